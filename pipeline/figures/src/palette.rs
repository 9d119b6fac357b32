//! Colour scales, perceptually uniform.

/// Viridis (S. van der Walt and N. Smith, CC0) at every tenth.
const VIRIDIS: [[u8; 3]; 11] = [
    [0x44, 0x01, 0x54],
    [0x48, 0x24, 0x75],
    [0x41, 0x44, 0x87],
    [0x35, 0x5f, 0x8d],
    [0x2a, 0x78, 0x8e],
    [0x21, 0x91, 0x8c],
    [0x22, 0xa8, 0x84],
    [0x44, 0xbf, 0x70],
    [0x7a, 0xd1, 0x51],
    [0xbd, 0xdf, 0x26],
    [0xfd, 0xe7, 0x25],
];

/// Turbo (A. Mikhailov, Google, 2019, Apache-2.0) at every fifteenth of its 256 colours: 0, 17, 34 ... 255.
const TURBO: [[u8; 3]; 16] = [
    [48, 18, 59],
    [65, 67, 167],
    [71, 113, 233],
    [62, 155, 254],
    [34, 197, 226],
    [26, 228, 182],
    [70, 248, 132],
    [136, 255, 78],
    [185, 246, 53],
    [225, 221, 55],
    [250, 186, 57],
    [253, 141, 39],
    [240, 91, 18],
    [214, 53, 6],
    [175, 24, 1],
    [122, 4, 3],
];

/// ColorBrewer's RdBu of eleven classes, reversed (C. Brewer, Apache-2.0).
const DIVERGING: [[u8; 3]; 11] = [
    [0x05, 0x30, 0x61],
    [0x21, 0x66, 0xac],
    [0x43, 0x93, 0xc3],
    [0x92, 0xc5, 0xde],
    [0xd1, 0xe5, 0xf0],
    [0xf7, 0xf7, 0xf7],
    [0xfd, 0xdb, 0xc7],
    [0xf4, 0xa5, 0x82],
    [0xd6, 0x60, 0x4d],
    [0xb2, 0x18, 0x2b],
    [0x67, 0x00, 0x1f],
];

/// Colour scale.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Palette {
    /// Dark blue to yellow with increasing lightness, readable without red or green.
    #[default]
    Viridis,
    /// Rainbow of potential-field maps, without the false edges of a rainbow with uneven lightness.
    Turbo,
    /// Blue over white to red: white is zero, and colours of equal magnitude have equal distance from white.
    Diverging,
}

impl Palette {
    /// Colour at the fraction `part` of the scale, 0 to 1, as red, green and blue.
    pub fn colour(self, part: f64) -> [u8; 3] {
        match self {
            Palette::Viridis => between(&VIRIDIS, part),
            Palette::Turbo => between(&TURBO, part),
            Palette::Diverging => between(&DIVERGING, part),
        }
    }
}

fn between<const N: usize>(anchors: &[[u8; 3]; N], part: f64) -> [u8; 3] {
    let along = if part.is_finite() { part.clamp(0.0, 1.0) * (N - 1) as f64 } else { 0.0 };
    let low = (along.floor() as usize).min(N - 2);
    let (a, b) = (anchors[low], anchors[low + 1]);
    let weight = along - low as f64;
    let mix = |i: usize| (f64::from(a[i]) + weight * (f64::from(b[i]) - f64::from(a[i]))).round() as u8;
    [mix(0), mix(1), mix(2)]
}

/// Colour in CSS notation.
pub fn hex([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Black or white, whichever has the higher contrast on `colour` (WCAG 2, relative luminance).
pub fn ink_on(colour: [u8; 3]) -> &'static str {
    if luminance(colour) > 0.179 { "#000" } else { "#fff" }
}

fn luminance(colour: [u8; 3]) -> f64 {
    let [r, g, b] = colour.map(|c| (f64::from(c) / 255.0).powf(2.2));
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

#[cfg(test)]
mod tests {
    use super::*;

    fn along(palette: Palette) -> Vec<f64> {
        (0..=100).map(|k| luminance(palette.colour(f64::from(k) / 100.0))).collect()
    }

    #[test]
    fn ref_ends_and_middles() {
        let spelt = |p: Palette| [0.0, 0.5, 1.0].map(|part| hex(p.colour(part)));
        assert_eq!(spelt(Palette::Viridis), ["#440154", "#21918c", "#fde725"]);
        assert_eq!(spelt(Palette::Diverging), ["#053061", "#f7f7f7", "#67001f"]);
        let [low, _, high] = spelt(Palette::Turbo);
        assert_eq!((low.as_str(), high.as_str()), ("#30123b", "#7a0403"));
        assert_eq!(Palette::Turbo.colour(f64::NAN), Palette::Turbo.colour(-3.0));
    }

    #[test]
    fn ref_turbo_between_its_anchors() {
        // Three colours of the published table; linear interpolation between anchors is off by at most 8 levels.
        for (index, published) in [(42, [70, 133, 250]), (110, [101, 253, 105]), (195, [249, 117, 29])] {
            let ours = Palette::Turbo.colour(f64::from(index) / 255.0);
            assert!(ours.iter().zip(published).all(|(a, b)| a.abs_diff(b) <= 8), "{index}: {ours:?}");
        }
    }

    #[test]
    fn unit_viridis_lightness_increases() {
        assert!(along(Palette::Viridis).windows(2).all(|w| w[1] > w[0]));
        assert_eq!((ink_on(VIRIDIS[0]), ink_on(VIRIDIS[10])), ("#fff", "#000"));
    }

    #[test]
    fn unit_the_diverging_scale_darkens_away_from_its_middle() {
        let light = along(Palette::Diverging);
        assert!(light[..51].windows(2).all(|w| w[1] > w[0]) && light[50..].windows(2).all(|w| w[1] < w[0]));
    }
}
