//! The INS of the aircraft: truth minus one realisation of the INS error.
//!
//! The errors continue from line to line of a flight. One [`FlightIns`] therefore simulates the lines of a flight in
//! order; flights are independent of each other.

use numerics::angle::wrap_deg;
use std::path::Path;

use datasets::ReadError;
use nalgebra::Vector3;
use numerics::{
    earth::attitude::{euler_rad, tilted},
    navigation::{
        ins_error::{
            InsErrorEnsemble, InsErrorFault, MechanisationErrors, NormalStreams, errors_along, horizontal_m,
            mechanised_errors_along,
        },
        ins_series::InsSeries,
        mechanisation::NavigationEarth,
        pinson::{ACC, ALT, LAT, LON, StateVector, TILT_N, VN},
    },
};

use self::{
    pause::{PauseEndpoint, between},
    spec::{InsAlignment, InsErrorPropagation, SynthIns},
};
use super::{
    random::RandomStream,
    scene::SynthLineContext,
    spec::SynthSpec,
    trajectory::{SynthFlight, TrueTrajectory},
};

mod pause;
pub(super) mod spec;

/// The columns of the INS, in their order.
pub(super) const COLUMNS: [&str; 13] = [
    "ins_lat",
    "ins_lon",
    "ins_alt",
    "ins_vn",
    "ins_ve",
    "ins_vd",
    "ins_roll",
    "ins_pitch",
    "ins_yaw",
    "ins_fn",
    "ins_fe",
    "ins_fd",
    "ins_aligned",
];

/// The INS of one flight, continued from line to line.
pub(super) struct FlightIns {
    member: usize,
    carried: Option<InsCarryover>,
    /// Time of the last alignment, in seconds; NaN before the first line.
    aligned_s: f64,
}

/// State of the INS and its errors between two lines of a flight.
struct InsCarryover {
    streams: InsRandomStreams,
    extras: MechanisationErrors,
    error: StateVector,
    place: PauseEndpoint,
}

impl FlightIns {
    /// The INS of a flight before its first line. For an ensemble, this function simulates all lines once to choose the
    /// member. One line is in memory at a time.
    ///
    /// For both methods, the realisations of an ensemble are ranked by the linear error model in steps of 1 s.
    ///
    /// # Errors
    /// Fails for a trajectory or a parameter outside the error model.
    pub(super) fn new(path: &Path, spec: &SynthSpec, flight: &SynthFlight) -> Result<FlightIns, ReadError> {
        let on = spec.components.on("ins");
        let member = if on && spec.ins.ensemble > 1 { chosen(path, spec, flight)? } else { 0 };
        Ok(FlightIns { member, carried: None, aligned_s: f64::NAN })
    }

    /// The INS output along the next line, one column for each of [`COLUMNS`]. With the component `ins` off, it equals
    /// the truth.
    ///
    /// # Errors
    /// Fails for a trajectory or a parameter outside the error model, or for an INS whose error exceeds the limit.
    pub(super) fn line(
        &mut self,
        scene: &SynthLineContext,
        truth: &TrueTrajectory,
    ) -> Result<[Vec<f64>; 13], ReadError> {
        if self.aligned_s.is_nan() || scene.spec.ins.align == InsAlignment::Line {
            self.aligned_s = truth.tt_s.first().copied().unwrap_or(f64::NAN);
        }
        if !scene.spec.components.on("ins") {
            return Ok(self.with_alignment(exact(truth)));
        }
        let wrong = |e: InsErrorFault| scene.fault(e.to_string());
        let ins = &scene.spec.ins;
        let mut state = match self.carried.take() {
            Some(carried) if ins.align == InsAlignment::Flight => carried.wait(ins, truth).map_err(wrong)?,
            _ => InsCarryover::aligned(scene, truth, self.member),
        };
        let errors = state.errors_along(ins, &series(truth)).map_err(wrong)?;
        refuse_runaway(scene, truth, &errors)?;
        if let (Some(error), Some(place)) = (errors.last(), PauseEndpoint::last(truth)) {
            (state.error, state.place) = (*error, place);
        }
        let columns = columns(truth, &errors, &state.extras);
        self.carried = Some(state);
        Ok(self.with_alignment(columns))
    }

    fn with_alignment(&self, columns: [Vec<f64>; 12]) -> [Vec<f64>; 13] {
        let rows = columns[0].len();
        let mut columns = columns.into_iter().chain([vec![self.aligned_s; rows]]);
        std::array::from_fn(|_| columns.next().unwrap_or_default())
    }
}

/// The streams of random numbers of one realisation.
struct InsRandomStreams {
    block: RandomStream,
    within: RandomStream,
}

