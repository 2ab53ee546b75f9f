//! Kalman filter of fixed size. The covariance is factored as U D U^T.
//!
//! U is unit upper triangular and D is diagonal, so the covariance stays symmetric and positive in spite of rounding.
//! This is the reason for the factored form: `f32` is sufficient even if the variances span twelve decades. One scalar
//! measurement costs order N^2 operations, and no matrix is inverted. The caller must decorrelate measurements with
//! correlated noise.
//!
//! Sources: Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, ch. V (measurement update) and
//! III.3 (rank-one modification, after Agee and Turner); Gelb, Applied Optimal Estimation, 1974, (4.2-12), for the
//! covariance of any gain.
//!
//! The state is the deviation from the linearization point of the caller.

use crate::base::linear::{Matrix, Real, Vector, columns, columns_mut, zeros};

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

/// States and their covariance, `P = U D U^T`.
#[derive(Clone, Debug, PartialEq)]
pub struct UdFilter<T: Real, const N: usize> {
    x: Vector<T, N>,
    u: Matrix<T, N, N>,
    d: Vector<T, N>,
    gate_sigma: Option<T>,
    gated: u32,
    refused: u32,
}

impl<T: Real, const N: usize> UdFilter<T, N> {
    /// A filter whose states have zero variance.
    pub const CERTAIN: Self = Self { x: zeros(), u: zeros(), d: zeros(), gate_sigma: None, gated: 0, refused: 0 };

    /// A filter of independent states with zero deviation and these sigmas, (N). A state with sigma zero is known and
    /// stays known.
    ///
    /// A measurement with a normalized innovation above `gate_sigma` is not used, but counted.
    pub fn new(sigmas: &Vector<T, N>, gate_sigma: Option<T>) -> Self {
        let mut filter = Self::CERTAIN;
        filter.restart(sigmas, gate_sigma);
        filter
    }

