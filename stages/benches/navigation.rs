//! The navigation filter on 144,668 samples, as many as the flights of thesis 000 hold, with map
//! look-up and core field, and its parts by themselves.
//!
//! `cargo bench -p stages --bench navigation --profile dev` prints medians on one thread, and
//! checks that the filter found its way; with `-- sweep` behind it, of the sweep alone.

#[path = "../src/numerics/test_normals.rs"]
mod normals;
#[path = "../tests/osborne/mod.rs"]
mod osborne;

use arrow_array::{ArrayRef, Float64Array, RecordBatch};
use normals::Normals;
use osborne::{Line, core_field, grid, temporal_nt};
use schemas::{Args, Given, LineIn, Literal, StageDyn};
use stages::numerics::core_field::{CoreField, CoreModel, CoreTrack, LinearisedCoreField};
use stages::numerics::ekf::{EkfOutput, EkfParameters, run};
use stages::numerics::geodesy::EarthModel;
use stages::numerics::ins_error::{InsErrorModel, simulate_ins_error};
use stages::numerics::map_grid::{AnomalyMap, Interpolation, MapGrid};
use stages::numerics::map_stack::FieldMap;
use stages::numerics::transition::NoiseDiscretisation;
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

type Failure = Box<dyn std::error::Error + Send + Sync>;

const SAMPLES: u32 = 144_668;
const DT_S: f64 = 0.1;
const REPEATS: usize = 7;
const LOOK_UPS: usize = 2_000_000;

/// The median time on the processor, in seconds, of several runs of `work`, and the last answer.
fn median_s<T>(mut work: impl FnMut() -> T) -> (f64, T) {
    let mut answer = work();
    let mut times: Vec<f64> = (0..REPEATS)
        .map(|_| {
            let (time_s, made) = processor_s(&mut work);
            answer = made;
            time_s
        })
        .collect();
    times.sort_by(f64::total_cmp);
    (times[REPEATS / 2], answer)
}

/// A flight of four hours: its truth, its INS and its magnetometer.
struct Flight {
    truth: Line,
    ins: Line,
    measured_nt: Vec<f64>,
}

fn flight(map: &AnomalyMap, core: &CoreField) -> Result<Flight, Failure> {
    let truth = Line::flown(SAMPLES, DT_S, 0.3)?;
    let mut normals = Normals::new(11);
    let errors = simulate_ins_error(&truth.series(), &InsErrorModel::default(), || normals.draw())?;
    let mut measured_nt = Vec::with_capacity(errors.len());
    for (row, error) in errors.iter().enumerate() {
        let [lat, lon, alt] = [1, 2, 3].map(|column: usize| truth.columns[column][row]);
        let anomaly = map.at(lat, lon).ok_or("the flight leaves the map")?;
        let field = anomaly.value_nt + core.magnitude_nt(lat, lon, alt);
        measured_nt.push(field + temporal_nt(error) + 5.0 * normals.draw());
    }
    let ins = truth.with_errors(&errors);
    Ok(Flight { truth, ins, measured_nt })
}

/// Root mean square of the horizontal distance between two tracks, in metres.
fn drms_m(truth: &Line, lat_deg: &[f64], lon_deg: &[f64]) -> f64 {
    let places = truth.columns[1].iter().zip(&truth.columns[2]);
    let squares = places.zip(lat_deg.iter().zip(lon_deg)).map(|(from, to)| {
        let (from, to) = ((*from.0, *from.1), (*to.0, *to.1));
        let (north, east) = EarthModel::Wgs84.offset_ne_m(from, to, 500.0);
        north * north + east * east
    });
    (squares.sum::<f64>() / lat_deg.len() as f64).sqrt()
}

