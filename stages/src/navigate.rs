//! Navigation by the magnetic anomaly.

mod aiding;
mod aircraft;
mod calibrations;
mod crlb;
mod ekf;
mod ekf_adaptive;
mod ekf_online_nn;
mod ekf_online_tl;
mod field_keys;
mod filter;
mod filters;
mod fixed_lag;
mod flown;
mod further;
mod geometry;
mod iekf;
mod ins;
mod ins_only;
mod line_noise;
mod mpf;
mod mpf_then_ekf;
mod nekf;
mod prepared;
mod rts;
mod slam;
mod start;
#[cfg(test)]
mod testing;
mod tuning;
mod ukf;
mod wide_start;

use std::sync::Arc;

use arrow_array::{ArrayRef, RecordBatch, StringArray};
use numerics::{maps::map_surface::MapInterpolation, navigation::ins_error::InsErrorSpec};
use prepared::NavigationMaps;
use schemas::{
    ChoiceRegistry, ChoiceSelection, Column, Fault, LineInput, LineOutput, LinePoint, LineStage, MagneticCorrection,
    NumberOrAuto, PassThroughColumns, Stage, StageEntry, StageSchema, Table, TableShape, stage,
};

use aiding::{Aiding, GnssPositions, both};
pub(crate) use aiding::{GNSS_UPDATE, GnssOutcome};
pub use calibrations::CalibrationPrior;
pub use field_keys::FieldKeys;
pub use filter::{
    FilterDecl, FilterFlight, FilterGroups, FilterInput, FilterMagnetometer, FilterPoint, FilterTrack,
    NavigationFilter, UpdateOutcome, filter, navigate_points,
};
pub use filters::FILTERS;
pub(crate) use flown::with_filter_input;
use further::{AuxiliaryMeasurements, constant_columns};
pub use geometry::{DeadZones, SensorGeometry};
pub(crate) use nekf::{Nekf, feature_faults, features_of, is_near_rate, mean_rate_hz, network_terms};
pub(crate) use prepared::NavigationMap;
pub use prepared::NavigationResources;
pub use start::{StartKeys, StartSource};
pub use tuning::{MeasurementNoise, Tuning};
pub use wide_start::START_COLUMNS;
pub(crate) use {crlb::DRMS_BOUND, further::MAP_SLOPE};

use crate::{
    columns::{array, faults_of, floats, shape},
    corrections::{CORE_FIELD, REMOVE_DIURNAL, corrects, note, twice},
    dates::{WAYS_OUT, dated_by_flight, first_year},
    maps::check_levels,
    model_columns::RATE,
};

stage! {
    /// Corrects an INS by matching the compensated field to an anomaly map with one of the filters below.
    ///
    /// The states are the errors of the INS (truth minus INS) and the temporal variation. The estimate is the INS value
    /// plus the state. Each row holds the estimate after the measurement update of its sample (a posteriori). `update`
    /// gives the outcome for the measurement: `used`; `missing` (NaN); `off_map` (predicted position off the map or in
    /// a cell with an unknown node); `gated` (outlier); `flat` (map too flat to observe the position, `flat_over_m`);
    /// `unused` (not needed by the filter). If the measurement of a sample is not used, the filter makes only the time
    /// update, and `residual` and `nis` are NaN.
    ///
    /// On a flat map, a measurement corrects only the temporal variation. With `core_field = true`, the slope of the
    /// core field also corrects the position slightly. A line with a NaN in an INS column is rejected, and the error
    /// message gives the row. If the INS columns of velocity, specific force or attitude are missing, they are derived
    /// from the INS positions or velocities. Derived roll and pitch angles are 0, and the derived yaw angle is the
    /// course.
    ///
    /// The map is used at its own height unless `map_levels_m` or `tuning = "auto"` continues it. `map_height_error` is
    /// the expected rms error of the map at the mean height of the line, computed from the spectrum of the whole map.
    /// For a continued map, this is the error of downward continuation: amplified noise plus the field that damping
    /// removes. The column is NaN if the map's height is unknown. A map in eastings and northings is interpolated on
    /// its native grid.
    ///
    /// Filters that linearise the map require an initial position error smaller than the distance over which the map is
    /// nearly linear. `start_sigma` is the standard deviation of the initial position. `start_sigma_limit` is the
    /// largest standard deviation for which the map is nearly linear. Up to this limit, the linearisation error is
    /// below the white noise, or below a third of the change that the linearised map predicts (medians over a minute of
    /// flight). A larger `start_sigma` is flagged (`wide_start` in the table of warnings), because these filters may
    /// then diverge unnoticed. In this case, use `filter = "mpf_then_ekf"`.
    ///
    /// The core field (IGRF-14) is computed at one date per line: `decimal_year`, or the flight's first sample with
    /// both `year` and `doy`. A flight without a date is rejected unless `core_field = false`.
    ///
    /// `measurement_sigma_nt`, `fogm_sigma_nt` and `fogm_tau_s` may be `"auto"`. This value selects the noise of the
    /// calibration residual, from the columns `mag_sigma`, `mag_fogm_sigma` and `mag_fogm_tau`. `compensate` estimates
    /// these columns from the lines to which its model was fitted; `residual_noise` and `assume_noise` estimate them
    /// from lines over a known field. If `offset_window_s` is set, the offset removes the slowly varying error at the
    /// start of the line. The remaining error is the change since the start, so the variance and the time constant from
    /// the columns are doubled. With `measurement_sigma_nt = "auto"` and `map_interpolation = "linear"`, the
    /// interpolation error is added to the white noise.
    Navigate = "navigate", version 13, grain Line, role EstimatesTrack,
    inputs [input: Lines, map: Map optional, model: ManyModels optional],
    groups [field: FieldKeys, noise: MeasurementNoise, start: StartKeys, geometry: SensorGeometry, ins: InsErrorSpec],
    example r#"
[[stages]]
name            = "navigate"
stage           = "navigate"
input           = "assume_noise"
map             = "anomaly"
offset_window_s = 1.0
core_field      = false
"#;
    /// Navigation filter.
    filter: ChoiceSelection<FilterDecl>, unit "";
}

