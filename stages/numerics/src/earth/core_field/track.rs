//! The core field at many positions and dates: each recursion evaluates four positions, one per lane of a vector
//! register.

use super::{
    CoreFieldError, CoreFieldModel, GeodeticCoordinate, HarmonicRecursion, LocalDirections,
    coefficients::{EpochCoefficients, HarmonicTable, REFERENCE_RADIUS_M, index},
    dot3,
};
use crate::earth::geodesy::ecef_m;

/// Positions per batch.
const LANES: usize = 4;
/// The field is the gradient of the potential, so its degree is higher by one.
const DEGREE: usize = super::HIGHEST_DEGREE - 1;

type PositionLanes = [f64; LANES];

/// The field at each position, in nT.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NedField {
    /// Northward component.
    pub north_nt: Vec<f64>,
    /// Eastward component.
    pub east_nt: Vec<f64>,
    /// Downward component.
    pub down_nt: Vec<f64>,
}

impl NedField {
    /// The magnitude at each position, in nT.
    pub fn magnitude_nt(&self) -> Vec<f64> {
        let three = self.north_nt.iter().zip(&self.east_nt).zip(&self.down_nt);
        three.map(|((n, e), d)| (n * n + e * e + d * d).sqrt()).collect()
    }
}

/// The core field along a track: geodetic latitude and longitude in degrees, height in metres above the WGS-84
/// ellipsoid, and the date of every sample.
pub struct CoreFieldTrack {
    model: CoreFieldModel,
    recursion: HarmonicRecursion,
}

impl CoreFieldTrack {
    /// Prepares a model.
    pub fn new(model: CoreFieldModel) -> Self {
        Self { model, recursion: HarmonicRecursion::new() }
    }

    /// The field (north, east, down; nT) at each position and date; the shortest of the four slices determines the
    /// length. If a coordinate or date is not finite, the result is NaN.
    ///
    /// # Errors
    /// Fails for a date outside the model's range, or for an invalid position: a latitude beyond a pole, a longitude
    /// outside -180 to 360 degrees, or a height outside -10 to 2,000 km.
    pub fn field(
        &self,
        lat_deg: &[f64],
        lon_deg: &[f64],
        alt_m: &[f64],
        year: &[f64],
    ) -> Result<NedField, CoreFieldError> {
        self.evaluate(lat_deg, lon_deg, alt_m, year, false)
    }

    /// Annual change of the field (north, east, down; nT/year); see [`CoreFieldTrack::field`].
    ///
    /// # Errors
    /// Returns the errors of [`CoreFieldTrack::field`].
    pub fn secular_variation(
        &self,
        lat_deg: &[f64],
        lon_deg: &[f64],
        alt_m: &[f64],
        year: &[f64],
    ) -> Result<NedField, CoreFieldError> {
        self.evaluate(lat_deg, lon_deg, alt_m, year, true)
    }

    fn evaluate(
        &self,
        lat_deg: &[f64],
        lon_deg: &[f64],
        alt_m: &[f64],
        year: &[f64],
        rate: bool,
    ) -> Result<NedField, CoreFieldError> {
        let n = lat_deg.len().min(lon_deg.len()).min(alt_m.len()).min(year.len());
        let mut out = NedField { north_nt: vec![f64::NAN; n], east_nt: vec![f64::NAN; n], down_nt: vec![f64::NAN; n] };
        let finite = |i: usize| [lat_deg[i], lon_deg[i], alt_m[i], year[i]].iter().all(|x| x.is_finite());
        let mut group = PositionGroup::default();
        let mut span: Option<&EpochCoefficients> = None;
        for i in (0..n).filter(|i| finite(*i)) {
            possible(i, [lat_deg[i], lon_deg[i], alt_m[i]])?;
            let here = match span {
                Some(span) if span.holds(year[i]) => span,
                _ => self.model.span(year[i])?,
            };
            if let Some(before) = span.filter(|before| !std::ptr::eq(*before, here)) {
                self.flush(&mut group, before, rate, &mut out);
            }
            span = Some(here);
            group.push(i, lat_deg[i], lon_deg[i], alt_m[i], year[i] - here.from_year);
            if group.len == LANES {
                self.flush(&mut group, here, rate, &mut out);
            }
        }
        if let Some(span) = span {
            self.flush(&mut group, span, rate, &mut out);
        }
        Ok(out)
    }

    fn flush(&self, group: &mut PositionGroup, span: &EpochCoefficients, rate: bool, out: &mut NedField) {
        if group.len == 0 {
            return;
        }
        let sums = HarmonicSums { recursion: &self.recursion, table: span.table(), position_m: &group.position };
        let sums = pulp::Arch::new().dispatch(sums);
        for (lane, &row) in group.rows.iter().enumerate().take(group.len) {
            let part = |axis: usize| {
                let change = sums[axis + 3][lane];
                if rate { change } else { sums[axis][lane] + group.years[lane] * change }
            };
            let field = [part(0), part(1), part(2)];
            let local = &group.local[lane];
            out.north_nt[row] = dot3(&field, &local.north);
            out.east_nt[row] = dot3(&field, &local.east);
            out.down_nt[row] = -dot3(&field, &local.up);
        }
        *group = PositionGroup::default();
    }
}

