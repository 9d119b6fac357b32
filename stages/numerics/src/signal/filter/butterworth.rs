//! Butterworth filters as second-order sections, by the bilinear transform with prewarped corners.

use std::f64::consts::PI;

use rustfft::num_complex::Complex64;

use super::FilterError;

/// The pass band of a filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FilterBand {
    /// Low-pass: all frequencies below `high_hz`.
    Low {
        /// The corner, in Hz.
        high_hz: f64,
    },
    /// High-pass: all frequencies above `low_hz`.
    High {
        /// The corner, in Hz.
        low_hz: f64,
    },
    /// Band-pass: all frequencies between `low_hz` and `high_hz`.
    Band {
        /// The lower corner, in Hz.
        low_hz: f64,
        /// The upper corner, in Hz.
        high_hz: f64,
    },
}

impl FilterBand {
    /// Pass band between two corners, each of which may be `None`.
    ///
    /// MagNav.jl drops a corner whose frequency is zero, negative or not below Nyquist. Here only `None` drops a
    /// corner, and the design rejects such a frequency.
    ///
    /// # Errors
    /// Fails with [`FilterError::NoCorner`] if both are `None`.
    pub fn between(low_hz: Option<f64>, high_hz: Option<f64>) -> Result<Self, FilterError> {
        match (low_hz, high_hz) {
            (Some(low_hz), Some(high_hz)) => Ok(Self::Band { low_hz, high_hz }),
            (Some(low_hz), None) => Ok(Self::High { low_hz }),
            (None, Some(high_hz)) => Ok(Self::Low { high_hz }),
            (None, None) => Err(FilterError::NoCorner),
        }
    }
}

impl std::fmt::Display for FilterBand {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Low { high_hz } => write!(f, "below {high_hz} Hz"),
            Self::High { low_hz } => write!(f, "above {low_hz} Hz"),
            Self::Band { low_hz, high_hz } => write!(f, "{low_hz} to {high_hz} Hz"),
        }
    }
}

/// One second-order section, H(z) = (1 + b1 z⁻¹ + b2 z⁻²) / (1 + a1 z⁻¹ + a2 z⁻²).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BiquadSection {
    /// Numerator, one sample ago.
    pub b1: f64,
    /// Numerator, two samples ago.
    pub b2: f64,
    /// Denominator, one sample ago.
    pub a1: f64,
    /// Denominator, two samples ago.
    pub a2: f64,
}

impl BiquadSection {
    /// Section that leaves its input unchanged.
    pub(super) const PASS: Self = Self { b1: 0.0, b2: 0.0, a1: 0.0, a2: 0.0 };

    /// Whether the numerator is 1 − z⁻², as for a band-pass.
    pub(super) fn is_band(&self) -> bool {
        self.b1 == 0.0 && self.b2 == -1.0
    }

    /// Response to a constant input of 1.
    pub(super) fn constant_gain(&self) -> f64 {
        (1.0 + self.b1 + self.b2) / (1.0 + self.a1 + self.a2)
    }
}

/// Square root with a real part of at least zero, computed without the angle of `z`.
fn square_root(z: Complex64) -> Complex64 {
    let norm = z.norm();
    let re = ((norm + z.re) / 2.0).max(0.0).sqrt();
    let im = ((norm - z.re) / 2.0).max(0.0).sqrt();
    Complex64::new(re, im.copysign(z.im))
}

/// Analogue poles of one section: a conjugate pair, represented by the pole in the upper half plane, or real poles.
enum SectionPoles {
    Pair(Complex64),
    Real(f64, f64),
    Single(f64),
}

/// Gain and sections of a Butterworth filter, with the poles nearest the origin first.
pub(super) fn design(band: FilterBand, rate_hz: f64, order: usize) -> Result<(f64, Vec<BiquadSection>), FilterError> {
    check(band, rate_hz, order)?;
    // Bilinear transform s = 2 f (z - 1)/(z + 1) with f = 1/2. A corner frequency becomes tan(π corner / rate).
    let warp = |corner_hz: f64| (PI * corner_hz / rate_hz).tan();
    let poles = match band {
        FilterBand::Low { high_hz } => low_pass(order, warp(high_hz)),
        FilterBand::High { low_hz } => high_pass(order, warp(low_hz)),
        FilterBand::Band { low_hz, high_hz } => band_pass(order, warp(low_hz), warp(high_hz)),
    };
    let mut sections: Vec<(f64, BiquadSection)> = poles.iter().map(|poles| section(poles, band)).collect();
    sections.sort_by(|(_, one), (_, other)| one.a2.total_cmp(&other.a2));
    let gain = sections.iter().fold(1.0, |gain, (factor, _)| gain * factor) * analogue_gain(band, order, &warp);
    let sections: Vec<BiquadSection> = sections.into_iter().map(|(_, section)| section).collect();
    if gain > 0.0 && gain.is_finite() && sections.iter().all(stable) {
        return Ok((gain, sections));
    }
    Err(FilterError::Unstable { order, band: band.to_string(), rate_hz })
}

