//! Diurnal variation from observatory records.

mod station;

use std::collections::BTreeMap;

use arrow_array::{Array, RecordBatch, cast::AsArray};
use numerics::{
    earth::{dates::day_number, geodesy::ecef_m},
    signal::resample::SampleInterpolation,
};
use schemas::{
    Column, Fault, LineInput, LineOutput, LineStage, MagneticCorrection, Role, Rule, Stage, StageSchema, Table,
    TableShape, choice, stage,
};
use station::{Station, StationSamples, Stations};

use crate::{
    columns::{array, data, faults_of, floats, shape},
    core_field::PositionSource,
    dates::{DAY_S, WAYS_OUT_OF_NO_DAY, dated_by_flight, first_midnight, whole_numbers},
};

stage! {
    /// Appends `diurnal`, the variation of the external field: the record of an observatory or base station at the time
    /// of each sample, minus the level of the record. An existing column of that name is replaced.
    ///
    /// A record is a table of flight lines, with each station stored as a flight and each day as a line. The table has
    /// the columns `year`, `doy` and `tt`, and the column that `element` names. IAGA-2002 and IMF files are read in
    /// this form; their total field is the column `field_f`. If a record has no scalar magnetometer, compute the
    /// magnitude of `field_n`, `field_e` and `field_d` with `derive`. Every line can use all days of a record, so a
    /// line may cross midnight.
    ///
    /// Values are interpolated between samples of the record. They are NaN outside the record and in gaps longer than
    /// `max_gap_s`. A line is rejected if it has no date, or if the record covers none of its samples. Several
    /// stations, in one or more tables, are averaged at each sample with weights 1/distance^`power`. The result is NaN
    /// for a sample at which any station has no value.
    ///
    /// The level of each record is subtracted, so that a station contributes only its variation. `level` selects the
    /// mean of the whole record, or its mean over the duration of the line. `level_nt` sets the level explicitly, for
    /// example to the level of a quiet night. A variation record (IAGA `Data Type variation`) has no absolute level.
    Diurnal = "diurnal", version 2, grain Line, inputs [input: Lines, record: ManyRecords],
    example r#"
[[stages]]
name   = "diurnal"
stage  = "diurnal"
input  = "derive"
record = "observatory"
"#;
    /// Column of the record from which the variation is computed.
    element: String, unit "nT", default "field_f";
    /// Name of the new column.
    column: String, unit "nT", default "diurnal";
    /// Interpolation between samples of the record.
    method: SampleInterpolation, unit "", default SampleInterpolation::Linear;
    /// Longest gap in the record over which values are interpolated.
    max_gap_s: f64, unit "s", default 180.0, rule Rule::Positive;
    /// Level that is subtracted from each record.
    level: DiurnalBaseline, unit "", default DiurnalBaseline::Record;
    /// Level that is subtracted from the record of each station, by station name.
    level_nt: Option<BTreeMap<String, f64>>, unit "nT", absent "set by `level`", rule Rule::Finite;
    /// For several stations: power of the distance in the inverse-distance weights.
    power: f64, unit "1", default 1.0, rule Rule::NotNegative;
    /// For several stations: source of the position from which distances are measured.
    position: PositionSource, unit "", default PositionSource::Truth;
}

choice! {
    /// Level that is subtracted from a record.
    pub enum DiurnalBaseline {
        /// Mean of the whole record.
        Record = "record",
        /// Mean at the times of the line.
        Line = "line",
    }
}

const INPUT: usize = 0;
/// Columns of a station's position.
const PLACE: [&str; 2] = ["lat", "lon"];
/// Smallest distance used in the weights, so that a station below the aircraft has a finite weight.
const NEAREST_M: f64 = 1.0;

