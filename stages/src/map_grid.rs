//! Makes a map from survey points.

mod gather;
mod points;
#[cfg(test)]
mod tests;

use std::path::Path;

use arrow_array::ArrayRef;
use grids::{AnomalyGrid, Crs, GridHeight, SurveyPointSet};
use numerics::maps::{
    gridding::{
        self, CleaningOptions, GridRegion, GriddingError, GriddingMethod, GriddingOptions, GriddingReport,
        GriddingResult, LineFolds,
    },
    levelling::{CrossoverOptions, LevellingOptions, LevellingResult, find_crossovers, level_lines, tie_lines},
    plane_grid::PlaneGrid,
};
use schemas::{
    Column, ColumnType, DataLocation, Fault, MagneticCorrection, Rule, Stage, StageSchema, SurveyPoint, SurveyStage,
    Table, TableShape, choice, stage,
};

use crate::{
    columns::{data, shape},
    corrections::{REMOVE_DIURNAL, twice},
    map_convert::bounds_of,
};

choice! {
    /// Method that makes a surface from points.
    pub enum GridSurfaceMethod {
        /// Equivalent sources below the points: a potential field at any height.
        EquivalentSources = "equivalent_sources",
        /// Minimum curvature at the heights flown.
        MinimumCurvature = "minimum_curvature",
    }
}

choice! {
    /// Source of the core field that is subtracted.
    pub enum CoreFieldSource {
        /// No core field is subtracted.
        None = "none",
        /// IGRF-14.
        Igrf = "igrf",
        /// World Magnetic Model.
        Wmm = "wmm",
        /// Column `igrf`.
        Column = "column",
    }
}

stage! {
    /// Grids survey lines to a map. The stage subtracts the core field and the diurnal variation, levels the lines at
    /// their crossings, removes outliers, and fits a surface.
    ///
    /// Use `map_grid` to make a navigation map from the survey lines that `where` selects. `equivalent_sources` gives a
    /// potential field at one height, by default the height of the highest point. The potential field can be continued
    /// to other heights. `minimum_curvature` interpolates the values without continuing them to a common height, so it
    /// does not require heights. Levelling is part of this stage, because it uses the crossings in the map's
    /// coordinates and the values without core field and diurnal variation. Do not grid the lines that are navigated,
    /// because the map would then contain the field measured along these lines.
    ///
    /// These points are omitted: points without a position, a value or, for equivalent sources, a height; duplicates;
    /// outliers along a line; points far from all others; and lines of fewer than five points. These inputs are
    /// rejected: a level below the points, a spacing wider than the area, levelling of lines that do not cross, and a
    /// core field for points without a date.
    ///
    /// With `cross_validate`, every line is predicted from a map of other lines. The column `error` then holds the
    /// expected error of each node.
    ///
    /// Source: Soler and Uieda 2021, "Gradient-boosted equivalent sources"; Briggs 1974, Smith and Wessel 1990 (minimum
    /// curvature with tension); Luyendyk 1997, "Processing of airborne magnetic data" (levelling).
    MapGrid = "map_grid", version 1, grain Survey, yields Map, inputs [input: Lines],
    example r#"
[[stages]]
name      = "map_grid"
stage     = "map_grid"
input     = "resample"
value     = "mag_1_c"
spacing_m = 200.0
level_m   = 300.0
"#;
    /// Column of the values.
    value: String, unit "nT", default "anomaly";
    /// Core field that is subtracted from the values: the magnitude from IGRF-14 or from the World Magnetic Model, or
    /// the column `igrf`.
    core_field: CoreFieldSource, unit "", default CoreFieldSource::None;
    /// Date of the core field, instead of the date of each point.
    decimal_year: Option<f64>, unit "a", absent "the date of each point, from `year`, `doy` and `tt`",
        rule Rule::Between(1900.0, 2030.0);
    /// Subtracts the column `diurnal` from the values.
    remove_diurnal: bool, unit "", default false;
    /// Order of the polynomial that levels each line: 0 for a constant, 1 for a linear correction, and so on.
    level_order: Option<usize>, unit "", absent "no levelling", rule Rule::Between(0.0, 8.0);
    /// Largest height difference between two lines at a crossing that is used for levelling.
    crossing_height_m: f64, unit "m", default 50.0, rule Rule::NotNegative;
    /// Gridding method.
    method: GridSurfaceMethod, unit "", default GridSurfaceMethod::EquivalentSources;
    /// Distance between nodes.
    spacing_m: Option<f64>, unit "m", absent "half the distance between lines", rule Rule::Positive;
    /// Height of the map above the WGS-84 ellipsoid, for equivalent sources.
    level_m: Option<f64>, unit "m", absent "the height of the highest point";
    /// Damping of the equivalent sources.
    damping: f64, unit "1", default 1.0, rule Rule::Positive;
    /// Tension of the minimum-curvature surface.
    tension: f64, unit "1", default 0.25, rule Rule::Between(0.0, 1.0);
    /// West, south, east and north bounds of the map: eastings and northings in metres.
    bounds: Option<Vec<f64>>, unit "m", absent "the extent of all points";
    /// Side of the blocks to which points are reduced. 0 keeps every point.
    block_m: Option<f64>, unit "m",
        absent "a quarter of the distance between lines, at most 200 m", rule Rule::NotNegative;
    /// Nodes farther than this distance from the nearest point are unknown. `inf` sets no limit.
    mask_m: Option<f64>, unit "m", absent "twice the distance between lines";
    /// Keeps outliers along a line, and points far from all others.
    keep_outliers: bool, unit "", default false;
    /// Number n of folds of the cross-validation: every n-th line is omitted in turn and predicted from the other
    /// lines.
    cross_validate: Option<usize>, unit "1", absent "no cross-validation", rule Rule::Between(2.0, 65535.0);
    /// EPSG code of the map's coordinate system.
    to_epsg: Option<usize>, unit "", absent "the coordinate system of the points, or their UTM zone",
        rule Rule::Between(1.0, 65535.0);
}

