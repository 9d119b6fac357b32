//! Computes the components of the anomaly field from a map of the total-field anomaly.

use arrow_array::RecordBatch;
use grids::{AnomalyGrid, GridHeight};
use numerics::{
    earth::{core_field::CoreField, geodesy::EarthModel},
    maps::{
        continuation::{MapSpectrum, Padding, masked_like},
        magnetic_sources::direction,
        plane_grid::PlaneGrid,
    },
};
pub use schemas::map::VectorComponent;
use schemas::{Fault, MapStage, Rule, Stage, StageOutput, StageSchema, Table, stage};

use crate::{
    columns::data,
    made_map::{grids, made, whole_map, without_gaps},
};

/// Limit of the angle, in degrees, between the core field at the middle of the map and at a corner. Above it, the map
/// is too large for one direction.
const WIDEST_DEG: f64 = 2.0;

stage! {
    /// Computes a component of the anomaly field from a map of the total-field anomaly: towards true north, towards
    /// true east, or down. A sweep over `component` gives all three.
    ///
    /// The anomaly is the component of the anomaly field along the core field. Above all sources the anomaly field is
    /// the gradient of a potential. Let A be the spectrum of the anomaly, f the direction of the core field and k the
    /// wavenumber. The spectra of the components (east, north, up) are then
    ///
    /// B_e = i k_e A/d, B_n = i k_n A/d, B_u = -\|k\| A/d, with d = i (f_e k_e + f_n k_n) - f_u \|k\|
    ///
    /// The direction f applies to the centre of the map, and follows from `decimal_year`, or from `inclination_deg` and
    /// `declination_deg`. On a projected map, grid north is corrected to true north.
    ///
    /// \|d\| is at least \|k\| sin \|I\| at the inclination I, so errors of the map are amplified by up to 1/sin \|I\|.
    /// Near the magnetic equator, waves whose k is perpendicular to the core field are missing from the map. At
    /// inclinations below 15 degrees, these waves are damped, the components are too small, and a warning is reported.
    /// The mean and the trend of a map give no information on direction, and are assumed to be parallel to the core
    /// field. The field beyond the map's edges is unknown; discard a margin of 15 nodes. In the remaining area,
    /// components of dipoles below the map have errors of 1 % at inclinations of 25 degrees and above, 2 % at 16
    /// degrees, and 8 to 18 % at 5 degrees. Unknown nodes are filled by minimum curvature for the transform and are
    /// unknown again in the result.
    ///
    /// The result has the unit nT, but it is not a total-field anomaly: do not navigate with it. These are rejected: a
    /// draped map, a map of a derivative, and a direction that is missing or given twice.
    ///
    /// Source: Blakely 1996, section 12.3.1. (MagNav.jl's `vector_fft` counts the declination from east, inverts the
    /// vertical component, and adds the mean to each component.)
    MapVector = "map_vector", version 1, grain Map, inputs [map: Map],
    example r#"
[[stages]]
name         = "map_vector"
stage        = "map_vector"
map          = "map_continue"
component    = "north"
decimal_year = 2020.5
"#;
    /// Component of the field.
    component: VectorComponent, unit "", default VectorComponent::Down;
    /// Date of the core field (IGRF-14) that gives the direction.
    decimal_year: Option<f64>, unit "a", absent "the direction follows from `inclination_deg` and `declination_deg`",
        rule Rule::Between(1900.0, 2030.0);
    /// Inclination of the core field, downward from the horizontal.
    inclination_deg: Option<f64>, unit "deg", absent "the inclination of the core field",
        rule Rule::Between(-90.0, 90.0);
    /// Declination of the core field, from true north to east.
    declination_deg: Option<f64>, unit "deg", absent "the declination of the core field",
        rule Rule::Between(-180.0, 180.0);
    /// Keeps the result at nodes that are unknown in the input map.
    keep_filled: bool, unit "", default false;
}

/// Component of a map.
pub struct VectorMapResult {
    /// The map.
    pub map: AnomalyGrid,
    /// Notes on the processing.
    pub notes: Vec<String>,
    /// Warnings about untrustworthy results.
    pub warnings: Vec<String>,
}

impl MapVector {
    /// Rejects a direction that is missing or given twice.
    ///
    /// # Errors
    /// Fails with the parameter and the remedy if the direction is missing or given twice.
    pub fn check(&self) -> Result<(), Fault> {
        let help = "set `decimal_year`, or both `inclination_deg` and `declination_deg`";
        match (self.decimal_year, self.inclination_deg, self.declination_deg) {
            (Some(_), None, None) | (None, Some(_), Some(_)) => Ok(()),
            (Some(_), Some(_), _) | (Some(_), _, Some(_)) => {
                let fault = Fault::new("the direction of the core field is given twice");
                Err(fault.help(help).of_param("decimal_year"))
            }
            (None, ..) => {
                let fault = Fault::new("the direction of the core field is unknown");
                Err(fault.help(help).of_param("decimal_year"))
            }
        }
    }

