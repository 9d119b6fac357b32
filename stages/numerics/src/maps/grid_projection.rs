//! Position of a latitude and longitude on the grid of a projected map, with exact derivatives.
//!
//! A filter needs the position and its four derivatives at every sample. The projection is therefore sampled once.
//! Between the samples, it is approximated by a polynomial of sixth degree in latitude and in longitude. Over half a
//! degree this polynomial differs from a transverse Mercator, Lambert or stereographic projection by less than the
//! rounding error of the eastings. Patches are halved until this accuracy is reached, and the remaining difference from
//! the projection is measured.

use thiserror::Error;

use crate::maps::plane_grid::EvenAxis;

/// Samples per patch in each direction; the degree of the polynomials is one less.
const SAMPLES: usize = 7;

/// Initial width of a patch, in degrees.
const WIDEST_DEG: f64 = 1.0;

/// Maximum number of patches, 800 bytes each.
const MOST_PATCHES: usize = 1 << 18;

/// Maximum accepted difference from the projection, in steps of the grid.
const ACCEPTED_STEPS: f64 = 1e-6;

/// Error of a projection on a grid.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum GridProjectionError {
    /// The area has no extent, or exceeds the earth.
    #[error("the area of latitudes {lat_deg:?} and longitudes {lon_deg:?} is empty or outside the valid range")]
    Area {
        /// Southern and northern edge of the area.
        lat_deg: [f64; 2],
        /// Western and eastern edge of the area.
        lon_deg: [f64; 2],
    },
    /// The projection is undefined at a position of the area.
    #[error("the map's projection is undefined at latitude {lat_deg}, longitude {lon_deg}")]
    Nowhere {
        /// Latitude.
        lat_deg: f64,
        /// Longitude.
        lon_deg: f64,
    },
    /// The projection is not smooth.
    #[error("the polynomials deviate from the map's projection by {steps} grid steps")]
    Rough {
        /// The largest difference found, in steps of the grid.
        steps: f64,
    },
}

/// An area between two parallels and two meridians, in degrees; longitudes may exceed 180.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeographicArea {
    /// The southern and the northern edge.
    pub lat_deg: [f64; 2],
    /// The western and the eastern edge.
    pub lon_deg: [f64; 2],
}

/// A position on a projected grid: fractional row and column, counted from 0, and the derivatives of both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridPosition {
    /// The row.
    pub row: f64,
    /// The column.
    pub column: f64,
    /// Rows per degree of latitude, and per degree of longitude.
    pub row_per_deg: [f64; 2],
    /// Columns per degree of latitude, and per degree of longitude.
    pub column_per_deg: [f64; 2],
}

/// Coefficients of row and column as polynomials in latitude and longitude within a patch.
type PatchPolynomial = [[[f64; 2]; SAMPLES]; SAMPLES];

/// A projection on a grid, over an area.
#[derive(Clone, Debug)]
pub struct GridProjection {
    area: GeographicArea,
    counts: [usize; 2],
    /// Patches per degree of latitude and of longitude.
    per_deg: [f64; 2],
    /// Patches by rows from south to north, each from west to east.
    patches: Vec<PatchPolynomial>,
    departure_steps: f64,
}

impl GridProjection {
    /// Samples `project`, which returns the easting and northing (in the unit of `columns` and `rows`) of a latitude
    /// and a longitude in degrees.
    ///
    /// # Errors
    /// Fails for an invalid area, for a position in the area where the projection is undefined, or for a projection
    /// that is not smooth.
    pub fn new(
        project: impl Fn(f64, f64) -> Option<(f64, f64)>,
        area: GeographicArea,
        rows: &EvenAxis,
        columns: &EvenAxis,
    ) -> Result<Self, GridProjectionError> {
        let GeographicArea { lat_deg, lon_deg } = area;
        let (height, width) = (lat_deg[1] - lat_deg[0], lon_deg[1] - lon_deg[0]);
        if !(height > 0.0 && width > 0.0 && width <= 360.0 && lat_deg[0] >= -90.0 && lat_deg[1] <= 90.0) {
            return Err(GridProjectionError::Area { lat_deg, lon_deg });
        }
        let place = |lat: f64, lon: f64| -> Result<[f64; 2], GridProjectionError> {
            let (easting, northing) =
                project(lat, lon).ok_or(GridProjectionError::Nowhere { lat_deg: lat, lon_deg: lon })?;
            Ok([rows.node(northing), columns.node(easting)])
        };
        let largest = |axis: &EvenAxis| axis.first.abs().max(axis.last().abs()) / axis.step;
        let rounding = 4.0 * f64::EPSILON * largest(rows).max(largest(columns));
        let mut counts = [height, width].map(|extent| (extent / WIDEST_DEG).ceil().max(1.0) as usize);
        let mut best = Self::from_patch_counts(&place, area, counts)?;
        while best.departure_steps > rounding && 4 * counts[0] * counts[1] <= MOST_PATCHES {
            counts = counts.map(|count| 2 * count);
            let finer = Self::from_patch_counts(&place, area, counts)?;
            let gained = finer.departure_steps < 0.5 * best.departure_steps;
            if finer.departure_steps < best.departure_steps {
                best = finer;
            }
            if !gained {
                break;
            }
        }
        let steps = best.departure_steps;
        if steps <= ACCEPTED_STEPS { Ok(best) } else { Err(GridProjectionError::Rough { steps }) }
    }

