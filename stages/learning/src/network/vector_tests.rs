use std::ops::ControlFlow;

use super::objective::{BatchRows, TrainingObjective};
use super::tests::{Table, columns, near};
use super::windowed::NetworkArchitecture;
use super::windowed_tests::train_windowed;
use super::*;

const FORMS: [NetworkForm; 3] = [NetworkForm::VectorOnly, NetworkForm::VectorScalar, NetworkForm::VectorNetwork];
const COUPLINGS: [FieldCoupling; 2] = [FieldCoupling::Magnitude, FieldCoupling::Projection];
const BT_SCALE_NT: f64 = 50_000.0;
const TARGET_SCALE_NT: f64 = 3_000.0;

/// Field and its difference per sample, in nT, as the columns of the reference table.
fn vectors() -> Vec<[f64; 6]> {
    let table = columns(include_str!("../../reference/network/vector.csv"));
    let all = ["bx", "by", "bz", "dx", "dy", "dz"].map(|name| &table[name]);
    (0..45).map(|row| all.map(|column| column[row])).collect()
}

/// Tolles-Lawson terms of a field from their definition.
fn terms(width: usize) -> Vec<f64> {
    let of = |[x, y, z, dx, dy, dz]: [f64; 6]| {
        let (field, change) = ([x, y, z], [dx, dy, dz]);
        let size = (x * x + y * y + z * z).sqrt();
        let pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
        let mut out = field.map(|b| b / size).to_vec();
        out.extend(pairs.map(|(i, j)| field[i] * field[j] / (size * BT_SCALE_NT)));
        out.extend(field.iter().flat_map(|b| change.map(|d| b * d / (size * BT_SCALE_NT))));
        out.truncate(width);
        out
    };
    vectors().into_iter().flat_map(of).collect()
}

fn frame(coupling: FieldCoupling) -> VectorFrame {
    VectorFrame { coupling, bt_scale_nt: BT_SCALE_NT, target_scale_nt: TARGET_SCALE_NT }
}

fn shape(form: NetworkForm, linear: usize) -> NetworkShape {
    let hidden: &[usize] = match form {
        NetworkForm::VectorOnly => &[],
        NetworkForm::VectorNetwork => &[7, 4],
        _ => &[6],
    };
    let inputs = if form == NetworkForm::VectorOnly { 0 } else { 5 };
    NetworkShape { inputs, linear, hidden: hidden.to_vec(), activation: ActivationFunction::Swish, form }
}

fn windowed(linear: usize) -> WindowedNetworkShape {
    let head = NetworkShape { inputs: 15, hidden: vec![4], ..shape(NetworkForm::VectorScalar, linear) };
    WindowedNetworkShape { memory: MemoryLayers::Window, inputs: 5, window: 3, heads: 1, units: 15, head }
}

fn transformer(linear: usize) -> WindowedNetworkShape {
    let head = NetworkShape { inputs: 18, hidden: vec![], ..shape(NetworkForm::VectorScalar, linear) };
    WindowedNetworkShape { memory: MemoryLayers::Transformer, inputs: 5, window: 3, heads: 2, units: 6, head }
}

const RUNS: [usize; 3] = [20, 3, 22];

fn waves(count: usize, case: usize) -> Vec<f64> {
    (0..count).map(|i| 0.5 * (0.9 * i as f64 + case as f64).sin()).collect()
}

/// First row of the run of each row.
fn first_rows() -> Vec<u32> {
    [(0, 20), (20, 3), (23, 22)].into_iter().flat_map(|(start, count)| vec![start; count]).collect()
}

fn go_on(_: &TrainingEpoch, _: &TrainingState) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

