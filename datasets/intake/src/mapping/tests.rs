//! Mappings of small files: units, axes, clocks and faults.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;

use arrow_array::{RecordBatch, cast::AsArray, types::Float64Type};
use schemas::canonical::FlightConversion;
use tempfile::TempDir;

use super::*;
use crate::open_log;

/// A CSV file and a mapping of it, opened as a table of a spec would be.
fn opened(csv: &str, mapping: &str, options: &FlightOptions) -> Result<(LogReader, TempDir), Fault> {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("log.csv");
    fs::write(&path, csv).unwrap();
    fs::write(folder.path().join("m.toml"), mapping).unwrap();
    let mapping = Arc::new(Mapping::load("m.toml", |name| Ok(folder.path().join(name)))?);
    let mapped = mapping.table(None)?;
    let reader = open_log(&path, options, Some(&mapped), &ReadHints::default())?;
    Ok((reader, folder))
}

/// The canonical rows of a file through a mapping.
fn rows(csv: &str, mapping: &str) -> Result<RecordBatch, Fault> {
    let (mut reader, _folder) = opened(csv, mapping, &FlightOptions::default())?;
    let canonical = FlightConversion::new(&reader.schema).map_err(|f| f.into_iter().next().unwrap())?;
    let mut batches = vec![];
    while let Some(part) = reader.next_part() {
        let part = part?;
        if let Some(wrong) = part.faults.into_iter().next() {
            return Err(wrong.fault.into());
        }
        batches.push(canonical.apply(&part.batch)?);
    }
    Ok(arrow_select::concat::concat_batches(canonical.schema(), &batches).unwrap())
}

fn numbers(batch: &RecordBatch, name: &str) -> Vec<f64> {
    let column = batch.column_by_name(name).unwrap_or_else(|| panic!("no {name} in {:?}", batch.schema()));
    let column = arrow_cast::cast(column, &arrow_schema::DataType::Float64).unwrap();
    column.as_primitive::<Float64Type>().iter().map(|x| x.unwrap_or(f64::NAN)).collect()
}

fn assert_fault(result: Result<RecordBatch, Fault>, words: &[&str]) {
    let text = result.unwrap_err().to_string();
    for word in words {
        assert!(text.contains(word), "no `{word}` in:\n{text}");
    }
}

const KEYS: &str = "flight = 'f'\nline = '1'\nepoch = { utc = '2021-04-21T12:00:00Z' }\n";

fn table(time: &str, rest: &str) -> String {
    format!("{KEYS}[tables.t]\ntime = {time}\n{rest}\n")
}

#[test]
fn law_units_signs_and_axes_are_converted_to_the_body_frame() {
    let csv = "ms,a,b,c,lat,raw\n0,500,-20,300,0.5,4\n100,510,-21,301,0.5,8\n";
    let mapping = table(
        "{ from = 'ms', unit = 'ms', clock = 'boot' }",
        "vectors.flux_a = { from = ['a', 'b', 'c'], unit = 'mgauss', axes = '+x -y -z', offset = [1, 2, 3], scale = 2 \
         }\n\
         columns = { lat = { from = 'lat', unit = 'rad' }, cur_x = { sql = 'raw * 0.5 - 1', unit = 'mA' }, \
         height = { from = 'raw', unit = 'ft', scale = -1, offset = 10, role = 'truth' }, year_of = { value = 7 } }",
    );
    let out = rows(csv, &mapping).unwrap();
    assert_eq!(numbers(&out, "flux_a_x"), [100_100.0, 102_100.0]);
    assert_eq!(numbers(&out, "flux_a_y"), [3_800.0, 4_000.0]);
    assert_eq!(numbers(&out, "flux_a_z"), [-60_300.0, -60_500.0]);
    assert!((numbers(&out, "lat")[0] - 0.5_f64.to_degrees()).abs() < 1e-12);
    assert_eq!(numbers(&out, "cur_x"), [0.001, 0.003]);
    assert_eq!(numbers(&out, "height"), [6.0, 2.0]);
    let schema = out.schema();
    let height = schema.field_with_name("height").unwrap().metadata();
    assert_eq!((height["unit"].as_str(), height["role"].as_str()), ("ft", "truth"));
    assert_eq!((numbers(&out, "tt"), numbers(&out, "doy")), (vec![43_200.0, 43_200.1], vec![111.0; 2]));
}

