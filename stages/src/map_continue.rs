//! Continues a map to another height.

use arrow_array::RecordBatch;
use grids::{AnomalyGrid, GridHeight};
use numerics::maps::{
    continuation::{
        DrapeOptions, LCurve, MAGNAV_ALPHA_M2, MapDerivative, MapSpectrum, Padding, Regularisation, downward,
        drape_to_level, edge_error, is_far, level_to_drape, masked_like, upward,
    },
    plane_grid::PlaneGrid,
};
use schemas::{Fault, MapStage, NumberOrAuto, Rule, Stage, StageOutput, StageSchema, Table, choice, stage};

use crate::{
    columns::data,
    made_map::{grids, made, whole_map, without_gaps},
};

choice! {
    /// Direction of differentiation.
    pub enum DerivativeDirection {
        /// Up.
        Up = "up",
        /// North, along the northing of the map.
        North = "north",
        /// East, along the easting of the map.
        East = "east",
        /// Up, second derivative.
        Up2 = "up2",
    }
}

stage! {
    /// Continues a map to another height, or differentiates it. A level map is continued to another level or to the
    /// heights of another map on the same grid (`drape`). A draped map is continued to a level.
    ///
    /// Use `map_continue` to bring a map to the flight height, or to bring several maps to one height before they are
    /// combined. Upward continuation is stable, because it smooths the field. Downward continuation amplifies short
    /// wavelengths and noise, so it is damped by `alpha_m2`. The damping removes part of the signal. Unknown nodes are
    /// filled by minimum curvature for the transform and are unknown again in the result. The result has errors near
    /// the map's edges, because the field beyond them is unknown. Keep the change of height below 1/50 of the map's
    /// shorter side, or remove the edges afterwards.
    ///
    /// These are rejected: a map without a known height, a derivative of a draped map, and a `drape` that is on another
    /// grid or has one height for all nodes.
    ///
    /// Source: Blakely 1996, sections 12.1 and 12.2; Gnadt 2022, section 2.3 (downward continuation).
    MapContinue = "map_continue", version 1, grain Map, inputs [map: Map, drape: Map optional],
    example r#"
[[stages]]
name  = "map_continue"
stage = "map_continue"
map   = "map_fill"
to_m  = 400.0
"#;
    /// Height above the WGS-84 ellipsoid to which the map is continued.
    to_m: Option<f64>, unit "m", absent "the heights of `drape` if it is given, otherwise the map's own height";
    /// Derivative that is returned instead of the field, in nT/m (`up2`: second vertical derivative, in nT/m2).
    derivative: Option<DerivativeDirection>, unit "", absent "the field itself";
    /// Damping of downward continuation. `auto` uses the corner of the L-curve.
    alpha_m2: NumberOrAuto, unit "m2", default NumberOrAuto::Auto, rule Rule::NotNegative;
    /// Keeps the result at nodes that are unknown in the input map.
    keep_filled: bool, unit "", default false;
}

/// Result of a continuation.
pub struct ContinuationResult {
    /// The map.
    pub map: AnomalyGrid,
    /// Notes on the processing.
    pub notes: Vec<String>,
    /// Warnings about untrustworthy results.
    pub warnings: Vec<String>,
    /// L-curve of a downward continuation.
    pub curve: Option<LCurve>,
    /// Estimated error of each node from the unknown field beyond the map's edges, in nT. `None` if it was not
    /// estimated.
    pub edge_error: Option<PlaneGrid>,
}

/// Map during processing.
struct ContinuationJob<'a> {
    stage: &'a MapContinue,
    map: &'a AnomalyGrid,
    /// The map with gaps.
    original: PlaneGrid,
    /// The map without gaps.
    plane: PlaneGrid,
    notes: Vec<String>,
    warnings: Vec<String>,
    curve: Option<LCurve>,
    edge_error: Option<PlaneGrid>,
}

impl MapContinue {
    /// Rejects incompatible parameters. `draped` states whether the heights of another map are given.
    ///
    /// # Errors
    /// Fails with the parameter and the remedy if the parameters are incompatible.
    pub fn check(&self, draped: bool) -> Result<(), Fault> {
        match (draped, self.to_m, self.derivative) {
            (false, None, None) => {
                let help = "set `to_m`, `derivative` or `drape`";
                Err(Fault::new("no continuation and no derivative is requested").help(help))
            }
            (true, Some(_), _) => {
                Err(Fault::new("`to_m` and `drape` cannot be combined; remove one of them").of_param("to_m"))
            }
            (true, _, Some(_)) => {
                let fault = Fault::new("`derivative` requires a level and cannot be combined with `drape`");
                Err(fault.of_param("derivative"))
            }
            (_, Some(to_m), _) if !to_m.is_finite() => {
                Err(Fault::new(format!("`to_m` is {to_m} but must be a finite number, in metres")).of_param("to_m"))
            }
            _ => Ok(()),
        }
    }

