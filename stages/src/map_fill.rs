//! Fills the gaps of a map, from other maps and from its surroundings.

use arrow_array::RecordBatch;
use grids::{AnomalyGrid, GridHeight};
use numerics::maps::{
    combine::{BiasModel, BlendMethod, CombineOptions, CombinedMap, WeightedMap, combine},
    continuation::{Padding, masked_like, upward},
    fill::{NearestFill, NeighbourWeights, SmoothFill, nearest, smooth},
    plane_grid::{EvenAxis, PlaneGrid},
};
use schemas::{Fault, MapStage, Rule, Stage, StageOutput, StageSchema, Table, choice, stage};

use crate::{
    columns::data,
    made_map::{grids, made, whole_map, without_gaps},
};

choice! {
    /// Method that fills gaps from their surroundings.
    pub enum GapFillMethod {
        /// Mean of the nearest known nodes.
        Knn = "knn",
        /// Harmonic surface, which stays between the values around the gap.
        Harmonic = "harmonic",
        /// Surface of minimum curvature, which continues the slope at the gap's edge.
        MinimumCurvature = "minimum_curvature",
        /// None; gaps are filled only from other maps.
        None = "none",
    }
}

choice! {
    /// Form of the difference between maps that is estimated in their overlap and removed.
    pub enum MapOverlapBias {
        /// No difference.
        Nothing = "nothing",
        /// Constant difference.
        Constant = "constant",
        /// Planar difference.
        Plane = "plane",
    }
}

stage! {
    /// Fills the unknown nodes of a map, first from other maps in the order of `with`, then from the nodes around each
    /// gap.
    ///
    /// The other maps are converted to the coordinate system of the map to be filled. Lower maps are continued upward
    /// to its height. The difference between each of these maps and the map to be filled is estimated in the overlap
    /// and removed (`bias`). Values filled from the nodes around a gap contain no information about the anomaly in the
    /// gap. `minimum_curvature` is suitable for gaps of a few nodes. No method is suitable for large gaps.
    ///
    /// A map of `with` that is higher than the map to be filled is rejected. A draped map together with other maps is
    /// also rejected.
    ///
    /// Source: Briggs 1974 (`minimum_curvature`); Blakely 1996, section 12.1 (upward continuation).
    MapFill = "map_fill", version 1, grain Map, inputs [map: Map, with: ManyMaps optional],
    example r#"
[[stages]]
name   = "map_fill"
stage  = "map_fill"
map    = "map_grid"
with   = ["anomaly"]
method = "minimum_curvature"
"#;
    /// Method that fills gaps from the nodes around them: `knn`, the mean of the nearest known nodes; `harmonic`, a
    /// harmonic surface, which stays between the values around the gap; `minimum_curvature`, which continues the slope
    /// at the gap's edge; or `none`.
    method: GapFillMethod, unit "", default GapFillMethod::Knn;
    /// Number of nodes in the mean of `knn`.
    neighbours: usize, unit "1", default 3usize, rule Rule::Positive;
    /// Power in the weights 1/distance^`power` of the nodes in the mean.
    power: Option<f64>, unit "1", absent "equal weights", rule Rule::Positive;
    /// Nodes farther than this distance from the nearest known node remain unknown.
    within_m: Option<f64>, unit "m", absent "all nodes are filled", rule Rule::Positive;
    /// Width of the transition between two maps at their common edge.
    feather_m: f64, unit "m", default 1000.0, rule Rule::NotNegative;
    /// Form of the difference that is estimated in the overlap and removed from the other maps: a `constant` or a
    /// `plane`. `nothing` removes no difference.
    bias: MapOverlapBias, unit "", default MapOverlapBias::Constant;
    /// Extends the map to the combined extent of all maps.
    extend: bool, unit "", default false;
}

/// Result of filling a map.
pub struct MapFillResult {
    /// The map.
    pub map: AnomalyGrid,
    /// Notes on the processing.
    pub notes: Vec<String>,
    /// Warnings about untrustworthy results.
    pub warnings: Vec<String>,
}

impl MapFill {
    /// Rejects incompatible parameters. `others` states whether there are other maps.
    ///
    /// # Errors
    /// Fails with the parameter and the remedy if the parameters are incompatible.
    pub fn check(&self, others: bool) -> Result<(), Fault> {
        if others || !(self.extend || self.method == GapFillMethod::None) {
            return Ok(());
        }
        let (param, help) = match self.extend {
            true => ("extend", "name other maps in `with`"),
            false => ("method", "name other maps in `with`, or choose another `method`"),
        };
        Err(Fault::new("there are no other maps to fill from").help(help).of_param(param))
    }

