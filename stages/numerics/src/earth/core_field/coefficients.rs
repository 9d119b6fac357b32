//! The Gauss coefficients: read from the embedded files, linear in time between epochs, differentiated.

use params::choice;
use std::sync::OnceLock;

use thiserror::Error;

/// Degree and order of IGRF, the highest of the models.
pub(super) const DEGREE: usize = 13;
/// Length of a coefficient vector: cosine and sine of all orders up to two degrees above the model.
pub(super) const TERMS: usize = (DEGREE + 3) * (DEGREE + 4);
/// The reference radius of the Gauss coefficients, in metres.
pub(super) const REFERENCE_RADIUS_M: f64 = 6_371_200.0;

choice! {
    /// A model of the core field.
    #[derive(Default)]
    pub enum CoreFieldModel {
        /// The International Geomagnetic Reference Field, 14th generation, degree 13, with the definitive and
        /// provisional coefficients of 1900 to 2025 and the secular variation to 2030. [IAGA,
        /// doi:10.5281/zenodo.14012302]
        #[default]
        Igrf14 = "igrf",
        /// The World Magnetic Model, degree 12: WMM2020 from 2020 to 2025, and WMM2025 from 2025 to 2030. At the change
        /// of model, a component jumps by up to 314 nT. [NOAA NCEI and BGS]
        Wmm = "wmm",
    }
}

impl CoreFieldModel {
    /// The usual spelling of the name.
    pub fn name(self) -> &'static str {
        match self {
            CoreFieldModel::Igrf14 => "IGRF-14",
            CoreFieldModel::Wmm => "WMM",
        }
    }

    /// The epochs of the model, read from the embedded files once.
    fn spans(self) -> Result<&'static [EpochCoefficients], CoreFieldError> {
        static IGRF: OnceLock<Result<Vec<EpochCoefficients>, CoreFieldError>> = OnceLock::new();
        static WMM: OnceLock<Result<Vec<EpochCoefficients>, CoreFieldError>> = OnceLock::new();
        let spans = match self {
            CoreFieldModel::Igrf14 => IGRF.get_or_init(|| shc(include_str!("IGRF14.shc"))),
            CoreFieldModel::Wmm => WMM.get_or_init(|| {
                Ok(vec![cof(include_str!("WMM2020.COF"), 2025.0)?, cof(include_str!("WMM2025.COF"), 2030.0)?])
            }),
        };
        spans.as_deref().map_err(Clone::clone)
    }

    /// The interval between epochs that contains a date; a date on an epoch belongs to the interval that begins there.
    pub(super) fn span(self, decimal_year: f64) -> Result<&'static EpochCoefficients, CoreFieldError> {
        let spans = self.spans()?;
        let (Some(first), Some(last)) = (spans.first(), spans.last()) else {
            return Err(CoreFieldError::Coefficients { model: self.name(), line: 0 });
        };
        if !(first.from_year..=last.to_year).contains(&decimal_year) {
            let (first, last) = (first.from_year, last.to_year);
            return Err(CoreFieldError::Date { model: self.name(), decimal_year, first, last });
        }
        Ok(spans.iter().rev().find(|s| s.from_year <= decimal_year).unwrap_or(first))
    }
}

/// Coefficients that are linear in time from one epoch to the next.
#[derive(Clone, Debug)]
pub(super) struct EpochCoefficients {
    pub(super) from_year: f64,
    to_year: f64,
    /// Coefficients of the potential at the first epoch, divided by the reference radius, in nT, for harmonics that are
    /// not normalised. Cosine and sine are interleaved.
    at_start: Box<[f64; TERMS]>,
    /// Change of the coefficients, in nT/year.
    per_year: Box<[f64; TERMS]>,
    table: OnceLock<HarmonicTable>,
}

/// Coefficients of the three earth-centred field components and of their annual changes, adjacent for each term.
pub(super) type HarmonicTable = Vec<[f64; 6]>;

