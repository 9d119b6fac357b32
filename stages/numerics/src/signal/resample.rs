//! Resampling from arbitrary times to an even grid of times.
//!
//! Grid times are whole multiples of the step (`k / rate_hz`), from the first such time at or after the first sample to
//! the last one at or before the last sample. They are identical for every sensor and flight, so that tables can be
//! joined on them. Between samples that are more than `max_gap_s` apart, the grid holds NaN. A NaN counts as a missing
//! sample in its column only. Nothing is extrapolated. At a grid time within a millionth of a step of a sample, the
//! result is that sample, unchanged. A series that is already on the grid is therefore bit-identical after resampling.
//!
//! Interpolation to a lower rate aliases all components above half of the new rate to lower frequencies. Such plain
//! interpolation is conventional and the default; [`anti_alias()`] removes these components beforehand.

mod akima;
mod angle;
mod anti_alias;

pub use angle::AngleRange;
pub use anti_alias::{ANTI_ALIAS_FRACTION, ANTI_ALIAS_ORDER, AntiAliasError, anti_alias};

use crate::angle::{unwrapped_deg, wrap_deg};
use crate::signal::segments::{TimeError, check_increasing};
use params::choice;

/// The maximum number of rows of a grid.
pub const MOST_ROWS: usize = 50_000_000;

/// A sample is used unchanged at a grid time within this distance, as a fraction of a step.
const SNAP: f64 = 1e-6;

choice! {
    /// Interpolation between samples.
    #[derive(Default)]
    pub enum SampleInterpolation {
        /// Linear between the previous and the next sample.
        #[default]
        Linear = "linear",
        /// The nearest sample; the earlier of two at equal distance.
        Nearest = "nearest",
        /// Akima's piecewise cubic: smooth, and without the overshoot of a spline. [Akima 1970, "A new
        /// method of interpolation and smooth curve fitting based on local procedures", J. ACM 17(4)]
        Cubic = "cubic",
    }
}

/// Error of resampling.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ResampleError {
    /// The rate is not a positive number.
    #[error("the new sample rate must be above 0 Hz, but is {rate_hz} Hz")]
    Rate {
        /// The given rate, in Hz.
        rate_hz: f64,
    },
    /// The longest gap is negative or not a number.
    #[error("the longest gap to interpolate must be at least 0 s, but is {max_gap_s} s")]
    Gap {
        /// The given gap, in seconds.
        max_gap_s: f64,
    },
    /// Times are not finite or do not increase.
    #[error(transparent)]
    Time(#[from] TimeError),
    /// The grid would be too long.
    #[error(
        "resampling from {first_s} s to {last_s} s at {rate_hz} Hz gives {rows:.0} rows, more than the limit of \
         {MOST_ROWS}; check that the time is in seconds and has no outliers"
    )]
    TooLong {
        /// The first time, in seconds.
        first_s: f64,
        /// The last time, in seconds.
        last_s: f64,
        /// The rate, in Hz.
        rate_hz: f64,
        /// The number of rows that the grid would have.
        rows: f64,
    },
    /// The times are so large that neighbouring grid times would be equal.
    #[error(
        "times near {tt} s cannot be distinguished at {rate_hz} Hz in double precision; count seconds \
         from midnight"
    )]
    TooCoarse {
        /// The largest time, in seconds.
        tt: f64,
        /// The rate, in Hz.
        rate_hz: f64,
    },
    /// A column and the time column have different lengths.
    #[error("a column has {given} rows, but the time has {expected}")]
    Length {
        /// The number of rows of the column.
        given: usize,
        /// The number of rows of the time column.
        expected: usize,
    },
}

/// Position of a grid time among samples: the previous sample, and the fraction of the step to the next.
#[derive(Debug, Clone, Copy, PartialEq)]
struct SamplePosition {
    left: usize,
    /// Fraction of the step; 0 at the sample `left`, NaN in a gap.
    weight: f64,
}

const NOWHERE: SamplePosition = SamplePosition { left: 0, weight: f64::NAN };

/// Position of each time of an even grid among a line's samples. It is computed once per line and applied to each of
/// its columns.
#[derive(Debug, Clone, PartialEq)]
pub struct ResamplePlan<'a> {
    tt: &'a [f64],
    grid: Vec<f64>,
    places: Vec<SamplePosition>,
    max_gap_s: f64,
    snap_s: f64,
}

