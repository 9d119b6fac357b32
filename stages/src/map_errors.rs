//! Errors of a map between its nodes, and at heights other than the height of the map.

use arrow_array::RecordBatch;
use numerics::{
    maps::{
        continuation::{MAGNAV_ALPHA_M2, RadialPower},
        map_stack::FieldMap,
        map_surface::MapInterpolation,
        plane_grid::PlaneGrid,
        undersampling::interpolation_error,
    },
    navigation::{line::NavigationLine, map_noise},
};
use schemas::{Fault, map::ERROR};

use crate::{
    columns::{data, floats},
    maps::{column_map, map_of_values, plane},
};

/// Error of a map at a height other than the height of the map.
enum HeightError {
    /// Map that is not continued: its height, in metres, and its mean square by wavenumber.
    AsItIs { own_m: f64, power: RadialPower },
    /// Continued map: height of each level, in metres, and error there, in nT.
    Continued(Vec<(f64, f64)>),
}

/// Source of the error of a map's nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NodeErrorSource {
    /// No error.
    None,
    /// The map's column `error`.
    Column,
    /// The map itself: the error of cubic interpolation between nodes that are too far apart.
    Interpolation,
}

/// Error of a map's nodes.
struct NodeError {
    /// Standard deviation of each node's error, in nT.
    map: FieldMap,
    /// Root mean square over all nodes, in nT.
    rms_nt: f64,
    /// Height at which the error has these values, in metres; `None` if the error is assumed equal at all heights.
    level_m: Option<f64>,
}

/// Errors of a map that are computed from the map itself.
pub struct MapErrors {
    height: HeightError,
    /// Rms error of bilinear interpolation, in nT, and length of a cell, in metres; `None` with another interpolation.
    bilinear: Option<(f64, f64)>,
    /// Error of each node.
    own: Option<NodeError>,
    /// Length of a cell, in metres.
    cell_m: f64,
}

impl MapErrors {
    /// Errors of a map table. `levels_m` are the heights of the continuation, in metres above the ellipsoid, ascending.
    /// `bilinear` states whether the interpolation is bilinear. `own` is the source of the nodes' error.
    ///
    /// # Errors
    /// Fails if the table is not a grid, or lacks the column of that source.
    pub fn new(
        map: &RecordBatch,
        levels_m: Option<&[f64]>,
        bilinear: bool,
        own: NodeErrorSource,
    ) -> Result<Self, Fault> {
        let plane = plane(map)?;
        let known: Vec<f64> = floats(map, "alt")?.iter().copied().filter(|a| a.is_finite()).collect();
        let own_m = known.iter().sum::<f64>() / known.len() as f64;
        let power = RadialPower::from_map(&plane).map_err(data)?;
        let height = match levels_m {
            None => HeightError::AsItIs { own_m, power },
            Some(levels_m) => {
                let noise_nt = map.column_by_name(ERROR).map(|_| floats(map, ERROR).map(rms)).transpose()?.flatten();
                HeightError::Continued(level_errors(&power, noise_nt, (own_m, levels_m)))
            }
        };
        let cell_m = plane.east_m.step.max(plane.north_m.step);
        let own = match own {
            NodeErrorSource::None => None,
            NodeErrorSource::Column => {
                let rms_nt = rms(floats(map, ERROR)?).unwrap_or(0.0);
                let map = column_map(map, ERROR, MapInterpolation::Linear, None)?;
                Some(NodeError { map, rms_nt, level_m: None })
            }
            NodeErrorSource::Interpolation => {
                let error_of = |error: Vec<f64>| -> Result<NodeError, Fault> {
                    let rms_nt = rms(&error).unwrap_or(0.0);
                    let map = map_of_values(map, &error, MapInterpolation::Linear, None)?;
                    Ok(NodeError { map, rms_nt, level_m: levels_m.map(|_| own_m) })
                };
                interpolation_error(&plane).map(error_of).transpose()?
            }
        };
        Ok(Self { height, bilinear: bilinear.then(|| (bilinear_error_nt(&plane), cell_m)), own, cell_m })
    }