#[test]
fn ref_predictions_and_gradients_agree_with_numpy() {
    let (table, expected) = (Table::reference(), columns(include_str!("../../reference/network/vector.csv")));
    let gradients = columns(include_str!("../../reference/network/vector_gradient.csv"));
    let training = NetworkTraining::default();
    let mut case = 0;
    for name in ["m3tl", "m3s", "m3v", "m3w", "m3tf"] {
        for coupling in COUPLINGS {
            for linear in [9, 18] {
                let rows = frame(coupling).rows(&terms(linear), linear);
                let dense = FORMS.map(|form| shape(form, linear));
                let windows = [windowed(linear), transformer(linear)];
                let (model, first): (NetworkArchitecture<'_>, _) = match name {
                    "m3tl" => ((&dense[0]).into(), vec![]),
                    "m3s" => ((&dense[1]).into(), vec![]),
                    "m3v" => ((&dense[2]).into(), vec![]),
                    "m3w" => ((&windows[0]).into(), first_rows()),
                    _ => ((&windows[1]).into(), first_rows()),
                };
                let x: &[f64] = if name == "m3tl" { &[] } else { &table.x };
                let samples = NetworkSamples { x, a: &rows, y: &table.y };
                let parameters = waves(model.parameters(), case);
                let what = format!("{name} {} {linear}", coupling.word());
                let predicted = model.predict(&parameters, &samples, &first);
                near(&predicted, &expected[what.as_str()], 1e-12, &what);
                let mut gradient = vec![0.0; parameters.len()];
                let mut objective = TrainingObjective::new(model, &training, samples, first, &[]);
                objective.at(&parameters, BatchRows::All, None, &mut gradient);
                // The steps of the transformer are compared below.
                if name != "m3tf" {
                    near(&gradient, &gradients[what.as_str()], 1e-11, &what);
                }
                case += 1;
            }
        }
    }
}

#[test]
fn ref_ten_epochs_agree_with_numpy_with_and_without_a_curriculum() {
    let (table, expected) = (Table::reference(), columns(include_str!("../../reference/network/vector_training.csv")));
    let rows = frame(FieldCoupling::Magnitude).rows(&terms(18), 18);
    for (name, form) in [("m3tl", 0), ("m3s", 1), ("m3v", 2), ("m3sc", 1), ("m3vc", 2), ("m3w", 3), ("m3tf", 4)] {
        let training = NetworkTraining {
            epochs: 10,
            batch: 14,
            learning_rate: 0.02,
            seed: 3,
            curriculum: name.ends_with('c').then_some(1.0),
            ..NetworkTraining::default()
        };
        let x: &[f64] = if name == "m3tl" { &[] } else { &table.x };
        let samples = NetworkSamples { x, a: &rows, y: &table.y };
        let trained = match FORMS.get(form) {
            Some(form) => {
                let shape = shape(*form, 18);
                let start = TrainingState::new(&shape, waves(shape.parameters(), 1));
                train(&shape, start, &training, &samples, None, &mut go_on).unwrap()
            }
            None => {
                let shape = if name == "m3w" { windowed(18) } else { transformer(18) };
                let start = shape.start(waves(shape.parameters(), 1));
                let runs = SampleRuns { samples, lengths: &RUNS };
                train_windowed(&shape, start, &training, &runs, None, &mut go_on).unwrap()
            }
        };
        near(&trained.parameters, &expected[name], 1e-9, name);
    }
}

#[test]
fn law_the_projection_is_linear_tolles_lawson() {
    let table = Table::reference();
    let parameters = waves(shape(NetworkForm::VectorScalar, 18).parameters(), 4);
    let rows = frame(FieldCoupling::Projection).rows(&terms(18), 18);
    let vector = shape(NetworkForm::VectorScalar, 18).predict(&parameters, &table.x, &rows);
    let linear = NetworkShape { form: NetworkForm::TrainedLinear, ..shape(NetworkForm::VectorScalar, 18) };
    near(&vector, &linear.predict(&parameters, &table.x, &terms(18)), 1e-13, "m3s and m2c");
}

