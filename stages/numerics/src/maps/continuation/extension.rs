//! Extension of a map beyond its edges, so that a periodic transform can be applied to it.

use crate::maps::plane_grid::PlaneGrid;

use super::ContinuationError;

/// Maximum padding on each side, in nodes, as in MagNav.jl.
pub const MOST_PADDING: usize = 5000;

/// The assumed continuation of a map past its edges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EdgeExtension {
    /// The value at the edge falls to the trend over half a period of a cosine. The image of the map, rotated about the
    /// edge, continues slope and detail; it fades over `detail_nodes`.
    ///
    /// This extension was compared with others on fields of dipoles in and around a map, continued upward by 2 to 10
    /// spacings. The alternatives were zeros, linear and cosine bridges, even and odd images with tapers and
    /// cross-fades, and the extension of least curvature. The chosen extension was closest to the closed form in most
    /// cases, and never much worse than the best extension.
    Falling {
        /// The number of nodes over which the detail fades.
        detail_nodes: usize,
    },
    /// A straight line from the last value of each row, and then of each column, around to the first value, as in
    /// MagNav.jl's `map_expand`.
    WrapAround,
    /// The trend alone. With [`TrendRemoval::None`], the padding is zero, as by default in `xrft.pad`.
    Zero,
}

/// The trend that is removed from a map before it is extended, and restored afterwards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrendRemoval {
    /// No trend.
    None,
    /// The mean of the values along the edge, so that a constant is preserved.
    EdgeMean,
    /// The plane of best fit to the values along the edge, for maps that contain a regional slope.
    EdgePlane,
}

/// Width of the padding on each side. The lengths of the padded sides are products of 2, 3, 5 and 7.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PaddingWidth {
    /// At least ten times the continuation distance and at least a tenth of the side, up to [`MOST_PADDING`] nodes.
    OfDistance,
    /// Minimum number of padding nodes before and after the map's `[rows, columns]`.
    Nodes([usize; 2]),
    /// No padding: the map is treated as periodic.
    None,
}

/// Width and method of the extension of a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Padding {
    /// The width of the padding.
    pub width: PaddingWidth,
    /// The values in the padding.
    pub edge: EdgeExtension,
    /// The trend that is removed first.
    pub trend: TrendRemoval,
    /// Maximum number of nodes of the padded map; the default padding is reduced to meet this limit. 2²⁸ nodes are 2
    /// GiB.
    pub most_nodes: usize,
    /// Whether both padded sides are even, which makes the transform faster.
    pub even: bool,
}

impl Default for Padding {
    fn default() -> Self {
        let edge = EdgeExtension::Falling { detail_nodes: 6 };
        Self { width: PaddingWidth::OfDistance, edge, trend: TrendRemoval::EdgeMean, most_nodes: 1 << 28, even: true }
    }
}

impl Padding {
    /// No padding: the map is treated as periodic.
    pub fn none() -> Self {
        Self {
            width: PaddingWidth::None,
            edge: EdgeExtension::Zero,
            trend: TrendRemoval::None,
            even: false,
            ..Self::default()
        }
    }

    /// The padding of MagNav.jl's `upward_fft` for a continuation by `distance_m`: a margin of ten times the distance,
    /// filled by wrapping the map around.
    pub fn magnav(grid: &PlaneGrid, distance_m: f64) -> Self {
        let cells = |step: f64| (10.0 * distance_m.abs() / step).ceil().min(MOST_PADDING as f64) as usize;
        let pad = cells(grid.east_m.step).max(cells(grid.north_m.step)).min(MOST_PADDING);
        Self {
            width: PaddingWidth::Nodes([pad, pad]),
            edge: EdgeExtension::WrapAround,
            trend: TrendRemoval::None,
            even: false,
            ..Self::default()
        }
    }

