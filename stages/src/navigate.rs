//! Navigates by the magnetic anomaly.

use std::sync::Arc;

use arrow_array::{ArrayRef, RecordBatch, StringArray};
use schemas::{Column, Fault, LineIn, Passes, Prepared, Rule, Shape, Stage, Table, Yield, stage};

use crate::{
    columns::{array, data, faults_of, floats, list, shape},
    dates::{dated_by_flight, first_year},
    maps::{check_levels, field_map, interpolation},
    numerics::{
        core_field::CoreField,
        ekf::{self, EkfOutput, EkfParameters},
        ins_error::InsErrorModel,
        ins_series::InsSeries,
        map_stack::FieldMap,
        pinson::STATES,
        strapdown,
        transition::NoiseDiscretisation,
    },
};

/// The date of the core field where neither the flight nor the spec gives one: MagNav.jl's, 4 July 2020.
const DEFAULT_YEAR: f64 = 2020.0 + 185.0 / 366.0;

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
    /// course). The map is taken as it is, at its own height, unless `map_levels_m` has it
    /// continued to the heights flown. A map in eastings and northings is looked up between its own nodes.
    ///
    /// The core field (IGRF-14) is taken at the flight's `year` and `doy`, else at `decimal_year`.
    ///
    /// Source: thesis 000, section 5.3, with F and H checked against finite differences and the process noise discretised.
    Navigate = "navigate", version 2, grain Line, inputs [input: Lines, map: Map];
    /// The filter.
    filter: String, unit "", default "ekf", rule Rule::OneOf(&["ekf"]);
    /// The measured field.
    mag: String, unit "nT", default "mag_c";
    /// Whether the measurement holds the core field, which is then part of the prediction.
    core_field: bool, unit "", default true;
    /// The date of the core field, before the flight's own.
    decimal_year: Option<f64>, unit "a", rule Rule::Between(1900.0, 2030.0);
    /// How the map is interpolated: bilinear, or by a natural cubic spline.
    map_interpolation: String, unit "", default "linear", rule Rule::OneOf(&["linear", "cubic"]);
    /// The heights above the ellipsoid, ascending, to which the map is continued; between them it is interpolated. Left
    /// out, the map is taken at its own height, whatever that of the flight.
    map_levels_m: Option<Vec<f64>>, unit "m";
    /// Append the state `x` and its covariance `p` (row-major).
    save_state: bool, unit "", default false;
    /// The mean of measurement minus prediction over the first seconds of a line, taken off before filtering; 0 takes
    /// nothing off. Compensation leaves a constant undetermined.
    offset_window_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
    /// A measurement whose squared innovation over its variance is above this is not used; left out, all are used.
    gate_nis: Option<f64>, unit "1", rule Rule::Positive;
    /// How the process noise becomes a step's covariance: to second order, to first order as MagNav.jl, or exactly.
    discretisation: String, unit "", default "trapezoidal", rule Rule::OneOf(&["trapezoidal", "rectangular", "van_loan"]);
    /// Measurement noise: sensor, map and what compensation left.
    measurement_sigma_nt: f64, unit "nT", default 5.0, rule Rule::Positive;
    /// Initial horizontal position error, each axis.
    init_position_sigma_m: f64, unit "m", default 3.0, rule Rule::NotNegative;
    /// Initial height error.
    init_altitude_sigma_m: f64, unit "m", default 0.001, rule Rule::NotNegative;
    /// Initial velocity error, each axis.
    init_velocity_sigma_mps: f64, unit "m/s", default 0.01, rule Rule::NotNegative;
    /// Initial tilt error, each axis.
    init_attitude_sigma_deg: f64, unit "deg", default 0.01, rule Rule::NotNegative;
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
    /// Temporal variation.
    fogm_sigma_nt: f64, unit "nT", default 3.0, rule Rule::NotNegative;
    /// Time constant of the barometer error.
    baro_tau_s: f64, unit "s", default 3600.0, rule Rule::Positive;
    /// Time constant of the accelerometer bias.
    acc_tau_s: f64, unit "s", default 3600.0, rule Rule::Positive;
    /// Time constant of the gyro bias.
    gyro_tau_s: f64, unit "s", default 3600.0, rule Rule::Positive;
    /// Time constant of the temporal variation.
    fogm_tau_s: f64, unit "s", default 600.0, rule Rule::Positive;
}

