//! Observability of the installation errors on a rotation scheme.
//!
//! The twelve installation errors are constant, F = 0, so the stripped observability matrix of the piecewise constant
//! system (PWCS; Goshen- Meskin and Bar-Itzhack 1992) is the stack of the measurement matrices:
//! ```text
//! (B11) H1 = [0(3x6) | R^T F(f_a) - F(f_a0) | [(R^T f_a) x](I - R^T)]     at stops
//! (B13) H2 = [-G(w_g) | 0(3x6)]                                           while turning
//! ```
//! (Bai et al., Sensors 2019, 19, 4005.) Here the rows are stacked in the order of the scheme and kept in triangular
//! form, so that the cost of the singular values does not depend on the length of the scheme. H1 is in units of gravity
//! and H2 in units of the scheme's rate, so that both have no unit.

use rins_selfcal::base::angle::Angle;
use rins_selfcal::base::linear::{ComplexField, Matrix, Vector, Vector3, skew};
use rins_selfcal::base::site::Site;
use rins_selfcal::model::error_model::{INSTALLATION_STATES, InstrumentErrors, frame_rotation_x, frame_rotation_z};
use rins_selfcal::model::rotation::gyro_non_orthogonality_matrix;
use rins_selfcal::model::stop_force::accel_non_orthogonality_matrix;
use rins_selfcal::scheme::{Leg, Scheme};
use std::ops::Range;

/// A singular value below this part of the largest counts as zero. Earth rate, 2e-4 of the scheme's rate, does not.
const RANK_TOLERANCE: f64 = 1e-10;
/// Time between rows while turning, s.
const ROW_S: f64 = 0.1;
/// Duration of an interval of the piecewise constant system in the paper, s.
pub const INTERVAL_S: f64 = 0.005;
/// A column with a smaller norm does not depend on its state.
const COLUMN_TOLERANCE: f64 = 1e-9;
/// A direction is observed if the measurements leave at most this part of its prior variance.
const OBSERVED_VARIANCE: f64 = 0.01;

/// Singular values, the largest first, by one-sided Jacobi rotations (Hestenes 1958), which are accurate for small
/// singular values too.
fn singular_values<const N: usize>(m: &Matrix<f64, N, N>) -> Vector<f64, N> {
    const SWEEPS: usize = 30;
    let mut columns = *m;
    for _ in 0..SWEEPS {
        let mut rotated = false;
        for i in 0..N {
            for j in i + 1..N {
                rotated |= orthogonalize(&mut columns, i, j);
            }
        }
        if !rotated {
            break;
        }
    }
    let mut values = Vector::<f64, N>::from_fn(|row, _| columns.column(row).norm());
    values.as_mut_slice().sort_unstable_by(|a, b| b.partial_cmp(a).unwrap_or(std::cmp::Ordering::Equal));
    values
}

/// Rotates two columns into orthogonal ones. Returns `false` if they were orthogonal already.
fn orthogonalize<const N: usize>(columns: &mut Matrix<f64, N, N>, i: usize, j: usize) -> bool {
    let (a, b) = (columns.column(i).norm_squared(), columns.column(j).norm_squared());
    let c = columns.column(i).dot(&columns.column(j));
    if c.abs() <= f64::EPSILON * (a * b).sqrt() {
        return false;
    }
    let zeta = (b - a) / (c + c);
    let tan = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
    let cos = (1.0 + tan * tan).sqrt().recip();
    let sin = cos * tan;
    for row in 0..N {
        let (x, y) = (columns[(row, i)], columns[(row, j)]);
        columns[(row, i)] = cos * x - sin * y;
        columns[(row, j)] = sin * x + cos * y;
    }
    true
}

/// Rank and singular values of a stacked matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observability<const N: usize> {
    /// Number of singular values that do not count as zero.
    pub rank: usize,
    /// Singular values, the largest first, (N).
    pub singular_values: Vector<f64, N>,
}

