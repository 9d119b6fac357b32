//! Keys of the INS in a synth spec.
//!
//! A given initial error is INS minus truth; a given bias is measured minus true.

use numerics::navigation::{
    ins_error::{InsErrorModel, InsErrors, InsGrade},
    pinson::{ACC, ALT, GYRO, HA, LAT, LON, STATES, StateVector, TILT_N, VN},
};

use schemas::{Rule, choice, params};

use crate::reading::SynthSection;

choice! {
    /// Time of alignment of the INS.
    pub enum InsAlignment {
        /// Once, at the start of the first line. The errors continue from line to line and through the pauses
        /// between them, which are simulated as straight level flight.
        Flight = "flight",
        /// At the start of each line.
        Line = "line",
    }
}

choice! {
    /// Propagation of the errors.
    pub enum InsErrorPropagation {
        /// The linear error model of Gnadt 2022, (5.15).
        ErrorModel = "error_model",
        /// A strapdown mechanisation of erroneous gyroscope and accelerometer readings, valid for errors of any size.
        Mechanisation = "mechanisation",
    }
}

params! {
    /// The table `ins`.
    pub struct InsKeys, groups [errors: InsErrors];
    /// Grade of the INS, which sets the defaults of its error sources.
    grade: InsGrade, unit "", default InsGrade::Magnav;
    /// Time of alignment: at the start of the flight, or of each line.
    align: InsAlignment, unit "", default InsAlignment::Flight;
    /// Propagation of the errors: by the linear error model, or by a strapdown mechanisation.
    method: InsErrorPropagation, unit "", default InsErrorPropagation::ErrorModel;
    /// Position error at alignment (north, east): INS minus truth.
    init_position_error_m: Option<[f64; 2]>, unit "m", absent "drawn at random", rule Rule::Finite;
    /// Height error at alignment: INS minus truth.
    init_altitude_error_m: Option<f64>, unit "m", absent "drawn at random", rule Rule::Finite;
    /// Velocity error at alignment (north, east, down): INS minus truth.
    init_velocity_error_mps: Option<[f64; 3]>, unit "m/s", absent "drawn at random", rule Rule::Finite;
    /// Tilt of the INS at alignment: rotation from the true attitude about north, east and down.
    init_tilt_error_deg: Option<[f64; 3]>, unit "deg", absent "drawn at random", rule Rule::Finite;
    /// Initial accelerometer biases along the x, y and z axes of the body frame: measured minus true.
    init_acc_bias_mps2: Option<[f64; 3]>, unit "m/s2", absent "drawn at random", rule Rule::Finite;
    /// Initial gyroscope biases about the x, y and z axes of the body frame: measured minus true.
    init_gyro_bias_radps: Option<[f64; 3]>, unit "rad/s", absent "drawn at random", rule Rule::Finite;
    /// Initial error of the barometric height, positive upward: measured minus true.
    init_baro_error_m: Option<f64>, unit "m", absent "drawn at random", rule Rule::Finite;
    /// Standard deviation of the accelerometers' constant scale errors, in ppm. Requires `method = "mechanisation"`.
    acc_scale_ppm: f64, unit "1", default 0.0, rule Rule::Between(0.0, 1e5);
    /// Standard deviation of the gyroscopes' constant scale errors, in ppm. Requires `method = "mechanisation"`.
    gyro_scale_ppm: f64, unit "1", default 0.0, rule Rule::Between(0.0, 1e5);
    /// Number of realisations that are drawn.
    ensemble: usize, unit "", default 1usize, rule Rule::Between(1.0, 10_000.0);
    /// Rank of the realisation that is used, in order of DRMS over the lines of the flight. Rank 1 has the largest
    /// DRMS.
    take: Option<usize>, unit "", absent "a tenth of `ensemble`, rounded up", rule Rule::Between(1.0, 10_000.0);
    /// Maximum horizontal position error. A line that exceeds it is rejected, because neither the linear error model
    /// nor the map applies there.
    error_limit_m: f64, unit "m", default 1e6, rule Rule::Positive;
}

/// The errors at alignment that the spec gives; the others are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InsInitialErrors {
    /// North and east, in metres.
    pub position_m: Option<[f64; 2]>,
    /// Up, in metres.
    pub altitude_m: Option<f64>,
    /// North, east and down, in m/s.
    pub velocity_mps: Option<[f64; 3]>,
    /// Rotation of the INS attitude about north, east and down, in degrees.
    pub tilt_deg: Option<[f64; 3]>,
    /// Initial accelerometer biases x, y and z, in m/s².
    pub acc_bias_mps2: Option<[f64; 3]>,
    /// Initial gyroscope biases x, y and z, in rad/s.
    pub gyro_bias_radps: Option<[f64; 3]>,
    /// Initial error of the barometric height, up, in metres.
    pub baro_m: Option<f64>,
}

