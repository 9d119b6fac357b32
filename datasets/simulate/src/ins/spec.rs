//! What the spec says of the INS.
//!
//! An initial error and a bias that are given are INS minus truth, and measured minus true.

use numerics::navigation::{
    ins_error::{InsErrorModel, InsGrade},
    pinson::{ACC, ALT, GYRO, HA, LAT, LON, STATES, StateVector, TILT_N, VN},
};

use super::super::spec::section::{Need, Section};

/// When the INS is aligned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Align {
    /// Once, at the beginning of the first line; its errors run on from line to line and through the
    /// pauses between them, which are taken as straight level flight.
    #[default]
    Flight,
    /// Anew at the beginning of each line.
    Line,
}

/// What carries the errors along.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// The linear error model of thesis 000 (5.15).
    #[default]
    ErrorModel,
    /// A strapdown mechanisation of faulty gyroscope and accelerometer readings, which is right for
    /// errors of any size.
    Mechanisation,
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

/// The INS of a simulation: the table `ins`.
///
/// Every key has a default:
/// - `grade`: `magnav`, `navigation`, `tactical` or `commercial`; the defaults of the error sources.
/// - `init_position_sigma_m`, `init_altitude_sigma_m`, `init_velocity_sigma_mps`,
///   `init_attitude_sigma_deg`: standard deviations of the initial errors; `init_heading_sigma_deg`: that of the heading,
///   by default the attitude's.
/// - `vrw_sigma` (m/s^1.5), `arw_sigma` (rad/s^0.5): random walks.
/// - `acc_sigma_mps2` and `acc_tau_s`, `gyro_sigma_radps` and `gyro_tau_s`, `baro_sigma_m` and
///   `baro_tau_s`: biases as Gauss-Markov processes; `ha_sigma_m` and `a_hat_sigma_mps2`: initial
///   standard deviations of the barometer loop.
/// - `init_position_error_m`, `init_altitude_error_m`, `init_velocity_error_mps`,
///   `init_tilt_error_deg`, `init_acc_bias_mps2`, `init_gyro_bias_radps`, `init_baro_error_m`: initial
///   errors in place of drawn ones.
/// - `align`: `flight` or `line`.
/// - `method`: `error_model` or `mechanisation`; the latter also takes `acc_scale_ppm` and
///   `gyro_scale_ppm`, standard deviations of constant scale errors.
/// - `ensemble` and `take`: how many realisations are drawn, and which one is flown by the rank of its
///   DRMS over the lines of the flight.
/// - `error_limit_m`: from what position error on the INS has run away, which is refused.
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

/// Position errors above it are refused unless the spec says otherwise: beyond it neither a
/// linear error model nor a map has anything to say.
const ERROR_LIMIT_M: f64 = 1e6;

impl Default for Ins {
    fn default() -> Self {
        Self {
            model: InsErrorModel { fogm_sigma_nt: 0.0, ..InsErrorModel::default() },
            align: Align::default(),
            method: Method::default(),
            initial: InitialErrors::default(),
            scale_ppm: [0.0; 2],
            ensemble: 1,
            take: 1,
            error_limit_m: ERROR_LIMIT_M,
        }
    }
}

/// The INS; its temporal variation is the spec's own `diurnal`.
pub(in super::super) fn ins(root: &Section) -> Ins {
    let Some(s) = root.section("ins") else { return Ins::default() };
    let grade = InsGrade::ALL[s.word("grade", &InsGrade::ALL.map(InsGrade::name))];
    let ensemble = s.whole("ensemble", 1, 1, 10_000);
    let ins = Ins {
        model: model(&s, grade),
        align: [Align::Flight, Align::Line][s.word("align", &["flight", "line"])],
        method: [Method::ErrorModel, Method::Mechanisation][s.word("method", &["error_model", "mechanisation"])],
        initial: initial(&s),
        scale_ppm: ["acc_scale_ppm", "gyro_scale_ppm"].map(|key| s.number(key, 0.0, Need::Between(0.0, 1e5))),
        ensemble: ensemble as usize,
        // The tenth largest of a hundred, as thesis 001 has it.
        take: s.whole("take", (ensemble + 9) / 10, 1, ensemble) as usize,
        error_limit_m: s.number("error_limit_m", ERROR_LIMIT_M, Need::Positive),
    };
    if ins.method == Method::ErrorModel {
        for (key, ppm) in ["acc_scale_ppm", "gyro_scale_ppm"].into_iter().zip(ins.scale_ppm) {
            if ppm > 0.0 {
                s.fault_at(
                    key,
                    format!("`{key}` of `ins` needs method = \"mechanisation\": the error model has no scale errors"),
                );
            }
        }
    }
    s.finish();
    ins
}

fn model(s: &Section, grade: InsGrade) -> InsErrorModel {
    let mut m = InsErrorModel { fogm_sigma_nt: 0.0, ..grade.model() };
    let sigmas: [(&'static str, &mut f64); 11] = [
        ("init_position_sigma_m", &mut m.init_position_sigma_m),
        ("init_altitude_sigma_m", &mut m.init_altitude_sigma_m),
        ("init_velocity_sigma_mps", &mut m.init_velocity_sigma_mps),
        ("init_attitude_sigma_deg", &mut m.init_attitude_sigma_deg),
        ("vrw_sigma", &mut m.vrw_sigma),
        ("arw_sigma", &mut m.arw_sigma),
        ("baro_sigma_m", &mut m.baro_sigma_m),
        ("ha_sigma_m", &mut m.ha_sigma_m),
        ("a_hat_sigma_mps2", &mut m.a_hat_sigma_mps2),
        ("acc_sigma_mps2", &mut m.acc_sigma_mps2),
        ("gyro_sigma_radps", &mut m.gyro_sigma_radps),
    ];
    for (key, value) in sigmas {
        *value = s.number(key, *value, Need::NotNegative);
    }
    m.init_heading_sigma_deg = s.optional("init_heading_sigma_deg", Need::NotNegative);
    for (key, value) in
        [("baro_tau_s", &mut m.baro_tau_s), ("acc_tau_s", &mut m.acc_tau_s), ("gyro_tau_s", &mut m.gyro_tau_s)]
    {
        *value = s.number(key, *value, Need::Positive);
    }
    m
}

fn initial(s: &Section) -> InitialErrors {
    InitialErrors {
        position_m: given(s, "init_position_error_m"),
        altitude_m: s.optional("init_altitude_error_m", Need::Any),
        velocity_mps: given(s, "init_velocity_error_mps"),
        tilt_deg: given(s, "init_tilt_error_deg"),
        acc_bias_mps2: given(s, "init_acc_bias_mps2"),
        gyro_bias_radps: given(s, "init_gyro_bias_radps"),
        baro_m: s.optional("init_baro_error_m", Need::Any),
    }
}

/// A list that may be left out.
fn given<const N: usize>(s: &Section, key: &'static str) -> Option<[f64; N]> {
    Some(s.numbers(key, [f64::NAN; N], Need::Any)).filter(|list| !list.iter().any(|x| x.is_nan()))
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
