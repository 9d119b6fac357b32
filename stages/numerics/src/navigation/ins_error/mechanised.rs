//! INS errors along a trajectory by mechanising faulty readings.

use crate::angle::wrap_rad;
use nalgebra::Vector3;

use super::along::steps_s;
use super::driving::{DrivingNoise, NormalStreams, blocks};
use super::{InsErrorFault, InsErrorModel};
use crate::earth::attitude::{body_to_ned, tilt_between, tilted};
use crate::navigation::ins_series::InsSeries;
use crate::navigation::mechanisation::{
    IdealImu, ImuErrors, ImuReading, Mechanisation, NavigationEarth, NavigationState, quaternion,
};
use crate::navigation::pinson::{A_HAT, ACC, ALT, GYRO, HA, LAT, LON, S, STATES, StateVector, TILT_N, VN};
use crate::signal::gauss_markov::GaussMarkov;

/// Error sources of the mechanisation that the error model does not contain.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MechanisationErrors {
    /// Earth model of the mechanisation.
    pub earth: NavigationEarth,
    /// Relative scale errors of the accelerometers x, y, z, truth minus measurement.
    pub acc_scale: [f64; 3],
    /// Relative scale errors of the gyroscopes x, y, z, truth minus measurement.
    pub gyro_scale: [f64; 3],
}

/// Mechanised errors, with the same realisation as [`errors_along`](super::errors_along) for the same draws. Errors are
/// added to error-free readings of the trajectory, and a barometer-aided strapdown mechanisation integrates them. The
/// error is the exact motion minus the result.
///
/// The exact motion is the error-free mechanisation of the error-free readings. The position of the mechanisation
/// differs from the position of the trajectory by the error of the trapezoidal rule, which cancels in the result.
///
/// # Errors
/// Returns the errors of [`InsErrorModel::check`] and [`InsSeries::check`].
pub fn mechanised_errors_along(
    truth: &InsSeries<'_>,
    model: &InsErrorModel,
    extras: &MechanisationErrors,
    start: &StateVector,
    draws: &mut NormalStreams<'_>,
) -> Result<Vec<StateVector>, InsErrorFault> {
    model.check()?;
    truth.check()?;
    let driving = DrivingNoise::new(model);
    let exact = motion(truth, 0);
    let mut run = MechanisationRun {
        processes: GaussMarkovDecay::new(model),
        extras,
        readings: IdealImu::new(extras.earth, exact),
        ins: Mechanisation::new(extras.earth, moved(&exact, start), -start[A_HAT]),
        error: *start,
    };
    let mut errors = Vec::with_capacity(truth.len());
    errors.push(*start);
    for (first, last) in blocks(truth.tt_s) {
        let steps_s = steps_s(truth.tt_s, first, last);
        let noises = driving.steps(&steps_s, draws);
        for ((row, dt_s), noise) in (first + 1..=last).zip(steps_s).zip(noises) {
            run.step(&motion(truth, row), dt_s, &noise);
            errors.push(run.error);
        }
    }
    Ok(errors)
}

fn motion(truth: &InsSeries<'_>, row: usize) -> NavigationState {
    let at = truth.point(row);
    let [roll, pitch, yaw] = at.euler_rad;
    NavigationState {
        lat_rad: at.lat_rad,
        lon_rad: truth.lon_deg[row].to_radians(),
        alt_m: truth.alt_m[row],
        vel_ned_mps: Vector3::from(at.vel_ned_mps),
        body_to_ned: quaternion(&body_to_ned(roll, pitch, yaw)),
    }
}

fn triple(error: &StateVector, from: usize) -> Vector3<f64> {
    Vector3::new(error[from], error[from + 1], error[from + 2])
}

