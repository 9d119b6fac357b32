//! Linear models of 432,000 samples (12 hours at 10 Hz in 24 lines) x 60 terms: the factor of each line, a path of 100
//! elastic nets, cross-validation of the path by line, 100 ridges, all numbers of components of partial least squares.
//!
//! `cargo bench -p magline-numerics --bench models --profile dev` prints the fastest of several runs. It checks the
//! coefficients against those of `models_sklearn.py --write` for the same input. That script prints its own times.

use std::time::Instant;

use numerics::regression::{
    choose_lambda,
    elastic_net::ElasticNetOptions,
    least_squares::{ColumnScaling, LineScoreMeasure, RegressionMoments},
    pls,
};
use rayon::prelude::*;

type Failure = Box<dyn std::error::Error + Send + Sync>;

const LINES: usize = 24;
const ROWS: usize = 18_000;
const TERMS: usize = 60;
const REPEATS: usize = 5;
const REFERENCE: &str = include_str!("../reference/models/bench.csv");

/// The line of `models_sklearn.py`: terms that share six waves, and a target of every seventh term.
fn line(number: usize) -> (Vec<f64>, Vec<f64>) {
    let wave = |k: usize, j: usize| (k as f64 * (0.013 + 0.0171 * (j % 6) as f64) + 0.37 * (j % 6) as f64).sin();
    let own = |k: usize, j: usize| (k as f64 * (0.05 + 0.0237 * j as f64) + 1.3 * j as f64).sin();
    let mut a = Vec::with_capacity(ROWS * TERMS);
    let mut y = Vec::with_capacity(ROWS);
    for row in 0..ROWS {
        let k = number * ROWS + row;
        a.extend((0..TERMS).map(|j| wave(k, j) + 0.2 * own(k, j)));
        let terms = &a[row * TERMS..];
        let signal: f64 = terms.iter().step_by(7).enumerate().map(|(j, x)| (j as f64 - 3.0) * x).sum();
        y.push(signal + 0.5 * (2.1 * k as f64).sin() + 0.1 * (k as f64 * k as f64 * 1e-4).sin());
    }
    (a, y)
}

fn timed<T>(name: &str, work: impl Fn() -> Result<T, Failure>) -> Result<T, Failure> {
    let mut least = f64::INFINITY;
    let mut answer = None;
    for _ in 0..REPEATS {
        let clock = Instant::now();
        answer = Some(work()?);
        least = least.min(clock.elapsed().as_secs_f64());
    }
    println!("{name}: {:.2} ms", least * 1e3);
    answer.ok_or_else(|| "no run".into())
}

fn main() -> Result<(), Failure> {
    let lines: Vec<(Vec<f64>, Vec<f64>)> = (0..LINES).into_par_iter().map(line).collect();
    println!("{} samples in {LINES} lines, {TERMS} terms", LINES * ROWS);
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        println!("threads {threads}");
        pool.install(|| run(&lines))?;
    }
    Ok(())
}

fn run(lines: &[(Vec<f64>, Vec<f64>)]) -> Result<(), Failure> {
    let moments = timed("factor of every line", || {
        Ok(lines
            .par_iter()
            .map(|(a, y)| RegressionMoments::from_matrix(a, TERMS, &[y]))
            .collect::<Result<Vec<_>, _>>()?)
    })?;
    let all = timed("lines merged", || Ok(RegressionMoments::merged(&moments)?))?;
    let net = ElasticNetOptions { l1_ratio: 0.9, ..ElasticNetOptions::default() };
    let alphas = net.alphas(&all, 0, 100, 1e-3)?;
    let path = timed("elastic net, path of 100", || Ok(net.path(&all, 0, &alphas)?))?;
    let scores = |alphas: &[f64]| Ok(net.choose(&moments, 0, alphas, LineScoreMeasure::MeanSquare)?);
    timed("elastic net, path of 100 with every line left out", || scores(&alphas))?;
    let lambdas = choose_lambda::grid(1e-3, 1e5, 100)?;
    let ridges = |lambdas: &[f64]| {
        let by_line = choose_lambda::by_lines(
            &moments,
            0,
            lambdas,
            ColumnScaling::Standardise,
            true,
            LineScoreMeasure::MeanSquare,
        );
        Ok(by_line?)
    };
    timed("ridge, 1 lambda with every line left out", || ridges(&lambdas[..1]))?;
    timed("ridge, 100 lambdas with every line left out", || ridges(&lambdas))?;
    timed("partial least squares, 1 to 20 components", || Ok(pls::fit(&all, &[0], 20, ColumnScaling::Standardise)?))?;
    check(&path.iter().map(|fit| fit.fit.coefficients.clone()).collect::<Vec<_>>(), &alphas)
}

/// Checks both ends of the path. A duality gap of 1e-10 of the target's square determines coefficients of standardised
/// terms to some 1e-5.
fn check(path: &[Vec<f64>], alphas: &[f64]) -> Result<(), Failure> {
    let mut worst = 0.0f64;
    for text in REFERENCE.lines().filter(|text| !text.starts_with('#')) {
        let fields: Vec<f64> = text.split(',').map(str::parse).collect::<Result<_, _>>()?;
        let [place, alpha, theirs @ ..] = fields.as_slice() else { return Err("a row is too short".into()) };
        let place = *place as usize;
        worst = worst.max((alphas[place] / alpha - 1.0).abs());
        let scale = theirs.iter().fold(0.0f64, |scale, b| scale.max(b.abs()));
        let pairs = path[place].iter().zip(theirs);
        worst = pairs.fold(worst, |worst, (ours, theirs)| worst.max((ours - theirs).abs() / scale.max(1e-3)));
    }
    println!("largest difference from scikit-learn {worst:.1e} of the largest coefficient");
    if worst < 1e-4 { Ok(()) } else { Err(format!("coefficients differ from scikit-learn's by {worst:e}").into()) }
}
