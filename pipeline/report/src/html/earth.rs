//! The tracks of a run, their error ellipses and the map below them, for Google Earth and QGIS.

use figures::{
    AxisQuantity, EarthArea, EarthFolder, EarthTrack, Kml, MapPicture, MapStyle, Palette, ellipse::Ellipse,
    folders_kml, raster::Bounds,
};
use numerics::{
    earth::geodesy::EarthModel,
    maps::{map_surface::GeographicGrid, plane_grid::EvenAxis},
};
use plan::{PlanGraph, TableRef};
use results::text::number;
use schemas::{Fault, StageRole};
use store::Store;

use super::{
    SubjectGroup, atlas, groups, over, scored,
    source::ReportSource,
    subject::{self, ReportLine, ReportSubject},
    track::{DegreeTrack, LineTracks},
};

/// Maximum number of ellipses of a line, and number of corners of an ellipse.
const ELLIPSES: usize = 60;
const CORNERS: usize = 36;
/// Size of the ellipses in standard deviations.
const SIGMAS: f64 = 3.0;
/// Colours of the report, except for the true track, because black is invisible on a picture of the ground.
const TRUTH: [u8; 3] = [255; 3];
const INS: [u8; 3] = [255, 122, 26];
const ESTIMATE: [u8; 3] = [255, 79, 208];

/// Selection of tracks by table and line.
pub struct TrackSelection<'a> {
    /// Tables of `navigate`; all if empty.
    pub tables: &'a [String],
    /// Lines; if empty, the lines of the report.
    pub lines: &'a [String],
}

/// Tracks of one line at one point, with heights in metres.
struct KmlTrack {
    name: String,
    line_tracks: LineTracks,
    /// Heights of truth, INS and estimate, in metres.
    alt: [Vec<f64>; 3],
}

/// The tracks of the plan's results in `store`: for each table of `navigate`, the points and lines that the report
/// shows, or the lines of `choice`. Pictures of the maps are named after `stem`.
///
/// # Errors
/// Fails if there are no results of the plan, no track matches `choice`, or the store is damaged.
pub fn kml(graph: &PlanGraph, store: &Store, choice: &TrackSelection, stem: &str) -> Result<Kml, Fault> {
    let source = ReportSource::new(graph, store);
    let groups = chosen(&source, choice)?;
    let mut points: Vec<(String, Vec<KmlTrack>)> = vec![];
    for group in &groups {
        for subject in &group.subjects {
            let mut legs = vec![];
            for shown in &group.lines {
                legs.extend(leg(&source, subject, shown)?);
            }
            if !legs.is_empty() {
                points.push((point_name(&source, subject, group), legs));
            }
        }
    }
    if points.is_empty() {
        let fault = Fault::new(format!("{} has no track", graph.plan.spec.file));
        return Err(fault.help("add a stage `navigate`, which makes tracks, and run the spec"));
    }
    let maps = maps(&source, &groups)?;
    let pictures: Vec<MapPicture> = maps.iter().map(KmlMap::picture).collect();
    let folders: Vec<EarthFolder> = points.iter().map(|(name, legs)| folder(name, legs)).collect();
    let look = MapStyle { palette: Palette::Viridis, width_px: 1200, ..MapStyle::default() };
    folders_kml(&graph.plan.spec.name, &pictures, &look, &folders, stem)
}

/// The navigations of `choice`, with the lines of `choice`.
fn chosen(source: &ReportSource, choice: &TrackSelection) -> Result<Vec<SubjectGroup>, Fault> {
    let plan = source.graph.plan;
    let navigates: Vec<&str> =
        plan.tables_of(StageRole::EstimatesTrack).map(|t| plan.tables[t].name.as_str()).collect();
    if let Some(name) = choice.tables.iter().find(|t| !navigates.contains(&t.as_str())) {
        return Err(Fault::new(format!("there is no table `{name}` of stage `navigate`")).nearest(name, &navigates));
    }
    let (mut found, _) = groups(source, &scored(source)?.boards, usize::MAX)?;
    let wanted = |s: &ReportSubject| {
        s.navigate.is_some_and(|r| choice.tables.is_empty() || choice.tables.iter().any(|t| t == plan.name_of(r)))
    };
    for group in &mut found {
        group.subjects.retain(wanted);
    }
    found.retain(|g| !g.subjects.is_empty());
    if choice.lines.is_empty() {
        return Ok(found);
    }
    let mut known: Vec<&str> = vec![];
    for group in &mut found {
        let Some(TableRef::Stage(t, i)) = group.subjects.first().and_then(|s| s.navigate) else { continue };
        let named = |l: &usize| source.graph.lines.get(*l).map(|(_, name)| name.as_str()).unwrap_or_default();
        let all = source.graph.lines_of(t, i);
        known.extend(all.iter().map(named));
        let of_choice = all.iter().filter(|l| choice.lines.iter().any(|c| c == named(l)));
        group.lines = of_choice.map(|line| ReportLine { line: *line, why: "" }).collect();
    }
    match choice.lines.iter().find(|l| !known.contains(&l.as_str())) {
        Some(line) => Err(Fault::new(format!("no table of `navigate` has a line `{line}`")).nearest(line, &known)),
        None => Ok(found),
    }
}

