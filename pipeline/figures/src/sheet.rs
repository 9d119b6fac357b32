//! Values of a map at the pixels of a picture: cells smaller than a pixel are averaged by area, and larger cells are
//! enlarged.

use numerics::maps::plane_grid::EvenAxis;

use super::MapPicture;

/// Part of a map, by its edges, in the map's coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapWindow {
    /// West and east.
    pub x: (f64, f64),
    /// South and north.
    pub y: (f64, f64),
}

impl MapWindow {
    /// Window of the whole map, which extends half a step beyond the outermost nodes.
    pub fn from_picture(picture: &MapPicture) -> MapWindow {
        let edges = |a: &EvenAxis| (a.at(-0.5), a.at(a.len as f64 - 0.5));
        MapWindow { x: edges(&picture.x), y: edges(&picture.y) }
    }
}

/// Values of a map on nodes that are not denser than the pixels of the picture, rows from the south.
#[derive(Clone, Debug)]
pub struct DisplayGrid {
    /// Coordinates of the columns.
    pub x: EvenAxis,
    /// Coordinates of the rows.
    pub y: EvenAxis,
    /// Values by rows; NaN if unknown.
    pub values: Vec<f64>,
}

/// Consecutive nodes and their weights.
struct NodeWeights {
    first: usize,
    weights: Vec<f64>,
}

/// Values of `window` for a picture of `size` pixels (width, height). If an axis has more than one node per pixel, the
/// nodes are averaged along it, weighted by the area of their cells within the pixel. Along other axes the nodes are
/// unchanged.
pub fn sheet(picture: &MapPicture, window: &MapWindow, size: (usize, usize)) -> DisplayGrid {
    let (x, across) = shares(&picture.x, window.x, size.0);
    let (y, up) = shares(&picture.y, window.y, size.1);
    let row = |r: usize| picture.values.get(r * picture.x.len..(r + 1) * picture.x.len).unwrap_or_default();
    let mut values = Vec::with_capacity(x.len * y.len);
    let mut sums = vec![(0.0, 0.0); x.len];
    for share in &up {
        sums.fill((0.0, 0.0));
        for (k, weight) in share.weights.iter().enumerate() {
            add(row(share.first + k), &across, *weight, &mut sums);
        }
        values.extend(sums.iter().map(|(sum, weight)| if *weight > 0.0 { sum / weight } else { f64::NAN }));
    }
    DisplayGrid { x, y, values }
}

fn add(row: &[f64], across: &[NodeWeights], weight: f64, sums: &mut [(f64, f64)]) {
    for (share, sum) in across.iter().zip(sums) {
        for (value, part) in row.iter().skip(share.first).zip(&share.weights).filter(|(v, _)| v.is_finite()) {
            sum.0 += weight * part * value;
            sum.1 += weight * part;
        }
    }
}

/// Axis of a sheet, and the nodes of the map that are averaged at each node of the sheet.
fn shares(axis: &EvenAxis, range: (f64, f64), pixels: usize) -> (EvenAxis, Vec<NodeWeights>) {
    let place = |x: f64| (axis.node(x) + 0.5).clamp(0.0, axis.len as f64);
    let (from, to) = (place(range.0), place(range.1));
    let per_pixel = (to - from) / pixels as f64;
    if per_pixel > 1.0 {
        let step = (range.1 - range.0) / pixels as f64;
        let sheet = EvenAxis { first: range.0 + 0.5 * step, step, len: pixels };
        let pixel = |k: usize| covered(from + per_pixel * k as f64, from + per_pixel * (k + 1) as f64, axis.len);
        return (sheet, (0..pixels).map(pixel).collect());
    }
    // One additional node on each side, for interpolation.
    let first = (from.floor() as usize).saturating_sub(1).min(axis.len - 1);
    let last = (to.ceil() as usize).clamp(first, axis.len - 1);
    let sheet = EvenAxis { first: axis.at(first as f64), step: axis.step, len: last - first + 1 };
    (sheet, (first..=last).map(|first| NodeWeights { first, weights: vec![1.0] }).collect())
}

