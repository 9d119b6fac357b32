//! Navigates by the magnetic anomaly.

mod ins;
mod sweep;

use std::sync::Arc;

use arrow_array::{ArrayRef, RecordBatch, StringArray};
use numerics::{
    maps::map_stack::FieldMap,
    navigation::{
        ekf::{EkfOutput, EkfParameters},
        ins_error::InsErrorModel,
        pinson::STATES,
        transition::NoiseDiscretisation,
    },
};
use schemas::{Column, Fault, LineIn, OrAuto, Passes, Prepared, Rule, Shape, Stage, Table, Yield, stage};

use crate::{
    columns::{array, faults_of, floats, list, shape},
    compensate::NOISE,
    dates::{WAYS_OUT, dated_by_flight, first_year},
    map_errors::MapErrors,
    maps::{check_levels, field_map, interpolation},
};

/// The states, in the order of thesis 000 (5.14).
const STATE_NAMES: [&str; STATES] = [
    "lat", "lon", "alt", "vn", "ve", "vd", "tilt_n", "tilt_e", "tilt_d", "acc_1", "acc_2", "acc_3", "gyro_1", "gyro_2",
    "gyro_3", "ha", "a_hat", "s",
];

stage! {
    /// Corrects an INS by matching the compensated field to an anomaly map with an 18-state extended Kalman filter.
    ///
    /// The states are the errors of the INS (truth - INS) and the temporal variation; the estimate is INS plus state.
    /// Each row holds the state after the measurement of its sample. `update` says what became of the measurement:
    /// `used`; `missing`, where it is NaN; `off_map`, where the predicted position is off the map or in an unknown cell;
    /// `gated`. Whatever is not used leaves the filter predicting, with NaN in `residual` and `nis`, and goes on.
    ///
    /// A flat map without a core field only moves the temporal variation; with one, the slope of the core field corrects
    /// the position too, however little. An INS value that is NaN is an error that names the row. Velocities,
    /// specific forces and attitude that the flight lacks are derived from the INS positions (attitude: level, along the
    /// course). The map is taken as it is, at its own height, unless `map_levels_m` has it continued to the heights flown;
    /// `map_height_error` is the rms error to expect of that over the whole map, from its spectrum, at the mean height of
    /// the line: 0 with `map_levels_m`, NaN where the map's height is unknown. A map in eastings and northings is looked up
    /// between its own nodes.
    ///
    /// The core field (IGRF-14) is that of one date a line: `decimal_year` where it is given, else the flight's first
    /// sample with both `year` and `doy`. It refuses a flight whose date neither says, unless `core_field = false`.
    ///
    /// `measurement_sigma_nt`, `fogm_sigma_nt` and `fogm_tau_s` may be `"auto"`: what the calibration left, of the columns
    /// `mag_sigma`, `mag_fogm_sigma` and `mag_fogm_tau`. `compensate` makes them of the lines that its model was fitted on,
    /// `residual_noise` and `assume_noise` of lines that were flown over a known field. Where an offset is taken off (`offset_window_s`), it
    /// holds the lasting part of its first seconds, and what remains has twice the variance and correlation time. To the
    /// white part comes what bilinear interpolation misses between the map's nodes.
    ///
    /// Source: thesis 000, section 5.3, with F and H checked against finite differences and the process noise discretised.
    Navigate = "navigate", version 4, grain Line, inputs [input: Lines, map: Map],
    example r#"
[[stages]]
name            = "navigate"
stage           = "navigate"
input           = "assume_noise"
map             = "anomaly"
offset_window_s = 1.0
core_field      = false
"#;
    /// The filter.
    filter: String, unit "", default "ekf", rule Rule::OneOf(&["ekf"]);
    /// The measured field.
    mag: String, unit "nT", default "mag_c";
    /// Whether the measurement holds the core field, which is then part of the prediction.
    core_field: bool, unit "", default true;
    /// Whether the column `diurnal` is taken off the measurement, so that the temporal variation need not be estimated. A
    /// sample without it has no measurement.
    remove_diurnal: Option<bool>, unit "", absent "true where the flight has the column";
    /// The date of the core field, in place of the flight's own.
    decimal_year: Option<f64>, unit "a", absent "the flight's own date", rule Rule::Between(1900.0, 2030.0);
    /// How the map is interpolated: bilinear, or by a natural cubic spline.
    map_interpolation: String, unit "", default "linear", rule Rule::OneOf(&["linear", "cubic"]);
    /// The heights above the ellipsoid, ascending, to which the map is continued; between them it is interpolated.
    map_levels_m: Option<Vec<f64>>, unit "m", absent "the map is taken at its own height, whatever that of the flight";
    /// Append the state `x` and its covariance `p` (row-major).
    save_state: bool, unit "", default false;
    /// The mean of measurement minus prediction over the first seconds of a line, taken off before filtering; 0 takes
    /// nothing off. Compensation leaves a constant undetermined.
    offset_window_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
    /// A measurement whose squared innovation over its variance is above this is not used.
    gate_nis: Option<f64>, unit "1", absent "all measurements are used", rule Rule::Positive;
    /// How the process noise becomes a step's covariance: to second order, to first order as MagNav.jl, or exactly.
    discretisation: String, unit "", default "trapezoidal", rule Rule::OneOf(&["trapezoidal", "rectangular", "van_loan"]);
    /// Measurement noise, sample by sample: sensor, map and what compensation left; or `"auto"`.
    measurement_sigma_nt: OrAuto, unit "nT", default 5.0, rule Rule::Positive;
    /// Initial horizontal position error, each axis.
    init_position_sigma_m: f64, unit "m", default 3.0, rule Rule::NotNegative;
    /// Initial height error.
    init_altitude_sigma_m: f64, unit "m", default 0.001, rule Rule::NotNegative;
    /// Initial velocity error, each axis.
    init_velocity_sigma_mps: f64, unit "m/s", default 0.01, rule Rule::NotNegative;
    /// Initial tilt error, each axis.
    init_attitude_sigma_deg: f64, unit "deg", default 0.01, rule Rule::NotNegative;
    /// Initial heading error. An INS levels itself far better than it finds north.
    init_heading_sigma_deg: Option<f64>, unit "deg", absent "the initial tilt error", rule Rule::NotNegative;
    /// Velocity random walk.
    vrw_sigma: f64, unit "m/s^1.5", default 0.000238, rule Rule::NotNegative;
    /// Angular random walk.
    arw_sigma: f64, unit "rad/s^0.5", default 0.000000581, rule Rule::NotNegative;
    /// Barometer error.
    baro_sigma_m: f64, unit "m", default 1.0, rule Rule::NotNegative;
    /// Initial error of the barometric-aiding altitude.
    ha_sigma_m: f64, unit "m", default 0.001, rule Rule::NotNegative;
    /// Initial error of the barometric-aiding vertical acceleration.
    a_hat_sigma_mps2: f64, unit "m/s2", default 0.01, rule Rule::NotNegative;
    /// Accelerometer bias.
    acc_sigma_mps2: f64, unit "m/s2", default 0.000245, rule Rule::NotNegative;
    /// Gyro bias.
    gyro_sigma_radps: f64, unit "rad/s", default 0.00000000727, rule Rule::NotNegative;
    /// Temporal variation, and whatever else of the measurement's error lasts; or `"auto"`.
    fogm_sigma_nt: OrAuto, unit "nT", default 3.0, rule Rule::NotNegative;
    /// Time constant of the barometer error.
    baro_tau_s: f64, unit "s", default 3600.0, rule Rule::Positive;
    /// Time constant of the accelerometer bias.
    acc_tau_s: f64, unit "s", default 3600.0, rule Rule::Positive;
    /// Time constant of the gyro bias.
    gyro_tau_s: f64, unit "s", default 3600.0, rule Rule::Positive;
    /// Time constant of the temporal variation; or `"auto"`.
    fogm_tau_s: OrAuto, unit "s", default 600.0, rule Rule::Positive;
}

