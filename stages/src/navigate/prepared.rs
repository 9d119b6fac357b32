//! The map of a navigation: at its own height, at given heights, or at the heights of each line.

use std::sync::{Arc, Mutex, PoisonError};

use arrow_array::RecordBatch;
use numerics::maps::{map_stack::FieldMap, map_surface::MapInterpolation};
use schemas::Fault;

use super::{CalibrationPrior, Navigate};
use crate::{
    columns::floats,
    map_errors::{MapErrors, NodeErrorSource},
    maps::field_map,
};

/// Map and models.
pub struct NavigationResources {
    pub(super) map: Option<NavigationMaps>,
    pub(super) models: Vec<CalibrationPrior>,
}

/// A map that is continued to the heights of the lines. Computed levels are cached.
pub(super) struct NavigationMaps {
    table: RecordBatch,
    interpolation: MapInterpolation,
    /// Levels of `map_levels_m`.
    levels_m: Option<Vec<f64>>,
    node_error: NodeErrorSource,
    ladder: Option<MapHeightLevels>,
    made: Mutex<Vec<CachedMap>>,
}

/// Levels of a continued map, and the map.
type CachedMap = (Option<Vec<f64>>, Arc<NavigationMap>);

/// A map with its errors.
pub(crate) struct NavigationMap {
    pub(crate) field: FieldMap,
    pub(super) errors: MapErrors,
}

/// Heights to which a map is continued on demand.
#[derive(Clone, Copy, Debug, PartialEq)]
struct MapHeightLevels {
    /// The map's own height, in metres above the ellipsoid.
    own_m: f64,
    /// Length of a cell of the map, in metres.
    cell_m: f64,
    /// Largest height bias in either direction for which the map is continued, in metres.
    reach_m: f64,
}

/// The map is not continued to a height that differs from the map's own height by less than this number of cells.
const SAME_HEIGHT: f64 = 0.05;
/// Vertical distance between two levels, in cells of the map.
const SPACING: f64 = 0.25;
/// Maximum downward continuation, in cells. Downward continuation by n cells multiplies the amplitude of the map's
/// shortest wavelength by e^(pi n).
const DOWNWARD: f64 = 1.0;
/// Maximum number of cached maps. Without a limit, lines at many heights would fill the memory.
const MOST_KEPT: usize = 8;
/// Maximum number of levels per line.
const MOST_LEVELS: f64 = 24.0;
/// Distance below and above a line to which the map is continued to search for a height bias, in metres. It is four
/// prior standard deviations of the bias, because the first estimates may be far from the bias, and a height outside
/// the levels has no prediction.
const SEARCHED_M: f64 = 200.0;
/// Maximum number of nodes on all levels of a map for this search, which limits the memory.
const MOST_SEARCHED_NODES: usize = 10_000_000;

impl MapHeightLevels {
    /// Levels for a line between two heights, in metres. There are no levels if the map's own height is close enough,
    /// and there is one level for level flight.
    fn levels_m(&self, low_m: f64, high_m: f64) -> Option<Vec<f64>> {
        let Self { own_m, cell_m, reach_m } = *self;
        let (near, lowest_m) = (SAME_HEIGHT * cell_m, own_m - DOWNWARD * cell_m);
        let (low_m, high_m) = ((low_m - reach_m).max(lowest_m.min(low_m)), high_m + reach_m);
        let within = (own_m - low_m).abs() <= near && (high_m - own_m).abs() <= near;
        if within || low_m < lowest_m || !(low_m.is_finite() && high_m.is_finite()) {
            return None;
        }
        if high_m - low_m <= 2.0 * near {
            // Lines of similar height share a level.
            return Some(vec![own_m + ((0.5 * (low_m + high_m) - own_m) / near).round() * near]);
        }
        let spacing_m = (SPACING * cell_m).max((high_m - low_m) / (MOST_LEVELS - 2.0));
        let (from, to) = (((low_m - own_m) / spacing_m).floor(), ((high_m - own_m) / spacing_m).ceil());
        Some((0..=(to - from) as usize).map(|k| own_m + spacing_m * (from + k as f64)).collect())
    }
}

impl NavigationMaps {
    /// Prepares the map of a table for a navigation.
    ///
    /// # Errors
    /// Fails in the cases of [`field_map`] and [`MapErrors::new`].
    pub(super) fn new(table: &RecordBatch, stage: &Navigate) -> Result<Self, Fault> {
        let node_error = stage.node_error(table);
        let mut maps = Self {
            table: table.clone(),
            interpolation: stage.interpolation(),
            levels_m: stage.field.map_levels_m.clone(),
            node_error,
            ladder: None,
            made: Mutex::default(),
        };
        let own = maps.at(None)?;
        let own_m = level_m(floats(table, "alt")?);
        maps.ladder = own_m
            .filter(|_| stage.field.map_levels_m.is_none() && stage.is_auto())
            .map(|own_m| MapHeightLevels { own_m, cell_m: own.errors.cell_m(), reach_m: stage.height_reach_m() });
        Ok(maps)
    }

