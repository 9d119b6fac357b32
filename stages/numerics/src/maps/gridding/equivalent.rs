//! Equivalent sources: a field that satisfies Laplace's equation above its sources and fits the measurements.
//!
//! Sources are vertical dipoles on evenly spaced nodes beneath the measurements, in layers from deep to shallow. Each
//! layer is fitted to the residuals of the deeper layers, by damped least squares. Deep sources thus explain long
//! wavelengths and extend them smoothly across the gaps between lines; shallow sources keep the detail along the lines.
//! The method is the gradient boosting of Soler & Uieda (2021), "Gradient-boosted equivalent sources", with layers of
//! the whole survey instead of windows. Conjugate gradients solve the normal equations, with products computed by the
//! far-field sums of `far_field`. Memory therefore grows linearly with the number of points, not quadratically.

use super::block::{BlockReduction, reduce_blocks};
use super::clusters::{ClusterTree, PointPositions};
use super::far_field::{ProxySources, all_proxies};
use super::layer::{FittedSourceLayer, LEAF, SourceFitOptions, SourceLayer, SourceLayerReport, add, squares};
use super::nearest::{PointCellIndex, range};
use super::normal::LayerNormalEquations;
use super::plane::RegionalPlane;
use super::windows::SchwarzPreconditioner;
use super::{GriddingError, GriddingProgress, check_columns};
use rayon::prelude::*;

/// Number of nearest measurements that determine the depth of a source. The source lies beneath the lowest of them.
const AROUND: usize = 8;

/// Search radius, in depths, for the nearest measurement in each quadrant. A source also lies beneath these
/// measurements.
const BESIDE: f64 = 8.0;

/// Minimum height above a source, as a fraction of its depth. At smaller heights, a single source dominates and the
/// field is invalid.
const CLEAR: f64 = 0.5;

/// Opening criterion for the summation of distant boxes in predictions. The error is below 0.01 nT at Osborne, whose
/// anomalies reach 5600 nT.
const PREDICT_FAR: f64 = 0.3;

/// Side of the blocks over which measurements are averaged for the fit of a layer, as a fraction of the layer's depth.
const THIN: f64 = 0.25;

/// Field values in nT and their derivatives in nT/m at positions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FieldGradients {
    /// The field, in nT.
    pub value_nt: Vec<f64>,
    /// Derivative of the field towards east, in nT/m.
    pub by_east: Vec<f64>,
    /// Derivative of the field towards north, in nT/m.
    pub by_north: Vec<f64>,
    /// Derivative of the field upward, in nT/m.
    pub by_up: Vec<f64>,
}

/// Fitted equivalent sources.
pub struct EquivalentSources {
    origin_m: [f64; 2],
    plane: RegionalPlane,
    layers: Vec<FittedSourceLayer>,
}

impl EquivalentSources {
    /// Fits sources to `value_nt` measured at eastings, northings and heights in metres.
    ///
    /// # Errors
    ///
    /// Fails without points, for columns of different lengths, or for values that are not finite.
    pub fn fit(
        at_m: [&[f64]; 3],
        value_nt: &[f64],
        options: &SourceFitOptions,
        progress: GriddingProgress,
    ) -> Result<(Self, Vec<SourceLayerReport>), GriddingError> {
        let mut sources = Self::place(at_m, value_nt, &options.layers)?;
        let reports = sources.solve(at_m, value_nt, options, progress)?;
        Ok((sources, reports))
    }

    /// Places sources beneath `value_nt` measured at eastings, northings and heights in metres, for a fit by
    /// [`Self::solve`]. Before the fit, the predicted field is only the plane fitted to the values.
    ///
    /// # Errors
    ///
    /// Fails without points, for columns of different lengths, or for values that are not finite.
    pub fn place(at_m: [&[f64]; 3], value_nt: &[f64], layers: &[SourceLayer]) -> Result<Self, GriddingError> {
        check_columns(&[at_m[0], at_m[1], at_m[2], value_nt])?;
        if value_nt.is_empty() {
            return Err(GriddingError::NoPoints);
        }
        let origin_m = [middle(at_m[0]), middle(at_m[1])];
        let points = relative(at_m, origin_m);
        let plane = RegionalPlane::fitted([&points.east, &points.north], value_nt);
        let near = PointCellIndex::new(&points.east, &points.north);
        let placed = layers.iter().map(|layer| (layer, source_places(&points, &near, layer)));
        let layers =
            placed.filter(|(_, at)| at.len() > 0).map(|(layer, at)| FittedSourceLayer::at(&at, *layer)).collect();
        Ok(Self { origin_m, plane, layers })
    }

