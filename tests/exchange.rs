//! Files leave a store and come back: heads with units, time stamps, strings, GeoPackage, and names after a mapping.

use std::{fs, process::Output};

use arrow_array::{
    Array,
    cast::AsArray,
    types::{Int64Type, TimestampMicrosecondType},
};
use rusqlite::Connection;
use tempfile::TempDir;

use crate::support::{magline, numbers, read, stderr, stdout, texts};

/// Rows of each of the two lines of [`flown`].
const ROWS: usize = 300;
/// 2024-12-31, 23:59:50 UTC. The lines end after midnight.
const START_S: f64 = 86_390.0;

/// A store with the table `x.made` of a flight over New Year's Eve, with text and missing positions.
fn flown() -> TempDir {
    let folder = TempDir::new().unwrap();
    let mut text = "flight,line,tt,lat,lon,alt,mag_1_uc,ins_grade,year,doy\n".to_owned();
    for line in 1..=2 {
        for k in 0..ROWS {
            let (t, grade) = (START_S + k as f64 * 0.125, if k < 100 { "nav" } else { "tactical grade" });
            let lat = if k == 7 { String::new() } else { format!("{:.6}", 45.0 + 1e-5 * k as f64) };
            let lon = -9.1 - 0.001 * f64::from(line);
            let mag = 48_000.0 + (k % 7) as f64;
            text += &format!("F1,{line}.5,{t},{lat},{lon:.3},300.25,{mag},{grade},2024,366\n");
        }
    }
    fs::write(folder.path().join("f.csv"), text).unwrap();
    let spec = "name = \"x\"\nstore = \"store\"\n[tables.f]\npath = \"f.csv\"\n[[stages]]\nname = \"made\"\n\
                stage = \"derive\"\ninput = \"f\"\ncolumns = { double = \"2 * mag_1_uc\" }\n";
    fs::write(folder.path().join("spec.toml"), spec).unwrap();
    done(&folder, &["run", "spec.toml"]);
    folder
}

fn done(folder: &TempDir, args: &[&str]) -> Output {
    let output = magline(folder.path(), args);
    assert!(output.status.success(), "{args:?}: {}{}", stdout(&output), stderr(&output));
    output
}

fn refused(folder: &TempDir, args: &[&str], said: &[&str]) {
    let output = magline(folder.path(), args);
    assert_eq!(output.status.code(), Some(2), "{args:?}: {}{}", stdout(&output), stderr(&output));
    said.iter().for_each(|words| assert!(stderr(&output).contains(words), "{words}: {}", stderr(&output)));
}

fn unit(batch: &arrow_array::RecordBatch, name: &str) -> Option<String> {
    batch.schema().field_with_name(name).unwrap().metadata().get("unit").cloned()
}

#[test]
fn user_a_csv_file_with_units_in_its_header_is_ingested_with_the_same_values() {
    let folder = flown();
    done(&folder, &["export", "x.made", "-o", "out.csv", "--units"]);
    let text = fs::read_to_string(folder.path().join("out.csv")).unwrap();
    assert!(text.lines().next().unwrap().contains("tt [s],"), "{}", &text[..200]);
    done(&folder, &["ingest", "out.csv", "--to", "again"]);
    done(&folder, &["ingest", "f.csv", "--to", "first"]);
    let [again, first] = ["again/out.parquet", "first/f.parquet"].map(|name| {
        let own = folder.path().join(name);
        let alone = folder.path().join(format!("{name}.d"));
        fs::create_dir(&alone).unwrap();
        fs::rename(own, alone.join("a.parquet")).unwrap();
        read(&alone)
    });
    for name in ["tt", "lat", "lon", "alt", "mag_1_uc"] {
        let of = |rows| numbers(rows, name).iter().map(|x: &f64| x.to_bits()).collect::<Vec<_>>();
        assert_eq!(of(&again), of(&first), "{name}");
        assert_eq!(unit(&again[0], name), unit(&first[0], name), "{name}");
    }
    assert_eq!(texts(&again, "ins_grade"), texts(&first, "ins_grade"));
    assert!(numbers(&again, "double").iter().zip(numbers(&first, "mag_1_uc")).all(|(d, m)| *d == 2.0 * m));
    assert_eq!(unit(&again[0], "double").as_deref(), Some("nT"));
}

