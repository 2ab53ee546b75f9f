//! Cholesky factor of a symmetric matrix, in place, column by column.
//!
//! The order of the operations is fixed, so the result has the same bits on every machine. The factors of a matrix
//! library depend on the instructions of the processor.

use rins_selfcal::base::linear::ComplexField;

/// Replaces the lower triangle of a matrix of `size` columns by its factor L, `L L^T`. `None` if the matrix is not
/// positive definite.
#[inline]
pub fn factorize(lower: &mut [f64], size: usize) -> Option<()> {
    for column in 0..size {
        let pivot = lower[column * size + column];
        if pivot.is_nan() || pivot <= 0.0 {
            return None;
        }
        let (done, rest) = lower.split_at_mut((column + 1) * size);
        let of_column = &mut done[column * size..];
        let root = ComplexField::sqrt(pivot).recip();
        of_column[column..].iter_mut().for_each(|entry| *entry *= root);
        for (other, entries) in (column + 1..).zip(rest.chunks_exact_mut(size)) {
            let of_other = of_column[other];
            let entries = entries.iter_mut().zip(&*of_column).skip(other);
            entries.for_each(|(entry, of_entry)| *entry -= of_other * of_entry);
        }
    }
    Some(())
}

/// Replaces a vector v by `L^-1 v`. The entries of v before `first` are zero.
#[inline]
pub fn substitute(factor: &[f64], vector: &mut [f64], first: usize) {
    let size = vector.len();
    for (pivot, of_pivot) in factor.chunks_exact(size).enumerate().skip(first) {
        let value = vector[pivot] / of_pivot[pivot];
        vector[pivot] = value;
        let below = vector.iter_mut().zip(of_pivot).skip(pivot + 1);
        below.for_each(|(entry, of_entry)| *entry -= value * of_entry);
    }
}
