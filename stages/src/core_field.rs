//! Appends the core field.

use arrow_array::RecordBatch;
use nalgebra::Vector3;
use numerics::earth::{
    attitude::body_to_ned,
    core_field::{CoreFieldError, CoreFieldModel, CoreFieldTrack, GeodeticCoordinate, NedField},
};
use schemas::{
    Column, Fault, LineInput, LineOutput, LineStage, MagneticCorrection, Rule, Stage, StageSchema, Table, TableShape,
    choice, stage,
};

use crate::{
    columns::{array, data, faults_of, floats, shape},
    dates::{dated_by_flight, years},
};

stage! {
    /// Appends the core field at every sample: the magnitude `igrf` and the components `igrf_n`, `igrf_e`, `igrf_d`
    /// (north, east, down). If an attitude is available, the stage also appends `igrf_x`, `igrf_y`, `igrf_z` in the
    /// body frame (nose, right wing, down). `column` changes these names. An existing column of the same name is
    /// replaced.
    ///
    /// The date of each sample follows from `year`, `doy` and `tt` of the flight. `decimal_year` sets one date for all
    /// samples. Heights are above the WGS-84 ellipsoid. The result is NaN for a sample without a position. A body
    /// component is NaN if it depends on a missing angle.
    ///
    /// A flight without a date is rejected unless `decimal_year` is set. A date outside the model's range is rejected.
    /// An impossible position is rejected too: latitude beyond 90 degrees, longitude outside -180 to 360 degrees,
    /// height outside -10 to 2,000 km.
    ///
    /// Source: IGRF-14 (IAGA, doi:10.5281/zenodo.14012302); WMM2020 and WMM2025 (NOAA NCEI and BGS).
    CoreFieldStage = "core_field", version 2, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name         = "core_field"
stage        = "core_field"
input        = "resample"
decimal_year = 2020.5
"#;
    /// Model: `igrf` (IGRF-14, 1900 to 2030) or `wmm` (the World Magnetic Model, 2020 to 2030).
    model: CoreFieldModel, unit "", default CoreFieldModel::Igrf14;
    /// Name of the column for the magnitude. The components' names are this name plus a suffix.
    column: String, unit "", default "igrf";
    /// Position at which the field is computed: the true position (`lat`, `lon`, `alt`) or the INS position.
    position: PositionSource, unit "", default PositionSource::Truth;
    /// Attitude that rotates the field into the body frame. With `none`, the body components are omitted.
    attitude: Option<AttitudeSource>, unit "",
        absent "the attitude of the INS if present, otherwise the true attitude if present";
    /// Date of all samples, instead of the flight's date.
    decimal_year: Option<f64>, unit "a", absent "the flight's own date", rule Rule::Between(1900.0, 2030.0);
}

choice! {
    /// Source of the position.
    pub enum PositionSource {
        /// True position.
        Truth = "truth",
        /// Position of the INS.
        Ins = "ins",
    }
}

impl PositionSource {
    /// Latitude, longitude and height.
    pub(crate) fn columns(self) -> [&'static str; 3] {
        match self {
            PositionSource::Truth => ["lat", "lon", "alt"],
            PositionSource::Ins => ["ins_lat", "ins_lon", "ins_alt"],
        }
    }
}

choice! {
    /// Source of the attitude.
    pub enum AttitudeSource {
        /// True attitude.
        Truth = "truth",
        /// Attitude of the INS.
        Ins = "ins",
        /// No attitude; the body frame is omitted.
        None = "none",
    }
}

impl AttitudeSource {
    /// Roll, pitch and yaw.
    fn columns(self) -> Option<[&'static str; 3]> {
        match self {
            AttitudeSource::Truth => Some(["roll", "pitch", "yaw"]),
            AttitudeSource::Ins => Some(["ins_roll", "ins_pitch", "ins_yaw"]),
            AttitudeSource::None => None,
        }
    }
}

impl CoreFieldStage {
    /// Columns of the attitude. `None` if the body frame is omitted.
    fn attitude_columns(&self, shape: &TableShape) -> Option<[&'static str; 3]> {
        match self.attitude {
            Some(whose) => whose.columns(),
            None => [AttitudeSource::Ins, AttitudeSource::Truth]
                .into_iter()
                .filter_map(AttitudeSource::columns)
                .find(|c| c.iter().all(|n| shape.get(n).is_some())),
        }
    }

    /// Adds the column and the row of an impossible position to a fault.
    fn placed(&self, e: CoreFieldError) -> Fault {
        let [lat, lon, alt] = self.position.columns();
        match e {
            CoreFieldError::Position { coordinate, row, .. } => {
                let column = match coordinate {
                    GeodeticCoordinate::Latitude => lat,
                    GeodeticCoordinate::Longitude => lon,
                    GeodeticCoordinate::Height => alt,
                };
                data(e).in_column(column).in_row(row as u64)
            }
            CoreFieldError::Date { .. } | CoreFieldError::Coefficients { .. } => data(e).in_column("year"),
        }
    }

