//! Properties of the processor, other than the inputs, that change the last bits of a result.
//!
//! IEEE 754 fixes the four operations and the square root. It does not fix sines, exponentials and powers, which come
//! from the system's mathematical library. Nor does it fix the order of the sums in a matrix product or a Fourier
//! transform, which depends on the vector unit and the caches of the processor. If [`probe`] is bit-identical on two
//! machines, they give the same results for the functions that it covers; otherwise results differ by rounding.

use std::f64::consts::TAU;

use faer::{Accum, Mat, MatRef, Par, linalg::matmul::matmul};
use rustfft::{FftPlanner, num_complex::Complex64};

use crate::random::SplitMix64;

/// Number of compared values per elementary function.
const VALUES: usize = 256;

/// An elementary function.
type ElementaryFunction = fn(f64) -> f64;

/// Functions over the whole real line, and over (-1, 1).
const ANY: [ElementaryFunction; 8] =
    [f64::sin, f64::cos, f64::tan, f64::atan, f64::tanh, f64::sinh, f64::cosh, f64::cbrt];
const UNIT: [ElementaryFunction; 3] = [f64::asin, f64::acos, f64::atanh];
const POSITIVE: [ElementaryFunction; 4] = [f64::ln, f64::ln_1p, f64::log10, f64::log2];
const EXPONENTIAL: [ElementaryFunction; 3] = [f64::exp, f64::exp2, f64::exp_m1];

/// Results whose last bits depend on the machine: elementary functions of the system's library, matrix products and
/// Fourier transforms of fixed inputs.
pub fn probe() -> Vec<f64> {
    let mut words = SplitMix64::new(1);
    let mut uniform = || (words.draw() >> 11) as f64 / (1u64 << 53) as f64;
    let mut found = Vec::new();
    for _ in 0..VALUES {
        let [x, y] = [uniform(), uniform()];
        let (any, unit, positive) = (40.0 * x - 20.0, 2.0 * x - 1.0, 1e3 * x + 1e-9);
        found.extend(ANY.iter().map(|f| f(any)));
        found.extend(UNIT.iter().map(|f| f(unit)));
        found.extend(POSITIVE.iter().map(|f| f(positive)));
        found.extend(EXPONENTIAL.iter().map(|f| f(any)));
        found.extend([any.atan2(y - 0.5), any.hypot(y), positive.powf(y), f64::from((any as f32).exp())]);
        found.extend([f64::from((any as f32).tanh()), f64::from((any as f32).sin())]);
    }
    for (rows, sum, columns) in [(8, 3000, 8), (33, 1500, 17)] {
        let numbers: Vec<f64> = (0..sum * rows.max(columns)).map(|_| uniform() - 0.5).collect();
        let (left, right) = (
            MatRef::from_column_major_slice(&numbers[..rows * sum], rows, sum),
            MatRef::from_column_major_slice(&numbers[..sum * columns], sum, columns),
        );
        let mut product = Mat::<f64>::zeros(rows, columns);
        matmul(product.as_mut(), Accum::Replace, left, right, 1.0, Par::Seq);
        found.extend((0..columns).flat_map(|j| product.col_as_slice(j)));
        let single: Vec<f32> = numbers.iter().map(|x| *x as f32).collect();
        let (left, right) = (
            MatRef::from_column_major_slice(&single[..rows * sum], rows, sum),
            MatRef::from_column_major_slice(&single[..sum * columns], sum, columns),
        );
        let mut product = Mat::<f32>::zeros(rows, columns);
        matmul(product.as_mut(), Accum::Replace, left, right, 1.0, Par::Seq);
        found.extend((0..columns).flat_map(|j| product.col_as_slice(j)).map(|x| f64::from(*x)));
    }
    let mut planner = FftPlanner::new();
    for length in [256, 1000, 509] {
        let wave = |i: usize| Complex64::new((TAU * i as f64 / 7.0).sqrt(), i as f64 / 3.0);
        let mut buffer: Vec<Complex64> = (0..length).map(wave).collect();
        planner.plan_fft_forward(length).process(&mut buffer);
        found.extend(buffer.iter().flat_map(|x| [x.re, x.im]));
    }
    found
}

/// Architecture and vector extensions of the processor, as text.
pub fn processor() -> String {
    let mut words = vec![std::env::consts::ARCH];
    #[cfg(target_arch = "x86_64")]
    {
        let detected = [
            ("AVX", std::arch::is_x86_feature_detected!("avx")),
            ("AVX2", std::arch::is_x86_feature_detected!("avx2")),
            ("FMA", std::arch::is_x86_feature_detected!("fma")),
            ("AVX-512", std::arch::is_x86_feature_detected!("avx512f")),
        ];
        words.extend(detected.iter().filter(|(_, there)| *there).map(|(name, _)| *name));
    }
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_probe_is_finite_and_repeatable_on_each_thread() {
        let bits = || probe().into_iter().map(f64::to_bits).collect::<Vec<_>>();
        assert!(probe().iter().all(|x| x.is_finite()));
        assert_eq!(std::thread::spawn(bits).join().ok(), Some(bits()));
    }

    #[test]
    fn unit_processor_names_the_architecture() {
        assert!(processor().starts_with(std::env::consts::ARCH));
    }
}
