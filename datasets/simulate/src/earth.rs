//! The earth's field along a track: core field, crustal field and temporal variation, each a vector.
//!
//! A core model gives the core field at the date of every sample. A map, sources in the ground, or both give the
//! crustal field; see [`crustal`] and [`buried`]. The temporal variation is in [`variation`].

use buried::{LocalFrameSource, field_ned_nt};
use crustal::{CrustalCoverageError, CrustalMap, change_of_magnitude};
use datasets::{ReadError, read_map};
use nalgebra::Vector3;
use numerics::earth::{
    core_field::{CoreField, CoreFieldTrack},
    dates::decimal_year,
};
use observatory::ObservatoryVariation;
use places::OffsetTrack;

use super::{scene::SynthLineContext, spec::SynthSpec, trajectory::TrueTrajectory};
pub use spec::{BuriedBody, BuriedSource, Diurnal, Pulsations, Storm, SynthEarth};
use variation::{TemporalVariation, VariationPoints};

mod buried;
mod crustal;
mod observatory;
mod places;
pub(super) mod spec;
mod variation;

/// The data that all lines share: the map's field, the sources, the observatory's record. Several lines may query the
/// field concurrently; the results do not depend on the order of queries.
pub(super) struct EarthFieldModel {
    core: CoreFieldTrack,
    map: Option<CrustalMap>,
    sources: Vec<LocalFrameSource>,
    observatory: Option<ObservatoryVariation>,
}

impl EarthFieldModel {
    /// Reads and prepares the components that are switched on.
    ///
    /// # Errors
    /// Fails for a map that cannot be read or is not level, a record that cannot be read, or a date that the core model
    /// does not cover.
    pub(super) fn new(spec_path: &std::path::Path, spec: &SynthSpec) -> Result<EarthFieldModel, ReadError> {
        let wrong = |e: &dyn std::fmt::Display| ReadError::options(spec_path, e.to_string());
        let (earth, (year, doy)) = (&spec.earth, spec.date);
        let date = decimal_year(year, doy, 0.0).map_err(|e| wrong(&e))?;
        let at_date = CoreField::new(earth.core, date).map_err(|e| wrong(&e))?;
        let core = CoreFieldTrack::new(earth.core);
        let anomaly = spec.components.on("anomaly");
        let map = match earth.map.as_ref().filter(|_| anomaly) {
            Some((path, options)) => Some(CrustalMap::new(path, &read_map(path, options)?, &core, date)?),
            None => None,
        };
        let sources = earth.sources.iter().filter(|_| anomaly).map(|s| LocalFrameSource::new(s, &at_date)).collect();
        let record = earth.diurnal.observatory.as_ref().filter(|_| spec.components.on("diurnal"));
        let observatory = match record {
            Some((path, quiet_base)) => Some(ObservatoryVariation::read(path, *quiet_base)?),
            None => None,
        };
        Ok(EarthFieldModel { core, map, sources, observatory })
    }
}

/// The earth's field along a line, in nT; vectors are north, east, down unless stated otherwise.
#[derive(Clone, Debug, Default)]
pub(super) struct LineEarthField {
    /// The core field.
    pub(super) core_ned_nt: Vec<Vector3<f64>>,
    /// The crustal field.
    pub(super) anomaly_ned_nt: Vec<Vector3<f64>>,
    /// The temporal variation.
    pub(super) diurnal_ned_nt: Vec<Vector3<f64>>,
    /// The magnitude of the core field.
    pub(super) core_nt: Vec<f64>,
    /// The temporal variation along the core field, as a base station records it.
    pub(super) diurnal_nt: Vec<f64>,
    /// The change that the crustal field causes in the magnitude of the core field.
    pub(super) anomaly_nt: Vec<f64>,
    /// The whole field in the body frame.
    pub(super) body_nt: Vec<Vector3<f64>>,
    /// The rate of change of the whole field in the body frame, in nT/s.
    pub(super) body_rate_ntps: Vec<Vector3<f64>>,
}

/// Half of the interval over which the field is differenced along the track, in seconds.
const STEP_S: f64 = 1e-3;

