//! A map at the nodes of another grid.

use crate::maps::map_surface::{CellPosition, GridInterpolant, GridShape, MapInterpolation};
use crate::maps::plane_grid::{EvenAxis, PlaneGrid};
use rayon::prelude::*;

/// Two nodes are identical if their distance is below this fraction of a step.
const SAME: f64 = 1e-6;

/// Values of `map` at the nodes of `target`, by the natural bicubic spline; NaN off the map and in a cell with an
/// unknown node. A target node at a node of the map has the value of that node. A target node on a grid line of the map
/// requires only the two nodes on that line.
pub(super) fn resampled(map: &PlaneGrid, target: &PlaneGrid) -> Vec<f64> {
    let places = |axis: &EvenAxis, of: &EvenAxis| -> Vec<Option<AxisPosition>> {
        (0..of.len).map(|node| AxisPosition::on(axis, of.at(node as f64))).collect()
    };
    let (across, along) = (places(&map.east_m, &target.east_m), places(&map.north_m, &target.north_m));
    let on_nodes = across.iter().chain(&along).flatten().all(|place| place.on_node());
    let spline = (!on_nodes).then(|| MapSpline::from_map(map));
    let mut values = vec![f64::NAN; across.len() * along.len()];
    values.par_chunks_exact_mut(across.len()).zip(along).for_each(|(out, up)| {
        let Some(up) = up else { return };
        for (out, right) in out.iter_mut().zip(&across) {
            *out = right.and_then(|right| value(map, spline.as_ref(), up, right)).unwrap_or(f64::NAN);
        }
    });
    values
}

/// Position on an axis: a cell and the fraction of a step within it.
#[derive(Clone, Copy)]
struct AxisPosition {
    cell: usize,
    part: f64,
}

impl AxisPosition {
    fn on(axis: &EvenAxis, coordinate: f64) -> Option<Self> {
        let node = axis.node(coordinate);
        let last = (axis.len - 1) as f64;
        if !(node >= -SAME && node <= last + SAME) {
            return None;
        }
        let nearest = node.round();
        let node = if (node - nearest).abs() < SAME { nearest } else { node };
        let cell = (node as usize).min(axis.len - 2);
        Some(Self { cell, part: node - cell as f64 })
    }

    fn on_node(&self) -> bool {
        self.part == 0.0 || self.part == 1.0
    }

    /// The nodes between which the value at this position is interpolated.
    fn needs(&self) -> impl Iterator<Item = usize> + use<> {
        let (lower, upper) = (self.part < 1.0, self.part > 0.0);
        let cell = self.cell;
        lower.then_some(cell).into_iter().chain(upper.then_some(cell + 1))
    }
}

fn value(map: &PlaneGrid, spline: Option<&MapSpline>, up: AxisPosition, right: AxisPosition) -> Option<f64> {
    let mut needs = up.needs().flat_map(|row| right.needs().map(move |column| (row, column)));
    if up.on_node() && right.on_node() {
        let (row, column) = needs.next()?;
        return Some(map.get(row, column));
    }
    if needs.any(|(row, column)| map.get(row, column).is_nan()) {
        return None;
    }
    let cell = CellPosition { row: up.cell, column: right.cell, up: up.part, right: right.part };
    Some(spline?.0.at(cell)?.value[0])
}

/// Spline through a map with filled gaps, so that values also exist next to a gap.
struct MapSpline(GridInterpolant<1>);

impl MapSpline {
    fn from_map(map: &PlaneGrid) -> Self {
        let shape = GridShape { rows: map.rows(), columns: map.columns(), closed: false };
        Self(GridInterpolant::over_gaps(shape, &map.values, MapInterpolation::Cubic))
    }
}
