//! Memory limit of a query.

use std::fs;

use schemas::Fault;

const KB: usize = 1000;
/// Bounds of the default, which is a quarter of the machine's memory.
const LEAST: usize = 256 * KB * KB;
const MOST: usize = 8 * KB * KB * KB;
/// Minimum limit; a smaller limit is not enough for any query.
const SMALLEST: usize = 16 * KB * KB;

const UNITS: [(&str, usize); 8] = [
    ("b", 1),
    ("kb", KB),
    ("mb", KB * KB),
    ("gb", KB * KB * KB),
    ("tb", KB * KB * KB * KB),
    ("kib", 1 << 10),
    ("mib", 1 << 20),
    ("gib", 1 << 30),
];

/// Reads a size such as `1GB`, `500 MB` or `1.5GiB`.
///
/// # Errors
/// Fails if the text is not a size, or if the size is too small.
pub fn size(text: &str) -> Result<usize, String> {
    let text = text.trim();
    let digits = text.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(text.len());
    let unit = text[digits..].trim().to_ascii_lowercase();
    let factor = UNITS.iter().find(|(name, _)| *name == unit).map(|(_, factor)| *factor);
    let bytes = text[..digits].parse::<f64>().ok().zip(factor).map(|(number, factor)| number * factor as f64);
    match bytes {
        Some(bytes) if bytes >= SMALLEST as f64 && bytes < 1e18 => Ok(bytes as usize),
        Some(_) => Err(format!("the value must be at least {}", shown(SMALLEST))),
        None => Err("give a size such as `500MB` or `4GB`".to_owned()),
    }
}

/// A size as text.
pub fn shown(bytes: usize) -> String {
    let of = |unit: usize, name: &str| format!("{} {name}", (bytes as f64 / unit as f64 * 10.0).round() / 10.0);
    if bytes >= KB * KB * KB { of(KB * KB * KB, "GB") } else { of(KB * KB, "MB") }
}

/// The message for a query that needs more memory than `limit` bytes.
pub fn exceeded(limit: usize) -> String {
    format!("the query exceeds its memory limit of {}", shown(limit))
}

/// The fault for a query that needs more memory than `limit` bytes.
pub fn fault(limit: usize) -> Fault {
    Fault::machine(exceeded(limit))
        .help("increase `--memory-limit`, or select fewer rows with WHERE or LIMIT, or fewer columns")
}

/// A quarter of the machine's memory, or of the limit of its control group, within bounds.
pub fn by_default() -> usize {
    let machine = fs::read_to_string("/proc/meminfo").ok().and_then(|t| total(&t));
    let group = fs::read_to_string("/sys/fs/cgroup/memory.max").ok().and_then(|t| t.trim().parse().ok());
    let there = machine.into_iter().chain(group).min();
    there.map_or(LEAST * 4, |bytes: usize| (bytes / 4).clamp(LEAST, MOST))
}

fn total(meminfo: &str) -> Option<usize> {
    let line = meminfo.lines().find_map(|l| l.strip_prefix("MemTotal:"))?;
    line.trim().trim_end_matches("kB").trim().parse::<usize>().ok().map(|kib| kib << 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gold_sizes_are_read() {
        assert_eq!(size("1GB"), Ok(1_000_000_000));
        assert_eq!(size(" 1.5 GiB "), Ok(3 << 29));
        assert_eq!(size("64mb"), Ok(64_000_000));
        for wrong in ["", "GB", "1", "1 XB", "-1GB", "1e9GB", "nan MB", "10", "1KB", "99999999999999TB"] {
            assert!(size(wrong).is_err(), "{wrong}");
        }
        assert_eq!(shown(1_500_000_000), "1.5 GB");
        assert_eq!(shown(64_000_000), "64 MB");
    }

    #[test]
    fn gold_the_default_is_a_quarter_within_bounds() {
        assert_eq!(total("MemTotal:       1000 kB\nMemFree: 1 kB\n"), Some(1_024_000));
        assert!((LEAST..=MOST).contains(&by_default()));
    }
}
