//! Converts a map to another coordinate system or extent.

use std::ops::Range;

use arrow_array::RecordBatch;
use grids::{AnomalyGrid, GridHeight};
use numerics::maps::{continuation::expand, plane_grid::EvenAxis};
use schemas::{Fault, MapStage, Rule, Stage, StageOutput, StageSchema, Table, stage};

use crate::{
    columns::data,
    made_map::{grids, made, whole_map},
};

stage! {
    /// Resamples a map to another coordinate system or spacing, crops it, or extends it periodically. The operations
    /// run in the order of the parameters.
    ///
    /// Use `map_convert` to bring maps onto one grid, or to remove the edges of a continued map. Resampling uses
    /// polynomials of degree nine, and of lower degree near edges and unknown nodes. A node within two nodes of an
    /// unknown node becomes unknown. Stages that interpolate a map also project the positions, so a map need not be
    /// converted for these stages.
    ///
    /// Bounds outside the map are rejected. The periodic extension of a map that is draped or has gaps is also
    /// rejected.
    MapConvert = "map_convert", version 1, grain Map, inputs [map: Map],
    example r#"
[[stages]]
name    = "map_convert"
stage   = "map_convert"
map     = "map_continue"
to_epsg = 32632
spacing = 300.0
trim    = true
"#;
    /// EPSG code of the coordinate system to which the map is resampled, such as 4326 or 32754.
    to_epsg: Option<usize>, unit "", absent "the map's own coordinate system", rule Rule::Between(1.0, 65535.0);
    /// Distance between nodes, in the unit of the coordinate system: metres, feet or degrees.
    spacing: Option<f64>, unit "", absent "a spacing no larger than the spacing of the map", rule Rule::Positive;
    /// Bounds of the part to keep: west, south, east and north, in the new coordinate system.
    bounds: Option<Vec<f64>>, unit "", absent "the whole map";
    /// Removes rows and columns without values at the edges.
    trim: bool, unit "", default false;
    /// Extends the map periodically, by at least this number of nodes on each side, to sizes without a prime factor
    /// above 7.
    expand_nodes: Option<usize>, unit "1", absent "no periodic extension";
}

/// Four coordinates as west, south, east and north.
///
/// # Errors
/// Fails unless there are four coordinates, west is below east, and south is below north.
pub fn bounds_of(bounds: &[f64]) -> Result<[f64; 4], Fault> {
    match *bounds {
        [west, south, east, north] if west < east && south < north => Ok([west, south, east, north]),
        [_, _, _, _] => Err(Fault::new("west and south in `bounds` must be below east and north")),
        _ => Err(Fault::new("`bounds` must be four numbers: west, south, east, north")),
    }
    .map_err(|fault: Fault| fault.of_param("bounds"))
}

impl MapConvert {
    /// Rejects invalid parameters, independent of the map.
    ///
    /// # Errors
    /// Fails with the parameter and the reason if a parameter is invalid.
    pub fn check(&self) -> Result<(), Fault> {
        self.bounds.as_deref().map(bounds_of).transpose().map(|_| ())
    }

    /// Converts a map.
    ///
    /// # Errors
    /// See [`MapConvert`].
    pub fn apply(&self, map: &AnomalyGrid) -> Result<AnomalyGrid, Fault> {
        self.check()?;
        let mut map = map.clone();
        if self.to_epsg.is_some() || self.spacing.is_some() {
            let epsg = self.to_epsg.map_or(Some(map.crs.code()), |code| u16::try_from(code).ok());
            let epsg = epsg.ok_or_else(|| Fault::new("`to_epsg` is not an EPSG code").of_param("to_epsg"))?;
            map = map.to_crs(epsg, self.spacing)?;
        }
        if let Some(bounds) = &self.bounds {
            let [west, south, east, north] = bounds_of(bounds)?;
            map = cut(&map, within(&map.y, south, north), within(&map.x, west, east))?;
        }
        if self.trim {
            let (rows, columns) = known_box(&map);
            map = cut(&map, rows, columns)?;
        }
        match self.expand_nodes {
            Some(nodes) => expanded(&map, nodes),
            None => Ok(map),
        }
    }
}

/// Indices of the nodes of an axis between two coordinates.
fn within(axis: &EvenAxis, low: f64, high: f64) -> Range<usize> {
    let inside = |i: &usize| (low..=high).contains(&axis.at(*i as f64));
    let first = (0..axis.len).find(inside).unwrap_or(axis.len);
    let after = (0..axis.len).rev().find(inside).map_or(first, |i| i + 1);
    first..after
}

/// Rows and columns from the first to the last with a value.
fn known_box(map: &AnomalyGrid) -> (Range<usize>, Range<usize>) {
    let known = |row: usize, column: usize| !map.anomaly_nt[row * map.x.len + column].is_nan();
    let rows: Vec<usize> = (0..map.y.len).filter(|j| (0..map.x.len).any(|i| known(*j, i))).collect();
    let columns: Vec<usize> = (0..map.x.len).filter(|i| (0..map.y.len).any(|j| known(j, *i))).collect();
    let range = |of: &[usize]| of.first().copied().unwrap_or(0)..of.last().map_or(0, |last| last + 1);
    (range(&rows), range(&columns))
}