#[test]
fn user_a_unit_in_a_head_is_converted_and_a_contradiction_is_an_error() {
    let folder = TempDir::new().unwrap();
    let file = |head: &str| {
        let mut text = format!("flight,line,tt [s],{head}\n");
        text.extend((0..50).map(|k| format!("1,1,{}.5,{}\n", 100 + k, 1000 + k)));
        fs::write(folder.path().join("a.csv"), text).unwrap();
    };
    let ingested = |name: &str| {
        done(&folder, &["ingest", "a.csv", "--to", "out", "--replace"]);
        numbers(&read(&folder.path().join("out")), name)[0]
    };
    file("alt [ft]");
    assert!((ingested("alt") - 304.8).abs() < 1e-9);
    file("mine [ft]");
    assert_eq!(ingested("mine"), 1000.0);
    file("Mag [nT]");
    assert_eq!(ingested("Mag [nT]"), 1000.0);
    file("alt [nT]");
    refused(&folder, &["ingest", "a.csv", "--to", "new"], &["column `alt [nT]`", "does not convert to m"]);
    file("alt [cubits]");
    refused(&folder, &["ingest", "a.csv", "--to", "new"], &["column `alt [cubits]`", "does not convert to m"]);
    fs::write(folder.path().join("a.csv"), "flight,line,tt,alt [m],alt [ft]\n1,1,1,2,3\n1,1,2,2,3\n").unwrap();
    refused(&folder, &["ingest", "a.csv", "--to", "new"], &["two columns would have this name", "`alt`"]);
    // Both names can be renamed.
    for name in ["alt [ft]", "alt"] {
        file("alt [ft]");
        let spec = format!(
            "name = \"x\"\nstore = \"store\"\n[tables.f]\npath = \"a.csv\"\nrename = {{ {name:?} = \"msl\" }}\n\
             [[stages]]\nname = \"s\"\nstage = \"derive\"\ninput = \"f\"\ncolumns = {{ out = \"msl\" }}\n"
        );
        fs::write(folder.path().join("spec.toml"), spec).unwrap();
        done(&folder, &["run", "spec.toml"]);
        let found = numbers(&read(&folder.path().join("store/tables/x/s")), "out")[0];
        assert!((found - 304.8).abs() < 1e-9, "{name}: {found}");
    }
}

#[test]
fn user_survey_points_with_units_in_their_heads_are_gridded() {
    let folder = TempDir::new().unwrap();
    let file = |name: &str, head: &str, factor: f64| {
        let mut text = format!("{head}\n");
        for (i, j) in (0..30).flat_map(|i| (0..30).map(move |j| (i, j))) {
            let (x, y) = (500_000.0 + 100.0 * f64::from(i), 5_000_000.0 + 100.0 * f64::from(j));
            text += &format!("{x},{y},500,{}\n", factor * (100.0 * (x / 700.0).sin() + f64::from(j)));
        }
        fs::write(folder.path().join(name), text).unwrap();
    };
    file("plain.csv", "easting,northing,alt,anomaly", 1.0);
    file("units.csv", "easting [m],northing [m],alt [m],anomaly [nT]", 1.0);
    file("pico.csv", "easting [m],northing [m],alt [m],anomaly [uT]", 1e-3);
    let grid = |name: &str| {
        let out = format!("{name}.parquet");
        done(&folder, &["map", "grid", name, "--epsg", "32630", "--spacing", "200", "-o", &out]);
        let alone = folder.path().join(format!("{name}.d"));
        fs::create_dir(&alone).unwrap();
        fs::rename(folder.path().join(&out), alone.join("a.parquet")).unwrap();
        numbers(&read(&alone), "anomaly")
    };
    let [plain, units, micro] = ["plain.csv", "units.csv", "pico.csv"].map(grid);
    assert!(plain.len() > 100 && plain.len() == units.len() && plain.len() == micro.len());
    let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6 || a.is_nan() && b.is_nan());
    assert!(near(&plain, &units) && near(&plain, &micro));
}

