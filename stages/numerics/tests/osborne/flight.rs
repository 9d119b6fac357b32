//! A flight over the Osborne map with the readings of the INS and the magnetometer, for the benches.

use numerics::{
    earth::core_field::CoreField,
    maps::map_surface::MapSurface,
    navigation::ins_error::{InsErrorModel, simulate_ins_error},
    random::NormalGenerator,
};

use crate::osborne::{Line, temporal_nt};

/// A flight: its truth, its INS and its magnetometer in nT.
pub struct Flight {
    pub truth: Line,
    pub ins: Line,
    pub measured_nt: Vec<f64>,
}

/// A flight of `samples` at 10 Hz.
pub fn flight(
    map: &MapSurface,
    core: &CoreField,
    samples: u32,
) -> Result<Flight, Box<dyn std::error::Error + Send + Sync>> {
    let truth = Line::flown(samples, 0.1, 0.3)?;
    let mut normals = NormalGenerator::new(11);
    let errors = simulate_ins_error(&truth.series(), &InsErrorModel::default(), || normals.draw())?;
    let mut measured_nt = Vec::with_capacity(errors.len());
    for (row, error) in errors.iter().enumerate() {
        let [lat, lon, alt] = [1, 2, 3].map(|column: usize| truth.columns[column][row]);
        let anomaly = map.at(lat, lon).ok_or("the flight leaves the map")?;
        let field = anomaly.value_nt + core.magnitude_nt(lat, lon, alt);
        measured_nt.push(field + temporal_nt(error) + 5.0 * normals.draw());
    }
    let ins = truth.with_errors(&errors);
    Ok(Flight { truth, ins, measured_nt })
}