/// Cells from `from` to `to`; cell k spans k to k + 1.
fn covered(from: f64, to: f64, len: usize) -> NodeWeights {
    let first = (from.floor() as usize).min(len - 1);
    let last = (to.ceil() as usize).clamp(first + 1, len);
    let share = |k: usize| (to.min((k + 1) as f64) - from.max(k as f64)).max(0.0);
    NodeWeights { first, weights: (first..last).map(share).collect() }
}

/// Two neighbouring nodes and the fraction of a position between them, 0 to 1.
#[derive(Clone, Copy)]
struct NodeBracket {
    low: usize,
    high: usize,
    part: f64,
}

/// Interpolation of values on the nodes of a grid at the pixels of a picture.
pub struct PixelInterpolator<'a> {
    sheet: &'a DisplayGrid,
    across: Vec<NodeBracket>,
    down: Vec<NodeBracket>,
    known: Vec<bool>,
}

impl<'a> PixelInterpolator<'a> {
    /// Interpolator for a picture of `size` pixels of `window`, with interpolated or uniform cells.
    pub fn new(sheet: &'a DisplayGrid, window: &MapWindow, size: (usize, usize), blend: bool) -> PixelInterpolator<'a> {
        let centre = |ends: (f64, f64), k: usize, n: usize| ends.0 + (ends.1 - ends.0) * (k as f64 + 0.5) / n as f64;
        let across = (0..size.0).map(|k| between(&sheet.x, centre(window.x, k, size.0), blend)).collect();
        let down = (0..size.1).map(|k| between(&sheet.y, centre((window.y.1, window.y.0), k, size.1), blend)).collect();
        let known = sheet.values.iter().map(|v| v.is_finite()).collect();
        PixelInterpolator { sheet, across, down, known }
    }

    /// Values at each pixel, rows from the north, from `values` (one per node of the sheet). NaN if the nearest part of
    /// the sheet is unknown; if only some nodes are known, only these are used.
    pub fn interpolate(&self, values: &[f64]) -> Vec<f64> {
        let pixels = self.down.iter().flat_map(|down| self.across.iter().map(move |across| (down, across)));
        pixels.map(|(down, across)| self.blended(values, down, across)).collect()
    }

    fn blended(&self, values: &[f64], down: &NodeBracket, across: &NodeBracket) -> f64 {
        let corners = [
            (down.low, across.low, (1.0 - down.part) * (1.0 - across.part)),
            (down.low, across.high, (1.0 - down.part) * across.part),
            (down.high, across.low, down.part * (1.0 - across.part)),
            (down.high, across.high, down.part * across.part),
        ];
        let (mut sum, mut weight) = (0.0, 0.0);
        for (row, column, part) in corners {
            let node = row * self.sheet.x.len + column;
            if part > 0.0 && self.known.get(node) == Some(&true) {
                sum += part * values.get(node).copied().unwrap_or(f64::NAN);
                weight += part;
            }
        }
        // A weight of one half corresponds to the edge of a cell. The tolerance covers the rounding of a pixel's
        // position.
        if weight > 0.5 - 1e-9 { sum / weight } else { f64::NAN }
    }
}

fn between(axis: &EvenAxis, at: f64, blend: bool) -> NodeBracket {
    let node = axis.node(at).clamp(0.0, (axis.len - 1) as f64);
    if !blend {
        let nearest = node.round() as usize;
        return NodeBracket { low: nearest, high: nearest, part: 0.0 };
    }
    let low = (node.floor() as usize).min(axis.len - 1);
    NodeBracket { low, high: (low + 1).min(axis.len - 1), part: node - low as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::picture;

    fn drawn(map: &MapPicture, size: (usize, usize), blend: bool) -> Vec<f64> {
        let window = MapWindow::from_picture(map);
        let sheet = sheet(map, &window, size);
        PixelInterpolator::new(&sheet, &window, size, blend).interpolate(&sheet.values)
    }

    #[test]
    fn unit_reduction_keeps_the_mean() {
        // 7 x 5 cells on 3 x 2 pixels: only the outer edges coincide, and the area mean is unchanged.
        let values: Vec<f64> = (0..35).map(|k| f64::from(k * k % 17)).collect();
        let map = picture(7, 5, &values);
        let few = drawn(&map, (3, 2), true);
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        assert!((mean(&few) - mean(&values)).abs() < 1e-12);
    }

    #[test]
    fn unit_reduction_skips_unknown_nodes_and_keeps_single_spikes() {
        let mut values = vec![f64::NAN; 10_000];
        values[5_050] = 12.0;
        let few = drawn(&picture(100, 100, &values), (10, 10), true);
        assert_eq!(few.iter().filter(|v| v.is_finite()).copied().collect::<Vec<f64>>(), [12.0]);
    }

    #[test]
    fn unit_north_is_up_and_corners_match() {
        let values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        let map = picture(3, 2, &values);
        assert_eq!(drawn(&map, (3, 2), true), [4.0, 5.0, 6.0, 1.0, 2.0, 3.0]);
        let large = drawn(&map, (6, 4), false);
        assert_eq!(large[..6], [4.0, 4.0, 5.0, 5.0, 6.0, 6.0]);
        assert_eq!(large[18..], [1.0, 1.0, 2.0, 2.0, 3.0, 3.0]);
    }

    #[test]
    fn unit_blending_is_exact_for_a_plane_between_the_nodes() {
        let values: Vec<f64> = (0..12).map(|k| f64::from(k % 4) + 10.0 * f64::from(k / 4)).collect();
        let map = picture(4, 3, &values);
        let (w, h) = (40, 30);
        for (k, value) in drawn(&map, (w, h), true).into_iter().enumerate() {
            let column = ((k % w) as f64 + 0.5) / 10.0 - 0.5;
            let row = ((h - 1 - k / w) as f64 + 0.5) / 10.0 - 0.5;
            let exact = column.clamp(0.0, 3.0) + 10.0 * row.clamp(0.0, 2.0);
            // Tolerance for about twenty roundings of numbers up to 23.
            assert!((value - exact).abs() < 1e-12, "{k}: {value} {exact}");
        }
    }

    #[test]
    fn unit_unknown_cell_ends_at_its_edges() {
        let mut values = [5.0; 9];
        values[4] = f64::NAN;
        for blend in [false, true] {
            let large = drawn(&picture(3, 3, &values), (30, 30), blend);
            let row: Vec<bool> = large[15 * 30..16 * 30].iter().map(|v| v.is_nan()).collect();
            assert!((0..30).all(|k| row[k] == (10..20).contains(&k)), "{row:?}");
            assert!(large.iter().all(|v| v.is_nan() || (v - 5.0).abs() < 1e-12));
        }
    }

    #[test]
    fn unit_part_equals_the_same_part_of_the_whole() {
        let values: Vec<f64> = (0..24).map(|k| f64::from(k * 7 % 11)).collect();
        let map = picture(6, 4, &values);
        let all = MapWindow::from_picture(&map);
        let half = MapWindow { x: (all.x.0, 0.5 * (all.x.0 + all.x.1)), ..all };
        let part = sheet(&map, &half, (30, 40));
        let part = PixelInterpolator::new(&part, &half, (30, 40), true).interpolate(&part.values);
        let whole = drawn(&map, (60, 40), true);
        for (k, value) in part.iter().enumerate() {
            // The positions are computed from different edges, so rounding differs.
            assert!((value - whole[k / 30 * 60 + k % 30]).abs() < 1e-10);
        }
    }
}
