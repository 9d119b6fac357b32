//! The crustal field as a vector, from a map of the total field anomaly.
//!
//! A level map gives the change that the crustal field b causes in the magnitude of the core field. To first order this
//! is the component T of b along the core field. If all sources lie below, b is the gradient of a harmonic potential,
//! and T determines b at each wavenumber separately ([`MapSpectrum::components`], the stable form of MagNav.jl's
//! `vector_fft`).
//!
//! This computation uses one direction of the core field for the whole map, although the direction changes by a degree
//! in 100 km. It also neglects the second order, b²/2B: 2 nT for 500 nT. Therefore, at each node, the map is compared
//! with the change of magnitude that the computed field causes. The map is corrected by the difference, and the field
//! is computed again. Each correction reduces the difference to about b/B of the previous difference. After the last
//! correction it is below the rounding of the transform.
//!
//! At inclinations below 15 degrees, T contains almost nothing of the waves whose wave vector is perpendicular to the
//! core field, so a residual remains. The residual is added along the core direction, so that the scalar anomaly equals
//! the map everywhere. Only this part of the field is not a gradient.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use datasets::{MapTable, ReadError};
use nalgebra::Vector3;
use numerics::{
    earth::core_field::CoreFieldTrack,
    maps::{
        continuation::{MapSpectrum, Padding, upward},
        fill::{SmoothFill, smooth},
        map_surface::GeographicGrid,
        plane_grid::PlaneGrid,
    },
    signal::natural_cubic,
};

/// The number of corrections of the map for the core field at each node.
const CORRECTIONS: usize = 6;
/// Maximum distance below the map, as a fraction of the map's spacing. Down to this distance, the field is extrapolated
/// with its slope.
const BELOW: f64 = 0.1;

/// East, north and up components in nT, and the residual along the core field in nT.
type CrustalComponents = [f64; 4];

/// Evenly spaced axis of a map, in degrees.
#[derive(Clone, Copy, Debug)]
struct CrustalMapAxis {
    first_deg: f64,
    step_deg: f64,
    len: usize,
}

impl CrustalMapAxis {
    fn from_coordinates(axis: &[f64]) -> CrustalMapAxis {
        let first_deg = axis.first().copied().unwrap_or(f64::NAN);
        let last_deg = axis.last().copied().unwrap_or(f64::NAN);
        CrustalMapAxis { first_deg, step_deg: (last_deg - first_deg) / (axis.len().max(2) - 1) as f64, len: axis.len() }
    }

    /// The cell and the fraction within it. A position that is past an end because of rounding is moved to the end.
    fn locate(&self, deg: f64) -> Option<(usize, f64)> {
        const ROUNDING: f64 = 1e-7;
        let steps = (deg - self.first_deg) / self.step_deg;
        let last = self.len.saturating_sub(1) as f64;
        if !(steps >= -ROUNDING && steps <= last + ROUNDING) {
            return None;
        }
        let cell = (steps.max(0.0) as usize).min(self.len.saturating_sub(2));
        Some((cell, (steps - cell as f64).clamp(0.0, 1.0)))
    }
}

/// Cell of a map, and the position in it as fractions of a step northward and eastward.
#[derive(Clone, Copy)]
struct CrustalMapCell {
    row: usize,
    column: usize,
    up: f64,
    right: f64,
}

/// The vector field of a map, at and above its height.
pub(super) struct CrustalMap {
    path: PathBuf,
    level_m: f64,
    lat: CrustalMapAxis,
    lon: CrustalMapAxis,
    /// Length of a step northward and eastward, in metres.
    steps_m: [f64; 2],
    /// The mean direction of the core field, east, north and up.
    direction: [f64; 3],
    /// Corrected map, from which the field is computed. The values are the field's component in the mean direction.
    corrected: PlaneGrid,
    /// The residual along the core field at the map's height.
    rest: PlaneGrid,
    /// Whether the four corner nodes of each grid square are known, row by row.
    known: Vec<bool>,
    /// Cached levels; the key is the bits of the height above the map. The set of levels does not depend on the order
    /// of requests.
    levels: Mutex<BTreeMap<u64, Arc<CrustalMapLevel>>>,
}

/// Reason why the map gives no field at a sample, with the index of the sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum CrustalCoverageError {
    /// The sample is off the map or at an unknown node.
    Off(usize),
    /// The sample is below the map.
    Below(usize),
}