    fn made(&self, reads: &[String], body: bool) -> Vec<Column> {
        let name = &self.column;
        let column =
            |suffix: &str, doc: &str| Column::float(format!("{name}{suffix}"), "nT", doc.to_owned()).from(0, reads);
        let mut made = vec![
            Column { correction: Some(MagneticCorrection::Core), ..column("", "magnitude of the core field") },
            column("_n", "north component of the core field"),
            column("_e", "east component of the core field"),
            column("_d", "down component of the core field"),
        ];
        if body {
            made.push(column("_x", "core field in the body frame, component towards the nose"));
            made.push(column("_y", "core field in the body frame, component towards the right wing"));
            made.push(column("_z", "core field in the body frame, down component"));
        }
        made
    }
}

impl Stage for CoreFieldStage {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let place = self.position.columns();
        let units = ["deg", "deg", "m"];
        let mut faults = faults_of(place.iter().zip(units).map(|(c, unit)| shape.number(c, unit)), "position");
        let attitude = self.attitude_columns(shape);
        faults.extend(faults_of(attitude.iter().flatten().map(|c| shape.number(c, "deg")), "attitude"));
        let dated = dated_by_flight(shape);
        if self.decimal_year.is_none() && !dated {
            let what = "the core field needs a date, but the flight has no `year` and `doy`";
            faults.push(
                Fault::new(what).help("set `decimal_year`, such as `decimal_year = 2020.5`").of_param("decimal_year"),
            );
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let mut reads: Vec<String> = place.iter().chain(attitude.iter().flatten()).map(|c| (*c).to_owned()).collect();
        if self.decimal_year.is_none() {
            reads.extend(["tt", "year", "doy"].map(str::to_owned));
        }
        Ok(StageSchema::append(self.made(&reads, attitude.is_some()), &reads))
    }
}

impl LineStage for CoreFieldStage {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        let batch = &line.inputs[0];
        let [lat, lon, alt] = self.position.columns();
        let (lat, lon, alt) = (floats(batch, lat)?, floats(batch, lon)?, floats(batch, alt)?);
        let year = match self.decimal_year {
            Some(year) => vec![year; lat.len()],
            None => years(batch)?,
        };
        let field = CoreFieldTrack::new(self.model).field(lat, lon, alt, &year).map_err(|e| self.placed(e))?;
        let shape = TableShape::from_schema(&batch.schema());
        let body = self.attitude_columns(&shape).map(|attitude| in_body_frame(batch, attitude, &field)).transpose()?;
        let magnitude = field.magnitude_nt();
        let mut arrays = vec![array(magnitude), array(field.north_nt), array(field.east_nt), array(field.down_nt)];
        arrays.extend(body.into_iter().flatten().map(array));
        Ok(arrays)
    }
}