/// Part of a map in some rows and columns.
fn cut(map: &AnomalyGrid, rows: Range<usize>, columns: Range<usize>) -> Result<AnomalyGrid, Fault> {
    if rows.len() < 2 || columns.len() < 2 {
        let extent = |a: &EvenAxis| format!("{} to {}", a.first, a.last());
        let help = format!("the map covers {} eastward and {} northward", extent(&map.x), extent(&map.y));
        return Err(Fault::data("the bounds contain no node of the map").help(help));
    }
    let part = |axis: &EvenAxis, of: &Range<usize>| EvenAxis {
        first: axis.at(of.start as f64),
        step: axis.step,
        len: of.len(),
    };
    let of = |values: &[f64]| -> Vec<f64> {
        let row = |j: usize| &values[j * map.x.len + columns.start..j * map.x.len + columns.end];
        rows.clone().flat_map(|j| row(j).to_vec()).collect()
    };
    let height = match &map.height {
        GridHeight::Level(alt_m) => GridHeight::Level(*alt_m),
        GridHeight::Cells(cells) => GridHeight::Cells(of(cells)),
    };
    let (x, y) = (part(&map.x, &columns), part(&map.y, &rows));
    let cut = AnomalyGrid { x, y, anomaly_nt: of(&map.anomaly_nt), error_nt: None, height, ..map.clone() };
    if cut.anomaly_nt.iter().all(|v| v.is_nan()) {
        return Err(Fault::data("no node within the bounds has a value").of_param("bounds"));
    }
    Ok(cut)
}

fn expanded(map: &AnomalyGrid, nodes: usize) -> Result<AnomalyGrid, Fault> {
    let GridHeight::Level(alt_m) = map.height else {
        let fault = Fault::data("a draped map cannot be extended periodically");
        return Err(fault.help("continue the map to a level first with `map_continue`"));
    };
    let plane = map.plane();
    if plane.unknown() > 0 {
        let fault = Fault::data("a map with gaps cannot be extended periodically");
        return Err(fault.help("fill the map first with `map_fill`"));
    }
    let (wide, _) = expand(&plane, nodes).map_err(data)?;
    Ok(map.with_plane(wide, GridHeight::Level(alt_m))?)
}

impl Stage for MapConvert {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        self.check().map_err(|fault| vec![fault])?;
        if let Some(code) = self.to_epsg.and_then(|code| u16::try_from(code).ok()) {
            let known = grids::Crs::from_epsg(std::path::Path::new(""), code);
            known.map_err(|e| vec![Fault { place: Default::default(), ..Fault::from(e) }.of_param("to_epsg")])?;
        }
        Ok(schemas::map::yields(schemas::map::ANOMALY_UNIT, vec![whole_map(); inputs.len()]))
    }
}

impl MapStage for MapConvert {
    fn run(&self, maps: &[RecordBatch]) -> Result<StageOutput, Fault> {
        let maps = grids(maps)?;
        let map = maps.first().ok_or_else(|| Fault::bug("a stage that works on maps has no map"))?;
        made(&self.apply(map)?, vec![])
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::made_map::testing::{NODES, STEP_M, map};

    const AS_IT_IS: MapConvert =
        MapConvert { to_epsg: None, spacing: None, bounds: None, trim: false, expand_nodes: None };

    #[test]
    fn unit_a_cut_map_keeps_the_positions_of_its_nodes() {
        let bounds = Some(vec![500_950.0, 5_000_000.0, 502_000.0, 5_000_300.0]);
        let cut = MapConvert { bounds, ..AS_IT_IS }.apply(&map()).unwrap();
        assert_eq!((cut.x.first, cut.x.len, cut.y.first, cut.y.len), (501_000.0, 11, 5_000_000.0, 4));
        assert_eq!(cut.anomaly_nt[11], map().anomaly_nt[NODES + 10]);
        let mut edged = map();
        (0..NODES).for_each(|i| edged.anomaly_nt[i] = f64::NAN);
        let trimmed = MapConvert { trim: true, ..AS_IT_IS }.apply(&edged).unwrap();
        assert_eq!((trimmed.y.first, trimmed.y.len, trimmed.x.len), (5_000_000.0 + STEP_M, NODES - 1, NODES));
    }

    #[test]
    fn gold_impossible_conversions_are_rejected_with_the_reason() {
        let refused =
            |stage: MapConvert, map: &AnomalyGrid| stage.apply(map).err().map(|f| f.to_string()).unwrap_or_default();
        let of = |bounds: &[f64]| MapConvert { bounds: Some(bounds.to_vec()), ..AS_IT_IS };
        assert!(refused(of(&[0.0, 0.0, 1.0, 1.0]), &map()).contains("the bounds contain no node"));
        assert!(refused(of(&[1.0, 0.0, 0.0, 1.0]), &map()).contains("must be below"));
        assert!(refused(of(&[1.0]), &map()).contains("four numbers"));
        let mut holed = map();
        holed.anomaly_nt[7] = f64::NAN;
        assert!(refused(MapConvert { expand_nodes: Some(4), ..AS_IT_IS }, &holed).contains("gaps"));
    }
}