impl<const N: usize> Observability<N> {
    fn of(matrix: &Matrix<f64, N, N>) -> Self {
        let found = Self { rank: 0, singular_values: singular_values(matrix) };
        Self { rank: found.rank_above(RANK_TOLERANCE), ..found }
    }

    /// Number of singular values above this part of the largest.
    pub fn rank_above(&self, part: f64) -> usize {
        let least = part * self.singular_values.max();
        self.singular_values.iter().filter(|value| **value > least).count()
    }

    /// Largest singular value divided by the smallest that does not count as zero.
    pub fn condition_number(&self) -> f64 {
        let counted = self.singular_values.iter().take(self.rank);
        counted.clone().fold(0.0, |a, b| f64::max(a, *b)) / counted.fold(f64::INFINITY, |a, b| f64::min(a, *b))
    }
}

/// The rows so far, reduced to a triangular matrix with the same singular values.
#[derive(Clone, Debug, PartialEq)]
pub struct StrippedMatrix<const N: usize> {
    triangle: Matrix<f64, N, N>,
}

impl<const N: usize> Default for StrippedMatrix<N> {
    fn default() -> Self {
        Self { triangle: Matrix::zeros() }
    }
}

impl<const N: usize> StrippedMatrix<N> {
    /// Adds the rows of a measurement matrix by Givens rotations into the triangular matrix.
    pub fn add<const ROWS: usize>(&mut self, rows: &Matrix<f64, ROWS, N>) {
        for row in rows.row_iter() {
            let mut row = row.transpose();
            for column in 0..N {
                self.rotate(&mut row, column);
            }
        }
    }

    fn rotate(&mut self, row: &mut Vector<f64, N>, column: usize) {
        let (diagonal, entry) = (self.triangle[(column, column)], row[column]);
        let radius = ComplexField::hypot(diagonal, entry);
        if entry == 0.0 {
            return;
        }
        let (cos, sin) = (diagonal / radius, entry / radius);
        for k in column..N {
            let (above, below) = (self.triangle[(column, k)], row[k]);
            self.triangle[(column, k)] = cos * above + sin * below;
            row[k] = cos * below - sin * above;
        }
    }

    /// Rank and singular values of the rows so far.
    pub fn observability(&self) -> Observability<N> {
        Observability::of(&self.triangle)
    }
}

/// (B11): the measurement matrix of a stop against the first stop, in units of gravity.
fn stop_matrix(outer: Angle, inner: Angle, up_b: &Vector3<f64>) -> Matrix<f64, 3, INSTALLATION_STATES> {
    let back = InstrumentErrors::<f64>::default().rot_rr0(outer, inner).transpose();
    let force_a = back.transpose() * up_b;
    let mut h = Matrix::<f64, 3, INSTALLATION_STATES>::zeros();
    let non_orthogonality = back * accel_non_orthogonality_matrix(&force_a) - accel_non_orthogonality_matrix(up_b);
    h.fixed_columns_mut::<3>(6).copy_from(&non_orthogonality);
    h.fixed_columns_mut::<3>(9).copy_from(&(skew(&(back * force_a)) * (Matrix::identity() - back)));
    h
}

/// (B13): the measurement matrix while turning, in units of `unit_rad_s`.
fn turn_matrix(omega_g: &Vector3<f64>, unit_rad_s: f64) -> Matrix<f64, 3, INSTALLATION_STATES> {
    let mut h = Matrix::<f64, 3, INSTALLATION_STATES>::zeros();
    h.fixed_columns_mut::<6>(0).copy_from(&(-gyro_non_orthogonality_matrix(omega_g) / unit_rad_s));
    h
}

/// Stacks (B11) and (B13) along one period of a scheme on an instrument without errors, with the base at this attitude.
/// Calls `report` with time (s) and observability after every row while turning and after every stop.
pub fn along_scheme(
    scheme: &Scheme,
    site: &Site,
    base: &InstrumentErrors<f64>,
    report: impl FnMut(f64, &Observability<INSTALLATION_STATES>),
) {
    along_scheme_every(ROW_S, scheme, site, base, report);
}

