use nalgebra::{Cholesky, DMatrix, DVector};

use super::*;
use crate::navigation::slam::CovarianceFunction;
use crate::random::NormalGenerator;

fn kernel(covariance: CovarianceFunction) -> AnomalyKernel {
    AnomalyKernel { covariance, sigma_se_nt: 40.0, length_m: 600.0, sigma_n_nt: 1.0 }
}

fn fixed(kernel: AnomalyKernel) -> TrackMapParameters {
    TrackMapParameters {
        kernel,
        hyperparameters: HyperparameterSource::Fixed,
        temporal: (0.0, 600.0),
        line_sigma_nt: 0.0,
        most_functions: 4000,
    }
}

/// Field with the covariance of a kernel: waves with the directions and wavenumbers of the spectral density of the
/// kernel.
struct Field(Vec<[f64; 4]>);

impl Field {
    fn drawn(kernel: &AnomalyKernel, seed: u64) -> Self {
        let mut normals = NormalGenerator::new(seed);
        let count = 3000;
        let wave = |_| {
            let freedom = match kernel.covariance {
                CovarianceFunction::Matern52 => 5,
                CovarianceFunction::Matern32 => 3,
                CovarianceFunction::SquaredExponential => 0,
            };
            // Student's t, whose characteristic function is the Matérn covariance.
            let chi2: f64 = (0..freedom).map(|_| normals.draw().powi(2)).sum();
            let heavy = if freedom > 0 { (f64::from(freedom) / chi2).sqrt() } else { 1.0 };
            let mut k = || normals.draw() * heavy / kernel.length_m;
            let (east, north) = (k(), k());
            // Amplitudes of sine and cosine give a Gaussian field for any number of waves.
            let amplitude = kernel.sigma_se_nt / f64::from(count).sqrt();
            [east, north, amplitude * normals.draw(), amplitude * normals.draw()]
        };
        Self((0..count).map(wave).collect())
    }

    fn at(&self, [east, north]: [f64; 2]) -> f64 {
        let wave = |[a, b, c, s]: &[f64; 4]| {
            let phase = a * east + b * north;
            c * phase.cos() + s * phase.sin()
        };
        self.0.iter().map(wave).sum()
    }
}

/// Parallel eastward lines in a square of this side, `apart_m` apart, with a sample every `step_m`.
fn lines(side_m: f64, apart_m: f64, step_m: f64) -> Vec<TrackSample> {
    let (count, of_line) = ((side_m / apart_m) as usize + 1, (side_m / step_m) as usize + 1);
    let sample = |place: usize| {
        let (line, i) = (place / of_line, place % of_line);
        let east = if line % 2 == 0 { i } else { of_line - 1 - i };
        TrackSample {
            at_m: [step_m * east as f64, apart_m * line as f64],
            alt_m: 300.0,
            tt_s: place as f64,
            value_nt: 0.0,
            variance_nt2: 0.0,
            position_m2: [0.0; 3],
            flight: 0,
            line,
        }
    };
    (0..count * of_line).map(sample).collect()
}

fn axis(first: f64, step: f64, len: usize) -> EvenAxis {
    EvenAxis { first, step, len }
}

/// Mean and variance of the field and level at some positions, from all pairs of samples.
fn dense(kernel: &AnomalyKernel, samples: &[TrackSample], at: &[[f64; 2]]) -> Vec<(f64, f64)> {
    let n = samples.len();
    let apart2 = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
    let k = |a: [f64; 2], b: [f64; 2]| kernel.anomaly_nt2(apart2(a, b)) + kernel.mean_nt2();
    let noise = |i: usize| samples[i].variance_nt2 + kernel.sigma_n_nt.powi(2);
    let all = DMatrix::from_fn(n, n, |i, j| k(samples[i].at_m, samples[j].at_m) + if i == j { noise(i) } else { 0.0 });
    let factor = Cholesky::new(all).unwrap();
    let values = factor.solve(&DVector::from_iterator(n, samples.iter().map(|sample| sample.value_nt)));
    let one = |at: &[f64; 2]| {
        let cross = DVector::from_iterator(n, samples.iter().map(|sample| k(sample.at_m, *at)));
        (cross.dot(&values), k(*at, *at) - cross.dot(&factor.solve(&cross)))
    };
    at.iter().map(one).collect()
}

