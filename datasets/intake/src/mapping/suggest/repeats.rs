//! Rows that repeat the time of the previous row: copies, or samples between times of a coarse resolution.

use numerics::regression::statistics::median;

use super::sample::ColumnSample;

/// Rows that repeat the time of the previous row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RepeatedTimes {
    /// None.
    None,
    /// Some rows are copies, or are too irregular to have a rate.
    Some,
    /// Samples at this rate, in Hz, with times of a coarse resolution.
    AtRate(f64),
}

/// The rows have a rate only if the largest number of rows per time is at most this many times the median number.
const EVEN: f64 = 1.25;

impl RepeatedTimes {
    /// Classifies the rows that repeat a time, from the times of all rows, in seconds, and the columns with these rows.
    pub fn new(times_s: &[f64], columns: &[ColumnSample]) -> RepeatedTimes {
        let repeated: Vec<usize> = (1..times_s.len()).filter(|row| times_s[*row] == times_s[*row - 1]).collect();
        if repeated.is_empty() {
            return RepeatedTimes::None;
        }
        let changes = |column: &ColumnSample| {
            let value = |row: usize| column.values.get(row).copied().unwrap_or(f64::NAN);
            let changed = repeated.iter().filter(|row| (value(**row) - value(**row - 1)).abs() > 0.0).count();
            changed * 2 > repeated.len()
        };
        match rate_hz(times_s).filter(|_| columns.iter().any(changes)) {
            Some(rate_hz) => RepeatedTimes::AtRate(rate_hz),
            None => RepeatedTimes::Some,
        }
    }
}

/// Lowest rate, in Hz, at which all rows with one time come before the next time; `None` if the numbers of rows per
/// time differ too much. The first and the last time may have fewer rows.
fn rate_hz(times_s: &[f64]) -> Option<f64> {
    let mut runs: Vec<(f64, f64)> = vec![];
    for time in times_s {
        match runs.last_mut() {
            Some((last, rows)) if last == time => *rows += 1.0,
            _ => runs.push((*time, 1.0)),
        }
    }
    let mut counts: Vec<f64> = runs.get(1..runs.len().checked_sub(1)?)?.iter().map(|(_, rows)| *rows).collect();
    let mut steps: Vec<f64> = runs.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    let most = counts.iter().copied().fold(0.0, f64::max);
    if counts.len() < 3 || steps.iter().any(|step| *step <= 0.0) {
        return None;
    }
    let (usual, step) = (median(&mut counts), median(&mut steps));
    (usual >= 2.0 && most <= EVEN * usual).then(|| most / step)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Times of rows at a given rate from a given start, rounded down to whole seconds.
    fn coarse(rate_hz: f64, start_s: f64, rows: usize) -> Vec<f64> {
        (0..rows).map(|row| (start_s + row as f64 / rate_hz).floor()).collect()
    }

    fn column(value: impl Fn(usize) -> f64) -> [ColumnSample; 1] {
        [ColumnSample { values: (0..1000).map(value).collect(), ..ColumnSample::default() }]
    }

    #[test]
    fn unit_samples_between_coarse_times_have_a_rate() {
        let rows = column(|row| row as f64);
        for (rate_hz, found_hz) in [(10.0, 10.0), (20.0, 20.0), (10.4, 11.0)] {
            let times = coarse(rate_hz, 7.35, 400);
            assert_eq!(RepeatedTimes::new(&times, &rows), RepeatedTimes::AtRate(found_hz), "{rate_hz}");
        }
        let even: Vec<f64> = (0..400).map(|row| row as f64 * 0.1).collect();
        assert_eq!(RepeatedTimes::new(&even, &rows), RepeatedTimes::None);
    }

    #[test]
    fn unit_copies_and_irregular_rows_have_no_rate() {
        let times = coarse(10.0, 0.0, 400);
        assert_eq!(RepeatedTimes::new(&times, &column(|row| (row / 10) as f64)), RepeatedTimes::Some);
        let mut rare: Vec<f64> = (0..400).map(|row| row as f64 * 0.1).collect();
        rare[50] = rare[49];
        assert_eq!(RepeatedTimes::new(&rare, &column(|row| row as f64)), RepeatedTimes::Some);
        let jump: Vec<f64> = times.iter().enumerate().map(|(row, t)| if row > 200 { t - 15.0 } else { *t }).collect();
        assert_eq!(RepeatedTimes::new(&jump, &column(|row| row as f64)), RepeatedTimes::Some);
    }
}
