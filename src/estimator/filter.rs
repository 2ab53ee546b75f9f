//! Kalman filter of fixed size. The covariance is factored as U D U^T.
//!
//! U is unit upper triangular and D is diagonal, so the covariance stays symmetric and positive in spite of rounding.
//! This is the reason for the factored form: `f32` is sufficient even if the variances span twelve decades. One scalar
//! measurement costs order N^2 operations, and no matrix is inverted. The caller must decorrelate measurements with
//! correlated noise.
//!
//! Sources: Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, ch. V (measurement update) and
//! III.3 (rank-one modification, after Agee and Turner).
//!
//! The state is the deviation from the linearization point of the caller. The memory is for `N` states, of which the
//! first ones are in use: a state that is absent costs no time.

use crate::base::linear::{Real, Vector, zeros};

/// Difference between a measurement and its prediction.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Innovation<T> {
    /// Measured minus predicted.
    pub value: T,
    /// Predicted variance of the innovation, `h P h^T + r`.
    pub variance: T,
}

impl<T: Real> Innovation<T> {
    /// The innovation in units of its standard deviation.
    pub fn normalized(&self) -> T {
        self.value / self.variance.sqrt()
    }
}

/// Outcome of a measurement update.
#[must_use]
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Update<T> {
    /// State and covariance are updated.
    Applied(Innovation<T>),
    /// The innovation exceeds the gate. Only the count has changed.
    Gated(Innovation<T>),
    /// A number is not finite, or the noise variance is not positive. Only the count has changed.
    Refused,
}

/// One scalar measurement, linear in the deviation: `z = h x + v`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Measurement<T: Real, const N: usize> {
    /// Measured value minus the value predicted at zero deviation.
    pub z: T,
    /// Row of the measurement matrix, (N).
    pub h: Vector<T, N>,
    /// Variance of the noise `v`.
    pub r: T,
}

/// Number of entries of U above the diagonal for `states` states: the third parameter of [`UdFilter`].
pub const fn entries_above_diagonal(states: usize) -> usize {
    states * states.saturating_sub(1) / 2
}

/// States and their covariance, `P = U D U^T`. `ABOVE` is [`entries_above_diagonal`] of `N`.
#[derive(Clone, Debug, PartialEq)]
pub struct UdFilter<T: Real, const N: usize, const ABOVE: usize> {
    /// Number of states in use.
    count: usize,
    x: Vector<T, N>,
    /// The entries of U above its diagonal, column by column.
    u: [T; ABOVE],
    d: Vector<T, N>,
    gate_sigma: Option<T>,
    gated: u32,
    refused: u32,
}

impl<T: Real, const N: usize, const ABOVE: usize> UdFilter<T, N, ABOVE> {
    /// A filter whose states have zero variance.
    pub const CERTAIN: Self =
        Self { count: N, x: zeros(), u: [T::ZERO; ABOVE], d: zeros(), gate_sigma: None, gated: 0, refused: 0 };

    /// A filter of independent states with zero deviation and these sigmas, (N). A state with sigma zero is known and
    /// stays known.
    ///
    /// A measurement with a normalized innovation above `gate_sigma` is not used, but counted.
    pub fn new(sigmas: &Vector<T, N>, gate_sigma: Option<T>) -> Self {
        let mut filter = Self::CERTAIN;
        filter.restart(sigmas, N, gate_sigma);
        filter
    }

    /// Resets the filter in place to the state of [`UdFilter::new`]. Only the first `count` states are in use.
    pub fn restart(&mut self, sigmas: &Vector<T, N>, count: usize, gate_sigma: Option<T>) {
        self.count = count.min(N);
        self.x.fill(T::zero());
        self.u.fill(T::zero());
        self.d.copy_from(sigmas);
        self.d.component_mul_assign(sigmas);
        (self.gate_sigma, self.gated, self.refused) = (gate_sigma, 0, 0);
    }

    /// The deviation, (N).
    pub fn state(&self) -> &Vector<T, N> {
        &self.x
    }

    /// The deviation, mutable. The caller changes it together with the linearization point.
    pub fn state_mut(&mut self) -> &mut Vector<T, N> {
        &mut self.x
    }