/// Map of a survey.
pub struct SurveyMap {
    /// The map.
    pub map: AnomalyGrid,
    /// Expected error of each node, in nT, if the surface was cross-validated.
    pub error: Option<AnomalyGrid>,
    /// Report of the gridding.
    pub report: GriddingReport,
    /// Report of the levelling.
    pub levelled: Option<LevellingResult>,
}

pub use points::without_far;

/// Function that receives the current step, the amount done and the total.
pub type MapGridProgress<'a> = gridding::GriddingProgress<'a>;

impl MapGrid {
    /// Rejects invalid parameters, independent of the points.
    ///
    /// # Errors
    /// Fails with the parameter and the reason if a parameter is invalid.
    pub fn check(&self) -> Result<(), Fault> {
        gridding::check(&self.options()?).map_err(|e| refused(&e))?;
        let Some(code) = self.epsg()? else { return Ok(()) };
        let of_param = |fault: Fault| Fault { place: DataLocation::default(), ..fault }.of_param("to_epsg");
        let crs = Crs::from_epsg(Path::new(""), code).map_err(|e| of_param(e.into()))?;
        match crs.is_geographic() {
            true => Err(of_param(Fault::new(format!("EPSG:{code} is in degrees, but gridding requires metres")))),
            false => Ok(()),
        }
    }

    /// EPSG code of the map's coordinate system, if given.
    ///
    /// # Errors
    /// Fails if there is no such code.
    pub fn epsg(&self) -> Result<Option<u16>, Fault> {
        epsg_of(self.to_epsg)
    }

