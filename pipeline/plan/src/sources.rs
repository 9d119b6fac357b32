//! Tables read from files: found, hashed, and stored line by line.

mod bytes;
pub mod export;
mod files;
mod flight_file;
mod ingest;
mod model;
mod options;
mod packer;
mod sample;

use std::{path::PathBuf, sync::Arc};

use arrow_array::RecordBatch;
use arrow_schema::{Schema, SchemaRef};
use buckets::{StorageLocation, cache, place};
use datasets::{AnomalyGrid, MapOptions, map_files, map_gives_error, read_grid};
use intake::FlightDivision;
use schemas::{Column, Fault, Table, TableShape, canonical::FlightConversion, describe_field, keys::HashKey};
use store::Store;

pub use bytes::{FileDigest, ReusePolicy, fingerprint};
pub use files::{file, find, hive, walk};
use flight_file::FlightFile;
pub use ingest::LineRecord;
use model::ModelTable;
pub use options::{AUTO, MappingOptions, ModelOptions, WHOLE, division};
use options::{FileOptions, flight_options, map_options, spelt};

use crate::spec::SourceDecl;

/// Version of ingest, increased when the output of ingest changes.
const VERSION: &str = "ingest 3";

/// Version of the stored form of a map, increased when the form changes.
const MAP_VERSION: &str = "map 3";

/// Version of the stored form of a model from files, increased when the form changes.
const MODEL_VERSION: &str = "model 1";

/// Table of flights with known columns, before its lines are read.
pub struct Flights {
    /// Name in the spec.
    pub name: String,
    /// Columns that any of the files has.
    pub shape: TableShape,
    /// Arrow fields of these columns.
    pub schema: SchemaRef,
    /// Notes for the user on the files.
    pub notes: Vec<String>,
    /// Whether the bytes of the files are read even if the files appear unchanged.
    pub read_all: bool,
    /// Division of the flights into lines, which replaces the lines of the files.
    division: Option<FlightDivision>,
    files: Vec<FlightFile>,
}

/// The lines of a table of flights, in the order of their names.
pub struct FlightLines {
    /// One record per line.
    pub lines: Vec<LineRecord>,
    /// The files that contain the lines, and the keys of the files.
    pub files: Vec<FileDigest>,
    /// The folders of their quality figures: tables in the form of [`intake::checks::table`].
    pub quality: Vec<PathBuf>,
}

/// The progress of reading a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadProgress<'a> {
    /// The file that is read.
    pub file: &'a std::path::Path,
    /// Whether the file is the spec of a simulation, whose lines are simulated.
    pub simulated: bool,
    /// Number of finished lines of the file.
    pub lines: usize,
    /// Number of lines of the file, if known before the file is read.
    pub of_lines: Option<usize>,
    /// Number of finished files of the table.
    pub done: usize,
    /// Number of files of the table.
    pub all: usize,
}

impl<'a> ReadProgress<'a> {
    /// Progress at the start or end of a file.
    pub fn of_file(file: &'a std::path::Path, done: usize, all: usize) -> ReadProgress<'a> {
        ReadProgress { file, simulated: false, lines: 0, of_lines: None, done, all }
    }
}

impl Flights {
    /// Finds the files and reads their schemas.
    ///
    /// # Errors
    /// Fails for options, files, columns and units that cannot be used, with their position in the spec.
    pub fn open(decl: &SourceDecl, folder: &std::path::Path) -> Result<Flights, Vec<Fault>> {
        Flights::open_trusting(decl, folder, ReusePolicy::default())
    }

