//! Export of a log as flight Parquet: its lines in the columns of the flight table, and their quality figures. Each row
//! group ends with a line.
//!
//! A file gets its final name when it is complete and on the disk. Its metadata hold the key of its inputs, so a file
//! of other data is recognised and not replaced.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io,
    path::{Path, PathBuf},
};

use arrow_array::{RecordBatch, cast::AsArray, types::Float64Type};
use arrow_schema::{DataType, Field, SchemaRef};
use arrow_select::concat::concat_batches;
use datasets::{FlightOptions, ReadHints, formats::FlightInputLister, row_groups::ends_with_line};
use intake::{
    assemble::{LineAssembly, LineBatches},
    checks::{self, QualityMeasure, measures, of_findings},
    clock_digits,
    formats::open_log,
    line_table::LineTable,
    mapping::{MappingTable, is_shown},
    midnight,
    quality::{FileColumns, examine},
};
use parquet::{
    arrow::ArrowWriter,
    basic::{Compression, ZstdLevel},
    file::{
        metadata::KeyValue,
        properties::WriterProperties,
        reader::{FileReader, SerializedFileReader},
    },
};
use schemas::{
    Fault,
    canonical::{FlightConversion, check_time},
    keys::HashKey,
};
use store::{make_folder, sync_folder};

use super::{bytes::hash_file, ingest::divided};

/// Version of the export, increased when the written files change.
const VERSION: &str = "export 2";
/// Metadata key for the key of a file's inputs.
const FROM: &str = "magline.from";

/// Export of one log: its input, options and output file.
pub struct LogExport<'a> {
    /// The log.
    pub input: &'a Path,
    /// Options for reading it.
    pub options: FlightOptions,
    /// Mapping of its columns.
    pub mapped: Option<MappingTable>,
    /// Division into lines, if it differs from the lines of the log.
    pub lines: Option<&'a LineTable>,
    /// The folder of the table.
    pub folder: PathBuf,
    /// The name of the file in the output folder, without extension.
    pub name: String,
    /// Whether each flight has a separate folder `flight=...`, which replaces the column.
    pub hive: bool,
    /// Whether files of other data are replaced.
    pub replace: bool,
    /// A folder of this process for unfinished files, on the same file system.
    pub unfinished: &'a Path,
    /// Number that is unique among the exports of this process.
    pub number: usize,
}

/// One exported line, with its faults and quality measures.
#[derive(Debug)]
pub struct ExportLine {
    /// The flight.
    pub flight: String,
    /// The line.
    pub line: String,
    /// Samples.
    pub rows: usize,
    /// First and last time, in seconds.
    pub tt: (f64, f64),
    /// The year and the day of the year of the line's first sample, if known.
    pub date: Option<(i64, i64)>,
    /// Faults that make the line unusable; an unusable line is not written.
    pub faults: Vec<Fault>,
    /// Quality figures of the line's columns.
    pub measures: Vec<QualityMeasure>,
}

/// Outcome of the export of a log.
#[derive(Debug)]
pub struct ExportOutcome {
    /// The format of the log.
    pub format: &'static str,
    /// The files with the lines of the log.
    pub files: Vec<PathBuf>,
    /// Whether the files already existed with the same data.
    pub unchanged: bool,
    /// File with the quality figures; `None` if no line is usable.
    pub quality: Option<PathBuf>,
    /// Lines, in the file's order.
    pub lines: Vec<ExportLine>,
    /// Notes for the user.
    pub notes: Vec<String>,
    /// The names and units of the columns.
    pub columns: Vec<(String, String)>,
}

/// A Parquet file being written.
struct ExportFile {
    writer: ArrowWriter<File>,
    path: PathBuf,
    target: PathBuf,
}