impl EpochCoefficients {
    /// Whether a date is in this span; the end is excluded.
    pub(super) fn holds(&self, decimal_year: f64) -> bool {
        (self.from_year..self.to_year).contains(&decimal_year)
    }

    /// Coefficients for evaluation at many dates, computed once.
    pub(super) fn table(&self) -> &HarmonicTable {
        self.table.get_or_init(|| {
            let field = |of: &[f64; TERMS]| [0, 1, 2].map(|axis| derivative(of, axis, -1.0));
            let (start, rate) = (field(&self.at_start), field(&self.per_year));
            let all = [&start[0], &start[1], &start[2], &rate[0], &rate[1], &rate[2]];
            // The sine of order zero multiplies a zero harmonic.
            (0..TERMS).map(|k| all.map(|c| c[k])).collect()
        })
    }

    /// The coefficients of the potential at a date.
    pub(super) fn at(&self, decimal_year: f64) -> Box<[f64; TERMS]> {
        let years = decimal_year - self.from_year;
        let mut out = self.at_start.clone();
        out.iter_mut().zip(self.per_year.iter()).for_each(|(g, rate)| *g += years * rate);
        out
    }
}

/// A geodetic coordinate of a position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GeodeticCoordinate {
    /// Geodetic latitude.
    Latitude,
    /// Longitude, to the east.
    Longitude,
    /// Height above the WGS-84 ellipsoid.
    Height,
}

impl std::fmt::Display for GeodeticCoordinate {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(match self {
            GeodeticCoordinate::Latitude => "latitude",
            GeodeticCoordinate::Longitude => "longitude",
            GeodeticCoordinate::Height => "height for the core field",
        })
    }
}

/// Error of the core field.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CoreFieldError {
    /// The date is outside the model's years.
    #[error("{model} covers the years {first} to {last}, not {decimal_year}")]
    Date {
        /// The model.
        model: &'static str,
        /// The requested date.
        decimal_year: f64,
        /// The model's first year.
        first: f64,
        /// The model's last year.
        last: f64,
    },
    /// A coordinate outside its range.
    #[error("{value:?} is not a {coordinate}; the range is {low} to {high} {unit}")]
    Position {
        /// Coordinate: `latitude`, `longitude` or `height`.
        coordinate: GeodeticCoordinate,
        /// The value.
        value: f64,
        /// The lower limit.
        low: f64,
        /// The upper limit.
        high: f64,
        /// The unit of the value and its limits.
        unit: &'static str,
        /// The index of the position, from 0, in the given order.
        row: usize,
    },
    /// The embedded coefficient file is damaged.
    #[error("line {line} of the coefficient file of {model} is damaged")]
    Coefficients {
        /// The model.
        model: &'static str,
        /// The line, from 1.
        line: usize,
    },
}

/// Position of degree `n` and order `m` in a triangle stored by rows.
pub(super) const fn index(n: usize, m: usize) -> usize {
    n * (n + 1) / 2 + m
}

/// Parses a file in the SHC format of IGRF: a line of epochs, then lines of degree, order (negative for sines) and a
/// value per epoch.
fn shc(file: &str) -> Result<Vec<EpochCoefficients>, CoreFieldError> {
    let damaged = |line: usize| CoreFieldError::Coefficients { model: CoreFieldModel::Igrf14.name(), line: line + 1 };
    let mut lines = file.lines().enumerate().filter(|(_, line)| !line.starts_with('#')).skip(1);
    let (epoch_line, epochs) = lines.next().ok_or(damaged(0))?;
    let epochs = numbers(epochs).filter(|e| e.len() > 1).ok_or(damaged(epoch_line))?;
    let mut tables = vec![Box::new([0.0; TERMS]); epochs.len()];
    for (number, line) in lines {
        let words = numbers(line).ok_or(damaged(number))?;
        let [degree, order, values @ ..] = words.as_slice() else { return Err(damaged(number)) };
        let (place, factor) = place(*degree, *order).ok_or(damaged(number))?;
        if values.len() != epochs.len() {
            return Err(damaged(number));
        }
        tables.iter_mut().zip(values).for_each(|(table, value)| table[place] = factor * value);
    }
    let pairs = epochs.windows(2).zip(tables.windows(2));
    Ok(pairs.map(|(years, tables)| between((years[0], &tables[0]), (years[1], &tables[1]))).collect())
}