    fn from_patch_counts(
        place: &impl Fn(f64, f64) -> Result<[f64; 2], GridProjectionError>,
        area: GeographicArea,
        counts: [usize; 2],
    ) -> Result<Self, GridProjectionError> {
        let extents = [area.lat_deg[1] - area.lat_deg[0], area.lon_deg[1] - area.lon_deg[0]];
        let per_deg = [counts[0] as f64 / extents[0], counts[1] as f64 / extents[1]];
        let basis = ChebyshevBasis::new();
        let ends = [area.lat_deg, area.lon_deg];
        // Rounding must not shift a latitude beyond a pole.
        let at = |d: usize, i: usize, t: f64| (ends[d][0] + (i as f64 + 0.5 * (1.0 + t)) / per_deg[d]).min(ends[d][1]);
        let mut patches = Vec::with_capacity(counts[0] * counts[1]);
        for (i, j) in (0..counts[0]).flat_map(|i| (0..counts[1]).map(move |j| (i, j))) {
            let mut samples = [[[0.0; 2]; SAMPLES]; SAMPLES];
            for (row, t) in samples.iter_mut().zip(basis.nodes) {
                for (sample, u) in row.iter_mut().zip(basis.nodes) {
                    *sample = place(at(0, i, t), at(1, j, u))?;
                }
            }
            patches.push(basis.polynomial(&samples));
        }
        let mut projection = Self { area, counts, per_deg, patches, departure_steps: 0.0 };
        // Ends of a patch and midpoints between samples, where a polynomial has its largest error.
        const CHECKS: [f64; 5] = [-1.0, -0.6, 0.1, 0.7, 1.0];
        for (i, j) in (0..counts[0]).flat_map(|i| (0..counts[1]).map(move |j| (i, j))) {
            for (t, u) in CHECKS.into_iter().flat_map(|t| CHECKS.map(|u| (t, u))) {
                let exact = place(at(0, i, t), at(1, j, u))?;
                let found = projection.in_patch([i, j], [t, u]);
                let off = (found.row - exact[0]).abs().max((found.column - exact[1]).abs());
                projection.departure_steps = projection.departure_steps.max(off);
            }
        }
        Ok(projection)
    }

    /// The grid position of a position in degrees; `None` outside the area, or for NaN. A longitude may differ by a
    /// full turn.
    #[inline]
    pub fn at(&self, lat_deg: f64, lon_deg: f64) -> Option<GridPosition> {
        let (i, t) = patch_of((lat_deg - self.area.lat_deg[0]) * self.per_deg[0], self.counts[0])?;
        let east_deg = (lon_deg - self.area.lon_deg[0]).rem_euclid(360.0);
        let (j, u) = patch_of(east_deg * self.per_deg[1], self.counts[1])?;
        Some(self.in_patch([i, j], [t, u]))
    }

    /// Largest difference from the projection that was found, in steps of the grid.
    pub fn departure_steps(&self) -> f64 {
        self.departure_steps
    }

