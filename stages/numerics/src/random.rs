//! Reproducible random numbers: SplitMix64 [Steele, Lea & Flood 2014], and standard normals by Box and Muller.

/// A reproducible source of uniform bits.
#[derive(Clone, Debug)]
pub struct SplitMix64 {
    state: u64,
}

impl SplitMix64 {
    /// Creates a source from a seed. Adjacent seeds give unrelated numbers.
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
pub struct NormalGenerator {
    bits: SplitMix64,
    spare: Option<f64>,
}

impl NormalGenerator {
    /// Creates a source from a seed.
    pub fn new(seed: u64) -> Self {
        // Adjacent seeds must not give the same sequence shifted by one number.
        Self { bits: SplitMix64::new(mixed(seed ^ 0x5851_f42d_4c95_7f2d)), spare: None }
    }

    /// The next uniform number between 0 (excluded) and 1.
    fn uniform(&mut self) -> f64 {
        (self.bits.draw() >> 11) as f64 / (1_u64 << 53) as f64 + 1.0 / (1_u64 << 54) as f64
    }

    /// The next standard normal number.
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

/// Seed for a list of names (such as flight and line), derived from a common seed. Each flight and line therefore has
/// its own random numbers, independent of other lines and of the order of drawing.
pub fn seed_of(seed: u64, names: &[&str]) -> u64 {
    names.iter().fold(mixed(seed ^ 0x2545_f491_4f6c_dd1d), |state, name| {
        // The length distinguishes ("ab", "c") from ("a", "bc").
        let state = mixed(state ^ name.len() as u64);
        name.bytes().fold(state, |state, byte| mixed(state.wrapping_add(0x9e37_79b9_7f4a_7c15) ^ u64::from(byte)))
    })
}

fn mixed(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_different_names_have_different_seeds() {
        let all = [
            seed_of(0, &["1", "1.01"]),
            seed_of(0, &["1", "1.02"]),
            seed_of(1, &["1", "1.01"]),
            seed_of(0, &["1.01", "1"]),
            seed_of(0, &["11", ".01"]),
            seed_of(0, &["1", "1.01", ""]),
            seed_of(0, &[]),
        ];
        assert!((0..all.len()).all(|i| all[..i].iter().all(|other| *other != all[i])), "{all:?}");
        assert_eq!(seed_of(3, &["1003", "1003.02"]), seed_of(3, &["1003", "1003.02"]));
        // Bits of adjacent lines agree by chance: 32 of 64 on average, within 4 standard deviations.
        let same = (0..200).map(|k| (seed_of(k, &["1"]) ^ seed_of(k, &["2"])).count_ones()).sum::<u32>();
        assert!((f64::from(same) / 200.0 - 32.0).abs() < 4.0 * 4.0 / 200f64.sqrt(), "{same}");
    }
}