    /// Fits the sources placed by [`Self::place`] to the values.
    ///
    /// # Errors
    ///
    /// Fails for columns of different lengths, or for values that are not finite.
    pub fn solve(
        &mut self,
        at_m: [&[f64]; 3],
        value_nt: &[f64],
        options: &SourceFitOptions,
        progress: GriddingProgress,
    ) -> Result<Vec<SourceLayerReport>, GriddingError> {
        check_columns(&[at_m[0], at_m[1], at_m[2], value_nt])?;
        let points = relative(at_m, self.origin_m);
        let places = ClusterTree::new(&points, LEAF);
        let off_plane = |i: usize| value_nt[i] - self.plane.at(points.east[i], points.north[i]);
        let mut rest: Vec<f64> = (0..points.len()).map(off_plane).collect();
        let count = self.layers.len();
        for (at, fitted) in self.layers.iter_mut().enumerate() {
            progress("equivalent sources", at, count);
            fitted.report.iterations = fitted.solve(&points, &rest, options);
            let explained = fitted.spread(PREDICT_FAR).values(&places, 1.0);
            add(&mut rest, &places.unsorted(&explained), -fitted.scale());
            fitted.report.rms_nt = (squares(&rest) / rest.len() as f64).sqrt();
        }
        progress("equivalent sources", count, count);
        Ok(self.layers.iter().map(|layer| layer.report).collect())
    }

    /// Checks that the field is defined at eastings, northings and heights in metres: above the sources near each
    /// position.
    ///
    /// # Errors
    /// Fails at the first position where the field is undefined, with the lowest height that is valid at all positions.
    /// Also fails for columns of different lengths and for values that are not finite.
    pub fn check_above(&self, at_m: [&[f64]; 3]) -> Result<(), GriddingError> {
        check_columns(&at_m)?;
        self.check_points(&relative(at_m, self.origin_m))
    }

    fn check_points(&self, points: &PointPositions) -> Result<(), GriddingError> {
        let least = self.layers.iter().map(|layer| layer.least_m(points)).filter(|layer| !layer.is_empty());
        let higher = |a: Vec<f64>, b: Vec<f64>| a.into_iter().zip(b).map(|(a, b)| f64::max(a, b)).collect();
        let least = least.reduce(higher).unwrap_or_default();
        let Some(i) = least.iter().zip(&points.up).position(|(least, up)| least > up) else { return Ok(()) };
        let lowest_m = least.iter().fold(f64::NEG_INFINITY, |a, b| a.max(*b));
        let at_m = [points.east[i] + self.origin_m[0], points.north[i] + self.origin_m[1]];
        Err(GriddingError::BelowSources { height_m: points.up[i], at_m, lowest_m })
    }

    /// The field in nT at eastings, northings and heights in metres.
    ///
    /// # Errors
    /// Fails if a position is not above the sources near it, where the field is undefined. Also fails for columns of
    /// different lengths, or for values that are not finite.
    pub fn predict(&self, at_m: [&[f64]; 3]) -> Result<Vec<f64>, GriddingError> {
        let targets = self.targets(at_m)?;
        let mut sum = vec![0.0; targets.points.len()];
        for layer in &self.layers {
            let values = layer.spread(PREDICT_FAR).values(&targets, 1.0);
            add(&mut sum, &values, layer.scale());
        }
        let points = &targets.points;
        let places = points.east.iter().zip(&points.north);
        sum.iter_mut().zip(places).for_each(|(s, (e, n))| *s += self.plane.at(*e, *n));
        Ok(targets.unsorted(&sum))
    }

