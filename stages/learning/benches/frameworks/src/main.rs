//! Benchmark of `../networks.rs` in candle: a network of 77 inputs, 8 units with swish and one output, 400,000 samples
//! reshuffled in every epoch, batches of 2048, Adam, mean squared error.
//!
//! `cargo run --release` runs `../networks.rs`, then candle in single and double precision, on one and on two threads.
//! For each case it prints the wall-clock time and the processor time of an epoch in ms, their ratios to magline in
//! double precision, and whether one and two threads give bit-identical weights. `cargo run --release -- PROGRAM` runs
//! that program instead of building the bench. Each case asserts that the loss falls. Each case runs in a separate
//! process, because the number of threads is a setting of the process.

use std::{process::Command, time::Instant};

mod in_candle;

type Failure = Box<dyn std::error::Error>;

const FRAMEWORKS: [&str; 1] = ["candle"];
const ROWS: usize = 400_000;
const INPUTS: usize = 77;
const HIDDEN: usize = 8;
const BATCH: usize = 2048;
const EPOCHS: usize = 5;

/// Input of a framework.
struct Work {
    /// Inputs, row-major.
    x: Vec<f64>,
    y: Vec<f64>,
    /// First weights of the hidden layer, `INPUTS` rows of `HIDDEN`.
    hidden: Vec<f64>,
    /// First weights of the output.
    output: Vec<f64>,
    /// The order of the samples in each epoch.
    orders: Vec<Vec<u32>>,
}

/// Callback after each epoch with the mean loss over its batches.
type Each<'a> = &'a mut dyn FnMut(f64);

fn main() -> Result<(), Failure> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    match words.as_slice() {
        [framework, precision] => one(framework, precision == "f64"),
        [program] => all(Command::new(program)),
        _ => {
            let mut cargo = Command::new("cargo");
            let learning = concat!(env!("CARGO_MANIFEST_DIR"), "/../../Cargo.toml");
            cargo.args(["bench", "--manifest-path", learning, "--bench", "networks", "--profile", "dev"]);
            all(cargo)
        }
    }
}

/// Runs every case in a separate process, after the bench of magline.
fn all(mut bench: Command) -> Result<(), Failure> {
    let output = bench.output()?;
    if !output.status.success() {
        return Err(format!("the bench of magline failed: {}", String::from_utf8_lossy(&output.stderr)).into());
    }
    let printed = String::from_utf8(output.stdout)?;
    let ours = [magline(&printed, 1)?, magline(&printed, 2)?];
    println!(
        "{ROWS} samples of {INPUTS} inputs, batches of {BATCH}; the fastest of {} epochs: clock, processors",
        EPOCHS - 1
    );
    for (threads, [clock_ms, processors_ms]) in (1..).zip(&ours) {
        println!("magline f64, {threads} threads: {clock_ms:.1} ms, {processors_ms:.1} ms");
    }
    for precision in ["f32", "f64"] {
        let mut losses = vec![];
        for framework in FRAMEWORKS {
            let cases = [case(framework, precision, "1")?, case(framework, precision, "2")?];
            for (threads, (case, base)) in (1..).zip(cases.iter().zip(&ours)) {
                let BenchResult { clock_ms, processors_ms, loss, .. } = case;
                let (clock, processors) = (clock_ms / base[0], processors_ms / base[1]);
                println!(
                    "{framework} {precision}, {threads} threads: {clock_ms:.1} ms, {processors_ms:.1} ms; {clock:.1} \
                     and {processors:.1} times magline; loss {loss:.5}"
                );
                losses.push(*loss);
            }
            let same = if cases[0].bits == cases[1].bits { "the same" } else { "other" };
            println!("{framework} {precision}: {same} bits on one and two threads");
        }
        assert!(losses.iter().all(|loss| (loss / losses[0] - 1.0).abs() < 0.01), "the frameworks disagree: {losses:?}");
    }
    Ok(())
}

/// Wall-clock time and processor time of magline for `m1` with one hidden layer of 8 units, in milliseconds.
fn magline(printed: &str, threads: usize) -> Result<[f64; 2], Failure> {
    let row = format!("m1 [8], {threads} threads: ");
    let found = printed.lines().find_map(|line| line.strip_prefix(&row)).and_then(|times| {
        let mut times = times.split(", ").map(|time| time.trim_end_matches(" ms").parse());
        Some([times.next()?.ok()?, times.next()?.ok()?])
    });
    found.ok_or_else(|| format!("the bench of magline printed {printed}").into())
}