/// Table and point, with the role of the point in the report if there are several.
fn point_name(source: &ReportSource, subject: &ReportSubject, group: &SubjectGroup) -> String {
    let table = subject.navigate.map(|r| source.graph.plan.name_of(r)).unwrap_or_default();
    let mut name = if subject.point.is_empty() { table.to_owned() } else { format!("{table}, {}", subject.point) };
    if group.subjects.len() > 1 {
        name.push_str(&format!(" ({})", subject.id));
    }
    name
}

fn leg(source: &ReportSource, subject: &ReportSubject, shown: &ReportLine) -> Result<Option<KmlTrack>, Fault> {
    let (Some(r), Some(line_tracks)) = (subject.navigate, LineTracks::read(source, subject, shown.line)?) else {
        return Ok(None);
    };
    let TableRef::Stage(t, i) = r else { return Ok(None) };
    let own = source.floats(r, shown.line, "alt")?.unwrap_or_else(|| vec![0.0; line_tracks.tt.len()]);
    let mut alt = [own.clone(), own.clone(), own];
    if let Some(flights) = source.graph.plan.instance(t, i).first_input() {
        for (to, name) in alt.iter_mut().zip(["alt", "ins_alt"]) {
            // Unknown heights are replaced by the heights of the estimate.
            if let Some(heights) = source.floats(flights, shown.line, name)?.filter(|h| h.len() == to.len()) {
                to.iter_mut().zip(heights).filter(|(_, h)| h.is_finite()).for_each(|(to, h)| *to = h);
            }
        }
    }
    Ok(Some(KmlTrack { name: subject::named(source, shown.line), line_tracks, alt }))
}

fn folder<'a>(name: &str, legs: &'a [KmlTrack]) -> EarthFolder<'a> {
    EarthFolder {
        name: name.to_owned(),
        folders: legs.iter().map(KmlTrack::folder).collect(),
        ..EarthFolder::default()
    }
}

impl KmlTrack {
    fn folder(&self) -> EarthFolder<'_> {
        let name = format!("{SIGMAS}σ ellipses of the estimate");
        let ellipses = EarthFolder { name, areas: self.areas(), ..EarthFolder::default() };
        let folders = if ellipses.areas.is_empty() { vec![] } else { vec![ellipses] };
        EarthFolder { name: self.name.clone(), tracks: self.tracks(), folders, ..EarthFolder::default() }
    }

    fn tracks<'a>(&'a self) -> Vec<EarthTrack<'a>> {
        let LineTracks { truth, ins, estimate, .. } = &self.line_tracks;
        let all = [
            ("truth", truth.as_ref(), TRUTH),
            ("INS alone", ins.as_ref(), INS),
            ("estimate", Some(estimate), ESTIMATE),
        ];
        let mut tracks = vec![];
        for ((name, track, colour), alt_m) in all.into_iter().zip(&self.alt) {
            let one = |DegreeTrack { lat, lon }: &'a DegreeTrack| EarthTrack {
                name,
                lat_deg: lat,
                lon_deg: lon,
                alt_m,
                time_unix_s: None,
                colour: Some(colour),
            };
            tracks.extend(track.map(one));
        }
        tracks
    }

    fn areas(&self) -> Vec<EarthArea> {
        let rows = atlas::spaced(0..self.line_tracks.tt.len(), ELLIPSES);
        rows.into_iter().filter_map(|k| self.area(k)).collect()
    }

    fn area(&self, k: usize) -> Option<EarthArea> {
        let LineTracks { tt, truth, estimate, .. } = &self.line_tracks;
        let (centre, ellipse) = (estimate.at(k)?, self.line_tracks.ellipse(k, SIGMAS)?);
        let [_, _, alt] = &self.alt;
        let mut about = format!(
            "{SIGMAS}σ region of the estimate: {} m by {} m, with the longer axis at an azimuth of {:.0}°.",
            number(Some(ellipse.major_m)),
            number(Some(ellipse.minor_m)),
            ellipse.azimuth_deg
        );
        if let Some(error) = truth.as_ref().and_then(|t| atlas::apart(estimate, t, k)) {
            about.push_str(&format!(" The error of the estimate is {} m.", number(Some(error))));
        }
        let (lat_deg, lon_deg) = outline(centre, ellipse);
        Some(EarthArea {
            name: format!("{:.1} min", (tt.get(k)? - tt.first()?) / 60.0),
            about,
            lat_deg,
            lon_deg,
            alt_m: *alt.get(k).filter(|h| h.is_finite())?,
            colour: ESTIMATE,
        })
    }
}