/// Coordinates of a position, and the valid range of each. The models apply from the ground up to heights where the
/// external field is no longer small compared with the core field.
const PLACES: [(GeodeticCoordinate, f64, f64, &str); 3] = [
    (GeodeticCoordinate::Latitude, -90.0, 90.0, "deg"),
    (GeodeticCoordinate::Longitude, -180.0, 360.0, "deg"),
    (GeodeticCoordinate::Height, -10_000.0, 2_000_000.0, "m"),
];

fn possible(row: usize, place: [f64; 3]) -> Result<(), CoreFieldError> {
    for (value, (coordinate, low, high, unit)) in place.into_iter().zip(PLACES) {
        if !(low..=high).contains(&value) {
            return Err(CoreFieldError::Position { coordinate, value, low, high, unit, row });
        }
    }
    Ok(())
}

/// Positions that are evaluated together, one per vector lane.
struct PositionGroup {
    len: usize,
    rows: [usize; LANES],
    position: [PositionLanes; 3],
    years: PositionLanes,
    local: [LocalDirections; LANES],
}

impl Default for PositionGroup {
    fn default() -> Self {
        // An unused lane holds a position on the reference sphere, to avoid overflow.
        let unused = [[REFERENCE_RADIUS_M; LANES], [0.0; LANES], [0.0; LANES]];
        let local = [(); LANES].map(|()| LocalDirections::at(0.0, 0.0));
        Self { len: 0, rows: [0; LANES], position: unused, years: [0.0; LANES], local }
    }
}

impl PositionGroup {
    fn push(&mut self, row: usize, lat_deg: f64, lon_deg: f64, alt_m: f64, years: f64) {
        let (lat, lon) = (lat_deg.to_radians(), lon_deg.to_radians());
        let lane = self.len;
        for (axis, coordinate) in self.position.iter_mut().zip(ecef_m(lat, lon, alt_m)) {
            axis[lane] = coordinate;
        }
        self.rows[lane] = row;
        self.years[lane] = years;
        self.local[lane] = LocalDirections::at(lat, lon);
        self.len += 1;
    }
}

/// Sums over all harmonics for each column of the table, one position per lane; compiled for the vector width of each
/// processor.
struct HarmonicSums<'a> {
    recursion: &'a HarmonicRecursion,
    table: &'a HarmonicTable,
    position_m: &'a [PositionLanes; 3],
}

impl pulp::NullaryFnOnce for HarmonicSums<'_> {
    type Output = [PositionLanes; 6];

    #[inline(always)]
    fn call(self) -> [PositionLanes; 6] {
        summed(self.recursion, self.table, self.position_m)
    }
}

/// The recursion of [`HarmonicRecursion::harmonics`], degree by degree. Each degree is summed as soon as it is
/// computed, so that at most three degrees are stored. The order of operations is the same for every register width.
#[inline(always)]
fn summed(recursion: &HarmonicRecursion, table: &HarmonicTable, position_m: &[PositionLanes; 3]) -> [PositionLanes; 6] {
    const WIDTH: usize = DEGREE + 1;
    let [px, py, pz] = position_m;
    let radius_squared = lanes(|l| px[l] * px[l] + py[l] * py[l] + pz[l] * pz[l]);
    let scale = lanes(|l| REFERENCE_RADIUS_M / radius_squared[l]);
    let (x, y, z) = (lanes(|l| px[l] * scale[l]), lanes(|l| py[l] * scale[l]), lanes(|l| pz[l] * scale[l]));
    let ratio = lanes(|l| REFERENCE_RADIUS_M * scale[l]);
    let zero = [[[0.0; LANES]; 2]; WIDTH];
    let (mut two, mut one, mut here) = (zero, zero, zero);
    one[0][0] = lanes(|l| ratio[l].sqrt());
    let mut sums = [[0.0; LANES]; 6];
    for n in 1..=DEGREE {
        for m in 0..n {
            let k = index(n, m);
            let (back, further) = (recursion.one_back[k], recursion.two_back[k]);
            for part in 0..2 {
                let (a, b) = (&one[m][part], &two[m][part]);
                here[m][part] = lanes(|l| z[l] * back * a[l] - ratio[l] * further * b[l]);
            }
        }
        let factor = 2.0 * n as f64 - 1.0;
        let [v, w] = one[n - 1];
        here[n] = [lanes(|l| factor * (x[l] * v[l] - y[l] * w[l])), lanes(|l| factor * (x[l] * w[l] + y[l] * v[l]))];
        let entries = &table[2 * index(n, 0)..2 * index(n + 1, 0)];
        for (coefficients, [v, w]) in entries.as_chunks::<2>().0.iter().zip(&here) {
            for (sum, (c, s)) in sums.iter_mut().zip(coefficients[0].iter().zip(&coefficients[1])) {
                *sum = lanes(|l| sum[l] + (c * v[l] + s * w[l]));
            }
        }
        (two, one, here) = (one, here, two);
    }
    sums
}

#[inline(always)]
fn lanes(of: impl Fn(usize) -> f64) -> PositionLanes {
    [of(0), of(1), of(2), of(3)]
}
