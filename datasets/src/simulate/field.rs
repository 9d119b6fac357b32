//! The earth's field along a track: the core field, and the anomaly of a real map at the height flown.

use std::path::Path;

use rustfft::{FftPlanner, num_complex::Complex};
use stages::numerics::{
    geodesy::EarthModel,
    map_grid::{AnomalyMap, Interpolation, MapGrid},
};

use crate::{Map, ReadError};

/// Heights that differ by less are one, in metres.
const SAME_LEVEL_M: f64 = 0.5;

/// The anomaly at the height `alt_m`: the map itself at its own height, above it the map continued
/// upward.
///
/// # Errors
/// A map that is not level, or that lies higher than `alt_m`: continuing down would amplify its noise.
pub(super) fn anomaly_at(path: &Path, map: &Map, alt_m: f64) -> Result<AnomalyMap, ReadError> {
    let level_m = map.column("alt").first().copied().unwrap_or(f64::NAN);
    if map.column("alt").iter().any(|a| *a != level_m) {
        return Err(ReadError::data(path, "the simulation needs a map of one height").in_column("alt"));
    }
    let up_m = alt_m - level_m;
    if up_m < -SAME_LEVEL_M {
        let what = format!("the map is {level_m} m high, above the line's {alt_m} m");
        return Err(ReadError::options(path, what).help("fly at the map's height or above"));
    }
    let mut values = map.column("anomaly").to_vec();
    if up_m > SAME_LEVEL_M {
        values = continued(map, &values, up_m);
    }
    let grid = MapGrid::new(&map.latitudes_deg(), &map.longitudes_deg(), &values);
    let grid = grid.map_err(|e| ReadError::data(path, e.to_string()))?;
    Ok(AnomalyMap::new(&grid, Interpolation::Cubic))
}

/// A map continued upward by `up_m` metres; what was unknown stays unknown. The grid is taken as even in
/// metres, with the spacing at its middle.
fn continued(map: &Map, values: &[f64], up_m: f64) -> Vec<f64> {
    let (lat, lon) = (map.latitudes_deg(), map.longitudes_deg());
    let step = |axis: &[f64]| (axis[axis.len() - 1] - axis[0]) / (axis.len() - 1) as f64;
    let middle = (0.5 * (lat[0] + lat[lat.len() - 1])).to_radians();
    let earth = EarthModel::Wgs84;
    let dy_m = step(&lat).to_radians() * earth.north_m_per_rad(middle, 0.0);
    let dx_m = step(&lon).to_radians() * earth.east_m_per_rad(middle, 0.0);
    let known = filled(values, map.n_lon);
    let up = upward(&known, map.n_lat, map.n_lon, (dy_m, dx_m), up_m);
    values.iter().zip(up).map(|(v, u)| if v.is_nan() { f64::NAN } else { u }).collect()
}

/// Unknown cells with the value of the nearest known one of their row, or of the nearest row that has any.
fn filled(values: &[f64], width: usize) -> Vec<f64> {
    let mut rows: Vec<Vec<f64>> = values.chunks(width).map(nearest_known).collect();
    let full = |row: &[f64]| !row.iter().any(|v| v.is_nan());
    let known: Vec<usize> = (0..rows.len()).filter(|j| full(&rows[*j])).collect();
    for j in 0..rows.len() {
        if let (false, Some(nearest)) = (full(&rows[j]), known.iter().min_by_key(|k| k.abs_diff(j))) {
            rows[j] = rows[*nearest].clone();
        }
    }
    rows.concat()
}

fn nearest_known(row: &[f64]) -> Vec<f64> {
    let known: Vec<usize> = (0..row.len()).filter(|i| !row[*i].is_nan()).collect();
    let mut out = row.to_vec();
    for (i, value) in out.iter_mut().enumerate() {
        // The nearest at or after i, or the last before.
        let after = known.partition_point(|k| *k < i);
        let near = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|k| known.get(k));
        if let (true, Some(near)) = (value.is_nan(), near.min_by_key(|k| k.abs_diff(i))) {
            *value = row[*near];
        }
    }
    out
}

/// A level grid of a potential field, by rows, continued upward: exp(-|k| up) in the Fourier domain. The
/// grid is extended to twice its size by a smooth bridge from each end to the other, so that it is
/// periodic. [Blakely 1996, (12.8)]
pub(super) fn upward(values: &[f64], rows: usize, columns: usize, spacing_m: (f64, f64), up_m: f64) -> Vec<f64> {
    let (tall, wide) = (transform_size(rows), transform_size(columns));
    let across: Vec<Vec<f64>> = values.chunks(columns).map(|row| periodic(row, wide)).collect();
    let mut grid = vec![Complex::default(); tall * wide];
    for i in 0..wide {
        let column: Vec<f64> = across.iter().map(|row| row[i]).collect();
        for (j, value) in periodic(&column, tall).into_iter().enumerate() {
            grid[j * wide + i] = Complex::new(value, 0.0);
        }
    }
    let mut planner = FftPlanner::new();
    let (along, down) = (planner.plan_fft_forward(wide), planner.plan_fft_forward(tall));
    along.process(&mut grid);
    let mut turned = transposed(&grid, tall, wide);
    down.process(&mut turned);
    for (i, column) in turned.chunks_mut(tall).enumerate() {
        for (j, value) in column.iter_mut().enumerate() {
            let k = wave_number(i, wide, spacing_m.1).hypot(wave_number(j, tall, spacing_m.0));
            *value *= (-k * up_m).exp() / (tall * wide) as f64;
        }
    }
    planner.plan_fft_inverse(tall).process(&mut turned);
    let mut back = transposed(&turned, wide, tall);
    planner.plan_fft_inverse(wide).process(&mut back);
    back.chunks(wide).take(rows).flat_map(|row| row.iter().take(columns).map(|c| c.re)).collect()
}

/// The next size at or above twice `n` that has no prime factor above 7.
fn transform_size(n: usize) -> usize {
    let smooth = |mut m: usize| {
        for p in [2, 3, 5, 7] {
            while m.is_multiple_of(p) {
                m /= p;
            }
        }
        m == 1
    };
    (2 * n..).find(|m| smooth(*m)).unwrap_or(2 * n)
}

/// `x` extended to `size` values by half a cosine from its last value to its first.
fn periodic(x: &[f64], size: usize) -> Vec<f64> {
    let (first, last) = (x[0], x[x.len() - 1]);
    let gap = size - x.len();
    let bridge = (1..=gap).map(|i| {
        let s = 0.5 - 0.5 * (std::f64::consts::PI * i as f64 / (gap + 1) as f64).cos();
        last + (first - last) * s
    });
    x.iter().copied().chain(bridge).collect()
}

fn transposed(x: &[Complex<f64>], rows: usize, columns: usize) -> Vec<Complex<f64>> {
    (0..columns).flat_map(|i| (0..rows).map(move |j| x[j * columns + i])).collect()
}

/// In rad/m.
fn wave_number(i: usize, n: usize, spacing_m: f64) -> f64 {
    std::f64::consts::TAU * i.min(n - i) as f64 / (n as f64 * spacing_m)
}