const POSITION: [&str; 3] = ["ins_lat", "ins_lon", "ins_alt"];
const VELOCITY: [&str; 3] = ["ins_vn", "ins_ve", "ins_vd"];
const FORCE: [&str; 3] = ["ins_fn", "ins_fe", "ins_fd"];
const ATTITUDE: [&str; 3] = ["ins_roll", "ins_pitch", "ins_yaw"];
const DIURNAL: &str = "diurnal";
const ANOMALY: &str = "anomaly";
const TERM: &str = "term";
const VALUE: &str = "value";
const STD: &str = "std";

/// Columns read from a model table.
fn of_model(model: &Table) -> Vec<&'static str> {
    [TERM, VALUE, STD].into_iter().chain(model.shape().get(RATE).map(|_| RATE)).collect()
}

/// The map input and the model inputs, each identified by columns that no other input has.
fn map_and_models(inputs: &[RecordBatch]) -> (Option<&RecordBatch>, impl Iterator<Item = &RecordBatch>) {
    let further = inputs.iter().skip(1);
    let has = |table: &&RecordBatch, name: &str| table.column_by_name(name).is_some();
    (further.clone().find(move |table| has(table, ANOMALY)), further.filter(move |table| has(table, TERM)))
}

/// Column for `score`: the expected error of a map that is used at a height other than its own.
pub(crate) const MAP_HEIGHT_ERROR: &str = "map_height_error";

/// Catalogue entry of the stage, with `filters` to choose from.
pub fn entry(filters: Vec<&'static FilterDecl>) -> StageEntry {
    let kinds = filters.iter().map(|filter| filter.document()).collect();
    StageEntry { kinds, ..Navigate::entry_with(ChoiceRegistry::default().with(filters)) }
}

impl Navigate {
    /// Interpolation of the map.
    fn interpolation(&self) -> MapInterpolation {
        let usual = if self.is_auto() { MapInterpolation::Cubic } else { MapInterpolation::Linear };
        self.field.map_interpolation.unwrap_or(usual)
    }

    /// Magnetometers that the filter uses.
    fn magnetometers(&self) -> &[String] {
        if self.filter.keys.takes_field() { &self.field.mag } else { &[] }
    }

    /// Whether the temporal variation is subtracted.
    fn removes_diurnal(&self, shape: &TableShape) -> bool {
        let there = shape.get(DIURNAL).is_some();
        corrects(shape, self.magnetometers(), MagneticCorrection::Diurnal, self.field.remove_diurnal, there)
            && self.filter.keys.takes_field()
    }

    /// Faults of corrections that have already been applied.
    fn corrections_twice(&self, shape: &TableShape) -> Vec<Fault> {
        let mags = self.magnetometers();
        let there = shape.get(DIURNAL).is_some() || self.field.remove_diurnal.is_some();
        let diurnal = twice(shape, mags, MagneticCorrection::Diurnal, self.field.remove_diurnal, REMOVE_DIURNAL)
            .filter(|_| there);
        let core = twice(shape, mags, MagneticCorrection::Core, Some(self.field.core_field), CORE_FIELD);
        diurnal.into_iter().chain(core).collect()
    }