impl Diurnal {
    /// The position columns of the line; empty if the line has no position.
    fn position_of(&self, input: &TableShape) -> &'static [&'static str] {
        let columns: &'static [&'static str] = match self.position {
            PositionSource::Truth => &["lat", "lon"],
            PositionSource::Ins => &["ins_lat", "ins_lon"],
        };
        if columns.iter().all(|name| input.get(name).is_some()) { columns } else { &[] }
    }

    fn reads_of(&self, record: &TableShape) -> Vec<String> {
        let place = PLACE.iter().filter(|_| PLACE.iter().all(|name| record.get(name).is_some()));
        let reads = ["flight", "year", "doy", "tt", &self.element];
        reads.iter().chain(place).map(ToString::to_string).collect()
    }

    /// The samples of the stations of one table.
    fn gather(&self, record: &RecordBatch, found: &mut BTreeMap<String, StationSamples>) -> Result<(), Fault> {
        let names = record.column_by_name("flight").and_then(|c| c.as_string_opt::<i32>());
        let names = names.ok_or_else(|| Fault::data("the record has no column `flight` with the station's name"))?;
        let (year, doy) = (whole_numbers(record, "year")?, whole_numbers(record, "doy")?);
        let (tt, value) = (floats(record, "tt")?, floats(record, &self.element)?);
        let place = |row: usize| {
            let [lat, lon] = PLACE.map(|name| floats(record, name).ok().and_then(|x| x.get(row).copied()));
            lat.zip(lon).filter(|(lat, lon)| lat.is_finite() && lon.is_finite())
        };
        let rows = year.into_iter().zip(doy).zip(tt).zip(value).enumerate();
        for (row, (((year, doy), &tt), &value)) in rows {
            if ![year, doy, tt, value].iter().all(|x| x.is_finite()) {
                continue;
            }
            let name = if names.is_valid(row) { names.value(row) } else { "" };
            let station = found.entry(name.to_owned()).or_default();
            station.place_deg = station.place_deg.or_else(|| place(row));
            let day = day_number(year as i32, if doy >= 1.0 { doy as u32 } else { 0 });
            let day = day.map_err(|e| data(e).in_column("doy").in_line(name, ""))?;
            station.rows.push((day, tt.rem_euclid(DAY_S), value));
        }
        Ok(())
    }

    fn level_of(&self, station: &Station, on_line: &[f64]) -> f64 {
        if let Some(level) = self.level_nt.as_ref().and_then(|levels| levels.get(&station.name)) {
            return *level;
        }
        let values = match self.level {
            DiurnalBaseline::Record => &station.value_nt,
            DiurnalBaseline::Line => on_line,
        };
        let finite: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
        // The values are summed relative to the first value, so that a sum of thousands of fields keeps its precision.
        let first = finite.first().copied().unwrap_or(f64::NAN);
        first + finite.iter().map(|x| x - first).sum::<f64>() / finite.len() as f64
    }
}

impl Stage for Diurnal {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let input = shape(inputs, INPUT)?;
        let records = inputs.get(INPUT + 1..).unwrap_or_default();
        let mut faults = vec![];
        if !dated_by_flight(input) {
            let fault = Fault::new("records are matched by date, but `input` has no `year` and `doy`");
            faults.push(fault.help(WAYS_OUT_OF_NO_DAY).of_param("input"));
        }
        for record in records.iter().map(|table| table.shape()) {
            faults.extend(faults_of([record.number(&self.element, "nT")], "element"));
            faults.extend(faults_of(["flight", "tt", "year", "doy"].map(|name| record.need(name)), "record"));
        }
        let place = self.position_of(input);
        if records.len() > 1 && place.is_empty() {
            let fault = Fault::new("several stations are weighted by distance, but `input` has no position");
            faults.push(
                fault
                    .help("name one record, or set `position` to a source of positions in `input`")
                    .of_param("position"),
            );
        }
        if crate::columns::is_key(&self.column) {
            faults.push(
                Fault::new(format!(
                    "`{}` is a key of every line and cannot be replaced; choose another name",
                    self.column
                ))
                .of_param("column"),
            );
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let ours: Vec<&str> = ["tt", "year", "doy"].iter().chain(place).copied().collect();
        let mut column =
            Column::float(&self.column, "nT", "diurnal variation of the field, from the records of stations")
                .role(Role::Sensor)
                .from(INPUT, &ours);
        column.correction = Some(MagneticCorrection::Diurnal);
        let mut yields = StageSchema::append(vec![], &ours);
        for (i, record) in records.iter().enumerate() {
            let reads = self.reads_of(record.shape());
            column = column.from(INPUT + 1 + i, &reads);
            yields.reads.push(reads);
        }
        yields.columns = vec![column];
        Ok(yields)
    }
}

impl LineStage for Diurnal {
    type Prepared = Stations;