fn filter(
    map: &AnomalyMap,
    core: &CoreField,
    flight: &Flight,
    noise: NoiseDiscretisation,
) -> Result<EkfOutput, Failure> {
    let errors = InsErrorModel { noise, ..InsErrorModel::default() };
    let parameters = EkfParameters { errors, ..EkfParameters::default() };
    let field = FieldMap::Flat(map.clone());
    let (time_s, output) = median_s(|| run(&parameters, &flight.ins.series(), &flight.measured_nt, &field, Some(core)));
    let output = output?;
    let microseconds = time_s * 1e6 / f64::from(SAMPLES);
    let drms = drms_m(&flight.truth, &output.lat_deg, &output.lon_deg);
    let ins = drms_m(&flight.truth, &flight.ins.columns[1], &flight.ins.columns[2]);
    println!(
        "ekf, {:?} map, core field, {noise:?} noise: {microseconds:.2} us/step, {time_s:.3} s for {SAMPLES} steps \
         (INS {ins:.0} m, filter {drms:.1} m DRMS)",
        map.interpolation()
    );
    // A filter this good by chance is out of the question; a broken one is hundreds of metres off.
    if !(drms < 30.0 && ins > 300.0 && output.report.updates == SAMPLES as usize) {
        return Err(format!("the filter lost its way: {drms} m, {:?}", output.report).into());
    }
    Ok(output)
}

/// Places along a track, again and again.
fn places(line: &Line) -> impl Iterator<Item = (f64, f64)> {
    let track = line.columns[1].iter().copied().zip(line.columns[2].iter().copied());
    track.cycle().take(LOOK_UPS)
}

fn look_ups(map: &AnomalyMap, line: &Line) {
    let (time_s, sum) = median_s(|| {
        places(line)
            .filter_map(|(lat, lon)| map.at(lat, lon))
            .map(|field| field.value_nt + field.d_lat_nt_per_rad + field.d_lon_nt_per_rad)
            .sum::<f64>()
    });
    assert!(sum.is_finite());
    let rate = LOOK_UPS as f64 / time_s / 1e6;
    println!("map value and gradient, {:?}: {rate:.1} million/s", map.interpolation());
}

