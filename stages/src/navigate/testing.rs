//! A flight over a map, with its truth, and the filters on it.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use arrow_array::{Array, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_schema::Schema;
use schemas::{Column, Fault, LineInput, Literal, SpecEntries, SpecEntry, Table, TableShape};

use super::{FILTERS, entry};
use crate::columns::{array, list};

pub(super) const ROWS: usize = 600;
const M_PER_DEG: f64 = 111_130.0;

/// The field of the map, in nT, at a position in metres north and east of 45° N, 75° W: hills of a few kilometres.
fn hills(north: f64, east: f64) -> f64 {
    hills_above(north, east, 0.0)
}

/// The same field at a height above the map, in metres. Each harmonic decays with its wave number.
fn hills_above(north: f64, east: f64, up: f64) -> f64 {
    let decay = |k: f64| (-k * up).exp();
    60.0 * decay(1.0 / 500.0) * (north / 500.0).sin()
        + 50.0 * decay(f64::hypot(1.0 / 430.0, 1.0 / 900.0)) * (east / 430.0 + north / 900.0).cos()
}

/// Field `ahead_m` metres ahead of the aircraft at a row, in nT.
pub(super) fn ahead_nt(row: usize, ahead_m: f64) -> f64 {
    let (t, m_per_deg_east) = (row as f64, M_PER_DEG * 45_f64.to_radians().cos());
    let (north, east) = (55.0 * t, 0.004 * (t / 70.0).sin() * m_per_deg_east);
    let (vn, ve) = (55.0, 0.004 / 70.0 * (t / 70.0).cos() * m_per_deg_east);
    let part = ahead_m / f64::hypot(vn, ve);
    hills(north + part * vn, east + part * ve)
}

fn metres(lat: f64, lon: f64) -> (f64, f64) {
    ((lat - 45.0) * M_PER_DEG, (lon + 75.0) * M_PER_DEG * 45_f64.to_radians().cos())
}

/// The flight with a height bias: the true height is `up_m` above the height columns and the map.
pub(super) fn higher(up_m: f64) -> RecordBatch {
    let flight = flight();
    let (lat, lon) = (numbers_of(&flight, "lat"), numbers_of(&flight, "lon"));
    with(&flight, "mag_1_c", |row, nt| {
        let (north, east) = metres(lat[row], lon[row]);
        nt + hills_above(north, east, up_m) - hills(north, east)
    })
}

/// The map with nodes 0.001° apart.
pub(super) fn map() -> RecordBatch {
    let nodes = || (0..340).flat_map(|row| (0..70).map(move |column| (row, column)));
    let lat: Vec<f64> = nodes().map(|(row, _)| 44.99 + 0.001 * f64::from(row)).collect();
    let lon: Vec<f64> = nodes().map(|(_, column)| -75.03 + 0.001 * f64::from(column)).collect();
    let place = |(lat, lon): (&f64, &f64)| metres(*lat, *lon);
    let anomaly = lat.iter().zip(&lon).map(place).map(|(north, east)| hills(north, east)).collect();
    let (alt, columns) = (vec![300.0; lat.len()], schemas::map::shape().columns);
    let of = |name: &str| match name {
        "lat" => lat.clone(),
        "lon" => lon.clone(),
        "alt" => alt.clone(),
        _ => Vec::clone(&anomaly),
    };
    let columns = columns.iter().map(|column| (column.name.clone(), array(of(&column.name))));
    RecordBatch::try_from_iter(columns.collect::<Vec<_>>()).unwrap()
}

