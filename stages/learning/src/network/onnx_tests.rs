use super::tests::{Table, columns, near};
use super::*;
use crate::inputs::InputScaling;

const OFFSET: [f64; 3] = [0.3, -0.1, 0.2];
const FACTOR: [f64; 3] = [1.5, 0.7, 2.0];

/// A file in `reference/network/onnx`, and its contents.
struct Case {
    name: &'static str,
    shape: NetworkShape,
    parameters: Vec<f64>,
    inputs: InputScaling,
    /// Whether the linear terms are scaled.
    scaled: bool,
    bytes: Vec<u8>,
}

/// A network of each form.
fn cases() -> Vec<Case> {
    let table = Table::reference();
    let shape = |form, activation, hidden: &[usize], inputs| NetworkShape {
        inputs,
        linear: if form == NetworkForm::Plain { 0 } else { 3 },
        hidden: hidden.to_vec(),
        activation,
        form,
    };
    let plain = InputScaling::standardised(&table.x, 5).unwrap();
    // Given as numbers, so that the bytes of the file do not depend on a decomposition.
    let mut whitened = plain.clone();
    let weights = (0..10).map(|i| f64::from(i) * 0.1 - 0.4).collect();
    whitened.components = Some(crate::inputs::WhitenedComponents { count: 2, weights, explained: 0.5 });
    let all = [
        ("m1", shape(NetworkForm::Plain, ActivationFunction::Relu, &[6], 2), whitened, false),
        ("m2a", shape(NetworkForm::Weights, ActivationFunction::Tanh, &[4], 5), plain.clone(), false),
        ("m2b", shape(NetworkForm::FixedLinear, ActivationFunction::Sigmoid, &[4], 5), plain.clone(), true),
        ("m2c", shape(NetworkForm::TrainedLinear, ActivationFunction::Swish, &[7, 4], 5), plain.clone(), true),
        ("m2d", shape(NetworkForm::WeightsAroundFixed, ActivationFunction::Swish, &[], 5), plain, true),
    ];
    let of = |(name, shape, inputs, scaled): (&'static str, NetworkShape, InputScaling, bool)| {
        let parameters: Vec<f64> = (0..shape.parameters()).map(|i| 0.5 * (0.9 * i as f64).sin()).collect();
        let linear = scaled.then_some((OFFSET.as_slice(), FACTOR.as_slice()));
        let scales = NetworkScales { inputs: &inputs, linear, frame: None, target_mean: 12.0, target_scale: 30.0 };
        let bytes = shape.to_onnx(&parameters, &scales).unwrap();
        Case { name, shape, parameters, inputs, scaled, bytes }
    };
    all.into_iter().map(of).collect()
}

#[test]
#[ignore = "writes the files that reference/network/check_onnx.py runs"]
fn user_write_the_onnx_files() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/reference/network/onnx");
    std::fs::create_dir_all(folder).unwrap();
    for Case { name, bytes, .. } in cases() {
        std::fs::write(format!("{folder}/{name}.onnx"), bytes).unwrap();
    }
}

#[test]
fn ref_onnx_files_and_predictions_agree_with_onnxruntime() {
    let table = Table::reference();
    let expected = columns(include_str!("../../reference/network/onnx.csv"));
    let kept: [(&str, &[u8]); 5] = [
        ("m1", include_bytes!("../../reference/network/onnx/m1.onnx")),
        ("m2a", include_bytes!("../../reference/network/onnx/m2a.onnx")),
        ("m2b", include_bytes!("../../reference/network/onnx/m2b.onnx")),
        ("m2c", include_bytes!("../../reference/network/onnx/m2c.onnx")),
        ("m2d", include_bytes!("../../reference/network/onnx/m2d.onnx")),
    ];
    for (Case { name, shape, parameters, inputs, scaled, bytes }, (file, kept)) in cases().into_iter().zip(kept) {
        assert!(name == file && bytes == kept, "{name}.onnx is not the file that was checked: run its checks again");
        let scale = |(k, a): (usize, &f64)| if scaled { (a + OFFSET[k % 3]) * FACTOR[k % 3] } else { *a };
        let a: Vec<f64> = if shape.linear == 0 { vec![] } else { table.a.iter().enumerate().map(scale).collect() };
        let predicted = shape.predict(&parameters, &inputs.apply(&table.x), &a);
        let predicted: Vec<f64> = predicted.iter().map(|y| 12.0 + 30.0 * y).collect();
        near(&predicted, &expected[name], 1e-12, name);
    }
}

#[test]
fn unit_mismatched_or_non_finite_parameters_are_not_exported() {
    let table = Table::reference();
    let inputs = InputScaling::standardised(&table.x, 5).unwrap();
    let shape = NetworkShape {
        inputs: 5,
        linear: 3,
        hidden: vec![2],
        activation: ActivationFunction::Relu,
        form: NetworkForm::TrainedLinear,
    };
    let good = NetworkScales { inputs: &inputs, linear: None, frame: None, target_mean: 0.0, target_scale: 1.0 };
    let parameters = shape.initial(1, &[0.1, 0.2, 0.3]);
    assert!(shape.to_onnx(&parameters, &good).is_ok());
    assert!(shape.to_onnx(&parameters[1..], &good).is_err());
    assert!(shape.to_onnx(&shape.initial(1, &[]), &good).is_err());
    let narrow = NetworkShape { inputs: 4, ..shape.clone() };
    assert!(narrow.to_onnx(&narrow.initial(1, &[0.1, 0.2, 0.3]), &good).is_err());
    assert!(shape.to_onnx(&parameters, &NetworkScales { target_scale: f64::NAN, ..good }).is_err());
    assert!(shape.to_onnx(&parameters, &NetworkScales { linear: Some((&[0.0], &[1.0, 1.0, 1.0])), ..good }).is_err());
}
