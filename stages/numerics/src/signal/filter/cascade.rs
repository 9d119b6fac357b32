//! Second-order sections run over the columns of a row-major matrix, forwards and backwards.
//!
//! The outer loop runs over time and the inner loop over columns. The columns fill the vector registers, whereas a
//! single recursive filter cannot be vectorised. The arithmetic of a column is always the same sequence of additions
//! and fused multiplications, so its result depends neither on the processor nor on the other columns.

use super::BiquadSection;

/// Number of columns that are filtered together: one cache line.
const LANES: usize = 8;

/// Number of sections that share one pass over the samples: the state of these sections fits into the registers.
const PER_PASS: usize = 4;

/// Number of values of a matrix that are read and filtered together. They fit into the second-level cache while the
/// groups of columns are processed one at a time.
const PER_CHUNK: usize = 16_384;

/// A gain, the sections of one pass, and their steady state for a constant input of 1.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct BiquadCascade {
    gain: f64,
    sections: Vec<BiquadSection>,
    steady: Vec<[f64; 2]>,
}

/// State of a section for up to eight columns: y = x − w0, w0 ← w1 − b1 x + a1 y, w1 ← a2 y − b2 x (transposed direct
/// form II with inverted signs).
type BiquadState = [[f64; LANES]; 2];

impl BiquadCascade {
    pub(super) fn new(gain: f64, sections: Vec<BiquadSection>) -> Self {
        let mut level = gain;
        let mut steady = Vec::with_capacity(sections.len());
        for section in &sections {
            let out = level * section.constant_gain();
            steady.push([level - out, section.a2 * out - section.b2 * level]);
            level = out;
        }
        Self { gain, sections, steady }
    }

    pub(super) fn gain(&self) -> f64 {
        self.gain
    }

    pub(super) fn sections(&self) -> &[BiquadSection] {
        &self.sections
    }

    /// Filters `pieces`, consecutive row-major parts of one matrix, from the first row to the last.
    pub(super) fn forwards(&self, columns: usize, pieces: [&mut [f64]; 3]) {
        pulp::Arch::new().dispatch(CascadeSweep::<false> { cascade: self, columns, pieces });
    }

    /// Filters `pieces`, in the order given, each from its last row to its first.
    pub(super) fn backwards(&self, columns: usize, pieces: [&mut [f64]; 3]) {
        pulp::Arch::new().dispatch(CascadeSweep::<true> { cascade: self, columns, pieces });
    }

    /// The steady state of every section for the first row of a sweep.
    fn start(&self, row: &[f64]) -> Vec<BiquadState> {
        let groups = row.chunks(LANES);
        groups
            .flat_map(|group| {
                self.steady.iter().map(move |steady| {
                    let mut state = [[0.0; LANES]; 2];
                    for (w, unit) in state.iter_mut().zip(steady) {
                        for (w, x) in w.iter_mut().zip(group) {
                            *w = x * unit;
                        }
                    }
                    state
                })
            })
            .collect()
    }
}

/// One sweep, compiled for the vector width of each processor.
struct CascadeSweep<'a, const BACKWARDS: bool> {
    cascade: &'a BiquadCascade,
    columns: usize,
    pieces: [&'a mut [f64]; 3],
}

impl<const BACKWARDS: bool> pulp::NullaryFnOnce for CascadeSweep<'_, BACKWARDS> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let columns = self.columns;
        let Some(piece) = self.pieces.iter().find(|piece| piece.len() >= columns) else {
            return;
        };
        let first = if BACKWARDS { piece.len() - columns } else { 0 };
        let mut states = self.cascade.start(&piece[first..first + columns]);
        let chunk = columns * (PER_CHUNK / columns).max(1);
        for piece in self.pieces {
            if BACKWARDS {
                for rows in piece.rchunks_mut(chunk) {
                    filter_chunk::<BACKWARDS>(self.cascade, rows, columns, &mut states);
                }
            } else {
                for rows in piece.chunks_mut(chunk) {
                    filter_chunk::<BACKWARDS>(self.cascade, rows, columns, &mut states);
                }
            }
        }
    }
}