    #[inline]
    fn in_patch(&self, [i, j]: [usize; 2], [t, u]: [f64; 2]) -> GridPosition {
        let mut value = [0.0; 2];
        let mut per_t = [0.0; 2];
        let mut per_u = [0.0; 2];
        for powers in self.patches[i * self.counts[1] + j].iter().rev() {
            let (mut inner, mut slope) = ([0.0; 2], [0.0; 2]);
            for c in powers.iter().rev() {
                for q in 0..2 {
                    slope[q] = slope[q] * u + inner[q];
                    inner[q] = inner[q] * u + c[q];
                }
            }
            for q in 0..2 {
                per_t[q] = per_t[q] * t + value[q];
                value[q] = value[q] * t + inner[q];
                per_u[q] = per_u[q] * t + slope[q];
            }
        }
        let [lat, lon] = self.per_deg.map(|per_deg| 2.0 * per_deg);
        GridPosition {
            row: value[0],
            column: value[1],
            row_per_deg: [per_t[0] * lat, per_u[0] * lon],
            column_per_deg: [per_t[1] * lat, per_u[1] * lon],
        }
    }
}

/// Patch index and position within the patch, from -1 to 1, of a position in units of patches.
#[inline]
fn patch_of(patches: f64, count: usize) -> Option<(usize, f64)> {
    if !(patches >= 0.0 && patches <= count as f64) {
        return None;
    }
    let patch = (patches as usize).min(count - 1);
    Some((patch, 2.0 * (patches - patch as f64) - 1.0))
}

/// Lagrange polynomials through the zeros of a Chebyshev polynomial.
struct ChebyshevBasis {
    nodes: [f64; SAMPLES],
    /// Weight of each sample for each power: the expanded Lagrange polynomials.
    powers: [[f64; SAMPLES]; SAMPLES],
}

impl ChebyshevBasis {
    fn new() -> Self {
        let nodes: [f64; SAMPLES] =
            std::array::from_fn(|k| -(std::f64::consts::PI * (k as f64 + 0.5) / SAMPLES as f64).cos());
        let mut powers = [[0.0; SAMPLES]; SAMPLES];
        for (k, node) in nodes.iter().enumerate() {
            let mut lagrange = [0.0; SAMPLES];
            lagrange[0] = 1.0;
            for (_, other) in nodes.iter().enumerate().filter(|(other, _)| *other != k) {
                for power in (0..SAMPLES).rev() {
                    let below = if power > 0 { lagrange[power - 1] } else { 0.0 };
                    lagrange[power] = (below - other * lagrange[power]) / (node - other);
                }
            }
            for (weights, weight) in powers.iter_mut().zip(lagrange) {
                weights[k] = weight;
            }
        }
        Self { nodes, powers }
    }