    /// Map for a line at these heights, in metres above the ellipsoid.
    ///
    /// # Errors
    /// Fails in the cases of [`field_map`].
    pub(super) fn for_heights(&self, alt_m: &[f64]) -> Result<Arc<NavigationMap>, Fault> {
        let (low_m, high_m) = ends(alt_m);
        self.at(self.ladder.and_then(|ladder| ladder.levels_m(low_m, high_m)))
    }

    /// Map that is also continued below and above a line at these heights, to search for a height bias. `None` for
    /// given levels, a map of unknown height, or a map that is too large.
    ///
    /// # Errors
    /// Fails in the cases of [`field_map`].
    pub(super) fn around_heights(&self, alt_m: &[f64]) -> Result<Option<Arc<NavigationMap>>, Fault> {
        let Some(ladder) = self.ladder else { return Ok(None) };
        let (low_m, high_m) = ends(alt_m);
        let levels = MapHeightLevels { reach_m: SEARCHED_M, ..ladder }.levels_m(low_m, high_m);
        let fits = |levels: &Vec<f64>| levels.len() * self.table.num_rows() <= MOST_SEARCHED_NODES;
        levels.filter(fits).map(|levels| self.at(Some(levels))).transpose()
    }

    fn at(&self, levels_m: Option<Vec<f64>>) -> Result<Arc<NavigationMap>, Fault> {
        let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, map)) = made.iter().find(|(of, _)| *of == levels_m) {
            return Ok(map.clone());
        }
        let levels = levels_m.as_ref().or(self.levels_m.as_ref());
        let field = field_map(&self.table, self.interpolation, levels.map(Vec::as_slice))?;
        let bilinear = self.interpolation == MapInterpolation::Linear;
        let errors = MapErrors::new(&self.table, levels.map(Vec::as_slice), bilinear, self.node_error)?;
        let map = Arc::new(NavigationMap { field, errors });
        if made.len() >= MOST_KEPT {
            made.remove(0);
        }
        made.push((levels_m, map.clone()));
        Ok(map)
    }
}

/// Lowest and highest of the finite heights.
fn ends(alt_m: &[f64]) -> (f64, f64) {
    let finite = || alt_m.iter().copied().filter(|alt| alt.is_finite());
    (finite().fold(f64::INFINITY, f64::min), finite().fold(f64::NEG_INFINITY, f64::max))
}

/// Height of a level map; `None` for a draped map or an unknown height.
fn level_m(alt_m: &[f64]) -> Option<f64> {
    let first = alt_m.first().copied().filter(|alt| alt.is_finite())?;
    alt_m.iter().all(|alt| *alt == first).then_some(first)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const MAP: MapHeightLevels = MapHeightLevels { own_m: 500.0, cell_m: 100.0, reach_m: 0.0 };

    #[test]
    fn unit_a_line_has_the_levels_around_its_heights() {
        assert_eq!(MAP.levels_m(497.0, 504.0), None);
        assert_eq!(MAP.levels_m(899.0, 903.0), Some(vec![900.0]));
        let levels = MAP.levels_m(590.0, 701.0).unwrap();
        assert!(levels[0] <= 590.0 && *levels.last().unwrap() >= 701.0, "{levels:?}");
        assert!(levels.windows(2).all(|pair| (pair[1] - pair[0] - 25.0).abs() < 1e-9), "{levels:?}");
        assert!(MAP.levels_m(600.0, 6000.0).unwrap().len() <= 25);
        // Downward continuation by more than a cell would amplify noise.
        assert_eq!(MAP.levels_m(390.0, 420.0), None);
        assert!(MAP.levels_m(420.0, 440.0).is_some());
        assert_eq!(MAP.levels_m(f64::INFINITY, f64::NEG_INFINITY), None);
    }

    #[test]
    fn unit_a_height_bias_has_levels_within_its_reach() {
        let levels = MapHeightLevels { reach_m: 80.0, ..MAP }.levels_m(500.0, 500.0).unwrap();
        assert!(levels[0] <= 420.0 && *levels.last().unwrap() >= 580.0, "{levels:?}");
        // At most one level is below the lowest height, and the levels contain the line.
        let levels = MapHeightLevels { reach_m: 500.0, ..MAP }.levels_m(450.0, 500.0).unwrap();
        assert!(levels[0] <= 400.0 && levels[1] > 400.0 && *levels.last().unwrap() >= 1000.0, "{levels:?}");
        assert_eq!(MapHeightLevels { reach_m: 80.0, ..MAP }.levels_m(390.0, 420.0), None);
    }

    #[test]
    fn unit_a_draped_map_has_no_level() {
        assert_eq!(level_m(&[300.0, 300.0]), Some(300.0));
        assert_eq!((level_m(&[300.0, 301.0]), level_m(&[f64::NAN, f64::NAN])), (None, None));
    }
}
