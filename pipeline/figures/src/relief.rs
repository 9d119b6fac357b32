//! Hill-shading: the map as a landscape in low light, which shows lineaments that colours alone hide.

use super::sheet::DisplayGrid;
use crate::palette::Palette;

/// Direction and strength of the light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HillShading {
    /// Azimuth of the light, degrees east of north.
    pub azimuth_deg: f64,
    /// Elevation of the light, in degrees: above 0, at most 90.
    pub elevation_deg: f64,
    /// Strength: 0 for no shading, 1 for full shading with black unlit slopes.
    pub strength: f64,
}

impl Default for HillShading {
    /// Light from the north-west at an elevation of 45 degrees, as on maps of mountains.
    fn default() -> Self {
        Self { azimuth_deg: 315.0, elevation_deg: 45.0, strength: 0.5 }
    }
}

/// Fraction of the slopes that are below 45 degrees after the heights are scaled.
const GENTLE: f64 = 0.9;

/// Light on each node of `sheet` relative to level ground, which has 1; unknown nodes also have 1. `ground` is the
/// ratio of a step along x to a step along y on the ground. Heights are scaled so that the steepest tenth of the map
/// begins at 45 degrees. Slopes are then flattened smoothly to at most 45 degrees, because the steepest gradients of an
/// anomaly would otherwise be black. [Horn, Hill shading and the reflectance map, Proc. IEEE 69, 1981]
pub fn light(sheet: &DisplayGrid, ground: f64, shade: &HillShading) -> Vec<f64> {
    let slopes: Vec<(f64, f64)> = (0..sheet.values.len()).map(|k| slope(sheet, k, ground)).collect();
    let mut steep: Vec<f64> = slopes.iter().map(|(e, n)| e.hypot(*n)).filter(|s| *s > 0.0).collect();
    if steep.is_empty() {
        return vec![1.0; slopes.len()];
    }
    let at = ((GENTLE * steep.len() as f64) as usize).min(steep.len() - 1);
    let steepness = *steep.select_nth_unstable_by(at, f64::total_cmp).1;
    let (azimuth, elevation) = (shade.azimuth_deg.to_radians(), shade.elevation_deg.to_radians());
    let (to_east, to_north) = (azimuth.sin() / elevation.tan(), azimuth.cos() / elevation.tan());
    let lit = |(east, north): &(f64, f64)| {
        let flatter = 1.0 / steepness.hypot(east.hypot(*north));
        let (east, north) = (east * flatter, north * flatter);
        let facing = 1.0 - east * to_east - north * to_north;
        let lambert = (facing / (1.0 + east * east + north * north).sqrt()).max(0.0);
        1.0 + shade.strength * (lambert - 1.0)
    };
    slopes.iter().map(lit).collect()
}

/// Rise to the east and to the north, per step along y.
fn slope(sheet: &DisplayGrid, node: usize, ground: f64) -> (f64, f64) {
    let (row, column) = (node / sheet.x.len, node % sheet.x.len);
    let at = |row: Option<usize>, column: Option<usize>| {
        let (row, column) = (row.filter(|r| *r < sheet.y.len)?, column.filter(|c| *c < sheet.x.len)?);
        sheet.values.get(row * sheet.x.len + column).copied().filter(|v| v.is_finite())
    };
    let Some(here) = at(Some(row), Some(column)) else { return (0.0, 0.0) };
    let east = rise(at(Some(row), column.checked_sub(1)), here, at(Some(row), Some(column + 1)));
    let north = rise(at(row.checked_sub(1), Some(column)), here, at(Some(row + 1), Some(column)));
    (east / ground, north)
}

/// Rise per step, from both neighbours or from the only known neighbour.
fn rise(before: Option<f64>, here: f64, after: Option<f64>) -> f64 {
    match (before, after) {
        (Some(a), Some(b)) => 0.5 * (b - a),
        (Some(a), None) => here - a,
        (None, Some(b)) => b - here,
        (None, None) => 0.0,
    }
}

/// Number of prepared steps of a palette.
const STEPS: usize = 1024;

/// Colours of a palette in light and shade. Below 1, the light multiplies lightness and chroma in Oklab, so that the
/// hue stays and shade looks like dimmer light. Above 1, it shifts the colour towards white.
pub struct ShadedPalette {
    palette: Palette,
    steps: Vec<[f64; 3]>,
}

impl ShadedPalette {
    /// Prepares a palette.
    pub fn new(palette: Palette) -> ShadedPalette {
        let steps = (0..=STEPS).map(|k| oklab(palette.colour(k as f64 / STEPS as f64))).collect();
        ShadedPalette { palette, steps }
    }

    /// Colour at the position `part` of the palette under `light`. A light of 1 gives the colour of the palette.
    pub fn colour(&self, part: f64, light: f64) -> [u8; 3] {
        // Interpolated light may differ slightly from 1.
        if (light - 1.0).abs() < 1e-9 || !light.is_finite() {
            return self.palette.colour(part);
        }
        let nearest = (part.clamp(0.0, 1.0) * STEPS as f64).round() as usize;
        let Some([l, a, b]) = self.steps.get(nearest).copied() else { return self.palette.colour(part) };
        if light < 1.0 {
            return srgb([l * light, a * light, b * light]);
        }
        // The brightest slopes, twice as light as level ground, are halfway to white.
        let glare = (0.5 * (light - 1.0)).min(0.6);
        srgb([l + glare * (1.0 - l), a * (1.0 - glare), b * (1.0 - glare)])
    }
}