    /// Same as [`Flights::open`], but does not scan unchanged files whose facts are in a store.
    ///
    /// # Errors
    /// Returns the errors of [`Flights::open`].
    pub fn open_trusting(
        decl: &SourceDecl,
        folder: &std::path::Path,
        trust: ReusePolicy,
    ) -> Result<Flights, Vec<Fault>> {
        let placed = |f: Fault| f.at(decl.path.1.clone());
        let FileOptions { options, mapped, lines, note } = flight_options(decl, folder)?;
        // A fault in a mapping is shown at its place in the mapping.
        let shown = |f: &Fault| mapped.is_some() && intake::mapping::is_shown(f);
        let any_name = decl.options.contains_key("format");
        let mut found = find(&decl.path.0, folder, any_name).map_err(|f| vec![placed(f)])?;
        let young = trust.settle.and_then(|settle| files::settled(&mut found, settle));
        if let Some(what) = young.as_ref().filter(|_| found.is_empty()) {
            let fault =
                Fault::new(format!("every file of `{}` was modified within the time given by `--settle`", decl.name))
                    .help(what.clone());
            return Err(vec![placed(fault)]);
        }
        if let Some(mapped) = mapped.as_ref().filter(|_| found.len() > 1) {
            found.retain(|path| mapped.is_in(path));
            if found.is_empty() {
                let what =
                    format!("no file of `{}` belongs to the table `{}` of the mapping", decl.path.0, mapped.name());
                return Err(vec![placed(Fault::new(what).help("check the pattern in `file` for this table"))]);
            }
        }
        let mut faults = vec![];
        let mut fields: Vec<arrow_schema::FieldRef> = vec![];
        let (mut files, mut notes) = (vec![], Vec::from_iter(young.map(|what| format!("`{}`: {what}", decl.name))));
        notes.extend(note);
        let threads = threads_in_each(found.len());
        for path in found {
            // A second file that a mapping names may also be in an object store.
            if let Some(other) = mapped.as_ref().and_then(|m| m.companion(&path)) {
                buckets::fetch_companion(&other).map_err(|fault| vec![placed(fault)])?;
            }
            let opened = FlightFile::open(&path, files::hive(&path, &options), mapped.as_ref(), threads, trust);
            let opened = opened.map_err(|e| vec![Fault::from(e)]);
            match opened.and_then(|(file, r)| Ok((FlightConversion::new(&r.schema)?, r.notes, file))) {
                Ok((canonical, noted, file)) => {
                    notes.extend(noted);
                    merge(&mut fields, canonical.schema(), &path, &mut faults);
                    files.push(file);
                }
                Err(wrong) => faults.extend(
                    wrong.into_iter().map(|f| if shown(&f) { f } else { placed(f.in_file(&cache::shown(&path))) }),
                ),
            }
        }
        if !faults.is_empty() {
            return Err(faults.into_iter().map(|f| if shown(&f) { f } else { placed(f) }).collect());
        }
        let known = Flights::recorded(&decl.name, Arc::new(Schema::new(fields)));
        Ok(Flights { notes, read_all: trust.read_all, division: lines, files, ..known })
    }

    /// Creates a table with the recorded columns `schema`. It has no files to read, because its lines are also
    /// recorded.
    pub fn recorded(name: &str, schema: SchemaRef) -> Flights {
        let columns: Vec<Column> = schema.fields().iter().map(|f| describe_field(f)).collect();
        let shape = TableShape { columns: columns.into(), rate_hz: None };
        Flights { name: name.to_owned(), shape, schema, notes: vec![], read_all: false, division: None, files: vec![] }
    }

    /// The files of the table, and the input files of its simulations.
    ///
    /// # Errors
    /// Fails if the spec of a simulation cannot be read.
    pub fn inputs(&self) -> Result<Vec<PathBuf>, Fault> {
        let mut found = vec![];
        for file in &self.files {
            found.push(file.path.clone());
            let made_from = file.made_from.map(|say| say(&file.path)).transpose().map_err(Fault::from)?;
            found.extend(made_from.into_iter().flat_map(|m| m.files));
        }
        Ok(found)
    }