#[test]
fn law_the_map_equals_the_regression_on_all_pairs() {
    for covariance in
        [CovarianceFunction::SquaredExponential, CovarianceFunction::Matern52, CovarianceFunction::Matern32]
    {
        let kernel = kernel(covariance);
        let field = Field::drawn(&kernel, 3);
        let mut normals = NormalGenerator::new(8);
        let mut samples = lines(3000.0, 500.0, 120.0);
        for sample in &mut samples {
            sample.variance_nt2 = if sample.at_m[0] > 1500.0 { 9.0 } else { 0.0 };
            let sd_nt = (sample.variance_nt2 + 1.0).sqrt();
            sample.value_nt = 70.0 + field.at(sample.at_m) + sd_nt * normals.draw();
        }
        let map = TrackMap::new(&fixed(kernel), &samples).unwrap();
        let (east, north) = (axis(-130.0, 170.0, 20), axis(-130.0, 170.0, 20));
        let nodes = map.on(east, north);
        let at: Vec<[f64; 2]> =
            north.coordinates().iter().flat_map(|n| east.coordinates().into_iter().map(|e| [e, *n])).collect();
        // The theoretical error of the mean has two contributions: the omitted waves, √lacking of the variance where
        // nothing is measured, and the boundary, k(4 l) at the outermost samples.
        let tolerance = 3.0 * map.report.lacking.sqrt() * 40.0 + 0.15;
        let (mut worst, mut worst_sd) = (0.0_f64, 0.0_f64);
        for (node, (value, variance)) in nodes.iter().zip(dense(&kernel, &samples, &at)) {
            worst = worst.max((node.value_nt - value).abs());
            worst_sd = worst_sd.max((node.sd_nt - variance.sqrt()).abs());
        }
        println!("{covariance:?}: {} functions, {worst} {worst_sd} {tolerance}", map.report.functions);
        assert!(worst < tolerance && worst_sd < tolerance, "{covariance:?}: {worst} {worst_sd} {tolerance}");
        // The variance that the basis omits is treated as noise. This noise is not added if the basis omits little of
        // the lines' variance.
        assert!((0.3..1.1).contains(&map.report.misfit), "{}", map.report.misfit);
    }
}

#[test]
fn law_the_standard_deviation_is_consistent_with_the_error() {
    let kernel = kernel(CovarianceFunction::Matern52);
    let (mut within, mut squares, mut count) = (0, 0.0, 0);
    for seed in 0..6 {
        let field = Field::drawn(&kernel, seed);
        let mut normals = NormalGenerator::new(100 + seed);
        let mut samples = lines(4000.0, 500.0, 100.0);
        for sample in &mut samples {
            sample.value_nt = field.at(sample.at_m) - 500.0 + normals.draw();
        }
        let map = TrackMap::new(&fixed(kernel), &samples).unwrap();
        let (east, north) = (axis(30.0, 90.0, 44), axis(30.0, 90.0, 44));
        for (place, node) in map.on(east, north).iter().enumerate() {
            let at_m = [east.at((place % 44) as f64), north.at((place / 44) as f64)];
            let z = (node.value_nt - (field.at(at_m) - 500.0)) / node.sd_nt;
            within += usize::from(z.abs() < 1.96);
            squares += z * z;
            count += 1;
        }
    }
    let (part, rms) = (within as f64 / f64::from(count), (squares / f64::from(count)).sqrt());
    println!("within 1.96 sd: {part:.4}, rms of the standardised error {rms:.3}");
    // The errors of the 11616 nodes are correlated over a few hundred metres, so about 500 errors are independent.
    assert!((part - 0.95).abs() < 0.03 && (rms - 1.0).abs() < 0.1, "{part} {rms}");
}