const POSITION: [&str; 3] = ["ins_lat", "ins_lon", "ins_alt"];
const VELOCITY: [&str; 3] = ["ins_vn", "ins_ve", "ins_vd"];
const FORCE: [&str; 3] = ["ins_fn", "ins_fe", "ins_fd"];
const ATTITUDE: [&str; 3] = ["ins_roll", "ins_pitch", "ins_yaw"];
const DIURNAL: &str = "diurnal";

/// The noise that the filter expects: white, and lasting with its time constant.
#[derive(Clone, Copy)]
struct Expected {
    sigma_nt: f64,
    fogm_sigma_nt: f64,
    fogm_tau_s: f64,
}

/// The map as it is looked up, and its errors.
struct PreparedMap {
    field: FieldMap,
    errors: MapErrors,
}

/// The error to expect of a map at another height, for `score`.
pub(crate) const MAP_HEIGHT_ERROR: &str = "map_height_error";

impl Navigate {
    fn parameters(&self, noise: Expected) -> EkfParameters {
        let errors = InsErrorModel {
            init_position_sigma_m: self.init_position_sigma_m,
            init_altitude_sigma_m: self.init_altitude_sigma_m,
            init_velocity_sigma_mps: self.init_velocity_sigma_mps,
            init_attitude_sigma_deg: self.init_attitude_sigma_deg,
            init_heading_sigma_deg: self.init_heading_sigma_deg,
            vrw_sigma: self.vrw_sigma,
            arw_sigma: self.arw_sigma,
            baro_sigma_m: self.baro_sigma_m,
            ha_sigma_m: self.ha_sigma_m,
            a_hat_sigma_mps2: self.a_hat_sigma_mps2,
            acc_sigma_mps2: self.acc_sigma_mps2,
            gyro_sigma_radps: self.gyro_sigma_radps,
            fogm_sigma_nt: noise.fogm_sigma_nt,
            baro_tau_s: self.baro_tau_s,
            acc_tau_s: self.acc_tau_s,
            gyro_tau_s: self.gyro_tau_s,
            fogm_tau_s: noise.fogm_tau_s,
            noise: match self.discretisation.as_str() {
                "rectangular" => NoiseDiscretisation::Rectangular,
                "van_loan" => NoiseDiscretisation::VanLoan,
                _ => NoiseDiscretisation::Trapezoidal,
            },
            ..InsErrorModel::default()
        };
        EkfParameters {
            errors,
            measurement_sigma_nt: noise.sigma_nt,
            offset_window_s: self.offset_window_s,
            gate_nis: self.gate_nis,
            keep_states: self.save_state,
            keep_covariance: self.save_state,
        }
    }