/// The corners of an ellipse around a position, counterclockwise.
fn outline((lat, lon): (f64, f64), ellipse: Ellipse) -> (Vec<f64>, Vec<f64>) {
    let (earth, at) = (EarthModel::default(), lat.to_radians());
    let corner = |(north, east): (f64, f64)| {
        let (up, right) = (earth.north_m_to_lat_rad(north, at, 0.0), earth.east_m_to_lon_rad(east, at, 0.0));
        (lat + up.to_degrees(), lon + right.to_degrees())
    };
    let mut corners: Vec<(f64, f64)> = ellipse.outline(CORNERS).map(corner).collect();
    corners.reverse();
    corners.into_iter().unzip()
}

/// Part of a map below tracks.
struct KmlMap {
    name: String,
    x: EvenAxis,
    y: EvenAxis,
    values: Vec<f64>,
}

impl KmlMap {
    fn picture(&self) -> MapPicture<'_> {
        MapPicture {
            x: self.x,
            y: self.y,
            values: &self.values,
            plane: AxisQuantity::Degrees,
            title: &self.name,
            quantity: &self.name,
            unit: "nT",
            x_label: None,
            y_label: None,
        }
    }
}

/// Each map below the tracks, without duplicates, cut to the extent of the tracks.
fn maps(source: &ReportSource, groups: &[SubjectGroup]) -> Result<Vec<KmlMap>, Fault> {
    let mut around: Vec<(TableRef, Vec<DegreeTrack>)> = vec![];
    for group in groups {
        let (Some(map), tracks) = over(source, group)? else { continue };
        match around.iter_mut().find(|(known, _)| *known == map) {
            Some((_, all)) => all.extend(tracks),
            None => around.push((map, tracks)),
        }
    }
    let mut found = vec![];
    for (map, tracks) in around {
        let name = source.graph.plan.name_of(map);
        let Some(bounds) = atlas::around(&tracks) else { continue };
        found.extend(source.map(map)?.and_then(|grid| cut(name, &grid, &bounds)));
    }
    Ok(found)
}

