//! A run holds one line at a time, so its memory peak does not grow with the number of lines.

use std::{
    fs,
    process::{Command, Stdio},
    thread::sleep,
    time::Duration,
};

use crate::support::{Bench, line_of, write};

/// Peak resident memory of a run over `lines` lines of 20,000 samples, kB.
fn peak_kb(lines: usize) -> u64 {
    let bench = Bench::new();
    for flight in ["1", "2"] {
        fs::remove_file(bench.path(&format!("flights/{flight}.parquet"))).unwrap();
    }
    for i in 0..lines {
        let name = format!("{i:03}");
        write(&bench.path(&format!("flights/{name}.parquet")), &[line_of(&name, &format!("{name}.01"), 20_000)]);
    }
    let mut child = Command::new(env!("CARGO_BIN_EXE_magline"))
        .args(["run", "spec.toml", "--threads", "1", "--set", "track.offset_window_s=0"])
        .args(["--set", "axes.mag=[\"mag_4_uc\"]", "--set", "axes.vector=[\"flux_a\"]", "--set", "axes.lambda=[0.1]"])
        .current_dir(bench.folder.path())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut peak = 0;
    while child.try_wait().unwrap().is_none() {
        let text = fs::read_to_string(&status).unwrap_or_default();
        let high = text
            .lines()
            .find_map(|l| l.strip_prefix("VmHWM:"))
            .and_then(|l| l.trim().trim_end_matches(" kB").parse().ok());
        peak = peak.max(high.unwrap_or(0));
        sleep(Duration::from_millis(3));
    }
    // Most of the track is off the map; the test only requires a complete run.
    assert!(bench.path("store/tables/small/failures").exists());
    peak
}

#[test]
#[cfg(target_os = "linux")]
fn user_the_peak_of_memory_does_not_grow_with_the_number_of_lines() {
    // With fewer lines, the allocator has not yet taken the blocks that every longer run requires.
    let (few, many) = (peak_kb(12), peak_kb(48));
    // 36 more lines are 36 * 20,000 * 39 columns * 8 bytes = 225 MB. A fit keeps the means of the terms over each
    // second, which are 16 MB. The allocator takes memory in blocks of 32 MB.
    assert!(many < few + 60_000, "{few} kB for 12 lines, {many} kB for 48");
}