    /// The columns of the flight that are read: available INS columns and the date.
    fn reads(&self, shape: &TableShape) -> Vec<String> {
        let mut reads: Vec<&str> = vec!["tt"];
        reads.extend(self.magnetometers().iter().map(String::as_str));
        reads.extend(POSITION);
        for three in [VELOCITY, FORCE, ATTITUDE] {
            if three.iter().all(|c| shape.get(c).is_some()) {
                reads.extend(three);
            }
        }
        if self.dated_by_flight(shape) {
            reads.extend(["year", "doy"]);
        }
        if self.removes_diurnal(shape) {
            reads.push(DIURNAL);
        }
        reads.extend(self.of_calibration().iter().filter(|f| f.0 == Some(NumberOrAuto::Auto)).map(|f| f.2));
        let of_start = self.start_reads(shape);
        reads.extend(of_start.iter().map(String::as_str));
        reads.extend(self.noise_column());
        let mut all: Vec<String> = vec![];
        for name in reads.into_iter().map(str::to_owned).chain(self.geometry.reads()) {
            if !all.contains(&name) {
                all.push(name);
            }
        }
        all
    }

    fn dated_by_flight(&self, shape: &TableShape) -> bool {
        self.field.core_field && self.field.decimal_year.is_none() && dated_by_flight(shape)
    }

    fn notes(&self, shape: &TableShape) -> Vec<String> {
        let mut notes = vec![];
        notes.extend(self.start_note(shape));
        notes.extend(note(shape, self.magnetometers(), MagneticCorrection::Diurnal, self.field.remove_diurnal));
        if self.field.remove_diurnal.is_none() && self.removes_diurnal(shape) {
            notes.push(format!(
                "`{DIURNAL}` is subtracted from the measurement; set `remove_diurnal = false` to keep it"
            ));
        }
        for (three, from) in [(VELOCITY, "INS positions"), (FORCE, "INS velocities"), (ATTITUDE, "the course, level")] {
            let missing: Vec<&str> = three.into_iter().filter(|c| shape.get(c).is_none()).collect();
            if !missing.is_empty() {
                notes.push(format!("{} missing: derived from {from}", missing.join(", ")));
            }
        }
        notes
    }

    /// Date of the core field; `None` if the measurement does not contain the core field.
    fn core_year(&self, batch: &RecordBatch) -> Result<Option<f64>, Fault> {
        match self.field.decimal_year {
            _ if !self.field.core_field => Ok(None),
            Some(year) => Ok(Some(year)),
            None => first_year(batch).map(Some),
        }
    }
}

