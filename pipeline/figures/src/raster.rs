//! Part of an anomaly map as a shaded picture with an equalised colour scale.

use numerics::maps::{map_surface::GeographicGrid, plane_grid::EvenAxis};
use schemas::Fault;

use super::{
    palette::Palette,
    png_file::{PixelFormat, encode},
    relief::{HillShading, ShadedPalette, light},
    sheet::DisplayGrid,
};

/// Maximum number of pixels per side of a picture.
const MOST: usize = 720;

/// Number of colours of the scale, and of light levels of each colour. A picture has 256 colours, including one for
/// unknown cells.
const COLOURS: usize = 42;
const LIGHTS: usize = 6;
/// Minimum and maximum light, relative to the light on level ground.
const LIGHT: (f64, f64) = (0.55, 1.2);

/// Rectangle of latitudes and longitudes, in degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// South, north.
    pub lat: (f64, f64),
    /// West, east.
    pub lon: (f64, f64),
}

/// Picture of a map.
pub struct Raster {
    /// Position of its edges.
    pub bounds: Bounds,
    /// Size in pixels.
    pub size: (usize, usize),
    /// Picture as a PNG file.
    pub png: Vec<u8>,
    /// Values at evenly spaced steps of the colour scale, from first to last, in nT.
    pub scale: Vec<f64>,
}

/// Values by rows from north to south, one per pixel.
struct PixelGrid {
    values: Vec<f64>,
    width: usize,
    bounds: Bounds,
}

/// Part of `grid` within `bounds`; `None` if picture and map share no known cell.
///
/// # Errors
/// Fails if the picture cannot be encoded.
pub fn raster(grid: &GeographicGrid, bounds: &Bounds) -> Result<Option<Raster>, Fault> {
    let Some(pixels) = cut(grid, bounds) else { return Ok(None) };
    let mut known: Vec<f64> = pixels.values.iter().copied().filter(|v| v.is_finite()).collect();
    if known.is_empty() {
        return Ok(None);
    }
    known.sort_by(f64::total_cmp);
    let rank = |part: f64| known[((part * (known.len() - 1) as f64).round() as usize).min(known.len() - 1)];
    let limits: Vec<f64> = (1..COLOURS).map(|k| rank(k as f64 / COLOURS as f64)).collect();
    let lights = pixels.lights();
    let index = |(v, light): (&f64, &f64)| {
        let strength = ((light - LIGHT.0) / (LIGHT.1 - LIGHT.0) * (LIGHTS - 1) as f64).round();
        let (colour, strength) =
            (limits.partition_point(|l| l <= v), strength.clamp(0.0, (LIGHTS - 1) as f64) as usize);
        (if v.is_finite() { colour * LIGHTS + strength } else { COLOURS * LIGHTS }) as u8
    };
    let indices: Vec<u8> = pixels.values.iter().zip(&lights).map(index).collect();
    let size = (pixels.width, pixels.values.len() / pixels.width);
    let png = encode(&colours(), size, &indices)?;
    let scale = (0..=10).map(|k| rank(f64::from(k) / 10.0)).collect();
    Ok(Some(Raster { bounds: pixels.bounds, size, png, scale }))
}

impl PixelGrid {
    /// Light on each pixel, from the north-west.
    fn lights(&self) -> Vec<f64> {
        let turned = |rows: &[f64]| -> Vec<f64> { rows.chunks(self.width).rev().flatten().copied().collect() };
        let axis = |ends: (f64, f64), len: usize| {
            let step = (ends.1 - ends.0) / len as f64;
            EvenAxis { first: ends.0 + 0.5 * step, step, len }
        };
        let (x, y) = (axis(self.bounds.lon, self.width), axis(self.bounds.lat, self.values.len() / self.width));
        let shrink = (0.5 * (self.bounds.lat.0 + self.bounds.lat.1)).to_radians().cos().max(0.01);
        let ground = shrink * x.step / y.step;
        turned(&light(&DisplayGrid { x, y, values: turned(&self.values) }, ground, &HillShading::default()))
    }
}

/// Nodes of one axis within `range`: index of the first node, and index of the last node plus 1.
fn within(first: f64, step: f64, len: usize, range: (f64, f64)) -> (usize, usize) {
    let place = |x: f64| (x - first) / step;
    let low = (place(range.0) - 0.5).ceil().clamp(0.0, len as f64) as usize;
    let high = (place(range.1) + 0.5).floor().clamp(-1.0, len as f64 - 1.0) + 1.0;
    (low, (high as usize).max(low))
}