const POSITION: [&str; 3] = ["ins_lat", "ins_lon", "ins_alt"];
const VELOCITY: [&str; 3] = ["ins_vn", "ins_ve", "ins_vd"];
const FORCE: [&str; 3] = ["ins_fn", "ins_fe", "ins_fd"];
const ATTITUDE: [&str; 3] = ["ins_roll", "ins_pitch", "ins_yaw"];

impl Navigate {
    fn parameters(&self) -> EkfParameters {
        let errors = InsErrorModel {
            init_position_sigma_m: self.init_position_sigma_m,
            init_altitude_sigma_m: self.init_altitude_sigma_m,
            init_velocity_sigma_mps: self.init_velocity_sigma_mps,
            init_attitude_sigma_deg: self.init_attitude_sigma_deg,
            vrw_sigma: self.vrw_sigma,
            arw_sigma: self.arw_sigma,
            baro_sigma_m: self.baro_sigma_m,
            ha_sigma_m: self.ha_sigma_m,
            a_hat_sigma_mps2: self.a_hat_sigma_mps2,
            acc_sigma_mps2: self.acc_sigma_mps2,
            gyro_sigma_radps: self.gyro_sigma_radps,
            fogm_sigma_nt: self.fogm_sigma_nt,
            baro_tau_s: self.baro_tau_s,
            acc_tau_s: self.acc_tau_s,
            gyro_tau_s: self.gyro_tau_s,
            fogm_tau_s: self.fogm_tau_s,
            noise: match self.discretisation.as_str() {
                "rectangular" => NoiseDiscretisation::Rectangular,
                "van_loan" => NoiseDiscretisation::VanLoan,
                _ => NoiseDiscretisation::Trapezoidal,
            },
            ..InsErrorModel::default()
        };
        EkfParameters {
            errors,
            measurement_sigma_nt: self.measurement_sigma_nt,
            offset_window_s: self.offset_window_s,
            gate_nis: self.gate_nis,
            keep_covariance: self.save_state,
        }
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
        reads.into_iter().map(str::to_owned).collect()
    }

    fn dated_by_flight(&self, shape: &Shape) -> bool {
        self.core_field && self.decimal_year.is_none() && dated_by_flight(shape)
    }

    fn notes(&self, shape: &Shape) -> Vec<String> {
        let mut notes = vec![];
        if self.core_field && self.decimal_year.is_none() && !self.dated_by_flight(shape) {
            let what = "the flight has no `year` and `doy`, so the core field is that of";
            notes.push(format!("{what} {DEFAULT_YEAR:.2}; say `decimal_year` for another date"));
        }
        for (three, from) in [(VELOCITY, "INS positions"), (FORCE, "INS velocities"), (ATTITUDE, "the course, level")] {
            let missing: Vec<&str> = three.into_iter().filter(|c| shape.get(c).is_none()).collect();
            if !missing.is_empty() {
                notes.push(format!("no {}: derived from {from}", missing.join(", ")));
            }
        }
        notes
    }

    fn core(&self, batch: &RecordBatch) -> Result<Option<CoreField>, Fault> {
        if !self.core_field {
            return Ok(None);
        }
        let year = match (self.decimal_year, batch.column_by_name("year").is_some()) {
            (Some(year), _) => year,
            (None, false) => DEFAULT_YEAR,
            (None, true) => first_year(batch)?,
        };
        CoreField::at(year).map(Some).map_err(data)
    }
}

