//! Every navigation filter on one line of 63 minutes at 10 Hz, and SLAM on lines of up to ten hours at 1 Hz.
//!
//! `cargo bench -p magline-numerics --bench filters --profile dev` prints the processor time of a step and the position
//! error. The time is the median of three runs, on one thread. The bench rejects any filter that diverges.

#[path = "../tests/osborne/mod.rs"]
mod osborne;
mod processor;

use std::sync::Arc;

use nalgebra::Vector3;
use numerics::{
    compensation::tolles_lawson::{BodyFieldColumns, DEFAULT_SCALE_NT, TermSelection, matrix},
    earth::{attitude::body_to_ned, geodesy::EarthModel},
    maps::{
        map_stack::FieldMap,
        map_surface::{MapInterpolation, MapSurface},
    },
    navigation::{
        NavigationLine,
        adaptive::{self, AdaptiveParameters},
        aided::Aids,
        crlb::{self, TruePath},
        ekf::{self, EkfInput, EkfParameters},
        fixed_lag::{self, AircraftCoefficients, FixedLagOptions, FixedLagParameters},
        iekf::{self, IekfParameters},
        ins_error::{InsErrorModel, InsErrors, InsGrade, simulate_ins_error},
        mpf::{self, MpfParameters},
        online::{self, CoefficientPrior, Fluxgate, LineModel, OnlineParameters},
        rts::{self, RtsParameters},
        slam::{self, SlamLine, SlamParameters},
        stream::{FilterStream, InsSample, StreamEstimate, StreamMagnetometer, StreamSample, StreamSetup},
        ukf::{self, UkfParameters},
    },
    random::NormalGenerator,
    signal::gauss_markov::GaussMarkov,
};
use osborne::{Line, core_field, grid, temporal_nt};
use processor::processor_s;

type Failure = Box<dyn std::error::Error + Send + Sync>;

const SAMPLES: u32 = 37_800;
const DT_S: f64 = 0.1;
const SIGMA_NT: f64 = 5.0;
const REPEATS: usize = 3;

/// Median processor time in seconds, and the last result.
fn median_s<T, E>(mut work: impl FnMut() -> Result<T, E>) -> Result<(f64, T), E> {
    let (first_s, first) = processor_s(&mut work);
    let (mut times, mut answer) = (vec![first_s], first?);
    for _ in 1..REPEATS {
        let (time_s, made) = processor_s(&mut work);
        times.push(time_s);
        answer = made?;
    }
    times.sort_by(f64::total_cmp);
    Ok((times[REPEATS / 2], answer))
}

/// Root mean square of the horizontal error, in metres.
fn drms_m(truth: &Line, lat_deg: &[f64], lon_deg: &[f64]) -> f64 {
    let places = truth.columns[1].iter().zip(&truth.columns[2]).zip(lat_deg.iter().zip(lon_deg));
    let square = |((lat, lon), (found_lat, found_lon)): ((&f64, &f64), (&f64, &f64))| {
        let (north, east) = EarthModel::Wgs84.offset_ne_m((*lat, *lon), (*found_lat, *found_lon), 500.0);
        north * north + east * east
    };
    (places.map(square).sum::<f64>() / lat_deg.len() as f64).sqrt()
}

/// Prints a filter's time and error, and rejects an error above a limit.
fn tell(name: &str, time_s: f64, error_m: f64, most_m: f64) -> Result<(), Failure> {
    println!(
        "{name}: {:.2} us a step, {time_s:.2} s for the line, {error_m:.1} m DRMS",
        time_s * 1e6 / f64::from(SAMPLES)
    );
    if error_m < most_m { Ok(()) } else { Err(format!("{name} lost its way: {error_m} m").into()) }
}

/// A flight with manoeuvres, and the field of an aircraft of 18 Tolles-Lawson terms.
struct Flight {
    truth: Line,
    ins: Line,
    vector: [Vec<f64>; 3],
    clean_nt: Vec<f64>,
    terms: Vec<f64>,
    uncompensated_nt: Vec<f64>,
}

