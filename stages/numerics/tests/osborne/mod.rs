//! Flights over the real Osborne map, with known truth: shared by the Monte Carlo test and the
//! navigation bench. The map's origin and licence are in `reference/navigation/README.md`.

use numerics::{
    earth::{
        core_field::{CoreField, CoreFieldError},
        geodesy::EarthModel,
    },
    maps::map_surface::{GeographicGrid, MapGridError},
    navigation::{
        ins_series::{InsSeries, SeriesError},
        pinson::{ALT, LAT, LON, S, STATES, VD, VE, VN},
        strapdown::{level_attitude_deg, specific_force_ned_mps2, velocity_ned_mps},
    },
};

const SOUTH_DEG: f64 = -22.166;
const WEST_DEG: f64 = 140.501;
const ROWS: u32 = 416;
const COLUMNS: u32 = 333;
const STEP_DEG: f64 = 0.001;
const VALUES: &[u8] = include_bytes!("../../reference/navigation/osborne.i16");

/// The date of the flights.
pub const DECIMAL_YEAR: f64 = 2023.42;

/// The anomaly map, 500 m above sea level.
pub fn grid() -> Result<GeographicGrid, MapGridError> {
    let axis = |first: f64, count: u32| -> Vec<f64> { (0..count).map(|k| first + STEP_DEG * f64::from(k)).collect() };
    let fifths = VALUES.chunks_exact(2).map(|pair| i16::from_le_bytes([pair[0], pair[1]]));
    let values: Vec<f64> = fifths.map(|fifth| f64::from(fifth) / 5.0).collect();
    GeographicGrid::new(&axis(SOUTH_DEG, ROWS), &axis(WEST_DEG, COLUMNS), &values)
}

/// The core field at the date of the flights.
pub fn core_field() -> Result<CoreField, CoreFieldError> {
    CoreField::at(DECIMAL_YEAR)
}

/// A navigation line that owns the columns: time, position, velocity, specific force, attitude.
#[derive(Clone)]
pub struct Line {
    pub columns: [Vec<f64>; 13],
}

impl Line {
    /// A flight of `samples` every `dt_s` that crosses the whole map repeatedly, 18 km to the north and south of the
    /// middle, and 12 km to the east and west, at up to 75 m/s; `phase_rad` selects another such flight.
    pub fn flown(samples: u32, dt_s: f64, phase_rad: f64) -> Result<Self, SeriesError> {
        let of = |f: &dyn Fn(f64) -> f64| -> Vec<f64> { (0..samples).map(|k| f(dt_s * f64::from(k))).collect() };
        let middle_lat = SOUTH_DEG + STEP_DEG * f64::from(ROWS) / 2.0;
        let middle_lon = WEST_DEG + STEP_DEG * f64::from(COLUMNS) / 2.0;
        let lat_rad = middle_lat.to_radians();
        let earth = EarthModel::Wgs84;
        let degrees_north = earth.north_m_to_lat_rad(18e3, lat_rad, 500.0).to_degrees();
        let degrees_east = earth.east_m_to_lon_rad(12e3, lat_rad, 500.0).to_degrees();
        let tt = of(&|t| t);
        let lat = of(&|t| middle_lat + degrees_north * (0.002_9 * t + phase_rad).sin());
        let lon = of(&|t| middle_lon + degrees_east * (0.004_37 * t + 2.0 * phase_rad + 0.6).sin());
        let alt = of(&|t| 500.0 + 20.0 * (0.01 * t).sin());
        let [vn, ve, vd] = velocity_ned_mps(&tt, &lat, &lon, &alt)?;
        let [force_n, force_e, force_d] = specific_force_ned_mps2(&tt, [&lat, &alt], [&vn, &ve, &vd])?;
        let [roll, pitch, yaw] = level_attitude_deg(&vn, &ve)?;
        Ok(Self { columns: [tt, lat, lon, alt, vn, ve, vd, force_n, force_e, force_d, roll, pitch, yaw] })
    }

    /// The columns as an `InsSeries`.
    pub fn series(&self) -> InsSeries<'_> {
        InsSeries::from_columns(self.columns.each_ref().map(Vec::as_slice))
    }

    /// Output of an INS with these errors on this line: truth minus error.
    pub fn with_errors(&self, errors: &[[f64; STATES]]) -> Self {
        let mut ins = self.clone();
        for (row, error) in errors.iter().enumerate() {
            ins.columns[1][row] -= error[LAT].to_degrees();
            ins.columns[2][row] -= error[LON].to_degrees();
            for (column, state) in [(3, ALT), (4, VN), (5, VE), (6, VD)] {
                ins.columns[column][row] -= error[state];
            }
        }
        ins
    }
}

/// The temporal variation of an error state.
pub fn temporal_nt(error: &[f64; STATES]) -> f64 {
    error[S]
}
