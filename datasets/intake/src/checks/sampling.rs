//! The sampling rate of a line, and irregularities of its time stamps.

use numerics::regression::statistics::median;

use super::SampleTally;

/// Sampling of a line's time stamps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeStampFigures {
    /// Reciprocal of the median step.
    pub rate_hz: f64,
    /// The robust standard deviation of the steps: 1.4826 times the median absolute deviation from the median step.
    pub jitter_s: f64,
    /// Steps longer than [`GAP`] medians, each with the row after it.
    pub gaps: SampleTally,
    /// Total time missing in the gaps.
    pub missing_s: f64,
    /// Time missing in the longest gap.
    pub longest_gap_s: f64,
    /// Rows that repeat the time of the previous row.
    pub repeated: SampleTally,
    /// Rows with an earlier time than the previous row.
    pub backward: SampleTally,
    /// The largest step back.
    pub worst_step_back_s: f64,
    /// Midnights within the line.
    pub midnights: SampleTally,
}

/// Minimum length of a gap in median steps. One lost sample gives a step of twice the median.
const GAP: f64 = 1.75;

/// The sampling of time stamps; `None` for fewer than three samples.
pub fn sampling(tt: &[f64]) -> Option<TimeStampFigures> {
    let mut forward: Vec<f64> = tt.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0.0).collect();
    if forward.len() < 2 {
        return None;
    }
    let step = median(&mut forward);
    let mut off: Vec<f64> = forward.iter().map(|d| (d - step).abs()).collect();
    let mut out = TimeStampFigures {
        rate_hz: 1.0 / step,
        jitter_s: 1.4826 * median(&mut off),
        gaps: SampleTally::default(),
        missing_s: 0.0,
        longest_gap_s: 0.0,
        repeated: SampleTally::default(),
        backward: SampleTally::default(),
        worst_step_back_s: 0.0,
        midnights: SampleTally::default(),
    };
    for (i, w) in tt.windows(2).enumerate() {
        let d = w[1] - w[0];
        if d == 0.0 {
            out.repeated.add(i + 1);
        } else if d < 0.0 {
            out.backward.add(i + 1);
            out.worst_step_back_s = out.worst_step_back_s.max(-d);
        } else if d > GAP * step {
            out.gaps.add(i + 1);
            out.missing_s += d - step;
            out.longest_gap_s = out.longest_gap_s.max(d - step);
        }
        if (w[1] / 86_400.0).floor() > (w[0] / 86_400.0).floor() {
            out.midnights.add(i + 1);
        }
    }
    Some(out)
}

/// Whether each row follows a gap or a jump of the clock.
pub fn breaks(tt: &[f64]) -> Vec<bool> {
    let mut forward: Vec<f64> = tt.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0.0).collect();
    let step = if forward.is_empty() { f64::INFINITY } else { median(&mut forward) };
    let before = |i: usize| i > 0 && !(0.0..=GAP * step).contains(&(tt[i] - tt[i - 1]));
    (0..tt.len()).map(before).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_even_samples_have_no_jitter_and_no_gaps() {
        let tt: Vec<f64> = (0..1000).map(|i| 40_000.0 + f64::from(i) / 8.0).collect();
        let found = sampling(&tt).unwrap();
        assert_eq!((found.rate_hz, found.jitter_s, found.gaps.n, found.midnights.n), (8.0, 0.0, 0, 0));
        assert!(breaks(&tt).iter().all(|b| !b));
        assert!(sampling(&[1.0, 2.0]).is_none());
    }

    #[test]
    fn unit_gaps_and_jumps_are_found() {
        // 100 Hz over midnight, with 3 samples lost at one place and 50 samples at another, one repeated time stamp,
        // and one backward step of the clock.
        let all: Vec<f64> = (0..1000).map(|i| 86_399.0 + f64::from(i) / 100.0).collect();
        let mut tt: Vec<f64> = [&all[..200], &all[203..500], &all[550..]].concat();
        tt.insert(10, tt[10]);
        let found = sampling(&tt).unwrap();
        assert!((found.rate_hz - 100.0).abs() < 1e-6);
        assert!((found.missing_s - 0.53).abs() < 1e-6 && (found.longest_gap_s - 0.5).abs() < 1e-6, "{found:?}");
        assert_eq!((found.gaps.n, found.gaps.first), (2, Some(201)));
        assert_eq!((found.repeated.n, found.repeated.first), (1, Some(11)));
        assert_eq!((found.midnights.n, found.midnights.first), (1, Some(101)));
        let back: Vec<f64> = tt.iter().enumerate().map(|(i, t)| if i < 600 { *t } else { t - 2.5 }).collect();
        let found = sampling(&back).unwrap();
        assert!(found.backward.n == 1 && found.backward.first == Some(600), "{found:?}");
        assert!((found.worst_step_back_s - 2.49).abs() < 1e-6);
        assert!(breaks(&back)[600] && breaks(&back)[201] && !breaks(&back)[599]);
    }

    #[test]
    fn law_the_jitter_is_the_deviation_of_the_steps() {
        // The steps are alternately 2 ms longer and 2 ms shorter than 1 s, so their distance from the median is 2 ms.
        let mut t = 0.0;
        let tt: Vec<f64> = (0..2001)
            .map(|i| {
                t += if i % 2 == 0 { 1.002 } else { 0.998 };
                t
            })
            .collect();
        let found = sampling(&tt).unwrap();
        assert!(
            (found.jitter_s - 1.4826 * 0.004).abs() < 1e-9 || (found.jitter_s - 1.4826 * 0.002).abs() < 1e-9,
            "{found:?}"
        );
    }
}