    /// Continues a map, to the heights of `drape` if given.
    ///
    /// # Errors
    /// See [`MapContinue`].
    pub fn apply(&self, map: &AnomalyGrid, drape: Option<&AnomalyGrid>) -> Result<ContinuationResult, Fault> {
        self.check(drape.is_some())?;
        let original = map.plane();
        let plane = without_gaps(&original).map_err(data)?;
        let (notes, warnings) = (vec![], vec![]);
        let mut job =
            ContinuationJob { stage: self, map, original, plane, notes, warnings, curve: None, edge_error: None };
        let gaps = job.original.unknown();
        if gaps > 0 {
            job.notes.push(format!("{gaps} unknown nodes are filled from their surroundings for the transform"));
        }
        let (plane, height) = match (drape, &map.height) {
            (Some(drape), GridHeight::Level(level_m)) => job.onto(*level_m, drape)?,
            (Some(_), GridHeight::Cells(_)) => {
                return Err(Fault::data("the map is draped, so it cannot be continued to `drape`")
                    .help("continue the map to a level first with `map_continue` and `to_m`"));
            }
            (None, GridHeight::Cells(_)) if self.derivative.is_some() => {
                let fault = Fault::data("a draped map cannot be differentiated");
                return Err(fault.help("continue the map to a level first with `map_continue` and `to_m`"));
            }
            (None, GridHeight::Cells(heights)) => job.drape_to(heights, self.to_m.unwrap_or(f64::NAN))?,
            (None, GridHeight::Level(level_m)) => job.level_to(*level_m)?,
        };
        job.finish(plane, height)
    }
}