#[test]
fn law_all_clocks_give_the_same_instant() {
    // 2021-04-21T23:59:59.5Z and a second later, in the clocks of logs.
    let columns = "columns = { x = { from = 'x' } }";
    for (csv, time) in [
        ("t,x\n1619049599500,1\n1619049600500,1\n", "{ from = 't', unit = 'ms', clock = 'unix' }"),
        ("t,x\n1619049599500000,1\n1619049600500000,1\n", "{ from = 't', unit = 'us', clock = 'unix' }"),
        ("t,x\n1619049599.5,1\n1619049600.5,1\n", "{ from = 't', unit = 's', clock = 'unix' }"),
        // Wednesday, GPS week 2154, 18 leap seconds.
        ("t,x\n345617500,1\n345618500,1\n", "{ from = 't', unit = 'ms', clock = 'gps', week = 2154 }"),
        (
            "t,w,x\n345617500,106,1\n345618500,106,1\n",
            "{ from = 't', unit = 'ms', clock = 'gps', week = 'w', rollovers = 2 }",
        ),
        ("t,x\n345617.5,1\n345618.5,1\n", "{ from = 't', unit = 's', clock = 'gps', week = 2154, leap_s = 18 }"),
        ("t,x\n2021-04-21T23:59:59.5Z,1\n2021-04-22T00:00:00.5Z,1\n", "{ from = 't', clock = 'text' }"),
        (
            "d,t,x\n22/04/2021,09:59:59.5,1\n22/04/2021,10:00:00.5,1\n",
            "{ from = ['d', 't'], clock = 'text', format = '%d/%m/%Y %H:%M:%S%.f', zone = '+10:00' }",
        ),
        ("t,x\n86399.5,1\n0.5,1\n", "{ from = 't', unit = 's', clock = 'day', date = '2021-04-21' }"),
        (
            "t,x\n35999.5,1\n36000.5,1\n",
            "{ from = 't', unit = 's', clock = 'day', date = '2021-04-22', zone = '+10:00' }",
        ),
        ("t,x\n719.991666666666667,1\n720.008333333333333,1\n", "{ from = 't', unit = 'min', clock = 'boot' }"),
        (
            "t,x\n23:59:59.5,1\n00:00:00.5,1\n",
            "{ from = 't', clock = 'text', format = '%H:%M:%S%.f', date = '2021-04-21' }",
        ),
    ] {
        let out = rows(csv, &table(time, columns)).unwrap_or_else(|f| panic!("{time}: {f}"));
        // Unix seconds in double precision resolve 2.4e-7 s.
        let tt = numbers(&out, "tt");
        assert!((tt[0] - 86_399.5).abs() < 3e-7 && (tt[1] - 86_400.5).abs() < 3e-7, "{time}: {tt:?}");
        assert_eq!((numbers(&out, "year"), numbers(&out, "doy")), (vec![2021.0; 2], vec![111.0, 112.0]), "{time}");
    }
    // A time of the day without a date gives no date.
    let out = rows("t,x\n1,1\n", &table("{ from = 't', unit = 's', clock = 'day' }", columns)).unwrap();
    assert!(out.column_by_name("year").is_none() && numbers(&out, "tt") == [1.0]);
}

