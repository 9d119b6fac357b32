//! Interpolation of anomaly maps, compared with scipy. The cases are value and gradient along a flight and at random
//! places, one at a time and in batches. One map fits into the cache; the other map does not. Another case fills gaps
//! of a large map.
//!
//! `cargo bench -p magline-numerics --bench interpolation --profile dev` prints the fastest of several runs on one
//! thread and checks each against a formula. `interpolation_scipy.py` times scipy on the same work, runs this bench,
//! and prints the ratios.

use std::{hint::black_box, sync::OnceLock, time::Instant};

use numerics::{
    earth::field_value::FieldValue,
    maps::{
        fill::{NearestFill, SmoothFill, nearest, smooth},
        grid_projection::{GeographicArea, GridProjection},
        map_stack::{MapStack, ProjectedMap, StackOptions},
        map_surface::{FieldColumns, GeographicGrid, MapInterpolation, MapSurface, VerticalDerivative},
        plane_grid::{EvenAxis, PlaneGrid},
        projection::Projection,
    },
};

type Failure = Box<dyn std::error::Error + Send + Sync>;

const LOOK_UPS: usize = 2_000_000;
/// Number of repetitions. The fastest run counts in this bench and in the script, because it is the least disturbed.
const REPEATS: usize = 7;
const SOUTH_DEG: f64 = -22.0;
const WEST_DEG: f64 = 140.0;
const STEP_DEG: f64 = 0.001;

/// Name, rows and columns of the maps; the large one has as many nodes as the map of Gnadt 2022.
const MAPS: [(&str, usize, usize); 2] = [("small", 400, 330), ("large", 3195, 7279)];

/// Processor time of this thread in seconds, or elapsed time if the system does not report the processor time. Other
/// work on the machine affects the processor time less.
fn seconds_now() -> f64 {
    static START: OnceLock<Instant> = OnceLock::new();
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = told.split(' ').next().and_then(|first| first.parse::<f64>().ok());
    nanoseconds.map_or_else(|| START.get_or_init(Instant::now).elapsed().as_secs_f64(), |ns| ns * 1e-9)
}

fn fastest_s(mut work: impl FnMut()) -> f64 {
    work();
    let time = |_| {
        let start = seconds_now();
        work();
        seconds_now() - start
    };
    (0..REPEATS).map(time).fold(f64::INFINITY, f64::min)
}

/// Waves of the script, some 25 nodes long.
fn field(row: f64, column: f64) -> f64 {
    100.0 * (0.23 * row).sin() * (0.19 * column).cos() + 0.02 * row - 0.01 * column
}

fn axis(first_deg: f64, count: usize) -> Vec<f64> {
    (0..count).map(|k| first_deg + STEP_DEG * k as f64).collect()
}

fn map(rows: usize, columns: usize, scale: f64) -> Result<GeographicGrid, Failure> {
    let values: Vec<f64> =
        (0..rows).flat_map(|r| (0..columns).map(move |c| scale * field(r as f64, c as f64))).collect();
    Ok(GeographicGrid::new(&axis(SOUTH_DEG, rows), &axis(WEST_DEG, columns), &values)?)
}

/// Positions of a flight with steps of about 7 m, back and forth over the map; or the same number of random positions
/// on the map.
fn places(rows: usize, columns: usize, along_track: bool) -> (Vec<f64>, Vec<f64>) {
    let (height, width) = (STEP_DEG * (rows - 3) as f64, STEP_DEG * (columns - 3) as f64);
    let place = |k: usize| {
        let k = k as f64;
        let (up, right) = if along_track {
            let turn = |x: f64| (x.rem_euclid(2.0) - 1.0).abs();
            (turn(5.3e-5 * k / height), turn(4.1e-5 * k / width))
        } else {
            ((0.618_033_988_749_895 * k).fract(), (0.754_877_666_246_693 * k).fract())
        };
        (SOUTH_DEG + STEP_DEG + height * up, WEST_DEG + STEP_DEG + width * right)
    };
    (0..LOOK_UPS).map(place).unzip()
}

