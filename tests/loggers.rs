//! Logs of specific loggers, written by their definitions and read through the included mappings.

use std::{fs, path::Path};

use arrow_array::RecordBatch;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use tempfile::TempDir;

use crate::support::{magline, numbers, repository, stderr, texts};

fn file(path: &Path) -> Vec<RecordBatch> {
    let reader = ParquetRecordBatchReaderBuilder::try_new(fs::File::open(path).unwrap()).unwrap();
    reader.build().unwrap().map(Result::unwrap).collect()
}

/// Logs written by `datasets/reference/logs.py` from the message definitions of ArduPilot 4.1 and 3.6, and verified
/// with pymavlink.
#[test]
fn ref_ardupilot_logs_of_4_1_and_3_6_are_read_through_their_mappings() {
    let folder = TempDir::new().unwrap();
    for (name, mapping, year, doy) in
        [("ardupilot_4", "ardupilot_dataflash", 2022, 68), ("ardupilot_3", "ardupilot_dataflash_timeus", 2018, 129)]
    {
        let log = repository().join(format!("datasets/reference/logs/{name}.bin")).display().to_string();
        let output = magline(folder.path(), &["ingest", &log, "--to", name, "--mapping", mapping]);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(0), "{message}");
        // The clock is 0 at noon GPS time, which is 18 s earlier in UTC since 2017.
        assert!(
            message.contains(&format!("its clock read 0 on {year}-")) && message.contains("11:59:42.000 UTC"),
            "{message}"
        );
        let table = |table: &str| file(&folder.path().join(format!("{name}/{table}/{name}.parquet")));
        let mag = table("mag");
        let first_and_last = |t: &[RecordBatch], column: &str| {
            let all = numbers(t, column);
            (all[0], all[all.len() - 1])
        };
        // 30 s and 41.9 s of the clock.
        let (from, to) = first_and_last(&mag, "tt");
        assert!((from - 43_212.0).abs() < 1e-6 && (to - 43_223.9).abs() < 1e-6, "{from} {to}");
        assert_eq!((numbers(&mag, "year")[0], numbers(&mag, "doy")[0]), (f64::from(year), f64::from(doy)));
        assert_eq!(texts(&mag, "flight")[0], name);
        // 200 + k + 97 - k mod 5, -40 - 118 - 1 and -586 + 2 k - 213 + 2 mgauss.
        assert_eq!(first_and_last(&mag, "flux_a_x"), (29_700.0, 41_200.0));
        assert_eq!(first_and_last(&mag, "flux_a_y"), (-15_900.0, -15_900.0));
        assert_eq!(first_and_last(&mag, "flux_a_z"), (-79_700.0, -55_900.0));
        let second = table("mag_2");
        assert_eq!(
            ["flux_b_x", "flux_b_y", "flux_b_z"].map(|n| numbers(&second, n)[0]),
            [-4000.0, 27_000.0, -43_000.0]
        );
        let gps = table("gps");
        // The first two records have no GNSS fix. The velocity is 12 m/s eastward.
        assert_eq!(numbers(&gps, "lat").len(), 58);
        assert_eq!(["lat", "lon", "msl"].map(|n| numbers(&gps, n)[0]), [-35.362_581, 149.165_23, 584.36]);
        assert!(numbers(&gps, "vn")[0].abs() < 1e-12 && numbers(&gps, "ve")[0] == 12.0);
        assert_eq!(numbers(&gps, "vd")[0], -0.5);
        let attitude = table("attitude");
        assert_eq!(["ins_roll", "ins_pitch", "ins_yaw"].map(|n| numbers(&attitude, n)[0]), [12.5, -3.75, 270.25]);
        let imu = table("imu");
        assert_eq!(["accel_x", "accel_y", "accel_z"].map(|n| numbers(&imu, n)[0]), [0.5, -0.25, -9.75]);
        let battery = table("battery");
        assert_eq!(["cur_battery", "vol_battery"].map(|n| numbers(&battery, n)[0]), [12.25, 15.875]);
        assert_eq!(["baro_above_start", "press"].map(|n| numbers(&table("baro"), n)[0]), [42.5, 95_123.5]);
    }
}

/// Rows of a MagArrow over midnight, as in its manual and in the documentation of other readers.
const MAGARROW: &str = "\
     Counter,Date,Time,Latitude,Longitude,Mag, MagValid,CompassX, CompassY, CompassZ,GyroscopeX, GyroscopeY, \
     GyroscopeZ,AccelerometerX, AccelerometerY, AccelerometerZ,ImuTemperature,Track,LocationSource,Hdop,FixQuality, \
     SatellitesUsed, Altitude,HeightOverEllipsoid,SpeedOverGround,MagneticVariation,VariationDirection,ModeIndicator,\
     GgaSentence,RmcSentence,EventCode,EventInfo,EventDataLength,EventData\n";

/// Rows of two sensors of an MFAM.
const MFAM: &str =
    "Counter,Date,Time,Latitude,Longitude,Mag1Data, Mag1Valid, Mag1Deadzone, Mag2Data, Mag2Valid, Mag2Deadzone\n";

