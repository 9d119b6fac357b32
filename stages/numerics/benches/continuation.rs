//! Upward continuation of a map of 3195 x 7279 nodes, padded to 3840 x 8748.
//!
//! `cargo bench -p magline-numerics --bench continuation --profile dev` prints the fastest of several runs on one and
//! on two threads, and the peak memory of the process. It checks the result against the closed form of the field and
//! against the nodes of `continuation_harmonica.py` for the same padded map. That script prints its own times and the
//! ratio.

use std::time::Instant;

use numerics::maps::{
    continuation::{EdgeExtension, MapSpectrum, Padding, PaddingWidth, TrendRemoval, upward},
    plane_grid::{EvenAxis, PlaneGrid},
};
use rayon::prelude::*;

type Failure = Box<dyn std::error::Error + Send + Sync>;

const ROWS: usize = 3195;
const COLUMNS: usize = 7279;
const PADDED: [usize; 2] = [3840, 8748];
const STEP_M: f64 = 50.0;
const UP_M: f64 = 300.0;
/// Number of repetitions, as in the Python script. This bench and the script report the fastest run, which is the least
/// disturbed.
const REPEATS: usize = 7;

/// Nodes computed by harmonica, written by `continuation_harmonica.py --write`.
const REFERENCE: &str = include_str!("../reference/maps/continuation/harmonica_bench.csv");

/// Sources of `continuation_harmonica.py`: east, north, depth in metres and strength in nT. Each makes `strength
/// (depth/r)³` at `r` metres; z/r³ is the field of a pole, a harmonic function.
const SOURCES: [[f64; 4]; 6] = [
    [60_000.0, 40_000.0, 700.0, 300.0],
    [150_000.0, 90_000.0, 1500.0, -200.0],
    [210_000.0, 30_000.0, 4000.0, 250.0],
    [300_000.0, 120_000.0, 900.0, -350.0],
    [330_000.0, 60_000.0, 2500.0, 150.0],
    [90_000.0, 130_000.0, 600.0, 400.0],
];

/// The sum of strength d² (z + d)/r³ at a height z above the map.
fn field_nt(east: f64, north: f64, up: f64) -> f64 {
    SOURCES
        .iter()
        .map(|[e, n, depth, strength]| {
            let z = up + depth;
            let square = (east - e).powi(2) + (north - n).powi(2) + z * z;
            strength * depth * depth * z / (square * square.sqrt())
        })
        .sum()
}

fn map() -> PlaneGrid {
    let axis = |len| EvenAxis { first: 0.0, step: STEP_M, len };
    let mut values = vec![0.0; ROWS * COLUMNS];
    values.par_chunks_mut(COLUMNS).enumerate().for_each(|(row, line)| {
        for (column, value) in line.iter_mut().enumerate() {
            *value = field_nt(STEP_M * column as f64, STEP_M * row as f64, 0.0);
        }
    });
    PlaneGrid { east_m: axis(COLUMNS), north_m: axis(ROWS), values }
}

/// Peak memory of the process, in bytes; `None` if the system does not report the memory.
fn most_memory() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM"))?;
    line.split_whitespace().nth(1)?.parse::<f64>().ok().map(|kilobytes| 1024.0 * kilobytes)
}

/// The largest difference from harmonica's nodes, in nT.
fn from_harmonica(answer: &PlaneGrid) -> Result<f64, Failure> {
    let mut worst = 0.0_f64;
    let mut nodes = 0;
    for line in REFERENCE.lines().filter(|line| !line.starts_with('#')).skip(1) {
        let fields: Vec<f64> = line.split(',').map(str::parse).collect::<Result<_, _>>()?;
        let [row, column, value] = fields[..] else { return Err("a row of the reference is not three numbers".into()) };
        worst = worst.max((answer.get(row as usize, column as usize) - value).abs());
        nodes += 1;
    }
    if nodes < 50 { Err(format!("only {nodes} nodes in the reference").into()) } else { Ok(worst) }
}

/// Largest difference from the closed form, relative to the largest value of the field, at least 2 km from the edges.
fn from_closed_form(answer: &PlaneGrid) -> f64 {
    let (mut worst, mut largest) = (0.0_f64, 0.0_f64);
    for row in (40..ROWS - 40).step_by(3) {
        for column in (40..COLUMNS - 40).step_by(3) {
            let exact = field_nt(STEP_M * column as f64, STEP_M * row as f64, UP_M);
            largest = largest.max(exact.abs());
            worst = worst.max((answer.get(row, column) - exact).abs());
        }
    }
    worst / largest
}

/// Time of the fastest of several runs in seconds, and the last result.
fn timed<T>(run: impl Fn() -> Result<T, Failure>) -> Result<(f64, T), Failure> {
    let mut fastest = f64::INFINITY;
    let mut answer = None;
    for _ in 0..REPEATS {
        drop(answer.take());
        let clock = Instant::now();
        answer = Some(run()?);
        fastest = fastest.min(clock.elapsed().as_secs_f64());
    }
    Ok((fastest, answer.ok_or("no run")?))
}

fn main() -> Result<(), Failure> {
    let map = map();
    let zeros = Padding {
        width: PaddingWidth::Nodes([(PADDED[0] - ROWS) / 2, (PADDED[1] - COLUMNS) / 2]),
        edge: EdgeExtension::Zero,
        trend: TrendRemoval::None,
        ..Padding::default()
    };
    let layout = zeros.layout(&map, UP_M)?;
    if [layout.rows.padded, layout.columns.padded] != PADDED {
        return Err(format!("padded to {layout:?}").into());
    }
    let copy = (8 * layout.nodes()) as f64;
    let before = most_memory();
    let first = upward(&map, UP_M, &zeros)?;
    if let (Some(before), Some(most)) = (before, most_memory()) {
        println!(
            "memory of the map alone {:.2}, of all at its most {:.2} copies of the padded map",
            before / copy,
            most / copy
        );
        if most > 4.0 * copy {
            return Err("more than four copies of the padded map".into());
        }
    }
    let apart = from_harmonica(&first)?;
    println!(
        "largest difference from harmonica {apart:.1e} nT, from the closed form {:.1e} of the largest value",
        from_closed_form(&first)
    );
    // 1e-9: sums of 3e7 terms in double precision. 0.01: required accuracy away from the edges.
    if apart > 1e-9 || from_closed_form(&first) > 0.01 {
        return Err("the answer is wrong".into());
    }
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let (zeros_s, same) = timed(|| Ok(pool.install(|| upward(&map, UP_M, &zeros))?))?;
        if same != first {
            return Err("the answer depends on the number of threads".into());
        }
        let (default_s, _) = timed(|| Ok(pool.install(|| upward(&map, UP_M, &Padding::default()))?))?;
        println!(
            "threads {threads}: {:.1} ms padded by zeros, {:.1} ms padded by default",
            zeros_s * 1e3,
            default_s * 1e3
        );
        let (spectrum_s, spectrum) = timed(|| Ok(pool.install(|| MapSpectrum::new(&map, UP_M, &zeros))?))?;
        let (level_s, _) = timed(|| Ok(pool.install(|| spectrum.at_height(UP_M, 0.0))?))?;
        println!("  a spectrum {:.1} ms, each level from it {:.1} ms", spectrum_s * 1e3, level_s * 1e3);
    }
    Ok(())
}
