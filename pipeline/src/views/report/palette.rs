//! The colour scale: viridis, of even steps to the eye and readable without red or green.

/// Viridis (S. van der Walt and N. Smith, CC0) at every tenth.
const ANCHORS: [[u8; 3]; 11] = [
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

/// The colour at `part` of the scale, 0 to 1, as red, green and blue.
pub fn colour(part: f64) -> [u8; 3] {
    let steps = (ANCHORS.len() - 1) as f64;
    let along = if part.is_finite() { part.clamp(0.0, 1.0) * steps } else { 0.0 };
    let low = (along.floor() as usize).min(ANCHORS.len() - 2);
    let (a, b) = (ANCHORS[low], ANCHORS[low + 1]);
    let weight = along - low as f64;
    let mix = |i: usize| (f64::from(a[i]) + weight * (f64::from(b[i]) - f64::from(a[i]))).round() as u8;
    [mix(0), mix(1), mix(2)]
}

/// A colour as style sheets spell it.
pub fn hex([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Black or white, whichever is read more easily on `colour` (WCAG 2, relative luminance).
pub fn ink_on(colour: [u8; 3]) -> &'static str {
    let linear = |c: u8| (f64::from(c) / 255.0).powf(2.2);
    let [r, g, b] = colour.map(linear);
    let luminance = 0.2126 * r + 0.7152 * g + 0.0722 * b;
    if luminance > 0.179 { "#000" } else { "#fff" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ref_ends_of_viridis() {
        assert_eq!(hex(colour(0.0)), "#440154");
        assert_eq!(hex(colour(1.0)), "#fde725");
        assert_eq!(hex(colour(0.5)), "#21918c");
        assert_eq!(colour(f64::NAN), colour(-3.0));
    }

    #[test]
    fn law_it_grows_lighter_all_the_way() {
        let luminance = |k: i32| {
            let [r, g, b] = colour(f64::from(k) / 100.0).map(|c| (f64::from(c) / 255.0).powf(2.2));
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        assert!((1..=100).all(|k| luminance(k) > luminance(k - 1)));
        assert_eq!((ink_on(colour(0.0)), ink_on(colour(1.0))), ("#fff", "#000"));
    }
}
