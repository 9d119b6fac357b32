//! Training and prediction of 200 boosted trees of up to 31 leaves on 200,000 samples of 77 columns.
//!
//! `cargo bench -p magline-learning --bench trees --profile dev` prints the times on one and on two threads and checks
//! the errors against those of scikit-learn for the same input. `trees.py` prints the times and errors of scikit-learn.
//!
//! Two cores of an AMD EPYC shared with other work, scikit-learn 1.9.1:
//!
//! | | training, 1 thread | 2 threads | prediction of all rows, 1 thread | 2 threads |
//! |---|---|---|---|---|
//! | magline | 6.6 s | 3.8 s | 0.66 s | 0.35 s |
//! | `HistGradientBoostingRegressor` | 10.9 s | 5.1 s | 3.6 s | 1.7 s |

use std::{ops::ControlFlow, time::Instant};

use learning::trees::{BoostingSettings, boost};

type Failure = Box<dyn std::error::Error + Send + Sync>;

const ROWS: usize = 200_000;
const AHEAD: usize = 20_000;
const WIDTH: usize = 77;

/// Mean square errors from `trees.py` with scikit-learn 1.9.1: training rows, then the rows after them.
const THEIRS: [f64; 2] = [0.222_15, 0.237_81];

/// The same rows as in `trees.py`.
fn rows(first: usize, count: usize) -> (Vec<f64>, Vec<f64>) {
    let wave = |k: f64, j: f64| (k * (0.000_13 + 0.000_171 * j) + 0.37 * j).sin() + 0.2 * (k * (1.7 + 0.31 * j)).sin();
    let x: Vec<f64> = (first..first + count).flat_map(|k| (0..WIDTH).map(move |j| wave(k as f64, j as f64))).collect();
    let y = x.chunks(WIDTH).enumerate().map(|(i, x)| {
        let k = (first + i) as f64;
        let bent = 5.0 * (3.0 * x[2]).tanh() + 4.0 * x[3].abs() + x[4] * x[5] + 2.0 * x[40] * (x[60] + 0.3);
        10.0 * x[0] + bent + 0.5 * (k * k * 0.37).sin()
    });
    let y = y.collect();
    (x, y)
}

fn main() -> Result<(), Failure> {
    let ((x, y), (ahead, truth)) = (rows(0, ROWS), rows(ROWS, AHEAD));
    println!("{ROWS} samples of {WIDTH} columns, 200 trees of up to 31 leaves");
    let mut errors = vec![];
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let clock = Instant::now();
        let mut first = 0.0;
        let boosted = pool.install(|| {
            boost(&x, WIDTH, &y, &BoostingSettings::default(), None, &mut |n, _, _| {
                if n == 1 {
                    first = clock.elapsed().as_secs_f64();
                }
                ControlFlow::Continue(())
            })
        })?;
        let trained = clock.elapsed().as_secs_f64();
        let clock = Instant::now();
        let found = pool.install(|| boosted.forest.predict(&x, WIDTH));
        let predicted = clock.elapsed().as_secs_f64();
        let ours = pool.install(|| boosted.forest.predict(&ahead, WIDTH));
        errors = vec![mse(&found, &y), mse(&ours, &truth)];
        println!(
            "threads {threads}: training {trained:.2} s (bins and first tree {first:.2} s), prediction {predicted:.2} s"
        );
    }
    println!("mean square errors {errors:.4?}, scikit-learn {THEIRS:.4?}");
    // The two programs place bin edges differently, and their numbers of bins differ by one.
    if errors.iter().zip(THEIRS).all(|(a, b)| (a / b - 1.0).abs() < 0.05) {
        Ok(())
    } else {
        Err("errors differ".into())
    }
}

fn mse(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64
}