/// Ten minutes northward at 55 m/s, one sample per second. The INS has errors of 10 m and 0.15 m/s north, and of 0.2
/// m/s east. `mag_1_c` and `mag_2_c` are the field plus noise of 1 nT; `mag_2_c` has a gap. `mag_1_uc` also contains
/// the aircraft field, which is linear in the direction of the vector `flux_d`: 40 along nose, -25 right, 30 down, and
/// 12 nT. `tl` holds the terms of the aircraft field, `attitude` two features of the field direction.
pub(super) fn flight() -> RecordBatch {
    let t: Vec<f64> = (0..ROWS).map(|k| k as f64).collect();
    let of = |f: &dyn Fn(f64) -> f64| -> Vec<f64> { t.iter().map(|t| f(*t)).collect() };
    let lat = of(&|t| 45.0 + 55.0 * t / M_PER_DEG);
    let lon = of(&|t| -75.0 + 0.004 * (t / 70.0).sin());
    let east_deg = 1.0 / (M_PER_DEG * 45_f64.to_radians().cos());
    let clean: Vec<f64> = lat.iter().zip(&lon).map(|(lat, lon)| metres(*lat, *lon)).map(|(n, e)| hills(n, e)).collect();
    let noise = |k: f64| 1.4 * (2.3 * k).sin();
    let (roll, pitch) = (of(&|t| 0.5 * (t / 3.1).sin()), of(&|t| 0.25 * (t / 2.3).cos()));
    let direction = |k: usize| {
        let (x, y) = (0.2 + pitch[k], 0.1 + roll[k]);
        let z = (1.0 - x * x - y * y).sqrt();
        [x, y, z]
    };
    let axis = |axis: usize| (0..ROWS).map(|k| 50_000.0 * direction(k)[axis]).collect::<Vec<f64>>();
    let own = |k: usize| {
        let [x, y, z] = direction(k);
        40.0 * x - 25.0 * y + 30.0 * z + 12.0
    };
    let terms: Vec<f64> = (0..ROWS).flat_map(|k| direction(k).into_iter().chain([1.0])).collect();
    let each = |f: &dyn Fn(usize) -> f64| (0..ROWS).map(f).collect::<Vec<f64>>();
    let columns = vec![
        ("tt", "s", t.clone()),
        ("lat", "deg", lat.clone()),
        ("lon", "deg", lon.clone()),
        ("alt", "m", vec![300.0; ROWS]),
        ("ins_lat", "deg", each(&|k| lat[k] + (10.0 + 0.15 * t[k]) / M_PER_DEG)),
        ("ins_lon", "deg", each(&|k| lon[k] + 0.2 * t[k] * east_deg)),
        ("ins_alt", "m", vec![300.0; ROWS]),
        ("mag_1_c", "nT", each(&|k| clean[k] + noise(t[k]))),
        ("mag_2_c", "nT", each(&|k| if (100..130).contains(&k) { f64::NAN } else { clean[k] + noise(t[k] + 77.0) })),
        ("mag_1_uc", "nT", each(&|k| clean[k] + own(k) + noise(t[k]))),
        ("flux_d_x", "nT", axis(0)),
        ("flux_d_y", "nT", axis(1)),
        ("flux_d_z", "nT", axis(2)),
    ];
    let mut fields: Vec<Column> = columns.iter().map(|(name, unit, _)| Column::float(*name, *unit, "")).collect();
    fields.push(Column::list("attitude", "", "", ["roll", "pitch"].map(str::to_owned).to_vec()));
    fields.push(Column::list("tl", "", "", ["x", "y", "z", "bias"].map(str::to_owned).to_vec()));
    let mut arrays: Vec<_> = columns.into_iter().map(|(_, _, values)| array(values)).collect();
    let attitude = roll.iter().zip(&pitch).flat_map(|(roll, pitch)| [*roll, *pitch]).collect();
    arrays.push(list(attitude, 2).unwrap());
    arrays.push(list(terms, 4).unwrap());
    let schema = Schema::new(fields.iter().map(Column::field).collect::<Vec<_>>());
    RecordBatch::try_new(Arc::new(schema), arrays).unwrap()
}

/// The flight with changed values in one column.
pub(super) fn with(flight: &RecordBatch, column: &str, of: impl Fn(usize, f64) -> f64) -> RecordBatch {
    let (at, _) = flight.schema().column_with_name(column).map(|(at, field)| (at, field.clone())).unwrap();
    let mut columns = flight.columns().to_vec();
    let values = columns[at].as_primitive::<Float64Type>().values().to_vec();
    columns[at] = array(values.into_iter().enumerate().map(|(row, x)| of(row, x)).collect());
    RecordBatch::try_new(flight.schema(), columns).unwrap()
}

/// Output of a filter on the test flight.
#[derive(Debug)]
pub(super) struct NavigateOutput(Vec<(String, Arc<dyn Array>)>);

impl NavigateOutput {
    fn column(&self, name: &str) -> &Arc<dyn Array> {
        &self.0.iter().find(|(known, _)| known == name).unwrap_or_else(|| panic!("no column {name}")).1
    }

    pub(super) fn numbers(&self, name: &str) -> Vec<f64> {
        let array = self.column(name);
        let values = array.as_fixed_size_list_opt().map_or(array, |list| list.values());
        values.as_primitive::<Float64Type>().values().to_vec()
    }

    pub(super) fn words(&self, name: &str) -> Vec<String> {
        self.column(name).as_string::<i32>().iter().map(|word| word.unwrap().to_owned()).collect()
    }

    /// Number of samples with this word in `update`.
    pub(super) fn updates(&self, word: &str) -> usize {
        self.words("update").iter().filter(|update| *update == word).count()
    }

    /// The distance from the truth at a row, in metres.
    pub(super) fn error_m(&self, row: usize) -> f64 {
        let truth = flight();
        let truth = |name: &str| truth.column_by_name(name).unwrap().as_primitive::<Float64Type>().value(row);
        let (north, east) = metres(truth("lat"), truth("lon"));
        let (found_north, found_east) = metres(self.numbers("lat")[row], self.numbers("lon")[row]);
        (north - found_north).hypot(east - found_east)
    }

    pub(super) fn has(&self, name: &str) -> bool {
        self.0.iter().any(|(known, _)| known == name)
    }
}