impl CrustalMap {
    /// Prepares the field of a map; `core` and `year` give the direction of the core field.
    ///
    /// # Errors
    /// Fails for a map that is not level, or for a date outside the core model.
    pub(super) fn new(path: &Path, map: &MapTable, core: &CoreFieldTrack, year: f64) -> Result<CrustalMap, ReadError> {
        let wrong = |e: &dyn std::fmt::Display| ReadError::data(path, e.to_string());
        let level_m = map.column("alt").first().copied().unwrap_or(f64::NAN);
        if map.column("alt").iter().any(|a| *a != level_m) {
            return Err(ReadError::data(path, "the simulation requires a level map").in_column("alt"));
        }
        let (lats, lons) = (map.latitudes_deg(), map.longitudes_deg());
        let grid = GeographicGrid::new(&lats, &lons, map.column("anomaly")).map_err(|e| wrong(&e))?;
        let plane = grid.plane();
        let filled = match plane.unknown() {
            0 => plane.clone(),
            _ => smooth(&plane, &SmoothFill::default()).map_err(|e| wrong(&e))?.0,
        };
        let nodes = filled.values.len();
        let heights = vec![level_m; nodes];
        let field = core.field(map.column("lat"), map.column("lon"), &heights, &vec![year; nodes]);
        let field = field.map_err(|e| wrong(&e))?;
        let enu = |i: usize| Vector3::new(field.east_nt[i], field.north_nt[i], -field.down_nt[i]);
        let core_nt: Vec<Vector3<f64>> = (0..nodes).map(enu).collect();
        let direction: [f64; 3] = core_nt.iter().map(Vector3::normalize).sum::<Vector3<f64>>().normalize().into();
        let (corrected, rest) = corrected(&filled, direction, &core_nt).map_err(|e| wrong(&e))?;
        Ok(CrustalMap {
            path: path.to_path_buf(),
            level_m,
            lat: CrustalMapAxis::from_coordinates(&lats),
            lon: CrustalMapAxis::from_coordinates(&lons),
            steps_m: [plane.north_m.step, plane.east_m.step],
            direction,
            corrected,
            rest,
            known: known_cells(&plane),
            levels: Mutex::default(),
        })
    }

    /// The height of the map, in metres.
    pub(super) fn level_m(&self) -> f64 {
        self.level_m
    }

    /// The crustal field (north, east, down; nT) at positions in degrees and metres where the core field is
    /// `core_ned_nt`. `moved` shifts each position by at most a few decimetres (degrees of latitude and longitude,
    /// metres up). A shift may lead past the edge of the map, where the splines at the position are extrapolated.
    ///
    /// If all positions have one height, the field is computed at this level. Otherwise the field is interpolated
    /// between levels by a cubic in height. Near the map, levels are half a grid spacing apart. Farther up, the
    /// distance between levels is a quarter of their height above the map. The slopes of the cubic follow from zero
    /// divergence and curl, so value and slope are continuous. For levels s apart, the relative error of the cubic is
    /// (k s)⁴/384 at the wavenumber k: 6e-5 for a wavelength of eight spacings.
    ///
    /// # Errors
    /// Fails at the first position without a field, or for a map that cannot be continued.
    pub(super) fn along(
        &self,
        [lat_deg, lon_deg, alt_m]: [&[f64]; 3],
        moved: &[[f64; 3]],
        core_ned_nt: &[Vector3<f64>],
    ) -> Result<Result<Vec<Vector3<f64>>, CrustalCoverageError>, ReadError> {
        let Some(first_m) = alt_m.first() else { return Ok(Ok(vec![])) };
        let least_m = self.level_m - BELOW * self.steps_m[0].min(self.steps_m[1]);
        if let Some(i) = alt_m.iter().position(|alt| alt.is_nan() || *alt < least_m) {
            return Ok(Err(CrustalCoverageError::Below(i)));
        }
        let level = alt_m.iter().all(|alt| alt == first_m) && *first_m >= self.level_m;
        let tower = if level { CrustalLevelStack::new(self, &[*first_m - self.level_m])? } else { self.tower(alt_m)? };
        let mut out = Vec::with_capacity(alt_m.len());
        for (i, (core, moved)) in core_ned_nt.iter().zip(moved).enumerate() {
            let Some(mut cell) = self.cell(lat_deg[i], lon_deg[i]) else {
                return Ok(Err(CrustalCoverageError::Off(i)));
            };
            cell.up += moved[0] / self.lat.step_deg;
            cell.right += moved[1] / self.lon.step_deg;
            let [east, north, up, rest] = tower.at(cell, alt_m[i] + moved[2] - self.level_m, self.steps_m);
            out.push(Vector3::new(north, east, -up) + core.normalize() * rest);
        }
        Ok(Ok(out))
    }

    /// The largest residual along the core field at the map's height, in nT.
    #[cfg(test)]
    pub(super) fn most_rest_nt(&self) -> f64 {
        self.rest.values.iter().fold(0.0, |most, rest| most.max(rest.abs()))
    }

