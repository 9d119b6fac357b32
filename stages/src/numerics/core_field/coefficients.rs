//! The Gauss coefficients: read from the embedded file, interpolated in time, differentiated.

use thiserror::Error;

/// Degree and order of IGRF.
pub(super) const DEGREE: usize = 13;
/// Length of a coefficient vector: cosine and sine of all orders up to two degrees past the model.
pub(super) const TERMS: usize = (DEGREE + 3) * (DEGREE + 4);
/// The reference radius of the Gauss coefficients, in metres.
pub(super) const REFERENCE_RADIUS_M: f64 = 6_371_200.0;

const FILE: &str = include_str!("IGRF14.shc");

/// Why there is no core field.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CoreFieldError {
    /// The date is outside the model's years.
    #[error("the core field is asked for the year {decimal_year}; IGRF-14 covers {first} to {last}")]
    Date {
        /// The date asked for.
        decimal_year: f64,
        /// The model's first year.
        first: f64,
        /// The model's last year.
        last: f64,
    },
    /// The embedded coefficient file is damaged.
    #[error("the coefficient file of IGRF-14 is damaged in line {0}")]
    Coefficients(usize),
}

/// Position of degree `n` and order `m` in a triangle stored by rows.
pub(super) const fn index(n: usize, m: usize) -> usize {
    n * (n + 1) / 2 + m
}

/// The coefficients of the potential (divided by the reference radius, in nT) at a date, for
/// harmonics that are not normalised; cosine and sine interleaved.
pub(super) fn gauss_coefficients(decimal_year: f64) -> Result<Box<[f64; TERMS]>, CoreFieldError> {
    let mut lines = FILE.lines().enumerate().filter(|(_, line)| !line.starts_with('#')).skip(1);
    let (epoch_line, epochs) = lines.next().ok_or(CoreFieldError::Coefficients(0))?;
    let epochs = numbers(epochs).ok_or(CoreFieldError::Coefficients(epoch_line + 1))?;
    let (before, fraction) = bracket(&epochs, decimal_year)?;
    let mut potential = Box::new([0.0; TERMS]);
    for (number, line) in lines {
        let damaged = CoreFieldError::Coefficients(number + 1);
        let (place, factor, values) = entry(line).ok_or(damaged.clone())?;
        let (Some(early), Some(late)) = (values.get(before), values.get(before + 1)) else {
            return Err(damaged);
        };
        potential[place] = factor * (early + fraction * (late - early));
    }
    Ok(potential)
}

/// The epoch before a date and how far the date is towards the next.
fn bracket(epochs: &[f64], decimal_year: f64) -> Result<(usize, f64), CoreFieldError> {
    let (Some(first), Some(last)) = (epochs.first(), epochs.last()) else {
        return Err(CoreFieldError::Coefficients(0));
    };
    if !(*first..=*last).contains(&decimal_year) {
        return Err(CoreFieldError::Date { decimal_year, first: *first, last: *last });
    }
    let before = epochs.partition_point(|epoch| *epoch <= decimal_year);
    let before = before.saturating_sub(1).min(epochs.len().saturating_sub(2));
    match epochs.get(before..before + 2) {
        Some([early, late]) => Ok((before, (decimal_year - early) / (late - early))),
        _ => Err(CoreFieldError::Coefficients(0)),
    }
}

fn numbers(line: &str) -> Option<Vec<f64>> {
    line.split_whitespace().map(|word| word.parse().ok()).collect()
}

/// One line of the file: place in the vector, factor of normalisation, values by epoch.
fn entry(line: &str) -> Option<(usize, f64, Vec<f64>)> {
    let mut words = line.split_whitespace();
    let degree: usize = words.next()?.parse().ok()?;
    let signed_order: i32 = words.next()?.parse().ok()?;
    let order = usize::try_from(signed_order.unsigned_abs()).ok()?;
    if degree > DEGREE || order > degree {
        return None;
    }
    let values: Option<Vec<f64>> = words.map(|word| word.parse().ok()).collect();
    let place = 2 * index(degree, order) + usize::from(signed_order < 0);
    Some((place, schmidt_factor(degree, order), values?))
}

/// What turns a Legendre function into a Schmidt semi-normalised one:
/// sqrt(2 (n-m)! / (n+m)!), 1 for order zero.
fn schmidt_factor(n: usize, m: usize) -> f64 {
    if m == 0 {
        return 1.0;
    }
    let falling: f64 = (n - m + 1..=n + m).map(|k| k as f64).product();
    (2.0 / falling).sqrt()
}

/// The coefficients of `scale` times the derivative of a potential along the earth-centred axis
/// 0, 1 or 2 (x, y, z), position being counted in reference radii.
/// [Montenbruck & Gill, Satellite Orbits, (3.33)]
pub(super) fn derivative(of: &[f64; TERMS], axis: usize, scale: f64) -> Box<[f64; TERMS]> {
    let mut out = Box::new([0.0; TERMS]);
    for n in 0..=DEGREE + 1 {
        for m in 0..=n {
            let here = 2 * index(n, m);
            // The sine of order zero is no function: what a derivative leaves there is dropped.
            let sine = if m == 0 { 0.0 } else { of[here + 1] };
            let (c, s) = (scale * of[here], scale * sine);
            if axis == 2 {
                add_axial(&mut out, n, m, c, s);
            } else {
                add_equatorial(&mut out, n, m, c, s, axis == 1);
            }
        }
    }
    out
}

fn add_axial(out: &mut [f64; TERMS], n: usize, m: usize, c: f64, s: f64) {
    let factor = (n - m + 1) as f64;
    let up = 2 * index(n + 1, m);
    out[up] -= factor * c;
    out[up + 1] -= factor * s;
}

/// The y derivative is the x derivative with cosine and sine exchanged as a quarter turn does.
fn add_equatorial(out: &mut [f64; TERMS], n: usize, m: usize, c: f64, s: f64, along_y: bool) {
    let half = if m == 0 { 1.0 } else { 0.5 };
    let (up_v, up_w) = if along_y { (s, -c) } else { (-c, -s) };
    let up = 2 * index(n + 1, m + 1);
    out[up] += half * up_v;
    out[up + 1] += half * up_w;
    if m > 0 {
        let factor = 0.5 * ((n - m + 2) * (n - m + 1)) as f64;
        let (down_v, down_w) = if along_y { (s, -c) } else { (c, s) };
        let down = 2 * index(n + 1, m - 1);
        out[down] += factor * down_v;
        out[down + 1] += factor * down_w;
    }
}
