//! Mapping of values to the colours of a palette.

use numerics::regression::statistics::quantile;
use schemas::Fault;

use crate::{
    palette::Palette,
    ticks::{self, AxisTick},
};

/// Mapping of values to colours.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ColourMapping {
    /// Linear from the smallest to the largest value.
    Linear,
    /// By rank: each colour covers an equal share of the area, so that long tails do not dominate.
    #[default]
    Equalised,
    /// Linear between two percentiles, 0 to 100; values beyond them have the colours of the ends.
    Percentile(f64, f64),
    /// Linear between two values; values beyond them have the colours of the ends.
    Range(f64, f64),
}

/// Number of quantiles of an equalised scale.
const QUANTILES: usize = 256;

/// Colours of values.
#[derive(Clone, Debug)]
pub struct ColourScale {
    /// At least two values with their positions on the palette, both ascending, with linear interpolation in between.
    knots: Vec<(f64, f64)>,
    palette: Palette,
    equalised: bool,
    /// Whether there are values below the first value of the scale, and whether there are values above the last value.
    pub beyond: (bool, bool),
}

impl ColourScale {
    /// Colour scale for `values`, ignoring values that are not finite.
    ///
    /// # Errors
    /// Fails if no value is known, or percentiles or range are not ascending.
    pub fn new(values: &[f64], scale: ColourMapping, palette: Palette) -> Result<ColourScale, Fault> {
        let mut known: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
        known.sort_unstable_by(f64::total_cmp);
        let (Some(least), Some(most)) = (known.first().copied(), known.last().copied()) else {
            return Err(Fault::data("the map has no known value and cannot be drawn"));
        };
        let equalised = scale == ColourMapping::Equalised && most > least;
        let knots = match scale {
            ColourMapping::Equalised if equalised => equal_areas(known, palette),
            ColourMapping::Equalised | ColourMapping::Linear => even(least, most, palette),
            ColourMapping::Percentile(low, high) => {
                in_order("percentiles", low, high, (0.0, 100.0))?;
                even(quantile(&known, low / 100.0), quantile(&known, high / 100.0), palette)
            }
            ColourMapping::Range(low, high) => {
                in_order("ends of the colour scale", low, high, (f64::MIN, f64::MAX))?;
                fixed(low, high, palette)
            }
        };
        let mut made = ColourScale { knots, palette, equalised, beyond: (false, false) };
        made.beyond = (least < made.low(), most > made.high());
        Ok(made)
    }

    /// Value of the first colour.
    pub fn low(&self) -> f64 {
        self.knots.first().map_or(f64::NAN, |k| k.0)
    }

    /// Value of the last colour.
    pub fn high(&self) -> f64 {
        self.knots.last().map_or(f64::NAN, |k| k.0)
    }

    /// Position of a value on the palette, 0 to 1.
    pub fn part(&self, value: f64) -> f64 {
        follow(&self.knots, value, |k| *k)
    }

    /// Position of a value on the colour bar, 0 to 1.
    pub fn along(&self, value: f64) -> f64 {
        let (first, last) = self.parts();
        (self.part(value) - first) / (last - first)
    }

    /// Value at a position on the colour bar, 0 to 1.
    pub fn value_at(&self, along: f64) -> f64 {
        let (first, last) = self.parts();
        follow(&self.knots, first + along * (last - first), |k| (k.1, k.0))
    }

    /// Colour at a position on the colour bar, 0 to 1.
    pub fn colour_at(&self, along: f64) -> [u8; 3] {
        let (first, last) = self.parts();
        self.palette.colour(first + along * (last - first))
    }

    /// The palette.
    pub fn palette(&self) -> Palette {
        self.palette
    }

    /// Whether values are mapped by rank.
    pub fn by_rank(&self) -> bool {
        self.equalised
    }

    fn parts(&self) -> (f64, f64) {
        (self.knots.first().map_or(0.0, |k| k.1), self.knots.last().map_or(1.0, |k| k.1))
    }

    /// At most `most` values for labels of the colour bar: round values of a linear scale, evenly spaced values of an
    /// equalised scale.
    pub fn ticks(&self, most: usize) -> Vec<AxisTick> {
        if !self.equalised {
            return ticks::linear(self.low(), self.high(), most);
        }
        let gaps = most.saturating_sub(1).clamp(1, 10);
        let values: Vec<f64> = (0..=gaps).map(|k| self.value_at(k as f64 / gaps as f64)).collect();
        let narrowest = values.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0.0).fold(f64::INFINITY, f64::min);
        let decimals = (-narrowest.log10().floor()).clamp(0.0, 6.0) as usize;
        values.into_iter().map(|at| AxisTick { at, label: ticks::fixed(at, decimals) }).collect()
    }
}

