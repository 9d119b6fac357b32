#![allow(clippy::unwrap_used)]
use arrow_array::{ArrayRef, Float64Array, cast::AsArray, types::Float64Type};
use schemas::{AnyLinePoint, AnySharedData, AnyStage, LineInput, LineStageDyn, Literal, SpecEntries, SpecEntry};

use super::*;

const ROWS: i32 = 300;

fn table(columns: Vec<(&str, Vec<f64>)>) -> RecordBatch {
    let arrays = columns.into_iter().map(|(name, values)| (name, Arc::new(Float64Array::from(values)) as ArrayRef));
    RecordBatch::try_from_iter(arrays).unwrap()
}

fn map_table() -> RecordBatch {
    let nodes = || (0..40).flat_map(|row| (0..40).map(move |column| (f64::from(row), f64::from(column))));
    table(vec![
        ("lat", nodes().map(|(row, _)| 45.0 + 0.001 * row).collect()),
        ("lon", nodes().map(|(_, column)| -75.0 + 0.001 * column).collect()),
        ("alt", vec![300.0; 1600]),
        ("anomaly", nodes().map(|(row, column)| 50.0 * (0.5 * row).sin() + 40.0 * (0.4 * column).cos()).collect()),
    ])
}

/// A line with three measurements: the second has a gap, and the third has no values.
fn line(north_deg: f64) -> RecordBatch {
    let of = |f: &dyn Fn(f64) -> f64| (0..ROWS).map(|k| f(f64::from(k))).collect::<Vec<f64>>();
    table(vec![
        ("tt", of(&|k| 0.1 * k)),
        ("ins_lat", of(&|k| 45.005 + 5e-5 * k + north_deg)),
        ("ins_lon", of(&|k| -74.99 + 6e-5 * k)),
        ("ins_alt", of(&|k| 300.0 + (0.02 * k).sin())),
        ("mag_1_c", of(&|k| 30.0 * (0.05 * k).sin())),
        ("mag_2_c", of(&|k| if (100.0..130.0).contains(&k) { f64::NAN } else { 25.0 * (0.04 * k).cos() })),
        ("mag_3_c", of(&|_| f64::NAN)),
    ])
}

fn point(params: &[(&str, Literal)]) -> AnyStage {
    let given = [
        ("tuning", Literal::Text("magnav".into())),
        ("core_field", Literal::Bool(false)),
        ("save_state", Literal::Bool(true)),
    ];
    let args: SpecEntries = given
        .iter()
        .chain(params)
        .map(|(name, value)| ((*name).to_owned(), SpecEntry { value: value.clone(), key_at: 0..0, at: 0..0 }))
        .collect();
    (super::super::entry(super::super::FILTERS.to_vec()).build)(&args).unwrap()
}

fn on(line: &RecordBatch) -> LineInput {
    LineInput { flight: "1".into(), line: "1.01".into(), inputs: vec![line.clone(), line.slice(0, 0)], keep: None }
}

/// The values of a result as bits, and its text values.
fn content(arrays: &[ArrayRef]) -> Vec<String> {
    let one = |array: &ArrayRef| {
        let items = array.as_fixed_size_list_opt().map(|list| list.values().clone());
        let array = items.as_ref().unwrap_or(array);
        match array.as_primitive_opt::<Float64Type>() {
            Some(numbers) => format!("{:x?}", numbers.values().iter().map(|x| x.to_bits()).collect::<Vec<_>>()),
            None => format!("{:?}", array.as_string::<i32>()),
        }
    };
    arrays.iter().map(one).collect()
}

#[test]
fn unit_points_together_give_the_same_results_as_alone() {
    let text = |word: &str| Literal::Text(word.to_owned());
    let points = [
        point(&[("mag", text("mag_1_c"))]),
        point(&[("mag", text("mag_2_c")), ("map_interpolation", text("cubic"))]),
        point(&[("mag", text("mag_3_c"))]),
        point(&[("mag", text("mag_1_c")), ("measurement_sigma_nt", Literal::Float(9.0))]),
        point(&[("mag", text("mag_2_c")), ("acc_tau_s", Literal::Float(1000.0)), ("gate_nis", Literal::Float(0.5))]),
        point(&[("mag", text("mag_1_c")), ("discretisation", text("van_loan"))]),
        point(&[("mag", text("absent"))]),
        point(&[("mag", text("mag_1_c")), ("offset_window_s", Literal::Float(2.0))]),
    ];
    let (here, there) = (line(0.0), line(0.0005));
    let mut lines: Vec<LineInput> = points.iter().map(|_| on(&here)).collect();
    // Three points that differ: in the INS, in the memory that holds equal values, and in the stage that computes the
    // map.
    lines[3] = on(&there);
    lines[7] = on(&line(0.0));
    lines.push(lines[0].clone());
    let stages: Vec<&dyn LineStageDyn> = points.iter().chain([&points[0]]).map(|p| p.of_lines().unwrap()).collect();
    let nodes = [here.slice(0, 0), map_table()];
    let mut prepared: Vec<AnySharedData> = stages.iter().map(|stage| stage.prepare(&nodes).unwrap()).collect();
    prepared[8] = Arc::new(());
    let each = stages.iter().zip(&lines).zip(&prepared);
    let together: Vec<AnyLinePoint> =
        each.map(|((stage, line), prepared)| AnyLinePoint { stage: *stage, line, prepared }).collect();
    let answers = stages[0].run_points(&together);
    assert_eq!(answers.len(), 9);
    let mut faults = vec![];
    for (point, answer) in together.iter().zip(answers) {
        match (point.stage.run(point.line, point.prepared), answer) {
            (Ok(alone), Ok(answer)) => assert!(content(&alone) == content(&answer)),
            (Err(alone), Err(answer)) => {
                assert_eq!(alone.what, answer.what);
                faults.push(answer.what);
            }
            (alone, answer) => panic!("{alone:?} {answer:?}"),
        }
    }
    let expected = [
        "no sample could be used: 300 without a measurement",
        "the line has no column",
        "the data belong to another stage",
    ];
    assert!(
        faults.iter().zip(expected).all(|(fault, words)| fault.starts_with(words)) && faults.len() == 3,
        "{faults:?}"
    );
}

#[test]
fn unit_equal_columns_are_one_ins() {
    let (one, other) = (line(0.0), line(0.0));
    assert!(ins::same(&one, &one.clone()) && ins::same(&one, &other));
    assert!(!ins::same(&one, &line(1e-12)) && !ins::same(&one, &one.slice(0, 299)));
    assert!(!ins::same(&one, &one.project(&[0, 1, 2]).unwrap()), "a height is missing");
}
