//! The points of a sweep as index numbers, so that a table of a million points is planned without a list of points.

use std::{collections::BTreeMap, ops::Range};

use schemas::Literal;

use crate::spec::Spec;

/// The values of the axes at one point of a sweep.
pub type SweepPoint = BTreeMap<String, Literal>;

/// Grid of sweep points over some axes; the last axis varies fastest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SweepGrid {
    sides: Vec<SweepGridSide>,
    len: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct SweepGridSide {
    /// The axis, as a position in the spec; if several axes are searched together, the first of them.
    axis: usize,
    /// Number of axes that are searched together, starting with this one.
    together: usize,
    /// The number of axis values.
    length: usize,
    /// Difference between the indices of two points with adjacent values of the axis.
    stride: usize,
}

impl SweepGrid {
    /// The points over `axes`, the numbers of axes in the spec in any order.
    pub fn new(axes: &[usize], spec: &Spec) -> SweepGrid {
        let searched = spec.searched.clone();
        let first = |i: &usize| if searched.contains(i) { searched.start } else { *i };
        let mut axes: Vec<usize> = axes.iter().map(first).collect();
        axes.sort_unstable();
        axes.dedup();
        let together = |i: usize| if searched.contains(&i) { searched.len() } else { 1 };
        let side = |i: usize| spec.axes.get(i).map(|a| (i, together(i), a.values.len()));
        SweepGrid::over(axes.into_iter().filter_map(side).collect())
    }

    /// Grid over axes, each given by its first position, the number of axes searched together, and the number of
    /// values.
    fn over(axes: Vec<(usize, usize, usize)>) -> SweepGrid {
        let mut len = 1usize;
        let mut sides = vec![];
        for (axis, together, length) in axes.into_iter().rev() {
            sides.push(SweepGridSide { axis, together, length, stride: len });
            len = len.saturating_mul(length);
        }
        sides.reverse();
        SweepGrid { sides, len }
    }

    /// The number of points, saturating.
    #[allow(clippy::len_without_is_empty)] // A grid has at least one point.
    pub fn len(&self) -> usize {
        self.len
    }

    /// The axes, as positions in the spec, sorted.
    pub fn axes(&self) -> impl Iterator<Item = usize> + '_ {
        self.sides().flatten()
    }

    /// The axes, as ranges of positions in the spec; axes that are searched together form one range.
    pub fn sides(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.sides.iter().map(|s| s.axis..s.axis + s.together)
    }

    /// Each axis of the point `i`, with the position of its value.
    pub fn place(&self, i: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.sides.iter().flat_map(move |s| (s.axis..s.axis + s.together).map(move |a| (a, i / s.stride % s.length)))
    }

    /// The values of the point `i`.
    pub fn point(&self, i: usize, spec: &Spec) -> SweepPoint {
        let value = |(axis, at): (usize, usize)| {
            let axis = spec.axes.get(axis)?;
            Some((axis.name.clone(), axis.values.get(at)?.clone()))
        };
        self.place(i).filter_map(value).collect()
    }

    /// The point whose axis values have the positions `place`, one for each side; `None` if a position is out of range.
    pub fn number(&self, place: &[usize]) -> Option<usize> {
        let fits = place.len() == self.sides.len() && place.iter().zip(&self.sides).all(|(at, s)| *at < s.length);
        fits.then(|| place.iter().zip(&self.sides).map(|(at, s)| at * s.stride).sum())
    }

    /// Points that differ from the point `i` in the axis `axis` alone, including `i`. For axes that are searched
    /// together, the first axis represents all, and the other axes have no further points.
    pub fn along(&self, i: usize, axis: usize) -> impl Iterator<Item = usize> + '_ {
        let side = self.sides.iter().copied().find(move |s| s.axis == axis);
        let (length, stride) = side.map_or((1, 0), |s| (s.length, s.stride));
        let first = side.map_or(i, |s| i - i / s.stride % s.length * s.stride);
        (0..length).map(move |k| first + k * stride)
    }

    /// Mapping from the points of this grid to the points of `other`. For axes that only `other` has, the first value
    /// is used.
    pub fn onto(&self, other: &SweepGrid) -> SweepPointMap {
        let mut steps: Vec<SweepStride> = vec![];
        for own in &self.sides {
            let Some(there) = other.sides.iter().find(|s| s.axis == own.axis) else { continue };
            let step = SweepStride { own: own.stride, length: own.length, there: there.stride };
            // Axes that are adjacent in both grids are merged.
            match steps.last_mut() {
                Some(l) if l.own == step.own * step.length && l.there == step.there * step.length => {
                    *l = SweepStride { length: l.length * step.length, ..step };
                }
                _ => steps.push(step),
            }
        }
        SweepPointMap { steps }
    }

    /// The grid over the axes that this grid does not share with `other`.
    pub fn without(&self, other: &SweepGrid) -> SweepGrid {
        let own = self.sides.iter().filter(|s| !other.axes().any(|a| a == s.axis));
        SweepGrid::over(own.map(|s| (s.axis, s.together, s.length)).collect())
    }
}

