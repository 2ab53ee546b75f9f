//! Vectors and 3x3 matrices for the rigid truth. They are separate from the core's linear algebra on purpose, because
//! an error there must not cancel against the same error here.

/// Components in one frame.
pub type Vec3 = [f64; 3];
/// Rows of a matrix.
pub type Mat3 = [Vec3; 3];

/// Unit matrix.
pub const IDENTITY: Mat3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// `a + b`.
pub fn add(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// `a * factor`.
pub fn scale(a: Vec3, factor: f64) -> Vec3 {
    a.map(|x| x * factor)
}

/// `a + b * factor`.
pub fn add_scaled(a: Vec3, b: Vec3, factor: f64) -> Vec3 {
    [a[0] + b[0] * factor, a[1] + b[1] * factor, a[2] + b[2] * factor]
}

/// Scalar product.
pub fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Vector product `a x b`.
pub fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `m v`.
pub fn apply(m: &Mat3, v: Vec3) -> Vec3 {
    [dot(m[0], v), dot(m[1], v), dot(m[2], v)]
}

/// `m^T v`.
pub fn apply_transposed(m: &Mat3, v: Vec3) -> Vec3 {
    apply(&transpose(m), v)
}

/// Rows to columns.
pub fn transpose(m: &Mat3) -> Mat3 {
    [0, 1, 2].map(|column| m.map(|row| row[column]))
}

/// `a b`.
pub fn multiply(a: &Mat3, b: &Mat3) -> Mat3 {
    let columns = transpose(b);
    a.map(|row| columns.map(|column| dot(row, column)))
}

/// Inverse by cofactors. `m` is near the unit matrix in all uses.
pub fn inverse(m: &Mat3) -> Mat3 {
    let cofactors = [cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1])];
    let determinant = dot(m[0], cofactors[0]);
    transpose(&cofactors.map(|row| scale(row, determinant.recip())))
}

/// Components of `v` after the frame has turned by the angle with this sine and cosine about the unit vector `axis`
/// (Rodrigues, passive).
pub fn turn_frame(v: Vec3, axis: Vec3, (sin, cos): (f64, f64)) -> Vec3 {
    let along = dot(axis, v) * (1.0 - cos);
    add_scaled(add_scaled(scale(v, cos), cross(axis, v), -sin), axis, along)
}

/// Matrix of [`turn_frame`] for the rotation vector `turn`, rad: `exp(-[turn x])`.
pub fn frame_rotation(turn: Vec3) -> Mat3 {
    let angle = dot(turn, turn).sqrt();
    if angle == 0.0 {
        return IDENTITY;
    }
    let axis = scale(turn, angle.recip());
    transpose(&IDENTITY.map(|unit| turn_frame(unit, axis, angle.sin_cos())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_rotation_about_x_is_the_one_of_the_design() {
        let (s, c) = 0.3_f64.sin_cos();
        let expected = [[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]];
        let rotation = frame_rotation([0.3, 0.0, 0.0]);
        for (row, expected) in rotation.iter().zip(&expected) {
            assert!(row.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15), "{rotation:?}");
        }
    }

    #[test]
    fn inverse_times_matrix_is_unit() {
        let m = [[1.0, -0.02, 0.03], [0.01, 1.1, -0.05], [-0.04, 0.06, 0.9]];
        let product = multiply(&inverse(&m), &m);
        for (row, unit) in product.iter().zip(&IDENTITY) {
            assert!(row.iter().zip(unit).all(|(a, b)| (a - b).abs() < 1e-15), "{product:?}");
        }
    }
}
