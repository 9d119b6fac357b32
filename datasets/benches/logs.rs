//! Benchmark of reading binary logs: `cargo bench -p magline-datasets --bench logs --profile dev [megabytes [folder]]`.
//! The files repeat the real samples. If `folder` is given, they are written there, so that other programs can read the
//! same files (`logs.py`).

use std::{error::Error, fs, io::Write, path::Path, time::Instant};

use datasets::{FlightOptions, ReadHints, open_raw, samples, topics};

const RUNS: usize = 5;

/// Writes a PX4 log: the definitions once, then the data repeatedly.
fn write_ulog(path: &Path, bytes: usize) -> Result<usize, Box<dyn Error>> {
    let log = fs::read(samples::path("logs/sample_cut.ulg"))?;
    let mut at = 16;
    while log[at + 2] != b'D' {
        at += 3 + usize::from(u16::from_le_bytes([log[at], log[at + 1]]));
    }
    repeat(path, &log[..at], &log[at..], bytes)
}

/// Writes an ArduPilot log repeatedly, without its last message, which is truncated.
fn write_dataflash(path: &Path, bytes: usize) -> Result<usize, Box<dyn Error>> {
    let log = fs::read(samples::path("logs/log171_cut.bin"))?;
    let (mut at, mut lengths) = (0, [0; 256]);
    lengths[0x80] = 89;
    while at + 5 < log.len() {
        let length = lengths[usize::from(log[at + 2])];
        if at + length > log.len() {
            break;
        }
        if log[at + 2] == 0x80 {
            lengths[usize::from(log[at + 3])] = usize::from(log[at + 4]);
        }
        at += length;
    }
    repeat(path, &[], &log[..at], bytes)
}

/// Writes a head once and a body repeatedly up to the size; returns the number of repeats.
fn repeat(path: &Path, head: &[u8], body: &[u8], bytes: usize) -> Result<usize, Box<dyn Error>> {
    let mut out = fs::File::create(path)?;
    out.write_all(head)?;
    let times = bytes.div_ceil(body.len());
    for _ in 0..times {
        out.write_all(body)?;
    }
    Ok(times)
}

/// Speed in megabytes per second of wall-clock time and of processor time of this thread; the best of several runs.
fn measured(path: &Path, mut run: impl FnMut() -> Result<(), Box<dyn Error>>) -> Result<String, Box<dyn Error>> {
    let megabytes = fs::metadata(path)?.len() as f64 / 1e6;
    let (mut wall, mut thread) = (0f64, 0f64);
    for _ in 0..RUNS {
        let (start, before) = (Instant::now(), thread_s());
        run()?;
        wall = wall.max(megabytes / start.elapsed().as_secs_f64());
        thread = thread.max(megabytes / (thread_s() - before));
    }
    Ok(format!("{wall:.0} MB/s ({thread:.0} by the time of the thread)"))
}

/// Processor time of this thread, in seconds; NaN if the system does not report it.
fn thread_s() -> f64 {
    let text = fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(f64::NAN) / 1e9
}

/// Reads all rows and columns of a topic.
fn read(path: &Path, topic: &str, rows: usize) -> Result<(), Box<dyn Error>> {
    let options = FlightOptions { topic: Some(topic.to_owned()), ..FlightOptions::default() };
    let reader = open_raw(path, &options, &ReadHints::default())?;
    let read: usize = reader.map(|b| b.map(|b| b.num_rows())).sum::<Result<_, _>>()?;
    assert_eq!(read, rows, "{topic}");
    Ok(())
}

fn list(path: &Path) -> Result<(), Box<dyn Error>> {
    assert!(topics(path, &FlightOptions::default())?.len() > 10);
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut given = std::env::args().skip(1).filter(|a| !a.starts_with("--"));
    let megabytes: usize = given.next().map_or(Ok(200), |m| m.parse())?;
    let (folder, keep) = match given.next() {
        Some(folder) => (folder.into(), true),
        None => (std::env::temp_dir().join(format!("magline_logs_bench.{}", std::process::id())), false),
    };
    fs::create_dir_all(&folder)?;
    let (ulog, dataflash) = (folder.join("log.ulg"), folder.join("log.bin"));
    let times = write_ulog(&ulog, megabytes * 1_000_000)?;
    // Numbers of rows of the samples by pyulog and pymavlink, from `reference/logs`.
    for (topic, rows) in [("estimator_status", 118), ("vehicle_attitude", 0), ("sensor_combined", 0)] {
        let rows = if rows == 0 { rows_of(&samples::path("logs/sample_cut.ulg"), topic)? } else { rows };
        println!("ulog, {topic}: {}", measured(&ulog, || read(&ulog, topic, rows * times))?);
    }
    let listed = measured(&ulog, || list(&ulog))?;
    println!("ulog, list of topics: {listed}");
    let times = write_dataflash(&dataflash, megabytes * 1_000_000)?;
    for (topic, rows) in [("MAG", 226), ("IMU", 1131)] {
        println!("dataflash, {topic}: {}", measured(&dataflash, || read(&dataflash, topic, rows * times))?);
    }
    let listed = measured(&dataflash, || list(&dataflash))?;
    println!("dataflash, list of topics: {listed}");
    if !keep {
        fs::remove_dir_all(&folder)?;
    }
    Ok(())
}

fn rows_of(path: &Path, topic: &str) -> Result<usize, Box<dyn Error>> {
    let all = topics(path, &FlightOptions::default())?;
    let found = all.iter().find(|t| t.name == topic).ok_or("no such topic")?;
    Ok(usize::try_from(found.rows)?)
}