fn cut(grid: &GeographicGrid, bounds: &Bounds) -> Option<PixelGrid> {
    let (lat, lon) = (grid.lat(), grid.lon());
    let (r0, r1) = within(lat.first_deg(), lat.step_deg(), lat.len(), bounds.lat);
    let (c0, c1) = within(lon.first_deg(), lon.step_deg(), lon.len(), bounds.lon);
    let block = (r1 - r0).max(c1 - c0).div_ceil(MOST).max(1);
    let (height, width) = ((r1 - r0) / block, (c1 - c0) / block);
    if height == 0 || width == 0 {
        return None;
    }
    let mean = |row: usize, column: usize| {
        let cells = (0..block).flat_map(|i| (0..block).map(move |j| (r0 + row * block + i, c0 + column * block + j)));
        let known = cells.filter_map(|(r, c)| grid.values().get(r * lon.len() + c).filter(|v| v.is_finite()));
        let (sum, n) = known.fold((0.0, 0usize), |(sum, n), v| (sum + v, n + 1));
        if n > 0 { sum / n as f64 } else { f64::NAN }
    };
    let values = (0..height).rev().flat_map(|row| (0..width).map(move |column| (row, column)));
    let edge = |first: f64, step: f64, node: usize| first + step * (node as f64 - 0.5);
    let edges =
        |first: f64, step: f64, from: usize, n: usize| (edge(first, step, from), edge(first, step, from + n * block));
    let bounds = Bounds {
        lat: edges(lat.first_deg(), lat.step_deg(), r0, height),
        lon: edges(lon.first_deg(), lon.step_deg(), c0, width),
    };
    Some(PixelGrid { values: values.map(|(r, c)| mean(r, c)).collect(), width, bounds })
}

/// Colours of the scale at each light level, and a transparent one for unknown cells.
fn colours() -> PixelFormat {
    let lit = ShadedPalette::new(Palette::Viridis);
    let shade = |k: usize| {
        let strength = (k % LIGHTS) as f64 / (LIGHTS - 1) as f64;
        let part = (k / LIGHTS) as f64 / (COLOURS - 1) as f64;
        lit.colour(part, LIGHT.0 + strength * (LIGHT.1 - LIGHT.0))
    };
    let shades = (0..COLOURS * LIGHTS).map(shade).map(|[r, g, b]| [r, g, b, 255]);
    PixelFormat::Indexed(shades.chain([[0; 4]]).collect())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::png_file::decode;

    fn grid() -> GeographicGrid {
        let (lat, lon): (Vec<f64>, Vec<f64>) = ((0..4).map(f64::from).collect(), (10..15).map(f64::from).collect());
        let mut values: Vec<f64> = (0..20).map(f64::from).collect();
        values[19] = f64::NAN;
        GeographicGrid::new(&lat, &lon, &values).unwrap()
    }

    #[test]
    fn unit_north_is_up_and_edges_are_half_a_cell_out() {
        let all = Bounds { lat: (-9.0, 9.0), lon: (0.0, 99.0) };
        let pixels = cut(&grid(), &all).unwrap();
        assert_eq!(pixels.bounds, Bounds { lat: (-0.5, 3.5), lon: (9.5, 14.5) });
        assert_eq!(pixels.width, 5);
        assert_eq!(pixels.values[0], 15.0);
        assert!(pixels.values[4].is_nan());
        assert_eq!(pixels.values[15], 0.0);
    }

    #[test]
    fn unit_part_includes_all_touched_cells() {
        let part = Bounds { lat: (0.9, 2.2), lon: (11.0, 12.9) };
        let pixels = cut(&grid(), &part).unwrap();
        assert_eq!(pixels.bounds, Bounds { lat: (0.5, 2.5), lon: (10.5, 13.5) });
        assert_eq!(pixels.values, [11.0, 12.0, 13.0, 6.0, 7.0, 8.0]);
        assert!(cut(&grid(), &Bounds { lat: (20.0, 30.0), lon: (11.0, 12.0) }).is_none());
    }

    #[test]
    fn unit_equal_areas_have_equal_shares_of_the_colours() {
        let lat: Vec<f64> = (0..16).map(f64::from).collect();
        // The values have a long tail, as anomalies do. Without equalisation, most of the map would have one colour.
        let values: Vec<f64> = (0..256).map(|k| (f64::from(k) / 20.0).exp()).collect();
        let grid = GeographicGrid::new(&lat, &lat, &values).unwrap();
        let drawn = raster(&grid, &Bounds { lat: (-1.0, 17.0), lon: (-1.0, 17.0) }).unwrap().unwrap();
        let (_, pixels) = decode(&drawn.png).unwrap();
        let mut counts = [0usize; COLOURS];
        pixels.iter().for_each(|p| counts[usize::from(*p) / LIGHTS] += 1);
        assert!(counts.iter().all(|n| (6..=7).contains(n)), "{counts:?}");
        assert_eq!((drawn.scale[0], drawn.scale[10]), (values[0], values[255]));
    }

    #[test]
    fn unit_slopes_to_the_north_west_are_lighter() {
        // A ridge from south-west to north-east on level ground, on the equator.
        let side: Vec<f64> = (0..21).map(f64::from).collect();
        let height = |k: i32| 10.0 - f64::from(k / 21 - k % 21).abs();
        let values: Vec<f64> = (0..441).map(height).collect();
        let grid = GeographicGrid::new(&side, &side, &values).unwrap();
        let pixels = cut(&grid, &Bounds { lat: (-1.0, 21.0), lon: (-1.0, 21.0) }).unwrap();
        let lights = pixels.lights();
        // Rows are from the north: north-west of the ridge is the upper left.
        let (lit, dark, flat) = (lights[7 * 21 + 7], lights[13 * 21 + 13], lights[10 * 21 + 10]);
        assert!(lit > 1.1 && dark < 0.7 && (flat - 1.0).abs() < 1e-9, "{lit} {dark} {flat}");
    }
}
