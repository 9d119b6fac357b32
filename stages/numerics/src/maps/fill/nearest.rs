//! The mean of the nearest known nodes.

use super::edge::edge_nodes;
use super::{FillError, check};
use crate::maps::plane_grid::PlaneGrid;
use kiddo::{ImmutableKdTree, QueryResultItem, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZeroUsize;

/// Weights of the nearest nodes in the average.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum NeighbourWeights {
    /// Uniform weights, as in MagNav.jl.
    #[default]
    Equal,
    /// Inverse of the distance raised to this exponent, which is above zero. [Shepard 1968]
    InverseDistance(f64),
}

/// Settings for filling gaps from the nearest nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearestFill {
    /// The number of known nodes in a mean.
    pub neighbours: usize,
    /// Averaging of the nodes.
    pub weights: NeighbourWeights,
    /// Maximum distance in metres to the nearest known node; beyond this distance a node remains unknown.
    pub max_distance_m: Option<f64>,
}

impl Default for NearestFill {
    /// Three neighbours of equal weight, at any distance: MagNav.jl's `map_fill`.
    fn default() -> Self {
        Self { neighbours: 3, weights: NeighbourWeights::Equal, max_distance_m: None }
    }
}

/// Replaces each unknown node by the mean of its nearest known nodes, by distance in metres. Among nodes at equal
/// distance, the southernmost, then the westernmost come first. If there are fewer known nodes than neighbours, all
/// known nodes are used. Results are bit-identical for any number of threads.
///
/// # Errors
/// Fails if the map is invalid or has no known node, or if a parameter is out of its valid range.
pub fn nearest(grid: &PlaneGrid, options: &NearestFill) -> Result<PlaneGrid, FillError> {
    check(grid)?;
    let neighbours = NonZeroUsize::new(options.neighbours).ok_or(FillError::NoNeighbours)?;
    check_options(options)?;
    let edge = edge_nodes(grid, options.neighbours);
    if edge.is_empty() {
        return Ok(grid.clone());
    }
    let search = NearestNodeSearch::new(grid, edge, neighbours, *options)?;
    let width = grid.columns();
    let mut values = grid.values.clone();
    values.par_chunks_exact_mut(width).enumerate().for_each(|(row, values)| {
        let mut found = NearestNodes::default();
        for (column, value) in values.iter_mut().enumerate().filter(|(_, value)| value.is_nan()) {
            search.find(row, column, &mut found);
            *value = search.value(&found.nodes);
        }
    });
    Ok(grid.with(values))
}

fn check_options(options: &NearestFill) -> Result<(), FillError> {
    let above_zero = |name, value: f64| {
        if value > 0.0 { Ok(()) } else { Err(FillError::Parameter { name, value }) }
    };
    if let NeighbourWeights::InverseDistance(power) = options.weights {
        above_zero("the power of the distance", power)?;
    }
    options.max_distance_m.map_or(Ok(()), |far| above_zero("the maximum distance", far))
}

/// Search tree of the nodes at the edge of the gaps.
struct NearestNodeSearch<'a> {
    grid: &'a PlaneGrid,
    edge: Vec<usize>,
    tree: ImmutableKdTree<f64, 2>,
    /// The number of neighbours in a mean.
    take: usize,
    /// Number of neighbours to find: `take` plus 1, to detect equal distances.
    ask: NonZeroUsize,
    /// Ratio of the northward to the eastward step.
    aspect: f64,
    options: NearestFill,
}

impl<'a> NearestNodeSearch<'a> {
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

    /// The mean of the nodes found.
    fn value(&self, found: &[(f64, usize)]) -> f64 {
        let step_m = self.grid.east_m.step;
        let too_far = |squared: f64| self.options.max_distance_m.is_some_and(|far| squared.sqrt() * step_m > far);
        let Some((nearest, _)) = found.first().filter(|(squared, _)| !too_far(*squared)) else {
            return f64::NAN;
        };
        let weight = |squared: f64| match self.options.weights {
            NeighbourWeights::Equal => 1.0,
            // Distances are relative to the nearest one, so that powers do not overflow.
            NeighbourWeights::InverseDistance(power) => (nearest / squared).powf(0.5 * power),
        };
        let (mut sum, mut weights) = (0.0, 0.0);
        for (squared, node) in found {
            sum += weight(*squared) * self.grid.values[*node];
            weights += weight(*squared);
        }
        sum / weights
    }

    /// Finds the nearest nodes. `found` holds the result for another node of the same row, or is empty.
    fn find(&self, row: usize, column: usize, found: &mut NearestNodes) {
        let place = [column as f64, row as f64 * self.aspect];
        // Distances from the tree are rounded. The order is based on distances that do not depend on the position
        // within the grid.
        const ROUNDING: f64 = 1e-9;
        // The distance to a node found before is at most its distance from the previous position plus the step.
        let enough =
            found.nodes.last().filter(|_| found.nodes.len() == self.take).map_or(f64::INFINITY, |(last, _)| {
                (last.sqrt() + column.abs_diff(found.column) as f64).powi(2) * (1.0 + ROUNDING)
            });
        let query = self.tree.query(&place).nearest_n::<SquaredEuclidean<f64>>(self.ask).within(enough).execute();
        let reach = query.get(self.take - 1).map(|last| last.distance * (1.0 + ROUNDING));
        match (reach, query.get(self.take)) {
            (Some(reach), Some(next)) if next.distance <= reach => {
                let tied = self.tree.query(&place).within::<SquaredEuclidean<f64>>(reach).execute();
                self.order(row, column, &tied, &mut found.nodes);
            }
            _ => self.order(row, column, &query, &mut found.nodes),
        }
        found.nodes.truncate(self.take);
        found.column = column;
    }

    /// Sorts nodes by distance, then by grid order.
    fn order(&self, row: usize, column: usize, query: &[QueryResultItem<(), u32, f64>], nodes: &mut Vec<(f64, usize)>) {
        let width = self.grid.columns();
        nodes.clear();
        nodes.extend(query.iter().map(|item| {
            let node = self.edge[item.item as usize];
            let east = (node % width).abs_diff(column) as f64;
            let north = (node / width).abs_diff(row) as f64 * self.aspect;
            (east * east + north * north, node)
        }));
        nodes.sort_unstable_by(|one, other| one.0.total_cmp(&other.0).then(one.1.cmp(&other.1)));
    }
}

/// The last result, with the column of its node: nodes and squared distances in eastward steps, nearest first.
#[derive(Default)]
struct NearestNodes {
    nodes: Vec<(f64, usize)>,
    column: usize,
}