    /// Number of measurements that the gate refused.
    pub fn gated(&self) -> u32 {
        self.gated
    }

    /// Number of measurements refused because a number is not finite or the noise variance is not positive.
    pub fn refused(&self) -> u32 {
        self.refused
    }

    /// The columns of U above the diagonal, with the diagonal of D, for the states in use.
    fn columns(&self) -> impl Iterator<Item = (&[T], &T)> {
        self.columns_from(0)
    }

    /// The columns from this one on.
    fn columns_from(&self, first: usize) -> impl Iterator<Item = (&[T], &T)> {
        let mut rest = self.u.get(entries_above_diagonal(first)..).unwrap_or_default();
        self.d.as_slice().iter().take(self.count).enumerate().skip(first).map_while(move |(j, d)| {
            let (column, after) = rest.split_at_checked(j)?;
            rest = after;
            Some((column, d))
        })
    }

    /// Variances of the states, (N).
    pub fn variances(&self) -> Vector<T, N> {
        let mut variances = Vector::<T, N>::zeros();
        for (j, (column, d)) in self.columns().enumerate() {
            for (variance, u) in variances.iter_mut().zip(column) {
                *variance += *u * *u * *d;
            }
            if let Some(variance) = variances.iter_mut().nth(j) {
                *variance += *d;
            }
        }
        variances
    }

    /// Row `i` of the covariance, (N).
    pub fn covariance_row(&self, i: usize) -> Vector<T, N> {
        let mut row = Vector::<T, N>::zeros();
        for (j, (column, d)) in self.columns().enumerate() {
            let of_i = if i == j { T::one() } else { column.get(i).copied().unwrap_or(T::zero()) };
            let scaled = of_i * *d;
            for (entry, u) in row.iter_mut().zip(column.iter().chain([&T::one()])) {
                *entry += scaled * *u;
            }
        }
        row
    }

    /// Covariance of the states `i` and `j`.
    pub fn covariance(&self, i: usize, j: usize) -> T {
        let entry = |column: &[T], diagonal: usize, i: usize| {
            if i == diagonal { T::one() } else { column.get(i).copied().unwrap_or(T::zero()) }
        };
        let columns = (i.max(j)..).zip(self.columns_from(i.max(j)));
        columns.fold(T::zero(), |sum, (k, (column, d))| sum + entry(column, k, i) * entry(column, k, j) * *d)
    }

    /// Updates the filter with one scalar measurement, with the optimal gain. Returns the outcome and the gain, (N),
    /// which is zero if the measurement was not used.
    pub fn update(&mut self, Measurement { z, h, r }: &Measurement<T, N>) -> (Update<T>, Vector<T, N>) {
        // First `U^T h`, then the gain times the variance of the innovation, then the gain.
        let mut gain = self.factor_row(h);
        let variance = gain.iter().zip(self.d.iter()).fold(*r, |sum, (f, d)| sum + *f * *f * *d);
        let predicted = h.iter().zip(self.x.iter()).take(self.count).fold(T::zero(), |sum, (h, x)| sum + *h * *x);
        let innovation = Innovation { value: *z - predicted, variance };
        if !(innovation.value.is_finite() && variance.is_finite() && *r > T::zero()) {
            self.refused += 1;
            gain.fill(T::zero());
            return (Update::Refused, gain);
        }
        if self.gate_sigma.is_some_and(|gate| innovation.normalized().abs() > gate) {
            self.gated += 1;
            gain.fill(T::zero());
            return (Update::Gated(innovation), gain);
        }
        let mut alpha = *r;
        let mut rest: &mut [T] = &mut self.u;
        for (j, d) in self.d.as_mut_slice().iter_mut().enumerate().take(self.count) {
            let Some((column, after)) = rest.split_at_mut_checked(j) else { break };
            rest = after;
            let Some((before, [place, ..])) = gain.as_mut_slice().split_at_mut_checked(j) else { break };
            let f = *place;
            let g = *d * f;
            let alpha_before = alpha;
            alpha += f * g;
            *d *= alpha_before / alpha;
            let lambda = -f / alpha_before;
            for (u, k) in column.iter_mut().zip(before) {
                let old = *u;
                *u += lambda * *k;
                *k += g * old;
            }
            *place = g;
        }
        gain /= variance;
        for (x, gain) in self.x.iter_mut().zip(gain.iter()) {
            *x += *gain * innovation.value;
        }
        (Update::Applied(innovation), gain)
    }