/// Printed output of a case.
struct BenchResult {
    clock_ms: f64,
    processors_ms: f64,
    loss: f64,
    bits: String,
}

fn case(framework: &str, precision: &str, threads: &str) -> Result<BenchResult, Failure> {
    let mut command = Command::new(std::env::current_exe()?);
    let output = command.args([framework, precision]).env("RAYON_NUM_THREADS", threads).output()?;
    let printed = String::from_utf8(output.stdout)?;
    if !output.status.success() {
        return Err(format!("{framework} failed: {}", String::from_utf8_lossy(&output.stderr)).into());
    }
    let fields: Vec<&str> = printed.split_whitespace().collect();
    let [clock, processors, loss, bits] = fields[..] else {
        return Err(format!("{framework} printed {printed}").into());
    };
    Ok(BenchResult {
        clock_ms: clock.parse()?,
        processors_ms: processors.parse()?,
        loss: loss.parse()?,
        bits: bits.to_owned(),
    })
}

/// Trains once and prints wall-clock time, processor time, the last loss, and a hash of the trained weights.
fn one(framework: &str, double: bool) -> Result<(), Failure> {
    let work = work();
    let mut times: Vec<(f64, f64)> = vec![];
    let mut losses = vec![];
    let mut before = (Instant::now(), processors());
    let mut each = |loss: f64| {
        let now = (Instant::now(), processors());
        times.push((now.0.duration_since(before.0).as_secs_f64(), now.1 - before.1));
        losses.push(loss);
        before = (Instant::now(), processors());
    };
    let weights = match framework {
        "candle" => in_candle::train(&work, double, &mut each)?,
        other => return Err(format!("no framework is called {other}").into()),
    };
    assert!(losses.windows(2).all(|pair| pair[1] < pair[0]), "the loss does not fall: {losses:?}");
    let least = |of: fn(&(f64, f64)) -> f64| times.iter().skip(1).map(of).fold(f64::INFINITY, f64::min) * 1e3;
    let bits = weights.iter().fold(0_u64, |sum, w| sum.wrapping_mul(0x0100_0000_01b3).wrapping_add(w.to_bits()));
    let last = losses.last().copied().unwrap_or(f64::NAN);
    println!("{:.2} {:.2} {last:.6} {bits:016x}", least(|t| t.0), least(|t| t.1));
    Ok(())
}

fn work() -> Work {
    let mut draws = Draws(1);
    let x: Vec<f64> = (0..ROWS * INPUTS).map(|_| draws.normal()).collect();
    let y = x.chunks_exact(INPUTS).map(|x| 0.5 * x[0] * x[1] + (1.5 * x[2]).sin() + 0.2 * x[3]).collect();
    let size = (1.0 / INPUTS as f64).sqrt();
    let hidden = (0..INPUTS * HIDDEN).map(|_| size * draws.normal()).collect();
    let output = (0..HIDDEN).map(|_| 0.3 * draws.normal()).collect();
    let mut order: Vec<u32> = (0..ROWS as u32).collect();
    let orders = (0..EPOCHS).map(|_| {
        (1..ROWS).rev().for_each(|last| order.swap(last, (draws.bits() % (last as u64 + 1)) as usize));
        order.clone()
    });
    let orders = orders.collect();
    Work { x, y, hidden, output, orders }
}

/// SplitMix64 generator, with normal numbers by the method of Box and Muller.
struct Draws(u64);

impl Draws {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn normal(&mut self) -> f64 {
        let mut uniform = || ((self.bits() >> 11) as f64 + 0.5) * 2.0_f64.powi(-53);
        let (radius, angle) = ((-2.0 * uniform().ln()).sqrt(), std::f64::consts::TAU * uniform());
        radius * angle.cos()
    }
}

/// Processor time of all threads, in seconds; NaN if the system does not report it.
fn processors() -> f64 {
    let of = |task: std::fs::DirEntry| -> Option<f64> {
        let schedstat = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        schedstat.split_whitespace().next()?.parse().ok()
    };
    std::fs::read_dir("/proc/self/task").map_or(f64::NAN, |tasks| tasks.flatten().filter_map(of).sum::<f64>() * 1e-9)
}
