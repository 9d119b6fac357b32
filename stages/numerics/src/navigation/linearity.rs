//! Range of position uncertainty over which a Kalman filter may linearise the field.
//!
//! An extended Kalman filter predicts the field at the position x + e as h(x) + H e. With the error e ~ N(0, P) of the
//! position x, the linear change of the field and the linearisation error have the mean squares
//!
//! ```text
//! λ²(P) = E [H e]²,      ε²(P) = E [h(x + e) − h(x) − H e]²,      e ~ N(0, P)
//! ```
//!
//! The filter does not include ε in its covariance. The filter is valid where ε is below the standard deviation σ of
//! the measurement noise [compare Bar-Shalom, Li & Kirubarajan 2001, section 10.3]. A larger ε is also tolerated if it
//! is below λ/3: the first updates are then overconfident, but the slope has the correct sign, and later updates
//! correct the position. The range is the standard deviation of the position at which ε equals the larger of σ and λ/3,
//! for an error ellipse with the shape of P. λ² and ε² are medians over the next 60 s of a straight path, because the
//! map may be unusually flat or steep at a single position.
//!
//! The mean over e is computed by a Gauss-Laguerre rule of three nodes in |e|²/2, for each of eight directions
//! [Abramowitz & Stegun 1964, 25.4.45]. The rule is exact for a field of second and third degree.

use crate::earth::geodesy::EarthModel;
use crate::navigation::field::PredictedField;
use crate::navigation::line::NavigationLine;
use crate::navigation::pinson::{LAT, LON};

/// Half of the squared radii, in standard deviations, and the weights.
const RADII: [(f64, f64); 3] = [
    (0.415_774_556_783_479_1, 0.711_093_009_929_173),
    (2.294_280_360_279_042, 0.278_517_733_569_240_9),
    (6.289_945_082_937_479, 0.010_389_256_501_586_136),
];
/// Number of directions.
const DIRECTIONS: u32 = 8;
/// Times of the positions along the path, in seconds: interval and number.
const PATH: (f64, u32) = (5.0, 13);
/// Largest tolerated linearisation error, as a fraction of the linear change.
const LARGEST_SHARE: f64 = 1.0 / 3.0;
/// Smallest and largest range, in metres.
const RANGE_M: [f64; 2] = [0.1, 1e5];
/// Number of bisections of the logarithm of the range; the relative error is 1e-5.
const BISECTIONS: usize = 20;

/// Position uncertainty, and the largest uncertainty over which the field is linear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearRange {
    /// Standard deviation of the position along the longer axis of its error ellipse, in metres.
    pub sigma_m: f64,
    /// Largest `sigma_m` for which the linearisation error is below the noise or a third of the linear change, in
    /// metres; at most the extent of the map, and 100 km. NaN without a value of the map on the path, or without a
    /// measurement.
    pub limit_m: f64,
}

impl LinearRange {
    /// Whether the uncertainty exceeds the range; false for an unknown range.
    pub fn is_exceeded(&self) -> bool {
        self.sigma_m > self.limit_m
    }
}

/// Range at the first sample of a line, for the initial covariance and the mean square noise of its measurements.
///
/// Aiding positions of the first sample reduce the covariance. The path leads straight ahead from the INS position. The
/// line is valid ([`NavigationLine::check`]).
pub fn at_start(line: &NavigationLine<'_>) -> LinearRange {
    let ins = line.ins;
    let p = line.errors.initial_covariance(ins.lat_deg[0].to_radians(), ins.alt_m[0]);
    let mut covariance = [p[LAT][LAT], p[LAT][LON], p[LON][LON]];
    for fix in line.fixes_at(0).into_iter().flatten().filter(|fix| fix.state == LAT || fix.state == LON) {
        covariance = conditioned(covariance, fix.state == LAT, fix.variance);
    }
    let place = PathStart {
        lat_deg: ins.lat_deg[0],
        lon_deg: ins.lon_deg[0],
        alt_m: ins.alt_m[0],
        velocity_ne_mps: [ins.vn_mps[0], ins.ve_mps[0]],
    };
    LinearityTest::new(line).range(&place, covariance, noise_nt(line))
}

/// Root mean square of the standard deviations of a line's measurements, in nT; NaN without a measurement.
pub(crate) fn noise_nt(line: &NavigationLine<'_>) -> f64 {
    let known = line.sigma_nt.iter().zip(line.measurement_nt).filter(|(sigma, nt)| **sigma > 0.0 && nt.is_finite());
    let (sum, count) = known.fold((0.0, 0.0), |(sum, count), (sigma, _)| (sum + sigma * sigma, count + 1.0));
    f64::sqrt(sum / count)
}

/// Covariance of latitude and longitude after a measurement of one of them.
fn conditioned([a, b, c]: [f64; 3], of_lat: bool, variance: f64) -> [f64; 3] {
    if of_lat {
        let total = a + variance;
        [a * variance / total, b * variance / total, c - b * b / total]
    } else {
        let total = c + variance;
        [a - b * b / total, b * variance / total, c * variance / total]
    }
}

/// Position and horizontal velocity at the start of a straight path.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PathStart {
    pub(crate) lat_deg: f64,
    pub(crate) lon_deg: f64,
    pub(crate) alt_m: f64,
    pub(crate) velocity_ne_mps: [f64; 2],
}