#[test]
fn ref_magarrow_and_mfam_logs_are_read_through_their_mapping() {
    let folder = TempDir::new().unwrap();
    let (mut magarrow, mut mfam) = (MAGARROW.to_owned(), MFAM.to_owned());
    for k in 0..400 {
        let (day, t) = if k < 100 { (25, 86_390.0 + f64::from(k) / 10.0) } else { (26, f64::from(k - 100) / 10.0) };
        let clock = format!("{:02}:{:02}:{:06.3}", t as u32 / 3600, t as u32 / 60 % 60, t % 60.0);
        let nt = 32_575.0 + 10.0 * (f64::from(k) / 20.0).sin();
        magarrow += &format!(
            "{k},2026/04/{day},{clock},{:.8},-2.59298368,{nt:.5},{},24246,-11815,{},-51.052,3.699,27.426,\
             -0.01903,-0.05149,1.39587,35.805,106.9,G,0.980,1,12,301.40,24.10,2.578,0.000, ,,'$GNGGA','$GNRMC',,,,\n",
            8.134_843_66 + 1e-6 * f64::from(k),
            u8::from(k != 7),
            -20_435 - k % 3,
        );
        let dead = (200..230).contains(&k);
        mfam += &format!(
            "{k},2026/04/{day},{clock},49.5,7.0,{nt:.4}, {}, {}, {:.4}, 1, 0\n",
            u8::from(!dead),
            u8::from(dead),
            nt - 1.3
        );
    }
    for (name, text) in [("magarrow.csv", &magarrow), ("mfam.csv", &mfam)] {
        fs::write(folder.path().join(name), text).unwrap();
        let output = magline(folder.path(), &["ingest", name, "--to", "out", "--mapping", "mfam"]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    }
    let one = file(&folder.path().join("out/magarrow.parquet"));
    let tt = numbers(&one, "tt");
    assert!((tt[0] - 86_390.0).abs() < 1e-9 && (tt[399] - 86_429.9).abs() < 1e-9, "{} {}", tt[0], tt[399]);
    assert_eq!((numbers(&one, "year")[0], numbers(&one, "doy")[0]), (2026.0, 115.0));
    assert_eq!((texts(&one, "flight")[0].as_str(), texts(&one, "line")[0].as_str()), ("magarrow", "1"));
    let mag = numbers(&one, "mag_1_uc");
    assert!(mag[7].is_nan() && mag[0] == 32_575.0 && mag.iter().filter(|x| x.is_nan()).count() == 1);
    // Axes starboard, aft, down are converted to nose, starboard, down. The height is 301.4 m above the sea, which is
    // 24.1 m above the ellipsoid.
    assert_eq!(["flux_a_x", "flux_a_y", "flux_a_z"].map(|n| numbers(&one, n)[0]), [11_815.0, 24_246.0, -20_435.0]);
    assert!((numbers(&one, "alt")[0] - 325.5).abs() < 1e-9 && numbers(&one, "lat")[0] == 8.134_843_66);
    let two = file(&folder.path().join("out/mfam.parquet"));
    assert_eq!(numbers(&two, "mag_1_uc").iter().filter(|x| x.is_nan()).count(), 30);
    assert_eq!(numbers(&two, "mag_2_uc")[0], 32_573.7);
    // Status messages of the sensor are counted as data quality.
    let quality = file(&folder.path().join("out/_quality/mfam.parquet"));
    let at = texts(&quality, "check").iter().position(|check| check == "dead_zone").unwrap();
    assert_eq!((texts(&quality, "column")[at].as_str(), numbers(&quality, "count")[at]), ("mag_1_uc", 30.0));
    assert!((numbers(&quality, "value")[at] - 3.1).abs() < 1e-6);
}

#[test]
fn user_the_lines_of_a_small_aircraft_are_found_and_usable() {
    let folder = TempDir::new().unwrap();
    let log = repository().join("datasets/samples/thor75/flight.parquet").display().to_string();
    let spec = format!(
        "name = 'thor'\nstore = 'store'\n[tables.log]\npath = '{log}'\nmapping = 'thor75_parquet'\ntable = 'flight'\n\
         lines = 'auto'\n[[stages]]\nname = 'even'\nstage = 'resample'\ninput = 'log'\nrate_hz = 10.0\n"
    );
    fs::write(folder.path().join("thor.toml"), spec).unwrap();
    let output = magline(folder.path(), &["run", "thor.toml"]);
    // The barometer is zero at take-off, 240 m above the sea. A line in the air must not be rejected for this.
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let query = "SELECT DISTINCT line FROM thor.even ORDER BY line";
    let lines = magline(folder.path(), &["sql", query, "--store", "store", "--format", "csv"]);
    let lines: Vec<String> = String::from_utf8_lossy(&lines.stdout).lines().skip(1).map(str::to_owned).collect();
    // Climb-out, three sides of each of seven squares, and two lines of the return.
    assert_eq!((lines.len(), lines[0].as_str()), (24, "circle1"), "{lines:?}");
}
