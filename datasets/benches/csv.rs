//! Benchmark of reading flight logs in text: `cargo bench -p magline-datasets --bench csv --profile dev [megabytes
//! [path]]`. The files are written first. If `path` is given, the CSV file is written there, so that another program
//! can read the same file.

use std::{
    error::Error,
    fs,
    io::{BufWriter, Write},
    path::Path,
    time::Instant,
};

use arrow_array::{Array, cast::AsArray, types::Float64Type};
use datasets::{FlightOptions, PointOptions, ReadHints, open_flight_with, read_points};

/// Number of columns of numbers. Half of them have canonical names; the type of the others must be inferred.
const NUMBERS: usize = 40;

const RUNS: usize = 5;

/// Number in a row and column, of six to nine digits.
fn number(row: usize, column: usize) -> f64 {
    let x = ((row * 7919 + column * 104_729) % 999_983) as f64;
    match column % 4 {
        0 => 48_000.0 + x / 1000.0,
        1 => (x - 5e5) / 1e4,
        2 => 100.0 + x / 1e6,
        _ => x / 10.0,
    }
}

fn decimals(column: usize) -> usize {
    [3, 4, 6, 1][column % 4]
}

fn name(column: usize) -> String {
    if column.is_multiple_of(2) { format!("mag_{column}_uc") } else { format!("channel {column}") }
}

fn write_csv(path: &Path, bytes: u64) -> Result<usize, Box<dyn Error>> {
    let mut out = BufWriter::new(fs::File::create(path)?);
    let names: Vec<String> = (0..NUMBERS).map(name).collect();
    writeln!(out, "flight,line,tt,{}", names.join(","))?;
    let (mut row, mut written) = (0, 0);
    let mut text = vec![];
    while written < bytes {
        text.clear();
        write!(text, "1003,1003.{:02},{:.1}", row / 36_000, 30_000.0 + row as f64 / 10.0)?;
        for column in 0..NUMBERS {
            write!(text, ",{:.*}", decimals(column), number(row, column))?;
        }
        text.push(b'\n');
        out.write_all(&text)?;
        written += text.len() as u64;
        row += 1;
    }
    out.flush()?;
    Ok(row)
}

/// Writes blank-separated text in the form of the SGL surveys.
fn write_xyz(path: &Path, bytes: u64) -> Result<usize, Box<dyn Error>> {
    let mut out = BufWriter::new(fs::File::create(path)?);
    let names: Vec<String> = (0..NUMBERS).map(|c| format!("CHANNEL{c}")).collect();
    writeln!(out, "/ a survey\n/ LINE FLT TIME LAT LONG UTM-Z {}", names.join(" "))?;
    let (mut row, mut written) = (0, 0);
    let mut text = vec![];
    while written < bytes {
        text.clear();
        let place = (45.0 + row as f64 * 1e-6, -75.0 + row as f64 * 1e-6);
        write!(
            text,
            " 1003.{:02} 1003 {:.1} {:.6} {:.6} 300.0",
            row / 36_000,
            30_000.0 + row as f64 / 10.0,
            place.0,
            place.1
        )?;
        for column in 0..NUMBERS {
            write!(text, " {:10.*}", decimals(column), number(row, column))?;
        }
        text.push(b'\n');
        out.write_all(&text)?;
        written += text.len() as u64;
        row += 1;
    }
    out.flush()?;
    Ok(row)
}

/// Writes survey points.
fn write_points(path: &Path, bytes: u64) -> Result<usize, Box<dyn Error>> {
    let mut out = BufWriter::new(fs::File::create(path)?);
    writeln!(out, "lon lat alt mag")?;
    let (mut row, mut written) = (0, 0);
    let mut text = vec![];
    while written < bytes {
        text.clear();
        writeln!(
            text,
            "{:.6} {:.6} {:.1} {:.3}",
            140.0 + row as f64 * 1e-7,
            -22.0 + row as f64 * 1e-7,
            500.0,
            number(row, 0)
        )?;
        out.write_all(&text)?;
        written += text.len() as u64;
        row += 1;
    }
    out.flush()?;
    Ok(row)
}