impl Stage for Navigate {
    fn effort(&self) -> f64 {
        self.filter.keys.effort()
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        let unused = key == "noise_column" && !self.filter.keys.takes_field();
        let what = || Fault::new(format!("the filter `{}` does not use `noise_column`", self.filter.kind.name));
        let noise = unused.then(what);
        let filter = &self.filter.keys;
        let of_groups = || {
            let of_aiding = filter.aiding().and_then(|aiding| aiding.unused_key(key));
            of_aiding.or_else(|| filter.further().and_then(|further| further.unused_key(key)))
        };
        let own = self.filter.foreign(key).or(noise).or_else(|| self.geometry.unused_key(key));
        own.or_else(|| filter.unused_key(key)).or_else(of_groups)
    }

    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let mut faults = faults_of(self.magnetometers().iter().map(|mag| shape.number(mag, "nT")), "mag");
        if self.field.mag.is_empty() {
            faults.push(Fault::new("`mag` names no magnetometer").of_param("mag"));
        }
        if let Some(twice) = self.field.mag.iter().enumerate().find(|(i, mag)| self.field.mag[..*i].contains(mag)) {
            faults.push(Fault::new(format!("`{}` is a duplicate", twice.1)).of_param("mag"));
        }
        faults.extend(faults_of(["ins_lat", "ins_lon"].map(|c| shape.number(c, "deg")), "input"));
        faults.extend(faults_of([shape.number("ins_alt", "m")], "input"));
        faults.extend(check_levels(self.field.map_levels_m.as_ref(), "map_levels_m"));
        faults.extend(self.auto_faults(shape));
        faults.extend(self.start_faults(shape));
        faults.extend(self.noise_faults(shape));
        if self.field.remove_diurnal == Some(true) {
            let found = shape.number(DIURNAL, "nT").map_err(|f| f.help("set `remove_diurnal = false`"));
            faults.extend(faults_of([found], "remove_diurnal"));
        }
        faults.extend(self.corrections_twice(shape));
        if self.field.core_field && self.field.decimal_year.is_none() && !dated_by_flight(shape) {
            let what = "the core field needs a date, but the flight has no `year` and `doy`";
            faults.push(Fault::new(what).help(WAYS_OUT).of_param("decimal_year"));
        }
        let flight = FilterFlight {
            shape,
            mags: &self.field.mag,
            has_direction: self.geometry.vector.is_some(),
            core_field: self.field.core_field,
            interpolation: self.interpolation(),
        };
        let filter = &self.filter.keys;
        faults.extend(self.geometry.faults(shape, filter.takes_direction()));
        let of_groups = both(
            filter.aiding().map_or(Ok(vec![]), |aiding| aiding.reads(&flight)),
            filter.further().map_or(Ok(vec![]), |further| further.reads(&flight)),
        );
        let further = both(filter.reads(&flight), of_groups).map_err(|more| faults.extend(more)).unwrap_or_default();
        let tables = &inputs[1..];
        let map = tables.iter().position(|table| matches!(table, Table::Map(_)));
        let models: Vec<usize> = (0..tables.len()).filter(|i| matches!(tables[*i], Table::Model { .. })).collect();
        faults.extend(self.input_faults(map.is_some(), !models.is_empty()));
        if let (Some(_), Some(Table::Map(shape))) = (self.field.map_error_length_m, map.map(|at| tables[at]))
            && let Err(fault) = shape.number(schemas::map::ERROR, "nT")
        {
            let help = "make the map with `map_grid` and `cross_validate`, or add the column to a Parquet map";
            faults.push(fault.of_param("map_error_length_m").help(help));
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let mut reads = self.reads(shape);
        reads.extend(further.into_iter().filter(|column| !reads.contains(column)).collect::<Vec<_>>());
        let made = |c: Column| {
            let c = map.iter().fold(c.from(0, &reads), |c, map| c.from(1 + map, &[ANOMALY]));
            models.iter().fold(c, |c, model| c.from(1 + model, &of_model(tables[*model])))
        };
        let named = [
            ("lat", "deg", "estimated latitude, WGS-84"),
            ("lon", "deg", "estimated longitude, WGS-84"),
            ("alt", "m", "estimated height above the WGS-84 ellipsoid"),
            ("vn", "m/s", "estimated velocity north"),
            ("ve", "m/s", "estimated velocity east"),
            ("vd", "m/s", "estimated velocity down"),
            ("sd_n", "m", "standard deviation of the position error north"),
            ("sd_e", "m", "standard deviation of the position error east"),
            ("cov_ne", "m2", "covariance of the north and east position errors"),
            ("residual", "nT", "innovation: measurement minus prediction; NaN where no measurement was used"),
            ("nis", "1", "normalised innovation squared"),
        ];
        let mut columns: Vec<Column> = named.into_iter().map(|(n, u, d)| made(Column::float(n, u, d))).collect();
        columns.push(made(Column::text(
            "update",
            "outcome of the measurement: used, missing, off_map, gated, flat or unused",
        )));
        let height =
            "expected rms error of the map at the height of the line; NaN where the height of the map is unknown";
        columns.push(made(Column::float(MAP_HEIGHT_ERROR, "nT", height)));
        columns.extend(self.start_columns().into_iter().map(made));
        columns.extend(self.noise_columns(map.is_some()).into_iter().map(made));
        columns.extend(filter.columns(&flight).into_iter().map(made));
        columns.extend(constant_columns(self.has_constants(map.is_some())).into_iter().map(made));
        columns.extend(filter.further().into_iter().flat_map(AuxiliaryMeasurements::columns).map(made));
        columns.extend(filter.aiding().into_iter().flat_map(Aiding::columns).map(made));
        let mut yields = StageSchema::append(columns, &reads);
        yields.reads.extend(tables.iter().map(|table| match table {
            model @ Table::Model { .. } => of_model(model).into_iter().map(str::to_owned).collect(),
            Table::Map(_) | Table::Lines(_) | Table::Scores(_) => {
                let own_error = self.reads_map_error(table).then_some(schemas::map::ERROR);
                [ANOMALY, "alt"].into_iter().chain(own_error).map(str::to_owned).collect()
            }
        }));
        yields.passes = PassThroughColumns::Only(schemas::flight::KEYS.map(str::to_owned).to_vec());
        yields.notes = self.notes(shape);
        Ok(yields)
    }
}

impl LineStage for Navigate {
    type Prepared = NavigationResources;