    /// The parameters that may be found from the data, each with the column that holds it.
    fn found(&self) -> [(OrAuto, &'static str, &'static str, &'static str); 3] {
        let [sigma, fogm_sigma, fogm_tau] = NOISE;
        [
            (self.measurement_sigma_nt, "measurement_sigma_nt", sigma.0, sigma.1),
            (self.fogm_sigma_nt, "fogm_sigma_nt", fogm_sigma.0, fogm_sigma.1),
            (self.fogm_tau_s, "fogm_tau_s", fogm_tau.0, fogm_tau.1),
        ]
    }

    /// Says which column is missing for what is `auto`.
    fn auto_faults(&self, shape: &Shape) -> Vec<Fault> {
        let wanted = self.found().into_iter().filter(|(value, ..)| *value == OrAuto::Auto);
        let missing = wanted.filter_map(|(_, param, column, unit)| {
            let fault = shape.number(column, unit).err()?;
            let what = format!("`{param} = \"auto\"` is what the calibration left, and {}", fault.what);
            let help =
                format!("navigate on the table of a `compensate` or an `assume_noise`, or give `{param}` a number");
            Some(Fault::new(what).help(help).of_param(param))
        });
        missing.collect()
    }

    /// The noise of a line.
    fn expected(&self, batch: &RecordBatch) -> Result<Expected, Fault> {
        let mut values = [0.0; 3];
        for (to, (value, param, column, _)) in values.iter_mut().zip(self.found()) {
            *to = match value {
                OrAuto::Given(x) => x,
                OrAuto::Auto => {
                    let first = floats(batch, column)?.iter().copied().find(|x| x.is_finite());
                    first.ok_or_else(|| {
                        let what = format!(
                            "`{param} = \"auto\"` has no value: the model was fitted on lines too short to tell"
                        );
                        Fault::data(what).in_column(column).help(format!("give `{param}` a number"))
                    })?
                }
            };
        }
        let [sigma_nt, mut fogm_sigma_nt, mut fogm_tau_s] = values;
        if self.offset_window_s > 0.0 {
            if self.fogm_sigma_nt == OrAuto::Auto {
                fogm_sigma_nt *= std::f64::consts::SQRT_2;
            }
            if self.fogm_tau_s == OrAuto::Auto {
                fogm_tau_s *= 2.0;
            }
        }
        Ok(Expected { sigma_nt, fogm_sigma_nt, fogm_tau_s })
    }

    /// Whether the temporal variation is taken off.
    fn removes_diurnal(&self, there: bool) -> bool {
        self.remove_diurnal.unwrap_or(there)
    }

    /// The columns of the flight that are read: those of the INS that are there, and its date.
    fn reads(&self, shape: &Shape) -> Vec<String> {
        let mut reads: Vec<&str> = vec!["tt", &self.mag];
        reads.extend(POSITION);
        for three in [VELOCITY, FORCE, ATTITUDE] {
            if three.iter().all(|c| shape.get(c).is_some()) {
                reads.extend(three);
            }
        }
        if self.dated_by_flight(shape) {
            reads.extend(["year", "doy"]);
        }
        if self.removes_diurnal(shape.get(DIURNAL).is_some()) {
            reads.push(DIURNAL);
        }
        reads.extend(self.found().iter().filter(|f| f.0 == OrAuto::Auto).map(|f| f.2));
        reads.into_iter().map(str::to_owned).collect()
    }

    fn dated_by_flight(&self, shape: &Shape) -> bool {
        self.core_field && self.decimal_year.is_none() && dated_by_flight(shape)
    }

    fn notes(&self, shape: &Shape) -> Vec<String> {
        let mut notes = vec![];
        if self.remove_diurnal.is_none() && shape.get(DIURNAL).is_some() {
            notes
                .push(format!("`{DIURNAL}` is taken off the measurement; say `remove_diurnal = false` to leave it in"));
        }
        for (three, from) in [(VELOCITY, "INS positions"), (FORCE, "INS velocities"), (ATTITUDE, "the course, level")] {
            let missing: Vec<&str> = three.into_iter().filter(|c| shape.get(c).is_none()).collect();
            if !missing.is_empty() {
                notes.push(format!("no {}: derived from {from}", missing.join(", ")));
            }
        }
        notes
    }

    /// The date of the core field, where it is part of the measurement.
    fn core_year(&self, batch: &RecordBatch) -> Result<Option<f64>, Fault> {
        match self.decimal_year {
            _ if !self.core_field => Ok(None),
            Some(year) => Ok(Some(year)),
            None => first_year(batch).map(Some),
        }
    }
}

impl Stage for Navigate {
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let mut faults = faults_of([shape.number(&self.mag, "nT")], "mag");
        faults.extend(faults_of(["ins_lat", "ins_lon"].map(|c| shape.number(c, "deg")), "input"));
        faults.extend(faults_of([shape.number("ins_alt", "m")], "input"));
        faults.extend(check_levels(self.map_levels_m.as_ref(), "map_levels_m"));
        faults.extend(self.auto_faults(shape));
        if self.remove_diurnal == Some(true) {
            let found = shape.number(DIURNAL, "nT").map_err(|f| f.help("say `remove_diurnal = false`"));
            faults.extend(faults_of([found], "remove_diurnal"));
        }
        if self.core_field && self.decimal_year.is_none() && !dated_by_flight(shape) {
            let what = "the core field needs a date, but the flight has no `year` and `doy`";
            faults.push(Fault::new(what).help(WAYS_OUT).of_param("decimal_year"));
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let reads = self.reads(shape);
        let made = |c: Column| c.from(0, &reads).from(1, &["anomaly"]);
        let named = [
            ("lat", "deg", "estimated latitude, WGS-84"),
            ("lon", "deg", "estimated longitude, WGS-84"),
            ("alt", "m", "estimated height above the WGS-84 ellipsoid"),
            ("vn", "m/s", "estimated velocity north"),
            ("ve", "m/s", "estimated velocity east"),
            ("vd", "m/s", "estimated velocity down"),
            ("sd_n", "m", "one sigma of the position, north"),
            ("sd_e", "m", "one sigma of the position, east"),
            ("cov_ne", "m2", "covariance of the north and east position errors"),
            ("residual", "nT", "innovation: measurement minus prediction; NaN where none was used"),
            ("nis", "1", "normalised innovation squared"),
        ];
        let mut columns: Vec<Column> = named.into_iter().map(|(n, u, d)| made(Column::float(n, u, d))).collect();
        columns.push(made(Column::text("update", "what became of the measurement: used, missing, off_map or gated")));
        let height =
            "rms error to expect because the map is at another height than the line; NaN where its own is unknown";
        columns.push(made(Column::float(MAP_HEIGHT_ERROR, "nT", height)));
        if self.save_state {
            let states: Vec<String> = STATE_NAMES.map(str::to_owned).to_vec();
            let pairs = STATE_NAMES.iter().flat_map(|a| STATE_NAMES.iter().map(move |b| format!("{a}*{b}"))).collect();
            columns.push(made(Column::list(
                "x",
                "",
                "error state, truth - INS, thesis 000 (5.14); rad, m, s, nT",
                states,
            )));
            columns.push(made(Column::list("p", "", "covariance of x, row-major", pairs)));
        }
        let mut yields = Yield::append(columns, &reads);
        yields.reads.push(vec!["anomaly".to_owned(), "alt".to_owned()]);
        yields.passes = Passes::Only(schemas::flight::KEYS.map(str::to_owned).to_vec());
        yields.notes = self.notes(shape);
        Ok(yields)
    }

