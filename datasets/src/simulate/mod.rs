//! Simulated flights with known truth over a real map.
//!
//! A synth spec (TOML) names a map, the INS, the aircraft's sensors and the flights. Every number is
//! computed from the spec alone: each random draw has a stream of its own, found by hashing the seed and
//! the names of flight, line and sensor, so that the same spec gives the same bytes, and adding a flight
//! or a sensor changes no other. One line at a time is in memory.
//!
//! Heights are above the WGS-84 ellipsoid throughout; a map whose height is above sea level is taken as
//! if that were above the ellipsoid, in the simulation as in navigation.

use std::{
    fs::File,
    path::{Path, PathBuf},
    sync::Arc,
};

use arrow_schema::{DataType, Schema, SchemaRef};
use parquet::{
    arrow::ArrowWriter,
    basic::{Compression, ZstdLevel},
    file::properties::WriterProperties,
};
use schemas::{field, flight};

use crate::{ReadError, table::Table};

mod aircraft;
mod earth;
mod ins;
mod line;
mod random;
mod spec;
mod trajectory;

pub use aircraft::{Aircraft, Current, Scalar, Source, Vector};
pub use earth::{Body, Buried, Diurnal, Earth, Pulsations, Storm};
pub use ins::spec::{Align, InitialErrors, Ins, Method};
pub use spec::{COMPONENTS, Components, Spec};
pub use trajectory::{Flight, Line, Path2d};

/// A spec about to be simulated.
#[derive(Debug)]
pub struct Simulation {
    path: PathBuf,
    spec: Spec,
}

impl Simulation {
    /// Reads a spec.
    ///
    /// # Errors
    /// All that is wrong with the spec, and a map that is not there.
    pub fn open(path: &Path) -> Result<Simulation, ReadError> {
        let spec = Spec::read(path)?;
        if let Some((what, file)) = spec.earth.files().into_iter().find(|(_, file)| !file.exists()) {
            return Err(ReadError::options(path, format!("the {what} `{}` is not there", file.display())));
        }
        Ok(Simulation { path: path.to_path_buf(), spec })
    }

    /// What is simulated.
    pub fn spec(&self) -> &Spec {
        &self.spec
    }

    /// The files that what comes out depends on: the spec, the map and the observatory's record.
    pub fn inputs(&self) -> Vec<&Path> {
        let others = self.spec.earth.files();
        std::iter::once(self.path.as_path()).chain(others.into_iter().map(|(_, file)| file)).collect()
    }

    /// The schema of every line.
    pub fn schema(&self) -> SchemaRef {
        let before = TRUTH.iter().chain(&ins::COLUMNS).chain(&FIELD);
        let mut names: Vec<String> = before.map(|&name| name.to_owned()).collect();
        names.extend(self.spec.aircraft.scalars.iter().map(|s| s.name.clone()));
        names.extend(
            self.spec.aircraft.vectors.iter().flat_map(|v| ["x", "y", "z"].map(|axis| format!("{}_{axis}", v.name))),
        );
        names.extend(self.spec.aircraft.currents.iter().map(|c| c.name.clone()));
        let fields = names.iter().map(|name| {
            let known = flight::describe(name);
            let data_type = match name.as_str() {
                "flight" | "line" => DataType::Utf8,
                "year" | "doy" => DataType::Int64,
                _ => DataType::Float64,
            };
            field(name, data_type, known.unit, known.role, known.description)
        });
        Arc::new(Schema::new(fields.collect::<Vec<_>>()))
    }

    /// The lines of all flights, each simulated when it is asked for.
    pub(crate) fn into_lines(self) -> Lines {
        let numbers = self.spec.flights.iter().enumerate();
        let order: Vec<_> = numbers.flat_map(|(f, flight)| (0..flight.lines.len()).map(move |l| (f, l))).collect();
        Lines { simulation: self, order: order.into_iter(), field: None, ins: None }
    }
}