/// The nodes of a map within `bounds`; `None` if all values are missing.
fn cut(name: &str, grid: &GeographicGrid, bounds: &Bounds) -> Option<KmlMap> {
    let (lat, lon) = (grid.lat(), grid.lon());
    // Maps may count longitudes from 0 to 360.
    let middle = 0.5 * (lon.first_deg() + lon.last_deg());
    let turns = 360.0 * ((middle - bounds.lon.0) / 360.0).round();
    let within = |first: f64, step: f64, len: usize, (low, high): (f64, f64)| {
        let from = ((low - first) / step).floor().clamp(0.0, len as f64) as usize;
        let to = ((high - first) / step).ceil().clamp(-1.0, len as f64 - 1.0) + 1.0;
        (
            from..to as usize,
            EvenAxis { first: first + step * from as f64, step, len: (to as usize).saturating_sub(from) },
        )
    };
    let (rows, y) = within(lat.first_deg(), lat.step_deg(), lat.len(), bounds.lat);
    let turned = (bounds.lon.0 + turns, bounds.lon.1 + turns);
    let (columns, x) = within(lon.first_deg(), lon.step_deg(), lon.len(), turned);
    let part = |r: usize| grid.values().get(r * lon.len() + columns.start..r * lon.len() + columns.end);
    let values: Vec<f64> = rows.filter_map(part).flatten().copied().collect();
    let known = values.len() == x.len * y.len && values.iter().any(|v| v.is_finite());
    known.then(|| KmlMap { name: name.to_owned(), x, y, values })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn leg() -> KmlTrack {
        let track = |shift: f64| DegreeTrack {
            lat: (0..200).map(|k| -22.0 + f64::from(k) * 1e-3).collect(),
            lon: (0..200).map(|k| 140.0 + shift * f64::from(k)).collect(),
        };
        let line_tracks = LineTracks {
            tt: (0..200).map(|k| 600.0 + 6.0 * f64::from(k)).collect(),
            truth: Some(track(0.0)),
            ins: Some(track(1e-5)),
            estimate: track(2e-6),
            sigma: Some([vec![10.0; 200], vec![20.0; 200], vec![0.0; 200]]),
            residual: None,
            nis: None,
        };
        KmlTrack {
            name: "flight 1, line 1.02".into(),
            line_tracks,
            alt: [vec![500.0; 200], vec![510.0; 200], vec![505.0; 200]],
        }
    }

    #[test]
    fn unit_a_line_is_truth_ins_estimate_and_ellipses() {
        let leg = leg();
        let folder = leg.folder();
        let names: Vec<&str> = folder.tracks.iter().map(|t| t.name).collect();
        assert_eq!(names, ["truth", "INS alone", "estimate"]);
        assert_eq!((folder.tracks[1].alt_m[0], folder.tracks[2].alt_m[0]), (510.0, 505.0));
        let areas = &folder.folders[0].areas;
        assert_eq!((areas.len(), areas[0].name.as_str(), areas[59].name.as_str()), (60, "0.0 min", "19.9 min"));
        // 199 steps of 2e-6 degrees at 21.8 degrees south are 41 m.
        assert!(
            areas[59].about.contains("60.00 m by 30.00 m, with the longer axis at an azimuth of 90°"),
            "{}",
            areas[59].about
        );
        assert!(
            areas[59].about.contains("41.1") && areas[59].about.contains("The error of the estimate is"),
            "{}",
            areas[59].about
        );
        let made = folders_kml("t", &[], &MapStyle::default(), &[folder], "t").unwrap().document;
        assert_eq!((made.matches("<LineString>").count(), made.matches("<Polygon>").count()), (3, 60));
    }

    #[test]
    fn law_the_corners_are_three_sigma_from_the_estimate_and_counterclockwise() {
        let leg = leg();
        let area = leg.area(50).unwrap();
        let centre = leg.line_tracks.estimate.at(50).unwrap();
        let offset = |k: usize| EarthModel::default().offset_ne_m(centre, (area.lat_deg[k], area.lon_deg[k]), 0.0);
        for k in 0..CORNERS {
            let (north, east) = offset(k);
            assert!(((north / 30.0).hypot(east / 60.0) - 1.0).abs() < 1e-4, "{north} {east}");
            let (to_north, to_east) = offset((k + 1) % CORNERS);
            assert!(east * to_north - north * to_east > 0.0, "from east over north to west");
        }
    }

    #[test]
    fn unit_a_map_is_cut_to_its_tracks() {
        let side: Vec<f64> = (0..50).map(|k| 200.0 + f64::from(k)).collect();
        let lat: Vec<f64> = (0..30).map(f64::from).collect();
        let values: Vec<f64> = (0..1500).map(f64::from).collect();
        let grid = GeographicGrid::new(&lat, &side, &values).unwrap();
        // 205 to 207 degrees east are 155 to 153 degrees west.
        let map = cut("rio", &grid, &Bounds { lat: (3.2, 5.0), lon: (-155.0, -153.0) }).unwrap();
        assert_eq!((map.x.first, map.x.len, map.y.first, map.y.len), (205.0, 3, 3.0, 3));
        assert_eq!(map.values[..4], [155.0, 156.0, 157.0, 205.0]);
        assert!(cut("rio", &grid, &Bounds { lat: (40.0, 41.0), lon: (-155.0, -153.0) }).is_none());
    }
}