#[test]
fn user_an_export_of_a_dated_table_has_time_stamps_in_utc() {
    let folder = flown();
    done(&folder, &["export", "x.made", "-o", "out.csv"]);
    let text = fs::read_to_string(folder.path().join("out.csv")).unwrap();
    let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    let at = rows[0].iter().position(|name| *name == "utc").unwrap();
    assert_eq!(rows[0][at - 1], "tt");
    assert_eq!(rows[1][at], "2024-12-31T23:59:50Z");
    assert_eq!(rows[2][at], "2024-12-31T23:59:50.125Z");
    // The date advances at midnight, and each line begins again.
    assert_eq!(rows[1 + 88][at], "2025-01-01T00:00:01Z");
    assert_eq!(rows[1 + ROWS][at], "2024-12-31T23:59:50Z");
    fs::create_dir(folder.path().join("pq")).unwrap();
    done(&folder, &["export", "x.made", "-o", "pq/out.parquet"]);
    let parquet = read(&folder.path().join("pq"));
    let times = parquet[0].column_by_name("utc").unwrap().as_primitive::<TimestampMicrosecondType>();
    // `date -u -d 2024-12-31T23:59:50 +%s`
    assert_eq!(times.value(0), 1_735_689_590_000_000);
    done(&folder, &["export", "x.made", "-o", "out.mat"]);
    let mat = fs::read(folder.path().join("out.mat")).unwrap();
    let seconds = 1_735_689_590.0_f64.to_le_bytes();
    assert!(mat.windows(8).any(|bytes| bytes == seconds));
    // Without a date there is no such column.
    let spec = fs::read_to_string(folder.path().join("spec.toml")).unwrap();
    let more = "[[stages]]\nname = \"few\"\nstage = \"select\"\ninput = \"made\"\ncolumns = [\"double\"]\n";
    fs::write(folder.path().join("spec.toml"), spec + more).unwrap();
    done(&folder, &["run", "spec.toml"]);
    done(&folder, &["export", "x.few", "-o", "few.csv"]);
    let few = fs::read_to_string(folder.path().join("few.csv")).unwrap();
    assert_eq!(few.lines().next(), Some("flight,line,double,tt"), "{}", &few[..80]);
}

#[test]
fn user_a_text_of_several_words_survives_geosoft_xyz() {
    let folder = flown();
    done(&folder, &["export", "x.made", "-o", "out.xyz"]);
    let text = fs::read_to_string(folder.path().join("out.xyz")).unwrap();
    assert!(text.contains(" \"tactical grade\"") && text.contains(" nav"), "{}", &text[..600]);
    done(&folder, &["ingest", "out.xyz", "--to", "again"]);
    let rows = read(&folder.path().join("again"));
    let grades = texts(&rows, "ins_grade");
    assert_eq!((grades[0].as_str(), grades[100].as_str()), ("nav", "tactical grade"));
    assert_eq!(grades.len(), 2 * ROWS);
}

#[test]
fn val_a_geopackage_is_read_by_sqlite_with_its_points_and_tracks() {
    let folder = flown();
    done(&folder, &["export", "x.made", "-o", "out.gpkg"]);
    done(&folder, &["export", "x.made", "-o", "again.gpkg"]);
    let bytes = fs::read(folder.path().join("out.gpkg")).unwrap();
    assert_eq!(&bytes[68..72], b"GPKG");
    assert_eq!(bytes, fs::read(folder.path().join("again.gpkg")).unwrap());
    let file = Connection::open(folder.path().join("out.gpkg")).unwrap();
    let one = |query: &str| file.query_row(query, [], |row| row.get::<_, String>(0)).unwrap();
    assert_eq!(one("PRAGMA integrity_check"), "ok");
    assert_eq!(one("SELECT group_concat(table_name) FROM gpkg_contents"), "made,made_lines");
    assert_eq!(one("SELECT cast(count(*) AS TEXT) FROM made"), (2 * ROWS).to_string());
    assert_eq!(one("SELECT cast(count(*) AS TEXT) FROM made WHERE geom IS NULL"), "2");
    assert_eq!(one("SELECT utc FROM made WHERE fid = 2"), "2024-12-31T23:59:50.125Z");
    assert_eq!(one("SELECT ins_grade FROM made WHERE fid = 200"), "tactical grade");
    assert_eq!(one("SELECT title FROM gpkg_data_columns WHERE column_name = 'double'"), "double [nT]");
    let total = file.query_row("SELECT sum(double) FROM made", [], |row| row.get::<_, f64>(0)).unwrap();
    let expected: f64 = (0..ROWS).map(|k| 4.0 * (48_000.0 + (k % 7) as f64)).sum();
    assert_eq!(total, expected);
    let blob: Vec<u8> = file.query_row("SELECT geom FROM made WHERE fid = 4", [], |row| row.get(0)).unwrap();
    // Magic, version, flags, EPSG code, byte order, type, longitude, latitude.
    let number = |at: usize| f64::from_le_bytes(blob[at..at + 8].try_into().unwrap());
    assert_eq!((&blob[..4], blob.len()), (&b"GP\x00\x01"[..], 29));
    assert_eq!((number(13), number(21)), (-9.101, 45.00003));
    let tracks = file.query_row("SELECT sum(rows), min(length(geom)) FROM made_lines", [], |row| {
        Ok((row.get::<_, i64>(0)?, row.get::<_, i64>(1)?))
    });
    assert_eq!(tracks.unwrap(), (2 * ROWS as i64, 8 + 32 + 9 + 16 * (ROWS as i64 - 1)));
    let wrong: i64 = file.query_row("SELECT count(*) FROM pragma_foreign_key_check", [], |row| row.get(0)).unwrap();
    assert_eq!(wrong, 0);
    // A table without positions.
    let spec = fs::read_to_string(folder.path().join("spec.toml")).unwrap();
    let more = "[[stages]]\nname = \"few\"\nstage = \"select\"\ninput = \"made\"\ncolumns = [\"double\"]\n";
    fs::write(folder.path().join("spec.toml"), spec + more).unwrap();
    done(&folder, &["run", "spec.toml"]);
    refused(&folder, &["export", "x.few", "-o", "few.gpkg"], &["no columns `lat` and `lon`", "carry"]);
    assert!(!folder.path().join("few.gpkg").exists());
}

