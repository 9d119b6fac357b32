//! Random numbers that depend only on seed, purpose, step and particle.

use crate::random::SplitMix64;

/// State increment of SplitMix64 per draw.
const STRIDE: u64 = 0x9e37_79b9_7f4a_7c15;

/// Purpose of a draw.
#[derive(Clone, Copy, Debug)]
pub(super) enum DrawPurpose {
    Start = 1,
    Motion = 2,
    Resampling = 3,
    Kernel = 4,
    Roughening = 5,
}

/// Random numbers for one purpose at one step: a section of a SplitMix64 sequence, with random access in constant time.
#[derive(Clone, Copy, Debug)]
pub(super) struct ParticleDraws {
    key: u64,
}

impl ParticleDraws {
    pub(super) fn new(seed: u64, purpose: DrawPurpose, step: usize) -> Self {
        let of_purpose = SplitMix64::new(SplitMix64::new(seed).draw() ^ purpose as u64).draw();
        Self { key: SplitMix64::new(of_purpose ^ step as u64).draw() }
    }

    /// Two independent uniform numbers of a particle, above 0 and below 1.
    #[inline(always)]
    pub(super) fn uniforms(self, particle: usize) -> [f64; 2] {
        let mut bits = SplitMix64::new(self.key.wrapping_add((2 * particle as u64).wrapping_mul(STRIDE)));
        [uniform(bits.draw()), uniform(bits.draw())]
    }

    /// Two independent standard normal numbers of a particle. [Box & Muller 1958]
    #[inline(always)]
    pub(super) fn normals(self, particle: usize) -> [f64; 2] {
        let [a, b] = self.uniforms(particle);
        let radius = (-2.0 * a.ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * b).sin_cos();
        [radius * cos, radius * sin]
    }
}

#[inline(always)]
fn uniform(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1_u64 << 53) as f64 + 1.0 / (1_u64 << 54) as f64
}