#[test]
fn ref_eastings_and_northings_in_any_unit_are_a_position() {
    // The CN Tower: 43 deg 38' 33.24" N, 79 deg 23' 13.7" W is 17T 630084 m E, 4833438 m N.
    let csv = |unit: f64| format!("ms,e,n\n0,{},{}\n100,0,0\n", 630_084.0 / unit, 4_833_438.0 / unit);
    let time = "{ from = 'ms', unit = 'ms', clock = 'boot' }";
    let mapping = |keys: &str| table(time, &format!("projected = {{ {keys} }}"));
    for (unit, name) in [(1.0, ""), (1000.0, ", unit = 'km'"), (1200.0 / 3937.0, ", unit = 'us-ft'")] {
        let out = rows(&csv(unit), &mapping(&format!("easting = 'e', northing = 'n', epsg = 32617{name}"))).unwrap();
        let (lat, lon) = (numbers(&out, "lat"), numbers(&out, "lon"));
        assert!((lat[0] - 43.642_567).abs() < 2e-5 && (lon[0] + 79.387_139).abs() < 2e-5, "{name}: {lat:?} {lon:?}");
        assert!(lat[1].is_nan() && lon[1].is_nan(), "a receiver without a fix");
    }
    for (keys, expected) in [
        ("easting = 'e', northing = 'n', epsg = 4326", &["is in degrees"]),
        ("easting = 'e', northing = 'n', epsg = 1", &["EPSG:1 is unknown"]),
        ("easting = 'x', northing = 'n', epsg = 32617", &["there is no column `x`"]),
        ("easting = 'n', northing = 'e', epsg = 32617", &["not a position in"]),
        ("easting = 'e', northing = 'n', epsg = 32617, unit = 'deg'", &["the coordinates are in degrees"]),
        ("easting = 'e', northing = 'n', epsg = 32617, to = ['lat']", &["names of two columns"]),
        ("easting = 'e', northing = 'n', epsg = 32617, zone = 17", &["has no parameter `zone`"]),
        ("easting = 'e', northing = 'n'", &["epsg"]),
    ] {
        assert_fault(rows(&csv(1.0), &mapping(keys)), expected);
    }
}

#[test]
fn unit_each_line_counts_from_the_midnight_of_its_first_sample() {
    let csv = "t,l,x\n1619049599,a,1\n1619049601,a,1\n1619049602,b,1\n";
    let mapping = "flight = 'f'\nline = { from = 'l' }\n[tables.t]\ntime = { from = 't', unit = 's', clock = 'unix' }\n\
                   columns = { x = { from = 'x' } }\n";
    let out = rows(csv, mapping).unwrap();
    assert_eq!(numbers(&out, "tt"), [86_399.0, 86_401.0, 2.0]);
    assert_eq!(numbers(&out, "doy"), [111.0, 112.0, 112.0]);
}

#[test]
fn unit_the_epoch_is_the_median_over_new_fixes() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("log.csv"), "ms,x\n1000,1\n2000,2\n").unwrap();
    // Each fix is repeated for two rows, the second fix is logged late, and the first row has no fix.
    let fixes = "boot,tow,week,fix\n0,0,0,0\n1000,345601000,2154,3\n1200,345601000,2154,3\n2500,345602000,2154,3\n\
                 2700,345602000,2154,3\n3000,345603000,2154,3\n";
    fs::write(folder.path().join("gps.csv"), fixes).unwrap();
    let text = "flight = 'f'\nline = '1'\n[epoch]\nfile = 'gps.csv'\nfrom = 'tow'\nunit = 'ms'\nclock = 'gps'\n\
                week = 'week'\n\
                boot = 'boot'\nboot_unit = 'ms'\nrows = 'fix >= 3'\n[tables.t]\ncolumns = { x = { from = 'x' } }\n\
                time = { from = 'ms', unit = 'ms', clock = 'boot' }\n";
    let open = |text: &str| {
        let mapped = Arc::new(Mapping::of_text("m.toml".into(), text.into()).unwrap()).table(None).unwrap();
        open_log(&folder.path().join("log.csv"), &FlightOptions::default(), Some(&mapped), &ReadHints::default())
    };
    let mut reader = open(text).unwrap();
    let note = &reader.notes[0];
    assert!(note.contains("on 2021-04-21 at 23:59:42.000 UTC (the median of 3 rows in gps.csv"), "{note}");
    assert!(note.contains("differ by up to 0.500 s"), "{note}");
    let first = reader.next_part().unwrap().unwrap().batch;
    let days = numbers(&first, "doy");
    assert_eq!((numbers(&first, "tt"), days), (vec![86_383.0, 86_384.0], vec![111.0; 2]));
    let mut later = open(&text.replace("boot_unit", "boot_offset_s = -7.75\nboot_unit")).unwrap();
    assert_eq!(numbers(&later.next_part().unwrap().unwrap().batch, "tt"), [86_390.75, 86_391.75]);
    let none = open(&text.replace("fix >= 3", "fix >= 4")).err().unwrap().to_string();
    assert!(
        none.contains("no row of gps.csv gives the start time of the log") && none.contains("m.toml:3:2"),
        "{none}"
    );
    let gone = open(&text.replace("gps.csv", "gsp.csv")).err().unwrap().to_string();
    assert!(gone.contains("gsp.csv") && gone.contains("the epoch of `t` is read from this file"), "{gone}");
}