/// Mapping from the points of one grid to the points of another grid.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SweepPointMap {
    steps: Vec<SweepStride>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct SweepStride {
    own: usize,
    length: usize,
    there: usize,
}

impl SweepPointMap {
    /// Point of the other grid for the point `i` of this grid.
    pub fn at(&self, i: usize) -> usize {
        self.steps.iter().map(|s| i / s.own % s.length * s.there).sum()
    }
}

/// Values that depend on the position of a point along some of the axes.
#[derive(Clone, Debug)]
pub struct SweepValues<T> {
    grid: SweepGrid,
    onto: SweepPointMap,
    values: Vec<T>,
}

impl<T: Clone + PartialEq> SweepValues<T> {
    /// Creates a look-up for the points of `whole`, from values at the points of `grid`. Axes along which the values do
    /// not change are dropped.
    pub fn new(whole: &SweepGrid, grid: SweepGrid, values: Vec<T>) -> SweepValues<T> {
        let (grid, values) = reduced(grid, values);
        SweepValues { onto: whole.onto(&grid), grid, values }
    }

    /// Grid of the axes that the values depend on.
    pub fn grid(&self) -> &SweepGrid {
        &self.grid
    }

    /// The value at each point of [`SweepValues::grid`].
    pub fn values(&self) -> &[T] {
        &self.values
    }

    /// Value at the point `i` of the whole grid.
    pub fn at(&self, i: usize) -> &T {
        &self.values[self.onto.at(i)]
    }
}