impl ContinuationJob<'_> {
    fn known_level(&self, level_m: f64) -> Result<f64, Fault> {
        let help = "set `alt_m` of the map, in metres above the WGS-84 ellipsoid";
        let fault = || Fault::data("the height of the map is unknown").help(help);
        if level_m.is_finite() { Ok(level_m) } else { Err(fault()) }
    }

    fn warn_if_far(&mut self, distance_m: f64) {
        if is_far(&self.plane, distance_m) {
            self.warnings.push(format!(
                "the continuation by {distance_m:.0} m exceeds 1/50 of the map's shorter side, so the unknown field \
                 beyond the map's edges causes errors"
            ));
        }
    }

    fn regularisation(&self) -> Regularisation {
        self.stage.alpha_m2.given().map_or(Regularisation::LCurve, Regularisation::Alpha)
    }

    /// Damping of a downward continuation by at most `down_m`, in m².
    fn alpha_m2(&self, down_m: f64) -> Result<f64, Fault> {
        Ok(match self.regularisation() {
            Regularisation::Alpha(alpha_m2) => alpha_m2,
            Regularisation::LCurve if down_m <= 0.0 => MAGNAV_ALPHA_M2,
            Regularisation::LCurve => {
                downward(&self.plane, down_m, Regularisation::LCurve, &Padding::default()).map_err(data)?.alpha_m2
            }
        })
    }

    /// Continues a level map to `to_m` and computes the derivative there, if one is requested. Without `to_m`, computes
    /// the derivative at the level of the map.
    fn level_to(&mut self, level_m: f64) -> Result<(PlaneGrid, GridHeight), Fault> {
        let padding = Padding::default();
        let Some(to_m) = self.stage.to_m else {
            let along = self.stage.derivative.map_or(MapDerivative::Up, which);
            let spectrum = MapSpectrum::new(&self.plane, 0.0, &padding).map_err(data)?;
            return Ok((spectrum.derivative(along, 0.0, 0.0).map_err(data)?, GridHeight::Level(level_m)));
        };
        let up_m = to_m - self.known_level(level_m)?;
        self.warn_if_far(up_m);
        let (plane, alpha_m2) = if up_m < 0.0 {
            let down = downward(&self.plane, -up_m, self.regularisation(), &padding).map_err(data)?;
            self.notes.push(format!(
                "the map is continued downward by {:.1} m with alpha = {:.3e} m2; continued back up, the result \
                 differs from the map by {:.3} nT rms",
                -up_m, down.alpha_m2, down.regularisation_error_nt
            ));
            self.curve = Some(down.curve);
            (down.map, down.alpha_m2)
        } else {
            (upward(&self.plane, up_m, &padding).map_err(data)?, 0.0)
        };
        let plane = match self.stage.derivative {
            Some(along) => {
                let spectrum = MapSpectrum::new(&self.plane, up_m, &padding).map_err(data)?;
                spectrum.derivative(which(along), up_m, alpha_m2).map_err(data)?
            }
            None => plane,
        };
        if let Ok(error) = edge_error(&self.plane, up_m, alpha_m2, &padding) {
            self.notes.push(format!(
                "the unknown field beyond the map's edges causes an error of about {:.3} nT rms over the map",
                error.rms_nt
            ));
            self.edge_error = Some(error.map);
        }
        Ok((plane, GridHeight::Level(to_m)))
    }

    fn drape_to(&mut self, heights: &[f64], to_m: f64) -> Result<(PlaneGrid, GridHeight), Fault> {
        let heights = self.complete(heights)?;
        self.warn_if_far(heights.iter().map(|h| (to_m - h).abs()).fold(0.0, f64::max));
        let alpha_m2 = self.alpha_m2(heights.iter().map(|h| h - to_m).fold(0.0, f64::max))?;
        let drape = DrapeOptions { alpha_m2, ..DrapeOptions::default() };
        let plane = drape_to_level(&self.plane, &heights, to_m, &drape).map_err(data)?;
        Ok((plane, GridHeight::Level(to_m)))
    }

    fn onto(&mut self, level_m: f64, drape: &AnomalyGrid) -> Result<(PlaneGrid, GridHeight), Fault> {
        let level_m = self.known_level(level_m)?;
        let GridHeight::Cells(heights) = &drape.height else {
            let fault = Fault::data("the map `drape` has one height for all nodes");
            return Err(fault.help("set `to_m` to that height"));
        };
        // The axes of grids from different files may differ by rounding errors.
        let near = |a: f64, b: f64, step: f64| (a - b).abs() < 1e-3 * step;
        let same = [(&drape.x, &self.map.x), (&drape.y, &self.map.y)]
            .iter()
            .all(|(a, b)| a.len == b.len && near(a.first, b.first, b.step) && near(a.last(), b.last(), b.step));
        if !same || drape.crs != self.map.crs {
            return Err(Fault::data("the map `drape` is not on the grid of the input map"));
        }
        let heights = self.complete(heights)?;
        self.warn_if_far(heights.iter().map(|h| (level_m - h).abs()).fold(0.0, f64::max));
        let alpha_m2 = self.alpha_m2(heights.iter().map(|h| level_m - h).fold(0.0, f64::max))?;
        let drape = DrapeOptions { alpha_m2, ..DrapeOptions::default() };
        let plane = level_to_drape(&self.plane, level_m, &heights, &drape).map_err(data)?;
        Ok((plane, GridHeight::Cells(heights)))
    }

    /// Heights of all nodes. Unknown heights are filled from their surroundings.
    fn complete(&self, heights: &[f64]) -> Result<Vec<f64>, Fault> {
        let heights = without_gaps(&self.original.with(heights.to_vec()));
        heights.map(|grid| grid.values).map_err(data)
    }

    fn finish(self, plane: PlaneGrid, height: GridHeight) -> Result<ContinuationResult, Fault> {
        let plane = if self.stage.keep_filled { plane } else { masked_like(plane, &self.original) };
        let value_unit = unit(self.stage.derivative);
        let map = AnomalyGrid { height, value_unit, ..self.map.with_plane_values(plane.values)? };
        let ContinuationJob { notes, warnings, curve, edge_error, .. } = self;
        Ok(ContinuationResult { map, notes, warnings, curve, edge_error })
    }
}

fn which(along: DerivativeDirection) -> MapDerivative {
    match along {
        DerivativeDirection::Up => MapDerivative::Up,
        DerivativeDirection::North => MapDerivative::North,
        DerivativeDirection::East => MapDerivative::East,
        DerivativeDirection::Up2 => MapDerivative::UpTwice,
    }
}