    /// Reduces, levels and grids points. Subtracts core field and levelling corrections from their values.
    ///
    /// # Errors
    /// See [`MapGrid`].
    pub fn apply(&self, points: &mut SurveyPointSet, progress: MapGridProgress) -> Result<SurveyMap, Fault> {
        let options = self.options()?;
        points::reduce(self, points)?;
        let line: Vec<usize> = points.line.iter().map(|l| *l as usize).collect();
        let flat = (self.method == GridSurfaceMethod::MinimumCurvature).then(|| points::any_heights(points));
        let survey = survey_at(points, &line, flat.as_deref());
        let levelled = self
            .level_order
            .map(|order| self.levelled(survey, order, points.ties(&tie_lines(survey)), progress))
            .transpose()?;
        if let Some(levelled) = &levelled {
            points.value_nt.iter_mut().zip(&levelled.correction_nt).for_each(|(v, c)| *v -= c);
        }
        let survey = survey_at(points, &line, flat.as_deref());
        self.fits(survey)?;
        let gridded = gridding::grid(survey, &options, progress).map_err(|e| match e {
            GriddingError::NoPoints => points::nothing_left(survey, &options.clean),
            e => refused(&e),
        })?;
        let GriddingResult { grid, error, report } = gridded;
        if grid.rows() < 2 || grid.columns() < 2 {
            let what = format!(
                "the map would have {} x {} nodes, {:.0} m apart",
                grid.rows(),
                grid.columns(),
                grid.east_m.step
            );
            let help = "choose a `spacing_m` below the extent of the points, or wider `bounds`";
            return Err(Fault::data(what).help(help).of_param("spacing_m"));
        }
        if grid.unknown() == grid.values.len() {
            let fault = Fault::data("no node of the map is within `mask_m` of a point");
            return Err(fault.help("increase `mask_m`, or set `bounds` around the points").of_param("mask_m"));
        }
        let height = match report.level_m {
            Some(level_m) => GridHeight::Level(level_m),
            None => survey_heights(points, &line, &grid, progress)?,
        };
        let error = error.map(|error| points.grid(error, height.clone())).transpose()?;
        Ok(SurveyMap { map: points.grid(grid, height)?, error, report, levelled })
    }