/// The field's components towards nose, right wing and down.
fn in_body_frame(batch: &RecordBatch, attitude: [&str; 3], field: &NedField) -> Result<[Vec<f64>; 3], Fault> {
    let [roll, pitch, yaw] = attitude;
    let (roll, pitch, yaw) = (floats(batch, roll)?, floats(batch, pitch)?, floats(batch, yaw)?);
    let mut body = [(); 3].map(|()| Vec::with_capacity(roll.len()));
    for i in 0..roll.len() {
        let turn = body_to_ned(roll[i].to_radians(), pitch[i].to_radians(), yaw[i].to_radians());
        let ned = Vector3::new(field.north_nt[i], field.east_nt[i], field.down_nt[i]);
        let xyz = turn.tr_mul(&ned);
        body.iter_mut().zip(xyz.iter()).for_each(|(column, x)| column.push(*x));
    }
    Ok(body)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::Arc;

    use arrow_array::{ArrayRef, Float64Array, cast::AsArray, types::Float64Type};

    use super::*;

    fn core_field(decimal_year: Option<f64>) -> CoreFieldStage {
        CoreFieldStage {
            model: CoreFieldModel::Igrf14,
            column: "igrf".into(),
            position: PositionSource::Truth,
            attitude: None,
            decimal_year,
        }
    }

    fn run(stage: &CoreFieldStage, columns: &[(&str, &[f64])]) -> Result<Vec<Vec<f64>>, Fault> {
        let column = |values: &[f64]| Arc::new(Float64Array::from(values.to_vec())) as ArrayRef;
        let batch = RecordBatch::try_from_iter(columns.iter().map(|(name, values)| (*name, column(values)))).unwrap();
        let line = LineInput { flight: "1".into(), line: "1.01".into(), inputs: vec![batch], keep: None };
        let arrays = stage.run(&line, &())?;
        Ok(arrays.iter().map(|a| a.as_primitive::<Float64Type>().values().to_vec()).collect())
    }

    #[test]
    fn val_igrf14_agrees_with_ppigrf_at_both_dates() {
        // Values from numerics/reference/navigation/igrf14_computed_values.csv: magnitude, north, east, down.
        let pacific = [46_740.993, 23_141.299, 1_354.233, 40_587.767];
        let date_line = [34_104.128, 33_467.591, 5_796.665, -3_067.671];
        let of_spec: [(&str, &[f64]); 3] =
            [("lat", &[47.9574, f64::NAN]), ("lon", &[-178.2449; 2]), ("alt", &[11_963.0; 2])];
        // Noon of day 183 is the middle of a year of 365 days: 2022.5.
        let of_flight: [(&str, &[f64]); 6] = [
            ("lat", &[0.0]),
            ("lon", &[180.0]),
            ("alt", &[0.0]),
            ("tt", &[43_200.0]),
            ("year", &[2022.0]),
            ("doy", &[183.0]),
        ];
        let spec = run(&core_field(Some(2025.238)), &of_spec).unwrap();
        let flight = run(&core_field(None), &of_flight).unwrap();
        for (made, expected) in [(&spec, pacific), (&flight, date_line)] {
            assert_eq!(made.len(), 4, "without an attitude there is no body frame");
            for (made, expected) in made.iter().zip(expected) {
                // The reference is printed to 0.001 nT. Its conversion from geodetic coordinates differs by 0.002 nT.
                assert!((made[0] - expected).abs() < 0.003, "{} {expected}", made[0]);
            }
            assert!((made[0][0] - made[1][0].hypot(made[2][0]).hypot(made[3][0])).abs() < 1e-9);
        }
        assert!(spec.iter().all(|column| column[1].is_nan()), "a sample without a position");
    }

    #[test]
    fn law_the_field_is_rotated_into_the_body_frame() {
        // The attitudes are: level to the east; to the north with the right wing down; to the north with the nose up;
        // without a heading.
        let (roll, pitch, yaw) = ([0.0, 90.0, 0.0, 0.0], [0.0, 0.0, 90.0, 0.0], [90.0, 0.0, 0.0, f64::NAN]);
        let columns: [(&str, &[f64]); 6] = [
            ("lat", &[45.0; 4]),
            ("lon", &[-75.0; 4]),
            ("alt", &[300.0; 4]),
            ("roll", &roll),
            ("pitch", &pitch),
            ("yaw", &yaw),
        ];
        let made = run(&core_field(Some(2020.5)), &columns).unwrap();
        let (n, e, d) = (made[1][0], made[2][0], made[3][0]);
        for (row, expected) in [[e, -n, d], [n, d, -e], [-d, e, n]].iter().enumerate() {
            for (axis, expected) in made[4..].iter().zip(expected) {
                // The computed cosine of 90 degrees is 6e-17.
                assert!((axis[row] - expected).abs() < 1e-9, "{row}: {} {expected}", axis[row]);
            }
        }
        assert!(made[4..].iter().all(|axis| axis[3].is_nan()) && made[..4].iter().all(|ned| ned[3].is_finite()));
        let level = CoreFieldStage { attitude: Some(AttitudeSource::None), ..core_field(Some(2020.5)) };
        assert_eq!(run(&level, &columns).unwrap().len(), 4);
    }

    #[test]
    fn unit_a_missing_date_is_reported_with_the_remedy() {
        let table = |names: &[(&str, &str)]| {
            let columns = names.iter().map(|(name, unit)| Column::float(*name, *unit, "")).collect();
            Table::Lines(TableShape { columns, rate_hz: None })
        };
        let place = [("tt", "s"), ("lat", "deg"), ("lon", "deg"), ("alt", "m")];
        let undated = table(&place);
        let faults = core_field(None).yields(&[&undated]).unwrap_err();
        assert_eq!(faults.len(), 1, "{faults:?}");
        assert!(faults[0].what.contains("needs a date"), "{}", faults[0]);
        assert!(faults[0].help.as_deref().unwrap().contains("`decimal_year`"));
        assert_eq!(faults[0].param.as_deref(), Some("decimal_year"));
        let of_spec = core_field(Some(2020.5)).yields(&[&undated]).unwrap();
        assert_eq!(of_spec.reads, [["lat", "lon", "alt"]]);
        let dated: Vec<_> = place.into_iter().chain([("year", ""), ("doy", "")]).collect();
        let of_flight = core_field(None).yields(&[&table(&dated)]).unwrap();
        assert_eq!(of_flight.reads, [["lat", "lon", "alt", "tt", "year", "doy"]]);
        let nowhere = core_field(None).yields(&[&table(&[("tt", "s")])]).unwrap_err();
        let params: Vec<_> = nowhere.iter().filter_map(|f| f.param.as_deref()).collect();
        assert_eq!(params, ["position", "position", "position", "decimal_year"], "all at once");
    }

    #[test]
    fn unit_an_impossible_position_or_date_is_reported() {
        let at = |lat: &[f64], year: f64| {
            run(&core_field(Some(year)), &[("lat", lat), ("lon", &[0.0, 0.0]), ("alt", &[0.0, 0.0])]).unwrap_err()
        };
        let place = at(&[45.0, 91.0], 2020.5).place;
        assert_eq!((place.column.as_deref(), place.row), (Some("lat"), Some(1)));
        assert!(at(&[45.0, 45.0], 2030.5).what.contains("1900 to 2030"));
    }
}