    /// `U^T h`
    fn factor_row(&self, h: &Vector<T, N>) -> Vector<T, N> {
        let mut f = Vector::<T, N>::zeros();
        let h = h.as_slice();
        for ((f, diagonal), (column, _)) in f.iter_mut().zip(h).zip(self.columns()) {
            *f = column.iter().zip(h).fold(T::zero(), |sum, (u, h)| sum + *u * *h) + *diagonal;
        }
        f
    }

    /// Adds `variance` along `direction`: `P + variance * direction direction^T`.
    pub fn inflate(&mut self, direction: &Vector<T, N>, variance: T) {
        let [mut v] = direction.data.0;
        let mut c = variance;
        let used = entries_above_diagonal(self.count.max(1));
        let mut rest: &mut [T] = self.u.get_mut(..used).unwrap_or_default();
        for (j, d) in self.d.as_mut_slice().iter_mut().enumerate().take(self.count).rev() {
            let length = rest.len();
            let Some((before, column)) = rest.split_at_mut_checked(length.saturating_sub(j)) else { break };
            rest = before;
            let Some(&p) = v.get(j) else { continue };
            let inflated = *d + c * p * p;
            if p == T::zero() || inflated <= T::zero() {
                continue;
            }
            let beta = c * p / inflated;
            for (u, v) in column.iter_mut().zip(v.iter_mut()) {
                *v -= p * *u;
                *u += beta * *v;
            }
            c *= *d / inflated;
            *d = inflated;
        }
    }

    /// Adds `variance` to one state. The cost grows with the square of the number of the state.
    pub fn inflate_state(&mut self, state: usize, variance: T) {
        let direction = Vector::from_fn(|i, _| if i == state { T::one() } else { T::zero() });
        self.inflate(&direction, variance);
    }

    /// Puts a new independent state with zero deviation and this variance in the place of a state. The cost grows with
    /// the square of the number of the state.
    pub fn renew_state(&mut self, state: usize, variance: T) {
        let mut direction = Vector::<T, N>::zeros();
        let mut freed = T::zero();
        let mut rest: &mut [T] = &mut self.u;
        for ((j, d), x) in self.d.as_mut_slice().iter_mut().enumerate().take(self.count).zip(self.x.iter_mut()) {
            let Some((column, after)) = rest.split_at_mut_checked(j) else { break };
            rest = after;
            if j == state {
                // The states before it keep what they share with it.
                direction.iter_mut().zip(column.iter_mut()).for_each(|(to, u)| *to = core::mem::take(u));
                freed = core::mem::replace(d, variance);
                *x = T::zero();
            } else if let Some(u) = column.get_mut(state) {
                *u = T::zero();
            }
        }
        self.inflate(&direction, freed);
    }

    /// Multiplies a state and its deviation by a positive `factor`.
    pub fn scale_state(&mut self, state: usize, factor: T) {
        let mut rest: &mut [T] = &mut self.u;
        for ((j, d), x) in self.d.as_mut_slice().iter_mut().enumerate().take(self.count).zip(self.x.iter_mut()) {
            let Some((column, after)) = rest.split_at_mut_checked(j) else { break };
            rest = after;
            if j == state {
                *x *= factor;
                *d *= factor * factor;
                column.iter_mut().for_each(|u| *u /= factor);
            } else if let Some(u) = column.get_mut(state) {
                *u *= factor;
            }
        }
    }