/// Speed in megabytes per second of wall-clock time and of processor time of this thread; the best of several runs.
struct Speed {
    wall: f64,
    /// Speed by the processor time of this thread, for a shared machine.
    thread: f64,
}

impl std::fmt::Display for Speed {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{:.0} MB/s ({:.0} by the time of the thread)", self.wall, self.thread)
    }
}

fn measured(path: &Path, mut run: impl FnMut() -> Result<(), Box<dyn Error>>) -> Result<Speed, Box<dyn Error>> {
    let megabytes = fs::metadata(path)?.len() as f64 / 1e6;
    let mut best = Speed { wall: 0.0, thread: 0.0 };
    for _ in 0..RUNS {
        let (start, thread) = (Instant::now(), thread_s());
        run()?;
        best.wall = best.wall.max(megabytes / start.elapsed().as_secs_f64());
        best.thread = best.thread.max(megabytes / (thread_s() - thread));
    }
    Ok(best)
}

/// Processor time of this thread, in seconds; NaN if the system does not report it.
fn thread_s() -> f64 {
    let text = fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(f64::NAN) / 1e9
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut given = std::env::args().skip(1).filter(|a| !a.starts_with("--"));
    let megabytes: u64 = given.next().map_or(Ok(150), |m| m.parse())?;
    let folder = std::env::temp_dir().join(format!("magline_csv_bench.{}", std::process::id()));
    fs::create_dir_all(&folder)?;
    let path = given.next().map_or(folder.join("flight.csv"), Into::into);
    let options = FlightOptions::default();
    let rows = write_csv(&path, megabytes * 1_000_000)?;
    for threads in [1, 2] {
        let mut found = None;
        let both = measured(&path, || {
            let reader = open_flight_with(&path, &options, &ReadHints { found: None, threads })?;
            found = reader.found().map(str::to_owned);
            check(reader, rows)
        })?;
        let types = measured(&path, || {
            open_flight_with(&path, &options, &ReadHints { found: None, threads })?;
            Ok(())
        })?;
        let values = measured(&path, || {
            check(open_flight_with(&path, &options, &ReadHints { found: found.clone(), threads })?, rows)
        })?;
        println!("csv, {threads} threads: {both}; types alone {types}; values alone {values}");
    }
    let survey = folder.join("survey.xyz");
    let rows = write_xyz(&survey, megabytes * 1_000_000)?;
    let speed = measured(&survey, || {
        let reader = open_flight_with(&survey, &options, &ReadHints::default())?;
        let read: usize = reader.map(|b| b.map(|b| b.num_rows())).sum::<Result<_, _>>()?;
        assert_eq!(read, rows);
        Ok(())
    })?;
    println!("xyz of a survey, 1 thread: {speed}");
    let points = folder.join("points.xyz");
    let rows = write_points(&points, megabytes * 100_000)?;
    let speed = measured(&points, || {
        let read = read_points(&points, &PointOptions::default())?;
        assert_eq!(read.value_nt.len(), rows);
        Ok(())
    })?;
    println!("xyz of points, projected: {speed}");
    fs::remove_dir_all(&folder)?;
    Ok(())
}

/// Reads all rows, and checks the first and last number of each column of each batch.
fn check(reader: datasets::FlightReader, rows: usize) -> Result<(), Box<dyn Error>> {
    let mut row = 0;
    for batch in reader {
        let batch = batch?;
        let n = batch.num_rows();
        for column in 0..NUMBERS {
            let values = batch.column(3 + column).as_primitive::<Float64Type>();
            for at in [0, n - 1] {
                let wanted: f64 = format!("{:.*}", decimals(column), number(row + at, column)).parse()?;
                assert_eq!(values.value(at).to_bits(), wanted.to_bits());
            }
            assert_eq!(values.null_count(), 0);
        }
        row += n;
    }
    assert_eq!(row, rows);
    Ok(())
}