impl<'a> ResamplePlan<'a> {
    /// Plan for samples at the strictly increasing times `tt` (s), for resampling to `rate_hz`, with interpolation over
    /// gaps of up to `max_gap_s`. Without samples the grid is empty.
    ///
    /// # Errors
    /// Fails for a rate that is not a finite number above 0, a gap limit that is negative or NaN, times that are not
    /// finite or do not increase, times too large to be distinguished at the rate, or more than [`MOST_ROWS`] rows.
    pub fn new(tt: &'a [f64], rate_hz: f64, max_gap_s: f64) -> Result<Self, ResampleError> {
        check(rate_hz, max_gap_s)?;
        check_increasing(tt)?;
        let grid = match (tt.first(), tt.last()) {
            (Some(first_s), Some(last_s)) => even_grid(*first_s, *last_s, rate_hz)?,
            _ => vec![],
        };
        Ok(Self::placed(tt, grid, rate_hz, max_gap_s))
    }

    /// Plan for samples at the strictly increasing times `tt` (s), for resampling to the strictly increasing times
    /// `grid`, which are about 1/`rate_hz` apart, with interpolation over gaps of up to `max_gap_s`. Results are NaN at
    /// grid times before the first sample and after the last, as in a gap.
    ///
    /// # Errors
    /// Returns the errors of [`ResamplePlan::new`].
    pub fn onto(tt: &'a [f64], grid: Vec<f64>, rate_hz: f64, max_gap_s: f64) -> Result<Self, ResampleError> {
        check(rate_hz, max_gap_s)?;
        check_increasing(tt)?;
        check_increasing(&grid)?;
        resolution(largest(tt).max(largest(&grid)), rate_hz)?;
        Ok(Self::placed(tt, grid, rate_hz, max_gap_s))
    }

    fn placed(tt: &'a [f64], grid: Vec<f64>, rate_hz: f64, max_gap_s: f64) -> Self {
        let rounding = rounding(largest(tt));
        let snap_s = (SNAP / rate_hz).max(rounding);
        // A gap of exactly the maximum length is interpolated despite the rounding of its times.
        let max_gap_s = max_gap_s + 2.0 * rounding;
        let places = places(tt, &grid, max_gap_s, snap_s);
        Self { tt, grid, places, max_gap_s, snap_s }
    }

    /// The times of the grid, in seconds.
    pub fn grid(&self) -> &[f64] {
        &self.grid
    }

    /// A column on the grid, in its unit; NaN in gaps.
    ///
    /// # Errors
    /// Fails with [`ResampleError::Length`] if the column and the times have different lengths.
    pub fn column(&self, x: &[f64], method: SampleInterpolation) -> Result<Vec<f64>, ResampleError> {
        self.on_finite(x, |tt, x, places| match method {
            SampleInterpolation::Linear => blend(x, places, |x, y, weight| x + weight * (y - x)),
            SampleInterpolation::Nearest => blend(x, places, |x, y, weight| if weight > 0.5 { y } else { x }),
            SampleInterpolation::Cubic => akima::interpolate(tt, x, places, self.max_gap_s),
        })
    }

    /// A column of angles in degrees on the grid, interpolated along the shorter arc, in the range (−180 to 180 or 0 to
    /// 360) of [`AngleRange::from_degrees`]; NaN in gaps.
    ///
    /// # Errors
    /// Fails with [`ResampleError::Length`] if the column and the times have different lengths.
    pub fn angle_deg(&self, x: &[f64], method: SampleInterpolation) -> Result<Vec<f64>, ResampleError> {
        let range = AngleRange::from_degrees(x);
        self.on_finite(x, |tt, x, places| match method {
            SampleInterpolation::Linear => blend(x, places, |x, y, weight| range.wrap(x + weight * wrap_deg(y - x))),
            SampleInterpolation::Nearest => blend(x, places, |x, y, weight| if weight > 0.5 { y } else { x }),
            SampleInterpolation::Cubic => {
                let turned = akima::interpolate(tt, &unwrapped_deg(x), places, self.max_gap_s);
                turned.into_iter().map(|x| range.wrap(x)).collect()
            }
        })
    }

    /// Row of the nearest sample for each grid time, for columns that are not numeric; the earlier of two samples at
    /// equal distance; `None` in gaps.
    pub fn nearest_rows(&self) -> Vec<Option<usize>> {
        let row = |place: &SamplePosition| {
            let later = usize::from(place.weight > 0.5);
            (!place.weight.is_nan()).then_some(place.left + later)
        };
        self.places.iter().map(row).collect()
    }