    fn prepare(&self, inputs: &[RecordBatch]) -> Result<Stations, Fault> {
        let mut found: BTreeMap<String, StationSamples> = BTreeMap::new();
        for record in inputs.iter().skip(INPUT + 1) {
            self.gather(record, &mut found)?;
        }
        let first_day = found.values().flat_map(|s| &s.rows).map(|row| row.0).min();
        let Some(first_day) = first_day else {
            return Err(Fault::data(format!("the record has no value of `{}`", self.element)));
        };
        if let Some(name) = self.level_nt.iter().flatten().map(|(name, _)| name).find(|name| !found.contains_key(*name))
        {
            let known: Vec<&String> = found.keys().collect();
            let fault = Fault::new(format!("`level_nt` names the station `{name}`, which has no record"));
            return Err(fault.nearest(name, &known).of_param("level_nt"));
        }
        let all = found.into_iter().map(|(name, samples)| Station::new(name, samples, first_day, self.max_gap_s));
        Ok(Stations { first_day, all: all.collect::<Result<_, Fault>>()? })
    }

    fn run(&self, line: &LineInput, stations: &Stations) -> LineOutput {
        let batch = line.inputs.first().ok_or_else(|| Fault::bug("a stage has no input"))?;
        let midnight = first_midnight(batch)?;
        let midnight = midnight.ok_or_else(|| Fault::data("the line has no date").help(WAYS_OUT_OF_NO_DAY))?;
        let since_s = DAY_S * (midnight - stations.first_day) as f64;
        let times: Vec<f64> = floats(batch, "tt")?.iter().map(|t| t + since_s).collect();
        let mut variations = vec![];
        for station in &stations.all {
            let mut values = station.at(&times, self.method, self.max_gap_s)?;
            let level_nt = self.level_of(station, &values);
            values.iter_mut().for_each(|x| *x -= level_nt);
            variations.push(values);
        }
        let made = match variations.as_slice() {
            [one] => one.clone(),
            several => self.weighted(batch, &stations.all, several)?,
        };
        if made.iter().all(|x| x.is_nan()) && !made.is_empty() {
            return Err(not_covered(stations, &times));
        }
        Ok(vec![array(made)])
    }
}

impl Diurnal {
    /// The variations of several stations, weighted by their distances.
    fn weighted(&self, batch: &RecordBatch, stations: &[Station], variations: &[Vec<f64>]) -> Result<Vec<f64>, Fault> {
        let [lat, lon, _] = self.position.columns();
        let help = "name one record, or give the line a position";
        let place = |name: &str| floats(batch, name).map_err(|fault| fault.help(help));
        let (lat, lon) = (place(lat)?, place(lon)?);
        let mut places = vec![];
        for station in stations {
            let what = || Fault::data(format!("the record of {} has no position of the station", station.name));
            places.push(
                station
                    .place_m
                    .ok_or_else(|| what().help("add the columns `lat` and `lon` to the record, or name one record"))?,
            );
        }
        let one = |row: usize| {
            let at = ecef_m(lat[row].to_radians(), lon[row].to_radians(), 0.0);
            let (mut sum, mut weights) = (0.0, 0.0);
            for (place, variation) in places.iter().zip(variations) {
                let squares: f64 = place.iter().zip(at).map(|(a, b)| (a - b) * (a - b)).sum();
                let weight = squares.sqrt().max(NEAREST_M).powf(-self.power);
                sum += weight * variation.get(row).copied().unwrap_or(f64::NAN);
                weights += weight;
            }
            // A missing position gives NaN, although `max` ignores NaN.
            if at.iter().all(|x| x.is_finite()) { sum / weights } else { f64::NAN }
        };
        Ok((0..lat.len()).map(one).collect())
    }
}