fn reduced<T: Clone + PartialEq>(mut grid: SweepGrid, mut values: Vec<T>) -> (SweepGrid, Vec<T>) {
    let axes: Vec<usize> = grid.sides.iter().map(|s| s.axis).collect();
    for axis in axes {
        let Some(side) = grid.sides.iter().copied().find(|s| s.axis == axis) else { continue };
        let first = |i: usize| i - i / side.stride % side.length * side.stride;
        if (0..values.len()).all(|i| values[i] == values[first(i)]) {
            values = (0..values.len()).filter(|i| first(*i) == *i).map(|i| values[i].clone()).collect();
            let rest = grid.sides.iter().filter(|s| s.axis != axis);
            grid = SweepGrid::over(rest.map(|s| (s.axis, s.together, s.length)).collect());
        }
    }
    values.shrink_to_fit();
    (grid, values)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(axes: &[usize]) -> SweepGrid {
        SweepGrid::over(axes.iter().map(|a| (*a, 1, [2, 1, 3, 4][*a])).collect())
    }

    #[test]
    fn unit_points_are_ordered_and_found_again() {
        let all = grid(&[0, 1, 2, 3]);
        assert_eq!((all.len(), grid(&[]).len()), (24, 1));
        let places: Vec<Vec<usize>> = (0..5).map(|i| all.place(i).map(|(_, at)| at).collect()).collect();
        assert_eq!(places, [[0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 0, 2], [0, 0, 0, 3], [0, 0, 1, 0]]);
        for some in [vec![], vec![0], vec![1, 3], vec![0, 2], vec![2, 3], vec![0, 1, 2, 3]] {
            let part = grid(&some);
            let (there, back) = (all.onto(&part), part.onto(&all));
            for i in 0..all.len() {
                let digits: Vec<(usize, usize)> = all.place(i).filter(|(a, _)| some.contains(a)).collect();
                assert_eq!(part.place(there.at(i)).collect::<Vec<_>>(), digits);
            }
            // A point of the whole grid is a point of the partial grid combined with a point of the remaining axes.
            let rest = all.without(&part);
            let rest_back = rest.onto(&all);
            let mut seen: Vec<usize> = (0..part.len())
                .flat_map(|p| (0..rest.len()).map(move |r| (p, r)))
                .map(|(p, r)| back.at(p) + rest_back.at(r))
                .collect();
            seen.sort_unstable();
            assert_eq!(seen, (0..all.len()).collect::<Vec<_>>());
        }
        assert!((0..24).all(|i| all.number(&all.place(i).map(|(_, at)| at).collect::<Vec<_>>()) == Some(i)));
        assert_eq!((all.number(&[0, 1, 0, 0]), all.number(&[0])), (None, None));
        assert_eq!(all.along(13, 2).collect::<Vec<_>>(), [13, 17, 21]);
        assert_eq!(all.along(13, 7).collect::<Vec<_>>(), [13]);
    }

    #[test]
    fn unit_axes_without_effect_are_dropped() {
        let all = grid(&[0, 1, 2, 3]);
        let part = grid(&[0, 1, 2]);
        let values: Vec<usize> = (0..part.len()).map(|i| i % 3).collect();
        let over = SweepValues::new(&all, part, values);
        assert_eq!(over.grid().axes().collect::<Vec<_>>(), [2]);
        assert_eq!(over.values(), [0, 1, 2]);
        assert!((0..all.len()).all(|i| *over.at(i) == i / 4 % 3));
        let same = SweepValues::new(&all, grid(&[2, 3]), vec!["x"; 12]);
        assert_eq!((same.grid().len(), *same.at(17)), (1, "x"));
    }

    #[test]
    fn unit_axes_that_are_searched_together_are_one_side() {
        // The axes 1 to 3 are searched together: two values of the axis 0, five trials.
        let all = SweepGrid::over(vec![(0, 1, 2), (1, 3, 5)]);
        assert_eq!((all.len(), all.axes().collect::<Vec<_>>()), (10, vec![0, 1, 2, 3]));
        assert_eq!(all.sides().collect::<Vec<_>>(), [0..1, 1..4]);
        assert_eq!(all.place(7).collect::<Vec<_>>(), [(0, 1), (1, 2), (2, 2), (3, 2)]);
        assert_eq!(all.number(&[1, 2]), Some(7));
        assert_eq!(all.along(7, 1).collect::<Vec<_>>(), [5, 6, 7, 8, 9]);
        assert_eq!(all.along(7, 2).collect::<Vec<_>>(), [7]);
        let trials = SweepGrid::over(vec![(1, 3, 5)]);
        assert_eq!((0..10).map(|i| all.onto(&trials).at(i)).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 0, 1, 2, 3, 4]);
        assert_eq!(all.without(&trials).axes().collect::<Vec<_>>(), [0]);
        let over = SweepValues::new(&all, trials, vec!["x"; 5]);
        assert_eq!((over.grid().len(), *over.at(9)), (1, "x"));
    }

    #[test]
    fn unit_the_number_of_points_saturates() {
        let wide = SweepGrid::over((0..40).map(|a| (a, 1, 1000)).collect());
        assert_eq!(wide.len(), usize::MAX);
    }
}