#[test]
fn law_a_position_error_enters_the_standard_deviation() {
    let kernel = kernel(CovarianceFunction::Matern52);
    // One error for the whole track, or one error for each line.
    for own in [false, true] {
        let (mut within, mut blind, mut count) = (0, 0, 0);
        for seed in 0..10 {
            let field = Field::drawn(&kernel, 50 + seed);
            let mut normals = NormalGenerator::new(200 + seed);
            let mut samples = lines(4000.0, 500.0, 100.0);
            let (sd_m, mut off_m, mut line) = (60.0, [0.0; 2], usize::MAX);
            for sample in &mut samples {
                if line == usize::MAX || (own && sample.line != line) {
                    off_m = [sd_m * normals.draw(), sd_m * normals.draw()];
                }
                line = sample.line;
                let truly_m = [sample.at_m[0] + off_m[0], sample.at_m[1] + off_m[1]];
                sample.value_nt = field.at(truly_m) + normals.draw();
                sample.position_m2 = [sd_m * sd_m, sd_m * sd_m, 0.0];
            }
            let map = TrackMap::new(&fixed(kernel), &samples).unwrap();
            let naive: Vec<TrackSample> =
                samples.iter().map(|sample| TrackSample { position_m2: [0.0; 3], ..*sample }).collect();
            let naive = TrackMap::new(&fixed(kernel), &naive).unwrap();
            let (east, north) = (axis(30.0, 90.0, 44), axis(30.0, 90.0, 44));
            for (place, (node, naive)) in map.on(east, north).iter().zip(naive.on(east, north)).enumerate() {
                let at_m = [east.at((place % 44) as f64), north.at((place / 44) as f64)];
                let truth = field.at(at_m);
                within += usize::from((node.value_nt - truth).abs() < 1.96 * node.sd_nt);
                blind += usize::from((naive.value_nt - truth).abs() < 1.96 * naive.sd_nt);
                count += 1;
            }
        }
        let [part, without] = [within, blind].map(|n| n as f64 / f64::from(count));
        println!("own {own}: within 1.96 sd {part:.3}, without the position's error {without:.3}");
        assert!(part > 0.92 && part > without + 0.1, "{own}: {part} {without}");
    }
}

#[test]
fn law_constants_of_lines_and_the_temporal_variation_are_removed() {
    let kernel = kernel(CovarianceFunction::Matern52);
    let field = Field::drawn(&kernel, 20);
    let mut normals = NormalGenerator::new(21);
    let mut samples = lines(4000.0, 500.0, 100.0);
    let mut ties = samples.clone();
    let lines_count = samples.iter().map(|sample| sample.line + 1).max().unwrap();
    for tie in &mut ties {
        tie.at_m.swap(0, 1);
        tie.line += lines_count;
        tie.tt_s += samples.len() as f64;
    }
    samples.extend(ties);
    let constants: Vec<f64> = (0..2 * lines_count).map(|_| 10.0 * normals.draw()).collect();
    let temporal = |tt_s: f64| 8.0 * (tt_s / 90.0).sin();
    for constant in [true, false] {
        let disturbed: Vec<TrackSample> = samples
            .iter()
            .map(|sample| {
                let more = if constant { constants[sample.line] } else { temporal(sample.tt_s) };
                TrackSample { value_nt: field.at(sample.at_m) + more + 0.5 * normals.draw(), ..*sample }
            })
            .collect();
        let rms = |parameters: TrackMapParameters| {
            let map = TrackMap::new(&parameters, &disturbed).unwrap();
            let (east, north) = (axis(220.0, 180.0, 20), axis(220.0, 180.0, 20));
            let errors: Vec<f64> = map
                .on(east, north)
                .iter()
                .enumerate()
                .map(|(i, node)| node.value_nt - field.at([east.at((i % 20) as f64), north.at((i / 20) as f64)]))
                .collect();
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            // A constant that all lines share is not observable.
            (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / errors.len() as f64).sqrt()
        };
        let plain = rms(fixed(kernel));
        let with = rms(match constant {
            true => TrackMapParameters { line_sigma_nt: 10.0, ..fixed(kernel) },
            false => TrackMapParameters { temporal: (8.0, 100.0), ..fixed(kernel) },
        });
        println!("constants {constant}: {plain:.2} nT without, {with:.2} nT with");
        assert!(with < 0.65 * plain, "{constant}: {plain} {with}");
    }
}