fn core_evaluations(core: &CoreField, line: &Line) {
    let few = LOOK_UPS / 10;
    let (time_s, sum) = median_s(|| {
        let values = places(line).take(few).map(|(lat, lon)| core.magnitude_nt(lat, lon, 500.0));
        values.sum::<f64>()
    });
    let mean = sum / few as f64;
    // Around Osborne: 50,900 nT in 2023.
    assert!((mean - 50_900.0).abs() < 500.0, "{mean}");
    println!("core field magnitude: {:.2} million/s", few as f64 / time_s / 1e6);
    let (time_s, _) = median_s(|| {
        let fields = places(line).take(few).map(|(lat, lon)| core.magnitude_and_gradient(lat, lon, 500.0));
        fields.map(|field| field.value_nt + field.d_lat_nt_per_rad).sum::<f64>()
    });
    println!("core field magnitude and gradient: {:.2} million/s", few as f64 / time_s / 1e6);
    let n = few.min(line.columns[1].len());
    let (lat, lon) = (&line.columns[1][..n], &line.columns[2][..n]);
    let (alt, year) = (vec![500.0; n], (0..n).map(|k| 2023.4 + 1e-9 * k as f64).collect::<Vec<_>>());
    let track = CoreTrack::new(CoreModel::Igrf14);
    let (time_s, field) =
        median_s(|| track.field(lat, lon, &alt, &year).map(|ned| ned.magnitude_nt()).unwrap_or_default());
    let mean = field.iter().sum::<f64>() / field.len() as f64;
    assert!((mean - 50_900.0).abs() < 500.0, "{mean}");
    println!(
        "core field vector and magnitude along the track, each sample's date: {:.2} million/s",
        n as f64 / time_s / 1e6
    );
    let (time_s, near) = median_s(|| {
        let mut near = LinearisedCoreField::new(core.clone());
        places(line).map(|(lat, lon)| near.magnitude_and_gradient(lat, lon, 500.0).value_nt).sum::<f64>()
    });
    assert!((near / LOOK_UPS as f64 - 50_900.0).abs() < 500.0);
    println!("the same, linearised along the track: {:.1} million/s", LOOK_UPS as f64 / time_s / 1e6);
}

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
fn map_table(grid: &MapGrid) -> Result<RecordBatch, Failure> {
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
fn sweep_points() -> Result<Vec<Arc<dyn StageDyn>>, Failure> {
    let entry = stages::catalogue().into_iter().find(|e| e.name == "navigate").ok_or("there is no `navigate`")?;
    let mut points = vec![];
    for mag in ["mag_1_c", "mag_2_c", "mag_3_c"] {
        for sigma_nt in [4.0, 5.0, 7.0] {
            for (interpolation, tau_s) in [("linear", 600.0), ("cubic", 600.0), ("cubic", 300.0)] {
                let text = |word: &str| Literal::Text(word.to_owned());
                let args: Args = [
                    ("mag", text(mag)),
                    ("map_interpolation", text(interpolation)),
                    ("measurement_sigma_nt", Literal::Float(sigma_nt)),
                    ("fogm_tau_s", Literal::Float(tau_s)),
                    ("decimal_year", Literal::Float(osborne::DECIMAL_YEAR)),
                ]
                .into_iter()
                .map(|(name, value)| (name.to_owned(), Given { value, key_at: 0..0, at: 0..0 }))
                .collect();
                points.push((entry.build)(&args).map_err(|faults| format!("{faults:?}"))?);
            }
        }
    }
    Ok(points)
}

/// A sweep of 27 points over one line, by all that the stage does.
fn sweep(grid: &MapGrid, flight: &Flight) -> Result<(), Failure> {
    let (line, map) = (sweep_line(flight)?, map_table(grid)?);
    let points = sweep_points()?;
    let mut maps = std::collections::BTreeMap::new();
    let mut lines = vec![];
    for point in &points {
        let prepared = match maps.entry(point.prepare_key()) {
            std::collections::btree_map::Entry::Occupied(made) => made.into_mut(),
            std::collections::btree_map::Entry::Vacant(place) => {
                let made = point.prepare(&[line.slice(0, 0), map.clone()]).map_err(|f| f.what)?;
                place.insert(made)
            }
        };
        let (flight, name, inputs) = ("1".to_owned(), "1".to_owned(), vec![line.clone(), map.clone()]);
        lines.push(LineIn { flight, line: name, inputs, keep: None, prepared: prepared.clone() });
    }
    let together: Vec<(&dyn StageDyn, &LineIn)> = points.iter().map(Arc::as_ref).zip(&lines).collect();
    let first = points.first().ok_or("the sweep has no point")?;
    let alone = || together.iter().map(|(point, line)| point.run(line)).collect::<Vec<_>>();
    let (mut times, mut answers) = ([const { vec![] }; 2], [vec![], vec![]]);
    for _ in 0..REPEATS {
        // In turn, so that whatever else the machine does falls on both.
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

/// The time that this thread had the processor, in seconds, for `work` (that on the clock where the system does not
/// tell), and its answer.
fn processor_s<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let on_processor_s = || -> Option<f64> {
        let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        Some(told.split_whitespace().next()?.parse::<f64>().ok()? * 1e-9)
    };
    let (clock, before) = (Instant::now(), on_processor_s());
    let answer = black_box(work());
    let time_s = before.zip(on_processor_s()).map_or_else(|| clock.elapsed().as_secs_f64(), |(a, b)| b - a);
    (time_s, answer)
}

fn main() -> Result<(), Failure> {
    let (grid, core) = (grid()?, core_field()?);
    let cubic = AnomalyMap::new(&grid, Interpolation::Cubic);
    let linear = AnomalyMap::new(&grid, Interpolation::Linear);
    let flight = flight(&cubic, &core)?;
    if std::env::args().any(|arg| arg == "sweep") {
        return sweep(&grid, &flight);
    }
    filter(&linear, &core, &flight, NoiseDiscretisation::Trapezoidal)?;
    filter(&cubic, &core, &flight, NoiseDiscretisation::Trapezoidal)?;
    filter(&linear, &core, &flight, NoiseDiscretisation::VanLoan)?;
    sweep(&grid, &flight)?;
    look_ups(&linear, &flight.truth);
    look_ups(&cubic, &flight.truth);
    core_evaluations(&core, &flight.truth);
    Ok(())
}