    /// Rejects a spacing that is wider than the area of the points.
    fn fits(&self, survey: gridding::SurveyPoints) -> Result<(), Fault> {
        let Some(spacing_m) = self.spacing_m else { return Ok(()) };
        let extent_m = |values: &[f64]| {
            let known = values.iter().filter(|x| x.is_finite());
            let (low, high) = known.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(*x), b.max(*x)));
            high - low
        };
        let (east_m, north_m) = (extent_m(survey.easting_m), extent_m(survey.northing_m));
        // The area of a line has a length but no width; the area of a point has neither.
        if !(east_m > 0.0 || north_m > 0.0) || spacing_m < east_m.max(north_m) {
            return Ok(());
        }
        let what =
            format!("a spacing of {spacing_m} m is wider than the area of the points, {east_m:.0} by {north_m:.0} m");
        Err(Fault::data(what).help("choose a `spacing_m` below the extent of the points").of_param("spacing_m"))
    }

    /// Levels lines by their crossings.
    fn levelled(
        &self,
        survey: gridding::SurveyPoints,
        order: usize,
        ties: Vec<usize>,
        progress: MapGridProgress,
    ) -> Result<LevellingResult, Fault> {
        progress("levelling lines", 0, 1);
        let crossings = CrossoverOptions { most_height_m: self.crossing_height_m, ..CrossoverOptions::default() };
        let found = find_crossovers(survey, &crossings);
        if found.is_empty() {
            let what = format!(
                "no lines cross at heights within {} m of each other, so they cannot be levelled",
                self.crossing_height_m
            );
            let help = "remove `level_order`, or increase `crossing_height_m`";
            return Err(Fault::data(what).help(help).of_param("level_order"));
        }
        Ok(level_lines(survey, &found, &LevellingOptions { order, ties: Some(ties), ..LevellingOptions::default() }))
    }

    fn options(&self) -> Result<GriddingOptions, Fault> {
        let method = match self.method {
            GridSurfaceMethod::EquivalentSources => {
                GriddingMethod::EquivalentSources { layers: None, damping: self.damping, level_m: self.level_m }
            }
            GridSurfaceMethod::MinimumCurvature => match GriddingMethod::minimum_curvature() {
                GriddingMethod::MinimumCurvature(relaxation) => {
                    GriddingMethod::MinimumCurvature(gridding::RelaxationOptions {
                        tension: self.tension,
                        ..relaxation
                    })
                }
                other @ GriddingMethod::EquivalentSources { .. } => other,
            },
        };
        let region =
            |[west, south, east, north]: [f64; 4]| GridRegion { east_m: [west, east], north_m: [south, north] };
        let kept = CleaningOptions { sigmas: 0.0, without_far: false, ..CleaningOptions::default() };
        Ok(GriddingOptions {
            spacing_m: self.spacing_m,
            block_m: self.block_m,
            mask_m: self.mask_m,
            folds: self.cross_validate.map(LineFolds::all),
            region: self.bounds.as_deref().map(bounds_of).transpose()?.map(region),
            clean: if self.keep_outliers { kept } else { CleaningOptions::default() },
            ..GriddingOptions::new(method)
        })
    }

    /// Columns that are read from the lines.
    fn reads(&self) -> Vec<&str> {
        let mut reads = vec!["lat", "lon", "alt", self.value.as_str()];
        if self.remove_diurnal {
            reads.push("diurnal");
        }
        match self.core_field {
            CoreFieldSource::None => {}
            CoreFieldSource::Column => reads.push("igrf"),
            CoreFieldSource::Igrf | CoreFieldSource::Wmm if self.decimal_year.is_some() => {}
            CoreFieldSource::Igrf | CoreFieldSource::Wmm => reads.extend(["year", "doy", "tt"]),
        }
        reads.dedup();
        reads
    }

    /// Faults for requested corrections that an earlier stage has already applied to the values.
    fn corrections_twice(&self, shape: &TableShape) -> Vec<Fault> {
        let value = std::slice::from_ref(&self.value);
        let core = ("core_field", "set `core_field = \"none\"`");
        let again = [
            (MagneticCorrection::Diurnal, self.remove_diurnal, REMOVE_DIURNAL),
            (MagneticCorrection::Core, self.core_field != CoreFieldSource::None, core),
            (MagneticCorrection::Levelling, self.level_order.is_some(), ("level_order", "remove `level_order`")),
        ];
        again.into_iter().filter_map(|(which, asked, key)| twice(shape, value, which, Some(asked), key)).collect()
    }

    /// Faults of the columns of the lines.
    fn missing(&self, shape: &TableShape) -> Vec<Fault> {
        let mut faults: Vec<Fault> = [("lat", "deg"), ("lon", "deg"), ("alt", "m")]
            .into_iter()
            .filter_map(|(name, unit)| shape.number(name, unit).err())
            .collect();
        faults.extend(shape.number(&self.value, "nT").err().map(|f| f.of_param("value")));
        faults.extend(self.corrections_twice(shape));
        if self.remove_diurnal {
            faults.extend(shape.number("diurnal", "nT").err().map(|f| f.of_param("remove_diurnal")));
        }
        match self.core_field {
            CoreFieldSource::Column => {
                faults.extend(shape.number("igrf", "nT").err().map(|f| f.of_param("core_field")))
            }
            CoreFieldSource::Igrf | CoreFieldSource::Wmm if self.decimal_year.is_none() => {
                let dated = ["year", "doy"].iter().all(|name| {
                    let known = |c: &Column| matches!(c.column_type, ColumnType::Float | ColumnType::Other(_));
                    shape.get(name).is_some_and(known)
                });
                if !dated {
                    let what = "the core field needs a date, but the points have no `year` and `doy`";
                    faults.push(
                        Fault::new(what)
                            .help("set `decimal_year`, such as `decimal_year = 1990.5`")
                            .of_param("core_field"),
                    );
                }
            }
            CoreFieldSource::None | CoreFieldSource::Igrf | CoreFieldSource::Wmm => {}
        }
        faults
    }
}

/// The points of a survey, at the heights `height_m` if they are given.
fn survey_at<'a>(
    points: &'a SurveyPointSet,
    line: &'a [usize],
    height_m: Option<&'a [f64]>,
) -> gridding::SurveyPoints<'a> {
    let survey = points::survey(points, line);
    gridding::SurveyPoints { height_m: height_m.unwrap_or(survey.height_m), ..survey }
}

/// Note on a map from points without heights.
pub const NO_HEIGHTS: &str =
    "the points have no heights, so the height of the map is unknown; set `alt_m` where the map is used";