/// Motion minus an error.
fn moved(exact: &NavigationState, error: &StateVector) -> NavigationState {
    let attitude = exact.body_to_ned.to_rotation_matrix().into_inner();
    NavigationState {
        lat_rad: exact.lat_rad - error[LAT],
        lon_rad: exact.lon_rad - error[LON],
        alt_m: exact.alt_m - error[ALT],
        vel_ned_mps: exact.vel_ned_mps - triple(error, VN),
        body_to_ned: quaternion(&tilted(&attitude, &-triple(error, TILT_N))),
    }
}

/// Time constants of the Gauss-Markov states, in seconds; infinite for the other states.
struct GaussMarkovDecay {
    taus_s: StateVector,
}

impl GaussMarkovDecay {
    fn new(model: &InsErrorModel) -> Self {
        let mut taus_s = [f64::INFINITY; STATES];
        taus_s[ACC..GYRO].fill(model.sources.acc_tau_s);
        taus_s[GYRO..HA].fill(model.sources.gyro_tau_s);
        taus_s[HA] = model.sources.baro_tau_s;
        taus_s[S] = model.fogm_tau_s;
        Self { taus_s }
    }

    /// Value after a step, with half of the noise added before the decay and half after it.
    fn after(&self, state: usize, value: f64, noise: f64, dt_s: f64) -> f64 {
        let process = GaussMarkov { sigma: 0.0, tau_s: self.taus_s[state] };
        process.decay(dt_s) * (value + 0.5 * noise) + 0.5 * noise
    }
}

struct MechanisationRun<'a> {
    processes: GaussMarkovDecay,
    extras: &'a MechanisationErrors,
    readings: IdealImu,
    ins: Mechanisation,
    error: StateVector,
}

impl MechanisationRun<'_> {
    fn step(&mut self, to: &NavigationState, dt_s: f64, noise: &StateVector) {
        let from = *self.readings.motion();
        let reading = self.readings.next(&to.vel_ned_mps, &to.body_to_ned, dt_s);
        let before = self.error;
        for state in (ACC..STATES).filter(|state| *state != A_HAT) {
            self.error[state] = self.processes.after(state, before[state], noise[state], dt_s);
        }
        let mean = |state: usize| 0.5 * (before[state] + self.error[state]);
        let mean_triple = |state: usize| Vector3::new(mean(state), mean(state + 1), mean(state + 2));
        let in_body = |ned: Vector3<f64>| from.body_to_ned.inverse() * ned;
        let errors = ImuErrors {
            acc_bias_mps2: mean_triple(ACC),
            gyro_bias_radps: mean_triple(GYRO),
            acc_walk_mps: in_body(triple(noise, VN)),
            // The tilt of the INS is minus the rotation of the INS body axes.
            gyro_walk_rad: -in_body(triple(noise, TILT_N)),
            acc_scale: Vector3::from(self.extras.acc_scale),
            gyro_scale: Vector3::from(self.extras.gyro_scale),
        };
        let exact_alt_m = 0.5 * (from.alt_m + self.readings.motion().alt_m);
        let faulty: ImuReading = errors.measured(&reading);
        self.ins.step(&faulty, Some(exact_alt_m - mean(HA)));
        self.read_error();
    }

    /// Computes the error states from the difference of the two motions.
    fn read_error(&mut self) {
        let (exact, said) = (self.readings.motion(), self.ins.motion());
        let turned = |motion: &NavigationState| motion.body_to_ned.to_rotation_matrix().into_inner();
        let tilt = -tilt_between(&turned(exact), &turned(said));
        self.error[LAT] = exact.lat_rad - said.lat_rad;
        self.error[LON] = wrap_rad(exact.lon_rad - said.lon_rad);
        self.error[ALT] = exact.alt_m - said.alt_m;
        self.error[VN..TILT_N].copy_from_slice((exact.vel_ned_mps - said.vel_ned_mps).as_slice());
        self.error[TILT_N..ACC].copy_from_slice(tilt.as_slice());
        self.error[A_HAT] = -self.ins.loop_mps2();
    }
}