impl InsRandomStreams {
    fn new(scene: &SynthLineContext, member: usize) -> InsRandomStreams {
        InsRandomStreams { block: stream(scene, member, "ins"), within: stream(scene, member, "ins within a second") }
    }

    fn draw<T>(&mut self, f: impl FnOnce(&mut NormalStreams) -> T) -> T {
        f(&mut NormalStreams { block: &mut || self.block.normal(), within: &mut || self.within.normal() })
    }
}

/// The random numbers of an ensemble member: one stream per flight, or per line where the INS is realigned.
fn stream(scene: &SynthLineContext, member: usize, what: &str) -> RandomStream {
    let (flight, member) = (scene.flight.name.as_str(), member.to_string());
    match scene.spec.ins.align {
        InsAlignment::Flight => RandomStream::new(scene.spec.seed, &["flight", flight, what, &member]),
        InsAlignment::Line => RandomStream::new(scene.spec.seed, &["line", flight, &scene.line.name, what, &member]),
    }
}

/// The error at the first sample after an alignment.
fn initial_error(ins: &SynthIns, truth: &TrueTrajectory, block: &mut RandomStream) -> StateVector {
    let place = PauseEndpoint::first(truth).unwrap_or_default();
    let (lat_rad, alt_m) = (place.lat_deg.to_radians(), place.alt_m);
    let mut error = ins.model.initial_error(lat_rad, alt_m, &mut || block.normal());
    ins.initial.replace(&mut error, &ins.model, lat_rad, alt_m);
    error
}

impl InsCarryover {
    fn aligned(scene: &SynthLineContext, truth: &TrueTrajectory, member: usize) -> InsCarryover {
        let ins = &scene.spec.ins;
        let mut streams = InsRandomStreams::new(scene, member);
        let mut scales = stream(scene, member, "ins scale");
        let [acc_scale, gyro_scale] = ins.scale_ppm.map(|ppm| [(); 3].map(|()| 1e-6 * ppm * scales.normal()));
        let extras = MechanisationErrors { earth: NavigationEarth::Wgs84, acc_scale, gyro_scale };
        let error = initial_error(ins, truth, &mut streams.block);
        InsCarryover { streams, extras, error, place: PauseEndpoint::default() }
    }

    /// The state at the end of the pause before a line.
    fn wait(mut self, ins: &SynthIns, next: &TrueTrajectory) -> Result<InsCarryover, InsErrorFault> {
        let next = PauseEndpoint::first(next).unwrap_or_default();
        if let Some(pause) = between(&self.place, &next) {
            let errors = self.errors_along(ins, &series(&pause))?;
            self.error = errors.last().copied().unwrap_or(self.error);
        }
        Ok(self)
    }

    fn errors_along(&mut self, ins: &SynthIns, truth: &InsSeries) -> Result<Vec<StateVector>, InsErrorFault> {
        let (start, extras) = (self.error, &self.extras);
        self.streams.draw(|draws| match ins.method {
            InsErrorPropagation::ErrorModel => errors_along(truth, &ins.model, &start, draws),
            InsErrorPropagation::Mechanisation => mechanised_errors_along(truth, &ins.model, extras, &start, draws),
        })
    }
}

/// The member of the ensemble with the requested rank.
fn chosen(path: &Path, spec: &SynthSpec, flight: &SynthFlight) -> Result<usize, ReadError> {
    let ins = &spec.ins;
    let mut blocks: Vec<RandomStream> = vec![];
    let mut ensemble = InsErrorEnsemble::new(vec![]);
    let mut before: Option<PauseEndpoint> = None;
    for line in &flight.lines {
        let scene = SynthLineContext { path, spec, flight, line };
        let truth = scene.fly();
        let advance = |ensemble: &mut InsErrorEnsemble, blocks: &mut [RandomStream], along: &TrueTrajectory, counts| {
            let normal = &mut |member: usize| blocks.get_mut(member).map_or(0.0, RandomStream::normal);
            ensemble.advance(&series(along), &ins.model, counts, normal).map_err(|e| scene.fault(e.to_string()))
        };
        match before.filter(|_| ins.align == InsAlignment::Flight).zip(PauseEndpoint::first(&truth)) {
            Some((end, start)) => {
                if let Some(pause) = between(&end, &start) {
                    advance(&mut ensemble, &mut blocks, &pause, false)?;
                }
            }
            None => {
                blocks = (0..ins.ensemble).map(|member| stream(&scene, member, "ins")).collect();
                ensemble.restart(blocks.iter_mut().map(|block| initial_error(ins, &truth, block)).collect());
            }
        }
        advance(&mut ensemble, &mut blocks, &truth, true)?;
        before = PauseEndpoint::last(&truth);
    }
    Ok(ensemble.ranked(ins.take).unwrap_or(0))
}

