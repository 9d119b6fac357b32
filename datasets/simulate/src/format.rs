//! Synth spec as a flight format. Reading the spec runs the simulation, so that no large file is stored.

use std::path::Path;

use datasets::{
    ReadError,
    formats::{FileHead, FlightBatch, FlightFormat, FlightInputs, FlightOptions, RawFlight, ReadHints},
};

use crate::Simulation;

/// Synth specs among the flight formats.
pub const FORMAT: FlightFormat = FlightFormat {
    name: "synth",
    about: "a synth spec: simulated flights with known truth",
    extensions: &["synth.toml"],
    recognise: |head: &FileHead| head.path().to_string_lossy().ends_with(".synth.toml"),
    open,
    topics: None,
    made_from: Some(made_from),
};

fn made_from(path: &Path) -> Result<FlightInputs, ReadError> {
    let simulation = Simulation::open(path)?;
    let files = simulation.inputs().into_iter().map(Path::to_path_buf).collect();
    Ok(FlightInputs { files, lines: simulation.spec().flights.iter().map(|f| f.lines.len()).sum() })
}

fn open(path: &Path, _: &FlightOptions, reading: &ReadHints) -> Result<RawFlight, ReadError> {
    let simulation = Simulation::open(path)?;
    let schema = simulation.schema();
    let (path, mut done) = (path.to_path_buf(), false);
    let mut lines = simulation.into_lines(reading.threads);
    let parts = std::iter::from_fn(move || {
        if done {
            return None;
        }
        let batch = lines.next()?.and_then(|line| line.into_batch(&path));
        done = batch.is_err();
        Some(batch.map(FlightBatch::whole))
    });
    Ok(RawFlight::new(schema, Box::new(parts)))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

    use std::path::PathBuf;

    use arrow_array::cast::AsArray;
    use arrow_schema::{DataType, Field, Schema};
    use datasets::{formats::flight_formats, open_flight_among};

    use super::*;

    #[test]
    fn unit_the_synth_spec_is_a_format() {
        let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../examples/osborne.synth.toml");
        let formats = flight_formats(&[FORMAT]);
        let mut reader = open_flight_among(&formats, &path, &FlightOptions::default(), &ReadHints::default()).unwrap();
        assert_eq!(reader.format(), "synth");
        let first = reader.next().unwrap().unwrap();
        assert_eq!(&first.schema(), reader.schema());
        assert_eq!(first.column_by_name("line").unwrap().as_string::<i32>().value(0), "1.01");
        schemas::canonical::FlightConversion::new(reader.schema()).unwrap();
        let schema = Schema::new(vec![Field::new("x", DataType::Float64, true)]);
        assert_ne!(reader.schema().as_ref(), &schema);
    }

    #[test]
    fn unit_a_synth_spec_lists_its_inputs_and_number_of_lines() {
        let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../examples/osborne.synth.toml");
        let formats = flight_formats(&[FORMAT]);
        let reader = open_flight_among(&formats, &path, &FlightOptions::default(), &ReadHints::default()).unwrap();
        let contents = reader.made_from().unwrap()(&path).unwrap();
        let mut lines: Vec<String> = vec![];
        for batch in reader {
            let batch = batch.unwrap();
            let of = |name: &str| batch.column_by_name(name).unwrap().as_string::<i32>().value(0).to_owned();
            lines.push(of("flight") + "/" + &of("line"));
        }
        lines.dedup();
        assert_eq!(contents.lines, lines.len());
        assert_eq!(contents.files[0], path);
        assert!(
            contents.files[1..].iter().any(|f| f.ends_with("osborne_anomaly_100m_at_500m.tif")),
            "{:?}",
            contents.files
        );
    }

    #[test]
    fn gold_the_error_of_an_unknown_format_lists_synth_specs() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("a.dat");
        std::fs::write(&path, "\0\u{1}\u{2}").unwrap();
        let formats = flight_formats(&[FORMAT]);
        let message = open_flight_among(&formats, &path, &FlightOptions::default(), &ReadHints::default()).unwrap_err();
        let known = "known here: parquet, synth, ulog, dataflash, mat, sgl_hdf5, magnav_hdf5, geosoft_xyz, sgl_xyz, \
                     magnav_csv, iaga2002, imf, mfam, csv, points; choose one with `format`";
        assert_eq!(message.to_string(), format!("{}: is not in a known flight format ({known})", path.display()));
    }
}
