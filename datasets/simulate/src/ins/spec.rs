//! What the spec says of the INS.
//!
//! An initial error and a bias that are given are INS minus truth, and measured minus true.

use numerics::navigation::{
    ins_error::{InsErrorModel, InsErrors, InsGrade},
    pinson::{ACC, ALT, GYRO, HA, LAT, LON, STATES, StateVector, TILT_N, VN},
};

use schemas::{Rule, choice, params};

use crate::reading::Section;

choice! {
    /// When the INS is aligned.
    pub enum Align {
        /// Once, at the beginning of the first line; its errors run on from line to line and through the
        /// pauses between them, which are taken as straight level flight.
        Flight = "flight",
        /// Anew at the beginning of each line.
        Line = "line",
    }
}

choice! {
    /// What carries the errors along.
    pub enum Method {
        /// The linear error model of thesis 000 (5.15).
        ErrorModel = "error_model",
        /// A strapdown mechanisation of faulty gyroscope and accelerometer readings, which is right for
        /// errors of any size.
        Mechanisation = "mechanisation",
    }
}

params! {
    /// The table `ins`.
    pub struct Keys, groups [errors: InsErrors];
    /// The grade of the INS: the defaults of its error sources.
    grade: InsGrade, unit "", default InsGrade::Magnav;
    /// When it is aligned: once a flight, or anew at each line.
    align: Align, unit "", default Align::Flight;
    /// What carries the errors along: the linear error model, or a strapdown mechanisation.
    method: Method, unit "", default Method::ErrorModel;
    /// Error of the position at alignment, north and east, INS minus truth.
    init_position_error_m: Option<[f64; 2]>, unit "m", absent "drawn", rule Rule::Finite;
    /// Error of the height at alignment.
    init_altitude_error_m: Option<f64>, unit "m", absent "drawn", rule Rule::Finite;
    /// Error of the velocity at alignment, north, east and down.
    init_velocity_error_mps: Option<[f64; 3]>, unit "m/s", absent "drawn", rule Rule::Finite;
    /// How the attitude of the INS is turned about north, east and down at alignment.
    init_tilt_error_deg: Option<[f64; 3]>, unit "deg", absent "drawn", rule Rule::Finite;
    /// The accelerometers' biases x, y, z at first, measured minus true.
    init_acc_bias_mps2: Option<[f64; 3]>, unit "m/s2", absent "drawn", rule Rule::Finite;
    /// The gyroscopes' biases x, y, z at first, measured minus true.
    init_gyro_bias_radps: Option<[f64; 3]>, unit "rad/s", absent "drawn", rule Rule::Finite;
    /// The barometer's error at first, up.
    init_baro_error_m: Option<f64>, unit "m", absent "drawn", rule Rule::Finite;
    /// Standard deviation of the accelerometers' constant scale errors, in parts per million; of `mechanisation` alone.
    acc_scale_ppm: f64, unit "1", default 0.0, rule Rule::Between(0.0, 1e5);
    /// Standard deviation of the gyroscopes' constant scale errors, in parts per million; of `mechanisation` alone.
    gyro_scale_ppm: f64, unit "1", default 0.0, rule Rule::Between(0.0, 1e5);
    /// How many realisations are drawn.
    ensemble: usize, unit "", default 1usize, rule Rule::Between(1.0, 10_000.0);
    /// Which one is flown: its rank by the DRMS over the lines of the flight, the largest being 1.
    take: Option<usize>, unit "", absent "the tenth largest of a hundred", rule Rule::Between(1.0, 10_000.0);
    /// The largest position error that is simulated. Beyond it neither a linear error model nor a map applies.
    error_limit_m: f64, unit "m", default 1e6, rule Rule::Positive;
}