    /// Fills the gaps of `map`, first from `others`. Each of the other maps has a name for messages.
    ///
    /// # Errors
    /// See [`MapFill`].
    pub fn apply(&self, map: &AnomalyGrid, others: &[(String, AnomalyGrid)]) -> Result<MapFillResult, Fault> {
        let (mut notes, mut warnings) = (vec![], vec![]);
        let before = map.plane().unknown();
        let mut map = map.clone();
        if !others.is_empty() {
            map = self.combined(&map, others, &mut notes, &mut warnings)?;
        }
        let filled = self.surroundings(&map.plane())?;
        notes.push(format!("{before} unknown nodes before, {} after", filled.unknown()));
        Ok(MapFillResult { map: map.with_plane_values(filled.values)?, notes, warnings })
    }

    fn surroundings(&self, plane: &PlaneGrid) -> Result<PlaneGrid, Fault> {
        let surface = |keep_slope: bool| {
            let options = SmoothFill { keep_slope, ..SmoothFill::default() };
            smooth(plane, &options).map(|(grid, _)| grid).map_err(data)
        };
        match self.method {
            GapFillMethod::None => Ok(plane.clone()),
            GapFillMethod::Harmonic => surface(false),
            GapFillMethod::MinimumCurvature => surface(true),
            GapFillMethod::Knn => {
                let weights = self.power.map_or(NeighbourWeights::Equal, NeighbourWeights::InverseDistance);
                let options = NearestFill { neighbours: self.neighbours, weights, max_distance_m: self.within_m };
                nearest(plane, &options).map_err(data)
            }
        }
    }

    /// Combination of the map with the other maps.
    fn combined(
        &self,
        map: &AnomalyGrid,
        others: &[(String, AnomalyGrid)],
        notes: &mut Vec<String>,
        warnings: &mut Vec<String>,
    ) -> Result<AnomalyGrid, Fault> {
        let GridHeight::Level(level_m) = map.height else { return Err(draped()) };
        let mut planes = vec![map.plane()];
        let (unit_x, unit_y) = map.unit_m();
        for (name, other) in others {
            let other = other.to_crs(map.crs.code(), None).map_err(|e| Fault::from(e).in_file(name))?;
            let GridHeight::Level(from_m) = other.height else { return Err(draped().in_file(name)) };
            let (east_m, north_m) = (in_metres(&other.x, unit_x), in_metres(&other.y, unit_y));
            let plane = PlaneGrid { east_m, north_m, values: other.anomaly_nt };
            let up_m = level_m - from_m;
            if up_m.is_nan() {
                warnings.push(format!(
                    "the height of the map or of {name} is unknown; both are assumed to have the same height"
                ));
            } else if up_m > 0.0 {
                notes.push(format!("{name} is continued upward by {up_m:.1} m"));
            }
            planes.push(at_level(plane, up_m).map_err(|fault| fault.in_file(name))?);
        }
        let (east_m, north_m) = match self.extend {
            true => (extended(&planes, |p| p.east_m), extended(&planes, |p| p.north_m)),
            false => (planes[0].east_m, planes[0].north_m),
        };
        let bias = match self.bias {
            MapOverlapBias::Nothing => BiasModel::Nothing,
            MapOverlapBias::Constant => BiasModel::Constant,
            MapOverlapBias::Plane => BiasModel::Plane,
        };
        let options = CombineOptions { blend: BlendMethod::Priority, feather_m: self.feather_m, bias };
        let pieces: Vec<WeightedMap> = planes.iter().map(|grid| WeightedMap { grid, weight: 1.0 }).collect();
        let done = combine(&pieces, east_m, north_m, &options).map_err(data)?;
        notes.extend(compared(others, &done));
        Ok(map.with_plane(done.grid, GridHeight::Level(level_m))?)
    }
}

fn draped() -> Fault {
    let help = "continue the map to a level first with `map_continue`";
    Fault::data("a draped map cannot be combined with others").help(help)
}

fn compared(others: &[(String, AnomalyGrid)], done: &CombinedMap) -> Vec<String> {
    let name = |i: usize| i.checked_sub(1).and_then(|i| others.get(i)).map_or("the map", |(name, _)| name.as_str());
    let one = |o: &numerics::maps::combine::MapOverlap| {
        format!(
            "{} minus {} at {} nodes: median {:.2} nT, rms {:.2} nT; after levelling {:.2} and {:.2} nT",
            name(o.first),
            name(o.second),
            o.before.count,
            o.before.median,
            o.before.rms,
            o.after.median,
            o.after.rms
        )
    };
    done.overlaps.iter().map(one).collect()
}