    fn run(&self, line: &LineInput, prepared: &NavigationResources) -> LineOutput {
        let answer = Self::run_points(&[LinePoint { stage: self, line, prepared }]).pop();
        answer.unwrap_or_else(|| Err(Fault::bug("the result of a point is missing")))
    }

    fn run_points(points: &[LinePoint<Self>]) -> Vec<LineOutput> {
        flown::run(points)
    }

    fn prepare(&self, inputs: &[RecordBatch]) -> Result<NavigationResources, Fault> {
        let (map, models) = map_and_models(inputs);
        let models = models.map(CalibrationPrior::from_table).collect::<Result<_, Fault>>()?;
        Ok(NavigationResources { map: map.map(|map| NavigationMaps::new(map, self)).transpose()?, models })
    }

    fn prepare_key(&self) -> String {
        let (own_error, tuning) = (self.field.map_error_length_m.is_some(), self.field.tuning.word());
        let (levels, reach_m) = (&self.field.map_levels_m, self.height_reach_m());
        format!("{} {levels:?} {reach_m} {own_error} {tuning}", self.interpolation().word())
    }
}

impl Navigate {
    /// Whether the errors of a map's nodes are read.
    fn reads_map_error(&self, map: &Table) -> bool {
        let there = match map {
            Table::Map(shape) => shape.get(schemas::map::ERROR).is_some(),
            Table::Lines(_) | Table::Model { .. } | Table::Scores(_) => false,
        };
        self.field.map_error_length_m.is_some() || self.is_auto() && there
    }

    /// Faults of the tables other than the flight.
    fn input_faults(&self, map: bool, models: bool) -> Vec<Fault> {
        let (name, filter) = (self.filter.kind.name, &self.filter.keys);
        let mut faults = vec![];
        if !map && filter.needs_map() {
            let what = format!("the filter `{name}` requires a map; set `map`");
            faults.push(Fault::new(what));
        }
        if map && !filter.takes_map() {
            faults.push(
                Fault::new(format!("the filter `{name}` uses no map; remove the map from the stage")).of_param("map"),
            );
        }
        if !models && filter.needs_model() {
            let what = format!("the filter `{name}` requires a trained network; set `model`");
            faults.push(Fault::new(what).of_param("model").help("name the table of a `noise_network` stage"));
        }
        if models && !filter.takes_models() {
            faults.push(Fault::new(format!("the filter `{name}` uses no model; remove `model`")).of_param("model"));
        }
        faults
    }

    /// Measurement of a magnetometer, minus the diurnal variation if `remove_diurnal` is set.
    fn measured(&self, batch: &RecordBatch, mag: &str) -> Result<Vec<f64>, Fault> {
        let mut measured = floats(batch, mag)?.to_vec();
        if self.removes_diurnal(&TableShape::from_schema(&batch.schema())) {
            let diurnal = floats(batch, DIURNAL).map_err(|f| f.help("set `remove_diurnal = false`"))?;
            measured.iter_mut().zip(diurnal).for_each(|(m, d)| *m -= d);
        }
        Ok(measured)
    }

    /// The track as arrays; every column must have a value for each sample.
    fn arrays(&self, track: FilterTrack, flown: &FilterInput, height_error_nt: f64) -> Result<Vec<ArrayRef>, Fault> {
        let rows = flown.ins.len();
        let fate =
            |(row, update): (usize, &UpdateOutcome)| flown.left_out.get(row).copied().flatten().unwrap_or(*update);
        let update = track.update.iter().enumerate().map(|at| Some(fate(at).word())).collect::<StringArray>();
        let mut arrays: Vec<ArrayRef> = vec![
            array(track.lat_deg),
            array(track.lon_deg),
            array(track.alt_m),
            array(track.vn_mps),
            array(track.ve_mps),
            array(track.vd_mps),
            array(track.sd_n_m),
            array(track.sd_e_m),
            array(track.cov_ne_m2),
            array(track.residual_nt),
            array(track.nis),
            Arc::new(update),
            array(vec![height_error_nt; rows]),
        ];
        arrays.extend(self.start_arrays(flown));
        arrays.extend(self.noise_arrays(flown));
        arrays.extend(track.more);
        arrays.extend(flown.gnss.as_ref().map(GnssPositions::array));
        if arrays.iter().any(|array| arrow_array::Array::len(array) != rows) {
            let what =
                format!("the filter `{}` returns columns whose length differs from the line's", self.filter.kind.name);
            return Err(Fault::bug(what));
        }
        Ok(arrays)
    }
}

#[cfg(test)]
mod tests;