    fn polynomial(&self, samples: &PatchPolynomial) -> PatchPolynomial {
        let mut patch = [[[0.0; 2]; SAMPLES]; SAMPLES];
        for (row, along) in patch.iter_mut().zip(&self.powers) {
            for (coefficient, across) in row.iter_mut().zip(&self.powers) {
                for (samples, a) in samples.iter().zip(along) {
                    for (sample, b) in samples.iter().zip(across) {
                        coefficient[0] += a * b * sample[0];
                        coefficient[1] += a * b * sample[1];
                    }
                }
            }
        }
        patch
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const STEP_M: f64 = 100.0;
    const RADIUS_M: f64 = 6_378_137.0;

    fn axis(first: f64) -> EvenAxis {
        EvenAxis { first, step: STEP_M, len: 500 }
    }

    /// The transverse Mercator projection of a sphere about a meridian of 10 degrees. [Snyder 1987, (8-1), (8-3)]
    fn transverse_mercator(lat_deg: f64, lon_deg: f64) -> Option<(f64, f64)> {
        let (lat, lon) = (lat_deg.to_radians(), (lon_deg - 10.0).to_radians());
        let b = lat.cos() * lon.sin();
        Some((RADIUS_M * b.atanh(), RADIUS_M * lat.tan().atan2(lon.cos())))
    }

    /// The polar stereographic projection of a sphere. [Snyder 1987, (21-5), (21-6)]
    fn polar(lat_deg: f64, lon_deg: f64) -> Option<(f64, f64)> {
        let (colatitude, lon) = ((90.0 - lat_deg).to_radians(), lon_deg.to_radians());
        let r = 2.0 * RADIUS_M * (0.5 * colatitude).tan();
        Some((r * lon.sin(), -r * lon.cos()))
    }

    #[test]
    fn law_positions_and_slopes_equal_those_of_the_projection() {
        let area = GeographicArea { lat_deg: [44.9, 46.3], lon_deg: [8.2, 10.4] };
        let (rows, columns) = (axis(4_980_000.0), axis(-140_000.0));
        let found = GridProjection::new(transverse_mercator, area, &rows, &columns).unwrap();
        println!("departs by {} of a step of {STEP_M} m, {} patches", found.departure_steps(), found.patches.len());
        assert!(found.departure_steps() < 1e-9);
        for (lat, lon) in [(45.0, 8.3), (45.5, 9.25), (46.2999, 10.39), (44.9, 8.2), (46.3, 10.4)] {
            let at = found.at(lat, lon).unwrap();
            let (easting, northing) = transverse_mercator(lat, lon).unwrap();
            // Northings of 5e6 m have a rounding error of 1e-9 m, 1e-11 of a step.
            assert!((at.row - rows.node(northing)).abs() < 1e-9 && (at.column - columns.node(easting)).abs() < 1e-9);
            let h = 1e-4;
            let slope = |d_lat: f64, d_lon: f64| {
                let (ahead, back) = (
                    transverse_mercator(lat + d_lat, lon + d_lon).unwrap(),
                    transverse_mercator(lat - d_lat, lon - d_lon).unwrap(),
                );
                [(ahead.1 - back.1) / (2.0 * h * STEP_M), (ahead.0 - back.0) / (2.0 * h * STEP_M)]
            };
            let (per_lat, per_lon) = (slope(h, 0.0), slope(0.0, h));
            for (exact, expected) in
                [(at.row_per_deg, [per_lat[0], per_lon[0]]), (at.column_per_deg, [per_lat[1], per_lon[1]])]
            {
                for (a, b) in exact.iter().zip(expected) {
                    // Some 1000 rows a degree; the differences have a rounding error of 1e-9 m / 2e-4 / 100 m.
                    assert!((a - b).abs() < 1e-5, "{lat} {lon}: {a} {b}");
                }
            }
        }
        assert_eq!(found.at(45.0, 8.3 + 360.0).unwrap().row, found.at(45.0, 8.3 + 360.0 - 720.0).unwrap().row);
        for (lat, lon) in [(44.89, 9.0), (46.31, 9.0), (45.0, 8.19), (45.0, 10.41), (f64::NAN, 9.0), (45.0, f64::NAN)] {
            assert_eq!(found.at(lat, lon), None);
        }
    }

    #[test]
    fn law_positions_around_the_pole_equal_those_of_the_projection() {
        let area = GeographicArea { lat_deg: [85.0, 90.0], lon_deg: [-180.0, 180.0] };
        let found = GridProjection::new(polar, area, &axis(-25_000.0), &axis(-25_000.0)).unwrap();
        assert!(found.departure_steps() < 1e-9, "{}", found.departure_steps());
        for lon in [-180.0, -90.0, 0.0, 33.0, 179.9, 540.0] {
            let at = found.at(89.9, lon).unwrap();
            let (easting, northing) = polar(89.9, lon).unwrap();
            assert!((at.row - (northing + 25_000.0) / STEP_M).abs() < 1e-8, "{at:?}");
            assert!((at.column - (easting + 25_000.0) / STEP_M).abs() < 1e-8, "{at:?}");
        }
    }

    #[test]
    fn unit_invalid_projections_are_rejected() {
        let area = GeographicArea { lat_deg: [0.0, 1.0], lon_deg: [0.0, 1.0] };
        let folded = |lat: f64, lon: f64| Some((1e5 * (lon - 0.31).abs(), 1e5 * lat));
        let rough = GridProjection::new(folded, area, &axis(0.0), &axis(0.0)).unwrap_err();
        assert!(matches!(rough, GridProjectionError::Rough { .. }), "{rough}");
        let holed = |lat: f64, lon: f64| (lon < 0.9).then_some((lon, lat));
        let nowhere = GridProjection::new(holed, area, &axis(0.0), &axis(0.0)).unwrap_err();
        assert!(matches!(nowhere, GridProjectionError::Nowhere { .. }), "{nowhere}");
        let none = GeographicArea { lat_deg: [1.0, 0.0], ..area };
        assert!(GridProjection::new(transverse_mercator, none, &axis(0.0), &axis(0.0)).is_err());
    }
}
