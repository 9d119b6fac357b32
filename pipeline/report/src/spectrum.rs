//! Amplitude spectral density of a column of a line, from all its samples.

use numerics::signal::{
    segments::{GAP_STEPS, STEP_TOLERANCE, TimeError, sample_rate},
    spectrum::{SpectralTaper, welch},
};

/// Maximum number of samples of a segment, as an exponent of 2.
const LARGEST: u32 = 12;

/// Amplitude spectral densities of columns with the same times.
#[derive(Debug, Clone, PartialEq)]
pub struct AmplitudeSpectrum {
    /// Sample rate, in Hz.
    pub rate_hz: f64,
    /// Number of samples of a segment.
    pub segment: usize,
    /// Frequencies above zero, in Hz.
    pub frequency_hz: Vec<f64>,
    /// The columns.
    pub columns: Vec<ColumnSpectrum>,
}

/// Amplitude spectral density of one column.
#[derive(Debug, Clone, PartialEq)]
pub struct ColumnSpectrum {
    /// Density at each frequency, unit of the column per √Hz; empty without a segment, and for a constant column.
    pub density: Vec<f64>,
    /// Number of averaged segments.
    pub segments: usize,
    /// Number of segments excluded because of a missing sample or a gap.
    pub left_out: usize,
    /// Reason why there is no density.
    pub why: Option<String>,
}

/// Number of samples of a segment of Welch's method for `rows` samples: a power of two, at most a quarter of the rows
/// and at most 4096.
pub fn segment_length(rows: usize) -> usize {
    1 << (rows / 4).max(2).ilog2().min(LARGEST)
}

/// Welch's method with a Hann taper, half overlap and segments without gaps, for columns with the times `tt` in
/// seconds.
///
/// # Errors
/// Fails for times that are not increasing or not evenly spaced.
pub fn amplitude_spectrum(tt: &[f64], columns: &[&[f64]]) -> Result<AmplitudeSpectrum, TimeError> {
    let rate_hz = sample_rate(tt, STEP_TOLERANCE)?;
    let segment = segment_length(tt.len());
    let frequency_hz = (1..=segment / 2).map(|bin| bin as f64 * rate_hz / segment as f64).collect();
    let columns = columns.iter().map(|values| density(&gapped(tt, values, rate_hz), rate_hz, segment)).collect();
    Ok(AmplitudeSpectrum { rate_hz, segment, frequency_hz, columns })
}

fn density(values: &[f64], rate_hz: f64, segment: usize) -> ColumnSpectrum {
    let none = |why: String| ColumnSpectrum { density: vec![], segments: 0, left_out: 0, why: Some(why) };
    let mut finite = values.iter().filter(|v| v.is_finite());
    let first = finite.next();
    if finite.all(|v| Some(v) == first) {
        return none("the column does not vary".to_owned());
    }
    match welch(values, rate_hz, segment, SpectralTaper::Hann) {
        Ok(found) => ColumnSpectrum {
            density: found.density.iter().skip(1).map(|d| d.sqrt()).collect(),
            segments: found.segments,
            left_out: found.left_out,
            why: None,
        },
        Err(_) => none(format!("no {segment} consecutive samples are present")),
    }
}

/// Copy of the values with NaN inserted at each gap in the times, so that no segment spans a gap.
pub fn gapped(tt: &[f64], values: &[f64], rate_hz: f64) -> Vec<f64> {
    let mut out = Vec::with_capacity(values.len());
    for (row, value) in values.iter().enumerate() {
        if row > 0 && (tt[row] - tt[row - 1]) * rate_hz >= GAP_STEPS {
            out.push(f64::NAN);
        }
        out.push(*value);
    }
    out
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::f64::consts::TAU;

    use super::*;

    fn times(rows: u32) -> Vec<f64> {
        (0..rows).map(|k| 45_000.0 + f64::from(k) / 10.0).collect()
    }

    #[test]
    fn law_a_sine_has_its_power_in_its_bin() {
        let tt = times(4096);
        // 32 periods in a segment of 1024 samples, amplitude 3: variance 4.5.
        let x: Vec<f64> = (0..4096).map(|k| 50_000.0 + 3.0 * (TAU * 32.0 * f64::from(k) / 1024.0).sin()).collect();
        let found = amplitude_spectrum(&tt, &[&x]).unwrap();
        assert_eq!((found.rate_hz, found.segment, found.frequency_hz.len()), (10.0, 1024, 512));
        let one = &found.columns[0];
        let peak = (0..512).max_by(|a, b| one.density[*a].total_cmp(&one.density[*b])).unwrap();
        assert_eq!(found.frequency_hz[peak], 0.3125);
        let power: f64 = one.density.iter().map(|d| d * d * found.rate_hz / 1024.0).sum();
        assert!((power - 4.5).abs() < 1e-6, "{power}");
    }

    #[test]
    fn bug_no_segment_spans_a_gap() {
        let mut tt = times(800);
        let x: Vec<f64> = (0..800).map(|k| (TAU * f64::from(k) / 20.0).sin()).collect();
        let whole = amplitude_spectrum(&tt, &[&x]).unwrap();
        assert_eq!(whole.columns[0].left_out, 0);
        tt[400..].iter_mut().for_each(|t| *t += 100.0);
        let found = amplitude_spectrum(&tt, &[&x]).unwrap();
        // Segments have 128 samples and overlap by half, so two segments contain the gap.
        assert_eq!((found.segment, found.columns[0].left_out), (128, 2));
        assert_eq!(gapped(&[0.0, 0.1, 0.4], &[1.0, 2.0, 3.0], 10.0)[1..2], [2.0]);
        assert!(gapped(&[0.0, 0.1, 0.4], &[1.0, 2.0, 3.0], 10.0)[2].is_nan());
    }

    #[test]
    fn unit_constant_missing_and_uneven_columns_have_no_spectrum() {
        let tt = times(100);
        let (same, missing, varies) = (vec![5.0; 100], vec![f64::NAN; 100], tt.clone());
        let found = amplitude_spectrum(&tt, &[&same, &missing, &varies]).unwrap();
        assert!(found.columns[0].density.is_empty() && found.columns[1].density.is_empty());
        assert_eq!(found.columns[2].density.len(), found.frequency_hz.len());
        let mut uneven = tt.clone();
        uneven[50] += 0.03;
        assert!(amplitude_spectrum(&uneven, &[&same]).unwrap_err().to_string().contains("evenly"));
        assert!(amplitude_spectrum(&[], &[]).is_err());
        assert_eq!([0, 7, 8, 400, 1 << 20].map(segment_length), [2, 2, 2, 64, 4096]);
    }
}