fn in_order(what: &str, low: f64, high: f64, within: (f64, f64)) -> Result<(), Fault> {
    if low < high && low >= within.0 && high <= within.1 {
        return Ok(());
    }
    let help = if within.1 == 100.0 {
        "give two percentages from 0 to 100, with the smaller one first"
    } else {
        "give the smaller one first"
    };
    Err(Fault::new(format!("{low} and {high} are not valid {what}")).help(help))
}

/// Linear from `low` to `high`, and symmetric about zero if the palette is symmetric.
fn even(low: f64, high: f64, palette: Palette) -> Vec<(f64, f64)> {
    let largest = low.abs().max(high.abs());
    if palette == Palette::Diverging && largest > 0.0 {
        return vec![(-largest, 0.0), (largest, 1.0)];
    }
    if high - low > 1e-12 * largest {
        return vec![(low, 0.0), (high, 1.0)];
    }
    // The scale of a map with one value surrounds this value, so that the value has a colour and a label.
    let around = if low == 0.0 { 1.0 } else { 1e-3 * low.abs() };
    vec![(low - around, 0.0), (low + around, 1.0)]
}

/// Linear scale between the requested ends; a diverging palette keeps white at zero.
fn fixed(low: f64, high: f64, palette: Palette) -> Vec<(f64, f64)> {
    if palette != Palette::Diverging {
        return vec![(low, 0.0), (high, 1.0)];
    }
    let largest = low.abs().max(high.abs());
    [low, high].map(|v| (v, 0.5 + 0.5 * v / largest)).to_vec()
}

/// Equal areas for equal parts of the palette. In a palette centred on zero, each half is ranked by magnitude.
fn equal_areas(mut sorted: Vec<f64>, palette: Palette) -> Vec<(f64, f64)> {
    if palette != Palette::Diverging {
        return ranks(&sorted);
    }
    sorted.iter_mut().for_each(|v| *v = v.abs());
    sorted.sort_unstable_by(f64::total_cmp);
    let mut half = ranks(&sorted);
    half.retain(|k| k.0 > 0.0);
    let mirrored = half.iter().rev().map(|(v, p)| (-v, 0.5 - 0.5 * p));
    mirrored.chain([(0.0, 0.5)]).chain(half.iter().map(|(v, p)| (*v, 0.5 + 0.5 * p))).collect()
}

/// Values at evenly spaced ranks, each with its rank; equal values appear once, at the middle of their ranks.
fn ranks(sorted: &[f64]) -> Vec<(f64, f64)> {
    let mut knots: Vec<(f64, f64)> = vec![];
    let mut tied_from = 0.0;
    for k in 0..=QUANTILES {
        let part = k as f64 / QUANTILES as f64;
        let value = quantile(sorted, part);
        match knots.last_mut() {
            Some(last) if value <= last.0 => last.1 = 0.5 * (tied_from + part),
            _ => {
                tied_from = part;
                knots.push((value, part));
            }
        }
    }
    if let [(only, _)] = knots[..] { even(only, only, Palette::Viridis) } else { knots }
}