fn not_covered(stations: &Stations, times: &[f64]) -> Fault {
    let day = |t: f64| format!("{:.2}", t / DAY_S);
    let of = |s: &Station| s.span().map(|(a, b)| format!("{} from day {} to {}", s.name, day(a), day(b)));
    let spans: Vec<String> = stations.all.iter().filter_map(of).collect();
    let (first, last) = (times.first().copied().unwrap_or(f64::NAN), times.last().copied().unwrap_or(f64::NAN));
    let what = format!(
        "the record covers no sample of the line: {}, the line from day {} to {}, counted from the record's first \
         midnight",
        spans.join("; "),
        day(first),
        day(last)
    );
    Fault::data(what).help("name a record that covers the days of the line, or raise `max_gap_s`")
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::Arc;

    use arrow_array::{ArrayRef, StringArray};

    use super::*;
    use crate::testing::{StageTestColumns, batch, fault_texts, line, numbers, sampled, table};

    fn diurnal() -> Diurnal {
        Diurnal {
            element: "field_f".into(),
            column: "diurnal".into(),
            method: SampleInterpolation::Linear,
            max_gap_s: 180.0,
            level: DiurnalBaseline::Record,
            level_nt: None,
            power: 1.0,
            position: PositionSource::Truth,
        }
    }

    fn with_station(station: &str, columns: StageTestColumns) -> RecordBatch {
        let numbers = batch(columns);
        let flight = Arc::new(StringArray::from(vec![station; numbers.num_rows()])) as ArrayRef;
        let schema = numbers.schema();
        let names = schema.fields().iter().map(|f| f.name().as_str()).zip(numbers.columns().iter().cloned());
        RecordBatch::try_from_iter([("flight", flight)].into_iter().chain(names)).unwrap()
    }

    /// A record with one value per minute, over whole days of 2020 from `doy` on.
    fn record(station: &str, doy: f64, days: usize, lat: f64, of: impl Fn(f64) -> f64) -> RecordBatch {
        let t = sampled(0.0, 1.0 / 60.0, 1440 * days, |t| t);
        let each = |f: &dyn Fn(f64) -> f64| t.iter().map(|t| f(*t)).collect::<Vec<_>>();
        with_station(
            station,
            vec![
                ("year", "", vec![2020.0; t.len()]),
                ("doy", "", each(&|t| doy + (t / DAY_S).floor())),
                ("tt", "s", each(&|t| t.rem_euclid(DAY_S))),
                ("field_f", "nT", each(&of)),
                ("lat", "deg", vec![lat; t.len()]),
                ("lon", "deg", vec![10.0; t.len()]),
            ],
        )
    }

    /// A line of day 60 of 2020.
    fn observed_line(first_s: f64, rows: usize) -> RecordBatch {
        let tt = sampled(first_s, 1.0, rows, |t| t);
        // After midnight the date advances.
        let doy = tt.iter().map(|t| 60.0 + (t / DAY_S).floor()).collect();
        batch(vec![
            ("tt", "s", tt),
            ("year", "", vec![2020.0; rows]),
            ("doy", "", doy),
            ("lat", "deg", vec![45.0; rows]),
            ("lon", "deg", vec![10.0; rows]),
        ])
    }

    fn run(stage: &Diurnal, input: RecordBatch, records: Vec<RecordBatch>) -> Result<Vec<f64>, Fault> {
        let empty = input.slice(0, 0);
        let prepared = stage.prepare(&[vec![empty], records].concat())?;
        Ok(numbers(stage.run(&line(vec![input]), &prepared))?.remove(0))
    }

    #[test]
    fn law_a_linear_record_is_interpolated_minus_its_mean_across_midnight() {
        let slope = |t: f64| 50_000.0 + 1e-3 * t;
        let made = run(&diurnal(), observed_line(86_000.0, 900), vec![record("ABC", 60.0, 2, 45.0, slope)]).unwrap();
        // The mean of 2880 minutes from 0 to 172,740 s.
        let mean = 50_000.0 + 1e-3 * 86_370.0;
        for (k, x) in made.iter().enumerate() {
            assert!((x - (slope(86_000.0 + k as f64) - mean)).abs() < 1e-8, "{k}: {x}");
        }
        let of_line = run(
            &Diurnal { level: DiurnalBaseline::Line, ..diurnal() },
            observed_line(86_000.0, 901),
            vec![record("ABC", 60.0, 2, 45.0, slope)],
        )
        .unwrap();
        assert!((of_line[0] + 0.45).abs() < 1e-8 && of_line[450].abs() < 1e-8);
        let level_nt = Some([("ABC".to_owned(), 49_990.0)].into());
        let given =
            run(&Diurnal { level_nt, ..diurnal() }, observed_line(600.0, 2), vec![record("ABC", 60.0, 2, 45.0, slope)])
                .unwrap();
        assert!((given[0] - 10.6).abs() < 1e-8);
    }

    #[test]
    fn law_two_stations_are_weighted_by_distance() {
        // The stations are 1 and 3 degrees away on a meridian of the ellipsoid.
        let records =
            || vec![record("NEAR", 60.0, 1, 44.0, |t| (1e-3 * t).sin()), record("FAR", 60.0, 1, 48.0, |_| 0.0)];
        let zeroed = || Some([("NEAR".to_owned(), 0.0), ("FAR".to_owned(), 0.0)].into());
        for (power, weight) in [(0.0, 0.5), (1.0, 0.75), (2.0, 0.9)] {
            let made =
                run(&Diurnal { power, level_nt: zeroed(), ..diurnal() }, observed_line(600.0, 600), records()).unwrap();
            // A degree is 0.1 % longer at latitude 47 than at latitude 44. The records are straight lines between
            // minutes.
            assert!((made[300] / 0.9_f64.sin() - weight).abs() < 2e-3, "{power}: {}", made[300] / 0.9_f64.sin());
        }
        // One table may hold both stations.
        let stage = Diurnal { level_nt: zeroed(), ..diurnal() };
        let both = arrow_select::concat::concat_batches(&records()[0].schema(), &records()).unwrap();
        let apart = run(&stage, observed_line(600.0, 60), records()).unwrap();
        assert_eq!(run(&stage, observed_line(600.0, 60), vec![both]).unwrap(), apart);
    }

    #[test]
    fn unit_gaps_are_nan_and_uncovered_lines_are_rejected() {
        let whole = record("ABC", 60.0, 1, 45.0, |t| 0.1 * t);
        let parts = [whole.slice(0, 20), whole.slice(30, 1410)];
        let gap = arrow_select::concat::concat_batches(&whole.schema(), &parts).unwrap();
        let made = run(&diurnal(), observed_line(1000.0, 1000), vec![gap.clone()]).unwrap();
        // The last minute before the gap is 1140 s, the first after it 1800 s.
        let missing: Vec<usize> = (0..1000).filter(|k| made[*k].is_nan()).collect();
        assert_eq!((missing.first().copied(), missing.last().copied(), missing.len()), (Some(141), Some(799), 659));
        let wide = Diurnal { max_gap_s: 660.0, ..diurnal() };
        assert!(run(&wide, observed_line(1000.0, 1000), vec![gap]).unwrap().iter().all(|x| x.is_finite()));
        let narrow = Diurnal { max_gap_s: 59.0, ..diurnal() };
        assert!(run(&narrow, observed_line(0.0, 9), vec![whole.clone()]).unwrap_err().what.contains("every 60 s"));
        let other_day = record("ABC", 62.0, 1, 45.0, |t| t);
        let fault = run(&diurnal(), observed_line(1000.0, 10), vec![other_day]).unwrap_err();
        assert!(
            fault.what.contains("ABC from day 0.00 to 1.00") && fault.what.contains("line from day -1.99"),
            "{fault}"
        );
        let undated = batch(vec![("tt", "s", vec![1.0]), ("year", "", vec![f64::NAN]), ("doy", "", vec![60.0])]);
        assert!(run(&diurnal(), undated, vec![whole.clone()]).unwrap_err().what.contains("no date"));
        let again = record("ABC", 60.0, 1, 45.0, |t| 0.1 * t + 1.0);
        assert!(
            run(&diurnal(), observed_line(0.0, 9), vec![whole.clone(), again]).unwrap_err().what.contains("two values")
        );
        assert!(run(&diurnal(), observed_line(0.0, 9), vec![whole.clone(), whole]).is_ok(), "the same values twice");
    }

    #[test]
    fn unit_missing_columns_are_reported_before_the_run() {
        let lines = table(&[("tt", "s"), ("year", ""), ("doy", ""), ("lat", "deg"), ("lon", "deg")], None);
        let of_station = [("flight", ""), ("tt", "s"), ("year", ""), ("doy", ""), ("field_f", "nT")];
        let station = table(&of_station, None);
        let made = diurnal().yields(&[&lines, &station]).unwrap();
        assert_eq!(made.columns[0].role, Role::Sensor);
        assert_eq!(
            made.reads,
            [vec!["tt", "year", "doy", "lat", "lon"], vec!["flight", "year", "doy", "tt", "field_f"]]
        );
        assert!(made.columns[0].from.contains(&(1, "field_f".into())));
        let of = |stage: Diurnal, inputs: &[&Table]| fault_texts(stage.yields(inputs).unwrap_err());
        let undated = table(&[("tt", "s")], None);
        assert!(of(diurnal(), &[&undated, &station]).contains("no `year` and `doy`"));
        assert!(of(diurnal(), &[&table(&of_station[1..4], None), &station, &station]).ends_with("[position]"));
        assert!(of(Diurnal { element: "h".into(), ..diurnal() }, &[&lines, &station]).ends_with("[element]"));
        assert!(of(Diurnal { column: "tt".into(), ..diurnal() }, &[&lines, &station]).ends_with("[column]"));
    }
}