/// As [`along_scheme`], with a row after every `row_s` while turning.
pub fn along_scheme_every(
    row_s: f64,
    scheme: &Scheme,
    site: &Site,
    base: &InstrumentErrors<f64>,
    mut report: impl FnMut(f64, &Observability<INSTALLATION_STATES>),
) {
    let base = BaseAxes::new(site, base);
    let mut stripped = StrippedMatrix::default();
    let mut time_s = scheme.first_stop_s;
    let mut from = Leg::default();
    for leg in &scheme.legs {
        let move_s = scheme.move_s(&from, leg);
        let rows = ComplexField::ceil(move_s / row_s) as u32;
        for row in 1..rows {
            let at_s = move_s * f64::from(row) / f64::from(rows);
            stripped.add(&turn_matrix(&base.omega_at(scheme, &from, leg, at_s), scheme.rate_rad_s));
            report(time_s + at_s, &stripped.observability());
        }
        time_s += move_s + leg.stop_s;
        stripped.add(&base.stop_matrix(leg));
        report(time_s, &stripped.observability());
        from = *leg;
    }
}

/// Directions of gravity and Earth rate in the base.
struct BaseAxes {
    up_b: Vector3<f64>,
    earth_rate_b: Vector3<f64>,
}

impl BaseAxes {
    fn new(site: &Site, base: &InstrumentErrors<f64>) -> Self {
        let rot_bn = base.rot_nb().transpose();
        Self { up_b: rot_bn.column(2).into_owned(), earth_rate_b: rot_bn * Vector3::from(site.earth_rate_n()) }
    }

    /// (B11) at the stop after a leg.
    fn stop_matrix(&self, leg: &Leg) -> Matrix<f64, 3, INSTALLATION_STATES> {
        stop_matrix(Angle::from_rad(leg.outer_rad), Angle::from_rad(leg.inner_rad), &self.up_b)
    }

    /// Angular rate in the rotation frame at a time after the start of a leg, rad/s. (B12)
    fn omega_at(&self, scheme: &Scheme, from: &Leg, leg: &Leg, at_s: f64) -> Vector3<f64> {
        let [outer, inner] = leg.ways_from(from).map(|way_rad| scheme.turning().profile(way_rad).at(at_s));
        let rot_inner = frame_rotation_z::<f64>(Angle::from_rad(from.inner_rad + inner.angle_rad));
        let rot_outer = frame_rotation_x::<f64>(Angle::from_rad(from.outer_rad + outer.angle_rad));
        rot_inner * (Vector3::x() * outer.rate_rad_s + rot_outer * self.earth_rate_b) + Vector3::z() * inner.rate_rad_s
    }
}

/// Stacks one interval for each move and each stop of one period, in the order of the scheme. This is the scheme in a
/// relative time, which passes only once for each thing that is activated. The first stop is left out: (B11) is the
/// difference to this stop.
pub fn in_relative_time(
    scheme: &Scheme,
    site: &Site,
    base: &InstrumentErrors<f64>,
) -> Vec<Observability<INSTALLATION_STATES>> {
    let base = BaseAxes::new(site, base);
    let mut stripped = StrippedMatrix::default();
    let mut from = Leg::default();
    let mut found = Vec::new();
    for leg in &scheme.legs {
        let middle_s = 0.5 * scheme.move_s(&from, leg);
        stripped.add(&turn_matrix(&base.omega_at(scheme, &from, leg, middle_s), scheme.rate_rad_s));
        found.push(stripped.observability());
        stripped.add(&base.stop_matrix(leg));
        found.push(stripped.observability());
        from = *leg;
    }
    found
}