    fn run(&self, line: &LineIn) -> Result<Vec<ArrayRef>, Fault> {
        // One point has one answer.
        Self::run_points(&[(self, line)]).pop().unwrap_or_else(|| Ok(vec![]))
    }

    fn run_points(points: &[(&Self, &LineIn)]) -> Vec<Result<Vec<ArrayRef>, Fault>> {
        sweep::run(points)
    }

    fn prepare(&self, inputs: &[RecordBatch]) -> Result<Prepared, Fault> {
        let map = inputs.get(1).ok_or_else(|| Fault::data("the map is missing"))?;
        let field = field_map(map, interpolation(&self.map_interpolation), self.map_levels_m.as_deref())?;
        let errors = MapErrors::of(map, self.map_levels_m.is_some(), self.map_interpolation == "linear")?;
        Ok(Some(Arc::new(PreparedMap { field, errors })))
    }

    fn prepare_key(&self) -> String {
        format!("{} {:?}", self.map_interpolation, self.map_levels_m)
    }
}

impl Navigate {
    /// The measurement, less the temporal variation where that is known.
    fn measured(&self, batch: &RecordBatch) -> Result<Vec<f64>, Fault> {
        let mut measured = floats(batch, &self.mag)?.to_vec();
        if self.removes_diurnal(batch.column_by_name(DIURNAL).is_some()) {
            let diurnal = floats(batch, DIURNAL).map_err(|f| f.help("say `remove_diurnal = false`"))?;
            measured.iter_mut().zip(diurnal).for_each(|(m, d)| *m -= d);
        }
        Ok(measured)
    }