/// Runs all sections over some rows, eight columns at a time, and the remaining columns four, two and one at a time.
#[inline(always)]
fn filter_chunk<const BACKWARDS: bool>(
    cascade: &BiquadCascade,
    rows: &mut [f64],
    columns: usize,
    states: &mut [BiquadState],
) {
    for (group, states) in states.chunks_exact_mut(cascade.sections.len()).enumerate() {
        let mut lane = 0;
        while lane < LANES.min(columns - group * LANES) {
            let at = ColumnLanes { columns, column: group * LANES + lane, lane };
            lane += match LANES.min(columns - group * LANES) - lane {
                8 => filter_lanes::<BACKWARDS, 8>(cascade, rows, at, states),
                4..8 => filter_lanes::<BACKWARDS, 4>(cascade, rows, at, states),
                2..4 => filter_lanes::<BACKWARDS, 2>(cascade, rows, at, states),
                _ => filter_lanes::<BACKWARDS, 1>(cascade, rows, at, states),
            };
        }
    }
}

/// Position of a group of columns in a row, and in the lanes of the group's state.
#[derive(Clone, Copy)]
struct ColumnLanes {
    columns: usize,
    column: usize,
    lane: usize,
}

/// Runs all sections over `W` columns, and returns `W`.
#[inline(always)]
fn filter_lanes<const BACKWARDS: bool, const W: usize>(
    cascade: &BiquadCascade,
    rows: &mut [f64],
    at: ColumnLanes,
    states: &mut [BiquadState],
) -> usize {
    let mut gain = cascade.gain;
    let mut done = 0;
    while done < cascade.sections.len() {
        let (sections, states) = (&cascade.sections[done..], &mut states[done..]);
        done += match sections.len() {
            1 => pass::<BACKWARDS, W, 1>(gain, sections, rows, at, states),
            2..PER_PASS => pass::<BACKWARDS, W, 2>(gain, sections, rows, at, states),
            _ => pass::<BACKWARDS, W, PER_PASS>(gain, sections, rows, at, states),
        };
        gain = 1.0;
    }
    W
}

/// Runs the first `K` of the sections over `W` columns, and returns `K`.
#[inline(always)]
fn pass<const BACKWARDS: bool, const W: usize, const K: usize>(
    gain: f64,
    sections: &[BiquadSection],
    rows: &mut [f64],
    at: ColumnLanes,
    states: &mut [BiquadState],
) -> usize {
    let mut bank = [BiquadSection::PASS; K];
    bank.copy_from_slice(&sections[..K]);
    let mut local = [[[0.0; W]; 2]; K];
    for (local, state) in local.iter_mut().zip(states.iter()) {
        for (local, state) in local.iter_mut().zip(state) {
            local.copy_from_slice(&state[at.lane..at.lane + W]);
        }
    }
    if bank.iter().all(BiquadSection::is_band) {
        run::<BACKWARDS, true, W, K>(gain, &bank, rows, at, &mut local);
    } else {
        run::<BACKWARDS, false, W, K>(gain, &bank, rows, at, &mut local);
    }
    for (local, state) in local.iter().zip(states) {
        for (local, state) in local.iter().zip(state) {
            state[at.lane..at.lane + W].copy_from_slice(local);
        }
    }
    K
}

#[inline(always)]
fn run<const BACKWARDS: bool, const BAND: bool, const W: usize, const K: usize>(
    gain: f64,
    bank: &[BiquadSection; K],
    rows: &mut [f64],
    at: ColumnLanes,
    state: &mut [[[f64; W]; 2]; K],
) {
    // Loops, not closures: a closure would be compiled without the vector instructions.
    if BACKWARDS {
        for row in rows.rchunks_exact_mut(at.columns) {
            step::<BAND, W, K>(&mut row[at.column..], gain, bank, state);
        }
    } else {
        for row in rows.chunks_exact_mut(at.columns) {
            step::<BAND, W, K>(&mut row[at.column..], gain, bank, state);
        }
    }
}

/// Passes one sample through `K` sections. With `BAND`, b1 = 0 and b2 = −1 in all sections; three operations then
/// replace five and give bit-identical results.
#[inline(always)]
fn step<const BAND: bool, const W: usize, const K: usize>(
    row: &mut [f64],
    gain: f64,
    bank: &[BiquadSection; K],
    state: &mut [[[f64; W]; 2]; K],
) {
    let Some(row) = row.first_chunk_mut::<W>() else {
        return;
    };
    let mut x = *row;
    for x in &mut x {
        *x *= gain;
    }
    for (section, [w0, w1]) in bank.iter().zip(state.iter_mut()) {
        for lane in 0..W {
            let input = x[lane];
            let output = input - w0[lane];
            let (first, second) =
                if BAND { (w1[lane], input) } else { ((-section.b1).mul_add(input, w1[lane]), -section.b2 * input) };
            w0[lane] = section.a1.mul_add(output, first);
            w1[lane] = section.a2.mul_add(output, second);
            x[lane] = output;
        }
    }
    *row = x;
}