/// What the stops of one step of a scheme activate.
#[derive(Clone, Debug, PartialEq)]
pub struct Activated {
    /// Legs of the step.
    pub legs: Range<usize>,
    /// States on which (B11) depends at a stop of the step.
    pub states: Vec<usize>,
    /// Number of independent combinations of these states that (B11) shows, all stops of the step together.
    pub rank: usize,
}

/// What (B11) activates on a level base in the three steps of the paper: about the outer axis at inner angle zero; one
/// move of the inner axis and then about the outer axis; and from the next move of the inner axis on.
pub fn activated(scheme: &Scheme) -> Vec<Activated> {
    let legs = scheme.legs.as_slice();
    let inner_before = |leg: usize| leg.checked_sub(1).map_or(0.0, |before| legs[before].inner_rad);
    let inner_moves = (0..legs.len()).filter(|leg| legs[*leg].inner_rad != inner_before(*leg));
    let bounds: Vec<usize> = std::iter::once(0).chain(inner_moves.take(2)).chain([legs.len()]).collect();
    let step = |bounds: &[usize]| {
        let mut stripped = StrippedMatrix::<INSTALLATION_STATES>::default();
        for leg in &legs[bounds[0]..bounds[1]] {
            stripped.add(&stop_matrix(Angle::from_rad(leg.outer_rad), Angle::from_rad(leg.inner_rad), &Vector3::z()));
        }
        let depends = |state: &usize| stripped.triangle.column(*state).norm() > COLUMN_TOLERANCE;
        Activated {
            legs: bounds[0]..bounds[1],
            states: (0..INSTALLATION_STATES).filter(depends).collect(),
            rank: stripped.observability().rank_above(COLUMN_TOLERANCE),
        }
    };
    bounds.windows(2).map(step).collect()
}

/// The states on which (B13) depends while the IMU turns about x, y and z.
pub fn activated_by_turns() -> [Vec<usize>; 3] {
    [Vector3::x(), Vector3::y(), Vector3::z()].map(|omega_g| {
        let rows = turn_matrix(&omega_g, 1.0);
        (0..INSTALLATION_STATES).filter(|state| rows.column(*state).norm() > COLUMN_TOLERANCE).collect()
    })
}

