//! Survey points as a flight log: the lines in sequence, with each point as a sample.

use std::{path::Path, sync::Arc};

use arrow_array::{ArrayRef, Float64Array, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema};
use schemas::{Role, field, flight};

use super::{
    FlightBatch, FlightFormat, FlightOptions, PointOptions, RawFlight, ReadHints, doubts, points_table, read_points,
};
use crate::ReadError;

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: points_table::POINTS,
    about: "survey points in any table: positions, values and lines; requires `format = \"points\"`",
    extensions: &[],
    // Any table of numbers may hold points, so only the option selects the format.
    recognise: |_| false,
    open,
    topics: None,
    made_from: None,
};

/// Canonical columns that `rename` can assign to columns of the file.
const ROLES: [&str; 7] = ["lon", "easting", "lat", "northing", "alt", "anomaly", "line"];

fn open(path: &Path, options: &FlightOptions, _: &ReadHints) -> Result<RawFlight, ReadError> {
    let named = |roles: &[&str]| {
        let found = options.rename.iter().find(|(_, to)| roles.contains(&to.as_str()));
        found.map(|(theirs, _)| theirs.clone())
    };
    let points = read_points(
        path,
        &PointOptions {
            x: named(&ROLES[..2]),
            y: named(&ROLES[2..4]),
            height: named(&["alt"]),
            value: named(&["anomaly"]),
            line: named(&["line"]),
            epsg: options.epsg,
            missing: options.missing.iter().filter(|w| w.0.trim().parse::<f64>().is_ok()).cloned().collect(),
            accept: options.accept.clone(),
            ..PointOptions::default()
        },
    )?;
    // The points of a line follow each other, in the order of the file.
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by_key(|i| points.line[*i]);
    let pick =
        |values: &[f64]| -> ArrayRef { Arc::new(order.iter().map(|i| Some(values[*i])).collect::<Float64Array>()) };
    let mut notes = points.notes.clone();
    notes.extend(doubts(&points));
    let tt = match &points.extra.tt_s {
        Some(tt_s) => pick(tt_s),
        None => {
            notes.push("the points have no time, so `tt` is the index of each point in its line, from 0".to_owned());
            let counted = order.iter().enumerate().map(|(k, i)| {
                let first = order.partition_point(|j| points.line[*j] < points.line[*i]);
                Some((k - first) as f64)
            });
            Arc::new(counted.collect::<Float64Array>())
        }
    };
    let known = |name: &str| {
        let known = flight::describe(name);
        field(name, DataType::Float64, known.unit, known.role, known.description)
    };
    let mut columns: Vec<(Field, ArrayRef)> = vec![
        (known("tt"), tt),
        (known("lat"), pick(&points.lat_deg)),
        (known("lon"), pick(&points.lon_deg)),
        (known("alt"), pick(&points.height_m)),
        (
            field("anomaly", DataType::Float64, "nT", Role::Aux, "total field anomaly of the survey"),
            pick(&points.value_nt),
        ),
    ];
    let extra = &points.extra;
    for (name, values) in
        [("diurnal", &extra.diurnal_nt), ("igrf", &extra.igrf_nt), ("year", &extra.year), ("doy", &extra.doy)]
    {
        columns.extend(values.as_ref().map(|values| (known(name), pick(values))));
    }
    let names = points.lines.len() > 1 || points.lines.iter().any(|name| !name.is_empty());
    if names && options.line.is_none() {
        let line: StringArray = order.iter().map(|i| points.lines.get(points.line[*i] as usize)).collect();
        columns.push((field("line", DataType::Utf8, "", Role::Key, "line identifier"), Arc::new(line)));
    }
    let (fields, arrays): (Vec<Field>, Vec<ArrayRef>) = columns.into_iter().unzip();
    let schema = Arc::new(Schema::new(fields));
    let batch = RecordBatch::try_new(schema.clone(), arrays).map_err(|e| ReadError::data(path, e.to_string()))?;
    let parts = Box::new(std::iter::once(Ok(FlightBatch::whole(batch))));
    // Renames to one of `ROLES` have already been applied; the caller applies the other renames.
    let own = options.rename.iter().filter(|(_, to)| ROLES.contains(&to.as_str())).map(|(from, _)| from.clone());
    Ok(RawFlight { own: Some(own.collect()), notes, ..RawFlight::new(schema, parts) })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use crate::{FlightOptions, open_flight, samples};

    #[test]
    fn unit_survey_points_are_lines_of_a_flight() {
        let path = samples::path("britain/britain_sw_survey_points.parquet");
        let options =
            FlightOptions { format: Some("points".into()), flight: Some("gb".into()), ..FlightOptions::default() };
        let reader = open_flight(&path, &options).unwrap();
        let names: Vec<String> = reader.schema().fields().iter().map(|f| f.name().clone()).collect();
        assert_eq!(names, ["flight", "tt", "lat", "lon", "alt", "anomaly", "year", "line"]);
        assert!(reader.notes().iter().any(|n| n.contains("no time")), "{:?}", reader.notes());
        let wrong = FlightOptions { rename: [("nowhere".into(), "anomaly".into())].into(), ..options };
        assert!(open_flight(&path, &wrong).err().unwrap().to_string().contains("nowhere"));
    }
}