#[test]
fn user_rename_applies_to_the_columns_of_a_mapping() {
    let folder = TempDir::new().unwrap();
    let mut text = "Time,Field,Ref\n".to_owned();
    text.extend((0..300).map(|k| format!("{},{},{}\n", 0.1 * f64::from(k), 48.0 + 0.001 * f64::from(k), 48.5)));
    fs::write(folder.path().join("a.csv"), text).unwrap();
    let mapping = "flight = \"1\"\nline = \"1\"\n[tables.log]\n\
                   time = { from = \"Time\", unit = \"s\", clock = \"day\" }\n[tables.log.columns]\n\
                   mag_1_uc = { from = \"Field\", unit = \"uT\" }\nmag_1_c = { from = \"Ref\", unit = \"uT\" }\n";
    fs::write(folder.path().join("m.toml"), mapping).unwrap();
    let spec = |rename: &str| {
        let text = format!(
            "name = \"x\"\nstore = \"store\"\n[tables.f]\npath = \"a.csv\"\nmapping = \"m.toml\"\nrename = {rename}\n\
             [[stages]]\nname = \"s\"\nstage = \"derive\"\ninput = \"f\"\ncarry = [\"mag_7_uc\"]\n\
             units = {{ out = \"nT\" }}\ncolumns = {{ out = \"mag_7_uc - 1000 * reference\" }}\n"
        );
        fs::write(folder.path().join("spec.toml"), text).unwrap();
    };
    spec("{ mag_1_uc = \"mag_7_uc\", mag_1_c = \"reference\" }");
    done(&folder, &["run", "spec.toml"]);
    let rows = read(&folder.path().join("store/tables/x/s"));
    assert!((numbers(&rows, "mag_7_uc")[10] - 48_010.0).abs() < 1e-6, "{}", numbers(&rows, "mag_7_uc")[10]);
    assert!((numbers(&rows, "out")[10] + 490.0).abs() < 1e-6);
    // Truth stays truth under another name.
    let schema = rows[0].schema();
    assert_eq!(schema.field_with_name("out").unwrap().metadata()["role"], "truth");
    for (rename, said) in [
        ("{ mag_2_uc = \"mag_7_uc\" }", "no column `mag_2_uc` to rename"),
        ("{ tt = \"time\" }", "`tt` cannot be renamed"),
        ("{ mag_1_uc = \"alt\" }", "must be in m"),
        ("{ mag_1_uc = \"mag_1_c\" }", "two columns would have this name"),
    ] {
        spec(rename);
        refused(&folder, &["check", "spec.toml"], &[said]);
    }
}

