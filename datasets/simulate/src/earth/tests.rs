#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::needless_range_loop)]

mod variation;

use std::{fs, path::Path};

use arrow_array::{RecordBatch, cast::AsArray, types::Float64Type};
use datasets::{AnomalyGrid, Crs, GridHeight, MapOptions, MapTable, samples};
use numerics::{
    earth::core_field::CoreFieldModel,
    maps::{
        map_surface::{GeographicGrid, MapInterpolation, MapSurface},
        plane_grid::EvenAxis,
    },
    signal::gauss_markov::GaussMarkov,
};
use tempfile::TempDir;

use super::{
    buried::{LocalFrameSource, field_ned_nt},
    *,
};
use crate::Simulation;

const OSBORNE: &str = "osborne/osborne_anomaly_100m_at_500m.tif";

fn field_at(model: CoreFieldModel, year: f64, lat: f64, lon: f64, alt: f64) -> Vector3<f64> {
    Vector3::from(CoreField::new(model, year).unwrap().field_ned_nt(lat, lon, alt))
}

fn prism(lat_deg: f64, lon_deg: f64, depth_m: f64, magnetisation_apm: f64) -> BuriedSource {
    let body = BuriedBody::Prism { magnetisation_apm, size_m: [1500.0, 700.0, 2000.0], azimuth_deg: 30.0 };
    BuriedSource { lat_deg, lon_deg, alt_m: -depth_m, inclination_declination_deg: Some((20.0, 40.0)), body }
}

/// Sources below a map of 201 x 201 nodes about 150 m apart, and the map of their total field anomaly.
fn known(lat_deg: f64) -> (Vec<LocalFrameSource>, MapTable) {
    let core = CoreField::at(2020.5).unwrap();
    let buried = [
        prism(lat_deg + 0.03, 140.52, 700.0, 5.0),
        prism(lat_deg - 0.02, 140.48, 900.0, -7.5),
        prism(lat_deg - 0.01, 140.54, 1200.0, 10.0),
    ];
    let placed: Vec<LocalFrameSource> = buried.iter().map(|b| LocalFrameSource::new(b, &core)).collect();
    let step = 0.00135;
    let y = EvenAxis { first: lat_deg - 100.0 * step, step, len: 201 };
    let x = EvenAxis { first: 140.5 - 100.0 * step, step, len: 201 };
    let mut values = vec![];
    for lat in y.coordinates() {
        for lon in x.coordinates() {
            let f = Vector3::from(core.field_ned_nt(lat, lon, 300.0)).normalize();
            values.push(field_ned_nt(&placed, lat, lon, 300.0).dot(&f));
        }
    }
    let grid = AnomalyGrid::new(x, y, Crs::wgs84().unwrap(), values, GridHeight::Level(300.0)).unwrap();
    (placed, grid.to_geographic().unwrap())
}

fn crustal(map: &MapTable) -> CrustalMap {
    CrustalMap::new(Path::new(""), map, &CoreFieldTrack::new(CoreFieldModel::Igrf14), 2020.5).unwrap()
}

/// The field of a crustal map at positions.
fn fields(map: &CrustalMap, places: &[(f64, f64, f64)]) -> Vec<Vector3<f64>> {
    let core: Vec<_> =
        places.iter().map(|(lat, lon, alt)| field_at(CoreFieldModel::Igrf14, 2020.5, *lat, *lon, *alt)).collect();
    let column = |of: fn(&(f64, f64, f64)) -> f64| places.iter().map(of).collect::<Vec<f64>>();
    let at = [column(|p| p.0), column(|p| p.1), column(|p| p.2)];
    map.along(at.each_ref().map(Vec::as_slice), &vec![[0.0; 3]; places.len()], &core).unwrap().unwrap()
}

fn rms<'a>(vectors: impl Iterator<Item = &'a Vector3<f64>>) -> f64 {
    let (sum, n) = vectors.fold((0.0, 0.0), |(sum, n), v| (sum + v.norm_squared(), n + 1.0));
    (sum / n).sqrt()
}

fn inner_places(lat_deg: f64, alt_m: f64) -> Vec<(f64, f64, f64)> {
    let at = |k: i32| (f64::from(k % 20) - 9.5) * 0.004;
    (0..400).map(|k| (lat_deg + at(k), 140.5 + at(k / 20), alt_m)).collect()
}