    /// Drops the first `W` states and moves the next `W` states to their place. The places of the moved states receive
    /// new independent states with zero deviation and these variances.
    ///
    /// The operation is exact and needs no arithmetic, because leading states can be dropped from U D U^T without a
    /// change of the other factors.
    pub fn renew_leading<const W: usize>(&mut self, variances: &[T; W]) {
        let index = |i: usize, j: usize| entries_above_diagonal(j.max(1)) + i;
        for j in 0..self.count {
            for i in 0..j.min(2 * W) {
                let from = match (i < W, j < W, j < 2 * W) {
                    (true, true, _) => self.u.get(index(i + W, j + W)),
                    (true, false, false) => self.u.get(index(i + W, j)),
                    _ => None,
                };
                let value = from.copied().unwrap_or(T::zero());
                if let Some(entry) = self.u.get_mut(index(i, j)) {
                    *entry = value;
                }
            }
        }
        for i in 0..W {
            self.x.swap_rows(i, i + W);
            self.d.swap_rows(i, i + W);
        }
        for ((x, d), variance) in self.x.iter_mut().zip(self.d.iter_mut()).skip(W).zip(variances) {
            *x = T::zero();
            *d = *variance;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::linear::{Matrix, real};

    const N: usize = 6;
    type Filter<T> = UdFilter<T, N, { entries_above_diagonal(N) }>;

    fn covariance(filter: &Filter<f64>) -> Matrix<f64, N, N> {
        Matrix::from_fn(|row, column| filter.covariance_row(row)[column])
    }

    /// Reproducible pseudo-random numbers in (-1, 1).
    fn scatter(seed: &mut u64) -> f64 {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn measurement<T: Real>(seed: &mut u64) -> Measurement<T, N> {
        Measurement { z: real(scatter(seed)), h: Vector::from_fn(|_, _| real(scatter(seed))), r: real(0.04) }
    }

    /// The textbook filter in Joseph form: `P = (I - K H) P (I - K H)^T + K R K^T`.
    fn joseph(x: &mut Vector<f64, N>, p: &mut Matrix<f64, N, N>, m: &Measurement<f64, N>, k: &Vector<f64, N>) {
        *x += k * (m.z - m.h.dot(x));
        let i_kh = Matrix::<f64, N, N>::identity() - k * m.h.transpose();
        *p = i_kh * *p * i_kh.transpose() + k * m.r * k.transpose();
    }

    fn sigmas<T: Real>() -> Vector<T, N> {
        Vector::from_fn(|row, _| real(if row == 3 { 0.0 } else { 1.0 + row as f64 }))
    }

    #[test]
    fn factored_updates_equal_joseph_form() {
        let mut seed = 7;
        let mut filter = Filter::<f64>::new(&sigmas(), None);
        let (mut x, mut p) = (Vector::zeros(), covariance(&filter));
        for _ in 0..40 {
            let m = measurement(&mut seed);
            let (update, gain) = filter.update(&m);
            assert!(matches!(update, Update::Applied(_)));
            joseph(&mut x, &mut p, &m, &gain);
        }
        assert!((covariance(&filter) - p).norm() < 1e-13 && (filter.state() - x).norm() < 1e-13);
        assert!((filter.variances() - p.diagonal()).norm() < 1e-13);
        assert!((filter.covariance_row(2) - p.row(2).transpose()).norm() < 1e-13);
        assert_eq!(filter.variances()[3], 0.0, "a known state stays known");
    }

    #[test]
    fn f32_covariance_stays_positive_and_close_over_twelve_decades() {
        let wide = |t: f64| Vector::<f64, N>::from_fn(|row, _| t * 10_f64.powi(-(row as i32)));
        let mut double = Filter::<f64>::new(&wide(1e3), None);
        let mut single = Filter::<f32>::new(&wide(1e3).map(|s| s as f32), None);
        let mut seed = 3;
        for _ in 0..200 {
            let mut m = measurement::<f64>(&mut seed);
            m.r = 1e-6;
            let narrow = Measurement { z: m.z as f32, h: m.h.map(|h| h as f32), r: m.r as f32 };
            assert!(matches!(double.update(&m).0, Update::Applied(_)));
            assert!(matches!(single.update(&narrow).0, Update::Applied(_)));
        }
        for (double, single) in double.variances().iter().zip(single.variances().iter()) {
            assert!((f64::from(*single) / double - 1.0).abs() < 1e-3, "{single} for {double}");
        }
    }

    #[test]
    fn inflation_adds_an_outer_product() {
        let mut seed = 5;
        let mut filter = Filter::<f64>::new(&sigmas(), None);
        let _ = filter.update(&measurement(&mut seed));
        let direction = Vector::<f64, N>::from_fn(|_, _| scatter(&mut seed));
        let expected = covariance(&filter) + direction * direction.transpose() * 2.5;
        filter.inflate(&direction, 2.5);
        assert!((covariance(&filter) - expected).norm() < 1e-13);
    }

    #[test]
    fn renewal_forgets_shifts_and_adds() {
        let mut seed = 9;
        let mut filter = Filter::<f64>::new(&sigmas(), None);
        for _ in 0..3 {
            let _ = filter.update(&measurement(&mut seed));
        }
        let (x, p) = (*filter.state(), covariance(&filter));
        filter.renew_leading::<2>(&[0.25, 0.5]);
        let from = |i: usize| match i {
            0 | 1 => Some(i + 2),
            2 | 3 => None,
            _ => Some(i),
        };
        let expected = Matrix::<f64, N, N>::from_fn(|i, j| match (from(i), from(j)) {
            (Some(i), Some(j)) => p[(i, j)],
            _ if i == j => [0.25, 0.5][i - 2],
            _ => 0.0,
        });
        assert!((covariance(&filter) - expected).norm() < 1e-14);
        assert_eq!(*filter.state(), Vector::<f64, N>::from([x[2], x[3], 0.0, 0.0, x[4], x[5]]));
    }

    #[test]
    fn gate_and_bad_numbers_leave_the_filter_as_it_was() {
        let mut filter = Filter::<f64>::new(&sigmas(), Some(5.0));
        let mut m = Measurement { z: 1e6, h: Vector::from_fn(|row, _| row as f64), r: 1.0 };
        let before = covariance(&filter);
        assert!(matches!(filter.update(&m).0, Update::Gated(i) if i.normalized() > 5.0));
        m.z = f64::NAN;
        assert_eq!(filter.update(&m).0, Update::Refused);
        assert_eq!((filter.gated(), filter.refused()), (1, 1));
        assert_eq!(covariance(&filter), before);
    }
    #[test]
    fn a_scaled_state_has_a_scaled_covariance() {
        let mut seed = 11;
        let mut filter = Filter::<f64>::new(&sigmas(), None);
        for _ in 0..3 {
            let _ = filter.update(&measurement(&mut seed));
        }
        let (mut x, mut p) = (*filter.state(), covariance(&filter));
        x[2] *= 0.3;
        p.row_mut(2).iter_mut().for_each(|entry| *entry *= 0.3);
        p.column_mut(2).iter_mut().for_each(|entry| *entry *= 0.3);
        p[(4, 4)] += 0.7;
        filter.scale_state(2, 0.3);
        filter.inflate_state(4, 0.7);
        assert!((covariance(&filter) - p).norm() < 1e-13 && (filter.state() - x).norm() < 1e-15);
    }

    #[test]
    fn a_renewed_state_is_independent_and_the_others_are_as_before() {
        let mut seed = 12;
        let mut filter = Filter::<f64>::new(&sigmas(), None);
        for _ in 0..3 {
            let _ = filter.update(&measurement(&mut seed));
        }
        let (mut x, mut p) = (*filter.state(), covariance(&filter));
        p.row_mut(2).fill(0.0);
        p.column_mut(2).fill(0.0);
        (x[2], p[(2, 2)]) = (0.0, 0.3);
        filter.renew_state(2, 0.3);
        assert!((covariance(&filter) - p).norm() < 1e-13 && (filter.state() - x).norm() < 1e-15);
    }

    #[test]
    fn states_that_are_not_in_use_are_left_alone() {
        let mut seed = 13;
        let mut filter = Filter::<f64>::CERTAIN;
        filter.restart(&sigmas(), 4, None);
        let mut small =
            UdFilter::<f64, 4, { entries_above_diagonal(4) }>::new(&sigmas().fixed_rows::<4>(0).into_owned(), None);
        for _ in 0..5 {
            let Measurement { z, h, r } = measurement(&mut seed);
            let _ = filter.update(&Measurement { z, h, r });
            let _ = small.update(&Measurement { z, h: h.fixed_rows::<4>(0).into_owned(), r });
        }
        assert_eq!(filter.state().fixed_rows::<4>(0), *small.state());
        assert_eq!(filter.variances().fixed_rows::<4>(0), small.variances());
        assert_eq!((filter.state()[5], filter.variances()[5]), (0.0, 0.0));
    }
}