/// Unit of the values of a map, or of its derivative.
fn unit(derivative: Option<DerivativeDirection>) -> &'static str {
    match derivative {
        None => schemas::map::ANOMALY_UNIT,
        Some(DerivativeDirection::Up | DerivativeDirection::North | DerivativeDirection::East) => "nT/m",
        Some(DerivativeDirection::Up2) => "nT/m2",
    }
}

impl Stage for MapContinue {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        self.check(inputs.len() > 1).map_err(|fault| vec![fault])?;
        Ok(schemas::map::yields(unit(self.derivative), vec![whole_map(); inputs.len()]))
    }
}

impl MapStage for MapContinue {
    fn run(&self, maps: &[RecordBatch]) -> Result<StageOutput, Fault> {
        let done = match grids(maps)?.as_slice() {
            [map] => self.apply(map, None)?,
            [map, drape, ..] => self.apply(map, Some(drape))?,
            [] => return Err(Fault::bug("a stage that works on maps has no map")),
        };
        made(&done.map, done.warnings)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::made_map::testing::{K, LEVEL_M, NODES, STEP_M, field_nt, map, middle};

    fn continued(to_m: Option<f64>, derivative: Option<DerivativeDirection>) -> MapContinue {
        MapContinue { to_m, derivative, alpha_m2: NumberOrAuto::Auto, keep_filled: false }
    }

    #[test]
    fn law_a_wave_decays_upward_and_its_slope_is_known() {
        let up = continued(Some(LEVEL_M + 100.0), None).apply(&map(), None).unwrap();
        assert_eq!((up.map.height.clone(), up.map.value_unit), (GridHeight::Level(400.0), "nT"));
        let slope = continued(None, Some(DerivativeDirection::Up)).apply(&map(), None).unwrap();
        assert_eq!((slope.map.height.clone(), slope.map.value_unit), (GridHeight::Level(300.0), "nT/m"));
        let k = K[0].hypot(K[1]);
        for ((east, north, value), (_, _, slope)) in middle(&up.map).into_iter().zip(middle(&slope.map)) {
            // The field beyond the edges is estimated, with an error of about 3 % at 100 m.
            assert!((value - field_nt(east, north, 100.0)).abs() < 3.0, "{east} {north} {value}");
            assert!((slope + k * field_nt(east, north, 0.0)).abs() < 0.03, "{east} {north} {slope}");
        }
        assert_eq!(up.warnings.len(), 1, "{:?}", up.warnings);
    }

    #[test]
    fn unit_unknown_nodes_stay_unknown_unless_filled_values_are_kept() {
        let mut holed = map();
        let hole = 20 * NODES + 20;
        holed.anomaly_nt[hole] = f64::NAN;
        let stage = continued(Some(310.0), None);
        assert!(stage.apply(&holed, None).unwrap().map.anomaly_nt[hole].is_nan());
        let kept = MapContinue { keep_filled: true, ..stage }.apply(&holed, None).unwrap();
        let expected = field_nt(20.0 * STEP_M, 20.0 * STEP_M, 10.0);
        assert!((kept.map.anomaly_nt[hole] - expected).abs() < 5.0);
    }

    #[test]
    fn gold_impossible_continuations_are_rejected_with_the_reason() {
        let refused = |stage: MapContinue, map: &AnomalyGrid, drape: Option<&AnomalyGrid>| {
            stage.apply(map, drape).err().map(|f| f.to_string()).unwrap_or_default()
        };
        let unknown = AnomalyGrid { height: GridHeight::Level(f64::NAN), ..map() };
        assert!(refused(continued(Some(400.0), None), &unknown, None).contains("height of the map is unknown"));
        assert!(refused(continued(None, None), &map(), None).contains("no continuation and no derivative"));
        assert!(refused(continued(None, None), &map(), Some(&map())).contains("one height"));
        let draped = AnomalyGrid { height: GridHeight::Cells(vec![LEVEL_M; NODES * NODES]), ..map() };
        assert!(
            refused(continued(None, Some(DerivativeDirection::Up)), &draped, None).contains("cannot be differentiated")
        );
        assert!(refused(continued(None, None), &draped, Some(&draped)).contains("the map is draped"));
        assert!(refused(continued(Some(1.0), None), &map(), Some(&draped)).contains("cannot be combined"));
        let mut shifted = draped.clone();
        shifted.x.first += STEP_M;
        assert!(refused(continued(None, None), &map(), Some(&shifted)).contains("not on the grid of the input map"));
        assert_eq!(refused(continued(None, None), &map(), Some(&draped)), "");
    }
}