#[test]
fn law_the_field_of_a_map_equals_the_field_of_its_sources() {
    let (sources, map) = known(-22.0);
    let map = crustal(&map);
    for (alt_m, most) in [(300.0, 0.02), (450.0, 0.02), (1000.0, 0.03), (2000.0, 0.06)] {
        let places = inner_places(-22.0, alt_m);
        let found = fields(&map, &places);
        let exact: Vec<_> = places.iter().map(|(lat, lon, alt)| field_ned_nt(&sources, *lat, *lon, *alt)).collect();
        let errors: Vec<_> = found.iter().zip(&exact).map(|(a, b)| a - b).collect();
        let relative = rms(errors.iter()) / rms(exact.iter());
        // The map lacks the field beyond its edges; the effect on the result increases with the height.
        assert!(relative < most, "{alt_m} m: {relative}");
    }
}

#[test]
fn law_the_field_along_a_climb_is_smooth_and_equals_the_exact_levels() {
    let (_, map) = known(-22.0);
    let map = crustal(&map);
    let climb: Vec<_> = (0..=3000).map(|k| (-21.98, 140.51, 297.0 + 0.5 * f64::from(k))).collect();
    let found = fields(&map, &climb);
    let bends: Vec<_> = found.windows(3).map(|w| w[0] - 2.0 * w[1] + w[2]).collect();
    let most = bends.iter().map(|v| v.norm()).fold(0.0, f64::max);
    let steps = found.windows(2).map(|w| (w[1] - w[0]).norm()).fold(0.0, f64::max);
    // Second differences of a smooth field that falls by 200 nT over a kilometre are 200 (0.5/1000)² = 5e-5 nT. A jump
    // of the field or of its slope would exceed this limit.
    assert!(steps > 0.05 && most < 2e-4, "{steps} {most}");
    for k in [6, 107, 406, 1506, 2906] {
        let exact = fields(&map, &[climb[k]])[0];
        // The relative error of the cubic is 6e-5 for a wavelength of eight spacings.
        assert!((found[k] - exact).norm() < 1e-3 * exact.norm(), "{k}: {} {}", found[k], exact);
    }
}

#[test]
fn law_the_field_is_a_gradient_without_sources() {
    let (_, map) = known(-22.0);
    let map = crustal(&map);
    let earth = numerics::earth::geodesy::EarthModel::Wgs84;
    const H: f64 = 60.0;
    let mut worst: [f64; 2] = [0.0, 0.0];
    let mut gradients: f64 = 0.0;
    for (lat, lon, _) in inner_places(-22.0, 0.0).into_iter().step_by(7) {
        let (alt, rad) = (520.0, lat.to_radians());
        let (dn, de) =
            (earth.north_m_to_lat_rad(H, rad, alt).to_degrees(), earth.east_m_to_lon_rad(H, rad, alt).to_degrees());
        let moved = [(dn, 0.0, 0.0), (0.0, de, 0.0), (0.0, 0.0, -H)];
        // Rows are components, columns directions: north, east, down. One climbing line requires all levels.
        let places: Vec<_> =
            moved.iter().flat_map(|(a, b, c)| [1.0, -1.0].map(|s| (lat + s * a, lon + s * b, alt + s * c))).collect();
        let at = fields(&map, &places);
        let slope = [0, 1, 2].map(|k| (at[2 * k] - at[2 * k + 1]) / (2.0 * H));
        let curl = Vector3::new(slope[1].z - slope[2].y, slope[2].x - slope[0].z, slope[0].y - slope[1].x);
        worst[0] = worst[0].max(curl.norm());
        worst[1] = worst[1].max((slope[0].x + slope[1].y + slope[2].z).abs());
        gradients = gradients.max(rms(slope.iter()));
    }
    // The transform uses the width at the middle latitude (0.1 % error over the map). Differences over h = 60 m have
    // the relative error (k h)²/6, which is 4e-3 at the wavenumber k = 1/400 m.
    assert!(gradients > 0.1, "{gradients}");
    assert!(worst[0] < 8e-3 * gradients && worst[1] < 8e-3 * gradients, "{worst:?} {gradients}");
}

