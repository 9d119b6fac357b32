#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod against_others;
mod by_closed_form;
mod fields;
mod heights;
mod laws;

use crate::maps::plane_grid::{EvenAxis, PlaneGrid};

/// Map whose values are a function of row and column, both counted from 1.
fn formula(rows: usize, columns: usize, steps: [f64; 2], value: impl Fn(f64, f64) -> f64) -> PlaneGrid {
    let values = (0..rows * columns).map(|i| value((i / columns + 1) as f64, (i % columns + 1) as f64)).collect();
    let axis = |len, step| EvenAxis { first: 1000.0, step, len };
    PlaneGrid { east_m: axis(columns, steps[0]), north_m: axis(rows, steps[1]), values }
}

fn worst(ours: &[f64], theirs: &[f64]) -> f64 {
    assert_eq!(ours.len(), theirs.len());
    ours.iter().zip(theirs).map(|(a, b)| (a - b).abs()).fold(0.0, |m, d| if d > m || d.is_nan() { d } else { m })
}
