//! Linear algebra. No other file names the matrix library.
//!
//! All types have a fixed size and are generic over the scalar: `f64` for processors with a double-precision FPU, `f32`
//! for processors with a single-precision FPU.

use core::fmt::Debug;

pub use nalgebra::{ComplexField, RealField};

/// Column vector of fixed length.
pub type Vector<T, const N: usize> = nalgebra::SVector<T, N>;
/// Matrix of fixed size.
pub type Matrix<T, const R: usize, const C: usize> = nalgebra::SMatrix<T, R, C>;
/// Vector in three-dimensional space.
pub type Vector3<T> = Vector<T, 3>;
/// 3x3 matrix. A matrix whose name contains `rot` is a rotation.
pub type Matrix3<T> = Matrix<T, 3, 3>;

/// The scalar of the core: `f32` or `f64`.
pub trait Real: RealField + Copy + Default + Debug + Send + Sync + 'static {
    /// Converts `value` to this type by rounding.
    fn rounded(value: f64) -> Self;
    /// Converts to `f64` without loss.
    fn widened(self) -> f64;
    /// Relative spacing of the numbers of this type: `2^-52` for `f64`, `2^-23` for `f32`.
    const EPSILON: f64;
    /// Zero as a constant expression.
    const ZERO: Self;
}

impl Real for f64 {
    fn rounded(value: f64) -> Self {
        value
    }
    fn widened(self) -> f64 {
        self
    }
    const EPSILON: f64 = f64::EPSILON;
    const ZERO: Self = 0.0;
}

impl Real for f32 {
    fn rounded(value: f64) -> Self {
        value as f32
    }
    fn widened(self) -> f64 {
        self.into()
    }
    const EPSILON: f64 = f32::EPSILON as f64;
    const ZERO: Self = 0.0;
}

/// Converts `value` to the scalar `T` by rounding.
#[inline]
pub fn real<T: Real>(value: f64) -> T {
    T::rounded(value)
}

/// A matrix of zeros for `const` expressions. Large memory is initialized in place and does not pass through the stack.
pub const fn zeros<T: Real, const R: usize, const C: usize>() -> Matrix<T, R, C> {
    Matrix::from_array_storage(nalgebra::ArrayStorage([[T::ZERO; R]; C]))
}

/// The columns of a matrix in order.
pub fn columns<T: Real, const R: usize, const C: usize>(m: &Matrix<T, R, C>) -> &[[T; R]; C] {
    &m.data.0
}

/// The columns of a matrix in order, mutable.
pub fn columns_mut<T: Real, const R: usize, const C: usize>(m: &mut Matrix<T, R, C>) -> &mut [[T; R]; C] {
    &mut m.data.0
}

/// Cross-product matrix `[v x]`, so that `skew(v) * w == v.cross(&w)`.
pub fn skew<T: Real>(v: &Vector3<T>) -> Matrix3<T> {
    let zero = T::zero();
    Matrix3::new(zero, -v.z, v.y, v.z, zero, -v.x, -v.y, v.x, zero)
}

/// Coefficients `(sin a / a, (1 - cos a) / a^2, (a - sin a) / a^3)`. Near zero they are computed by their series.
fn rotation_coefficients<T: Real>(angle_squared: T) -> (T, T, T) {
    if angle_squared < real(1e-2) {
        let series = |c: [f64; 5]| c.iter().rev().fold(T::zero(), |sum, term| sum * -angle_squared + real(*term));
        (
            series([1.0, 1.0 / 6.0, 1.0 / 120.0, 1.0 / 5040.0, 1.0 / 362_880.0]),
            series([0.5, 1.0 / 24.0, 1.0 / 720.0, 1.0 / 40_320.0, 1.0 / 3_628_800.0]),
            series([1.0 / 6.0, 1.0 / 120.0, 1.0 / 5040.0, 1.0 / 362_880.0, 1.0 / 39_916_800.0]),
        )
    } else {
        let angle = angle_squared.sqrt();
        let (sin, cos) = angle.sin_cos();
        (sin / angle, (T::one() - cos) / angle_squared, (angle - sin) / (angle_squared * angle))
    }
}

