//! Metrics of a map along the line.

use numerics::{
    earth::geodesy::EarthModel,
    regression::statistics::{self, SampleStatistic},
};
use schemas::{Fault, metric::MetricDisplay};

use super::{line::ScoreLine, metric::metric, source::ScoreSource};

metric! {
    /// expected error due to the difference between the height of the map and the height of the line; with
    /// `map_levels_m`, expected error of the map's continuation
    MAP_HEIGHT_ERROR = "map_height_error", unit "nT", pool Rms, better Neither, needs [Track, MapHeight];
    |line| Ok(statistics::mean(line.column(ScoreSource::MapHeight)?))
}

metric! {
    /// standard deviation (divisor n - 1) of the compensated signal minus core field, diurnal variation and map
    MAP_STD_ERROR = "map_std_error", unit "nT", pool Rms, better Lower,
    shown MetricDisplay::column(130, 100).rank(60), needs [Map, Signal, Core], uses [Diurnal];
    |line| line.map_error().map(|e| SampleStatistic { value: e.std, n: e.n })
}

metric! {
    /// mean of the compensated signal minus core field, diurnal variation and map
    MAP_BIAS_ERROR = "map_bias_error", unit "nT", pool Mean, better Neither,
    needs [Map, Signal, Core], uses [Diurnal];
    |line| line.map_error().map(|e| SampleStatistic { value: e.mean, n: e.n })
}

metric! {
    /// root mean square slope of the map along the track
    MAP_GRADIENT_ALONG_TRACK = "map_gradient_along_track", unit "nT/m", pool Rms, better Neither,
    shown MetricDisplay::column(140, 10), needs [Map, Position];
    gradient_along_track
}

metric! {
    /// lower bound on the rms horizontal error with which the map determines a constant position offset of the line
    MAP_POSITION_BOUND = "map_position_bound", unit "m", pool Rms, better Neither,
    shown MetricDisplay::column(150, 70), needs [Map, Position];
    |line| {
        let (north, east) = slopes(line)?;
        Ok(statistics::offset_bound(north, east, line.stage.map_sigma_nt))
    }
}

/// Slopes of the map, north and east, in nT/m.
fn slopes<'a>(line: &'a ScoreLine) -> Result<(&'a [f64], &'a [f64]), Fault> {
    Ok((line.named(ScoreSource::Map, "map_grad_n")?, line.named(ScoreSource::Map, "map_grad_e")?))
}

/// Slope along the track from one sample to the next.
fn gradient_along_track(line: &ScoreLine) -> Result<SampleStatistic, Fault> {
    let (lat, lon) = line.position()?;
    let (north, east) = slopes(line)?;
    let along = (1..lat.len()).map(|i| {
        let (n, e) = EarthModel::default().offset_ne_m((lat[i - 1], lon[i - 1]), (lat[i], lon[i]), 0.0);
        (north[i] * n + east[i] * e) / n.hypot(e)
    });
    Ok(statistics::rms(&along.collect::<Vec<_>>()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::testing::{TRUE_POSITION, seconds, value};

    #[test]
    fn law_a_northward_slope_has_no_gradient_along_an_eastward_track() {
        let (still, along) = (|| seconds(10, |_| 50.0), || seconds(10, |t| 50.0 + 0.001 * t));
        let table = |lat, lon| {
            let slope = [("map_grad_n", seconds(10, |_| 0.03)), ("map_grad_e", seconds(10, |_| 0.0))];
            [[(TRUE_POSITION[0], lat), (TRUE_POSITION[1], lon), ("map_anomaly", still())]
                .into_iter()
                .chain(slope)
                .collect::<Vec<_>>()]
        };
        let (north, east) = (table(along(), still()), table(still(), along()));
        assert!((value(&MAP_GRADIENT_ALONG_TRACK, &north).value - 0.03).abs() < 1e-15);
        // A parallel is not straight, but its curvature over a step of 70 m is negligible.
        assert!(value(&MAP_GRADIENT_ALONG_TRACK, &east).value < 1e-6);
        // On a constant slope, a constant offset is not separable from a position offset.
        assert!(value(&MAP_POSITION_BOUND, &north).value.is_nan());
    }

    #[test]
    fn law_signal_minus_core_field_and_map_is_the_map_error() {
        let map = seconds(10, |t| 5.0 * t);
        let core = seconds(10, |t| 52_000.0 + t);
        let mag = map.iter().zip(&core).map(|(m, c)| m + c - 7.0).collect();
        let slopes = [("map_grad_n", seconds(10, |_| 0.0)), ("map_grad_e", seconds(10, |_| 0.0))];
        let table = [("mag_c", mag), ("igrf", core), ("map_anomaly", map)].into_iter().chain(slopes).collect();
        let tables = [table];
        assert_eq!(value(&MAP_BIAS_ERROR, &tables), SampleStatistic { value: -7.0, n: 10 });
        assert_eq!(value(&MAP_STD_ERROR, &tables), SampleStatistic { value: 0.0, n: 10 });
    }
}