/// The earth's field along a line: the exact sum of its three vectors, and its rate.
///
/// The rate in the body frame is Cᵀ dB/dt − ω × (Cᵀ B). C is the attitude and ω the exact angular rate of the body
/// relative to north-east-down. dB/dt = (v·∇)B + ∂B/∂t is the rate of the components north, east and down. The rate is
/// computed from the field 1 ms ahead and 1 ms behind on the tangent of the track, so it does not depend on the sample
/// rate of the flight. The relative error of the difference is (k v h)²/6 at the wavenumber k: 1e-6 for 150 m at 60
/// m/s. The core field's secular variation, below 1e-5 nT/s, is not included in the rate.
///
/// # Errors
/// Fails for a line that leaves the known part of the map, descends below the map or crosses a source, for a time
/// without a value of the observatory, or for a date that the core model does not cover.
pub(super) fn along(
    scene: &SynthLineContext,
    truth: &TrueTrajectory,
    field: &EarthFieldModel,
) -> Result<LineEarthField, ReadError> {
    let [core_ned_nt, anomaly_ned_nt, diurnal_ned_nt] = parts(scene, truth, field, 0.0)?;
    let rates_ned_ntps = rates(scene, truth, field)?;
    let mut out = LineEarthField { core_ned_nt, anomaly_ned_nt, diurnal_ned_nt, ..LineEarthField::default() };
    for (i, rate_ned_ntps) in rates_ned_ntps.iter().enumerate() {
        let (core, anomaly, diurnal) = (out.core_ned_nt[i], out.anomaly_ned_nt[i], out.diurnal_ned_nt[i]);
        let magnitude = core.norm();
        out.core_nt.push(magnitude);
        out.diurnal_nt.push(core.dot(&diurnal) / magnitude);
        out.anomaly_nt.push(change_of_magnitude(&core, &anomaly));
        let body_nt = truth.attitude(i).transpose() * (core + anomaly + diurnal);
        out.body_rate_ntps.push(truth.rate_in_body(i, rate_ned_ntps, &body_nt));
        out.body_nt.push(body_nt);
    }
    Ok(out)
}

/// Core field, crustal field and temporal variation (north, east, down; nT) at the point of the body at `arm_m` (nose,
/// right, down; m) from the INS.
///
/// # Errors
/// Fails in the cases of [`along`].
pub(super) fn at_arm(
    scene: &SynthLineContext,
    truth: &TrueTrajectory,
    field: &EarthFieldModel,
    arm_m: &Vector3<f64>,
) -> Result<[Vec<Vector3<f64>>; 3], ReadError> {
    parts(scene, &truth.at_arm(arm_m), field, 0.0)
}

/// The rate of the field's components north, east and down along the track, in nT/s.
fn rates(
    scene: &SynthLineContext,
    truth: &TrueTrajectory,
    field: &EarthFieldModel,
) -> Result<Vec<Vector3<f64>>, ReadError> {
    let whole = |by_s: f64| -> Result<Vec<Vector3<f64>>, ReadError> {
        let [core, anomaly, diurnal] = parts(scene, truth, field, by_s)?;
        Ok(core.iter().zip(anomaly).zip(diurnal).map(|((core, anomaly), diurnal)| core + anomaly + diurnal).collect())
    };
    let (behind, ahead) = (whole(-STEP_S)?, whole(STEP_S)?);
    Ok(ahead.iter().zip(behind).map(|(ahead, behind)| (ahead - behind) / (2.0 * STEP_S)).collect())
}

/// Core field, crustal field and temporal variation (north, east, down; nT) at the position that is `by_s` seconds
/// ahead on the tangent of the track.
fn parts(
    scene: &SynthLineContext,
    truth: &TrueTrajectory,
    field: &EarthFieldModel,
    by_s: f64,
) -> Result<[Vec<Vector3<f64>>; 3], ReadError> {
    let at = OffsetTrack::from_truth(truth, by_s);
    let core_ned_nt = core(scene, field, &at)?;
    let anomaly_ned_nt = anomaly(scene, field, &at, &core_ned_nt)?;
    let diurnal_ned_nt = diurnal(scene, field, &at, &core_ned_nt)?;
    Ok([core_ned_nt, anomaly_ned_nt, diurnal_ned_nt])
}