fn between(early: (f64, &[f64; TERMS]), late: (f64, &[f64; TERMS])) -> EpochCoefficients {
    let mut per_year = Box::new([0.0; TERMS]);
    for (rate, (a, b)) in per_year.iter_mut().zip(early.1.iter().zip(late.1)) {
        *rate = (b - a) / (late.0 - early.0);
    }
    EpochCoefficients {
        from_year: early.0,
        to_year: late.0,
        at_start: Box::new(*early.1),
        per_year,
        table: OnceLock::new(),
    }
}

/// Parses a file in the COF format of WMM: the epoch, then lines of degree, order, cosine, sine and their annual
/// changes.
fn cof(file: &str, to_year: f64) -> Result<EpochCoefficients, CoreFieldError> {
    let damaged = |line: usize| CoreFieldError::Coefficients { model: CoreFieldModel::Wmm.name(), line: line + 1 };
    let mut lines = file.lines().enumerate();
    let epoch = lines.next().and_then(|(_, line)| line.split_whitespace().next()?.parse().ok());
    let mut span = EpochCoefficients {
        from_year: epoch.ok_or(damaged(0))?,
        to_year,
        at_start: Box::new([0.0; TERMS]),
        per_year: Box::new([0.0; TERMS]),
        table: OnceLock::new(),
    };
    for (number, line) in lines.take_while(|(_, line)| !line.starts_with("9999")) {
        let words = numbers(line).ok_or(damaged(number))?;
        let [degree, order, g, h, g_dot, h_dot] = words.as_slice() else { return Err(damaged(number)) };
        let (place, factor) = place(*degree, *order).ok_or(damaged(number))?;
        (span.at_start[place], span.at_start[place + 1]) = (factor * g, factor * h);
        (span.per_year[place], span.per_year[place + 1]) = (factor * g_dot, factor * h_dot);
    }
    Ok(span)
}

fn numbers(line: &str) -> Option<Vec<f64>> {
    line.split_whitespace().map(|word| word.parse().ok()).collect()
}

/// Index of a coefficient and its normalisation factor; a negative order denotes a sine.
fn place(degree: f64, signed_order: f64) -> Option<(usize, f64)> {
    let order = signed_order.abs();
    if degree.fract() != 0.0 || order.fract() != 0.0 || !(1.0..=DEGREE as f64).contains(&degree) || order > degree {
        return None;
    }
    let (n, m) = (degree as usize, order as usize);
    Some((2 * index(n, m) + usize::from(signed_order < 0.0), schmidt_factor(n, m)))
}

/// Factor from a Legendre function to a Schmidt semi-normalised function: sqrt(2 (n-m)! / (n+m)!), 1 for order zero.
fn schmidt_factor(n: usize, m: usize) -> f64 {
    if m == 0 {
        return 1.0;
    }
    let falling: f64 = (n - m + 1..=n + m).map(|k| k as f64).product();
    (2.0 / falling).sqrt()
}

/// The coefficients of `scale` times the derivative of a potential along the earth-centred axis 0, 1 or 2 (x, y, z),
/// with positions in units of the reference radius. [Montenbruck & Gill, Satellite Orbits, (3.33)]
pub(super) fn derivative(of: &[f64; TERMS], axis: usize, scale: f64) -> Box<[f64; TERMS]> {
    let mut out = Box::new([0.0; TERMS]);
    for n in 0..=DEGREE + 1 {
        for m in 0..=n {
            let here = 2 * index(n, m);
            // The sine of order zero is zero, so its coefficient in a derivative is omitted.
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

/// Adds the y derivative: the x derivative with cosine and sine exchanged as in a rotation by a quarter turn.
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