/// Linearisation error of a field.
pub(crate) struct LinearityTest<'a> {
    field: PredictedField<'a>,
    earth: EarthModel,
}

impl<'a> LinearityTest<'a> {
    /// Test for the map of a line. The nonlinear part of the core field is 0.001 nT over a kilometre, and is neglected.
    pub(crate) fn new(line: &NavigationLine<'a>) -> Self {
        Self { field: PredictedField::new(line.map, None), earth: line.errors.earth }
    }

    /// Whether the linearisation error over a covariance of latitude and longitude (in rad²: variance of latitude,
    /// covariance, variance of longitude) is below the noise; false without a value of the map.
    pub(crate) fn is_linear(&mut self, at: &PathStart, covariance: [f64; 3], sigma_nt: f64) -> bool {
        self.changes(at, cholesky(covariance)).is_some_and(|changes| changes.error_nt <= sigma_nt)
    }

    /// Range for an error ellipse with the shape of a covariance, and for a standard deviation of the noise.
    fn range(&mut self, at: &PathStart, covariance: [f64; 3], sigma_nt: f64) -> LinearRange {
        let (north_m, east_m) = self.earth.north_east_m_per_rad(at.lat_deg.to_radians(), at.alt_m);
        let [a, b, c] = covariance;
        let sigma_m = longer_axis([a * north_m * north_m, b * north_m * east_m, c * east_m * east_m]);
        // An exact position has no shape, so a circle is used.
        let (shape, unit_m) =
            if sigma_m > 0.0 { (covariance, sigma_m) } else { ([north_m.powi(-2), 0.0, east_m.powi(-2)], 1.0) };
        let root = cholesky(shape);
        let mut is_linear = |range_m: f64| {
            let FieldChanges { linear_nt, error_nt } = self.changes(at, root.map(|entry| entry * range_m / unit_m))?;
            Some(error_nt <= sigma_nt.max(LARGEST_SHARE * linear_nt))
        };
        let [mut low, mut high] = RANGE_M.map(f64::ln);
        if sigma_nt.is_nan() || sigma_nt <= 0.0 || is_linear(RANGE_M[0]).is_none() {
            return LinearRange { sigma_m, limit_m: f64::NAN };
        }
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            *(if is_linear(middle.exp()) == Some(true) { &mut low } else { &mut high }) = middle;
        }
        LinearRange { sigma_m, limit_m: low.exp() }
    }

    /// Changes of the field over the covariance with this Cholesky factor; `None` without a value of the map. Positions
    /// off the map do not count.
    fn changes(&mut self, at: &PathStart, [first, both, second]: [f64; 3]) -> Option<FieldChanges> {
        let (north_m, east_m) = self.earth.north_east_m_per_rad(at.lat_deg.to_radians(), at.alt_m);
        let [vn, ve] = at.velocity_ne_mps;
        let (mut linear, mut errors) = (vec![], vec![]);
        for step in 0..PATH.1 {
            let time_s = PATH.0 * f64::from(step);
            let (lat, lon) = (vn * time_s / north_m, ve * time_s / east_m);
            let mut look = |north: f64, east: f64| {
                let (lat_deg, lon_deg) =
                    (at.lat_deg + (lat + north).to_degrees(), at.lon_deg + (lon + east).to_degrees());
                self.field.at(lat_deg, lon_deg, at.alt_m)
            };
            let Some(centre) = look(0.0, 0.0) else { continue };
            let (mut squares, mut weights) = ([0.0; 2], 0.0);
            for (half, weight) in RADII {
                for direction in 0..DIRECTIONS {
                    let (sin, cos) = (std::f64::consts::TAU * f64::from(direction) / f64::from(DIRECTIONS)).sin_cos();
                    let radius = (2.0 * half).sqrt();
                    let (north, east) = (radius * first * cos, radius * (both * cos + second * sin));
                    if let Some(there) = look(north, east) {
                        let change = centre.d_lat_nt_per_rad * north + centre.d_lon_nt_per_rad * east;
                        squares[0] += weight * change.powi(2);
                        squares[1] += weight * (there.value_nt - centre.value_nt - change).powi(2);
                        weights += weight;
                    }
                }
            }
            if weights > 0.0 {
                linear.push(squares[0] / weights);
                errors.push(squares[1] / weights);
            }
        }
        Some(FieldChanges { linear_nt: median(linear)?.sqrt(), error_nt: median(errors)?.sqrt() })
    }
}

/// Root of the median mean square of the changes of a field.
#[derive(Clone, Copy, Debug)]
struct FieldChanges {
    linear_nt: f64,
    error_nt: f64,
}

/// Median; the upper of the two middle values for an even number of values. `None` without a value.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Square root of the larger eigenvalue of a covariance.
fn longer_axis([a, b, c]: [f64; 3]) -> f64 {
    (0.5 * (a + c) + (0.25 * (a - c).powi(2) + b * b).sqrt()).max(0.0).sqrt()
}

/// Lower Cholesky factor of a covariance, by rows.
fn cholesky([a, b, c]: [f64; 3]) -> [f64; 3] {
    let first = a.max(0.0).sqrt();
    let both = if first > 0.0 { b / first } else { 0.0 };
    [first, both, (c - both * both).max(0.0).sqrt()]
}

#[cfg(test)]
mod tests;