fn fly(map: &FieldMap, core: &numerics::earth::core_field::CoreField) -> Result<Flight, Failure> {
    let mut truth = Line::flown(SAMPLES, DT_S, 0.3)?;
    for row in 0..SAMPLES as usize {
        let t = truth.columns[0][row];
        for (column, degrees, period_s) in [(10, 10.0, 17.0), (11, 5.0, 23.0), (12, 4.0, 31.0)] {
            truth.columns[column][row] += degrees * (std::f64::consts::TAU * t / period_s).sin();
        }
    }
    let mut normals = NormalGenerator::new(1);
    let errors = simulate_ins_error(&truth.series(), &InsErrorModel::default(), || normals.draw())?;
    let (mut vector, mut clean_nt) = ([vec![], vec![], vec![]], vec![]);
    for (row, error) in errors.iter().enumerate() {
        let [lat, lon, alt, roll, pitch, yaw] = [1, 2, 3, 10, 11, 12].map(|c: usize| truth.columns[c][row]);
        let field = Vector3::from(core.field_ned_nt(lat, lon, alt));
        let turn = body_to_ned(roll.to_radians(), pitch.to_radians(), yaw.to_radians());
        let body = turn.transpose() * field;
        (0..3).for_each(|axis| vector[axis].push(body[axis]));
        let anomaly_nt = map.at(lat, lon, alt).ok_or("the flight leaves the map")?.value_nt;
        clean_nt.push(anomaly_nt + field.norm() + temporal_nt(error) + SIGMA_NT * normals.draw());
    }
    let [x, y, z] = &vector;
    let terms = matrix(&BodyFieldColumns { x, y, z, bt: None }, &TermSelection::default(), DEFAULT_SCALE_NT)?;
    let own: Vec<f64> = (0..18).map(|_| 60.0 * normals.draw()).collect();
    let aircraft = |row: &[f64]| row.iter().zip(&own).map(|(a, b)| a * b).sum::<f64>();
    let uncompensated_nt = terms.chunks_exact(18).zip(&clean_nt).map(|(row, nt)| nt + aircraft(row)).collect();
    Ok(Flight { ins: truth.with_errors(&errors), truth, vector, clean_nt, terms, uncompensated_nt })
}

fn known_field(flight: &Flight, line: &NavigationLine) -> Result<(), Failure> {
    let error = |out: &numerics::navigation::NavigationOutput| drms_m(&flight.truth, &out.lat_deg, &out.lon_deg);
    let parameters = EkfParameters { errors: line.errors, ..EkfParameters::default() };
    let point = EkfInput {
        parameters: &parameters,
        measurement_nt: line.measurement_nt,
        sigma_nt: Some(line.sigma_nt),
        fixes: None,
        map: line.map,
        core: line.core,
    };
    let (time_s, out) = median_s(|| ekf::run_together(line.ins, &[point]).remove(0))?;
    tell("ekf", time_s, error(&out), 40.0)?;
    let (time_s, out) = median_s(|| iekf::run(line, &IekfParameters::default()))?;
    tell("iekf", time_s, error(&out.line), 40.0)?;
    let (time_s, out) = median_s(|| ukf::run(&UkfParameters::default(), line))?;
    tell("ukf", time_s, error(&out.navigation), 40.0)?;
    let magnetometer = adaptive::AdaptiveMagnetometer::from_line(line, 0.25, 100.0);
    let (time_s, out) = median_s(|| adaptive::run(&AdaptiveParameters::default(), line, &[magnetometer]))?;
    tell("ekf_adaptive", time_s, error(&out.navigation), 45.0)?;
    let (time_s, out) = median_s(|| rts::run(line, &RtsParameters::default()))?;
    tell(&format!("rts, {} passes", out.iterations.passes), time_s, error(&out.line), 40.0)?;
    let [_, lat_deg, lon_deg, alt_m, ..] = flight.truth.columns.each_ref().map(Vec::as_slice);
    let path = TruePath { lat_deg, lon_deg, alt_m, velocity_ned_mps: None };
    let (time_s, out) = median_s(|| crlb::run(line, &path, false))?;
    let squares = out.sd_n_m.iter().zip(&out.sd_e_m).map(|(n, e)| n * n + e * e);
    let bound_m = (squares.sum::<f64>() / f64::from(SAMPLES)).sqrt();
    tell("crlb, the bound", time_s, bound_m, 40.0)?;
    let parameters = MpfParameters { particles: 1000, ..MpfParameters::default() };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let (time_s, out) = pool.install(|| median_s(|| mpf::run(&parameters, line, &Aids::default())))?;
    tell("mpf, 1000 particles", time_s, error(&out.track), 60.0)
}

