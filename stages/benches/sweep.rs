//! The stage `navigate` at 27 points of a sweep over one line: each alone, and all together.
//!
//! `cargo bench -p magline-stages --bench sweep --profile dev` prints medians on one thread, and checks that both give
//! the same to the last bit.

#[allow(dead_code, reason = "a sweep is not held against the truth")]
#[path = "../numerics/tests/osborne/flight.rs"]
mod flight;
#[path = "../numerics/tests/osborne/mod.rs"]
mod osborne;
#[path = "../numerics/benches/processor/mod.rs"]
mod processor;

use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, RecordBatch};
use flight::{Flight, flight};
use numerics::maps::map_surface::{GeographicGrid, MapInterpolation, MapSurface};
use osborne::{core_field, grid};
use processor::processor_s;
use schemas::{AnyLinePoint, AnyStage, LineInput, LineStageDyn, Literal, SpecEntries, SpecEntry};

type Failure = Box<dyn std::error::Error + Send + Sync>;

const REPEATS: usize = 7;
/// Samples of the line of the sweep.
const SWEEP_SAMPLES: usize = 20_000;

/// A table of number columns.
fn table(columns: Vec<(&str, Vec<f64>)>) -> Result<RecordBatch, Failure> {
    let arrays = columns.into_iter().map(|(name, values)| (name, Arc::new(Float64Array::from(values)) as ArrayRef));
    Ok(RecordBatch::try_from_iter(arrays)?)
}

/// The line of the sweep: the INS of the flight's first samples, and three magnetometers.
fn sweep_line(flight: &Flight) -> Result<RecordBatch, Failure> {
    let names = [
        "tt",
        "ins_lat",
        "ins_lon",
        "ins_alt",
        "ins_vn",
        "ins_ve",
        "ins_vd",
        "ins_fn",
        "ins_fe",
        "ins_fd",
        "ins_roll",
        "ins_pitch",
        "ins_yaw",
    ];
    let ins = names.into_iter().zip(&flight.ins.columns);
    let mut columns: Vec<(&str, Vec<f64>)> = ins.map(|(n, c)| (n, c[..SWEEP_SAMPLES].to_vec())).collect();
    for (name, shift_nt) in [("mag_1_c", 0.0), ("mag_2_c", 1.0), ("mag_3_c", -2.0)] {
        let measured = flight.measured_nt[..SWEEP_SAMPLES].iter().enumerate();
        columns.push((name, measured.map(|(row, nt)| nt + shift_nt * (0.01 * row as f64).sin()).collect()));
    }
    table(columns)
}

/// The map as a table of nodes.
fn map_table(grid: &GeographicGrid) -> Result<RecordBatch, Failure> {
    let (lat, lon) = (grid.lat(), grid.lon());
    let nodes = || (0..lat.len()).flat_map(|row| (0..lon.len()).map(move |column| (row, column)));
    table(vec![
        ("lat", nodes().map(|(row, _)| lat.first_deg() + lat.step_deg() * row as f64).collect()),
        ("lon", nodes().map(|(_, column)| lon.first_deg() + lon.step_deg() * column as f64).collect()),
        ("alt", vec![500.0; grid.values().len()]),
        ("anomaly", grid.values().to_vec()),
    ])
}

/// The 27 points: three magnetometers, three noises, and two maps with the second at two time constants.
fn sweep_points() -> Result<Vec<AnyStage>, Failure> {
    let entry = stages::catalogue().into_iter().find(|e| e.name == "navigate").ok_or("there is no `navigate`")?;
    let mut points = vec![];
    for mag in ["mag_1_c", "mag_2_c", "mag_3_c"] {
        for sigma_nt in [4.0, 5.0, 7.0] {
            for (interpolation, tau_s) in [("linear", 600.0), ("cubic", 600.0), ("cubic", 300.0)] {
                let text = |word: &str| Literal::Text(word.to_owned());
                let args: SpecEntries = [
                    ("mag", text(mag)),
                    ("map_interpolation", text(interpolation)),
                    ("measurement_sigma_nt", Literal::Float(sigma_nt)),
                    ("fogm_tau_s", Literal::Float(tau_s)),
                    ("decimal_year", Literal::Float(osborne::DECIMAL_YEAR)),
                ]
                .into_iter()
                .map(|(name, value)| (name.to_owned(), SpecEntry { value, key_at: 0..0, at: 0..0 }))
                .collect();
                points.push((entry.build)(&args).map_err(|faults| format!("{faults:?}"))?);
            }
        }
    }
    Ok(points)
}

/// A sweep of 27 points over one line, by all that the stage does.
fn sweep(grid: &GeographicGrid, flight: &Flight) -> Result<(), Failure> {
    let (line, map) = (sweep_line(flight)?, map_table(grid)?);
    let points = sweep_points()?;
    let points: Vec<&dyn LineStageDyn> =
        points.iter().map(|point| point.of_lines().map_err(|f| f.what)).collect::<Result<_, _>>()?;
    let mut maps = std::collections::BTreeMap::new();
    let (mut lines, mut ready) = (vec![], vec![]);
    for point in &points {
        let prepared = match maps.entry(point.prepare_key()) {
            std::collections::btree_map::Entry::Occupied(made) => made.into_mut(),
            std::collections::btree_map::Entry::Vacant(place) => {
                let made = point.prepare(&[line.slice(0, 0), map.clone()]).map_err(|f| f.what)?;
                place.insert(made)
            }
        };
        let (flight, name, inputs) = ("1".to_owned(), "1".to_owned(), vec![line.clone(), map.clone()]);
        lines.push(LineInput { flight, line: name, inputs, keep: None });
        ready.push(prepared.clone());
    }
    let each = points.iter().zip(&lines).zip(&ready);
    let together: Vec<AnyLinePoint> =
        each.map(|((stage, line), prepared)| AnyLinePoint { stage: *stage, line, prepared }).collect();
    let first = points.first().ok_or("the sweep has no point")?;
    let alone = || together.iter().map(|point| point.stage.run(point.line, point.prepared)).collect::<Vec<_>>();
    let (mut times, mut answers) = ([const { vec![] }; 2], [vec![], vec![]]);
    for _ in 0..REPEATS {
        // In turn, so that other load of the machine falls on both.
        let (alone_s, one) = processor_s(alone);
        let (together_s, all) = processor_s(|| first.run_points(&together));
        times[0].push(alone_s);
        times[1].push(together_s);
        answers = [one, all];
    }
    let [alone_s, together_s] = times.map(|mut times| {
        times.sort_by(f64::total_cmp);
        times[REPEATS / 2]
    });
    let each_us = |time_s: f64| time_s * 1e6 / (points.len() * SWEEP_SAMPLES) as f64;
    println!(
        "sweep of {} points over {SWEEP_SAMPLES} samples, us of the processor a step and point: alone {:.2}, together \
         {:.2}, {:.2} times as fast",
        points.len(),
        each_us(alone_s),
        each_us(together_s),
        alone_s / together_s
    );
    let [alone, together] = answers;
    for (one, all) in alone.into_iter().zip(together) {
        let (one, all) = (one.map_err(|f| f.what)?, all.map_err(|f| f.what)?);
        if one != all {
            return Err("a point alone and in company are not the same".into());
        }
    }
    Ok(())
}

fn main() -> Result<(), Failure> {
    let (grid, core) = (grid()?, core_field()?);
    let map = MapSurface::new(&grid, MapInterpolation::Cubic);
    let flight = flight(&map, &core, SWEEP_SAMPLES as u32)?;
    sweep(&grid, &flight)
}
