//! The mean of the nearest known nodes.

use super::edge::{edge_nodes, reach};
use super::{FillError, check};
use crate::numerics::plane_grid::PlaneGrid;
use kiddo::{ImmutableKdTree, QueryResultItem, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZeroUsize;

/// How the nearest nodes are averaged.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Weights {
    /// All alike, as MagNav.jl does.
    #[default]
    Equal,
    /// Each by its distance to minus this power, above zero. [Shepard 1968]
    InverseDistance(f64),
}

/// How gaps are filled from the nearest nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearestFill {
    /// How many known nodes make a value.
    pub neighbours: usize,
    /// How they are averaged.
    pub weights: Weights,
    /// A node stays unknown when its nearest known node is farther away than this, in metres.
    pub max_distance_m: Option<f64>,
}

impl Default for NearestFill {
    /// Three neighbours of equal weight, however far: MagNav.jl's `map_fill`.
    fn default() -> Self {
        Self { neighbours: 3, weights: Weights::Equal, max_distance_m: None }
    }
}

/// Gives each unknown node the mean of its nearest known nodes, by distance in metres; of nodes as far as each other
/// the southernmost, then the westernmost come first. With fewer known nodes than neighbours all are taken. The same
/// bits on any number of threads.
///
/// # Errors
/// Where the map is not well formed or knows nothing, or a parameter is out of its range.
pub fn nearest(grid: &PlaneGrid, options: &NearestFill) -> Result<PlaneGrid, FillError> {
    check(grid)?;
    let neighbours = NonZeroUsize::new(options.neighbours).ok_or(FillError::NoNeighbours)?;
    check_options(options)?;
    let (east_m, north_m) = (grid.east_m.step, grid.north_m.step);
    let edge = edge_nodes(grid, reach(options.neighbours, east_m, north_m));
    if edge.is_empty() {
        return Ok(grid.clone());
    }
    let search = Search::new(grid, edge, neighbours, *options)?;
    let width = grid.columns();
    let mut values = grid.values.clone();
    values.par_chunks_exact_mut(width).enumerate().for_each(|(row, values)| {
        let mut found = Vec::new();
        for (column, value) in values.iter_mut().enumerate().filter(|(_, value)| value.is_nan()) {
            *value = search.value(row, column, &mut found);
        }
    });
    Ok(grid.with(values))
}

fn check_options(options: &NearestFill) -> Result<(), FillError> {
    let above_zero = |name, value: f64| {
        if value > 0.0 { Ok(()) } else { Err(FillError::Parameter { name, value }) }
    };
    if let Weights::InverseDistance(power) = options.weights {
        above_zero("the power of the distance", power)?;
    }
    options.max_distance_m.map_or(Ok(()), |far| above_zero("the maximum distance", far))
}

/// The tree of the nodes at the edge of the gaps.
struct Search<'a> {
    grid: &'a PlaneGrid,
    edge: Vec<usize>,
    tree: ImmutableKdTree<f64, 2>,
    /// How many the answer takes.
    take: usize,
    /// One more than that, which tells a tie.
    ask: NonZeroUsize,
    /// A step northward, in steps eastward.
    aspect: f64,
    options: NearestFill,
}

impl<'a> Search<'a> {
    fn new(
        grid: &'a PlaneGrid,
        edge: Vec<usize>,
        neighbours: NonZeroUsize,
        options: NearestFill,
    ) -> Result<Self, FillError> {
        let (width, aspect) = (grid.columns(), grid.north_m.step / grid.east_m.step);
        let places: Vec<[f64; 2]> =
            edge.iter().map(|node| [(node % width) as f64, (node / width) as f64 * aspect]).collect();
        let tree = ImmutableKdTree::new_from_slice(&places).map_err(|_| FillError::TooMany { nodes: edge.len() })?;
        Ok(Self { grid, edge, tree, take: neighbours.get(), ask: neighbours.saturating_add(1), aspect, options })
    }

    /// The value of an unknown node; `found` is memory to work in.
    fn value(&self, row: usize, column: usize, found: &mut Vec<(f64, usize)>) -> f64 {
        self.nearest(row, column, found);
        let step_m = self.grid.east_m.step;
        let too_far = |squared: f64| self.options.max_distance_m.is_some_and(|far| squared.sqrt() * step_m > far);
        if found.first().is_none_or(|(squared, _)| too_far(*squared)) {
            return f64::NAN;
        }
        let weight = |squared: f64| match self.options.weights {
            Weights::Equal => 1.0,
            // Relative to the nearest, so that no power overflows.
            Weights::InverseDistance(power) => (found[0].0 / squared).powf(0.5 * power),
        };
        let (mut sum, mut weights) = (0.0, 0.0);
        for (squared, node) in found.iter() {
            sum += weight(*squared) * self.grid.values[*node];
            weights += weight(*squared);
        }
        sum / weights
    }

    /// The nearest nodes with their squared distances in steps eastward, nearest first.
    fn nearest(&self, row: usize, column: usize, found: &mut Vec<(f64, usize)>) {
        let place = [column as f64, row as f64 * self.aspect];
        // What the tree says of distances is good to rounding; the order is made by distances that do not depend on
        // where the nodes are in the grid.
        const ROUNDING: f64 = 1e-9;
        let query = self.tree.query(&place).nearest_n::<SquaredEuclidean<f64>>(self.ask).execute();
        let reach = query.get(self.take - 1).map(|last| last.distance * (1.0 + ROUNDING));
        match (reach, query.get(self.take)) {
            (Some(reach), Some(next)) if next.distance <= reach => {
                let tied = self.tree.query(&place).within::<SquaredEuclidean<f64>>(reach).execute();
                self.order(row, column, &tied, found);
            }
            _ => self.order(row, column, &query, found),
        }
        found.truncate(self.take);
    }

    fn order(&self, row: usize, column: usize, query: &[QueryResultItem<(), u32, f64>], found: &mut Vec<(f64, usize)>) {
        let width = self.grid.columns();
        found.clear();
        found.extend(query.iter().map(|item| {
            let node = self.edge[item.item as usize];
            let east = (node % width).abs_diff(column) as f64;
            let north = (node / width).abs_diff(row) as f64 * self.aspect;
            (east * east + north * north, node)
        }));
        found.sort_unstable_by(|one, other| one.0.total_cmp(&other.0).then(one.1.cmp(&other.1)));
    }
}
