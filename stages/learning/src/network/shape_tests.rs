use super::{ActivationFunction, NetworkForm, NetworkShape};

#[test]
fn unit_names_and_start_follow_the_order_of_the_parameters() {
    let shape = NetworkShape {
        inputs: 3,
        linear: 2,
        hidden: vec![2],
        activation: ActivationFunction::Swish,
        form: NetworkForm::TrainedLinear,
    };
    let names = "w1[1,1] w1[1,2] w1[1,3] w1[2,1] w1[2,2] w1[2,3] b1[1] b1[2] w2[1,1] w2[1,2] b2[1] linear[1] linear[2]";
    assert_eq!(shape.names().join(" "), names);
    let start = shape.initial(1, &[5.0, 6.0]);
    assert_eq!(start.len(), shape.parameters());
    assert_eq!((&start[6..8], start[10], &start[11..]), (&[0.0, 0.0][..], 0.0, &[5.0, 6.0][..]));
    assert!(start[..6].iter().all(|w| w.abs() <= (6.0f64 / 5.0).sqrt() && *w != 0.0));
    assert_ne!(start, shape.initial(2, &[5.0, 6.0]));
    let weights = NetworkShape { form: NetworkForm::Weights, hidden: vec![], ..shape };
    assert_eq!((weights.parameters(), weights.names().len()), (8, 8));
    // Glorot's variance, 2/(inputs + units).
    let wide = NetworkShape {
        inputs: 200,
        hidden: vec![100],
        linear: 0,
        activation: ActivationFunction::Relu,
        form: NetworkForm::Plain,
    };
    let start = wide.initial(4, &[]);
    let variance = start[..20_000].iter().map(|w| w * w).sum::<f64>() / 20_000.0;
    assert!((variance * 150.0 - 1.0).abs() < 0.03, "{variance}");
}

#[test]
fn unit_mismatched_inputs_predict_nan() {
    let shape = NetworkShape {
        inputs: 2,
        linear: 1,
        hidden: vec![2],
        activation: ActivationFunction::Relu,
        form: NetworkForm::TrainedLinear,
    };
    let parameters = shape.initial(1, &[1.0]);
    assert!(shape.predict(&parameters, &[1.0, 2.0], &[1.0])[0].is_finite());
    assert!(shape.predict(&parameters[1..], &[1.0, 2.0], &[1.0])[0].is_nan());
    assert!(shape.predict(&parameters, &[1.0, 2.0, 3.0, 4.0], &[1.0]).iter().all(|y| y.is_nan()));
    assert!(shape.predict(&parameters, &[], &[]).is_empty());
    let predicted = shape.predict(&parameters, &[1.0, f64::NAN, 3.0, 4.0], &[1.0, 1.0]);
    assert!(predicted[0].is_nan() && predicted[1].is_finite());
}
