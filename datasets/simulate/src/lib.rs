//! Simulated flights with known truth over a real map.
//!
//! A synth spec (TOML) describes a map, the INS, the aircraft's sensors and the flights. Every number depends on the
//! spec alone. Each random draw has its own stream, derived by hashing the seed and the names of flight, line and
//! sensor. The same spec therefore gives the same bytes, and an added flight or sensor does not change the others.
//! Flights and lines are simulated in parallel, with few lines in memory.
//!
//! Heights are above the WGS-84 ellipsoid. A map height above sea level is treated as a height above the ellipsoid, in
//! the simulation and in navigation.

use std::{
    fs::File,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
};

use arrow_schema::{DataType, Schema, SchemaRef};
use datasets::{ReadError, row_groups::ends_with_line, table::ColumnTable};
use parquet::{
    arrow::ArrowWriter,
    basic::{Compression, ZstdLevel},
    file::properties::WriterProperties,
};
use rayon::prelude::*;
use schemas::{
    field,
    flight::{self, GNSS_POSITION, GNSS_VELOCITY, INS_GRADE},
};

use self::lines::LineSimulator;

mod aircraft;
mod earth;
mod format;
mod gnss;
mod ins;
mod line;
mod lines;
mod random;
mod reading;
mod reference;
mod scene;
mod spec;
mod trajectory;

pub use aircraft::{
    Aircraft, AircraftFieldSpec, ChannelErrors, ControlQuantity, ControlSignal, Current, CurrentControl,
    EngineThrottle, HeadingErrorModel, QuantitySpec, ScalarMagnetometer, SensorSampling, Temperature, Thermostat,
    VectorMagnetometer, Voltage, Wire,
};
pub use earth::{BuriedBody, BuriedSource, Diurnal, Pulsations, Storm, SynthEarth};
pub use format::FORMAT;
pub use gnss::GnssReceiver;
pub use ins::spec::{InsAlignment, InsErrorPropagation, InsInitialErrors, SynthIns};
pub use reading::{COMPONENTS, ComponentSwitches, PRESETS};
pub use reference::reference;
pub use spec::SynthSpec;
pub use trajectory::{
    Dynamics, FlightConditions, HorizontalPath, LineHeights, Orbit, SurveyLineGrid, SynthFlight, SynthLine, Turbulence,
    Wind,
};

/// Simulation of a checked spec that has not been run.
#[derive(Debug)]
pub struct Simulation {
    path: PathBuf,
    spec: SynthSpec,
}

impl Simulation {
    /// Reads a spec.
    ///
    /// # Errors
    /// Fails with all faults of the spec, or for a map that does not exist.
    pub fn open(path: &Path) -> Result<Simulation, ReadError> {
        let spec = SynthSpec::read(path)?;
        if let Some((what, file)) = spec.earth.files().into_iter().find(|(_, file)| !file.exists()) {
            return Err(ReadError::options(path, format!("the {what} `{}` does not exist", file.display())));
        }
        Ok(Simulation { path: path.to_path_buf(), spec })
    }

    /// The spec.
    pub fn spec(&self) -> &SynthSpec {
        &self.spec
    }

    /// The input files: the spec, the map and the observatory's record.
    pub fn inputs(&self) -> Vec<&Path> {
        let others = self.spec.earth.files();
        std::iter::once(self.path.as_path()).chain(others.into_iter().map(|(_, file)| file)).collect()
    }

    /// The schema of every line.
    pub fn schema(&self) -> SchemaRef {
        let gnss = self.spec.gnss.iter().flat_map(|_| GNSS_POSITION.iter().chain(&GNSS_VELOCITY));
        let before = TRUTH.iter().chain(&ins::COLUMNS).chain([&INS_GRADE]).chain(gnss).chain(&FIELD);
        let mut names: Vec<String> = before.map(|&name| name.to_owned()).collect();
        names.extend(aircraft::columns(&self.spec.aircraft));
        let fields = names.iter().map(|name| {
            let known = flight::describe(name);
            let data_type = match name.as_str() {
                "flight" | "line" | INS_GRADE => DataType::Utf8,
                "year" | "doy" => DataType::Int64,
                _ => DataType::Float64,
            };
            field(name, data_type, known.unit, known.role, known.description)
        });
        Arc::new(Schema::new(fields.collect::<Vec<_>>()))
    }

    /// The lines of all flights, simulated on demand, `at_once` of them in parallel.
    pub(crate) fn into_lines(self, at_once: usize) -> LineSimulator {
        let flights = 0..self.spec.flights.len();
        LineSimulator::new(Arc::new(SimulationContext::new(self)), flights, at_once)
    }
}

const TRUTH: [&str; 17] = [
    "flight",
    "line",
    "year",
    "doy",
    "tt",
    "lat",
    "lon",
    "alt",
    "vn",
    "ve",
    "vd",
    "roll",
    "pitch",
    "yaw",
    "roll_rate",
    "pitch_rate",
    "yaw_rate",
];

const FIELD: [&str; 3] = ["diurnal", "igrf", "anomaly_truth"];

/// Data shared by all flights: the simulation and the earth's field.
struct SimulationContext {
    simulation: Simulation,
    field: Mutex<Option<Arc<earth::EarthFieldModel>>>,
}

impl SimulationContext {
    fn new(simulation: Simulation) -> SimulationContext {
        SimulationContext { simulation, field: Mutex::default() }
    }

