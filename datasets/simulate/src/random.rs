//! Random numbers: one stream for each quantity, derived from its names, so that adding a flight, a line or a sensor
//! does not change the other draws.

use rand_chacha::{
    ChaCha12Rng,
    rand_core::{Rng, SeedableRng},
};

/// A stream of random numbers.
pub(super) struct RandomStream {
    generator: ChaCha12Rng,
    spare: Option<f64>,
}

impl RandomStream {
    /// The stream of the quantity identified by `names`.
    pub(super) fn new(seed: u64, names: &[&str]) -> RandomStream {
        let mut hash = blake3::Hasher::new_derive_key("magline synth 1: streams of random numbers");
        hash.update(&seed.to_le_bytes());
        for name in names {
            // The length distinguishes ("ab", "c") from ("a", "bc").
            hash.update(&(name.len() as u64).to_le_bytes());
            hash.update(name.as_bytes());
        }
        RandomStream { generator: ChaCha12Rng::from_seed(*hash.finalize().as_bytes()), spare: None }
    }

    /// A uniformly distributed number, above 0 and at most 1.
    pub(super) fn uniform(&mut self) -> f64 {
        ((self.generator.next_u64() >> 11) + 1) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal. [Box & Muller 1958]
    pub(super) fn normal(&mut self) -> f64 {
        if let Some(x) = self.spare.take() {
            return x;
        }
        let radius = (-2.0 * self.uniform().ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * self.uniform()).sin_cos();
        self.spare = Some(radius * sin);
        radius * cos
    }

    /// Exponential with a mean.
    pub(super) fn exponential(&mut self, mean: f64) -> f64 {
        -mean * self.uniform().ln()
    }

    /// A uniformly distributed direction.
    pub(super) fn direction(&mut self) -> nalgebra::Vector3<f64> {
        loop {
            let v = nalgebra::Vector3::from_fn(|_, _| self.normal());
            if v.norm() > 1e-6 {
                return v.normalize();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_streams_are_repeatable_and_distinct() {
        let first = |names: &[&str]| RandomStream::new(7, names).normal().to_bits();
        assert_eq!(first(&["1", "1.01", "mag_3_uc"]), first(&["1", "1.01", "mag_3_uc"]));
        assert_ne!(first(&["ab", "c"]), first(&["a", "bc"]));
        assert_ne!(RandomStream::new(7, &["a"]).normal(), RandomStream::new(8, &["a"]).normal());
    }

    #[test]
    fn law_normals_have_mean_0_and_variance_1() {
        let mut random = RandomStream::new(1, &["test"]);
        let x: Vec<f64> = (0..200_000).map(|_| random.normal()).collect();
        let mean = x.iter().sum::<f64>() / 2e5;
        let (variance, fourth) =
            (x.iter().map(|x| x * x).sum::<f64>() / 2e5, x.iter().map(|x| x.powi(4)).sum::<f64>() / 2e5);
        // The tolerances are five standard errors, which are 0.0022, 0.0032 and 0.022.
        assert!(mean.abs() < 0.011 && (variance - 1.0).abs() < 0.016 && (fourth - 3.0).abs() < 0.11);
    }
}