/// Rotation matrix `exp([v x])`: the active rotation by `|v|` rad about `v`.
pub fn exp_so3<T: Real>(v: &Vector3<T>) -> Matrix3<T> {
    let (a, b, _) = rotation_coefficients(v.norm_squared());
    let cross = skew(v);
    Matrix3::identity() + cross * a + cross * cross * b
}

/// Left Jacobian of SO(3): `exp([(v + d) x]) = exp([J(v) d x]) exp([v x])` to first order in `d`.
pub fn left_jacobian_so3<T: Real>(v: &Vector3<T>) -> Matrix3<T> {
    let (_, b, c) = rotation_coefficients(v.norm_squared());
    let cross = skew(v);
    Matrix3::identity() + cross * b + cross * cross * c
}

/// Inverse by the adjugate. The matrix is not checked: `m` must be close to a rotation or to the identity.
pub fn inverse3<T: Real>(m: &Matrix3<T>) -> Matrix3<T> {
    let (x, y, z) = (m.column(0).into_owned(), m.column(1).into_owned(), m.column(2).into_owned());
    let (yz, zx, xy) = (y.cross(&z), z.cross(&x), x.cross(&y));
    let determinant = x.dot(&yz);
    Matrix3::from_columns(&[yz, zx, xy]).transpose() / determinant
}

/// Sum that carries the rounding error of each addition into the next addition (Knuth's two-sum). The mean of 100 000
/// `f32` samples is then as accurate as the mean of ten.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CompensatedSum<T> {
    sum: T,
    rest: T,
}

impl<T: Real> CompensatedSum<T> {
    /// The sum of no terms.
    pub const ZERO: Self = Self { sum: T::ZERO, rest: T::ZERO };

    /// Adds one term.
    #[inline]
    pub fn add(&mut self, term: T) {
        let term = term + self.rest;
        let sum = self.sum + term;
        let added = sum - self.sum;
        self.rest = (self.sum - (sum - added)) + (term - added);
        self.sum = sum;
    }

    /// The sum, rounded once to `T`.
    pub fn total(&self) -> T {
        self.sum + self.rest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_is_a_rotation_and_inverts() {
        for v in [Vector3::new(1e-9, -2e-9, 3e-9), Vector3::new(0.01, -0.02, 0.015), Vector3::new(1.0, -2.0, 0.5)] {
            let rot = exp_so3(&v);
            assert!((rot * rot.transpose() - Matrix3::identity()).norm() < 1e-15);
            assert!((rot * exp_so3(&-v) - Matrix3::identity()).norm() < 1e-15);
            assert!((inverse3(&rot) - rot.transpose()).norm() < 1e-15);
        }
    }

    #[test]
    fn left_jacobian_matches_differences() {
        let v = Vector3::new(0.3, -0.2, 0.7);
        for axis in 0..3 {
            let mut d = Vector3::zeros();
            d[axis] = 1e-6;
            let left = exp_so3(&(v + d)) * exp_so3(&(v - d)).transpose();
            let predicted = left_jacobian_so3(&v) * d * 2.0;
            let odd = (left - left.transpose()) * 0.5;
            let found = Vector3::new(odd[(2, 1)], odd[(0, 2)], odd[(1, 0)]);
            assert!((found - predicted).norm() < 1e-14, "axis {axis}");
        }
    }

    #[test]
    fn compensated_f32_sum_keeps_a_million_small_terms() {
        let mut sum = CompensatedSum::<f32>::default();
        sum.add(1.0e4);
        for _ in 0..1_000_000 {
            sum.add(1.0e-4);
        }
        assert!((f64::from(sum.total()) - 10_100.0).abs() < 2e-3);
    }
}
