//! Points of a survey: corrections of their values, and removal of points far from all others.

use grids::SurveyPointSet;
use numerics::{
    earth::{
        core_field::{CoreFieldModel, CoreFieldTrack},
        dates::decimal_year,
    },
    maps::gridding::{self, CleaningOptions, clean, far_points},
};
use schemas::Fault;

use super::{CoreFieldSource, MapGrid};
use crate::columns::data;

/// Length of one degree of latitude, in metres.
const DEGREE_M: f64 = 111_195.0;

/// The points in the form that gridding requires.
pub fn survey<'a>(points: &'a SurveyPointSet, line: &'a [usize]) -> gridding::SurveyPoints<'a> {
    gridding::SurveyPoints {
        easting_m: &points.easting_m,
        northing_m: &points.northing_m,
        height_m: &points.height_m,
        value_nt: &points.value_nt,
        line,
    }
}

/// Heights for a surface that does not depend on them: unknown heights become the mean of the known heights, or 0.
pub fn any_heights(points: &SurveyPointSet) -> Vec<f64> {
    let known = || points.height_m.iter().filter(|h| h.is_finite());
    let mean = known().sum::<f64>() / known().count().max(1) as f64;
    points.height_m.iter().map(|h| if h.is_finite() { *h } else { mean }).collect()
}

/// Subtracts core field and diurnal variation.
///
/// # Errors
/// Fails if the points lack the diurnal variation, core field, heights or dates that are needed. Fails if a date or
/// position is invalid or outside the model's range.
pub fn reduce(stage: &MapGrid, points: &mut SurveyPointSet) -> Result<(), Fault> {
    let lacks = |what: &str| Fault::data(format!("the points have no {what}"));
    if stage.remove_diurnal {
        let diurnal = points.extra.diurnal_nt.as_ref().ok_or_else(|| lacks("column `diurnal`"))?;
        points.value_nt.iter_mut().zip(diurnal).for_each(|(v, d)| *v -= d);
    }
    let model = match stage.core_field {
        CoreFieldSource::None => return Ok(()),
        CoreFieldSource::Column => {
            let core = points.extra.igrf_nt.as_ref().ok_or_else(|| lacks("column `igrf`"))?;
            points.value_nt.iter_mut().zip(core).for_each(|(v, c)| *v -= c);
            return Ok(());
        }
        CoreFieldSource::Igrf => CoreFieldModel::Igrf14,
        CoreFieldSource::Wmm => CoreFieldModel::Wmm,
    };
    let years = match stage.decimal_year {
        Some(year) => vec![year; points.len()],
        None => dates(points)?.ok_or_else(|| {
            lacks("date in columns `year`, `doy` and `tt`").help("set `decimal_year`, such as `decimal_year = 1990.5`")
        })?,
    };
    let field = CoreFieldTrack::new(model).field(&points.lat_deg, &points.lon_deg, &points.height_m, &years);
    let magnitude = field.map_err(data)?.magnitude_nt();
    if magnitude.iter().all(|m| m.is_nan()) {
        return Err(lacks("heights or dates for the core field"));
    }
    points.value_nt.iter_mut().zip(magnitude).for_each(|(v, m)| *v -= m);
    Ok(())
}

/// Decimal year of each point. NaN if it has no date.
fn dates(points: &SurveyPointSet) -> Result<Option<Vec<f64>>, Fault> {
    let (Some(year), Some(doy)) = (points.extra.year.as_ref(), points.extra.doy.as_ref()) else { return Ok(None) };
    let tt = points.extra.tt_s.as_ref();
    let one = |i: usize| {
        // After midnight the date advances and `tt` continues to increase, so only the time of day is added.
        let tt = tt.map_or(0.0, |tt| tt[i].rem_euclid(86_400.0));
        if ![year[i], doy[i], tt].iter().all(|x| x.is_finite()) {
            return Ok(f64::NAN);
        }
        let line = points.lines.get(points.line[i] as usize).map_or("", String::as_str);
        decimal_year(year[i] as i32, doy[i] as u32, tt)
            .map_err(|e| Fault::data(format!("line {line}: {e}")).in_column("doy").in_row(points.row[i]))
    };
    (0..points.len()).map(one).collect::<Result<Vec<f64>, Fault>>().map(Some)
}

/// Fault if no point remains to grid.
pub fn nothing_left(points: gridding::SurveyPoints, options: &CleaningOptions) -> Fault {
    let cleaned = clean(points, options);
    let left_out = [
        (cleaned.not_finite.len(), "without a finite position, height or value"),
        (cleaned.far.len(), "far from all others"),
        (cleaned.duplicates.len(), "duplicates"),
        (cleaned.outliers.len(), "outliers"),
        (cleaned.of_short_lines.len(), "on lines with too few points"),
    ];
    let left_out: Vec<String> =
        left_out.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")).collect();
    let help = match points.height_m.iter().all(|h| h.is_nan()) {
        true => {
            "equivalent sources require heights (`alt`, or the column that `--height` names); \
             `method = \"minimum_curvature\"` requires none"
        }
        false => "lines require at least five points; `method = \"minimum_curvature\"` requires no heights",
    };
    Fault::data(format!("none of {} points remains to grid: {}", points.len(), left_out.join(", "))).help(help)
}

/// Removes the positions of points that are far from all others, so that later steps omit them. Returns the indices of
/// these points.
pub fn without_far(points: &mut SurveyPointSet) -> Vec<usize> {
    let [east_m, north_m] = positions(points);
    let far = far_points(&east_m, &north_m);
    for i in &far {
        (points.easting_m[*i], points.northing_m[*i]) = (f64::NAN, f64::NAN);
    }
    far
}

/// Metres east and north at the middle latitude. They are accurate enough to detect distant points, and are defined
/// outside the projection of the points.
fn positions(points: &SurveyPointSet) -> [Vec<f64>; 2] {
    let middle = |values: &[f64]| {
        let mut known: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
        let at = known.len() / 2;
        if known.is_empty() { 0.0 } else { *known.select_nth_unstable_by(at, f64::total_cmp).1 }
    };
    let (lat, lon) = (middle(&points.lat_deg), middle(&points.lon_deg));
    let round = |deg: f64| deg - 360.0 * (deg / 360.0).round();
    let east = points.lon_deg.iter().map(|x| round(x - lon) * DEGREE_M * lat.to_radians().cos()).collect();
    let north = points.lat_deg.iter().map(|x| (x - lat) * DEGREE_M).collect();
    [east, north]
}
