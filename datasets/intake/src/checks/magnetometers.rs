//! Checks that compare the magnetometers of a line with each other.

use arrow_array::{RecordBatch, cast::AsArray, types::Float64Type};
use schemas::flight;

use super::{
    QualityFigure, QualityMeasure,
    dead_zone::{DeadZoneShape, dead_zone},
    dropouts, lag,
};

/// The figures of the magnetometers of a line.
pub fn of_magnetometers(line: &RecordBatch, tt: &[f64], out: &mut Vec<QualityMeasure>) {
    let schema = line.schema();
    let values = |name: &str| -> Option<Vec<f64>> {
        let column = line.column_by_name(name)?.as_primitive_opt::<Float64Type>()?;
        Some(column.iter().map(|x| x.unwrap_or(f64::NAN)).collect())
    };
    let names = || schema.fields().iter().map(|f| f.name().as_str());
    let scalars: Vec<&str> = names().filter(|n| flight::is_scalar_reading(n)).collect();
    let x_of = |name| flight::vector_part(name).filter(|part| part.1 == 'x').map(|part| part.0);
    let vectors: Vec<(&str, [Vec<f64>; 3])> = names()
        .filter_map(x_of)
        .filter_map(|vector| {
            let [x, y, z] = ["x", "y", "z"].map(|part| values(&format!("{vector}_{part}")));
            Some((vector, [x?, y?, z?]))
        })
        .collect();
    let at = |row: usize| tt.get(row).copied().unwrap_or(f64::NAN);
    let readings: Vec<(&str, Vec<f64>)> = scalars.iter().filter_map(|n| Some((*n, values(n)?))).collect();
    for (name, reading) in &readings {
        let flags = name.strip_suffix("_uc").and_then(|n| values(&format!("{n}_deadzone")));
        let flagged: Vec<f64> = flags.iter().flatten().map(|flag| if *flag > 0.0 { f64::NAN } else { 0.0 }).collect();
        if let Some(found) = dropouts::dropouts(&flagged, tt) {
            out.push(measure(name, QualityFigure::DeadZone, found.longest_s, "s", found.samples, at(found.first)));
        }
        let lost: Vec<bool> = reading
            .iter()
            .enumerate()
            .map(|(row, x)| !x.is_finite() || flagged.get(row).is_some_and(|flag| flag.is_nan()))
            .collect();
        if let Some((_, [x, y, z])) = vectors.first()
            && let Some(found) = dead_zone(&lost, [x, y, z])
        {
            let figure = match found.shape {
                DeadZoneShape::Polar => QualityFigure::PolarDeadZone,
                DeadZoneShape::Equatorial => QualityFigure::EquatorialDeadZone,
            };
            out.push(measure(name, figure, found.half_width_deg, "deg", found.samples, at(found.first)));
        }
    }
    if let Some(((_, reference), others)) = readings.split_first() {
        for (name, reading) in others {
            if let Some(found) = lag::lag(reference, reading, tt, false) {
                out.push(measure(name, QualityFigure::Lag, found.lag_s, "s", found.pairs, f64::NAN));
            }
        }
    }
    if let Some(((_, reference), others)) = vectors.split_first() {
        let most = (0..3).max_by(|a, b| roughness(&reference[*a]).total_cmp(&roughness(&reference[*b]))).unwrap_or(0);
        for (name, vector) in others {
            if let Some(found) = lag::lag(&reference[most], &vector[most], tt, true) {
                let column = format!("{name}_{}", ["x", "y", "z"][most]);
                out.push(measure(&column, QualityFigure::Lag, found.lag_s, "s", found.pairs, f64::NAN));
            }
        }
    }
}

/// The sum of squares of the differences from sample to sample.
fn roughness(x: &[f64]) -> f64 {
    x.windows(2).map(|w| (w[1] - w[0]).powi(2)).filter(|d| d.is_finite()).sum()
}

fn measure(column: &str, check: QualityFigure, value: f64, unit: &str, count: usize, first_tt: f64) -> QualityMeasure {
    QualityMeasure { column: column.to_owned(), check, value, unit: unit.to_owned(), count: count as u64, first_tt }
}