/// Entries of a spec for the stage with a filter. `keys` are written as in a spec.
fn args(filter: &str, keys: &str) -> SpecEntries {
    // Keys that match the flight: an INS with large errors, and a measured field without the core field.
    let usual = format!(
        "filter = '{filter}'\ntuning = 'magnav'\ncore_field = false\nmeasurement_sigma_nt = 1.5\nfogm_sigma_nt = 1.0\n\
         init_position_sigma_m = 20.0\ninit_velocity_sigma_mps = 0.3\n"
    );
    let usual: toml::Table = usual.parse().unwrap();
    let own: toml::Table = keys.parse().unwrap();
    let all = usual.into_iter().filter(|(key, _)| !own.contains_key(key)).chain(own.clone());
    all.map(|(key, value)| (key, SpecEntry { value: literal(value), key_at: 0..0, at: 0..0 })).collect()
}

fn literal(value: toml::Value) -> Literal {
    match value {
        toml::Value::String(text) => Literal::Text(text),
        toml::Value::Integer(number) => Literal::Int(number),
        toml::Value::Float(number) => Literal::Float(number),
        toml::Value::Boolean(is) => Literal::Bool(is),
        toml::Value::Array(items) => Literal::List(items.into_iter().map(literal).collect()),
        toml::Value::Datetime(_) | toml::Value::Table(_) => panic!("no key is one"),
    }
}

/// Columns of the track that a filter declares for the flight, or the faults of the filter.
pub(super) fn planned(filter: &str, keys: &str) -> Result<Vec<Column>, Vec<Fault>> {
    planned_on(&args(filter, keys), &flight())
}

fn planned_on(args: &SpecEntries, flight: &RecordBatch) -> Result<Vec<Column>, Vec<Fault>> {
    let stage = (entry(FILTERS.to_vec()).build)(args)?;
    let tables = [Table::Lines(TableShape::from_schema(&flight.schema())), Table::Map(schemas::map::shape())];
    Ok(stage.yields(&tables.iter().collect::<Vec<_>>())?.columns)
}

/// The numbers of a column.
pub(super) fn numbers_of(flight: &RecordBatch, name: &str) -> Vec<f64> {
    flight.column_by_name(name).unwrap().as_primitive::<Float64Type>().values().to_vec()
}

/// Runs a filter on a flight.
pub(super) fn flown(filter: &str, keys: &str, flight: &RecordBatch) -> Result<NavigateOutput, Fault> {
    flown_with(&args(filter, keys), flight)
}

/// Runs a filter on a flight with only these keys.
pub(super) fn flown_on(filter: &str, keys: &str, flight: &RecordBatch) -> Result<NavigateOutput, Fault> {
    let own = keys.lines().filter(|line| !line.trim().is_empty());
    // A later line replaces an earlier line with the same key.
    let mut table = toml::Table::new();
    own.for_each(|line| table.extend(line.parse::<toml::Table>().unwrap()));
    table.insert("filter".into(), filter.into());
    let args = table.into_iter().map(|(key, value)| (key, SpecEntry { value: literal(value), key_at: 0..0, at: 0..0 }));
    flown_with(&args.collect(), flight)
}

fn flown_with(args: &SpecEntries, flight: &RecordBatch) -> Result<NavigateOutput, Fault> {
    let planned = planned_on(args, flight).unwrap();
    let names: Vec<String> = planned.into_iter().map(|column| column.name).collect();
    let stage = (entry(FILTERS.to_vec()).build)(args).unwrap();
    let line = LineInput {
        flight: "1".into(),
        line: "1.01".into(),
        inputs: vec![flight.clone(), flight.slice(0, 0)],
        keep: None,
    };
    let of_lines = stage.of_lines().unwrap();
    let prepared = of_lines.prepare(&[flight.slice(0, 0), map()])?;
    let arrays = of_lines.run(&line, &prepared)?;
    assert_eq!(arrays.len(), names.len(), "{names:?}");
    Ok(NavigateOutput(names.into_iter().zip(arrays).collect()))
}

/// Runs a filter on the test flight. The run must succeed.
pub(super) fn run(filter: &str, keys: &str) -> NavigateOutput {
    flown(filter, keys, &flight()).unwrap()
}

/// Asserts that keys are rejected with a message that contains `words`.
pub(super) fn assert_refused(filter: &str, keys: &str, words: &str) {
    let stage = (entry(FILTERS.to_vec()).build)(&args(filter, keys));
    let faults = match stage {
        Err(faults) => faults,
        Ok(stage) => {
            let own: toml::Table = keys.parse().unwrap();
            let idle: Vec<Fault> = own.keys().filter_map(|key| stage.unused_key(key)).collect();
            if idle.is_empty() { planned(filter, keys).unwrap_err() } else { idle }
        }
    };
    assert!(faults.iter().any(|fault| fault.what.contains(words)), "{filter} {keys}: {faults:?}");
}