    /// Interpolates among the finite samples of a column. Samples that are not finite are skipped, which may create
    /// further gaps.
    fn on_finite(
        &self,
        x: &[f64],
        interpolate: impl Fn(&[f64], &[f64], &[SamplePosition]) -> Vec<f64>,
    ) -> Result<Vec<f64>, ResampleError> {
        if x.len() != self.tt.len() {
            return Err(ResampleError::Length { given: x.len(), expected: self.tt.len() });
        }
        if x.iter().all(|x| x.is_finite()) {
            return Ok(interpolate(self.tt, x, &self.places));
        }
        let pairs = self.tt.iter().zip(x).filter(|(_, x)| x.is_finite());
        let (tt, x): (Vec<f64>, Vec<f64>) = pairs.unzip();
        let places = places(&tt, &self.grid, self.max_gap_s, self.snap_s);
        Ok(interpolate(&tt, &x, &places))
    }
}

fn blend(x: &[f64], places: &[SamplePosition], between: impl Fn(f64, f64, f64) -> f64) -> Vec<f64> {
    let value = |place: &SamplePosition| {
        if place.weight == 0.0 {
            x[place.left]
        } else if place.weight.is_nan() {
            f64::NAN
        } else {
            between(x[place.left], x[place.left + 1], place.weight)
        }
    };
    places.iter().map(value).collect()
}

fn check(rate_hz: f64, max_gap_s: f64) -> Result<(), ResampleError> {
    if !(rate_hz > 0.0 && rate_hz.is_finite()) {
        return Err(ResampleError::Rate { rate_hz });
    }
    if max_gap_s.is_nan() || max_gap_s < 0.0 {
        return Err(ResampleError::Gap { max_gap_s });
    }
    Ok(())
}

fn largest(tt: &[f64]) -> f64 {
    tt.iter().fold(0.0f64, |largest, tt| largest.max(tt.abs()))
}

/// Bound of the rounding error of times up to `largest`, in seconds.
fn rounding(largest: f64) -> f64 {
    4.0 * f64::EPSILON * largest
}

/// Bound of the rounding error of times up to `largest`, in seconds. Fails if this error is not small compared with the
/// step.
fn resolution(largest: f64, rate_hz: f64) -> Result<f64, ResampleError> {
    let rounding = rounding(largest);
    if rounding * rate_hz > 1e-3 {
        return Err(ResampleError::TooCoarse { tt: largest, rate_hz });
    }
    Ok(rounding)
}

/// The times `k / rate_hz` (s, k whole) from `first_s` to `last_s`, inclusive.
///
/// # Errors
/// Fails for a rate that is not a finite number above 0, times that are not finite or too large to be distinguished at
/// the rate, or more than [`MOST_ROWS`] rows.
pub fn even_grid(first_s: f64, last_s: f64, rate_hz: f64) -> Result<Vec<f64>, ResampleError> {
    check(rate_hz, 0.0)?;
    if let Some(row) = [first_s, last_s].iter().position(|tt| !tt.is_finite()) {
        return Err(TimeError::NotFinite { row }.into());
    }
    let snap_s = (SNAP / rate_hz).max(resolution(first_s.abs().max(last_s.abs()), rate_hz)?);
    let rows = ((last_s - first_s) * rate_hz + 1.0).max(0.0);
    if rows > MOST_ROWS as f64 {
        return Err(ResampleError::TooLong { first_s, last_s, rate_hz, rows });
    }
    let time = |k: f64| k / rate_hz;
    let start = (first_s * rate_hz).floor() - 1.0;
    let steps = (0..rows as usize + 4).map(|step| time(start + step as f64));
    let inside = steps.filter(|tt| *tt >= first_s - snap_s && *tt <= last_s + snap_s);
    Ok(inside.collect())
}

/// The position of each grid time among the times `tt`. Grid times and `tt` increase.
fn places(tt: &[f64], grid: &[f64], max_gap_s: f64, snap_s: f64) -> Vec<SamplePosition> {
    let mut left = 0;
    let mut place = |time: f64| {
        while left + 1 < tt.len() && tt[left + 1] <= time + snap_s {
            left += 1;
        }
        let before = *tt.get(left)?;
        if (time - before).abs() <= snap_s {
            return Some(SamplePosition { left, weight: 0.0 });
        }
        let after = *tt.get(left + 1)?;
        let bridged = time > before && after - before <= max_gap_s;
        bridged.then(|| SamplePosition { left, weight: (time - before) / (after - before) })
    };
    grid.iter().map(|time| place(*time).unwrap_or(NOWHERE)).collect()
}

#[cfg(test)]
mod tests;