/// The core field at the dates of the samples.
fn core(scene: &SynthLineContext, field: &EarthFieldModel, at: &OffsetTrack) -> Result<Vec<Vector3<f64>>, ReadError> {
    let (year, doy) = scene.spec.date;
    let dates: Result<Vec<f64>, _> = at.own.tt_s.iter().map(|tt| decimal_year(year, doy, *tt)).collect();
    let dates = dates.map_err(|e| scene.fault(e.to_string()))?;
    let ned = field.core.field(&at.lat_deg, &at.lon_deg, &at.alt_m, &dates);
    let ned = ned.map_err(|e| scene.fault(e.to_string()))?;
    let both = ned.north_nt.iter().zip(&ned.east_nt).zip(&ned.down_nt);
    Ok(both.map(|((north, east), down)| Vector3::new(*north, *east, *down)).collect())
}

fn anomaly(
    scene: &SynthLineContext,
    field: &EarthFieldModel,
    at: &OffsetTrack,
    core_ned_nt: &[Vector3<f64>],
) -> Result<Vec<Vector3<f64>>, ReadError> {
    let (lat, lon, alt) = (&at.lat_deg, &at.lon_deg, &at.alt_m);
    let mut out = match &field.map {
        None => vec![Vector3::zeros(); alt.len()],
        Some(map) => match map.along(at.own.places(), &at.moved, core_ned_nt)? {
            Ok(found) => found,
            Err(nowhere) => return Err(off_the_map(scene, at.own, map, nowhere)),
        },
    };
    if !field.sources.is_empty() {
        for (i, sum) in out.iter_mut().enumerate() {
            *sum += field_ned_nt(&field.sources, lat[i], lon[i], alt[i]);
        }
    }
    match out.iter().position(|b| !b.iter().all(|x| x.is_finite())) {
        None => Ok(out),
        Some(i) => {
            let what = format!("the line goes through a source at {:.5}, {:.5}, {} m", lat[i], lon[i], at.own.alt_m[i]);
            Err(scene.fault(what).help("place the source deeper or raise `alt_m` of the line"))
        }
    }
}

fn off_the_map(
    scene: &SynthLineContext,
    truth: &TrueTrajectory,
    map: &CrustalMap,
    nowhere: CrustalCoverageError,
) -> ReadError {
    match nowhere {
        CrustalCoverageError::Off(i) => {
            let since = truth.tt_s[i] - truth.tt_s[0];
            let (lat, lon) = (truth.lat_deg[i], truth.lon_deg[i]);
            scene
                .fault(format!("the line leaves the known part of the map after {since:.1} s, at {lat:.5}, {lon:.5}"))
                .help("move the waypoints inwards or shorten the line")
        }
        CrustalCoverageError::Below(i) => {
            let (level_m, alt_m) = (map.level_m(), truth.alt_m[i]);
            scene
                .fault(format!("the map's height ({level_m} m) is above the line's height ({alt_m} m)"))
                .help("raise `alt_m` of the line to the map's height or above")
        }
    }
}

fn diurnal(
    scene: &SynthLineContext,
    field: &EarthFieldModel,
    at: &OffsetTrack,
    core_ned_nt: &[Vector3<f64>],
) -> Result<Vec<Vector3<f64>>, ReadError> {
    if !scene.spec.components.on("diurnal") {
        return Ok(vec![Vector3::zeros(); core_ned_nt.len()]);
    }
    let starts = scene.flight.lines.iter().map(|line| line.start_tt_s);
    let variation = TemporalVariation {
        diurnal: &scene.spec.earth.diurnal,
        observatory: field.observatory.as_ref(),
        seed: scene.spec.seed,
        flight: &scene.flight.name,
        start_tt_s: starts.fold(f64::INFINITY, f64::min),
    };
    let (tt_s, lat_deg, lon_deg) = (&at.tt_s, &at.lat_deg, &at.lon_deg);
    variation.along(&VariationPoints { tt_s, lat_deg, lon_deg, core_ned_nt }).map_err(|what| {
        scene.fault(what).help("move the flight to a time that the record covers, or use another record")
    })
}

#[cfg(test)]
mod tests;