/// Rejects a line on which the error of the INS exceeds the limit.
fn refuse_runaway(scene: &SynthLineContext, truth: &TrueTrajectory, errors: &[StateVector]) -> Result<(), ReadError> {
    let limit_m = scene.spec.ins.error_limit_m;
    let off_m = |row: usize| horizontal_m(&errors[row], truth.lat_deg[row].to_radians(), truth.alt_m[row]);
    let beyond = |row: &usize| off_m(*row).is_nan() || off_m(*row) > limit_m;
    let Some(row) = (0..errors.len()).find(beyond) else { return Ok(()) };
    let since = truth.tt_s[row] - scene.line.start_tt_s;
    let what = format!("the INS diverges: its error is {:.0} km after {since:.0} s", off_m(row) / 1e3);
    Err(scene
        .fault(what)
        .help("shorten the flight, set `align = \"line\"`, choose a better `grade` or raise `error_limit_m`"))
}

/// INS = truth - error. For any error, latitude and longitude are valid, and the attitude is a rotation. A position
/// beyond a pole continues on the other side of the pole.
fn columns(truth: &TrueTrajectory, errors: &[StateVector], extras: &MechanisationErrors) -> [Vec<f64>; 12] {
    let mut columns: [Vec<f64>; 12] = Default::default();
    for (i, e) in errors.iter().enumerate() {
        let c = truth.attitude(i);
        let c_ins = tilted(&c, &-Vector3::new(e[TILT_N], e[TILT_N + 1], e[TILT_N + 2]));
        let f = c.transpose() * Vector3::from_fn(|k, _| truth.force_mps2[k][i]);
        // The error of the accelerometers is also truth minus measurement.
        let f_ins = c_ins * Vector3::from_fn(|k, _| f[k] * (1.0 - extras.acc_scale[k]) - e[ACC + k]);
        let (roll, pitch, yaw) = euler_rad(&c_ins);
        let (lat_deg, lon_deg) =
            on_the_globe(truth.lat_deg[i] - e[LAT].to_degrees(), truth.lon_deg[i] - e[LON].to_degrees());
        let row = [
            lat_deg,
            lon_deg,
            truth.alt_m[i] - e[ALT],
            truth.velocity_mps[0][i] - e[VN],
            truth.velocity_mps[1][i] - e[VN + 1],
            truth.velocity_mps[2][i] - e[VN + 2],
            roll.to_degrees(),
            pitch.to_degrees(),
            yaw.to_degrees(),
            f_ins.x,
            f_ins.y,
            f_ins.z,
        ];
        columns.iter_mut().zip(row).for_each(|(column, x)| column.push(x));
    }
    columns
}

/// An INS without errors: the truth, bit-identical.
fn exact(truth: &TrueTrajectory) -> [Vec<f64>; 12] {
    let series = series(truth);
    [
        series.lat_deg,
        series.lon_deg,
        series.alt_m,
        series.vn_mps,
        series.ve_mps,
        series.vd_mps,
        series.roll_deg,
        series.pitch_deg,
        series.yaw_deg,
        series.fn_mps2,
        series.fe_mps2,
        series.fd_mps2,
    ]
    .map(<[f64]>::to_vec)
}

/// Converts angles of any size to a latitude (-90 to 90) and a longitude (-180 to 180), in degrees.
fn on_the_globe(lat_deg: f64, lon_deg: f64) -> (f64, f64) {
    if lat_deg.abs() <= 90.0 {
        return (lat_deg, wrap_deg(lon_deg));
    }
    let round = (lat_deg + 90.0).rem_euclid(360.0);
    if round <= 180.0 { (round - 90.0, wrap_deg(lon_deg)) } else { (270.0 - round, wrap_deg(lon_deg + 180.0)) }
}

fn series(truth: &TrueTrajectory) -> InsSeries<'_> {
    let TrueTrajectory { tt_s, lat_deg, lon_deg, alt_m, velocity_mps, force_mps2, attitude_deg, .. } = truth;
    let ([vn, ve, vd], [f_n, f_e, f_d], [roll, pitch, yaw]) = (velocity_mps, force_mps2, attitude_deg);
    InsSeries::from_columns([tt_s, lat_deg, lon_deg, alt_m, vn, ve, vd, f_n, f_e, f_d, roll, pitch, yaw])
}

#[cfg(test)]
mod tests;
