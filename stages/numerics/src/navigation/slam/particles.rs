//! Particles of the horizontal position errors. Given these, the other states of the error model are linear.

use crate::navigation::pinson::{LAT, LON, STATES, StateMatrix, StateVector};
use crate::navigation::transition::propagate_state;
use crate::random::{NormalGenerator, SplitMix64};
use rayon::prelude::*;

/// Number of particles per parallel task.
pub(super) const PIECE: usize = 64;

/// The second pivot is treated as rounding error if its ratio to the variance of its state is below this value. The two
/// position errors are then collinear.
const DEPENDENT: f64 = 1e-14;

/// Particles of the filter.
///
/// `x` contains both parts of the state of each particle: latitude and longitude, and the mean of the other 16 states
/// given the path of the particle. The covariance of these 16 states given the path, `linear`, is common to all
/// particles, because no matrix depends on the particle [Lee 2019, (20)]. Its rows and columns of latitude and
/// longitude are zero once the positions are drawn.
#[derive(Clone, Debug)]
pub struct SlamParticles {
    /// States, truth minus INS, in rad, m, m/s and so on.
    pub x: Vec<StateVector>,
    /// Weights, which add up to 1.
    pub weights: Vec<f64>,
    /// Covariance of the linear states.
    pub linear: StateMatrix,
    /// Whether each particle has revisited since the last resampling.
    pub active: Vec<bool>,
    seed: u64,
}

/// Mean and covariance of all states.
#[derive(Clone, Copy, Debug)]
pub struct SlamMoments {
    /// Mean.
    pub x: StateVector,
    /// Covariance.
    pub p: StateMatrix,
}

impl SlamMoments {
    /// Whether the mean is finite and no variance negative.
    pub fn are_sound(&self) -> bool {
        self.x.iter().all(|x| x.is_finite()) && (0..STATES).all(|state| self.p[state][state] >= 0.0)
    }
}

/// First two columns of the Cholesky factor of a covariance (latitude and longitude), and the covariance of the other
/// states given latitude and longitude.
///
/// With C = Φ P Φᵀ + Q this is the time update of the marginalised filter with every cross-covariance of the noise. The
/// upper two rows of the factor, multiplied by their transpose, are N of (28c). The lower rows times the draw are L (z
/// − A x) of (28a). The remainder is (28b). [Lee 2019, (27)-(29)]
fn known_positions(c: &StateMatrix) -> ([StateVector; 2], StateMatrix) {
    let mut factor = [[0.0; STATES]; 2];
    if c[LAT][LAT] > 0.0 {
        let pivot = c[LAT][LAT].sqrt();
        factor[0] = c[LAT].map(|entry| entry / pivot);
    }
    let along = factor[0][LON];
    let rest = c[LON][LON] - along * along;
    if rest > DEPENDENT * c[LON][LON] {
        let pivot = rest.sqrt();
        factor[1] = std::array::from_fn(|state| (c[LON][state] - factor[0][state] * along) / pivot);
        factor[1][LAT] = 0.0;
    }
    let mut left = [[0.0; STATES]; STATES];
    for row in LON + 1..STATES {
        for column in LON + 1..=row {
            let known = factor[0][row] * factor[0][column] + factor[1][row] * factor[1][column];
            let mut entry = c[row][column] - known;
            if row == column && entry < 0.0 && entry > -1e-9 * c[row][row] {
                entry = 0.0;
            }
            left[row][column] = entry;
            left[column][row] = entry;
        }
    }
    (factor, left)
}

/// Generator of the standard normal random numbers of a particle at a step. Draws are independent of the number and
/// order of threads.
fn normals_of(seed: u64, step: u64, particle: u64) -> NormalGenerator {
    NormalGenerator::new(key(seed, step).wrapping_add(particle.wrapping_mul(0xd134_2543_de82_ef95)))
}

fn key(seed: u64, step: u64) -> u64 {
    SplitMix64::new(SplitMix64::new(seed).draw() ^ step).draw()
}

impl SlamParticles {
    /// New particles without drawn positions: `linear` is the initial covariance of all states.
    pub fn new(count: usize, seed: u64, initial: &StateMatrix) -> Self {
        Self {
            x: vec![[0.0; STATES]; count],
            weights: vec![1.0 / count as f64; count],
            linear: *initial,
            active: vec![false; count],
            seed,
        }
    }

    /// Draws the positions from the covariance of all states, `linear`. Steps are counted from 0.
    pub fn draw(&mut self, step: u64) {
        let c = self.linear;
        self.spread(&c, |x| *x, step);
    }

    /// Time update without a draw of the positions. [`advance`](Self::advance) equals this function followed by
    /// [`draw`](Self::draw).
    pub fn shift(&mut self, phi: &StateMatrix, c: &StateMatrix) {
        self.x.par_chunks_mut(PIECE).for_each(|states| {
            for x in states {
                *x = propagate_state(phi, x);
            }
        });
        self.linear = *c;
    }

    /// Time update with the `phi` of a step and C = Φ P Φᵀ + Q, where P is the covariance of the linear states. Steps
    /// are counted from 1.
    pub fn advance(&mut self, phi: &StateMatrix, c: &StateMatrix, step: u64) {
        self.spread(c, |x| propagate_state(phi, x), step);
    }

    /// Propagates the states, draws the positions, and conditions the linear states on them.
    fn spread(&mut self, c: &StateMatrix, moved: impl Fn(&StateVector) -> StateVector + Sync, step: u64) {
        let (factor, left) = known_positions(c);
        self.linear = left;
        let seed = self.seed;
        self.x.par_chunks_mut(PIECE).enumerate().for_each(|(piece, states)| {
            for (place, x) in states.iter_mut().enumerate() {
                let mut normals = normals_of(seed, step, (piece * PIECE + place) as u64);
                let draws = [normals.draw(), normals.draw()];
                *x = moved(x);
                for (state, entry) in x.iter_mut().enumerate() {
                    *entry += factor[0][state] * draws[0] + factor[1][state] * draws[1];
                }
            }
        });
    }