impl LogExport<'_> {
    /// Reads the log and writes the files.
    ///
    /// # Errors
    /// Fails for a log that cannot be read, a mapping that does not fit, existing files of other data, or errors of the
    /// file system. Faults of single lines are in [`ExportLine::faults`].
    pub fn run(&self) -> Result<ExportOutcome, Fault> {
        let place = |f: Fault| if is_shown(&f) { f } else { f.in_file(&self.input.display().to_string()) };
        self.read().map_err(place)
    }

    fn read(&self) -> Result<ExportOutcome, Fault> {
        let reading = ReadHints { found: None, threads: 1 };
        let mut log = open_log(self.input, &self.options, self.mapped.as_ref(), &reading).map_err(Fault::from)?;
        let from = self.key(log.made_from)?;
        let canonical = FlightConversion::new(&log.schema).map_err(|f| f.into_iter().next().unwrap_or_default())?;
        let origins = FileColumns::new(&log.schema, &self.options.rename).of_mapping(self.mapped.is_some());
        let mut assembly = LineAssembly::new(&self.options);
        let mut open: BTreeMap<String, ExportFile> = BTreeMap::new();
        let mut lines = vec![];
        let mut take = |whole: LineBatches| -> Result<(), Fault> {
            let (line, batch) = self.line(whole, &origins)?;
            if let Some(clock) = line.faults.iter().find(|f| f.what == clock_digits::WHAT) {
                return Err(clock.clone());
            }
            if let Some(batch) = batch.filter(|_| line.faults.is_empty()) {
                self.write(&line.flight, &batch, from, &mut open)?;
            }
            lines.push(line);
            Ok(())
        };
        let mut divider = self.lines.map(LineTable::divider);
        while let Some(part) = log.next_part() {
            let part = part.map_err(Fault::from)?;
            let batch = canonical.apply_with_zeros(&part.batch)?;
            let (batch, wrong) = divided(divider.as_mut(), batch, part.faults)?;
            for whole in assembly.add(&batch, &wrong) {
                take(whole)?;
            }
        }
        for whole in assembly.finish() {
            take(whole)?;
        }
        if let Some(table) = self.lines.filter(|_| lines.is_empty()) {
            return Err(table.none_of(self.input));
        }
        if lines.is_empty() {
            let Some(mapped) = &self.mapped else { return Err(Fault::data("the file contains no samples")) };
            let name = self.input.file_name().unwrap_or_default().to_string_lossy().into_owned();
            log.notes
                .push(format!("{name}: no row belongs to the table `{}`, so nothing is written for it", mapped.name()));
        }
        once_each(&lines)?;
        let described = canonical.schema().fields().iter();
        let unit = |f: &Field| f.metadata().get("unit").cloned().unwrap_or_default();
        let columns = described.map(|f| (f.name().clone(), unit(f))).collect();
        let (files, unchanged) = self.publish(open, from)?;
        let quality = if files.is_empty() { None } else { Some(self.quality(&lines, from)?) };
        Ok(ExportOutcome { format: log.format, files, unchanged, quality, lines, notes: log.notes, columns })
    }

    /// Key of the inputs of the files.
    fn key(&self, made_from: Option<FlightInputLister>) -> Result<HashKey, Fault> {
        let failed = |path: &Path, e: &io::Error| match e.kind() {
            io::ErrorKind::NotFound => Fault::new(format!("there is no file {}", path.display())),
            _ => Fault::machine(format!("cannot read {}: {e}", path.display())),
        };
        let bytes = |path: &Path| {
            // Data in some formats are a folder, which the reader of the format handles.
            if path.is_dir() {
                return Ok("folder".to_owned());
            }
            hash_file(path).map(|key| key.to_string()).map_err(|e| failed(path, &e))
        };
        let mut parts = vec![
            VERSION.to_owned(),
            datasets::VERSION.to_owned(),
            format!("{:?}", self.options),
            self.hive.to_string(),
            bytes(self.input)?,
        ];
        parts.extend(self.lines.map(|table| table.key().to_string()));
        let made_from = made_from.map(|say| say(self.input)).transpose().map_err(Fault::from)?;
        for other in made_from.iter().flat_map(|m| &m.files) {
            parts.push(bytes(other)?);
        }
        if let Some(mapped) = &self.mapped {
            parts.push(mapped.key().to_string());
            // A missing file is reported later, when the log is read.
            if let Some(other) = mapped.companion(self.input).filter(|p| p.exists()) {
                parts.push(bytes(&other)?);
            }
        }
        Ok(HashKey::from_parts(parts))
    }

    /// A line with its faults, its quality figures and its rows.
    fn line(&self, whole: LineBatches, origins: &FileColumns) -> Result<(ExportLine, Option<RecordBatch>), Fault> {
        let LineBatches { flight, line, parts, rows, fault } = whole;
        let file = self.input.display().to_string();
        let placed = |f: Fault| f.in_line(&flight, &line).in_file(&file);
        let mut faults: Vec<Fault> = fault.into_iter().collect();
        let Some(schema) = parts.first().map(RecordBatch::schema) else {
            let faults = faults.into_iter().map(placed).collect();
            return Ok((
                ExportLine { flight, line, rows, tt: (f64::NAN, f64::NAN), date: None, faults, measures: vec![] },
                None,
            ));
        };
        let mut batch = concat_batches(&schema, &parts).map_err(|e| Fault::data(e.to_string()))?;
        match midnight::unwrapped(&batch) {
            Ok(Some(unwrapped)) => batch = unwrapped,
            Ok(None) => {}
            Err(wrong) => faults.push(wrong),
        }
        let examined = examine(&batch, origins, &self.options.accept)?;
        let tt = batch.column(2).as_primitive::<Float64Type>().values();
        faults.extend(check_time(tt).err());
        faults.extend(examined.faults);
        let mut all = of_findings(&examined.findings, tt);
        all.extend(measures(&examined.batch));
        let faults = faults.into_iter().map(placed).collect();
        let ends = (tt.first().copied().unwrap_or(f64::NAN), tt.last().copied().unwrap_or(f64::NAN));
        let date = date_of(&batch);
        Ok((ExportLine { flight, line, rows, tt: ends, date, faults, measures: all }, Some(batch)))
    }

    /// The file of a flight.
    fn target(&self, flight: &str) -> Result<PathBuf, Fault> {
        let name = format!("{}.parquet", self.name);
        if !self.hive {
            return Ok(self.folder.join(name));
        }
        let plain = |c: char| c.is_alphanumeric() || "._-".contains(c);
        if flight.is_empty() || !flight.chars().all(plain) {
            let fault = Fault::data(format!("the flight `{}` cannot be the name of a folder", flight.escape_default()));
            return Err(fault.help("remove `--hive`, or rename the flight with `--flight`"));
        }
        Ok(self.folder.join(format!("flight={flight}")).join(name))
    }

    /// Writes a line into the file of its flight: as a row group, or as a part of a row group of several short lines.
    fn write(
        &self,
        flight: &str,
        batch: &RecordBatch,
        from: HashKey,
        open: &mut BTreeMap<String, ExportFile>,
    ) -> Result<(), Fault> {
        let own = if self.hive { flight } else { "" };
        // In a folder `flight=...` the name of the folder replaces the column.
        let columns: Vec<usize> = (usize::from(self.hive)..batch.num_columns()).collect();
        let batch = batch.project(&columns).map_err(|e| Fault::data(e.to_string()))?;
        if !open.contains_key(own) {
            let path = self.unfinished.join(format!("{}-{}.parquet", self.number, open.len()));
            let file = File::create(&path).map_err(|e| cannot_write(&path, &e))?;
            let writer = ArrowWriter::try_new(file, batch.schema(), Some(properties(&batch.schema(), from)));
            let writer = writer.map_err(|e| cannot_write(&path, &e))?;
            open.insert(own.to_owned(), ExportFile { writer, path, target: self.target(flight)? });
        }
        let Some(file) = open.get_mut(own) else { return Err(Fault::bug("a file is not open")) };
        let failed = |e: parquet::errors::ParquetError| cannot_write(&file.target, &e);
        file.writer.write(&batch).map_err(failed)?;
        if ends_with_line(file.writer.in_progress_rows(), file.writer.flushed_row_groups().len()) {
            file.writer.flush().map_err(failed)?;
        }
        Ok(())
    }

    /// Renames the complete files to their final names. Also returns whether all files already existed.
    fn publish(&self, open: BTreeMap<String, ExportFile>, from: HashKey) -> Result<(Vec<PathBuf>, bool), Fault> {
        let (mut files, mut unchanged) = (vec![], !open.is_empty());
        let mut whole = vec![];
        for ExportFile { writer, path, target } in open.into_values() {
            let file = writer.into_inner().map_err(|e| cannot_write(&target, &e))?;
            file.sync_all().map_err(|e| cannot_write(&target, &e))?;
            whole.push((path, target));
        }
        for (path, target) in whole {
            unchanged &= settle(&path, &target, self.replace, from)?;
            files.push(target);
        }
        Ok((files, unchanged))
    }

    /// Writes the quality figures next to the data files.
    fn quality(&self, lines: &[ExportLine], from: HashKey) -> Result<PathBuf, Fault> {
        let rows: Vec<(&str, &str, &QualityMeasure)> = lines
            .iter()
            .flat_map(|l| l.measures.iter().map(move |m| (l.flight.as_str(), l.line.as_str(), m)))
            .collect();
        let batch = checks::table::table(&rows)?;
        // Folders with this prefix are not read as flights.
        let target = self.folder.join("_quality").join(format!("{}.parquet", self.name));
        let path = self.unfinished.join(format!("{}-quality.parquet", self.number));
        let written = File::create(&path).map_err(|e| cannot_write(&target, &e)).and_then(|file| {
            let failed = |e: parquet::errors::ParquetError| cannot_write(&target, &e);
            let properties = properties(&batch.schema(), from);
            let mut writer = ArrowWriter::try_new(file, batch.schema(), Some(properties)).map_err(failed)?;
            writer.write(&batch).map_err(failed)?;
            writer.into_inner().map_err(failed)?.sync_all().map_err(|e| cannot_write(&target, &e))
        });
        written?;
        // The quality figures are computed from the data files under their final names.
        settle(&path, &target, true, from)?;
        Ok(target)
    }
}