/// The INS of a simulation.
#[derive(Clone, Debug, PartialEq)]
pub struct SynthIns {
    /// The error sources.
    pub model: InsErrorModel,
    /// Time of alignment.
    pub align: InsAlignment,
    /// Propagation of the errors.
    pub method: InsErrorPropagation,
    /// Initial errors that the spec gives.
    pub initial: InsInitialErrors,
    /// Standard deviations of the scale errors of accelerometers and gyroscopes, in parts per million.
    pub scale_ppm: [f64; 2],
    /// Number of realisations that are drawn.
    pub ensemble: usize,
    /// Rank of the realisation that is used, by DRMS; rank 1 has the largest DRMS.
    pub take: usize,
    /// Maximum horizontal position error, in metres.
    pub error_limit_m: f64,
}

impl Default for SynthIns {
    fn default() -> Self {
        Self {
            model: InsErrorModel { fogm_sigma_nt: 0.0, ..InsErrorModel::default() },
            align: InsAlignment::Flight,
            method: InsErrorPropagation::ErrorModel,
            initial: InsInitialErrors::default(),
            scale_ppm: [0.0; 2],
            ensemble: 1,
            take: 1,
            error_limit_m: 1e6,
        }
    }
}

/// Reads the table `ins` of the spec.
pub(in super::super) fn ins(root: &SynthSection) -> SynthIns {
    let Some(s) = root.section("ins") else { return SynthIns::default() };
    // The grade sets the error sources that are unset.
    let base = |keys: InsKeys| InsKeys { errors: keys.grade.errors(), ..keys };
    let Some(graded) = s.group::<InsKeys>(None) else { return SynthIns::default() };
    let Some(keys) = s.group(Some(&base(graded))) else { return SynthIns::default() };
    // The tenth largest of a hundred, as in Lee 2019.
    let take = keys.take.unwrap_or(keys.ensemble.div_ceil(10));
    if take > keys.ensemble {
        s.fault_at("take", format!("`take` of `ins` must be at most `ensemble` ({})", keys.ensemble));
    }
    let scale_ppm = [keys.acc_scale_ppm, keys.gyro_scale_ppm];
    if keys.method == InsErrorPropagation::ErrorModel {
        for (key, ppm) in ["acc_scale_ppm", "gyro_scale_ppm"].into_iter().zip(scale_ppm) {
            if ppm > 0.0 {
                let what = "needs `method = \"mechanisation\"`: the error model has no scale errors";
                s.fault_at(key, format!("`{key}` of `ins` {what}"));
            }
        }
    }
    SynthIns {
        model: InsErrorModel { fogm_sigma_nt: 0.0, ..InsErrorModel::from_sources(keys.errors) },
        align: keys.align,
        method: keys.method,
        initial: InsInitialErrors {
            position_m: keys.init_position_error_m,
            altitude_m: keys.init_altitude_error_m,
            velocity_mps: keys.init_velocity_error_mps,
            tilt_deg: keys.init_tilt_error_deg,
            acc_bias_mps2: keys.init_acc_bias_mps2,
            gyro_bias_radps: keys.init_gyro_bias_radps,
            baro_m: keys.init_baro_error_m,
        },
        scale_ppm,
        ensemble: keys.ensemble,
        take,
        error_limit_m: keys.error_limit_m,
    }
}

impl InsInitialErrors {
    /// Replaces drawn errors by the given errors, as error states (truth minus INS), at a latitude (rad) and altitude
    /// (m).
    pub(super) fn replace(&self, error: &mut StateVector, model: &InsErrorModel, lat_rad: f64, alt_m: f64) {
        let mut put = |first: usize, values: Option<&[f64]>, factor: f64| {
            for (state, value) in (first..STATES).zip(values.unwrap_or_default()) {
                error[state] = factor * value;
            }
        };
        if let Some([north_m, east_m]) = self.position_m {
            put(LAT, Some(&[model.earth.north_m_to_lat_rad(north_m, lat_rad, alt_m)]), -1.0);
            put(LON, Some(&[model.earth.east_m_to_lon_rad(east_m, lat_rad, alt_m)]), -1.0);
        }
        put(ALT, self.altitude_m.as_ref().map(std::slice::from_ref), -1.0);
        put(VN, self.velocity_mps.as_ref().map(<[f64; 3]>::as_slice), -1.0);
        // The sign is unchanged, because the tilt state is the rotation from the true attitude to the INS attitude,
        // like the given tilt.
        put(TILT_N, self.tilt_deg.map(|tilt| tilt.map(f64::to_radians)).as_ref().map(<[f64; 3]>::as_slice), 1.0);
        put(ACC, self.acc_bias_mps2.as_ref().map(<[f64; 3]>::as_slice), -1.0);
        put(GYRO, self.gyro_bias_radps.as_ref().map(<[f64; 3]>::as_slice), -1.0);
        put(HA, self.baro_m.as_ref().map(std::slice::from_ref), -1.0);
    }
}