    fn cell(&self, lat_deg: f64, lon_deg: f64) -> Option<CrustalMapCell> {
        let (row, up) = self.lat.locate(lat_deg)?;
        let around = [0.0, -360.0, 360.0].into_iter().find_map(|turn| self.lon.locate(lon_deg + turn));
        let (column, right) = around?;
        let known = self.known.get(row * (self.lon.len - 1) + column).copied().unwrap_or(false);
        known.then_some(CrustalMapCell { row, column, up, right })
    }

    /// The levels from the one below the lowest height to the one above the highest height.
    fn tower(&self, alt_m: &[f64]) -> Result<CrustalLevelStack, ReadError> {
        let (low, high) = alt_m.iter().fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(*x), b.max(*x)));
        let spacing_m = self.steps_m[0].min(self.steps_m[1]);
        let mut rungs_m = vec![0.0];
        while rungs_m.last().is_some_and(|top| *top < high - self.level_m) {
            let top: f64 = rungs_m.last().copied().unwrap_or(0.0);
            rungs_m.push(top + (0.5 * spacing_m).max(0.25 * top));
        }
        let below = rungs_m.iter().filter(|rung| **rung <= low - self.level_m).count();
        CrustalLevelStack::new(self, rungs_m.get(below.saturating_sub(1)..).unwrap_or(&[]))
    }

    fn level(&self, up_m: f64) -> Result<Arc<CrustalMapLevel>, ReadError> {
        let key = up_m.to_bits();
        let known = self.levels.lock().unwrap_or_else(PoisonError::into_inner).get(&key).cloned();
        if let Some(level) = known {
            return Ok(level);
        }
        // The lock is not held here, because a thread that waits for its transform may start another flight.
        let wrong = |e: numerics::maps::continuation::ContinuationError| ReadError::data(&self.path, e.to_string());
        let spectrum = MapSpectrum::new(&self.corrected, up_m, &Padding::default()).map_err(wrong)?;
        let field = spectrum.components(self.direction, up_m, 0.0).map_err(wrong)?;
        let rest = upward(&self.rest, up_m, &Padding::default()).map_err(wrong)?;
        let level = Arc::new(CrustalMapLevel::new([field.east, field.north, field.up, rest]));
        let mut levels = self.levels.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(levels.entry(key).or_insert(level).clone())
    }
}

/// The change of the magnitude of `core` if `b` is added, computed without cancellation.
pub(super) fn change_of_magnitude(core: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    (2.0 * core + b).dot(b) / ((core + b).norm() + core.norm())
}

/// Corrected map, and the remaining difference. The corrected map is the component along `direction` of a field. This
/// field changes the magnitude of the core field at each node (east, north, up; nT) by the value of the map, except for
/// the remaining difference.
fn corrected(
    map: &PlaneGrid,
    direction: [f64; 3],
    core_nt: &[Vector3<f64>],
) -> Result<(PlaneGrid, PlaneGrid), numerics::maps::continuation::ContinuationError> {
    let mut corrected = map.clone();
    let mut correction = 0;
    loop {
        let field = MapSpectrum::new(&corrected, 0.0, &Padding::default())?.components(direction, 0.0, 0.0)?;
        let lacking = |i: usize| {
            let found = Vector3::new(field.east.values[i], field.north.values[i], field.up.values[i]);
            map.values[i] - change_of_magnitude(&core_nt[i], &found)
        };
        let rest = map.with((0..map.values.len()).map(lacking).collect());
        if correction == CORRECTIONS {
            return Ok((corrected, rest));
        }
        corrected.values.iter_mut().zip(&rest.values).for_each(|(value, lacking)| *value += lacking);
        correction += 1;
    }
}

fn known_cells(map: &PlaneGrid) -> Vec<bool> {
    let cells = (1..map.rows()).flat_map(|row| (1..map.columns()).map(move |column| (row, column)));
    let known = |(row, column)| {
        let corners = [(row - 1, column - 1), (row - 1, column), (row, column - 1), (row, column)];
        corners.iter().all(|(row, column)| !map.get(*row, *column).is_nan())
    };
    cells.map(known).collect()
}

/// Crustal field at one height, as bicubic spline coefficients.
struct CrustalMapLevel {
    /// Number of nodes in a row of the table.
    width: usize,
    /// The coefficients of the natural cubic splines by rows, with one more row and column on each side.
    table: Vec<CrustalComponents>,
}

/// Crustal components at a position, and their slopes per step northward and eastward.
#[derive(Clone, Copy)]
struct CrustalSample {
    value: CrustalComponents,
    per_row: CrustalComponents,
    per_column: CrustalComponents,
}