    /// Field in nT as in [`Self::predict`], with NaN at positions that are not above the sources near them.
    ///
    /// # Errors
    /// Fails for columns of different lengths, or for values that are not finite.
    pub fn predict_above(&self, at_m: [&[f64]; 3]) -> Result<Vec<f64>, GriddingError> {
        check_columns(&at_m)?;
        let points = relative(at_m, self.origin_m);
        let mut above = vec![true; points.len()];
        for layer in &self.layers {
            above.iter_mut().zip(layer.above(&points)).for_each(|(a, b)| *a &= b);
        }
        let kept: Vec<usize> = (0..above.len()).filter(|&i| above[i]).collect();
        let some = at_m.map(|axis| kept.iter().map(|&i| axis[i]).collect::<Vec<f64>>());
        let values = self.predict([&some[0], &some[1], &some[2]])?;
        let mut all = vec![f64::NAN; above.len()];
        kept.into_iter().zip(values).for_each(|(i, v)| all[i] = v);
        Ok(all)
    }

    /// The field and its derivatives at eastings, northings and heights in metres.
    ///
    /// # Errors
    ///
    /// Returns the errors of [`Self::predict`].
    pub fn predict_gradients(&self, at_m: [&[f64]; 3]) -> Result<FieldGradients, GriddingError> {
        let targets = self.targets(at_m)?;
        let points = &targets.points;
        let plane = points.east.iter().zip(&points.north).map(|(e, n)| self.plane.at(*e, *n)).collect();
        let flat = |slope: f64| vec![slope; points.len()];
        let mut sums = [plane, flat(self.plane.slope[0]), flat(self.plane.slope[1]), flat(0.0)];
        for layer in &self.layers {
            let fields = layer.spread(PREDICT_FAR).gradients(&targets);
            fields.iter().zip(&mut sums).for_each(|(field, sum)| add(sum, field, layer.scale()));
        }
        let [value_nt, by_east, by_north, by_up] = sums.map(|sum| targets.unsorted(&sum));
        Ok(FieldGradients { value_nt, by_east, by_north, by_up })
    }

    /// The number of sources.
    pub fn sources(&self) -> usize {
        self.layers.iter().map(|layer| layer.strength.len()).sum()
    }

    /// The height of the highest source, in metres.
    pub fn top_m(&self) -> f64 {
        let tops = self.layers.iter().map(|layer| range(&layer.clusters.points.up)[1]);
        tops.fold(f64::NEG_INFINITY, f64::max)
    }

    /// Largest error in nT of the prediction at about `count` of the positions, compared with the sum over all sources.
    pub fn summation_error_nt(&self, at_m: [&[f64]; 3], predicted_nt: &[f64], count: usize) -> f64 {
        let step = (predicted_nt.len() / count.max(1)).max(1);
        let thin = at_m.map(|axis| axis.iter().copied().step_by(step).collect::<Vec<f64>>());
        let points = relative([&thin[0], &thin[1], &thin[2]], self.origin_m);
        let exact: Vec<f64> = (0..points.len()).into_par_iter().map(|i| self.directly(&points, i)).collect();
        predicted_nt.iter().step_by(step).zip(&exact).fold(0.0, |worst: f64, (a, b)| worst.max((a - b).abs()))
    }

    fn directly(&self, points: &PointPositions, i: usize) -> f64 {
        let mut sum = self.plane.at(points.east[i], points.north[i]);
        for layer in &self.layers {
            let mut one = [0.0];
            let at = layer.clusters.points.part(0..layer.strength.len());
            super::kernel::add_values(
                points.part(i..i + 1),
                super::kernel::PointSources { at, strength: &layer.strength },
                1.0,
                &mut one,
            );
            sum += layer.scale() * one[0];
        }
        sum
    }

    fn targets(&self, at_m: [&[f64]; 3]) -> Result<ClusterTree, GriddingError> {
        check_columns(&at_m)?;
        let points = relative(at_m, self.origin_m);
        self.check_points(&points)?;
        Ok(ClusterTree::new(&points, LEAF))
    }
}