    /// Computes the component of a map.
    ///
    /// # Errors
    /// See [`MapVector`].
    pub fn apply(&self, map: &AnomalyGrid) -> Result<VectorMapResult, Fault> {
        self.check()?;
        map.check_anomaly()?;
        let GridHeight::Level(level_m) = map.height else {
            let fault = Fault::data("the map is draped, so its field is not known on a level");
            return Err(fault.help("continue the map to a level first with `map_continue`"));
        };
        let (mut notes, mut warnings) = (vec![], vec![]);
        let middle = map.middle_deg().ok_or_else(|| Fault::data("the projection is undefined at the map's middle"))?;
        let [inclination_deg, declination_deg] = match (self.decimal_year, self.inclination_deg, self.declination_deg) {
            (Some(year), ..) => self.core_direction(map, middle, level_m, year, &mut warnings)?,
            (None, inclination_deg, declination_deg) => {
                [inclination_deg, declination_deg].map(|angle_deg| angle_deg.unwrap_or(f64::NAN))
            }
        };
        let grid_north_deg = grid_north_deg(map, middle)?;
        let original = map.plane();
        let plane = without_gaps(&original).map_err(data)?;
        let gaps = original.unknown();
        if gaps > 0 {
            notes.push(format!("{gaps} unknown nodes are filled from their surroundings for the transform"));
        }
        notes.push(format!(
            "core field: inclination {inclination_deg:.2} degrees, declination {declination_deg:.2} degrees; grid \
             north is {grid_north_deg:.2} degrees east of true north"
        ));
        let spectrum = MapSpectrum::new(&plane, 0.0, &Padding::default()).map_err(data)?;
        let along = direction(inclination_deg, declination_deg - grid_north_deg);
        let found = spectrum.components(along, 0.0, 0.0).map_err(data)?;
        if found.damped {
            warnings.push(format!(
                "the inclination of the core field is {inclination_deg:.1} degrees; if it is between -15 and 15 \
                 degrees, the map does not determine waves perpendicular to the core field, and the computed component \
                 is too small"
            ));
        }
        let (sin, cos) = grid_north_deg.to_radians().sin_cos();
        let [east, north, up] = [&found.east, &found.north, &found.up];
        let plane = match self.component {
            VectorComponent::North => combined(north, cos, east, -sin),
            VectorComponent::East => combined(north, sin, east, cos),
            VectorComponent::Down => combined(up, -1.0, east, 0.0),
        };
        let plane = if self.keep_filled { plane } else { masked_like(plane, &original) };
        Ok(VectorMapResult { map: map.with_plane_values(plane.values)?, notes, warnings })
    }

    /// Inclination and declination of the core field at the middle of the map, in degrees.
    fn core_direction(
        &self,
        map: &AnomalyGrid,
        (lat_deg, lon_deg): (f64, f64),
        level_m: f64,
        year: f64,
        warnings: &mut Vec<String>,
    ) -> Result<[f64; 2], Fault> {
        let core = CoreField::at(year).map_err(|e| data(e).of_param("decimal_year"))?;
        // A kilometre of height turns the core field by less than 0.01 degrees.
        let alt_m = if level_m.is_finite() { level_m } else { 0.0 };
        let field = |(lat_deg, lon_deg): (f64, f64)| core.field_ned_nt(lat_deg, lon_deg, alt_m);
        let middle = field((lat_deg, lon_deg));
        let corners = [map.x.first, map.x.last()].into_iter().flat_map(|x| [(x, map.y.first), (x, map.y.last())]);
        let angles_deg =
            corners.filter_map(|(x, y)| map.crs.unproject(x, y)).map(|place| angle_deg(middle, field(place)));
        let widest_deg = angles_deg.fold(0.0, f64::max);
        if widest_deg > WIDEST_DEG {
            warnings.push(format!(
                "the direction of the core field differs by {widest_deg:.1} degrees between the middle and a corner \
                 of the map; divide the map into parts"
            ));
        }
        let [north, east, down] = middle;
        Ok([down.atan2(north.hypot(east)), east.atan2(north)].map(f64::to_degrees))
    }
}

/// Angle between two vectors, in degrees.
fn angle_deg(a: [f64; 3], b: [f64; 3]) -> f64 {
    let dot = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    (dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()).clamp(-1.0, 1.0).acos().to_degrees()
}