fn unknown_aircraft(flight: &Flight, line: &NavigationLine) -> Result<(), Failure> {
    let prior = CoefficientPrior::independent(&[0.0; 18], &[80.0; 18]);
    let walk = [0.0; 18];
    let magnetometer = online::OnlineMagnetometer {
        measurement_nt: &flight.uncompensated_nt,
        sigma_nt: line.sigma_nt,
        terms: &flight.terms,
        prior: &prior,
        walk_density: &walk,
    };
    let [x, y, z] = &flight.vector;
    let terms = TermSelection::default();
    let fluxgate = Fluxgate {
        field: BodyFieldColumns { x, y, z, bt: None },
        terms: &terms,
        scale_nt: DEFAULT_SCALE_NT,
        runs: &[],
        sigma_nt: 20.0,
        tau_s: f64::INFINITY,
    };
    let keep = OnlineParameters::default();
    for (name, bias) in [("18 + 18", None), ("18 + 18 + 3", Some(&fluxgate))] {
        let (time_s, out) = median_s(|| online::run(&LineModel::from_line(line), &[magnetometer], bias, &keep))?;
        let error_m = drms_m(&flight.truth, &out.navigation.lat_deg, &out.navigation.lon_deg);
        tell(&format!("ekf_online_tl, {name} states, cold"), time_s, error_m, 80.0)?;
    }
    let coefficients = AircraftCoefficients {
        regressors: &flight.terms,
        mean: &prior.mean,
        covariance: &prior.covariance,
        walk_density: &walk,
    };
    let magnetometer = fixed_lag::FixedLagMagnetometer {
        measurement_nt: &flight.uncompensated_nt,
        sigma_nt: line.sigma_nt,
        coefficients,
        error: GaussMarkov { sigma: 0.0, tau_s: 300.0 },
    };
    let parameters = FixedLagParameters::default();
    let (time_s, out) = median_s(|| fixed_lag::run(&parameters, line, &[magnetometer], FixedLagOptions::default()))?;
    let error_m = drms_m(&flight.truth, &out.navigation.lat_deg, &out.navigation.lon_deg);
    tell("fixed_lag, 18 terms, cold", time_s, error_m, 80.0)
}

/// Feeds the line to a filter sample by sample, and rejects more than 10 µs a sample.
fn feed(flight: &Flight, name: &str, made: &FilterStream, with_terms: bool, most_m: f64) -> Result<(), Failure> {
    let (ins, readings) = (flight.ins.series(), if with_terms { &flight.uncompensated_nt } else { &flight.clean_nt });
    let mut samples = vec![];
    for (row, nt) in readings.iter().enumerate() {
        let terms = if with_terms { &flight.terms[18 * row..18 * (row + 1)] } else { &[] };
        let measurement_nt = std::slice::from_ref(nt);
        let ins = InsSample::from_series(&ins, row);
        samples.push(StreamSample { ins, measurement_nt, sigma_nt: &[SIGMA_NT], terms, fix: None });
    }
    let (time_s, track) = median_s(|| -> Result<Vec<StreamEstimate>, Failure> {
        let mut filter = made.clone();
        Ok(samples.iter().map(|sample| filter.push(sample)).collect::<Result<_, _>>()?)
    })?;
    let of = |column: fn(&StreamEstimate) -> f64| track.iter().map(column).collect::<Vec<f64>>();
    let error_m = drms_m(&flight.truth, &of(|at| at.lat_deg), &of(|at| at.lon_deg));
    tell(&format!("{name}, sample by sample"), time_s, error_m, most_m)?;
    match time_s * 1e6 / f64::from(SAMPLES) {
        each_us if each_us > 10.0 => Err(format!("{name}: a sample takes {each_us:.1} us, more than 10 us").into()),
        _ => Ok(()),
    }
}

fn streamed(
    flight: &Flight,
    map: &FieldMap,
    core: &Arc<numerics::earth::core_field::CoreField>,
) -> Result<(), Failure> {
    let setup = StreamSetup { core: Some(core.clone()), ..StreamSetup::new(Arc::new(map.clone())) };
    feed(flight, "ekf", &FilterStream::ekf(&setup, None)?, false, 40.0)?;
    let adaptive = FilterStream::adaptive(&setup, &AdaptiveParameters::default(), &[[0.25, 100.0]])?;
    feed(flight, "ekf_adaptive", &adaptive, false, 45.0)?;
    let prior = CoefficientPrior::independent(&[0.0; 18], &[80.0; 18]);
    let magnetometer = StreamMagnetometer { prior: &prior, walk_density: &[0.0; 18] };
    let online = FilterStream::online(&setup, &[magnetometer], &OnlineParameters::default())?;
    feed(flight, "ekf_online_tl, 18 + 18 states", &online, true, 80.0)
}