    /// Expected root mean square error, in nT, over the whole map at the mean of the heights `alt_m`, in metres above
    /// the ellipsoid. For a continued map, this is the error of the continuation. NaN if the height of the line is
    /// unknown or, for a map that is not continued, the height of the map is unknown.
    pub fn of_height_nt(&self, alt_m: &[f64]) -> f64 {
        let mean_m = alt_m.iter().sum::<f64>() / alt_m.len() as f64;
        match &self.height {
            _ if !mean_m.is_finite() => f64::NAN,
            HeightError::Continued(levels) => between(levels, mean_m),
            HeightError::AsItIs { own_m, power } => {
                let up_m = mean_m - own_m;
                if up_m.is_finite() { power.height_error_nt(up_m) } else { f64::NAN }
            }
        }
    }

    /// Length of a cell, in metres.
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Root mean square of the nodes' error over the map, in nT; 0 if this error is not used.
    pub fn rms_at_nodes_nt(&self) -> f64 {
        self.own.as_ref().map_or(0.0, |own| own.rms_nt)
    }

    /// Standard deviation of the nodes' error at each sample of a line, in nT.
    ///
    /// # Errors
    /// Fails in the cases of [`map_noise::along`].
    pub fn at_nodes_nt(&self, line: &NavigationLine<'_>) -> Result<Option<Vec<f64>>, Fault> {
        let Some(own) = &self.own else { return Ok(None) };
        let mut error_nt = map_noise::along(line, &own.map, 1.0).map_err(data)?;
        if let Some(level_m) = own.level_m.filter(|level_m| level_m.is_finite()) {
            // The error consists of wavelengths of about two cells.
            for (nt, alt_m) in error_nt.iter_mut().zip(line.ins.alt_m) {
                *nt *= (-std::f64::consts::PI * (alt_m - level_m).max(0.0) / self.cell_m).exp();
            }
        }
        Ok(Some(error_nt))
    }

    /// White noise, in nT per sample, that is equivalent to the interpolation error between nodes. Samples are `step_m`
    /// apart. The interpolation error is correlated over a cell.
    pub fn of_interpolation_nt(&self, step_m: f64) -> f64 {
        self.bilinear.map_or(0.0, |(error_nt, cell_m)| error_nt * (cell_m / step_m.min(cell_m)).sqrt())
    }
}

impl MapErrors {
    /// White noise of each sample, in nT, equivalent to the map's own error at the aircraft ([`map_noise::along`]). The
    /// autocorrelation of the error falls to 1/e over `length_m`; samples are `step_m` apart.
    ///
    /// # Errors
    /// Fails in the cases of [`map_noise::along`].
    pub fn own_nt(&self, line: &NavigationLine<'_>, step_m: f64, length_m: f64) -> Result<Option<Vec<f64>>, Fault> {
        let factor = lasting_factor(step_m, length_m);
        self.own.as_ref().map(|own| map_noise::along(line, &own.map, factor).map_err(data)).transpose()
    }
}

/// Error of each level, in nT. Below the map it is the amplified noise and the field that damping removes; it is zero
/// elsewhere. The unknown field beyond the edges of the map is ignored.
fn level_errors(power: &RadialPower, noise_nt: Option<f64>, (own_m, levels_m): (f64, &[f64])) -> Vec<(f64, f64)> {
    let error_nt = |level_m: f64| match own_m - level_m {
        down if down > 0.0 => power.downward_error_nt(down, MAGNAV_ALPHA_M2, noise_nt),
        unknown if unknown.is_nan() => f64::NAN,
        _ => 0.0,
    };
    levels_m.iter().map(|level| (*level, error_nt(*level))).collect()
}

/// Linear interpolation between ascending positions; the nearest value beyond the ends.
fn between(levels: &[(f64, f64)], at: f64) -> f64 {
    let after = levels.partition_point(|(level, _)| *level <= at);
    match (after.checked_sub(1).and_then(|before| levels.get(before)), levels.get(after)) {
        (Some((low, one)), Some((high, other))) => one + (other - one) * (at - low) / (high - low),
        (Some((_, only)), None) | (None, Some((_, only))) => *only,
        (None, None) => f64::NAN,
    }
}

/// Root mean square of the finite values; `None` if there are none.
fn rms(values: &[f64]) -> Option<f64> {
    let known: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
    (!known.is_empty()).then(|| (known.iter().map(|x| x * x).sum::<f64>() / known.len() as f64).sqrt())
}

/// Factor from an error with correlation length `length_m` to the equivalent white noise of samples `step_m` apart.
fn lasting_factor(step_m: f64, length_m: f64) -> f64 {
    (2.0 * length_m / step_m.min(2.0 * length_m)).sqrt()
}