/// The largest error against the waves, in nT.
fn check(lat: &[f64], lon: &[f64], found: &FieldColumns) -> Result<f64, Failure> {
    let nodes = lat.iter().zip(lon).map(|(lat, lon)| ((lat - SOUTH_DEG) / STEP_DEG, (lon - WEST_DEG) / STEP_DEG));
    let errors = nodes.zip(&found.value_nt).map(|((row, column), value)| (value - field(row, column)).abs());
    let worst = errors.fold(0.0, |worst: f64, error| if error.is_nan() { f64::INFINITY } else { worst.max(error) });
    // Bilinear: a wave of 100 nT bends by 100 x (0.23² + 0.19²) / 8 = 1.1 nT in a cell.
    if worst < 1.2 { Ok(worst) } else { Err(format!("the look-ups are off by {worst} nT").into()) }
}

fn print(what: &str, seconds: f64) {
    println!("{what}: {:.1} million/s", LOOK_UPS as f64 / seconds / 1e6);
}

fn sum_one_by_one(map: &MapSurface, lat: &[f64], lon: &[f64]) -> f64 {
    let all = |f: FieldValue| f.value_nt + f.d_lat_nt_per_rad + f.d_lon_nt_per_rad + f.d_alt_nt_per_m;
    lat.iter().zip(lon).filter_map(|(lat, lon)| map.at(*lat, *lon)).map(all).sum()
}

fn look_ups() -> Result<(), Failure> {
    for (size, rows, columns) in MAPS {
        let (grid, derivative) = (map(rows, columns, 1.0)?, map(rows, columns, -0.01)?);
        let tracks = [("track", places(rows, columns, true)), ("random", places(rows, columns, false))];
        for interpolation in [MapInterpolation::Linear, MapInterpolation::Quadratic, MapInterpolation::Cubic] {
            let start = Instant::now();
            let plain = MapSurface::new(&grid, interpolation);
            println!("{size} {interpolation:?} prepared: {:.3} s", start.elapsed().as_secs_f64());
            let vertical = VerticalDerivative { d_alt_nt_per_m: derivative.values(), alt_m: 0.0 };
            let with_vertical = MapSurface::with_vertical(&grid, vertical, interpolation)?;
            for (track, (lat, lon)) in &tracks {
                let name = format!("{size} {interpolation:?} {track}");
                let single = fastest_s(|| {
                    black_box(sum_one_by_one(&plain, lat, lon));
                });
                print(&format!("{name} one by one"), single);
                for (kind, map) in [("many", &plain), ("many with vertical", &with_vertical)] {
                    let mut out = FieldColumns::default();
                    let mut answer = Ok(());
                    let seconds = fastest_s(|| answer = map.at_many(lat, lon, black_box(&mut out)));
                    answer?;
                    let worst = check(lat, lon, &out)?;
                    print(&format!("{name} {kind} (off by {worst:.1e} nT)"), seconds);
                }
            }
        }
    }
    Ok(())
}

fn stacks() -> Result<(), Failure> {
    let (_, rows, columns) = MAPS[0];
    let heights: Vec<f64> = (0..6).map(|level| 300.0 + 80.0 * f64::from(level)).collect();
    let maps: Vec<GeographicGrid> =
        heights.iter().map(|height| map(rows, columns, (-height / 500.0).exp())).collect::<Result<_, _>>()?;
    let (lat, lon) = places(rows, columns, true);
    let alt: Vec<f64> = (0..LOOK_UPS).map(|k| 310.0 + 380.0 * (1e-5 * k as f64).sin().abs()).collect();
    for interpolation in [MapInterpolation::Linear, MapInterpolation::Cubic] {
        let stack = MapStack::new(&heights, &maps, StackOptions { interpolation, ..StackOptions::default() })?;
        let mut out = FieldColumns::default();
        let mut answer = Ok(());
        let seconds = fastest_s(|| answer = stack.at_many(&lat, &lon, &alt, black_box(&mut out)));
        answer?;
        if out.value_nt.iter().any(|value| value.is_nan()) {
            return Err("a place within the stack has no value".into());
        }
        print(&format!("stack {interpolation:?} track many"), seconds);
    }
    Ok(())
}