fn cannot_write(path: &Path, e: &dyn std::fmt::Display) -> Fault {
    Fault::machine(format!("cannot write {}: {e}", path.display()))
}

/// Gives a complete file its final name. Returns `true` if a file with the same data existed.
fn settle(path: &Path, target: &Path, replace: bool, from: HashKey) -> Result<bool, Fault> {
    let failed = |e: io::Error| cannot_write(target, &e);
    let folder = target.parent().unwrap_or(Path::new("."));
    make_folder(folder).map_err(failed)?;
    if replace {
        fs::rename(path, target).map_err(failed)?;
        sync_folder(folder).map_err(failed)?;
        return Ok(false);
    }
    // A link, unlike a rename, does not replace a file that another process has made meanwhile.
    match fs::hard_link(path, target) {
        Ok(()) => {}
        Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {
            if made_from(target) != Some(from) {
                let fault = Fault::new(format!("{} already contains other data", target.display()));
                return Err(fault.help("give another folder with `--to`, or add `--replace`"));
            }
            return Ok(true);
        }
        // Fallback for a file system without links.
        Err(_) if !target.exists() => fs::rename(path, target).map_err(failed)?,
        Err(e) => return Err(failed(e)),
    }
    sync_folder(folder).map_err(failed)?;
    Ok(false)
}