/// Map continued upward by `up_m` to the height of another map. Unchanged if a height is unknown.
fn at_level(plane: PlaneGrid, up_m: f64) -> Result<PlaneGrid, Fault> {
    if up_m < 0.0 {
        let fault = Fault::data(format!("the map is {:.0} m above the map whose gaps it fills", -up_m));
        return Err(fault.help(
            "continue this map downward first with `map_continue`, or fill the gaps of this map from the lower map",
        ));
    }
    if up_m.is_nan() || up_m == 0.0 {
        return Ok(plane);
    }
    let full = without_gaps(&plane).map_err(data)?;
    let up = upward(&full, up_m, &Padding::default()).map_err(data)?;
    Ok(masked_like(up, &plane))
}

fn in_metres(axis: &EvenAxis, unit_m: f64) -> EvenAxis {
    EvenAxis { first: axis.first * unit_m, step: axis.step * unit_m, len: axis.len }
}

/// Axis of the first map, extended to the limits of all maps.
fn extended(planes: &[PlaneGrid], of: impl Fn(&PlaneGrid) -> EvenAxis) -> EvenAxis {
    let own = of(&planes[0]);
    let first = planes.iter().map(|p| of(p).first).fold(own.first, f64::min);
    let last = planes.iter().map(|p| of(p).last()).fold(own.last(), f64::max);
    let before = ((own.first - first) / own.step).floor();
    let after = ((last - own.last()) / own.step).floor();
    EvenAxis { first: own.at(-before), step: own.step, len: own.len + before as usize + after as usize }
}

impl Stage for MapFill {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        self.check(inputs.len() > 1).map_err(|fault| vec![fault])?;
        Ok(schemas::map::yields(schemas::map::ANOMALY_UNIT, vec![whole_map(); inputs.len()]))
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        let of_knn = ["neighbours", "power", "within_m"].contains(&key) && self.method != GapFillMethod::Knn;
        let what = format!("`{key}` belongs to the method `knn`, not to `{}`", self.method.word());
        of_knn.then(|| Fault::new(what).help(format!("remove `{key}`, or set `method = \"knn\"`")))
    }
}

impl MapStage for MapFill {
    fn run(&self, maps: &[RecordBatch]) -> Result<StageOutput, Fault> {
        let mut all = grids(maps)?.into_iter();
        let map = all.next().ok_or_else(|| Fault::bug("a stage that works on maps has no map"))?;
        let others: Vec<(String, AnomalyGrid)> =
            all.enumerate().map(|(i, other)| (format!("map {} of `with`", i + 1), other)).collect();
        let filled = self.apply(&map, &others)?;
        made(&filled.map, filled.warnings)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::made_map::testing::{NODES, field_nt, map, middle};

    fn fill(method: GapFillMethod) -> MapFill {
        MapFill {
            method,
            neighbours: 3,
            power: None,
            within_m: None,
            feather_m: 0.0,
            bias: MapOverlapBias::Constant,
            extend: false,
        }
    }

    fn holed() -> AnomalyGrid {
        let mut map = map();
        (20..23).for_each(|row| (24..27).for_each(|column| map.anomaly_nt[row * NODES + column] = f64::NAN));
        map
    }

    fn worst(map: &AnomalyGrid) -> f64 {
        middle(map).iter().map(|(e, n, v)| (v - field_nt(*e, *n, 0.0)).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn law_minimum_curvature_fills_small_gaps_best() {
        let curvature = worst(&fill(GapFillMethod::MinimumCurvature).apply(&holed(), &[]).unwrap().map);
        let harmonic = worst(&fill(GapFillMethod::Harmonic).apply(&holed(), &[]).unwrap().map);
        // The gap spans a fifth of a wavelength, and the field has an amplitude of 100 nT.
        assert!(curvature < 8.0 && curvature < harmonic, "{curvature} {harmonic}");
        let near = MapFill { within_m: Some(100.0), ..fill(GapFillMethod::Knn) }.apply(&holed(), &[]).unwrap();
        assert!(near.map.anomaly_nt[21 * NODES + 25].is_nan() && !near.map.anomaly_nt[20 * NODES + 24].is_nan());
    }

    #[test]
    fn law_another_map_fills_a_gap_at_the_height_of_the_map() {
        let mut other = map();
        other.anomaly_nt.iter_mut().for_each(|v| *v += 40.0);
        let filled = fill(GapFillMethod::None).apply(&holed(), &[("other".to_owned(), other.clone())]).unwrap();
        assert!(worst(&filled.map) < 1e-6, "{}", worst(&filled.map));
        let kept = MapFill { bias: MapOverlapBias::Nothing, ..fill(GapFillMethod::None) };
        let kept = kept.apply(&holed(), &[("other".to_owned(), other.clone())]).unwrap();
        assert!((worst(&kept.map) - 40.0).abs() < 1e-6);
        let higher = AnomalyGrid { height: GridHeight::Level(900.0), ..other };
        let refused = fill(GapFillMethod::None).apply(&holed(), &[("other".to_owned(), higher)]).err().unwrap();
        assert!(refused.to_string().contains("600 m above"), "{refused}");
    }
}