fn check(band: FilterBand, rate_hz: f64, order: usize) -> Result<(), FilterError> {
    if !(rate_hz > 0.0 && rate_hz.is_finite()) {
        return Err(FilterError::Rate { rate_hz });
    }
    if !(1..=12).contains(&order) {
        return Err(FilterError::Order { order });
    }
    let corners = match band {
        FilterBand::Low { high_hz } => vec![high_hz],
        FilterBand::High { low_hz } => vec![low_hz],
        FilterBand::Band { low_hz, high_hz } => vec![low_hz, high_hz],
    };
    for &corner_hz in &corners {
        if corner_hz.is_nan() || corner_hz <= 0.0 {
            return Err(FilterError::CornerNotPositive { corner_hz });
        }
        if corner_hz >= rate_hz / 2.0 {
            return Err(FilterError::CornerAboveNyquist { corner_hz, nyquist_hz: rate_hz / 2.0, rate_hz });
        }
    }
    match band {
        FilterBand::Band { low_hz, high_hz } if low_hz >= high_hz => {
            Err(FilterError::CornersCrossed { low_hz, high_hz })
        }
        _ => Ok(()),
    }
}

/// Poles of the prototype with a corner frequency of 1: exp(iπ(2k + n + 1)/2n), in the upper half plane.
fn prototype(order: usize) -> impl Iterator<Item = Complex64> {
    (0..order / 2).map(move |k| {
        let angle = PI * (2 * k + order + 1) as f64 / (2 * order) as f64;
        Complex64::new(angle.cos(), angle.sin())
    })
}

fn low_pass(order: usize, corner: f64) -> Vec<SectionPoles> {
    let pairs = prototype(order).map(|pole| SectionPoles::Pair(pole * corner));
    let single = (order % 2 == 1).then_some(SectionPoles::Single(-corner));
    pairs.chain(single).collect()
}

fn high_pass(order: usize, corner: f64) -> Vec<SectionPoles> {
    let pairs = prototype(order).map(|pole| SectionPoles::Pair(pole.inv() * corner));
    let single = (order % 2 == 1).then_some(SectionPoles::Single(-corner));
    pairs.chain(single).collect()
}

/// Each prototype pole p becomes the two roots of s² − p w s + c² with w = high − low and c² = low·high.
fn band_pass(order: usize, low: f64, high: f64) -> Vec<SectionPoles> {
    let (half, square) = ((high - low) / 2.0, low * high);
    let mut poles = Vec::with_capacity(order);
    for pole in prototype(order) {
        let middle = pole * half;
        let root = square_root(middle * middle - square);
        poles.push(SectionPoles::Pair(middle + root));
        poles.push(SectionPoles::Pair(middle - root));
    }
    if order % 2 == 1 {
        let under = half * half - square;
        poles.push(if under < 0.0 {
            SectionPoles::Pair(Complex64::new(-half, (-under).sqrt()))
        } else {
            SectionPoles::Real(-half - under.sqrt(), -half + under.sqrt())
        });
    }
    poles
}

/// Factor 1/Π(1 − s) of the analogue poles s, and their digital section, by z = (1 + s)/(1 − s).
fn section(poles: &SectionPoles, band: FilterBand) -> (f64, BiquadSection) {
    let (b1, b2) = match (band, poles) {
        (FilterBand::Low { .. }, SectionPoles::Single(_)) => (1.0, 0.0),
        (FilterBand::High { .. }, SectionPoles::Single(_)) => (-1.0, 0.0),
        (FilterBand::Low { .. }, _) => (2.0, 1.0),
        (FilterBand::High { .. }, _) => (-2.0, 1.0),
        // Each section has a zero at 0 Hz and a zero at the Nyquist frequency, so the first section removes a constant.
        (FilterBand::Band { .. }, _) => (0.0, -1.0),
    };
    let (factor, a1, a2) = match *poles {
        SectionPoles::Pair(s) => quadratic(2.0 * s.re, s.re * s.re + s.im * s.im),
        SectionPoles::Real(one, other) => quadratic(one + other, one * other),
        SectionPoles::Single(s) => (1.0 / (1.0 - s), -(1.0 + s) / (1.0 - s), 0.0),
    };
    (factor, BiquadSection { b1, b2, a1, a2 })
}

/// 1/((1−s1)(1−s2)), a1 and a2 for poles with the given sum and product.
fn quadratic(sum: f64, product: f64) -> (f64, f64, f64) {
    let denominator = 1.0 - sum + product;
    (1.0 / denominator, -2.0 * (1.0 - product) / denominator, (1.0 + sum + product) / denominator)
}

/// Gain without the factor Π 1/(1 − s): the analogue gain times Π(1 − zeros).
fn analogue_gain(band: FilterBand, order: usize, warp: &impl Fn(f64) -> f64) -> f64 {
    let width = match band {
        FilterBand::Low { high_hz } => warp(high_hz),
        FilterBand::High { .. } => 1.0,
        FilterBand::Band { low_hz, high_hz } => warp(high_hz) - warp(low_hz),
    };
    width.powi(order as i32)
}

/// Whether both poles are inside the unit circle, by the stability triangle.
fn stable(section: &BiquadSection) -> bool {
    section.a2.abs() < 1.0 && section.a1.abs() < 1.0 + section.a2
}