    /// Stores every missing line. `tick` is called from several threads: at the start of a file, after each of its
    /// lines, and at its end.
    ///
    /// # Errors
    /// Fails for a file that cannot be read. Faults of single lines are in their records.
    pub fn lines(&self, store: &Store, tick: &(dyn Fn(&ReadProgress) + Sync)) -> Result<FlightLines, Vec<Fault>> {
        ingest::lines(self, store, tick)
    }
}

/// Number of threads per file if `files` files are read in parallel.
fn threads_in_each(files: usize) -> usize {
    let threads = rayon::current_num_threads();
    // If there are at least as many files as threads, one thread reads each file. With several threads per file, a
    // thread that waits for the others would begin another file.
    if files >= threads { 1 } else { threads.div_ceil(files.max(1)) }
}

/// Adds the columns of one more file; a column must have one type in all of them.
fn merge(
    fields: &mut Vec<arrow_schema::FieldRef>,
    schema: &SchemaRef,
    path: &std::path::Path,
    faults: &mut Vec<Fault>,
) {
    for field in schema.fields() {
        match fields.iter().find(|f| f.name() == field.name()) {
            None => fields.push(field.clone()),
            Some(known) if known.data_type() == field.data_type() => {}
            Some(known) => {
                let what =
                    format!("contains {}, but {} in other files of the table", field.data_type(), known.data_type());
                faults.push(Fault::data(what).in_file(&path.display().to_string()).in_column(field.name()));
            }
        }
    }
}

/// Content of a table of files that has no flight lines.
enum MapSourceContent {
    /// A map.
    Map {
        options: MapOptions,
        /// Whether the map gives the error of each node.
        error: bool,
    },
    /// A model.
    Model(ModelTable),
}

/// A map of the spec, or a model that was fitted elsewhere.
pub struct MapSource {
    /// Name in the spec.
    pub name: String,
    /// File or folder.
    pub path: PathBuf,
    /// Whether the bytes of the file are read even if the file appears unchanged.
    pub read_all: bool,
    content: MapSourceContent,
}

impl MapSource {
    /// A map: checks the options and that the file exists.
    ///
    /// # Errors
    /// Fails for unknown options, or for a file that does not exist.
    pub fn open(decl: &SourceDecl, folder: &std::path::Path) -> Result<MapSource, Vec<Fault>> {
        let path = existing(decl, folder)?;
        let options = map_options(decl)?;
        let error = map_gives_error(&path, &options);
        Ok(MapSource::of_map(decl, path, options, error))
    }

    fn of_map(decl: &SourceDecl, path: PathBuf, options: MapOptions, error: bool) -> MapSource {
        MapSource { name: decl.name.clone(), path, read_all: false, content: MapSourceContent::Map { options, error } }
    }

    /// Creates a map with a known key, which has no file to read.
    ///
    /// # Errors
    /// Fails for unknown options.
    pub fn recorded(decl: &SourceDecl) -> Result<MapSource, Vec<Fault>> {
        // The plan was made with the file, so any stage that requires the error has been checked.
        Ok(MapSource::of_map(decl, PathBuf::new(), map_options(decl)?, true))
    }

    /// Opens a model: checks that the files hold one model.
    ///
    /// # Errors
    /// Fails for unknown options, for a file that does not exist, or for a file that is not the table of a fit or holds
    /// several models.
    pub fn open_model(decl: &SourceDecl, folder: &std::path::Path) -> Result<MapSource, Vec<Fault>> {
        let path = existing(decl, folder)?;
        let content = MapSourceContent::Model(ModelTable::open(decl, &path)?);
        Ok(MapSource { name: decl.name.clone(), path, read_all: false, content })
    }

    /// Creates a model with these columns and a known key, which has no file to read.
    ///
    /// # Errors
    /// Fails for unknown options.
    pub fn recorded_model(decl: &SourceDecl, schema: SchemaRef) -> Result<MapSource, Vec<Fault>> {
        let content = MapSourceContent::Model(ModelTable::recorded(decl, schema)?);
        Ok(MapSource { name: decl.name.clone(), path: PathBuf::new(), read_all: false, content })
    }

    /// Word for the content of the table: map or model.
    pub fn word(&self) -> &'static str {
        match self.content {
            MapSourceContent::Map { .. } => "map",
            MapSourceContent::Model(_) => "model",
        }
    }

    /// Whether it is a map that gives the error of each node.
    pub fn gives_error(&self) -> bool {
        matches!(self.content, MapSourceContent::Map { error: true, .. })
    }

    /// The table of a model as seen by stages; `None` for a map.
    pub fn model(&self) -> Option<Table> {
        match &self.content {
            MapSourceContent::Map { .. } => None,
            MapSourceContent::Model(model) => Some(model.table()),
        }
    }