impl CrustalMapLevel {
    fn new(quantities: [PlaneGrid; 4]) -> CrustalMapLevel {
        let (rows, columns) = (quantities[0].rows(), quantities[0].columns());
        let mut table = vec![[0.0; 4]; (rows + 2) * (columns + 2)];
        for (q, mut grid) in quantities.into_iter().enumerate() {
            natural_cubic::solve_along_rows(&mut grid.values, columns);
            grid.values.chunks_exact_mut(columns).for_each(natural_cubic::solve);
            for row in 0..rows + 2 {
                for column in 0..columns + 2 {
                    let inside = |r: usize, c: usize| grid.values[r * columns + c];
                    table[row * (columns + 2) + column][q] = natural_cubic::past_ends(row, rows, |r| {
                        natural_cubic::past_ends(column, columns, |c| inside(r, c))
                    });
                }
            }
        }
        CrustalMapLevel { width: columns + 2, table }
    }

    fn at(&self, cell: CrustalMapCell) -> CrustalSample {
        let (across, across_slope) = (natural_cubic::weights(cell.right), natural_cubic::slope_weights(cell.right));
        let (along, along_slope) = (natural_cubic::weights(cell.up), natural_cubic::slope_weights(cell.up));
        let mut jet = CrustalSample { value: [0.0; 4], per_row: [0.0; 4], per_column: [0.0; 4] };
        for (k, (along, along_slope)) in along.iter().zip(along_slope).enumerate() {
            let row = &self.table[(cell.row + k) * self.width + cell.column..][..4];
            let value = weighted(row, across);
            let slope = weighted(row, across_slope);
            for q in 0..4 {
                jet.value[q] += along * value[q];
                jet.per_row[q] += along_slope * value[q];
                jet.per_column[q] += along * slope[q];
            }
        }
        jet
    }
}

/// The weighted sum of four nodes of a row.
fn weighted(row: &[CrustalComponents], weights: [f64; 4]) -> CrustalComponents {
    row.iter().zip(weights).fold([0.0; 4], |sum, (node, weight)| std::array::from_fn(|q| sum[q] + weight * node[q]))
}

/// Crustal field at several heights, in ascending order.
struct CrustalLevelStack {
    rungs: Vec<(f64, Arc<CrustalMapLevel>)>,
}

impl CrustalLevelStack {
    fn new(map: &CrustalMap, rungs_m: &[f64]) -> Result<CrustalLevelStack, ReadError> {
        let rungs: Result<_, ReadError> = rungs_m.iter().map(|up_m| Ok((*up_m, map.level(*up_m)?))).collect();
        Ok(CrustalLevelStack { rungs: rungs? })
    }

    /// The components and the residual at a height above the map.
    fn at(&self, cell: CrustalMapCell, up_m: f64, steps_m: [f64; 2]) -> CrustalComponents {
        let over = self.rungs.partition_point(|(rung_m, _)| *rung_m <= up_m);
        let (Some((low_m, low)), Some((high_m, high))) = (self.rungs.get(over.saturating_sub(1)), self.rungs.get(over))
        else {
            return self.rungs.last().map_or([f64::NAN; 4], |(_, level)| level.at(cell).value);
        };
        let (low, below) = (low.at(cell), up_m < *low_m);
        let low_slope = vertical_slope(&low, steps_m);
        if below || over == 0 {
            // Slightly below the map.
            return std::array::from_fn(|q| low.value[q] + (up_m - low_m) * low_slope[q]);
        }
        let high = high.at(cell);
        let mut slopes = [low_slope, vertical_slope(&high, steps_m)];
        let step_m = high_m - low_m;
        slopes.iter_mut().for_each(|slope| slope[3] = (high.value[3] - low.value[3]) / step_m);
        let t = (up_m - low_m) / step_m;
        let s = 1.0 - t;
        let (a, b) = (s * s * (1.0 + 2.0 * t), t * t * (1.0 + 2.0 * s));
        let (c, d) = (s * s * t * step_m, -t * t * s * step_m);
        std::array::from_fn(|q| a * low.value[q] + b * high.value[q] + c * slopes[0][q] + d * slopes[1][q])
    }
}

/// Vertical derivatives of the components in a field without curl and sources, per metre; the residual is constant.
fn vertical_slope(jet: &CrustalSample, [north_m, east_m]: [f64; 2]) -> CrustalComponents {
    let [east, north, up] = [0, 1, 2];
    let divergence = jet.per_column[east] / east_m + jet.per_row[north] / north_m;
    [jet.per_column[up] / east_m, jet.per_row[up] / north_m, -divergence, 0.0]
}