/// Rms error of bilinear interpolation over the known cells. In the middle of a cell, the error is the difference from
/// cubic convolution (Keys 1981). The error decreases to 0 at the nodes.
fn bilinear_error_nt(map: &PlaneGrid) -> f64 {
    const WEIGHTS: [f64; 4] = [-1.0 / 16.0, 9.0 / 16.0, 9.0 / 16.0, -1.0 / 16.0];
    let (mut sum, mut cells) = (0.0, 0.0);
    for row in 1..map.rows().saturating_sub(2) {
        for column in 1..map.columns().saturating_sub(2) {
            let node = |r: usize, c: usize| map.get(row - 1 + r, column - 1 + c);
            let cubic: f64 = (0..16).map(|i| WEIGHTS[i / 4] * WEIGHTS[i % 4] * node(i / 4, i % 4)).sum();
            let linear = 0.25 * (node(1, 1) + node(1, 2) + node(2, 1) + node(2, 2));
            if cubic.is_finite() {
                sum += (cubic - linear).powi(2);
                cells += 1.0;
            }
        }
    }
    // Along one direction the error is proportional to 4t(1 - t), whose mean square is 8/15.
    if cells > 0.0 { (8.0 / 15.0 * sum / cells).sqrt() } else { 0.0 }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use numerics::maps::plane_grid::EvenAxis;

    #[test]
    fn law_a_correlated_error_equals_scaled_white_noise() {
        use arrow_array::{ArrayRef, Float64Array};
        use std::sync::Arc;
        let nodes = || (0..30).flat_map(|row| (0..30).map(move |column| (f64::from(row), f64::from(column))));
        let of = |f: &dyn Fn(f64, f64) -> f64| -> ArrayRef {
            Arc::new(Float64Array::from(nodes().map(|(row, column)| f(row, column)).collect::<Vec<f64>>()))
        };
        let columns = [
            ("lat", of(&|row, _| 45.0 + 0.001 * row)),
            ("lon", of(&|_, column| -75.0 + 0.001 * column)),
            ("alt", of(&|_, _| 300.0)),
            ("anomaly", of(&|row, column| row * column)),
            ("error", of(&|_, column| column)),
        ];
        let map = RecordBatch::try_from_iter(columns.clone()).unwrap();
        assert!(MapErrors::new(&map, None, true, NodeErrorSource::Column).unwrap().own.is_some());
        assert!(MapErrors::new(&map, None, true, NodeErrorSource::None).unwrap().own.is_none());
        // The errors of samples are correlated over L. A sum of n samples at intervals s has n · 2L/s times the
        // variance of one.
        assert_eq!(lasting_factor(50.0, 400.0), 4.0);
        // An error with a correlation length below a sample interval is white.
        assert_eq!(lasting_factor(50.0, 10.0), 1.0);
        let without = RecordBatch::try_from_iter(columns[..4].to_vec()).unwrap();
        assert!(MapErrors::new(&without, None, true, NodeErrorSource::Column).is_err());
    }

    #[test]
    fn law_bilinear_error_is_the_curvature_of_a_wave() {
        let axis = EvenAxis { first: 0.0, step: 100.0, len: 200 };
        let k = std::f64::consts::TAU / 2000.0;
        let wave = |east_m: f64| 10.0 * (k * east_m).sin();
        let values = (0..40_000).map(|i| wave(f64::from(i % 200) * 100.0)).collect();
        let map = PlaneGrid { east_m: axis, north_m: axis, values };
        let (mut sum, mut n) = (0.0, 0.0);
        for i in 0..20_000 {
            let east_m = 0.9 * f64::from(i) + 100.0;
            let (node, part) = ((east_m / 100.0).floor() * 100.0, (east_m / 100.0).fract());
            sum += (wave(node) * (1.0 - part) + wave(node + 100.0) * part - wave(east_m)).powi(2);
            n += 1.0;
        }
        let truth = (sum / n).sqrt();
        // The cubic convolution has an error of a few per cent of the error of linear interpolation.
        assert!((bilinear_error_nt(&map) / truth - 1.0).abs() < 0.1, "{} {truth}", bilinear_error_nt(&map));
        let errors = MapErrors {
            height: HeightError::Continued(vec![]),
            bilinear: Some((0.5, 100.0)),
            own: None,
            cell_m: 100.0,
        };
        assert_eq!(errors.of_interpolation_nt(6.25), 2.0);
        assert_eq!(errors.of_interpolation_nt(500.0), 0.5);
    }
}