impl Stage for Navigate {
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let mut faults = faults_of([shape.number(&self.mag, "nT")], "mag");
        faults.extend(faults_of(["ins_lat", "ins_lon"].map(|c| shape.number(c, "deg")), "input"));
        faults.extend(faults_of([shape.number("ins_alt", "m")], "input"));
        faults.extend(check_levels(self.map_levels_m.as_ref(), "map_levels_m"));
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
        yields.reads.push(vec!["anomaly".to_owned()]);
        yields.passes = Passes::Only(schemas::flight::KEYS.map(str::to_owned).to_vec());
        yields.notes = self.notes(shape);
        Ok(yields)
    }

    fn run(&self, line: &LineIn) -> Result<Vec<ArrayRef>, Fault> {
        let batch = &line.inputs[0];
        let map = line
            .prepared
            .as_ref()
            .and_then(|p| p.downcast_ref::<FieldMap>())
            .ok_or_else(|| Fault::data("the map is missing"))?;
        let tt = floats(batch, "tt")?;
        let three = |names: [&str; 3]| -> Result<[&[f64]; 3], Fault> {
            Ok([floats(batch, names[0])?, floats(batch, names[1])?, floats(batch, names[2])?])
        };
        let there = |names: [&str; 3]| batch.column_by_name(names[0]).is_some();
        let [lat_deg, lon_deg, alt_m] = three(POSITION)?;
        let velocity = if there(VELOCITY) {
            three(VELOCITY)?.map(<[f64]>::to_vec)
        } else {
            strapdown::velocity_ned_mps(tt, lat_deg, lon_deg, alt_m).map_err(data)?
        };
        let [vn_mps, ve_mps, vd_mps] = [&velocity[0][..], &velocity[1], &velocity[2]];
        let force = if there(FORCE) {
            three(FORCE)?.map(<[f64]>::to_vec)
        } else {
            strapdown::specific_force_ned_mps2(tt, vn_mps, ve_mps, vd_mps).map_err(data)?
        };
        let attitude = if there(ATTITUDE) {
            three(ATTITUDE)?.map(<[f64]>::to_vec)
        } else {
            strapdown::level_attitude_deg(vn_mps, ve_mps).map_err(data)?
        };
        let ([fn_mps2, fe_mps2, fd_mps2], [roll, pitch, yaw]) = (&force, &attitude);
        let ins = InsSeries::of([
            tt, lat_deg, lon_deg, alt_m, vn_mps, ve_mps, vd_mps, fn_mps2, fe_mps2, fd_mps2, roll, pitch, yaw,
        ]);
        let measured = floats(batch, &self.mag)?;
        let core = self.core(batch)?;
        let output = ekf::run(&self.parameters(), &ins, measured, map, core.as_ref()).map_err(data)?;
        if output.report.updates == 0 {
            let what = format!(
                "no sample could be used: {} without a measurement, {} off the map",
                output.report.missing_measurements, output.report.off_map
            );
            return Err(Fault::data(what).help("does the map cover the flight?"));
        }
        if self.offset_window_s > 0.0 && output.report.offset_samples == 0 {
            return Err(Fault::data(
                "no sample within `offset_window_s` has a measurement and a map value, so the offset is unknown",
            ));
        }
        self.arrays(output, measured)
    }

    fn prepare(&self, inputs: &[RecordBatch]) -> Result<Prepared, Fault> {
        let map = inputs.get(1).ok_or_else(|| Fault::data("the map is missing"))?;
        let map = field_map(map, interpolation(&self.map_interpolation), self.map_levels_m.as_deref())?;
        Ok(Some(Arc::new(map)))
    }

    fn prepare_key(&self) -> String {
        format!("{} {:?}", self.map_interpolation, self.map_levels_m)
    }
}

impl Navigate {
    fn arrays(&self, out: EkfOutput, measured: &[f64]) -> Result<Vec<ArrayRef>, Fault> {
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
        ];
        if self.save_state {
            arrays.push(list(out.x.into_iter().flatten().collect(), STATES)?);
            arrays.push(list(out.p.into_iter().flatten().flatten().collect(), STATES * STATES)?);
        }
        Ok(arrays)
    }
}
