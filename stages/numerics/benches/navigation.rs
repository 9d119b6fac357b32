//! The navigation filter on 144,668 samples, the number of the flights of Gnadt 2022, with map look-up and core field,
//! and each part separately.
//!
//! `cargo bench -p magline-numerics --bench navigation --profile dev` prints medians on one thread, and checks the
//! position error of the filter.

#[path = "../tests/osborne/flight.rs"]
mod flight;
#[path = "../tests/osborne/mod.rs"]
mod osborne;
mod processor;

use flight::{Flight, flight};
use numerics::{
    earth::{
        core_field::{CoreField, CoreFieldModel, CoreFieldTrack, LinearisedCoreField},
        geodesy::EarthModel,
    },
    maps::{
        map_stack::FieldMap,
        map_surface::{MapInterpolation, MapSurface},
    },
    navigation::{
        ekf::{EkfParameters, run},
        ins_error::InsErrorModel,
        output::NavigationOutput,
        transition::NoiseDiscretisation,
    },
};
use osborne::{Line, core_field, grid};
use processor::processor_s;

type Failure = Box<dyn std::error::Error + Send + Sync>;

const SAMPLES: u32 = 144_668;
const REPEATS: usize = 7;
const LOOK_UPS: usize = 2_000_000;

/// Median processor time, in seconds, of several runs of `work`, and the last result.
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
    map: &MapSurface,
    core: &CoreField,
    flight: &Flight,
    noise: NoiseDiscretisation,
) -> Result<NavigationOutput, Failure> {
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
    // A filter cannot be this accurate by chance; the error of a faulty filter is hundreds of metres.
    if !(drms < 30.0 && ins > 300.0 && output.report.updates == SAMPLES as usize) {
        return Err(format!("the filter lost its way: {drms} m, {:?}", output.report).into());
    }
    Ok(output)
}

/// Positions along a track, repeated cyclically.
fn places(line: &Line) -> impl Iterator<Item = (f64, f64)> {
    let track = line.columns[1].iter().copied().zip(line.columns[2].iter().copied());
    track.cycle().take(LOOK_UPS)
}

fn look_ups(map: &MapSurface, line: &Line) {
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
    let track = CoreFieldTrack::new(CoreFieldModel::Igrf14);
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

fn main() -> Result<(), Failure> {
    let (grid, core) = (grid()?, core_field()?);
    let cubic = MapSurface::new(&grid, MapInterpolation::Cubic);
    let linear = MapSurface::new(&grid, MapInterpolation::Linear);
    let flight = flight(&cubic, &core, SAMPLES)?;
    filter(&linear, &core, &flight, NoiseDiscretisation::Trapezoidal)?;
    filter(&cubic, &core, &flight, NoiseDiscretisation::Trapezoidal)?;
    filter(&linear, &core, &flight, NoiseDiscretisation::VanLoan)?;
    look_ups(&linear, &flight.truth);
    look_ups(&cubic, &flight.truth);
    core_evaluations(&core, &flight.truth);
    Ok(())
}