    fn arrays(&self, out: EkfOutput, measured: &[f64], height_error_nt: f64) -> Result<Vec<ArrayRef>, Fault> {
        let rows = measured.len();
        let fate = |(residual, (nis, m)): (&f64, (&f64, &f64))| match self.gate_nis {
            _ if !m.is_finite() => "missing",
            _ if residual.is_nan() => "off_map",
            Some(gate) if *nis > gate => "gated",
            _ => "used",
        };
        let fates =
            out.residual_nt.iter().zip(out.nis.iter().zip(measured)).map(fate).map(Some).collect::<StringArray>();
        let mut arrays: Vec<ArrayRef> = vec![
            array(out.lat_deg),
            array(out.lon_deg),
            array(out.alt_m),
            array(out.vn_mps),
            array(out.ve_mps),
            array(out.vd_mps),
            array(out.sd_n_m),
            array(out.sd_e_m),
            array(out.cov_ne_m2),
            array(out.residual_nt),
            array(out.nis),
            Arc::new(fates),
            array(vec![height_error_nt; rows]),
        ];
        if self.save_state {
            // The filter's own memory: a long flight's covariances take half a gigabyte.
            arrays.push(list(out.x.into_flattened(), STATES)?);
            arrays.push(list(out.p.into_flattened().into_flattened(), STATES * STATES)?);
        }
        Ok(arrays)
    }
}