#[test]
fn law_the_fitted_kernel_is_that_of_the_field() {
    let truth = AnomalyKernel { sigma_n_nt: 2.0, ..kernel(CovarianceFunction::Matern52) };
    let field = Field::drawn(&truth, 31);
    let mut normals = NormalGenerator::new(32);
    let mut samples = lines(12_000.0, 1000.0, 60.0);
    for sample in &mut samples {
        sample.value_nt = field.at(sample.at_m) + 2.0 * normals.draw() + 7.0 * sample.line as f64;
    }
    let start = AnomalyKernel { sigma_se_nt: 50.0, length_m: 150.0, sigma_n_nt: 1.0, ..truth };
    let parameters = TrackMapParameters { hyperparameters: HyperparameterSource::Fitted, ..fixed(start) };
    let map = TrackMap::new(&parameters, &samples).unwrap();
    let found = map.report.kernel;
    println!("{found:?} {} functions, {}", map.report.functions, map.report.lacking);
    assert!(map.report.fitted);
    assert!((found.length_m / 600.0).ln().abs() < 0.25, "{found:?}");
    assert!((found.sigma_se_nt / 40.0).ln().abs() < 0.35, "{found:?}");
    assert!((found.sigma_n_nt / 2.0).ln().abs() < 0.2, "{found:?}");
}

#[test]
fn unit_results_are_bit_identical_for_any_number_of_threads() {
    let kernel = kernel(CovarianceFunction::Matern52);
    let field = Field::drawn(&kernel, 40);
    let mut samples = lines(3000.0, 600.0, 100.0);
    for sample in &mut samples {
        sample.value_nt = field.at(sample.at_m);
        sample.position_m2 = [400.0, 900.0, 100.0];
    }
    let parameters = TrackMapParameters {
        hyperparameters: HyperparameterSource::Fitted,
        temporal: (2.0, 50.0),
        line_sigma_nt: 3.0,
        ..fixed(kernel)
    };
    let bits = |threads: usize| -> Vec<[u64; 2]> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let map = pool.install(|| TrackMap::new(&parameters, &samples).unwrap());
        let nodes = pool.install(|| map.on(axis(0.0, 100.0, 30), axis(0.0, 100.0, 30)));
        nodes.iter().map(|node| [node.value_nt.to_bits(), node.sd_nt.to_bits()]).collect()
    };
    assert_eq!(bits(1), bits(3));
}

#[test]
fn unit_invalid_maps_are_rejected() {
    let kernel = kernel(CovarianceFunction::Matern52);
    assert_eq!(TrackMap::new(&fixed(kernel), &[]).err(), Some(TrackMapError::Nothing));
    let wrong = AnomalyKernel { length_m: 0.0, ..kernel };
    let samples = lines(1000.0, 500.0, 100.0);
    assert!(matches!(TrackMap::new(&fixed(wrong), &samples), Err(TrackMapError::Parameter(_))));
    let far = lines(100_000.0, 50_000.0, 10_000.0);
    let fault = TrackMap::new(&fixed(kernel), &far).err().unwrap();
    assert!(fault.to_string().contains("is too large"), "{fault}");
    // One sample determines only a level; beyond the rectangle there is no value.
    let one = TrackMap::new(
        &TrackMapParameters { hyperparameters: HyperparameterSource::Fitted, temporal: (1.0, 60.0), ..fixed(kernel) },
        &[TrackSample { value_nt: 12.0, ..samples[0] }],
    )
    .unwrap();
    assert!(!one.report.fitted);
    let nodes = one.on(axis(0.0, 5000.0, 2), axis(0.0, 5000.0, 2));
    assert!((nodes[0].value_nt - 12.0).abs() < 0.1 && nodes[3].value_nt.is_nan(), "{nodes:?}");
}