#[test]
fn user_whole_numbers_of_the_date_survive_a_round_trip() {
    let folder = flown();
    done(&folder, &["export", "x.made", "-o", "out.csv", "--units"]);
    done(&folder, &["ingest", "out.csv", "--to", "again"]);
    let rows = read(&folder.path().join("again"));
    let doy = rows[0].column_by_name("doy").unwrap().as_primitive::<Int64Type>();
    assert_eq!((doy.value(0), doy.value(ROWS - 1), doy.null_count()), (366, 1, 0));
}

#[test]
fn user_one_block_declares_all_tables_of_a_log_with_a_mapping_by_content() {
    let folder = TempDir::new().unwrap();
    let log = crate::support::repository().join("datasets/samples/logs/log171_flight.bin");
    let spec = |more: &str| {
        let second = if more.contains("nothing") { "log_nothing" } else { "log_battery" };
        let text = format!(
            "name = \"x\"\nstore = \"store\"\n[tables.log]\npath = {log:?}\n{more}\n[[stages]]\nname = \"even\"\n\
             stage = \"resample\"\ninput = [\"log_mag\", \"{second}\"]\nrate_hz = 10.0\n"
        );
        fs::write(folder.path().join("spec.toml"), text).unwrap();
    };
    spec("mapping = \"auto\"\ntable = [\"mag\", \"battery\"]");
    let output = done(&folder, &["run", "spec.toml"]);
    let said = stderr(&output);
    assert!(said.contains("the mapping `ardupilot_dataflash_timems` is chosen by the content"), "{said}");
    let one = read(&folder.path().join("store/tables/x/even"));
    // The same values as with a block for each table.
    let blocks = format!(
        "name = \"y\"\nstore = \"store\"\n[tables.mag]\npath = {log:?}\nmapping = \"ardupilot_dataflash_timems\"\n\
         table = \"mag\"\n[tables.battery]\npath = {log:?}\nmapping = \"ardupilot_dataflash_timems\"\n\
         table = \"battery\"\n[[stages]]\nname = \"even\"\nstage = \"resample\"\ninput = [\"mag\", \"battery\"]\n\
         rate_hz = 10.0\n"
    );
    fs::write(folder.path().join("blocks.toml"), blocks).unwrap();
    done(&folder, &["run", "blocks.toml"]);
    let other = read(&folder.path().join("store/tables/y/even"));
    let bits = |rows: &[arrow_array::RecordBatch]| -> Vec<u64> {
        ["flux_a_x", "tt"].iter().flat_map(|name| numbers(rows, name)).map(f64::to_bits).collect()
    };
    assert!(bits(&one).len() > 1000 && bits(&one) == bits(&other));
    for (more, said) in [
        ("mapping = \"auto\"\ntable = [\"mag\", \"mag\"]", "lists `mag` twice"),
        ("mapping = \"auto\"\ntable = []", "`table` is empty"),
        ("mapping = \"auto\"\ntable = [\"mag\", \"nothing\"]", "no table `nothing`"),
        ("table = [\"mag\", \"battery\"]", "`table` requires `mapping`"),
    ] {
        spec(more);
        refused(&folder, &["check", "spec.toml"], &[said]);
    }
}