impl FittedSourceLayer {
    fn spread(&self, far: f64) -> ProxySources<'_> {
        ProxySources::new(&self.clusters, &self.proxies, &self.strength, far)
    }

    /// Fits a layer by conjugate gradients on the damped normal equations, with measurements thinned to the resolution
    /// of the layer.
    fn solve(&mut self, points: &PointPositions, rest: &[f64], options: &SourceFitOptions) -> usize {
        let thin = [&points.east[..], &points.north, &points.up, rest];
        let thin = reduce_blocks(thin, THIN * self.depth_m, BlockReduction::Mean);
        let at = PointPositions { east: thin.easting_m, north: thin.northing_m, up: thin.height_m };
        let data = ClusterTree::new(&at, LEAF);
        let windows = SchwarzPreconditioner::new(&self.clusters, &data, self.depth_m, options.damping);
        let normal = LayerNormalEquations { layer: self, data: &data, data_proxies: all_proxies(&data) };
        let (strength, iterations) = normal.solve(data.sorted(&thin.value_nt), &windows, options);
        self.strength = strength;
        iterations
    }

    /// Whether each target is at least half the layer's depth above the source nearest to the target.
    fn above(&self, targets: &PointPositions) -> Vec<bool> {
        let least = self.least_m(targets);
        (0..targets.len()).map(|i| least.get(i).is_none_or(|least| *least <= targets.up[i])).collect()
    }

    /// Minimum height at each target: half the layer's depth above the nearest source. Empty if every target is that
    /// far above all sources.
    fn least_m(&self, targets: &PointPositions) -> Vec<f64> {
        let sources = &self.clusters.points;
        if range(&sources.up)[1] + CLEAR * self.depth_m <= range(&targets.up)[0] {
            return vec![];
        }
        let near = PointCellIndex::new(&sources.east, &sources.north);
        let least = |i: usize| {
            let found = near.nearest([targets.east[i], targets.north[i]], 1, f64::INFINITY, |_| true);
            found.first().map_or(f64::NEG_INFINITY, |f| sources.up[f.1] + CLEAR * self.depth_m)
        };
        (0..targets.len()).into_par_iter().map(least).collect()
    }
}

/// Evenly spaced nodes of a layer that have a measurement within reach, each `depth_m` beneath the lowest measurement
/// around it.
fn source_places(points: &PointPositions, near: &PointCellIndex, layer: &SourceLayer) -> PointPositions {
    let nodes = |axis: &[f64]| -> Vec<f64> {
        let [a, b] = range(axis).map(|x| x / layer.spacing_m);
        let out = (layer.reach_m / layer.spacing_m).ceil();
        let (first, last) = ((a.floor() - out) as i64, (b.ceil() + out) as i64);
        (first..=last).map(|k| k as f64 * layer.spacing_m).collect()
    };
    let (east, north) = (nodes(&points.east), nodes(&points.north));
    let rows: Vec<Vec<[f64; 3]>> = north
        .par_iter()
        .map(|&n| {
            let height = |e: f64| {
                let found = near.nearest([e, n], AROUND, layer.reach_m, |_| true);
                let lowest = found.iter().map(|f| points.up[f.1]).reduce(f64::min)?;
                Some(lowest.min(lowest_beside(points, near, [e, n], BESIDE * layer.depth_m)))
            };
            east.iter().filter_map(|&e| height(e).map(|up| [e, n, up - layer.depth_m])).collect()
        })
        .collect();
    let axis = |k: usize| rows.iter().flatten().map(|place| place[k]).collect();
    PointPositions { east: axis(0), north: axis(1), up: axis(2) }
}

fn relative(at_m: [&[f64]; 3], origin: [f64; 2]) -> PointPositions {
    PointPositions {
        east: at_m[0].iter().map(|e| e - origin[0]).collect(),
        north: at_m[1].iter().map(|n| n - origin[1]).collect(),
        up: at_m[2].to_vec(),
    }
}

fn middle(values: &[f64]) -> f64 {
    let [a, b] = range(values);
    (0.5 * (a + b)).round()
}

/// Lowest of the nearest measurements in each quadrant: neighbouring lines may be lower than the nearest line.
fn lowest_beside(points: &PointPositions, near: &PointCellIndex, [e, n]: [f64; 2], reach_m: f64) -> f64 {
    let quadrant = |i: usize| [points.east[i] >= e, points.north[i] >= n];
    let found = [[true, true], [true, false], [false, true], [false, false]]
        .map(|which| near.nearest([e, n], 1, reach_m, |i| quadrant(i) == which));
    found.iter().flatten().map(|f| points.up[f.1]).fold(f64::INFINITY, f64::min)
}