    /// Layout of a map in its padded grid for a continuation by `distance_m`.
    ///
    /// # Errors
    /// Fails with [`ContinuationError::TooLarge`] if the padded map has more than `most_nodes` nodes.
    pub fn layout(&self, grid: &PlaneGrid, distance_m: f64) -> Result<PaddedLayout, ContinuationError> {
        let sides = [(grid.rows(), grid.north_m.step), (grid.columns(), grid.east_m.step)];
        let wanted = match self.width {
            PaddingWidth::Nodes(nodes) => return self.layout_of(sides, Some(nodes.map(|n| n.min(1 << 31)))),
            PaddingWidth::None => return self.layout_of(sides, None),
            PaddingWidth::OfDistance => sides.map(|(len, step)| default_width(len, step, distance_m)),
        };
        let narrowed = |tenths: usize| self.layout_of(sides, Some(wanted.map(|pad| pad * tenths / 10)));
        (1..=10).rev().find_map(|tenths| narrowed(tenths).ok()).map_or_else(|| narrowed(0), Ok)
    }

    fn layout_of(&self, sides: [(usize, f64); 2], pads: Option<[usize; 2]>) -> Result<PaddedLayout, ContinuationError> {
        let [rows, columns] = [0, 1].map(|i| AxisLayout::new(sides[i].0, pads.map(|pads| pads[i]), self.even));
        let nodes = rows.padded.saturating_mul(columns.padded);
        if nodes > self.most_nodes {
            return Err(ContinuationError::TooLarge { nodes, most: self.most_nodes });
        }
        Ok(PaddedLayout { rows, columns })
    }
}

fn default_width(len: usize, step: f64, distance_m: f64) -> usize {
    let reach = (10.0 * distance_m.abs() / step).ceil().min(MOST_PADDING as f64) as usize;
    reach.max(len.div_ceil(10)).min(MOST_PADDING)
}

/// Node counts of one side of a map and of its padding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisLayout {
    /// The nodes of the map.
    pub len: usize,
    /// Number of padding nodes before the first node of the map.
    pub before: usize,
    /// All nodes, a product of 2, 3, 5 and 7.
    pub padded: usize,
}

impl AxisLayout {
    fn new(len: usize, pad: Option<usize>, even: bool) -> Self {
        let padded = match pad.map(|pad| len + 2 * pad) {
            None => len,
            Some(least) if even => 2 * seven_smooth(least.div_ceil(2)),
            Some(least) => seven_smooth(least),
        };
        Self { len, before: (padded - len) / 2, padded }
    }

    /// Number of padding nodes after the last node of the map.
    pub fn after(&self) -> usize {
        self.padded - self.len - self.before
    }
}

/// Layout of a map inside its padded grid, by axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PaddedLayout {
    /// The rows, from south to north.
    pub rows: AxisLayout,
    /// The columns, from west to east.
    pub columns: AxisLayout,
}

impl PaddedLayout {
    /// The number of nodes of the padded map.
    pub fn nodes(&self) -> usize {
        self.rows.padded * self.columns.padded
    }
}

/// Smallest product of powers of 2, 3, 5 and 7 that is at least `n`.
pub fn seven_smooth(n: usize) -> usize {
    let smooth = |&m: &usize| [2, 3, 5, 7].iter().fold(m, |m, p| divided_out(m, *p)) == 1;
    (n.max(1)..).find(smooth).unwrap_or(n)
}

fn divided_out(mut m: usize, p: usize) -> usize {
    while m.is_multiple_of(p) {
        m /= p;
    }
    m
}

/// Padding node, expressed as a weighted sum of two nodes of the map.
#[derive(Clone, Copy, Debug)]
struct PaddingNode {
    nodes: [usize; 2],
    weights: [f64; 2],
}

/// The padding of one axis as a linear function of the map's nodes. The function applies to values and, along the other
/// axis, to spectra.
#[derive(Debug)]
pub(super) struct AxisExtension {
    layout: AxisLayout,
    before: Vec<PaddingNode>,
    after: Vec<PaddingNode>,
}

impl AxisExtension {
    pub(super) fn new(layout: AxisLayout, edge: EdgeExtension) -> Self {
        let gap = layout.padded - layout.len;
        let last = layout.len - 1;
        let weighted = |distance: usize, width: usize, upper: bool| match edge {
            EdgeExtension::Zero => PaddingNode { nodes: [0, 0], weights: [0.0, 0.0] },
            EdgeExtension::WrapAround => wrapped(distance, gap, last, upper),
            EdgeExtension::Falling { detail_nodes } => falling(distance, width, detail_nodes, last, upper),
        };
        Self {
            layout,
            before: (1..=layout.before).rev().map(|d| weighted(d, layout.before, false)).collect(),
            after: (1..=layout.after()).map(|d| weighted(d, layout.after(), true)).collect(),
        }
    }

