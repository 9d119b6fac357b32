//! Map as coloured pixels.

use super::{
    AxisQuantity, MapPicture, MapStyle,
    relief::{ShadedPalette, light},
    scale::ColourScale,
    sheet::{DisplayGrid, MapWindow, PixelInterpolator, sheet},
};
use schemas::Fault;

/// The colour scale is made from a reduced map with at most this number of nodes per axis, so that it does not depend
/// on the size of the picture.
const SCALE_NODES: usize = 1024;

/// Colour scale of a map.
///
/// # Errors
/// Returns the errors of [`ColourScale::new`].
pub fn colour_scale(picture: &MapPicture, look: &MapStyle) -> Result<ColourScale, Fault> {
    let reduced = sheet(picture, &MapWindow::from_picture(picture), (SCALE_NODES, SCALE_NODES));
    ColourScale::new(&reduced.values, look.scale, look.palette)
}

/// Ratio of the ground length of a step along the map's x to the ground length of a step along y.
pub fn shrink(picture: &MapPicture) -> f64 {
    match picture.plane {
        AxisQuantity::Metres => 1.0,
        AxisQuantity::Degrees => (0.5 * (picture.y.first + picture.y.last())).to_radians().cos().max(0.02),
    }
}

/// Map prepared for pictures of similar size.
pub struct ColouredMap<'a> {
    sheet: DisplayGrid,
    lights: Option<Vec<f64>>,
    lit: ShadedPalette,
    scale: &'a ColourScale,
    blend: bool,
}

impl<'a> ColouredMap<'a> {
    /// Prepares the whole map for a picture of `size` pixels.
    pub fn new(picture: &MapPicture, look: &MapStyle, scale: &'a ColourScale, size: (usize, usize)) -> ColouredMap<'a> {
        let sheet = sheet(picture, &MapWindow::from_picture(picture), size);
        let ground = shrink(picture) * sheet.x.step / sheet.y.step;
        let lights = look.shade.map(|shade| light(&sheet, ground, &shade));
        ColouredMap { sheet, lights, lit: ShadedPalette::new(scale.palette()), scale, blend: look.blend }
    }

    /// Red, green, blue and opacity of the pixels of a part of the map, rows from the north; unknown pixels are
    /// transparent.
    pub fn pixels(&self, window: &MapWindow, size: (usize, usize)) -> Vec<u8> {
        let enlarged = PixelInterpolator::new(&self.sheet, window, size, self.blend);
        let values = enlarged.interpolate(&self.sheet.values);
        let lights = self.lights.as_ref().map(|l| enlarged.interpolate(l));
        let light = |k: usize| lights.as_ref().and_then(|l| l.get(k)).copied().unwrap_or(1.0);
        let colour = |(k, value): (usize, &f64)| {
            if !value.is_finite() {
                return [0; 4];
            }
            let [r, g, b] = self.lit.colour(self.scale.part(*value), light(k));
            [r, g, b, 255]
        };
        values.iter().enumerate().flat_map(colour).collect()
    }
}
