//! The inner product of two slices.

/// Sum of the products of `a` and `b`, in their order and over the shorter of the two.
#[inline(always)]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