/// Key of the inputs of a file, as recorded in the file.
fn made_from(path: &Path) -> Option<HashKey> {
    let reader = SerializedFileReader::new(File::open(path).ok()?).ok()?;
    let pairs = reader.metadata().file_metadata().key_value_metadata()?.clone();
    HashKey::parse(pairs.iter().find(|kv| kv.key == FROM)?.value.as_deref()?)
}

fn properties(schema: &SchemaRef, from: HashKey) -> WriterProperties {
    let builder = WriterProperties::builder()
        .set_created_by("magline".to_owned())
        .set_compression(Compression::ZSTD(ZstdLevel::default()))
        .set_key_value_metadata(Some(vec![KeyValue::new(FROM.to_owned(), from.to_string())]))
        // Row groups end where lines do.
        .set_max_row_group_row_count(None);
    let numbers = schema.fields().iter().filter(|f| f.data_type() == &DataType::Float64);
    numbers.fold(builder, |b, f| b.set_column_dictionary_enabled(f.name().as_str().into(), false)).build()
}

/// Rejects duplicate lines of a file, which cannot be put in order.
fn once_each(lines: &[ExportLine]) -> Result<(), Fault> {
    let mut seen: BTreeMap<(String, String), usize> = BTreeMap::new();
    for (i, line) in lines.iter().enumerate() {
        if seen.insert((line.flight.clone(), line.line.clone()), i).is_some() {
            let fault = Fault::data("the line's samples are not contiguous").in_line(&line.flight, &line.line);
            return Err(fault.help("sort the file by flight, line and tt; each line must appear once"));
        }
    }
    Ok(())
}

fn date_of(batch: &RecordBatch) -> Option<(i64, i64)> {
    let first = |name: &str| {
        let column = batch.column_by_name(name)?;
        let column = arrow_cast::cast(column, &DataType::Int64).ok()?;
        column.as_primitive::<arrow_array::types::Int64Type>().iter().next().flatten()
    };
    Some((first("year")?, first("doy")?))
}