    /// The columns of a model; `None` for a map.
    pub fn schema(&self) -> Option<&SchemaRef> {
        match &self.content {
            MapSourceContent::Map { .. } => None,
            MapSourceContent::Model(model) => Some(&model.schema),
        }
    }

    /// The names of the table's columns.
    pub fn columns(&self) -> Vec<String> {
        match self.model() {
            None => {
                let error = self.gives_error().then_some(schemas::map::ERROR);
                schemas::map::COLUMNS.iter().map(|(name, _)| *name).chain(error).map(str::to_owned).collect()
            }
            Some(model) => model.shape().columns.iter().map(|c| c.name.clone()).collect(),
        }
    }

    /// The key of the content, and the hashes of the files; the grid or the model itself is put into the store.
    ///
    /// # Errors
    /// Fails if it cannot be read.
    pub fn load(&self, store: &Store) -> Result<(HashKey, Vec<FileDigest>), Fault> {
        let files = match self.content {
            // The values of a map may be in a second file next to its header.
            MapSourceContent::Map { .. } => map_files(&self.path).map_err(Fault::from)?,
            MapSourceContent::Model(_) if self.path.is_dir() => {
                let mut files = vec![];
                let wrong = |e: std::io::Error| Fault::machine(format!("cannot read {}: {e}", self.path.display()));
                walk(&self.path, &mut files).map_err(wrong)?;
                files.retain(|file| file.extension().is_some_and(|e| e == "parquet"));
                files
            }
            MapSourceContent::Model(_) => vec![self.path.clone()],
        };
        let bytes: Vec<FileDigest> =
            files.iter().map(|file| fingerprint(store, file, self.read_all)).collect::<Result<_, _>>()?;
        let fixed = match &self.content {
            MapSourceContent::Map { options, .. } => {
                ["map", MAP_VERSION, datasets::VERSION, &spelt(options)].map(str::to_owned)
            }
            MapSourceContent::Model(model) => ["model", MODEL_VERSION, "", &model.condition].map(str::to_owned),
        };
        let key = HashKey::from_parts(fixed.into_iter().chain(bytes.iter().map(|b| b.hash.to_string())));
        if !store.has(key) {
            let rows = match &self.content {
                MapSourceContent::Map { options, .. } => {
                    read_grid(&self.path, options).and_then(|grid| grid.table()).map_err(Fault::from)?
                }
                MapSourceContent::Model(model) => model::read(&self.path, &model.condition)?,
            };
            store.put(key, &rows)?;
        }
        Ok((key, bytes))
    }
}

/// The file or folder of a table, which must exist.
fn existing(decl: &SourceDecl, folder: &std::path::Path) -> Result<PathBuf, Vec<Fault>> {
    let at = |fault: Fault| vec![fault.at(decl.path.1.clone())];
    let path = match place(&decl.path.0).map_err(at)? {
        StorageLocation::Path(path) => folder.join(path),
        StorageLocation::Object(address) => return buckets::whole(&address).map_err(at),
    };
    if path.exists() {
        return Ok(path);
    }
    Err(vec![Fault::new(format!("there is no file {}", path.display())).at(decl.path.1.clone())])
}

/// The whole map `key`, on its native grid.
///
/// # Errors
/// Fails if the store cannot be read.
pub fn map_batch(store: &Store, key: HashKey) -> Result<RecordBatch, Fault> {
    store.whole(key)
}

/// The whole map `key` that a stage made, on its native grid.
///
/// # Errors
/// Fails if the store cannot be read.
pub fn made_map_batch(store: &Store, key: HashKey) -> Result<RecordBatch, Fault> {
    let error = store.columns(key)?.field_with_name(schemas::map::ERROR).is_ok().then_some(schemas::map::ERROR);
    let columns: Vec<&str> = schemas::map::MADE_COLUMNS.into_iter().chain(error).collect();
    let rows = store.get(key, &columns)?;
    AnomalyGrid::of_made(&rows).and_then(|map| map.table()).map_err(Fault::from)
}

#[cfg(test)]
mod tests;