#[test]
fn law_near_the_magnetic_equator_the_field_is_finite_and_its_scalar_anomaly_is_the_map() {
    // The dip is 0 to 1 degrees at 7.5 north, 140.5 east.
    let (_, map) = known(7.5);
    let grid = GeographicGrid::new(&map.latitudes_deg(), &map.longitudes_deg(), map.column("anomaly")).unwrap();
    let lookup = MapSurface::new(&grid, MapInterpolation::Cubic);
    let map = crustal(&map);
    let dip = field_at(CoreFieldModel::Igrf14, 2020.5, 7.5, 140.5, 300.0);
    assert!((dip.z / dip.norm()).abs() < 0.05, "{dip}");
    for (place, b) in inner_places(7.5, 300.0).iter().zip(fields(&map, &inner_places(7.5, 300.0))) {
        let core = field_at(CoreFieldModel::Igrf14, 2020.5, place.0, place.1, place.2);
        let t = lookup.at(place.0, place.1).unwrap().value_nt;
        assert!(b.norm() < 3000.0, "{b}");
        // Between nodes, splines of the vector and of the magnitude differ in the second order, which is 0.04 nT here.
        let shown = crustal::change_of_magnitude(&core, &b);
        assert!((shown - t).abs() < 5e-3, "{shown} {t}");
    }
}

#[test]
fn law_sources_have_no_curl_and_a_vertical_dipole_is_twice_as_strong_above_it() {
    let core = CoreField::at(2020.0).unwrap();
    let body = BuriedBody::Dipole { moment_am2: 1e9 };
    let down = BuriedSource {
        lat_deg: 50.0,
        lon_deg: 9.0,
        alt_m: -500.0,
        inclination_declination_deg: Some((90.0, 0.0)),
        body,
    };
    let above = field_ned_nt(&[LocalFrameSource::new(&down, &core)], 50.0, 9.0, 500.0);
    // 2 µ0/4π m/r³ = 2 · 100 nT m/A · 1e9 A m² / 1e9 m³.
    assert!((above - Vector3::new(0.0, 0.0, 200.0)).norm() < 1e-6, "{above}");
    let induced = BuriedSource { inclination_declination_deg: None, ..down };
    let east = BuriedSource { inclination_declination_deg: Some((0.0, 90.0)), ..down };
    let [induced, east] = [induced, east].map(|b| field_ned_nt(&[LocalFrameSource::new(&b, &core)], 50.0, 9.0, 500.0));
    assert!(east.x.abs() < 1e-6 && (east.y + 100.0).abs() < 1e-6, "{east}");
    let f = field_at(CoreFieldModel::Igrf14, 2020.0, 50.0, 9.0, -500.0).normalize();
    assert!((induced - Vector3::new(-100.0 * f.x, -100.0 * f.y, 200.0 * f.z)).norm() < 1e-6);
    // The work along a tilted circle of 2 km radius about the prism is zero.
    let prism =
        [LocalFrameSource::new(&BuriedSource { lat_deg: 50.0, lon_deg: 9.0, ..prism(50.0, 9.0, 300.0, 2.0) }, &core)];
    let earth = numerics::earth::geodesy::EarthModel::Wgs84;
    let rad = 50f64.to_radians();
    let (mut work, mut length) = (0.0, 0.0);
    const STEPS: usize = 2000;
    for k in 0..STEPS {
        let angle = std::f64::consts::TAU * k as f64 / STEPS as f64;
        let (sin, cos) = angle.sin_cos();
        let (north, east, alt) = (2000.0 * cos, 2000.0 * sin, 900.0 + 800.0 * cos);
        let lat = 50.0 + earth.north_m_to_lat_rad(north, rad, alt).to_degrees();
        let lon = 9.0 + earth.east_m_to_lon_rad(east, lat.to_radians(), alt).to_degrees();
        let step = std::f64::consts::TAU / STEPS as f64;
        let along = Vector3::new(-2000.0 * sin, 2000.0 * cos, 800.0 * sin) * step;
        let b = field_ned_nt(&prism, lat, lon, alt);
        work += b.dot(&along);
        length += b.norm() * along.norm();
    }
    // The circle is computed with the radii of curvature at one latitude, which gives a relative error of 3e-4.
    assert!(work.abs() < 1e-3 * length, "{work} of {length}");
}

fn simulate(text: &str) -> Vec<RecordBatch> {
    try_simulate(text).unwrap()
}

fn try_simulate(text: &str) -> Result<Vec<RecordBatch>, String> {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("s.synth.toml");
    fs::write(&path, text).unwrap();
    let simulation = Simulation::open(&path).map_err(|e| e.to_string())?;
    let lines = simulation.into_lines(1).map(|l| l.and_then(|l| l.into_batch(&path)));
    lines.collect::<Result<_, _>>().map_err(|e| e.to_string())
}

fn column<'a>(line: &'a RecordBatch, name: &str) -> &'a [f64] {
    line.column_by_name(name).unwrap().as_primitive::<Float64Type>().values()
}

