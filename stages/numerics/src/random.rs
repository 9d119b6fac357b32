//! Reproducible random numbers: SplitMix64 [Steele, Lea & Flood 2014], and standard normals by Box and Muller.

/// A reproducible source of uniform bits.
#[derive(Clone, Debug)]
pub struct SplitMix64 {
    state: u64,
}

impl SplitMix64 {
    /// A source for each seed. Adjacent seeds give unrelated numbers.
    pub fn new(seed: u64) -> Self {
        Self { state: seed }
    }

    /// The next 64 bits.
    pub fn draw(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mixed(self.state)
    }
}

/// A reproducible source of standard normals.
pub struct Normals {
    bits: SplitMix64,
    spare: Option<f64>,
}

impl Normals {
    /// A source for each seed.
    pub fn new(seed: u64) -> Self {
        // Adjacent seeds must not give the same sequence shifted by one.
        Self { bits: SplitMix64::new(mixed(seed ^ 0x5851_f42d_4c95_7f2d)), spare: None }
    }

    /// The next number between 0 (excluded) and 1.
    fn uniform(&mut self) -> f64 {
        (self.bits.draw() >> 11) as f64 / (1_u64 << 53) as f64 + 1.0 / (1_u64 << 54) as f64
    }

    /// The next standard normal.
    pub fn draw(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        let radius = (-2.0 * self.uniform().ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * self.uniform()).sin_cos();
        self.spare = Some(radius * sin);
        radius * cos
    }
}

fn mixed(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