#[test]
fn gold_mismatches_are_reported_with_their_position_in_the_mapping() {
    let csv = "ms,MagX,mode\n0,500,a\n";
    let of = |rest: &str| rows(csv, &table("{ from = 'ms', unit = 'ms', clock = 'boot' }", rest));
    assert_fault(
        of("columns = { mag_1_uc = { from = 'MagY', unit = 'nT' } }"),
        &["there is no column `MagY` in log.csv", "m.toml:6:33", "did you mean `MagX`?"],
    );
    assert_fault(
        of("columns = { mag_1_uc = { from = 'MagX' } }"),
        &["the unit of `mag_1_uc` is in neither the file nor the mapping", "m.toml:6:13"],
    );
    assert_fault(
        of("columns = { mag_1_uc = { from = 'MagX', unit = 'deg' } }"),
        &["`mag_1_uc` is in `deg`, which does not convert to nT", "m.toml:6:"],
    );
    assert_fault(
        of("columns = { lat = { from = 'mode', unit = 'deg' } }"),
        &["the column `mode` of log.csv contains Utf8, not numbers"],
    );
    assert_fault(
        of("columns = { lat = { sql = 'magx', unit = 'deg' } }"),
        &["there is no column `magx`", "put the name in double quotes"],
    );
    assert_fault(
        of("columns = { lat = { sql = 'random()', unit = 'deg' } }"),
        &["gives a different value each time", "m.toml:6:"],
    );
    assert_fault(of("columns = { tt = { from = 'ms' } }"), &["`tt` cannot be mapped as a column"]);
    assert_fault(
        of("columns = { lat = { from = 'MagX', unit = 'deg', role = 'sensor' } }"),
        &["has the role truth, not sensor"],
    );
    assert_fault(
        of("columns = { x = { from = 'ms', value = 3 } }"),
        &["requires exactly one of `from`, `sql` and `value`"],
    );
    assert_fault(of("vectors = { flux_a = { from = ['MagX'], unit = 'nT' } }"), &["with three entries"]);
    assert_fault(
        of("vectors = { flux_a = { sql = ['1', '2', '3'], unit = 'nT', axes = '+x +x +y' } }"),
        &["`axes` cannot be `+x +x +y`"],
    );
    assert_fault(of("rows = 'MagX'\ncolumns = { x = { from = 'ms' } }"), &["there is no column `magx`"]);
    assert_fault(of("rows = 'ms + 1'\ncolumns = { x = { from = 'ms' } }"), &["`rows` must be true or false"]);
    assert_fault(of("rows = 'ms > 0"), &["m.toml:6:"]);
    assert_fault(of(""), &["the table `t` has no columns except its time"]);
    assert_fault(
        of("columns = { x = { sql = 'cast(mode as double)' } }"),
        &["cannot be evaluated", "m.toml:6:25", "log.csv"],
    );
    for (time, words) in [
        ("{ from = 'MS', unit = 'ms', clock = 'boot' }", "there is no column `MS`"),
        ("{ from = 'ms', clock = 'boot' }", "the unit of the time `ms`"),
        ("{ from = 'ms', unit = 'nT', clock = 'boot' }", "cannot be in `nT`"),
        ("{ from = 'ms', unit = 'ms' }", "`clock`, the origin of the time, is required"),
        ("{ from = 'ms', unit = 'ms', clock = 'gps' }", "requires `week`"),
        ("{ from = 'mode', clock = 'text' }", "`a` is not a time in the format that the mapping gives"),
        ("{ from = 'ms', clock = 'text' }", "`clock = \"text\"` requires text"),
        ("{ from = 'ms', unit = 'ms', clock = 'unix', week = 3 }", "`week` does not apply to the clock `unix`"),
        ("{ from = 'ms', unit = 'ms', clock = 'day', zone = '10' }", "`zone` cannot be `10`"),
    ] {
        assert_fault(rows(csv, &table(time, "columns = { x = { from = 'ms' } }")), &[words]);
    }
    let no_epoch = "flight = 'f'\nline = '1'\n[tables.t]\ntime = { from = 'ms', unit = 'ms', clock = 'boot' }\n";
    assert_fault(rows(csv, no_epoch), &["the start time is unknown", "unknown = true"]);
    let no_flight = "line = '1'\n[tables.t]\ntime = { from = 'ms', unit = 'ms', clock = 'day' }\n\
                     columns = { x = { from = 'ms' } }\n";
    assert_fault(rows(csv, no_flight), &["has no flight for the table"]);
    let given = FlightOptions { flight: Some("7".into()), ..FlightOptions::default() };
    assert!(opened(csv, no_flight, &given).is_ok());
}