    /// The earth's field. The lock is not held during the computation, because a thread that waits for its transform
    /// may start another flight, which also needs the field.
    fn field(&self) -> Result<Arc<earth::EarthFieldModel>, ReadError> {
        let known = || self.field.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(field) = &*known() {
            return Ok(field.clone());
        }
        let field = Arc::new(earth::EarthFieldModel::new(&self.simulation.path, &self.simulation.spec)?);
        Ok(known().get_or_insert(field).clone())
    }
}

/// Simulates a spec into flight tables: in the folder `to` one Parquet file per flight, one row group per line (short
/// lines share one). Flights and lines are simulated in parallel, on the threads of the current pool; each file is
/// written under a temporary name, and all are renamed when the last is complete. Returns the paths.
///
/// # Errors
/// Fails with all faults of the spec, or for a line that leaves the map. Also fails if a file cannot be written. After
/// a failure no new file exists.
pub fn synthesise(spec: &Path, to: &Path) -> Result<Vec<PathBuf>, ReadError> {
    synthesise_with(spec, to, &|_, _| ())
}

/// Same as [`synthesise`], but calls `progress` after each line with the number of finished lines and the total.
/// `progress` is called from several threads, concurrently and not always in order.
///
/// # Errors
/// Fails in the cases of [`synthesise`].
pub fn synthesise_with(
    spec: &Path,
    to: &Path,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Vec<PathBuf>, ReadError> {
    let simulation = Simulation::open(spec)?;
    let schema = simulation.schema();
    let names: Vec<_> = simulation.spec.flights.iter().map(|f| f.name.clone()).collect();
    if let Some(name) = names.iter().find(|n| !n.chars().all(|c| c.is_alphanumeric() || "._-".contains(c))) {
        return Err(ReadError::options(spec, format!("the flight name `{name}` is not a valid file name")));
    }
    std::fs::create_dir_all(to).map_err(|e| ReadError::io(to, &e))?;
    let all = simulation.spec.flights.iter().map(|f| f.lines.len()).sum();
    let threads = rayon::current_num_threads();
    let at_once = if names.len() >= threads { 1 } else { threads.div_ceil(names.len().max(1)) };
    let (world, done, failed) =
        (Arc::new(SimulationContext::new(simulation)), AtomicUsize::new(0), AtomicUsize::new(usize::MAX));
    // The field is computed once, before the flights use it in parallel.
    world.field()?;
    // Processes that write into the same folder use separate partial files.
    let own = std::process::id();
    let files: Vec<_> = names
        .iter()
        .map(|n| (to.join(format!(".{n}.{own}.parquet.partial")), to.join(format!("{n}.parquet"))))
        .collect();
    let one = |(flight, (partial, _)): (usize, &(PathBuf, PathBuf))| {
        // Flights after a failed flight are skipped. Earlier flights are still simulated, because a fault of an earlier
        // flight is reported first.
        let wanted = || flight <= failed.load(Ordering::Relaxed);
        let lines = LineSimulator::new(world.clone(), flight..flight + 1, at_once).take_while(|_| wanted());
        let counted = lines.inspect(|_| progress(done.fetch_add(1, Ordering::Relaxed) + 1, all));
        let written = if wanted() { write(spec, partial, &schema, counted) } else { Ok(()) };
        if written.is_err() {
            failed.fetch_min(flight, Ordering::Relaxed);
        }
        written
    };
    let written: Vec<_> = files.par_iter().enumerate().with_max_len(1).map(one).collect();
    let renamed = written.into_iter().collect::<Result<Vec<()>, _>>().and_then(|_| rename(&files));
    if let Err(error) = renamed {
        for (partial, _) in &files {
            // An error of the removal is ignored, because the first error is reported.
            let _ = std::fs::remove_file(partial);
        }
        return Err(error);
    }
    Ok(files.into_iter().map(|(_, file)| file).collect())
}

fn rename(files: &[(PathBuf, PathBuf)]) -> Result<(), ReadError> {
    files.iter().try_for_each(|(from, to)| std::fs::rename(from, to).map_err(|e| ReadError::io(to, &e)))
}

fn write(
    spec: &Path,
    to: &Path,
    schema: &SchemaRef,
    lines: impl Iterator<Item = Result<ColumnTable, ReadError>>,
) -> Result<(), ReadError> {
    let file = File::create(to).map_err(|e| ReadError::io(to, &e))?;
    let failed = |e: parquet::errors::ParquetError| ReadError::io(to, &std::io::Error::other(e));
    let mut writer = ArrowWriter::try_new(file, schema.clone(), Some(properties(schema))).map_err(failed)?;
    for line in lines {
        writer.write(&line?.into_batch(spec)?).map_err(failed)?;
        if ends_with_line(writer.in_progress_rows(), writer.flushed_row_groups().len()) {
            writer.flush().map_err(failed)?;
        }
    }
    let file = writer.into_inner().map_err(failed)?;
    file.sync_all().map_err(|e| ReadError::io(to, &e))
}

/// The encoding of the files: plain numbers, because nearly all numbers are distinct.
fn properties(schema: &Schema) -> WriterProperties {
    let builder = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::default()))
        // Row groups end only at ends of lines.
        .set_max_row_group_row_count(None);
    let numbers = schema.fields().iter().filter(|f| f.data_type() == &DataType::Float64);
    numbers.fold(builder, |b, f| b.set_column_dictionary_enabled(f.name().as_str().into(), false)).build()
}

#[cfg(test)]
mod tests;