/// Lightness and two colour axes of Oklab. [B. Ottosson, A perceptual color space for image processing, 2020]
pub fn oklab(colour: [u8; 3]) -> [f64; 3] {
    let [r, g, b] = colour.map(|c| {
        let c = f64::from(c) / 255.0;
        if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    });
    let l = (0.412_221_470_8 * r + 0.536_332_536_3 * g + 0.051_445_992_9 * b).cbrt();
    let m = (0.211_903_498_2 * r + 0.680_699_545_1 * g + 0.107_396_956_6 * b).cbrt();
    let s = (0.088_302_461_9 * r + 0.281_718_837_6 * g + 0.629_978_700_5 * b).cbrt();
    [
        0.210_454_255_3 * l + 0.793_617_785_0 * m - 0.004_072_046_8 * s,
        1.977_998_495_1 * l - 2.428_592_205_0 * m + 0.450_593_709_9 * s,
        0.025_904_037_1 * l + 0.782_771_766_2 * m - 0.808_675_766_0 * s,
    ]
}

fn srgb([lightness, a, b]: [f64; 3]) -> [u8; 3] {
    let l = (lightness + 0.396_337_777_4 * a + 0.215_803_757_3 * b).powi(3);
    let m = (lightness - 0.105_561_345_8 * a - 0.063_854_172_8 * b).powi(3);
    let s = (lightness - 0.089_484_177_5 * a - 1.291_485_548_0 * b).powi(3);
    let linear = [
        4.076_741_662_1 * l - 3.307_711_591_3 * m + 0.230_969_929_2 * s,
        -1.268_438_004_6 * l + 2.609_757_401_1 * m - 0.341_319_396_5 * s,
        -0.004_196_086_3 * l - 0.703_418_614_7 * m + 1.707_614_701_0 * s,
    ];
    linear.map(|c| {
        let c = if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
        (255.0 * c).round().clamp(0.0, 255.0) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        sheet::{MapWindow, sheet},
        tests::picture,
    };

    fn lit(columns: usize, rows: usize, height: impl Fn(f64, f64) -> f64, shade: &HillShading) -> Vec<f64> {
        let values: Vec<f64> =
            (0..columns * rows).map(|k| height((k % columns) as f64, (k / columns) as f64)).collect();
        let map = picture(columns, rows, &values);
        light(&sheet(&map, &MapWindow::from_picture(&map), (1000, 1000)), 1.0, shade)
    }

    #[test]
    fn unit_plane_has_uniform_lambertian_light() {
        let shade = HillShading { azimuth_deg: 90.0, elevation_deg: 30.0, strength: 1.0 };
        // The slope of 45 degrees is flattened to a gradient of 1/√2; it descends to the east, towards the light.
        // Expected: the cosine between the slope's normal and the light, relative to level ground.
        let steep = (0.5f64).sqrt().atan();
        let exact = (60f64.to_radians() - steep).cos() / 60f64.to_radians().cos();
        for light in lit(6, 5, |x, _| -7.0 * x, &shade) {
            assert!((light - exact).abs() < 1e-12, "{light} {exact}");
        }
        // The slope faces away from the light and is steeper than the elevation of the light, so it receives no light.
        assert!(lit(6, 5, |x, _| 7.0 * x, &shade).iter().all(|l| *l == 0.0));
        assert!(lit(6, 5, |_, _| 7.0, &shade).iter().all(|l| *l == 1.0));
    }

    #[test]
    fn unit_light_from_the_north_lights_slopes_to_the_north() {
        let shade = HillShading { azimuth_deg: 0.0, ..HillShading::default() };
        assert!(lit(4, 9, |_, y| -y, &shade).iter().all(|l| *l > 1.0));
        assert!(lit(4, 9, |_, y| y, &shade).iter().all(|l| *l < 1.0));
    }

    #[test]
    fn unit_unknown_nodes_give_no_steep_slopes() {
        let hole = |x: f64, y: f64| if (x, y) == (2.0, 2.0) { f64::NAN } else { 5.0 };
        assert!(lit(5, 5, hole, &HillShading::default()).iter().all(|l| *l == 1.0));
    }

    #[test]
    fn unit_oklab_round_trips() {
        for palette in [Palette::Viridis, Palette::Turbo, Palette::Diverging] {
            for k in 0..=255 {
                let colour = palette.colour(f64::from(k) / 255.0);
                assert_eq!(srgb(oklab(colour)), colour);
            }
        }
    }

    #[test]
    fn unit_shade_multiplies_lightness_and_keeps_hue() {
        for palette in [Palette::Viridis, Palette::Turbo, Palette::Diverging] {
            let lit = ShadedPalette::new(palette);
            for k in 0..=STEPS {
                let part = k as f64 / STEPS as f64;
                let own = oklab(lit.colour(part, 1.0));
                let dim = oklab(lit.colour(part, 0.7));
                // Colours are multiples of 1/255; for the darkest colours, half a step is 0.02 in Oklab.
                assert!((dim[0] - 0.7 * own[0]).abs() < 0.02, "{palette:?} {part}");
                assert!((dim[1] - 0.7 * own[1]).abs() < 0.02 && (dim[2] - 0.7 * own[2]).abs() < 0.02);
                assert!(oklab(lit.colour(part, 1.3))[0] > own[0]);
            }
            assert_eq!(lit.colour(0.3, 0.0), [0, 0, 0]);
        }
    }
}
