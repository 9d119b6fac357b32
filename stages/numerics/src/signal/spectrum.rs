//! Power spectral density by Welch's method.

use std::f64::consts::TAU;

use rustfft::{FftPlanner, num_complex::Complex};

/// Taper of each segment; both tapers are periodic (suited to a spectrum, not symmetric).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SpectralTaper {
    /// ½ − ½ cos: falls to zero; low leakage to distant frequencies.
    #[default]
    Hann,
    /// 0.54 − 0.46 cos: lower leakage to nearby frequencies.
    Hamming,
}

impl SpectralTaper {
    fn values(self, n: usize) -> Vec<f64> {
        let constant = match self {
            Self::Hann => 0.5,
            Self::Hamming => 0.54,
        };
        let cosine = |k: usize| (TAU * k as f64 / n as f64).cos();
        (0..n).map(|k| constant - (1.0 - constant) * cosine(k)).collect()
    }
}

/// Error of a spectrum.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SpectrumError {
    /// The sample rate is not a positive number.
    #[error("the sample rate must be above 0 Hz, but is {rate_hz} Hz")]
    Rate {
        /// The given rate, in Hz.
        rate_hz: f64,
    },
    /// A segment of fewer than two samples.
    #[error("a segment must have at least 2 samples, but has {segment}")]
    Segment {
        /// The requested number of samples.
        segment: usize,
    },
    /// There is no segment of this length without gaps.
    #[error("the {rows} samples have no {segment} consecutive finite samples; use shorter segments")]
    TooShort {
        /// The number of samples of the series.
        rows: usize,
        /// The number of samples of a segment.
        segment: usize,
    },
}

/// A one-sided power spectral density.
#[derive(Debug, Clone, PartialEq)]
pub struct PowerSpectrum {
    /// Frequencies from 0 to half of the sample rate, in Hz.
    pub frequency_hz: Vec<f64>,
    /// Power density at each frequency, in the squared unit of the samples per Hz.
    pub density: Vec<f64>,
    /// The number of segments that were averaged.
    pub segments: usize,
    /// Number of segments that are excluded because they contain a sample that is not finite.
    pub left_out: usize,
}

/// Power spectral density of `x`, evenly sampled at `rate_hz`: the mean of the periodograms of segments. Segments have
/// `segment` samples and overlap by half; each is tapered after subtraction of its mean. [Welch 1967, IEEE Trans. Audio
/// Electroacoust. 15(2)]
///
/// The integral over frequency is the variance, as with scipy's `welch`. Segments with a value that is not finite are
/// excluded and counted. Results may differ in the last bits between processors, because the transform uses the widest
/// available vectors.
///
/// # Errors
/// Fails with [`SpectrumError::Rate`] for a rate that is not a finite number above 0, with [`SpectrumError::Segment`]
/// for segments of fewer than two samples, or with [`SpectrumError::TooShort`] if no segment is completely finite.
pub fn welch(x: &[f64], rate_hz: f64, segment: usize, window: SpectralTaper) -> Result<PowerSpectrum, SpectrumError> {
    if !(rate_hz > 0.0 && rate_hz.is_finite()) {
        return Err(SpectrumError::Rate { rate_hz });
    }
    if segment < 2 {
        return Err(SpectrumError::Segment { segment });
    }
    let taper = window.values(segment);
    let fft = FftPlanner::new().plan_fft_forward(segment);
    let bins = segment / 2 + 1;
    let mut density = vec![0.0; bins];
    let (mut segments, mut left_out) = (0usize, 0);
    for part in x.windows(segment).step_by(segment - segment / 2) {
        let mean = part.iter().sum::<f64>() / segment as f64;
        if !mean.is_finite() {
            left_out += 1;
            continue;
        }
        let tapered = part.iter().zip(&taper).map(|(x, w)| Complex::new((x - mean) * w, 0.0));
        let mut buffer: Vec<Complex<f64>> = tapered.collect();
        fft.process(&mut buffer);
        for (density, bin) in density.iter_mut().zip(&buffer) {
            *density += bin.norm_sqr();
        }
        segments += 1;
    }
    if segments == 0 {
        return Err(SpectrumError::TooShort { rows: x.len(), segment });
    }
    let power: f64 = taper.iter().map(|w| w * w).sum();
    let scale = 1.0 / (rate_hz * power * segments as f64);
    for (bin, density) in density.iter_mut().enumerate() {
        // Every bin represents a positive and a negative frequency, except 0 Hz and, for an even number of samples, the
        // Nyquist frequency.
        let sides = if bin == 0 || 2 * bin == segment { 1.0 } else { 2.0 };
        *density *= sides * scale;
    }
    let frequency_hz = (0..bins).map(|bin| bin as f64 * rate_hz / segment as f64).collect();
    Ok(PowerSpectrum { frequency_hz, density, segments, left_out })
}

#[cfg(test)]
mod tests;