#[test]
fn law_the_projection_exceeds_the_magnitude_in_second_order() {
    let b: Vec<f64> = waves(18, 2);
    let of = |coupling, scale_nt: f64| {
        let frame = VectorFrame { target_scale_nt: scale_nt, ..frame(coupling) };
        frame.fields(&terms(18), &b).iter().map(|f| f * scale_nt).collect::<Vec<f64>>()
    };
    let difference = |scale_nt: f64| -> f64 {
        let [magnitude, projection] = COUPLINGS.map(|coupling| of(coupling, scale_nt));
        magnitude.iter().zip(projection).map(|(m, p)| p - m).fold(0.0, f64::max)
    };
    let (one, half) = (difference(1000.0), difference(500.0));
    assert!(one > 1.0 && (one / half - 4.0).abs() < 0.1, "{one} {half}");
}

#[test]
fn law_gradients_agree_with_central_differences_in_every_phase() {
    let table = Table::reference();
    for form in FORMS {
        for coupling in COUPLINGS {
            let shape = shape(form, 18);
            let rows = frame(coupling).rows(&terms(18), 18);
            let x: &[f64] = if form == NetworkForm::VectorOnly { &[] } else { &table.x };
            let samples = NetworkSamples { x, a: &rows, y: &table.y };
            let b = waves(18, 8);
            for (epoch, whiten) in [(0, None), (10, None), (20, None), (30, None), (60, None), (60, Some(0.99999))] {
                let network = form != NetworkForm::VectorOnly;
                let training = NetworkTraining {
                    loss: NetworkLoss::Huber { delta: 0.7 },
                    conditioning: Some(TermScaling::new(form, &terms(18), 18, whiten, &b).unwrap()),
                    curriculum: network.then_some(1.0),
                    epochs: 100,
                    sparse_group_lasso: Some(SparseGroupLasso { strength: 0.2, alpha: 0.4 }),
                    dropout: if network { 0.3 } else { 0.0 },
                    ..NetworkTraining::default()
                };
                let parameters = waves(shape.parameters(), 7);
                let mut objective = TrainingObjective::new((&shape).into(), &training, samples, vec![], &b);
                objective.phase = training.phase(epoch);
                let (mut gradient, mut none) = (vec![0.0; parameters.len()], vec![0.0; parameters.len()]);
                let dropout = network.then_some(11);
                objective.at(&parameters, BatchRows::All, dropout, &mut gradient);
                for range in training.trained((&shape).into(), objective.phase) {
                    for i in range {
                        let mut at = |by: f64| {
                            let mut moved = parameters.clone();
                            moved[i] += by;
                            objective.at(&moved, BatchRows::All, dropout, &mut none).objective
                        };
                        let slope = (at(1e-6) - at(-1e-6)) / 2e-6;
                        let name = format!("{form:?} {coupling:?} {epoch} {whiten:?} {}", shape.names()[i]);
                        assert!(
                            (slope - gradient[i]).abs() < 1e-7 * (1.0 + slope.abs()),
                            "{name}: {slope} {}",
                            gradient[i]
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn law_scaled_coefficients_give_the_same_prediction() {
    let table = Table::reference();
    for form in FORMS {
        for whiten in [None, Some(0.99999)] {
            let shape = shape(form, 18);
            let scaling = TermScaling::new(form, &terms(18), 18, whiten, &waves(18, 5)).unwrap();
            let training = NetworkTraining { conditioning: Some(scaling.clone()), ..NetworkTraining::default() };
            let parameters = waves(shape.parameters(), 3);
            let scaled = scaling.scaled(&shape, &parameters);
            assert!(scaled != parameters);
            near(&training.plain((&shape).into(), None, &scaled), &parameters, 1e-9, shape.form.word());
            // The constant absorbs the mean of the terms: a change of a coefficient keeps the mean prediction.
            let rows = frame(FieldCoupling::Projection).rows(&terms(18), 18);
            let mean = |scaled: &[f64]| {
                let x: &[f64] = if form == NetworkForm::VectorOnly { &[] } else { &table.x };
                let y = shape.predict(&training.plain((&shape).into(), None, scaled), x, &rows);
                y.iter().sum::<f64>() / 45.0
            };
            let mut moved = scaled.clone();
            moved[shape.linear_start() + 4] += 1.0;
            assert!((mean(&moved) - mean(&scaled)).abs() < 1e-9);
        }
    }
}

#[test]
fn law_lbfgs_of_the_projection_gives_least_squares() {
    let a = terms(18);
    let y: Vec<f64> = (0..45).map(|i| (0.37 * f64::from(i)).sin() + 0.3 * (1.9 * f64::from(i)).cos()).collect();
    let rows = frame(FieldCoupling::Projection).rows(&a, 18);
    let shape = shape(NetworkForm::VectorOnly, 18);
    let optimiser = NetworkOptimiser { lbfgs_epochs: 3000, ..NetworkOptimiser::default() };
    let conditioning = TermScaling::new(shape.form, &a, 18, Some(1.0 - 1e-15), &[0.0; 18]).unwrap();
    let training =
        NetworkTraining { optimiser, epochs: 0, conditioning: Some(conditioning), ..NetworkTraining::default() };
    let start = TrainingState::new(&shape, vec![0.0; shape.parameters()]);
    let samples = NetworkSamples { x: &[], a: &rows, y: &y };
    let trained = train(&shape, start, &training, &samples, None, &mut go_on).unwrap();
    let moments = numerics::regression::least_squares::RegressionMoments::from_matrix(&a, 18, &[&y]).unwrap();
    let prepared = moments.prepare(numerics::regression::least_squares::ColumnScaling::Standardise, true).unwrap();
    let names: Vec<String> = VECTOR_TERMS.iter().map(ToString::to_string).collect();
    let path = prepared.ridge(&[0.0], &names.iter().collect::<Vec<_>>()).unwrap();
    let solution = &path.solutions[0].coefficients[0];
    let product = |row: &[f64]| row.iter().zip(solution).map(|(a, b)| a * b).sum::<f64>();
    let fitted: Vec<f64> = a.chunks(18).map(product).collect();
    let constant = (y.iter().sum::<f64>() - fitted.iter().sum::<f64>()) / 45.0;
    let left = y.iter().zip(&fitted).map(|(y, f)| (y - f - constant).powi(2)).sum::<f64>() / 45.0;
    near(&[trained.epochs.last().unwrap().train_loss], &[left], 1e-9, "loss");
}

/// Samples of a nonlinear problem, a shape and a training with a curriculum.
fn problem() -> (Vec<f64>, Vec<f64>, Vec<f64>) {
    let (rows, count) = (frame(FieldCoupling::Magnitude).rows(&terms(18), 18), 30);
    let a: Vec<f64> = (0..count).flat_map(|_| rows.clone()).collect();
    let x: Vec<f64> = (0..45 * count * 5).map(|i| (0.61 * i as f64).sin()).collect();
    let y = x.chunks(5).map(|x| x[0] * x[1] + 0.4 * x[2]).collect();
    (x, a, y)
}

#[test]
fn unit_threads_and_interruptions_change_no_bit() {
    let (x, a, y) = problem();
    let samples = NetworkSamples { x: &x, a: &a, y: &y };
    for form in [NetworkForm::VectorScalar, NetworkForm::VectorNetwork] {
        let shape = shape(form, 18);
        let training = NetworkTraining {
            epochs: 20,
            batch: 300,
            curriculum: Some(1.0),
            conditioning: Some(TermScaling::new(form, &terms(18), 18, None, &waves(18, 5)).unwrap()),
            dropout: 0.1,
            ..NetworkTraining::default()
        };
        let start = || TrainingState::new(&shape, shape.initial(1, &waves(18, 5)));
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| train(&shape, start(), &training, &samples, Some(&samples), &mut go_on).unwrap())
        };
        let whole = on(1);
        assert_eq!(whole, on(2));
        assert!(whole.best > 6, "an epoch without the network was selected: {}", whole.best);
        for stop in [1, 2, 4, 6, 13] {
            let mut kept = None;
            let mut each = |_: &TrainingEpoch, state: &TrainingState| {
                kept = Some(TrainingState::from_bytes(&state.to_bytes()).unwrap());
                if state.epoch == stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            };
            train(&shape, start(), &training, &samples, Some(&samples), &mut each).unwrap();
            let resumed = train(&shape, kept.unwrap(), &training, &samples, Some(&samples), &mut go_on).unwrap();
            assert_eq!(whole, resumed, "{form:?} {stop}");
        }
    }
}

#[test]
fn unit_each_phase_changes_only_its_parameters() {
    let (x, a, y) = problem();
    let samples = NetworkSamples { x: &x, a: &a, y: &y };
    let shape = shape(NetworkForm::VectorNetwork, 18);
    let training = NetworkTraining { epochs: 10, batch: 300, curriculum: Some(1.0), ..NetworkTraining::default() };
    let mut before = shape.initial(1, &waves(18, 5));
    let first = before.clone();
    let mut changed = vec![];
    let start = TrainingState::new(&shape, first.clone());
    train(&shape, start, &training, &samples, None, &mut |_, state| {
        let moved = |range: std::ops::Range<usize>| range.into_iter().all(|i| state.parameters[i] != before[i]);
        let at = shape.linear_start();
        changed.push([moved(0..1), moved(at..at + 3), moved(at + 3..at + 9), moved(at + 9..at + 18)]);
        before.clone_from(&state.parameters);
        ControlFlow::Continue(())
    })
    .unwrap();
    let (off, on) = (false, true);
    assert_eq!(changed[..3], [[off, on, off, off], [off, on, on, off], [off, on, on, on]]);
    assert_eq!(changed[3..6], [[on, off, off, off]; 3]);
    assert_eq!(changed[6..], [[on; 4]; 4]);
}

#[test]
fn unit_invalid_vector_networks_are_rejected() {
    let (x, a, y) = problem();
    let samples = NetworkSamples { x: &x, a: &a, y: &y };
    let refused = |shape: &NetworkShape, training: &NetworkTraining, what: &str| {
        let start = TrainingState::new(shape, vec![0.1; shape.parameters()]);
        let error = train(shape, start, training, &samples, None, &mut go_on).unwrap_err().to_string();
        assert!(error.contains(what), "{error}");
    };
    let (usual, training) = (shape(NetworkForm::VectorScalar, 18), NetworkTraining::default());
    refused(&NetworkShape { linear: 12, ..usual.clone() }, &training, "the model 3 family must be 9 or 18");
    refused(&NetworkShape { form: NetworkForm::VectorOnly, ..usual.clone() }, &training, "of `m3tl` must be 0");
    let short = NetworkTraining { epochs: 9, curriculum: Some(1.0), ..training.clone() };
    refused(&usual, &short, "at least 10");
    let narrow = NetworkTraining { epochs: 10, curriculum: Some(1e-12), ..training.clone() };
    refused(&usual, &narrow, "large enough to select a sample");
    refused(&usual, &NetworkTraining { physics: 1.0, ..training.clone() }, "the physics term of the model 3 family");
    let plain = NetworkShape { form: NetworkForm::Plain, linear: 0, ..usual.clone() };
    let start = TrainingState::new(&plain, vec![0.1; plain.parameters()]);
    let samples = NetworkSamples { a: &[], ..samples };
    let with = NetworkTraining { epochs: 10, curriculum: Some(1.0), ..training.clone() };
    assert!(train(&plain, start, &with, &samples, None, &mut go_on).is_err());
    // A row without a field is not finite.
    let none = frame(FieldCoupling::Magnitude).rows(&[0.0; 18], 18);
    assert!(none.iter().any(|x| x.is_nan()));
}

#[test]
fn unit_no_epoch_before_the_network_counts_for_patience() {
    let (x, a, y) = problem();
    let samples = NetworkSamples { x: &x, a: &a, y: &y };
    let shape = shape(NetworkForm::VectorScalar, 18);
    let training = NetworkTraining {
        epochs: 20,
        batch: 300,
        learning_rate: 1e-12,
        curriculum: Some(1.0),
        patience: Some(1),
        ..NetworkTraining::default()
    };
    let start = TrainingState::new(&shape, shape.initial(1, &waves(18, 5)));
    let trained = train(&shape, start, &training, &samples, Some(&samples), &mut go_on).unwrap();
    assert!(trained.epochs.len() >= 7 && trained.best >= 7, "{} {}", trained.epochs.len(), trained.best);
}

/// Files of `reference/network/onnx`: name, shape, coupling, and whether the inputs are scaled.
fn onnx_cases() -> Vec<(&'static str, NetworkShape, FieldCoupling, Vec<u8>)> {
    let table = Table::reference();
    let cases = [
        ("m3tl", shape(NetworkForm::VectorOnly, 18), FieldCoupling::Magnitude),
        ("m3s", shape(NetworkForm::VectorScalar, 9), FieldCoupling::Projection),
        ("m3v", shape(NetworkForm::VectorNetwork, 18), FieldCoupling::Magnitude),
    ];
    let of = |(name, shape, coupling): (&'static str, NetworkShape, FieldCoupling)| {
        let scales = NetworkScales {
            inputs: &onnx_scaling(&shape, &table),
            linear: None,
            frame: Some(frame(coupling)),
            target_mean: 12.0,
            target_scale: TARGET_SCALE_NT,
        };
        let bytes = shape.to_onnx(&waves(shape.parameters(), 3), &scales).unwrap();
        (name, shape, coupling, bytes)
    };
    cases.into_iter().map(of).collect()
}

fn onnx_scaling(shape: &NetworkShape, table: &Table) -> crate::inputs::InputScaling {
    if shape.inputs == 0 {
        return crate::inputs::InputScaling { mean: vec![], scale: vec![], components: None };
    }
    crate::inputs::InputScaling::standardised(&table.x, 5).unwrap()
}

#[test]
#[ignore = "writes the files that reference/network/check_onnx.py runs"]
fn user_write_the_onnx_files_of_vector_forms() {
    for (name, _, _, bytes) in onnx_cases() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/reference/network/onnx");
        std::fs::write(format!("{folder}/{name}.onnx"), bytes).unwrap();
    }
}

#[test]
fn ref_onnx_files_of_vector_forms_agree_with_onnxruntime() {
    let (table, expected) = (Table::reference(), columns(include_str!("../../reference/network/onnx_vector.csv")));
    let kept: [&[u8]; 3] = [
        include_bytes!("../../reference/network/onnx/m3tl.onnx"),
        include_bytes!("../../reference/network/onnx/m3s.onnx"),
        include_bytes!("../../reference/network/onnx/m3v.onnx"),
    ];
    for ((name, shape, coupling, bytes), kept) in onnx_cases().into_iter().zip(kept) {
        assert!(bytes == kept, "{name}.onnx is not the file that was checked: run its checks again");
        let rows = frame(coupling).rows(&terms(shape.linear), shape.linear);
        let x: &[f64] = if shape.inputs == 0 { &[] } else { &table.x };
        let x = onnx_scaling(&shape, &table).apply(x);
        let predicted = shape.predict(&waves(shape.parameters(), 3), &x, &rows);
        let predicted: Vec<f64> = predicted.iter().map(|y| 12.0 + TARGET_SCALE_NT * y).collect();
        near(&predicted, &expected[name], 1e-8, name);
    }
    let shape = shape(NetworkForm::VectorOnly, 18);
    let inputs = onnx_scaling(&shape, &table);
    let without = NetworkScales { inputs: &inputs, linear: None, frame: None, target_mean: 0.0, target_scale: 1.0 };
    assert_eq!(shape.to_onnx(&waves(shape.parameters(), 3), &without), Err(OnnxError::NoFrame));
}