#[test]
fn unit_rows_are_dropped_by_condition_and_repeats_counted() {
    let csv = "t,ok,x\n0,1,10\n1,1,11\n1,1,12\n2,0,13\n3,,14\n4,1,15\n";
    let time = "{ from = 't', unit = 's', clock = 'boot' }";
    let columns = "columns = { x = { from = 'x' } }";
    let out = rows(csv, &table(time, &format!("rows = 'ok = 1'\n{columns}"))).unwrap();
    assert_eq!(numbers(&out, "x"), [10.0, 11.0, 12.0, 15.0]);
    let text = table(time, &format!("rows = 'ok = 1'\ndrop_repeated = true\n{columns}"));
    assert_eq!(numbers(&rows(csv, &text).unwrap(), "x"), [10.0, 11.0, 15.0]);
    let (reader, _folder) = opened(csv, &text, &FlightOptions::default()).unwrap();
    assert!(
        reader.notes.iter().any(|n| n.contains("drops 1 rows with the time of the previous row")),
        "{:?}",
        reader.notes
    );
    // Rows at 3 Hz with times in whole seconds.
    let csv = "t,x\n1,10\n2,11\n2,12\n2,13\n3,14\n3,15\n";
    let moved = table(time, &format!("repeated_rate_hz = 4.0\n{columns}"));
    let (reader, _folder) = opened(csv, &moved, &FlightOptions::default()).unwrap();
    assert!(reader.notes.iter().any(|n| n.contains("has 3 rows") && n.contains("at 4 Hz")), "{:?}", reader.notes);
    let from_start: Vec<f64> = numbers(&rows(csv, &moved).unwrap(), "tt").iter().map(|tt| tt - 43_200.0).collect();
    assert_eq!(from_start, [1.0, 2.0, 2.25, 2.5, 3.0, 3.25]);
    let both = table(time, &format!("drop_repeated = true\nrepeated_rate_hz = 4.0\n{columns}"));
    assert_fault(rows(csv, &both), &["`drop_repeated` drops the rows", "remove one of the two keys"]);
    let csv = "t,ok,x\n0,1,10\n1,1,11\n1,1,12\n2,0,13\n3,,14\n4,1,15\n";
    // `others = true` keeps the columns that the mapping does not name.
    let out = rows(csv, &table(time, &format!("others = true\n{columns}"))).unwrap();
    assert_eq!(numbers(&out, "ok").len(), 6);
}

#[test]
fn unit_the_built_in_mappings_are_valid() {
    for ready in READY {
        let mapping =
            Mapping::load(ready.name, |name| Ok(name.into())).unwrap_or_else(|f| panic!("{}: {f}", ready.name));
        assert!(!mapping.about().is_empty() && !mapping.tables().is_empty(), "{}", ready.name);
    }
    let fault = Mapping::load("px4_ulgo", |name| Ok(name.into())).unwrap_err().to_string();
    assert!(fault.contains("did you mean `px4_ulog`?"), "{fault}");
}

#[test]
fn unit_the_key_depends_on_the_text() {
    let key = |text: &str| {
        let mapping = Arc::new(Mapping::of_text("m.toml".into(), text.into()).unwrap());
        mapping.table(None).unwrap().key()
    };
    let text = table("{ from = 't', unit = 's', clock = 'boot' }", "others = true");
    assert_eq!(key(&text), key(&text));
    assert_ne!(key(&text), key(&text.replace("'s'", "'ms'")));
}