const LINE: &str = "[[flights]]\nname = 'A'\nstart_tt_s = 36000.0\n[[flights.lines]]\nname = 'A.1'\nalt_m = 500.0\n\
                    duration_s = 60.0\nwaypoints = [[-22.05, 140.6], [-21.9, 140.65]]\n";
const BARE: &str = "[[magnetometers]]\nname = 'mag_1_c'\n[[vector_magnetometers]]\nname = 'flux_a'\n";

fn osborne() -> String {
    format!("[map]\npath = '{}'\n", samples::path(OSBORNE).display())
}

#[test]
fn law_with_all_off_the_field_is_the_core_field() {
    let off = "year = 2021\ndoy = 100\n[components]\nanomaly = false\ndiurnal = false\n[diurnal]\nsigma_nt = 5.0\n\
               quiet_nt = 30.0\n";
    let line = &simulate(&format!("{off}{}{BARE}{LINE}", osborne()))[0];
    let without_map = &simulate(&format!("{off}{BARE}{LINE}"))[0];
    assert_eq!(line, without_map, "a map that is off is not looked at");
    for i in 0..line.num_rows() {
        let year = decimal_year(2021, 100, column(line, "tt")[i]).unwrap();
        let (lat, lon) = (column(line, "lat")[i], column(line, "lon")[i]);
        let core = CoreField::at(year).unwrap().magnitude_nt(lat, lon, 500.0);
        // Rounding of 5e4 nT.
        assert!((column(line, "mag_1_c")[i] - core).abs() < 1e-9);
        assert!((column(line, "igrf")[i] - core).abs() < 1e-9);
        assert_eq!((column(line, "anomaly_truth")[i], column(line, "diurnal")[i]), (0.0, 0.0));
    }
}

#[test]
fn law_the_scalar_anomaly_equals_the_map() {
    let line = &simulate(&format!("year = 2020\ndoy = 185\n{}{BARE}{LINE}", osborne()))[0];
    let map = datasets::read_map(&samples::path(OSBORNE), &MapOptions::default()).unwrap();
    let grid = GeographicGrid::new(&map.latitudes_deg(), &map.longitudes_deg(), map.column("anomaly")).unwrap();
    let lookup = MapSurface::new(&grid, MapInterpolation::Cubic);
    let mut most: f64 = 0.0;
    for i in 0..line.num_rows() {
        let t = lookup.at(column(line, "lat")[i], column(line, "lon")[i]).unwrap().value_nt;
        let (truth, core) = (column(line, "anomaly_truth")[i], column(line, "igrf")[i]);
        let measured = column(line, "mag_1_c")[i] - core;
        assert!((measured - truth).abs() < 1e-8, "what the magnetometer shows is the column");
        // At the nodes the magnitude equals the map. Between nodes, splines of the magnitude and of the vector differ
        // by at most a quarter of the change of b²/2B from node to node.
        let beyond = (truth - t).abs();
        assert!(beyond < 0.05, "{i}: {truth} {t}");
        most = most.max(beyond);
    }
    assert!(most > 1e-6, "the anomaly is a vector, not a change along the core field: {most}");
}

#[test]
fn law_the_projected_field_differs_from_the_map_by_less_than_the_second_order() {
    let map = datasets::read_map(&samples::path(OSBORNE), &MapOptions::default()).unwrap();
    let grid = GeographicGrid::new(&map.latitudes_deg(), &map.longitudes_deg(), map.column("anomaly")).unwrap();
    let lookup = MapSurface::new(&grid, MapInterpolation::Cubic);
    let map = crustal(&map);
    // The map is the change of magnitude by a gradient field; without the corrections the residual would be 3 nT or
    // more.
    assert!(map.most_rest_nt() < 1e-4, "{}", map.most_rest_nt());
    let places: Vec<_> =
        (0..500).map(|k| (-22.1 + 0.00055 * f64::from(k), 140.57 + 0.0004 * f64::from(k), 500.0)).collect();
    for (place, b) in places.iter().zip(fields(&map, &places)) {
        let core = field_at(CoreFieldModel::Igrf14, 2020.5, place.0, place.1, place.2);
        let along = b.dot(&core) / core.norm();
        let t = lookup.at(place.0, place.1).unwrap().value_nt;
        let square = b.norm_squared() / (2.0 * core.norm());
        // The component across the core field makes the magnitude larger than the projection; the splines are as in the
        // test above.
        assert!((-0.05..square + 0.05).contains(&(t - along)), "{place:?}: {along} {t} {square}");
    }
}

