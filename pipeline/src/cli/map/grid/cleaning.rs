//! Points that are far from all others.

use std::path::PathBuf;

use datasets::SurveyPoints;
use numerics::maps::gridding::far_points;

use crate::cli::note;

/// Points that are named one by one.
const NAMED: usize = 5;
/// Metres of a degree of latitude.
const DEGREE_M: f64 = 111_195.0;

/// Takes away the places of points that are far from all others, so that what follows leaves these out, and names them;
/// the points of each file begin at its entry of `starts`. Says how many they are.
pub fn without_far(points: &mut SurveyPoints, files: &[PathBuf], starts: &[usize]) -> usize {
    let [east_m, north_m] = places(points);
    let far = far_points(&east_m, &north_m);
    if far.is_empty() {
        return 0;
    }
    let many = if far.len() == 1 { "1 point is".to_owned() } else { format!("{} points are", far.len()) };
    note(&format!("{many} far from all others and left out; `--keep-outliers` keeps such points"));
    for &i in far.iter().take(NAMED) {
        let file = starts.partition_point(|start| *start <= i).saturating_sub(1);
        let line = points.lines.get(points.line[i] as usize).filter(|name| !name.is_empty());
        note(&format!(
            "{}: row {}{} is at latitude {:.5}, longitude {:.5}",
            files.get(file).map_or(String::new(), |f| f.display().to_string()),
            points.row[i],
            line.map_or(String::new(), |name| format!(", line {name},")),
            points.lat_deg[i],
            points.lon_deg[i],
        ));
    }
    if far.len() > NAMED {
        note(&format!("and {} more", far.len() - NAMED));
    }
    for i in &far {
        (points.easting_m[*i], points.northing_m[*i]) = (f64::NAN, f64::NAN);
    }
    far.len()
}

/// Metres east and north as the middle latitude has them: good enough to tell far from near, and defined where the
/// points' own projection is not.
fn places(points: &SurveyPoints) -> [Vec<f64>; 2] {
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