/// Linear interpolation in `knots`, constant beyond the first and the last knot.
fn follow(knots: &[(f64, f64)], at: f64, sides: impl Fn(&(f64, f64)) -> (f64, f64)) -> f64 {
    let next = knots.partition_point(|k| sides(k).0 <= at);
    let before = next.checked_sub(1).and_then(|k| knots.get(k)).map(&sides);
    match (before, knots.get(next).map(&sides)) {
        (Some((a, from)), Some((b, to))) => from + (at - a) / (b - a) * (to - from),
        (Some((_, end)), None) | (None, Some((_, end))) => end,
        (None, None) => f64::NAN,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn tailed() -> Vec<f64> {
        (0..2000).map(|k| (f64::from(k) / 200.0).exp() - 50.0).chain([f64::NAN]).collect()
    }

    #[test]
    fn unit_equal_areas_have_equal_parts() {
        let values = tailed();
        let scale = ColourScale::new(&values, ColourMapping::Equalised, Palette::Turbo).unwrap();
        let mut counts = [0; 10];
        values.iter().filter(|v| v.is_finite()).for_each(|v| counts[((scale.part(*v) * 10.0) as usize).min(9)] += 1);
        // 2000 values in ten parts: because of the knots, one or two values may be in an adjacent part.
        assert!(counts.iter().all(|n| (197..=203).contains(n)), "{counts:?}");
    }

    #[test]
    fn unit_bar_positions_invert_the_scale() {
        for (scale, palette) in [
            (ColourMapping::Linear, Palette::Viridis),
            (ColourMapping::Equalised, Palette::Diverging),
            (ColourMapping::Equalised, Palette::Turbo),
            (ColourMapping::Percentile(2.0, 98.0), Palette::Diverging),
            (ColourMapping::Range(-10.0, 300.0), Palette::Diverging),
        ] {
            let made = ColourScale::new(&tailed(), scale, palette).unwrap();
            for k in 0..=20 {
                let along = f64::from(k) / 20.0;
                let value = made.value_at(along);
                assert!((made.along(value) - along).abs() < 1e-9, "{scale:?} {along}");
                // Rounding may select either of two adjacent colours.
                let (there, back) = (made.colour_at(along), palette.colour(made.part(value)));
                assert!(there.iter().zip(back).all(|(a, b)| a.abs_diff(b) <= 1), "{scale:?} {along}");
            }
            assert_eq!((made.value_at(0.0), made.value_at(1.0)), (made.low(), made.high()));
        }
    }

    #[test]
    fn unit_the_diverging_palette_has_white_at_zero() {
        for scale in [
            ColourMapping::Linear,
            ColourMapping::Equalised,
            ColourMapping::Percentile(1.0, 90.0),
            ColourMapping::Range(-7.0, 900.0),
        ] {
            let made = ColourScale::new(&tailed(), scale, Palette::Diverging).unwrap();
            assert!((made.part(0.0) - 0.5).abs() < 1e-12, "{scale:?}");
            assert!((made.part(5.0) + made.part(-5.0) - 1.0).abs() < 1e-12, "{scale:?}");
        }
    }

    #[test]
    fn unit_scale_surrounds_a_single_value() {
        for value in [0.0, -3.5, 48_000.0] {
            for scale in [ColourMapping::Linear, ColourMapping::Equalised, ColourMapping::Percentile(2.0, 98.0)] {
                let made = ColourScale::new(&[value; 4], scale, Palette::Viridis).unwrap();
                assert!(made.low() < value && value < made.high());
                assert!((made.part(value) - 0.5).abs() < 1e-9 && !made.ticks(6).is_empty());
            }
        }
    }

    #[test]
    fn unit_values_beyond_the_ends_are_detected() {
        let made = |scale| ColourScale::new(&[0.0, 1.0, 2.0, 10.0], scale, Palette::Viridis).unwrap().beyond;
        assert_eq!(made(ColourMapping::Linear), (false, false));
        assert_eq!(made(ColourMapping::Range(-1.0, 5.0)), (false, true));
        assert_eq!(made(ColourMapping::Range(0.5, 50.0)), (true, false));
        assert_eq!(made(ColourMapping::Percentile(10.0, 90.0)), (true, true));
    }

    #[test]
    fn unit_plateaus_are_mapped_and_wrong_ends_rejected() {
        // Nine tenths of the values are zeros. Their colour is at the middle of their ranks, and the scale still
        // ascends.
        let values: Vec<f64> = (0..100).map(|k| if k < 90 { 0.0 } else { f64::from(k) }).collect();
        let made = ColourScale::new(&values, ColourMapping::Equalised, Palette::Viridis).unwrap();
        assert!(made.knots.windows(2).all(|w| w[0].0 < w[1].0 && w[0].1 < w[1].1));
        assert_eq!(made.low(), 0.0);
        for scale in
            [ColourMapping::Range(2.0, 2.0), ColourMapping::Range(f64::NAN, 1.0), ColourMapping::Percentile(-1.0, 50.0)]
        {
            assert!(ColourScale::new(&values, scale, Palette::Viridis).is_err());
        }
        assert!(ColourScale::new(&[f64::NAN], ColourMapping::Linear, Palette::Viridis).is_err());
    }

    #[test]
    fn gold_labels_of_an_equalised_scale() {
        let made = ColourScale::new(&tailed(), ColourMapping::Equalised, Palette::Viridis).unwrap();
        let labels: Vec<String> = made.ticks(5).into_iter().map(|t| t.label).collect();
        assert_eq!(labels, ["\u{2212}49", "\u{2212}38", "98", "1751", "21867"]);
    }
}
