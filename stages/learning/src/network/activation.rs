//! Activation functions.

use params::choice;

choice! {
    /// Activation function of the sum z of a hidden unit. [Gnadt 2022, (4.3)-(4.6)]
    #[derive(Default)]
    pub enum ActivationFunction {
        /// z/(1 + e⁻ᶻ): swish, or SiLU.
        #[default]
        Swish = "swish",
        /// The larger of z and 0.
        Relu = "relu",
        /// tanh z.
        Tanh = "tanh",
        /// 1/(1 + e⁻ᶻ).
        Sigmoid = "sigmoid",
    }
}

impl ActivationFunction {
    /// Replaces sums by activations.
    pub(super) fn apply(self, z: &mut [f64]) {
        pulp::Arch::new().dispatch(ActivationKernel(self, z));
    }

    /// Replaces sums by activations, and writes their derivatives.
    pub(super) fn apply_with_slopes(self, z: &mut [f64], slopes: &mut [f64]) {
        pulp::Arch::new().dispatch(ActivationSlopeKernel(self, z, slopes));
    }
}

struct ActivationKernel<'a>(ActivationFunction, &'a mut [f64]);

impl pulp::NullaryFnOnce for ActivationKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self(activation, z) = self;
        match activation {
            ActivationFunction::Swish => each(
                z,
                #[inline(always)]
                |z| swish(z).0,
            ),
            ActivationFunction::Relu => each(
                z,
                #[inline(always)]
                |z| relu(z).0,
            ),
            ActivationFunction::Tanh => each(
                z,
                #[inline(always)]
                |z| tanh(z).0,
            ),
            ActivationFunction::Sigmoid => each(
                z,
                #[inline(always)]
                |z| sigmoid(z).0,
            ),
        }
    }
}

struct ActivationSlopeKernel<'a>(ActivationFunction, &'a mut [f64], &'a mut [f64]);

impl pulp::NullaryFnOnce for ActivationSlopeKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self(activation, z, slopes) = self;
        match activation {
            ActivationFunction::Swish => each_with_slope(z, slopes, swish),
            ActivationFunction::Relu => each_with_slope(z, slopes, relu),
            ActivationFunction::Tanh => each_with_slope(z, slopes, tanh),
            ActivationFunction::Sigmoid => each_with_slope(z, slopes, sigmoid),
        }
    }
}

#[inline(always)]
fn each(z: &mut [f64], of: impl Fn(f64) -> f64) {
    for z in z {
        *z = of(*z);
    }
}

#[inline(always)]
fn each_with_slope(z: &mut [f64], slopes: &mut [f64], of: impl Fn(f64) -> (f64, f64)) {
    for (z, slope) in z.iter_mut().zip(slopes) {
        (*z, *slope) = of(*z);
    }
}

#[inline(always)]
fn swish(z: f64) -> (f64, f64) {
    let s = sigmoid(z).0;
    let a = z * s;
    (a, s + a * (1.0 - s))
}

/// NaN stays NaN. The derivative at 0 is 0.
#[inline(always)]
fn relu(z: f64) -> (f64, f64) {
    (if z <= 0.0 { 0.0 } else { z }, if z <= 0.0 { 0.0 } else { 1.0 })
}

#[inline(always)]
pub(super) fn tanh(z: f64) -> (f64, f64) {
    let t = 1.0 - 2.0 / (1.0 + exp(2.0 * z));
    (t, 1.0 - t * t)
}

#[inline(always)]
pub(super) fn sigmoid(z: f64) -> (f64, f64) {
    let s = 1.0 / (1.0 + exp(-z));
    (s, s * (1.0 - s))
}

/// eˣ within two units in the last place, bit-identical on every machine, for results between e⁻⁷⁰⁸ and e⁷⁰⁹.
///
/// x = n ln 2 + r with |r| at most half of ln 2. The exponential of r is computed by the Taylor polynomial of degree
/// 13, and n is added to the exponent of the result. The computation is branch-free, so that it vectorises.
#[inline(always)]
fn exp(x: f64) -> f64 {
    const LN_2_HIGH: f64 = 6.931_471_803_691_238e-1;
    const LN_2_LOW: f64 = 1.908_214_929_270_587_7e-10;
    // Adding this constant to a number of moderate size leaves the nearest integer in the last bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    const INVERSE_FACTORIALS: [f64; 12] = [
        1.0 / 479_001_600.0,
        1.0 / 39_916_800.0,
        1.0 / 3_628_800.0,
        1.0 / 362_880.0,
        1.0 / 40_320.0,
        1.0 / 5_040.0,
        1.0 / 720.0,
        1.0 / 120.0,
        1.0 / 24.0,
        1.0 / 6.0,
        0.5,
        1.0,
    ];
    let within = if x > 709.0 { 709.0 } else { x };
    let within = if within < -708.0 { -708.0 } else { within };
    let shifted = within.mul_add(std::f64::consts::LOG2_E, ROUND);
    let n = shifted - ROUND;
    let r = (-n).mul_add(LN_2_LOW, (-n).mul_add(LN_2_HIGH, within));
    let mut sum = 1.0 / 6_227_020_800.0;
    for coefficient in INVERSE_FACTORIALS {
        sum = r.mul_add(sum, coefficient);
    }
    let sum = r.mul_add(sum, 1.0);
    let scaled = f64::from_bits(sum.to_bits().wrapping_add(shifted.to_bits() << 52));
    if x.is_nan() { x } else { scaled }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ref_the_exponential_agrees_with_the_c_library() {
        for i in -70_000..=70_000 {
            let x = f64::from(i) * 0.010_1;
            let (ours, theirs) = (exp(x), x.exp());
            assert!((ours - theirs).abs() <= 3.0 * f64::EPSILON * theirs, "{x}: {ours} {theirs}");
        }
        assert_eq!((exp(0.0), exp(-0.0)), (1.0, 1.0));
        assert!(exp(f64::NAN).is_nan() && exp(f64::from_bits(0x7ff8_0000_0000_0fff)).is_nan());
        assert!(exp(f64::INFINITY) > 1e307 && exp(1e300) > 1e307 && exp(f64::NEG_INFINITY) < 1e-307);
    }

    #[test]
    fn law_slopes_are_derivatives_and_nan_stays_nan() {
        for activation in
            [ActivationFunction::Swish, ActivationFunction::Relu, ActivationFunction::Tanh, ActivationFunction::Sigmoid]
        {
            let z: Vec<f64> = (-40..40).map(|i| f64::from(i) * 0.21 + 0.003).collect();
            let (mut value, mut slope) = (z.clone(), vec![0.0; z.len()]);
            activation.apply_with_slopes(&mut value, &mut slope);
            let at = |offset: f64| {
                let mut z: Vec<f64> = z.iter().map(|z| z + offset).collect();
                activation.apply(&mut z);
                z
            };
            let (before, after) = (at(-1e-5), at(1e-5));
            assert_eq!(value, at(0.0));
            for i in 0..z.len() {
                let by_difference = (after[i] - before[i]) / 2e-5;
                assert!((slope[i] - by_difference).abs() < 1e-9, "{activation:?} at {}", z[i]);
            }
            let mut lost = [f64::NAN; 5];
            activation.apply(&mut lost);
            assert!(lost.iter().all(|x| x.is_nan()), "{activation:?}");
        }
    }
}