/// Azimuth of grid north at the middle of the map, in degrees from true north to east; 0 for latitudes and longitudes.
fn grid_north_deg(map: &AnomalyGrid, middle: (f64, f64)) -> Result<f64, Fault> {
    if map.is_geographic() {
        return Ok(0.0);
    }
    let (x, y) = (0.5 * (map.x.first + map.x.last()), 0.5 * (map.y.first + map.y.last()));
    let ahead =
        map.crs.unproject(x, y + map.y.step).ok_or_else(|| Fault::data("grid north is undefined on the map"))?;
    let (north_m, east_m) = EarthModel::Wgs84.offset_ne_m(middle, ahead, 0.0);
    Ok(east_m.atan2(north_m).to_degrees())
}

/// Sum of multiples of two maps.
fn combined(one: &PlaneGrid, factor: f64, other: &PlaneGrid, other_factor: f64) -> PlaneGrid {
    one.with(one.values.iter().zip(&other.values).map(|(a, b)| factor * a + other_factor * b).collect())
}

impl Stage for MapVector {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        self.check().map_err(|fault| vec![fault])?;
        Ok(schemas::map::yields(schemas::map::ANOMALY_UNIT, vec![whole_map(); inputs.len()]))
    }
}

impl MapStage for MapVector {
    fn run(&self, maps: &[RecordBatch]) -> Result<StageOutput, Fault> {
        match grids(maps)?.as_slice() {
            [map, ..] => {
                let done = self.apply(map)?;
                made(&done.map, done.warnings)
            }
            [] => Err(Fault::bug("a stage that works on maps has no map")),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::path::Path;

    use grids::Crs;
    use numerics::maps::{
        magnetic_sources::{Dipole, EastNorthUp, total_field_anomaly_nt},
        plane_grid::EvenAxis,
    };

    use super::*;

    const SIDE: usize = 96;
    const STEP_M: f64 = 100.0;
    /// The south-west corner in UTM zone 32, two degrees east of the central meridian.
    const CORNER_M: [f64; 2] = [660_000.0, 5_000_000.0];

    fn given(component: VectorComponent, inclination_deg: f64, declination_deg: f64) -> MapVector {
        MapVector {
            component,
            decimal_year: None,
            inclination_deg: Some(inclination_deg),
            declination_deg: Some(declination_deg),
            keep_filled: false,
        }
    }

    /// Convergence of transverse Mercator at the middle of the map, tan γ = tan Δλ sin φ.
    fn convergence_deg() -> f64 {
        let middle = [0, 1].map(|axis| CORNER_M[axis] + 0.5 * STEP_M * (SIDE - 1) as f64);
        let (lat, lon) = Crs::from_epsg(Path::new(""), 32632).unwrap().unproject(middle[0], middle[1]).unwrap();
        ((lon - 9.0).to_radians().tan() * lat.to_radians().sin()).atan().to_degrees()
    }

    /// Field of dipoles 400 to 700 m below the map, magnetised along the core field, on the axes of the grid.
    fn field_nt(node: usize, along: EastNorthUp) -> EastNorthUp {
        let place = [STEP_M * (node % SIDE) as f64, STEP_M * (node / SIDE) as f64, 0.0];
        let spots =
            [(3100.0, 4200.0, 400.0), (5300.0, 3500.0, 500.0), (4600.0, 6000.0, 700.0), (6200.0, 5600.0, 450.0)];
        spots.iter().enumerate().fold([0.0; 3], |sum, (k, (x, y, depth))| {
            let moment_am2 = along.map(|part| part * [4e7, -3e7, 9e7, 5e7][k]);
            let field = Dipole { at_m: [*x, *y, -depth], moment_am2 }.field_nt(place);
            std::array::from_fn(|axis| sum[axis] + field[axis])
        })
    }

    fn map(along: EastNorthUp) -> AnomalyGrid {
        let axis = |first: f64| EvenAxis { first, step: STEP_M, len: SIDE };
        let values = (0..SIDE * SIDE).map(|node| total_field_anomaly_nt(field_nt(node, along), along)).collect();
        let crs = Crs::from_epsg(Path::new(""), 32632).unwrap();
        AnomalyGrid::new(axis(CORNER_M[0]), axis(CORNER_M[1]), crs, values, GridHeight::Level(0.0)).unwrap()
    }

    /// Root mean square of the error and of the exact component, in nT, excluding a margin of 15 nodes along the edges.
    fn error_nt(found: &AnomalyGrid, exact: impl Fn(usize) -> f64) -> [f64; 2] {
        let is_inside = |node: &usize| [node % SIDE, node / SIDE].iter().all(|at| (15..SIDE - 15).contains(at));
        let inside: Vec<usize> = (0..SIDE * SIDE).filter(is_inside).collect();
        let rms = |of: &dyn Fn(usize) -> f64| {
            (inside.iter().map(|node| of(*node).powi(2)).sum::<f64>() / inside.len() as f64).sqrt()
        };
        [rms(&|node| found.anomaly_nt[node] - exact(node)), rms(&exact)]
    }

    #[test]
    fn law_components_are_those_of_dipoles_about_true_north() {
        let gamma_deg = convergence_deg();
        assert!((1.4..1.6).contains(&gamma_deg), "{gamma_deg}");
        let (sin, cos) = gamma_deg.to_radians().sin_cos();
        for (inclination_deg, declination_deg, part) in
            [(66.0, 3.0, 0.01), (-40.0, -20.0, 0.012), (25.0, 10.0, 0.015), (16.0, 0.0, 0.025)]
        {
            let along = direction(inclination_deg, declination_deg - gamma_deg);
            let anomaly = map(along);
            for component in [VectorComponent::North, VectorComponent::East, VectorComponent::Down] {
                let done = given(component, inclination_deg, declination_deg).apply(&anomaly).unwrap();
                let exact = |node: usize| {
                    let [east, north, up] = field_nt(node, along);
                    match component {
                        VectorComponent::North => north * cos - east * sin,
                        VectorComponent::East => north * sin + east * cos,
                        VectorComponent::Down => -up,
                    }
                };
                let [error, size] = error_nt(&done.map, exact);
                let what = component.word();
                println!("{what} at {inclination_deg} degrees: {error:.3} nT of {size:.3} nT");
                assert!(error < part * size, "{what} at {inclination_deg} degrees: {error} of {size}");
                assert!(done.warnings.is_empty(), "{:?}", done.warnings);
            }
        }
    }

    #[test]
    fn law_the_core_field_of_a_date_gives_the_direction() {
        let core = CoreField::at(2020.5).unwrap();
        let anomaly = map(direction(60.0, 0.0));
        let (lat_deg, lon_deg) = anomaly.middle_deg().unwrap();
        let [north, east, down] = core.field_ned_nt(lat_deg, lon_deg, 0.0);
        let [inclination, declination] = [down.atan2(north.hypot(east)), east.atan2(north)].map(f64::to_degrees);
        let by_angles = given(VectorComponent::East, inclination, declination).apply(&anomaly).unwrap();
        let (decimal_year, none) = (Some(2020.5), None);
        let stage = given(VectorComponent::East, 0.0, 0.0);
        let dated = MapVector { decimal_year, inclination_deg: none, declination_deg: none, ..stage };
        assert_eq!(dated.apply(&anomaly).unwrap().map, by_angles.map);
    }

    #[test]
    fn law_a_nearly_horizontal_core_field_gives_a_warning() {
        let along = direction(5.0, 0.0);
        let done = given(VectorComponent::East, 5.0, 0.0).apply(&map(along)).unwrap();
        assert!(done.warnings[0].contains("the inclination of the core field is 5.0 degrees"), "{:?}", done.warnings);
        // The damped component is too small, not too large.
        let [_, found] = error_nt(&done.map, |node| done.map.anomaly_nt[node]);
        let [_, exact] = error_nt(&done.map, |node| field_nt(node, along)[0]);
        assert!(found < exact, "{found} {exact}");
    }

    #[test]
    fn gold_impossible_components_are_rejected_with_the_reason() {
        let anomaly = map(direction(60.0, 0.0));
        let refused = |stage: &MapVector, map: &AnomalyGrid| stage.apply(map).err().map(|f| f.to_string()).unwrap();
        let stage = given(VectorComponent::Down, 60.0, 0.0);
        let alone = MapVector { declination_deg: None, ..stage.clone() };
        assert!(refused(&alone, &anomaly).contains("the direction of the core field is unknown"));
        let twice = MapVector { decimal_year: Some(2020.0), ..stage.clone() };
        assert!(refused(&twice, &anomaly).contains("given twice"));
        let draped = AnomalyGrid { height: GridHeight::Cells(vec![1.0; SIDE * SIDE]), ..anomaly.clone() };
        assert!(refused(&stage, &draped).contains("the map is draped"));
        let slope = AnomalyGrid { value_unit: "nT/m", ..anomaly.clone() };
        assert!(refused(&stage, &slope).contains("the map holds a derivative"));
        let mut holed = anomaly.clone();
        holed.anomaly_nt[40 * SIDE + 40] = f64::NAN;
        assert!(stage.apply(&holed).unwrap().map.anomaly_nt[40 * SIDE + 40].is_nan());
        assert!(
            MapVector { keep_filled: true, ..stage }.apply(&holed).unwrap().map.anomaly_nt[40 * SIDE + 40].is_finite()
        );
    }
}