/// EPSG code of the parameter `to_epsg`.
///
/// # Errors
/// Fails if there is no such code.
pub(crate) fn epsg_of(to_epsg: Option<usize>) -> Result<Option<u16>, Fault> {
    let wrong = |code: usize| Fault::new(format!("there is no EPSG code {code}")).of_param("to_epsg");
    to_epsg.map(|code| u16::try_from(code).map_err(|_| wrong(code))).transpose()
}

/// Fault of invalid options or points, with its remedy.
fn refused(error: &GriddingError) -> Fault {
    match error {
        GriddingError::BelowSources { lowest_m, .. } => {
            let lowest_m = lowest_m.ceil();
            let help = "or remove `level_m` to use the height of the highest point";
            let fault = Fault::data(error.to_string()).of_param("level_m");
            fault.help(format!("set `level_m = {lowest_m:.0}` or higher, {help}"))
        }
        GriddingError::Option { name, .. } => Fault::new(error.to_string()).of_param(name),
        GriddingError::NoPoints
        | GriddingError::Lengths { .. }
        | GriddingError::NotFinite { .. }
        | GriddingError::TooLarge { .. } => data(error),
    }
}

/// Flight height at each node, if the surface is at the heights flown.
fn survey_heights(
    points: &SurveyPointSet,
    line: &[usize],
    grid: &PlaneGrid,
    progress: MapGridProgress,
) -> Result<GridHeight, Fault> {
    if points.height_m.iter().all(|h| !h.is_finite()) {
        return Ok(GridHeight::Level(f64::NAN));
    }
    let heights = gridding::SurveyPoints { value_nt: &points.height_m, ..points::survey(points, line) };
    let mut options = GriddingOptions::new(GriddingMethod::minimum_curvature());
    options.clean.sigmas = 0.0;
    options.spacing_m = Some(grid.east_m.step);
    options.region = Some(GridRegion {
        east_m: [grid.east_m.first, grid.east_m.last()],
        north_m: [grid.north_m.first, grid.north_m.last()],
    });
    options.mask_m = Some(f64::INFINITY);
    let heights = gridding::grid(heights, &options, progress).map_err(|e| refused(&e))?;
    Ok(GridHeight::Cells(heights.grid.values))
}

impl Stage for MapGrid {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let mut faults: Vec<Fault> = self.check().err().into_iter().collect();
        faults.extend(self.missing(shape(inputs, 0)?));
        if !faults.is_empty() {
            return Err(faults);
        }
        let reads: Vec<String> = self.reads().into_iter().map(str::to_owned).collect();
        let mut yields = schemas::map::yields(schemas::map::ANOMALY_UNIT, vec![reads.clone()]);
        if self.cross_validate.is_some() {
            yields.columns.push(schemas::map::error_column().from(0, &reads));
        }
        Ok(yields)
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        let of = |param: &str, word: &str| {
            let fault = Fault::new(format!("`{key}` has no effect without `{param} = {word}`"));
            Some(fault.help(format!("remove `{key}`, or set `{param} = {word}`")))
        };
        match (key, self.method, self.core_field) {
            ("tension", GridSurfaceMethod::EquivalentSources, _) => of("method", "\"minimum_curvature\""),
            ("level_m" | "damping", GridSurfaceMethod::MinimumCurvature, _) => of("method", "\"equivalent_sources\""),
            ("decimal_year", _, CoreFieldSource::None | CoreFieldSource::Column) => of("core_field", "\"igrf\""),
            ("crossing_height_m", _, _) if self.level_order.is_none() => of("level_order", "0"),
            _ => None,
        }
    }
}

impl SurveyStage for MapGrid {
    type Gather = gather::MapGridAggregator;

    fn gather(points: Vec<SurveyPoint<Self>>) -> gather::MapGridAggregator {
        gather::MapGridAggregator::new(points.into_iter().map(|point| point.stage).collect())
    }
}

/// Columns of a map that was made from a survey.
fn columns(mapped: &SurveyMap) -> Result<Vec<ArrayRef>, Fault> {
    let mut columns = mapped.map.made()?;
    columns.extend(mapped.error.as_ref().map(|error| crate::columns::array(error.anomaly_nt.clone())));
    Ok(columns)
}