#[test]
fn law_five_years_later_the_field_has_changed_by_the_secular_variation() {
    let at =
        |year: i32| simulate(&format!("year = {year}\ndoy = 1\n[components]\nanomaly = false\n{BARE}{LINE}")).remove(0);
    let (before, after) = (at(2020), at(2025));
    let track = CoreFieldTrack::new(CoreFieldModel::Igrf14);
    for i in (0..before.num_rows()).step_by(100) {
        let (lat, lon) = (column(&before, "lat")[i], column(&before, "lon")[i]);
        let place = ([lat], [lon], [500.0]);
        let sv = track.secular_variation(&place.0, &place.1, &place.2, &[2020.5]).unwrap();
        let change = Vector3::new(sv.north_nt[0], sv.east_nt[0], sv.down_nt[0]) * 5.0;
        let core = field_at(CoreFieldModel::Igrf14, 2020.0, lat, lon, 500.0);
        let expected = (core + change).norm() - core.norm();
        let found = column(&after, "igrf")[i] - column(&before, "igrf")[i];
        // The field is linear in time between the epochs. The first ten hours of 2025 use the rate of the following
        // years, which differs by up to 20 nT per year; the difference in ten hours is up to 0.02 nT.
        assert!((found - expected).abs() < 0.02 && found.abs() > 10.0, "{found} {expected}");
    }
    let wmm =
        |year: i32| format!("year = {year}\n[components]\nanomaly = false\n[core_field]\nmodel = 'wmm'\n{BARE}{LINE}");
    let world = &simulate(&wmm(2020))[0];
    let difference = column(world, "igrf")[0] - column(&before, "igrf")[0];
    assert!(difference != 0.0 && difference.abs() < 100.0, "two models of one field: {difference}");
    let early = try_simulate(&wmm(2015)).unwrap_err();
    assert!(early.contains("WMM") && early.contains("2015"), "{early}");
}

#[test]
fn law_flights_of_a_day_share_all_but_the_irregular_variation() {
    let diurnal = Diurnal {
        irregular: Some(GaussMarkov { sigma: 3.0, tau_s: 600.0 }),
        quiet_nt: 30.0,
        pulsations: Some(Pulsations { sigma_nt: 0.5, period_s: 30.0, width: 0.1 }),
        storm: Some(Storm { depth_nt: 100.0, start_tt_s: 36_100.0, main_s: 7200.0, recovery_s: 20_000.0 }),
        observatory: None,
    };
    let see = |flight: &str, diurnal: &Diurnal, tt_s: &[f64]| {
        let n = tt_s.len();
        let variation = TemporalVariation { diurnal, observatory: None, seed: 5, flight, start_tt_s: 36_000.0 };
        let core = vec![Vector3::new(20_000.0, 1000.0, 40_000.0); n];
        let (lat, lon) = (vec![45.0; n], vec![10.0; n]);
        variation.along(&VariationPoints { tt_s, lat_deg: &lat, lon_deg: &lon, core_ned_nt: &core }).unwrap()
    };
    let tt: Vec<f64> = (0..20_000).map(|k| 36_000.0 + 0.1 * f64::from(k)).collect();
    let whole = see("1", &diurnal, &tt);
    assert_eq!(see("1", &diurnal, &tt[7003..]), whole[7003..], "a line that begins later");
    let steps = whole.windows(2).map(|w| (w[1] - w[0]).norm()).fold(0.0, f64::max);
    // The steps are at most 0.085 nT by the knots (five standard deviations of 3 nT √(2/600) = 0.17 nT/s), 0.01 nT by
    // the pulsations (0.1 nT/s), and 0.03 nT by the storm's commencement (25 nT in 90 s).
    assert!(steps < 0.15, "{steps}");
    let other = see("2", &diurnal, &tt);
    assert!((0..tt.len()).any(|i| (other[i] - whole[i]).norm() > 1.0), "the irregular part is of the flight");
    let day = Diurnal { irregular: None, ..diurnal };
    assert_eq!(see("1", &day, &tt), see("2", &day, &tt), "all else is of the day");
}