    /// Draws the particles from a Gaussian kernel after a resampling. The width of the kernel is `width` standard
    /// deviations of the covariance `spread` about the mean before the resampling. [Musso, Oudjane & Le Gland 2001]
    ///
    /// The positions are drawn and contracted by √(1 − width²), which preserves their covariance [West 1993]. The
    /// linear states follow the positions by regression. The fraction `width`² of the conditional covariance of
    /// `spread`, given the positions, is added to the covariance given the path. Earlier paths do not change. Relative
    /// to the past of its particle, a position therefore jumps by a fraction of the particles' spread, which acts like
    /// additional process noise.
    pub fn regularise(&mut self, spread: &StateMatrix, mean: &StateVector, width: f64, step: u64) {
        let (factor, rest) = known_positions(spread);
        let over = |off: f64, root: f64| if root > 0.0 { off / root } else { 0.0 };
        let closer = (1.0 - width * width).sqrt();
        let seed = self.seed ^ 0x5851_f42d_4c95_7f2d;
        let expected = |at: [f64; 2]| -> StateVector {
            std::array::from_fn(|state| mean[state] + factor[0][state] * at[0] + factor[1][state] * at[1])
        };
        for (particle, x) in self.x.iter_mut().enumerate() {
            let north = over(x[LAT] - mean[LAT], factor[0][LAT]);
            let at = [north, over(x[LON] - mean[LON] - factor[0][LON] * north, factor[1][LON])];
            let mut normals = normals_of(seed, step, particle as u64);
            let to = at.map(|at| closer * at + width * normals.draw());
            let (here, there) = (expected(at), expected(to));
            *x = std::array::from_fn(|state| match state {
                LAT | LON => x[state] + there[state] - here[state],
                _ => there[state] + closer * (x[state] - here[state]),
            });
        }
        for (entry, rest) in self.linear.as_flattened_mut().iter_mut().zip(rest.as_flattened()) {
            *entry += width * width * rest;
        }
    }

    /// Weighted mean and covariance. [Lee 2019, (19), (24)]
    pub fn moments(&self) -> SlamMoments {
        let mut mean = [0.0; STATES];
        for (x, weight) in self.x.iter().zip(&self.weights) {
            for (mean, x) in mean.iter_mut().zip(x) {
                *mean += weight * x;
            }
        }
        let mut p = self.linear;
        for (x, weight) in self.x.iter().zip(&self.weights) {
            let apart: StateVector = std::array::from_fn(|state| x[state] - mean[state]);
            for (row, of_row) in p.iter_mut().zip(apart.map(|apart| apart * weight)) {
                for (entry, apart) in row.iter_mut().zip(apart) {
                    *entry += of_row * apart;
                }
            }
        }
        // The sums in both triangles are the same except for the order of two factors.
        let below = p;
        for (row, of_row) in below.iter().enumerate() {
            for (column, entry) in of_row.iter().enumerate().take(row) {
                p[column][row] = *entry;
            }
        }
        SlamMoments { x: mean, p }
    }

    /// Effective number of particles. [Lee 2019, (77)]
    pub fn effective(&self) -> f64 {
        1.0 / self.weights.iter().map(|weight| weight * weight).sum::<f64>()
    }

    /// Multiplies the weights by the exponentials of `log_likelihood`. Returns false without changes if no weight would
    /// remain.
    pub fn weigh(&mut self, log_likelihood: &[f64]) -> bool {
        let largest = log_likelihood.iter().zip(&self.weights).filter(|(_, weight)| **weight > 0.0);
        let largest = largest.map(|(log, _)| *log).fold(f64::NEG_INFINITY, f64::max);
        if !largest.is_finite() {
            return false;
        }
        let product = |(weight, log): (&f64, &f64)| weight * (log - largest).exp();
        let weights: Vec<f64> = self.weights.iter().zip(log_likelihood).map(product).collect();
        let sum: f64 = weights.iter().sum();
        // The comparison is also false for NaN.
        let sound = sum > 0.0 && sum.is_finite();
        if sound {
            self.weights = weights.into_iter().map(|weight| weight / sum).collect();
        }
        sound
    }

    /// Systematic resampling among the members; returns the parent of each particle. Afterwards members have equal
    /// weights and are no longer active. [Lee 2019, section 5.3.2.4]
    pub fn resample(&mut self, member: impl Fn(usize) -> bool, step: u64) -> Vec<u32> {
        let members: Vec<usize> = (0..self.x.len()).filter(|particle| member(*particle)).collect();
        let mut parents: Vec<u32> = (0..self.x.len() as u32).collect();
        let total: f64 = members.iter().map(|particle| self.weights[*particle]).sum();
        let share = total / members.len() as f64;
        let uniform = (key(self.seed ^ 0x632b_e59b_d9b4_e019, step) >> 11) as f64 / (1_u64 << 53) as f64;
        let (mut source, mut reached) = (0, members.first().map_or(0.0, |first| self.weights[*first]));
        for (place, particle) in members.iter().enumerate() {
            while reached <= share * (place as f64 + uniform) && source + 1 < members.len() {
                source += 1;
                reached += self.weights[members[source]];
            }
            parents[*particle] = members[source] as u32;
        }
        let before = self.x.clone();
        for particle in &members {
            self.x[*particle] = before[parents[*particle] as usize];
            self.weights[*particle] = share;
        }
        self.active.fill(false);
        parents
    }
}