/// Look-ups of the small map in UTM zone 54 south on its native grid, and the time of the projection alone, by the
/// polynomials and by the exact formulas.
fn projected() -> Result<(), Failure> {
    let (_, rows, columns) = MAPS[0];
    let (lat, lon) = places(rows, columns, true);
    let system = Projection::new("+proj=utm +zone=54 +south +datum=WGS84 +units=m +no_defs")?;
    let (easting, northing) = system.project(SOUTH_DEG, WEST_DEG).ok_or("no place")?;
    let even = |first: f64, len: usize| EvenAxis { first: first - 2_000.0, step: 100.0, len };
    let (y, x) = (even(northing, 3 * rows / 2), even(easting, 3 * columns / 2));
    let far = |n: usize| STEP_DEG * n as f64;
    let area =
        GeographicArea { lat_deg: [SOUTH_DEG, SOUTH_DEG + far(rows)], lon_deg: [WEST_DEG, WEST_DEG + far(columns)] };
    let projection = GridProjection::new(|lat, lon| system.project(lat, lon), area, &y, &x)?;
    println!("projection: off by {:.1e} of a step", projection.departure_steps());
    let exact = fastest_s(|| {
        let all = lat.iter().zip(&lon).filter_map(|(lat, lon)| system.project(*lat, *lon));
        black_box(all.map(|(x, y)| x + y).sum::<f64>());
    });
    print("projection by itself", exact);
    let polynomials = fastest_s(|| {
        let all = lat.iter().zip(&lon).filter_map(|(lat, lon)| projection.at(*lat, *lon));
        black_box(all.map(|p| p.row + p.column + p.row_per_deg[0] + p.column_per_deg[1]).sum::<f64>());
    });
    print("projection by polynomials, with slopes", polynomials);
    let values: Vec<f64> = (0..y.len).flat_map(|r| (0..x.len).map(move |c| field(r as f64, c as f64))).collect();
    let grid = GeographicGrid::of_nodes(y.len, x.len, &values)?;
    for interpolation in [MapInterpolation::Linear, MapInterpolation::Cubic] {
        let map = ProjectedMap::flat(projection.clone(), MapSurface::new(&grid, interpolation));
        let seconds = fastest_s(|| {
            let all = lat.iter().zip(&lon).filter_map(|(lat, lon)| map.at(*lat, *lon, 0.0));
            black_box(all.map(|f| f.value_nt + f.d_lat_nt_per_rad + f.d_lon_nt_per_rad).sum::<f64>());
        });
        print(&format!("projected {interpolation:?} track one by one"), seconds);
    }
    Ok(())
}

/// A large map with a wide gap, the corners cut off, and single nodes missing: 39 % unknown.
fn gappy() -> PlaneGrid {
    let (_, rows, columns) = MAPS[1];
    let axis = |len| EvenAxis { first: 0.0, step: 100.0, len };
    let unknown = |row: usize, column: usize| {
        let (r, c) = (row as f64 / rows as f64, column as f64 / columns as f64);
        (r - 0.55).hypot(1.7 * (c - 0.6)) < 0.28
            || r + 1.2 * c < 0.45
            || r - c > 0.6
            || (row * 31 + column * 17).is_multiple_of(97)
    };
    let value = |row: usize, column: usize| {
        if unknown(row, column) { f64::NAN } else { field(row as f64, column as f64) }
    };
    let values = (0..rows).flat_map(|row| (0..columns).map(move |column| value(row, column))).collect();
    PlaneGrid { east_m: axis(columns), north_m: axis(rows), values }
}

/// Processor time of one thread, or elapsed time with several threads, and the result.
fn timed<T>(threads: usize, work: impl FnOnce() -> T) -> (f64, T) {
    let (start, clock) = (seconds_now(), Instant::now());
    let answer = work();
    (if threads == 1 { seconds_now() - start } else { clock.elapsed().as_secs_f64() }, answer)
}

fn filling() -> Result<(), Failure> {
    let map = gappy();
    println!("fill {} of {} nodes", map.unknown(), map.values.len());
    let mut answers = Vec::new();
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let (seconds, filled) = pool.install(|| timed(threads, || nearest(&map, &NearestFill::default())));
        println!("fill nearest, threads {threads}: {seconds:.2} s");
        let (seconds, smoothed) = pool.install(|| timed(threads, || smooth(&map, &SmoothFill::default())));
        let (smoothed, report) = smoothed?;
        println!("fill smooth, threads {threads}: {seconds:.2} s, {} iterations", report.iterations);
        answers.push([filled?, smoothed]);
    }
    if answers[0] != answers[1] || answers[0].iter().any(|map| map.unknown() > 0) {
        return Err("the filled map depends on the number of threads, or is not filled".into());
    }
    let sum: f64 = answers[0][0].values.iter().sum();
    println!("fill sum {sum:?}");
    Ok(())
}

fn main() -> Result<(), Failure> {
    let only = std::env::args().nth(1).unwrap_or_default();
    if only != "fill" {
        projected()?;
        look_ups()?;
        stacks()?;
    }
    if only != "look-ups" {
        filling()?;
    }
    Ok(())
}