    /// Fills the padding of a line whose map nodes are already set.
    pub(super) fn fill<T>(&self, line: &mut [T])
    where
        T: Copy + std::ops::Mul<f64, Output = T> + std::ops::Add<Output = T>,
    {
        let (before, rest) = line.split_at_mut(self.layout.before);
        let (map, after) = rest.split_at_mut(self.layout.len);
        for (part, weighted) in [(before, &self.before), (after, &self.after)] {
            for (value, PaddingNode { nodes: [i, j], weights: [a, b] }) in part.iter_mut().zip(weighted) {
                *value = map[*i] * *a + map[*j] * *b;
            }
        }
    }
}

/// Padding node on the straight line across the whole gap, from the last node around to the first.
fn wrapped(distance: usize, gap: usize, last: usize, upper: bool) -> PaddingNode {
    let far = distance as f64 / (gap + 1) as f64;
    let nodes = if upper { [last, 0] } else { [0, last] };
    PaddingNode { nodes, weights: [1.0 - far, far] }
}

/// Padding node whose value is `s` times the edge value plus `s t` times (edge − image). Both s and t are half periods
/// of a cosine of the distance.
fn falling(distance: usize, width: usize, detail: usize, last: usize, upper: bool) -> PaddingNode {
    let half_cosine = |over: usize| {
        let part = (distance as f64 / over.max(1) as f64).min(1.0);
        0.5 * (1.0 + (std::f64::consts::PI * part).cos())
    };
    let fall = half_cosine(width + 1);
    let fade = fall * half_cosine(detail.min(width + 1));
    let inward = reflected(distance, last);
    let nodes = if upper { [last, last - inward] } else { [0, inward] };
    PaddingNode { nodes, weights: [fall + fade, -fade] }
}

/// The node at this distance from the edge, reflected between both edges.
fn reflected(distance: usize, last: usize) -> usize {
    let round = distance % (2 * last).max(1);
    if round > last { 2 * last - round } else { round.min(last) }
}

/// A map extended by wrap-around padding to sides that are products of 2, 3, 5 and 7, with at least `pad` nodes
/// on each side: MagNav.jl's `map_expand`.
///
/// Each row, and then each column, continues in a straight line from its last value around to its first, so that the
/// extended map is periodic. Returns the extended map with its eastings and northings, and the position of the original
/// map in it.
///
/// # Errors
/// Returns the errors of [`super::check`] for an invalid map. Also fails with [`ContinuationError::TooLarge`] for a
/// padding that is too wide.
pub fn expand(grid: &PlaneGrid, pad: usize) -> Result<(PlaneGrid, PaddedLayout), ContinuationError> {
    super::check(grid)?;
    let padding = Padding {
        width: PaddingWidth::Nodes([pad, pad]),
        edge: EdgeExtension::WrapAround,
        even: false,
        ..Padding::default()
    };
    let layout = padding.layout(grid, 0.0)?;
    let PaddedLayout { rows, columns } = layout;
    let (along, across) = (AxisExtension::new(columns, padding.edge), AxisExtension::new(rows, padding.edge));
    let mut values = vec![0.0; layout.nodes()];
    for (row, source) in grid.values.chunks_exact(columns.len).enumerate() {
        let line = &mut values[(rows.before + row) * columns.padded..][..columns.padded];
        line[columns.before..][..columns.len].copy_from_slice(source);
        along.fill(line);
    }
    let mut line = vec![0.0; rows.padded];
    for column in 0..columns.padded {
        (0..rows.padded).for_each(|row| line[row] = values[row * columns.padded + column]);
        across.fill(&mut line);
        (0..rows.padded).for_each(|row| values[row * columns.padded + column] = line[row]);
    }
    let mut expanded = PlaneGrid { values, ..*grid };
    for (axis, side) in [(&mut expanded.east_m, columns), (&mut expanded.north_m, rows)] {
        axis.first -= axis.step * side.before as f64;
        axis.len = side.padded;
    }
    Ok((expanded, layout))
}