/// SLAM on a loiter of `seconds` seconds without a map: a circle of 1.2 km that drifts slowly.
fn slam_step(map: &FieldMap, seconds: u32, particles: usize) -> Result<f64, Failure> {
    let mut truth = Line::flown(seconds, 1.0, 0.0)?;
    let (lat, lon) = (-21.96, 140.66);
    for row in 0..seconds as usize {
        let t = row as f64;
        let angle = t * 60.0 / 1200.0;
        truth.columns[1][row] = lat + 1200.0 / 111_000.0 * angle.sin();
        truth.columns[2][row] = lon + 1200.0 / 103_000.0 * angle.cos();
        truth.columns[3][row] = 500.0;
        truth.columns[4][row] = 60.0 * angle.cos();
        truth.columns[5][row] = -60.0 * angle.sin();
        truth.columns[6][row] = 0.0;
    }
    let errors = InsErrorModel::from_sources(InsErrors { init_position_sigma_m: 1.0, ..InsGrade::Navigation.errors() });
    let mut normals = NormalGenerator::new(3);
    let drift = simulate_ins_error(&truth.series(), &errors, || normals.draw())?;
    let ins = truth.with_errors(&drift);
    let mut measurement_nt = vec![];
    for (row, error) in drift.iter().enumerate() {
        let field = map.at(truth.columns[1][row], truth.columns[2][row], 500.0).ok_or("the flight leaves the map")?;
        measurement_nt.push(field.value_nt + temporal_nt(error) + normals.draw());
    }
    let sigma_nt = vec![1.0; seconds as usize];
    let series = ins.series();
    let line = SlamLine {
        ins: &series,
        measurement_nt: &measurement_nt,
        sigma_nt: &sigma_nt,
        core: None,
        fixes: None,
        errors,
    };
    let parameters = SlamParameters { particles, ..SlamParameters::default() };
    let clock = std::time::Instant::now();
    let out = slam::run(&parameters, &line)?;
    let wall_s = clock.elapsed().as_secs_f64();
    let error_m = drms_m(&truth, &out.navigation.lat_deg, &out.navigation.lon_deg);
    let alone_m = drms_m(&truth, &ins.columns[1], &ins.columns[2]);
    println!(
        "slam, {particles} particles, {:.0} min at 1 Hz: {:.2} ms a step, {wall_s:.1} s in all; {error_m:.0} m DRMS \
         (INS {alone_m:.0} m)",
        f64::from(seconds) / 60.0,
        wall_s * 1e3 / f64::from(seconds)
    );
    Ok(wall_s / f64::from(seconds))
}

fn main() -> Result<(), Failure> {
    let (grid, core) = (grid()?, core_field()?);
    let map = FieldMap::Flat(MapSurface::new(&grid, MapInterpolation::Linear));
    let flight = fly(&map, &core)?;
    let (core, sigma_nt, ins) = (Arc::new(core), vec![SIGMA_NT; SAMPLES as usize], flight.ins.series());
    let line = NavigationLine {
        ins: &ins,
        measurement_nt: &flight.clean_nt,
        sigma_nt: &sigma_nt,
        map: &map,
        core: Some(&core),
        errors: InsErrorModel::default(),
        offset_window_s: 0.0,
        fixes: None,
        second_order: false,
    };
    println!("ins: {:.0} m DRMS", drms_m(&flight.truth, &flight.ins.columns[1], &flight.ins.columns[2]));
    known_field(&flight, &line)?;
    unknown_aircraft(&flight, &line)?;
    streamed(&flight, &map, line.core.ok_or("the line has no core field")?)?;
    slam_step(&map, 6000, 1000)?;
    let (hour, ten) = (slam_step(&map, 3600, 100)?, slam_step(&map, 36_000, 100)?);
    println!("slam, a step of ten hours to one of an hour: {:.2}", ten / hour);
    if ten > 2.0 * hour { Err("a step grows with the flight".into()) } else { Ok(()) }
}