    /// Resets the filter in place to the state of [`UdFilter::new`].
    pub fn restart(&mut self, sigmas: &Vector<T, N>, gate_sigma: Option<T>) {
        self.x.fill(T::zero());
        self.u.fill_with_identity();
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

    /// Variances of the states, (N).
    pub fn variances(&self) -> Vector<T, N> {
        let mut variances = Vector::<T, N>::zeros();
        for (column, d) in self.u.column_iter().zip(self.d.iter()) {
            for (variance, u) in variances.iter_mut().zip(column.iter()) {
                *variance += *u * *u * *d;
            }
        }
        variances
    }

    /// The covariance, (N x N).
    pub fn covariance(&self) -> Matrix<T, N, N> {
        let mut scaled = self.u;
        for (mut column, d) in scaled.column_iter_mut().zip(self.d.iter()) {
            column *= *d;
        }
        scaled * self.u.transpose()
    }

    /// Row `i` of the covariance, (N).
    pub fn covariance_row(&self, i: usize) -> Vector<T, N> {
        let mut row = Vector::<T, N>::zeros();
        for (column, d) in self.u.column_iter().zip(self.d.iter()) {
            let Some(of_i) = column.iter().nth(i) else { continue };
            let scaled = *of_i * *d;
            for (entry, u) in row.iter_mut().zip(column.iter()) {
                *entry += scaled * *u;
            }
        }
        row
    }

    /// Updates the filter with one scalar measurement. `choose` receives the optimal gain and may change it. State and
    /// covariance are updated with the resulting gain. Returns the outcome and the resulting gain, (N), which is zero
    /// if the measurement was not used.
    pub fn update(
        &mut self,
        measurement: &Measurement<T, N>,
        choose: impl FnOnce(&mut Vector<T, N>),
    ) -> (Update<T>, Vector<T, N>) {
        let Measurement { z, h, r } = measurement;
        let f = self.factor_row(h);
        let variance = f.iter().zip(self.d.iter()).fold(*r, |sum, (f, d)| sum + *f * *f * *d);
        let innovation = Innovation { value: *z - h.dot(&self.x), variance };
        if !(innovation.value.is_finite() && variance.is_finite() && *r > T::zero()) {
            self.refused += 1;
            return (Update::Refused, Vector::zeros());
        }
        if self.gate_sigma.is_some_and(|gate| innovation.normalized().abs() > gate) {
            self.gated += 1;
            return (Update::Gated(innovation), Vector::zeros());
        }
        let optimal = self.update_factors(&f, *r) / variance;
        let mut gain = optimal;
        choose(&mut gain);
        self.x += gain * innovation.value;
        // A gain that differs from the optimal gain by k~ adds k~ S k~^T to the covariance.
        self.inflate(&(optimal - gain), variance);
        (Update::Applied(innovation), gain)
    }

    /// `U^T h`
    fn factor_row(&self, h: &Vector<T, N>) -> Vector<T, N> {
        let mut f = Vector::<T, N>::zeros();
        for ((j, f), column) in f.iter_mut().enumerate().zip(columns(&self.u)) {
            *f = column.iter().zip(h.as_slice()).take(j + 1).fold(T::zero(), |sum, (u, h)| sum + *u * *h);
        }
        f
    }

    /// Bierman's update of U and D. Returns the gain times the variance of the innovation.
    fn update_factors(&mut self, f: &Vector<T, N>, r: T) -> Vector<T, N> {
        let mut gain = [T::zero(); N];
        let mut alpha = r;
        let factors = columns_mut(&mut self.u).iter_mut().zip(self.d.as_mut_slice());
        for ((j, f), (column, d)) in f.iter().enumerate().zip(factors) {
            let g = *d * *f;
            let before = alpha;
            alpha += *f * g;
            *d *= before / alpha;
            let lambda = -*f / before;
            for (u, k) in column.iter_mut().zip(gain.iter_mut()).take(j) {
                let old = *u;
                *u += lambda * *k;
                *k += g * old;
            }
            if let Some(k) = gain.get_mut(j) {
                *k = g;
            }
        }
        Vector::from(gain)
    }

    /// Adds `variance` along `direction`: `P + variance * direction direction^T`.
    pub fn inflate(&mut self, direction: &Vector<T, N>, variance: T) {
        let [mut v] = direction.data.0;
        let mut c = variance;
        for ((j, column), d) in columns_mut(&mut self.u).iter_mut().enumerate().zip(self.d.as_mut_slice()).rev() {
            let Some(&p) = v.get(j) else { continue };
            let inflated = *d + c * p * p;
            if p == T::zero() || inflated <= T::zero() {
                continue;
            }
            let beta = c * p / inflated;
            for (u, v) in column.iter_mut().zip(v.iter_mut()).take(j) {
                *v -= p * *u;
                *u += beta * *v;
            }
            c *= *d / inflated;
            *d = inflated;
        }
    }

    /// Drops the first `W` states and moves the next `W` states to their place. The places of the moved states receive
    /// new independent states with zero deviation and these variances.
    ///
    /// The operation is exact and needs no arithmetic, because leading states can be dropped from U D U^T without a
    /// change of the other factors.
    pub fn renew_leading<const W: usize>(&mut self, variances: &[T; W]) {
        for j in 0..N {
            for i in 0..2 * W {
                let unit = if i == j { T::one() } else { T::zero() };
                let value = match (i < W, j < W, j < 2 * W) {
                    (true, true, _) => self.u.get((i + W, j + W)).copied(),
                    (true, false, false) => self.u.get((i + W, j)).copied(),
                    _ => Some(unit),
                };
                if let (Some(entry), Some(value)) = (self.u.get_mut((i, j)), value) {
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
    use crate::base::linear::real;

    const N: usize = 6;

    /// A function that changes the gain. The second argument is a random seed.
    type Change = fn(&mut Vector<f64, N>, &mut u64);

    fn leave<const N: usize, T: Real>(_: &mut Vector<T, N>) {}

    /// Reproducible pseudo-random numbers in (-1, 1).
    fn scatter(seed: &mut u64) -> f64 {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn measurement<T: Real>(seed: &mut u64) -> Measurement<T, N> {
        Measurement { z: real(scatter(seed)), h: Vector::from_fn(|_, _| real(scatter(seed))), r: real(0.04) }
    }

    /// The textbook filter in Joseph form with any gain: `P = (I - K H) P (I - K H)^T + K R K^T`.
    fn joseph(x: &mut Vector<f64, N>, p: &mut Matrix<f64, N, N>, m: &Measurement<f64, N>, k: &Vector<f64, N>) {
        *x += k * (m.z - m.h.dot(x));
        let i_kh = Matrix::<f64, N, N>::identity() - k * m.h.transpose();
        *p = i_kh * *p * i_kh.transpose() + k * m.r * k.transpose();
    }

    fn sigmas<T: Real>() -> Vector<T, N> {
        Vector::from_fn(|row, _| real(if row == 3 { 0.0 } else { 1.0 + row as f64 }))
    }

    #[test]
    fn factored_updates_equal_joseph_form_for_any_gain() {
        // Three cases: the optimal gain; some states only considered, not estimated (Schmidt 1966); an arbitrary gain.
        let considered: Change = |gain, _| (gain[1], gain[4]) = (0.0, 0.0);
        let other: Change =
            |gain, seed| *gain += Vector::from_fn(|row, _| if row == 3 { 0.0 } else { 0.1 * scatter(seed) });
        let optimal: Change = |_, _| ();
        for change in [optimal, considered, other] {
            let (mut seed, mut gains) = (7, 8);
            let mut filter = UdFilter::<f64, N>::new(&sigmas(), None);
            let (mut x, mut p) = (Vector::zeros(), filter.covariance());
            for _ in 0..40 {
                let m = measurement(&mut seed);
                let choose = |gain: &mut Vector<f64, N>| change(gain, &mut gains);
                let (update, gain) = filter.update(&m, choose);
                assert!(matches!(update, Update::Applied(_)));
                joseph(&mut x, &mut p, &m, &gain);
            }
            assert!((filter.covariance() - p).norm() < 1e-13 && (filter.state() - x).norm() < 1e-13);
            assert!((filter.variances() - p.diagonal()).norm() < 1e-13);
            assert!((filter.covariance_row(2) - p.row(2).transpose()).norm() < 1e-13);
            assert_eq!(filter.variances()[3], 0.0, "a known state stays known");
        }
    }

    #[test]
    fn f32_covariance_stays_positive_and_close_over_twelve_decades() {
        let wide = |t: f64| Vector::<f64, N>::from_fn(|row, _| t * 10_f64.powi(-(row as i32)));
        let mut double = UdFilter::<f64, N>::new(&wide(1e3), None);
        let mut single = UdFilter::<f32, N>::new(&wide(1e3).map(|s| s as f32), None);
        let mut seed = 3;
        for _ in 0..200 {
            let mut m = measurement::<f64>(&mut seed);
            m.r = 1e-6;
            let narrow = Measurement { z: m.z as f32, h: m.h.map(|h| h as f32), r: m.r as f32 };
            assert!(matches!(double.update(&m, leave).0, Update::Applied(_)));
            assert!(matches!(single.update(&narrow, leave).0, Update::Applied(_)));
        }
        for (double, single) in double.variances().iter().zip(single.variances().iter()) {
            assert!((f64::from(*single) / double - 1.0).abs() < 1e-3, "{single} for {double}");
        }
    }

    #[test]
    fn inflation_adds_an_outer_product() {
        let mut seed = 5;
        let mut filter = UdFilter::<f64, N>::new(&sigmas(), None);
        let _ = filter.update(&measurement(&mut seed), leave);
        let direction = Vector::<f64, N>::from_fn(|_, _| scatter(&mut seed));
        let expected = filter.covariance() + direction * direction.transpose() * 2.5;
        filter.inflate(&direction, 2.5);
        assert!((filter.covariance() - expected).norm() < 1e-13);
    }

    #[test]
    fn renewal_forgets_shifts_and_adds() {
        let mut seed = 9;
        let mut filter = UdFilter::<f64, N>::new(&sigmas(), None);
        for _ in 0..3 {
            let _ = filter.update(&measurement(&mut seed), leave);
        }
        let (x, p) = (*filter.state(), filter.covariance());
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
        assert!((filter.covariance() - expected).norm() < 1e-14);
        assert_eq!(*filter.state(), Vector::<f64, N>::from([x[2], x[3], 0.0, 0.0, x[4], x[5]]));
    }

    #[test]
    fn gate_and_bad_numbers_leave_the_filter_as_it_was() {
        let mut filter = UdFilter::<f64, N>::new(&sigmas(), Some(5.0));
        let mut m = Measurement { z: 1e6, h: Vector::from_fn(|row, _| row as f64), r: 1.0 };
        let before = filter.covariance();
        assert!(matches!(filter.update(&m, leave).0, Update::Gated(i) if i.normalized() > 5.0));
        m.z = f64::NAN;
        assert_eq!(filter.update(&m, leave).0, Update::Refused);
        assert_eq!((filter.gated(), filter.refused()), (1, 1));
        assert_eq!(filter.covariance(), before);
    }
}