/// Number of directions of the parameter space that the measurements determine, and condition number of the estimation
/// problem. The condition number is the one of the square root of the information matrix with columns of unit length,
/// that is of the square root of the correlation matrix. States with a prior sigma of zero are left out.
pub fn of_covariance<const N: usize>(covariance: &Matrix<f64, N, N>, prior_sigmas: &[f64; N]) -> (usize, f64) {
    let inverse = |value: f64| if value > 0.0 { 1.0 / value } else { 0.0 };
    let by_prior = Vector::<f64, N>::from_fn(|row, _| inverse(prior_sigmas[row]));
    let by_sigma = covariance.diagonal().map(|variance| inverse(ComplexField::sqrt(variance)));
    let scaled = |by: &Vector<f64, N>| singular_values(&covariance.component_mul(&(by * by.transpose())));
    let states = prior_sigmas.iter().filter(|sigma| **sigma > 0.0).count();
    let unobserved = scaled(&by_prior).iter().filter(|part| **part > OBSERVED_VARIANCE).count();
    let correlation = scaled(&by_sigma);
    let smallest = correlation.iter().copied().take(states).fold(f64::INFINITY, f64::min);
    (states - unobserved, ComplexField::sqrt(correlation.max() / smallest))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rins_selfcal::base::units::DEG;

    #[test]
    fn the_triangular_matrix_has_the_singular_values_of_the_stack() {
        let rows = Matrix::<f64, 7, 4>::from_fn(|row, column| ((3 * row + 5 * column * column) % 11) as f64 - 4.0);
        let mut stripped = StrippedMatrix::<4>::default();
        stripped.add(&rows);
        let (found, expected) = (stripped.observability().singular_values, rows.singular_values());
        assert!((found - expected).norm() < 1e-12, "{found} for {expected}");
    }

    /// The three states are Sayz, Sazy and alpha. No measurement depends on them until the inner axis has moved.
    #[test]
    fn turns_about_the_outer_axis_on_a_level_base_leave_three_states_without_a_column() {
        for quarters in -4..=4 {
            let h = stop_matrix(Angle::from_rad(f64::from(quarters) * 90.0 * DEG), Angle::default(), &Vector3::z());
            assert!([6, 8, 9].into_iter().all(|state| h.column(state).norm() < 1e-12), "{h}");
        }
        let h = stop_matrix(Angle::default(), Angle::from_rad(90.0 * DEG), &Vector3::x());
        assert!([6, 8, 9].into_iter().all(|state| h.column(state).norm() > 0.1), "{h}");
    }

    #[test]
    fn rank_of_bai_is_9_until_the_inner_axis_moves_and_then_12() {
        let base = InstrumentErrors { heading: 30.0 * DEG, ..InstrumentErrors::default() };
        let scheme = Scheme::bai(200.0, 1);
        let mut trace = Vec::new();
        along_scheme(&scheme, &Site::default(), &base, |time_s, seen| trace.push((time_s, seen.rank)));
        // Five outer moves of 5.5 s and six stops come before the first inner move.
        let inner_moves_s = 6.0 * 200.0 + 5.0 * 5.5;
        let before = trace.iter().filter(|(time_s, _)| *time_s <= inner_moves_s).map(|(_, rank)| *rank).max();
        assert_eq!(before, Some(9));
        assert_eq!(trace.last().map(|(_, rank)| *rank), Some(12));
    }

    /// The paper: "three", "four" and "five" parameters are activated (section 3.2.1; the names are lost in our text of it).
    #[test]
    fn the_three_steps_of_scheme_bai_activate_three_four_and_five_parameters() {
        let steps = activated(&Scheme::bai(200.0, 1));
        assert_eq!(steps.iter().map(|step| step.legs.clone()).collect::<Vec<_>>(), [0..5, 5..12, 12..18]);
        assert_eq!(steps.iter().map(|step| step.rank).collect::<Vec<_>>(), [3, 4, 5]);
        // Sazx, beta and gamma. The later steps depend on more states than they separate.
        assert_eq!(steps[0].states, [7, 10, 11]);
        assert_eq!(steps.iter().map(|step| step.states.len()).collect::<Vec<_>>(), [3, 5, 6]);
    }

    #[test]
    fn a_turn_about_each_axis_activates_two_parameters_of_the_gyros() {
        // Sgyz Sgzy, Sgxz Sgzx, Sgxy Sgyx: the rotation axis is the index that is missing.
        assert_eq!(activated_by_turns(), [vec![3, 5], vec![1, 4], vec![0, 2]]);
    }

    /// The last state is seen at the stop after the seventh move, the first one about the IMU's y axis.
    #[test]
    fn in_relative_time_the_rank_is_full_after_70_ms() {
        let found = in_relative_time(&Scheme::bai(200.0, 1), &Site::default(), &InstrumentErrors::default());
        let full = found.iter().position(|seen| seen.rank == INSTALLATION_STATES).map(|place| place + 1);
        assert_eq!(full, Some(14));
        assert!((14.0 * INTERVAL_S - 0.07).abs() < 1e-12);
    }

    #[test]
    fn all_states_are_seen_once_the_inner_axis_has_moved() {
        let (scheme, base) = (Scheme::bai(200.0, 1), InstrumentErrors::default());
        let (mut rank, mut full_s) = (0, None);
        along_scheme(&scheme, &Site::default(), &base, |time_s, seen| {
            rank = seen.rank;
            if rank == 12 {
                full_s.get_or_insert(time_s);
            }
        });
        // Six stops and five moves come before the first move of the inner axis.
        assert!(rank == 12 && full_s.is_some_and(|time_s| time_s > 6.0 * 200.0 + 5.0 * 5.5));
    }
}