#[test]
fn user_a_logger_with_a_clock_in_milliseconds_and_a_fluxgate_in_volts_is_recognised() {
    let folder = TempDir::new().unwrap();
    let log = |name: &str, head: &str, scalar: bool| {
        let mut text = format!("{head}\n");
        for k in 0..600 {
            let t = f64::from(k);
            let mag = if scalar { format!("{:.2},", 48_000.0 + 30.0 * (t / 40.0).sin()) } else { String::new() };
            let (x, y) = (2.0 * (t / 30.0).cos(), 2.0 * (t / 30.0).sin());
            text += &format!("{},{mag}{x:.5},{y:.5},{:.5}\n", 1000 + 100 * k, 4.36 + 0.05 * (t / 11.0).sin());
        }
        fs::write(folder.path().join("logs").join(name), text).unwrap();
    };
    fs::create_dir(folder.path().join("logs")).unwrap();
    log("a.csv", "millis,Mag_nT,FluxX_V,FluxY_V,FluxZ_V", true);
    log("b.csv", "millis,Mag_nT,FluxX_V,FluxY_V,FluxZ_V", true);
    log("c.csv", "millis,FluxX_V,FluxY_V,FluxZ_V", false);
    let text = stdout(&done(&folder, &["ingest", "--suggest", "logs"]));
    for words in [
        "# The same columns: 1 of 2 other logs.",
        "# c.csv lacks Mag_nT, and also has nothing",
        "time  = { from = \"millis\", unit = \"ms\", clock = \"boot\" }",
        "mag_1_uc = { from = \"Mag_nT\", unit = \"nT\" }",
        "flux_a = { from = [\"FluxX_V\", \"FluxY_V\", \"FluxZ_V\"], unit = \"nT\", scale = 10000.0",
        "the median of `Mag_nT` is 480",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
    // The mapping works: 4.8 V are 48,000 nT.
    done(&folder, &["ingest", "--suggest", "logs/a.csv", "-o", "m.toml"]);
    done(&folder, &["ingest", "logs/a.csv", "--mapping", "m.toml", "--to", "out"]);
    let rows = read(&folder.path().join("out"));
    let of = |name: &str| numbers(&rows, name)[0];
    let size = (of("flux_a_x").powi(2) + of("flux_a_y").powi(2) + of("flux_a_z").powi(2)).sqrt();
    assert!((size - 47_968.0).abs() < 2.0, "{size}");
    assert!((numbers(&rows, "tt")[1] - numbers(&rows, "tt")[0] - 0.1).abs() < 1e-9);
    // Without a scalar magnetometer the sensitivity is unknown.
    let output = magline(folder.path(), &["ingest", "--suggest", "logs/c.csv"]);
    let said = format!("{}{}", stdout(&output), stderr(&output));
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("volts according to the names") && said.contains("set `scale` in nT per V"), "{said}");
    // A clock under any name, if it is the only even one.
    log("d.csv", "Zaehler,Mag_nT,FluxX_V,FluxY_V,FluxZ_V", true);
    let text = stdout(&done(&folder, &["ingest", "--suggest", "logs/d.csv"]));
    assert!(
        text.contains("from = \"Zaehler\", unit = \"ms\"") && text.contains("only column that increases"),
        "{text}"
    );
}

#[test]
fn user_a_missing_lag_is_a_warning() {
    let folder = TempDir::new().unwrap();
    let mut text = "flight,line,tt,mag_1_uc,mag_2_uc\n".to_owned();
    text.extend((0..600).map(|k| format!("1,1.5,{},{},48000\n", 0.1 * f64::from(k), 48_000 + k % 9)));
    fs::write(folder.path().join("a.csv"), text).unwrap();
    let spec = "name = \"x\"\nstore = \"store\"\n[tables.f]\npath = \"a.csv\"\n[[stages]]\nname = \"lags\"\n\
                stage = \"lag\"\ninput = \"f\"\ncolumns = [\"mag_2_uc\"]\nreference = \"mag_1_uc\"\n";
    fs::write(folder.path().join("spec.toml"), spec).unwrap();
    // Also if the result is reused.
    for _ in 0..2 {
        let said = stderr(&done(&folder, &["run", "spec.toml"]));
        assert!(said.contains("line 1.5: `mag_2_uc` has no lag: one of the signals is constant"), "{said}");
    }
    let rows = read(&folder.path().join("store/tables/x/warnings"));
    assert_eq!((texts(&rows, "kind"), texts(&rows, "stage")), (vec!["stage".to_owned()], vec!["lags".to_owned()]));
}

#[test]
fn user_a_renamed_truth_column_stays_truth() {
    let folder = flown();
    let spec = fs::read_to_string(folder.path().join("spec.toml")).unwrap();
    let more = "[[stages]]\nname = \"ref\"\nstage = \"derive\"\ninput = \"f\"\ncolumns = { known = \"lat\" }\n";
    fs::write(folder.path().join("spec.toml"), spec + more).unwrap();
    done(&folder, &["run", "spec.toml"]);
    done(&folder, &["export", "x.ref", "-o", "ref.parquet"]);
    let spec = "name = \"y\"\nstore = \"store\"\n[tables.f]\npath = \"ref.parquet\"\nrename = { known = \"place\" }\n\
                [[stages]]\nname = \"s\"\nstage = \"derive\"\ninput = \"f\"\ncolumns = { out = \"place\" }\n";
    fs::write(folder.path().join("again.toml"), spec).unwrap();
    done(&folder, &["run", "again.toml"]);
    let rows = read(&folder.path().join("store/tables/y/s"));
    assert_eq!(rows[0].schema().field_with_name("out").unwrap().metadata()["role"], "truth");
}
