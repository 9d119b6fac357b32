//! Measures of this machine: processor time, memory, and speed relative to the machine of the built-in figures.

use std::{fs, hint::black_box, io::Write, path::Path, time::Instant};

use nix::time::{ClockId, clock_gettime};
use numerics::signal::filter::band_pass;

/// Reading of a system clock, in seconds; 0 if the system lacks it.
fn clock_s(id: ClockId) -> f64 {
    clock_gettime(id).map_or(0.0, |time| time.tv_sec() as f64 + time.tv_nsec() as f64 * 1e-9)
}

/// The processor time of this process on all its threads, in seconds.
pub fn processor_s() -> f64 {
    clock_s(ClockId::CLOCK_PROCESS_CPUTIME_ID)
}

/// The processor time of this thread, in seconds.
fn thread_s() -> f64 {
    clock_s(ClockId::CLOCK_THREAD_CPUTIME_ID)
}

/// Shortest time of the speed measurement on the reference machine, in seconds. The reference machine is a virtual
/// machine on an AMD EPYC.
const REFERENCE_S: f64 = 0.000_031_1;
/// Number of time measurements, of which the shortest is used.
const TRIES: usize = 15;
const SAMPLES: usize = 4096;

/// Speed of a processor of this machine relative to the reference machine, whose speed is 1. The speed follows from the
/// shortest measured time of a band-pass and a checksum, which take about 31 µs on the reference machine.
pub fn speed() -> f64 {
    let x: Vec<f64> = (0..SAMPLES).map(|i| (i as f64 * 0.1).sin()).collect();
    let bytes: Vec<u8> = (0..SAMPLES * 32).map(|i| (i % 251) as u8).collect();
    let mut least = f64::INFINITY;
    for _ in 0..TRIES {
        let begun = thread_s();
        let _ = black_box(band_pass(black_box(&x), 10.0, 0.1, 0.9, 4));
        black_box(blake3::hash(black_box(&bytes)));
        least = least.min(thread_s() - begun);
    }
    if least > 0.0 && least.is_finite() { REFERENCE_S / least } else { 1.0 }
}

/// Time to sync a small file to the disk, in seconds; 0 if it cannot be measured. `path` must be unused.
pub fn sync_s(path: &Path) -> f64 {
    let mut least = f64::INFINITY;
    for _ in 0..3 {
        let begun = Instant::now();
        let written = fs::File::create(path).and_then(|mut f| f.write_all(&[0; 4096]).and_then(|()| f.sync_all()));
        if written.is_ok() {
            least = least.min(begun.elapsed().as_secs_f64());
        }
    }
    // If the file cannot be removed here, it is removed with the other temporary files.
    let _ = fs::remove_file(path);
    if least.is_finite() { least } else { 0.0 }
}

/// Resets the peak memory. Returns whether the system supports this.
pub fn forget_peak() -> bool {
    fs::write("/proc/self/clear_refs", "5").is_ok()
}

/// Peak memory of the process, in bytes; `None` if the system does not report the memory.
pub fn peak_bytes() -> Option<u64> {
    peak(&fs::read_to_string("/proc/self/status").ok()?)
}

fn peak(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    Some(line.trim().trim_end_matches("kB").trim().parse::<u64>().ok()? << 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gold_the_peak_is_read() {
        assert_eq!(peak("Name:\tmagline\nVmPeak:\t  9 kB\nVmHWM:\t    2048 kB\nVmRSS:\t 1 kB\n"), Some(2 << 20));
        assert_eq!(peak("VmHWM:\t many kB\n"), None);
    }

    #[test]
    fn unit_processor_time_increases_and_speed_is_finite() {
        let before = processor_s();
        let speed = speed();
        assert!(speed.is_finite() && speed > 0.0, "{speed}");
        assert!(processor_s() > before);
    }
}