const TRUTH: [&str; 14] =
    ["flight", "line", "year", "doy", "tt", "lat", "lon", "alt", "vn", "ve", "vd", "roll", "pitch", "yaw"];

const FIELD: [&str; 3] = ["diurnal", "igrf", "anomaly_truth"];

/// Lines being simulated.
pub(crate) struct Lines {
    simulation: Simulation,
    order: std::vec::IntoIter<(usize, usize)>,
    field: Option<earth::Field>,
    /// The INS of the flight whose lines are being simulated, by the flight's number.
    ins: Option<(usize, ins::Run)>,
}

impl Iterator for Lines {
    type Item = Result<Table, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        let (f, l) = self.order.next()?;
        Some(self.simulate(f, l))
    }
}

impl Lines {
    fn simulate(&mut self, f: usize, l: usize) -> Result<Table, ReadError> {
        let Simulation { path, spec } = &self.simulation;
        let flight = &spec.flights[f];
        let line = &flight.lines[l];
        let field = match &mut self.field {
            Some(field) => field,
            none => none.insert(earth::Field::new(path, spec)?),
        };
        let ins = match &mut self.ins {
            Some((of, ins)) if *of == f => ins,
            other => &mut other.insert((f, ins::Run::of(path, spec, flight)?)).1,
        };
        line::Scene { path, spec, flight, line }.simulate(field, ins)
    }
}

/// Simulates a spec into flight tables: in the folder `to` one Parquet file a flight, one row group a
/// line, each written beside and renamed when it is whole. Returns the files.
///
/// # Errors
/// All that is wrong with the spec, a line that leaves the map, and what the machine says of the files.
pub fn synthesise(spec: &Path, to: &Path) -> Result<Vec<PathBuf>, ReadError> {
    let simulation = Simulation::open(spec)?;
    let schema = simulation.schema();
    let counts: Vec<_> = simulation.spec.flights.iter().map(|f| (f.name.clone(), f.lines.len())).collect();
    if let Some((name, _)) = counts.iter().find(|(n, _)| !n.chars().all(|c| c.is_alphanumeric() || "._-".contains(c))) {
        return Err(ReadError::options(spec, format!("the flight `{name}` cannot be the name of a file")));
    }
    std::fs::create_dir_all(to).map_err(|e| ReadError::io(to, &e))?;
    let mut lines = simulation.into_lines();
    let mut files = vec![];
    for (name, count) in counts {
        let file = to.join(format!("{name}.parquet"));
        let partial = to.join(format!(".{name}.parquet.partial"));
        let written = write(spec, &partial, &schema, lines.by_ref().take(count));
        let renamed = written.and_then(|()| std::fs::rename(&partial, &file).map_err(|e| ReadError::io(&file, &e)));
        if let Err(error) = renamed {
            // Best effort: the first error is the one to tell.
            let _ = std::fs::remove_file(&partial);
            return Err(error);
        }
        files.push(file);
    }
    Ok(files)
}

fn write(
    spec: &Path,
    to: &Path,
    schema: &SchemaRef,
    lines: impl Iterator<Item = Result<Table, ReadError>>,
) -> Result<(), ReadError> {
    let file = File::create(to).map_err(|e| ReadError::io(to, &e))?;
    let failed = |e: parquet::errors::ParquetError| ReadError::io(to, &std::io::Error::other(e));
    let properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::default()))
        // Row groups end where lines do.
        .set_max_row_group_row_count(None)
        .build();
    let mut writer = ArrowWriter::try_new(file, schema.clone(), Some(properties)).map_err(failed)?;
    for line in lines {
        writer.write(&line?.into_batch(spec)?).map_err(failed)?;
        writer.flush().map_err(failed)?;
    }
    let file = writer.into_inner().map_err(failed)?;
    file.sync_all().map_err(|e| ReadError::io(to, &e))
}

#[cfg(test)]
mod tests;