/// The errors at alignment that the spec gives; the others are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InitialErrors {
    /// North and east, in metres.
    pub position_m: Option<[f64; 2]>,
    /// Up, in metres.
    pub altitude_m: Option<f64>,
    /// North, east and down, in m/s.
    pub velocity_mps: Option<[f64; 3]>,
    /// How the attitude of the INS is turned about north, east and down, in degrees.
    pub tilt_deg: Option<[f64; 3]>,
    /// The accelerometers' biases x, y, z at first, in m/s².
    pub acc_bias_mps2: Option<[f64; 3]>,
    /// The gyroscopes' biases x, y, z at first, in rad/s.
    pub gyro_bias_radps: Option<[f64; 3]>,
    /// The barometer's error at first, up, in metres.
    pub baro_m: Option<f64>,
}

/// The INS of a simulation.
#[derive(Clone, Debug, PartialEq)]
pub struct Ins {
    /// The error sources.
    pub model: InsErrorModel,
    /// When it is aligned.
    pub align: Align,
    /// What carries its errors along.
    pub method: Method,
    /// Initial errors that are given.
    pub initial: InitialErrors,
    /// Standard deviations of the scale errors of accelerometers and gyroscopes, in parts per million.
    pub scale_ppm: [f64; 2],
    /// How many realisations are drawn.
    pub ensemble: usize,
    /// The rank of the one flown by its DRMS, the largest being 1.
    pub take: usize,
    /// The largest position error that is simulated, in metres.
    pub error_limit_m: f64,
}

impl Default for Ins {
    fn default() -> Self {
        Self {
            model: InsErrorModel { fogm_sigma_nt: 0.0, ..InsErrorModel::default() },
            align: Align::Flight,
            method: Method::ErrorModel,
            initial: InitialErrors::default(),
            scale_ppm: [0.0; 2],
            ensemble: 1,
            take: 1,
            error_limit_m: 1e6,
        }
    }
}

/// The INS; its temporal variation is the spec's own `diurnal`.
pub(in super::super) fn ins(root: &Section) -> Ins {
    let Some(s) = root.section("ins") else { return Ins::default() };
    // The grade decides what the error sources are where they are left out.
    let base = |keys: Keys| Keys { errors: keys.grade.errors(), ..keys };
    let Some(graded) = s.group::<Keys>(None) else { return Ins::default() };
    let Some(keys) = s.group(Some(&base(graded))) else { return Ins::default() };
    // The tenth largest of a hundred, as thesis 001 has it.
    let take = keys.take.unwrap_or(keys.ensemble.div_ceil(10));
    if take > keys.ensemble {
        s.fault_at("take", format!("`take` of `ins` must be at most `ensemble`, {}", keys.ensemble));
    }
    let scale_ppm = [keys.acc_scale_ppm, keys.gyro_scale_ppm];
    if keys.method == Method::ErrorModel {
        for (key, ppm) in ["acc_scale_ppm", "gyro_scale_ppm"].into_iter().zip(scale_ppm) {
            if ppm > 0.0 {
                let what = "needs method = \"mechanisation\": the error model has no scale errors";
                s.fault_at(key, format!("`{key}` of `ins` {what}"));
            }
        }
    }
    Ins {
        model: InsErrorModel { fogm_sigma_nt: 0.0, ..InsErrorModel::of(keys.errors) },
        align: keys.align,
        method: keys.method,
        initial: InitialErrors {
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

impl InitialErrors {
    /// Puts what is given in the place of what was drawn, as error states (truth minus INS), at a
    /// latitude (rad) and altitude (m).
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
        // The tilt from the INS to the truth is the turn from the truth to the INS.
        put(TILT_N, self.tilt_deg.map(|tilt| tilt.map(f64::to_radians)).as_ref().map(<[f64; 3]>::as_slice), 1.0);
        put(ACC, self.acc_bias_mps2.as_ref().map(<[f64; 3]>::as_slice), -1.0);
        put(GYRO, self.gyro_bias_radps.as_ref().map(<[f64; 3]>::as_slice), -1.0);
        put(HA, self.baro_m.as_ref().map(std::slice::from_ref), -1.0);
    }
}