#[test]
fn gold_faults_of_the_earths_field() {
    let message = try_simulate(&format!("{BARE}{LINE}")).unwrap_err();
    assert!(
        message.contains("needs a table `map`, a list `sources`, or `anomaly = false` in `components`"),
        "{message}"
    );
    let wrong = "[core_field]\nmodel = 'igfr'\n[[sources]]\nkind = 'prizm'\nlat = 1.0\nlon = 1.0\n[[sources]]\n\
                 lat = -22.0\nlon = 140.6\ndepth_m = 1.0\n\
                 alt_m = -1.0\nmoment_am2 = 1.0\n[[sources]]\nlat = 99.0\nlon = 1.0\ndepth_m = 1.0\n[[sources]]\n\
                 kind = 'prism'\n\
                 lat = 9.0\nlon = 1.0\ndepth_m = 1.0\nmagnetisation_apm = 1.0\n[diurnal]\nstorm_nt = 3.0\n\
                 quite_nt = 1.0\n";
    let message = try_simulate(&format!("{wrong}{LINE}")).unwrap_err();
    for what in [
        "`model` cannot be `igfr`",
        "did you mean `igrf`?",
        "`kind` cannot be `prizm`",
        "a source needs either `depth_m` or `alt_m`",
        "`lat` must be -90 to 90",
        "a prism needs `size_m`, its length, width and thickness",
        "`storm_nt` needs `storm_start_tt_s`, the start in seconds past midnight UTC",
        "did you mean `quiet_nt`?",
    ] {
        assert!(message.contains(what), "{what} is not in\n{message}");
    }
    let gone =
        try_simulate(&format!("[components]\nanomaly = false\n[diurnal]\nobservatory = 'no.min'\n{LINE}")).unwrap_err();
    assert!(gone.contains("the record of the observatory `") && gone.contains("no.min` does not exist"), "{gone}");
    let through = "[[sources]]\nlat = -22.05\nlon = 140.6\nalt_m = 500.0\nmoment_am2 = 1e6\n";
    let through = try_simulate(&format!("{through}{LINE}")).unwrap_err();
    assert!(through.contains("line A.1: the line goes through a source at -22.05000, 140.60000"), "{through}");
}

#[test]
fn unit_the_field_does_not_depend_on_the_order_of_requests() {
    fn shared<T: Send + Sync>(_: &T) {}
    let (_, map) = known(-22.0);
    let (one, other) = (crustal(&map), crustal(&map));
    shared(&one);
    let low: Vec<_> = (0..50).map(|k| (-22.0, 140.5, 320.0 + 3.0 * f64::from(k))).collect();
    let high: Vec<_> = low.iter().map(|(lat, lon, alt)| (*lat, *lon, alt + 100.0)).collect();
    let before = (fields(&one, &low), fields(&one, &high));
    let high_first = fields(&other, &high);
    assert_eq!(before, (fields(&other, &low), high_first));
}

#[test]
fn unit_the_field_of_twenty_hours_takes_less_than_20_s() {
    const SAMPLES: usize = 720_000;
    let map = datasets::read_map(&samples::path(OSBORNE), &MapOptions::default()).unwrap();
    let track = CoreFieldTrack::new(CoreFieldModel::Igrf14);
    let start = std::time::Instant::now();
    let map = CrustalMap::new(Path::new(""), &map, &track, 2020.5).unwrap();
    let prepared = start.elapsed();
    let phase = |k: usize, turns: f64| (turns * std::f64::consts::TAU * k as f64 / SAMPLES as f64).sin();
    let lat: Vec<f64> = (0..SAMPLES).map(|k| -21.97 + 0.1 * phase(k, 97.0)).collect();
    let lon: Vec<f64> = (0..SAMPLES).map(|k| 140.67 + 0.1 * phase(k, 31.0)).collect();
    let alt: Vec<f64> = (0..SAMPLES).map(|k| 700.0 + 200.0 * phase(k, 11.0)).collect();
    let core = track.field(&lat, &lon, &alt, &vec![2020.5; SAMPLES]).unwrap();
    let cored = start.elapsed();
    let core: Vec<_> = (0..SAMPLES).map(|i| Vector3::new(core.north_nt[i], core.east_nt[i], core.down_nt[i])).collect();
    let field = map.along([&lat, &lon, &alt], &vec![[0.0; 3]; lat.len()], &core).unwrap().unwrap();
    println!("map {prepared:?}, core field {:?}, crustal field {:?}", cored - prepared, start.elapsed() - cored);
    assert!(field.iter().all(|b| b.norm() < 1e4));
    // Ten times the usual duration, for a busy machine.
    assert!(start.elapsed().as_secs() < 20, "{:?}", start.elapsed());
}
