//! Conversion of flight files to one object per line, with the hash of every column.

use std::{
    collections::{BTreeMap, VecDeque},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
};

use arrow_array::{Array, ArrayRef, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_schema::DataType;
use arrow_select::concat::concat_batches;
use datasets::RowFault;
use intake::{
    assemble::{LineAssembly, LineBatches, MISSING},
    checks::{self, QualityMeasure, measures, of_findings, table::COLUMNS},
    clock_digits, find_lines,
    in_order::in_order,
    line_table::{FlightDivision, LineDivider},
    midnight,
    quality::{FileColumns, Finding, LineExamination, examine},
};
use rayon::prelude::*;
use schemas::{
    DataLocation, Fault, FaultOwner,
    canonical::{FlightConversion, check_time},
    describe_field,
    keys::HashKey,
    paths,
    plausible::PlausibilityCheck,
};
use serde::{Deserialize, Serialize};
use store::{Store, note, published};

use super::{
    FileDigest, FlightLines, Flights, ReadProgress, VERSION, fingerprint, flight_file::FlightFile, packer::LinePacker,
    threads_in_each,
};

/// One line of a table of flights.
#[derive(Clone, Debug)]
pub struct LineRecord {
    /// The flight identifier.
    pub flight: String,
    /// The line identifier.
    pub line: String,
    /// The number of samples.
    pub rows: usize,
    /// The object that holds the line.
    pub object: HashKey,
    /// The hash of each column's values.
    pub columns: BTreeMap<String, HashKey>,
    /// The fault that makes the line unusable.
    pub fault: Option<Fault>,
    /// Further faults of an unusable line.
    pub more_faults: Vec<Fault>,
    /// The findings in the columns of the line.
    pub findings: Vec<Finding>,
    /// The file that contains the line.
    pub file: usize,
}

/// The contents of a file, as recorded in the store.
#[derive(Serialize, Deserialize)]
struct FileIndex {
    lines: Vec<IndexLine>,
}

#[derive(Serialize, Deserialize)]
struct IndexLine {
    flight: String,
    line: String,
    rows: usize,
    object: String,
    columns: BTreeMap<String, String>,
    fault: Option<Fault>,
    more_faults: Vec<Fault>,
    findings: Vec<Finding>,
}

impl IndexLine {
    /// Fault for all lines of the file: the time of day is written as digits, such as 123456. On a line shorter than a
    /// minute, this fault cannot be detected.
    fn clock_in_digits(&self) -> Option<Fault> {
        let mut faults = self.fault.iter().chain(&self.more_faults);
        let mut fault = faults.find(|f| f.what == clock_digits::WHAT)?.clone();
        fault.place.flight = Some(self.flight.clone());
        fault.place.line = Some(self.line.clone());
        Some(fault)
    }
}

/// `fault` as a data fault, without its file, flight and line, which are in the index.
fn unplaced(Fault { what, help, place, .. }: Fault) -> Fault {
    let place = DataLocation { column: place.column, row: place.row, ..DataLocation::default() };
    Fault { what, help, place, owner: FaultOwner::Data, ..Fault::default() }
}

/// The lines of all files, after ingest of the new files.
pub fn lines(flights: &Flights, store: &Store, tick: ReadCallback) -> Result<FlightLines, Vec<Fault>> {
    let done = AtomicUsize::new(0);
    let total = flights.files.len();
    let division = flights.division.as_ref();
    let how = IngestOptions { threads: threads_in_each(total), read_all: flights.read_all, division };
    let read: Vec<Result<(FileDigest, FileIndex, PathBuf), Fault>> = flights
        .files
        .par_iter()
        .map(|file| {
            let path = &file.path;
            let at = |done| ReadProgress::of_file(path, done, total);
            tick(&at(done.load(Ordering::Relaxed)));
            let lines = |simulated, lines, of_lines| {
                tick(&ReadProgress { simulated, lines, of_lines, ..at(done.load(Ordering::Relaxed)) });
            };
            let read = index(store, file, &how, &lines).map_err(|f| f.in_file(&path.display().to_string()));
            tick(&at(done.fetch_add(1, Ordering::Relaxed) + 1));
            read
        })
        .collect();
    let (mut files, mut lines, mut quality, mut faults) = (vec![], vec![], vec![], vec![]);
    for one in read {
        match one {
            Ok((bytes, index, figures)) => {
                quality.push(figures);
                lines.extend(index.lines.into_iter().filter_map(|l| record(l, files.len(), &bytes.path)));
                files.push(bytes);
            }
            Err(fault) => faults.push(fault),
        }
    }
    if !faults.is_empty() {
        return Err(faults);
    }
    // A mapping is an input too.
    for mapped in flights.files.first().into_iter().filter_map(|file| file.mapped.as_ref()) {
        files.push(FileDigest { path: mapped.mapping().label.clone().into(), hash: mapped.key() });
    }
    if let Some(table) = division.and_then(FlightDivision::table) {
        table.check(lines.iter().map(|l| (l.flight.as_str(), l.line.as_str()))).map_err(|fault| vec![fault])?;
        files.push(FileDigest { path: table.label.clone().into(), hash: table.key() });
    }
    lines.sort_by(|a, b| (&a.flight, &a.line, a.file).cmp(&(&b.flight, &b.line, b.file)));
    Ok(FlightLines { lines: once_each(lines, &files), files, quality })
}

/// Rejects duplicate lines: the parts of such a line cannot be put in order, so none of them is used.
fn once_each(lines: Vec<LineRecord>, files: &[FileDigest]) -> Vec<LineRecord> {
    let mut kept: Vec<LineRecord> = vec![];
    for line in lines {
        match kept.last_mut() {
            Some(last) if (&last.flight, &last.line) == (&line.flight, &line.line) => {
                let name =
                    |i: usize| files.get(i).map(|f: &FileDigest| f.path.display().to_string()).unwrap_or_default();
                if line.flight == MISSING || line.line == MISSING {
                    // If several files have rows without a line, one fault names all these files.
                    last.fault.get_or_insert_default().what += &format!("; more such rows are in {}", name(line.file));
                    continue;
                }
                let what = if last.file == line.file {
                    "the line's samples are not contiguous".to_owned()
                } else {
                    format!("the line is also in {}", name(line.file))
                };
                let fault = Fault::data(what).help("sort the file by flight, line and tt; each line must appear once");
                last.fault = Some(fault.in_line(&last.flight, &last.line).in_file(&name(last.file)));
            }
            _ => kept.push(line),
        }
    }
    kept
}

fn record(line: IndexLine, file: usize, path: &Path) -> Option<LineRecord> {
    let placed = |mut fault: Fault| {
        fault.place.file = Some(path.display().to_string());
        fault.place.flight = Some(line.flight.clone());
        fault.place.line = Some(line.line.clone());
        fault
    };
    let fault = line.fault.map(placed);
    let more_faults = line.more_faults.into_iter().map(placed).collect();
    let columns = line.columns.into_iter().filter_map(|(n, k)| Some((n, HashKey::parse(&k)?))).collect();
    Some(LineRecord {
        flight: line.flight,
        line: line.line,
        rows: line.rows,
        object: HashKey::parse(&line.object)?,
        columns,
        fault,
        more_faults,
        findings: line.findings,
        file,
    })
}

/// Callback for every step of reading.
type ReadCallback<'a> = &'a (dyn Fn(&ReadProgress) + Sync);
/// Callback for the progress of one file: whether its lines are simulated, the number of finished lines, and the total
/// number if known.
type LineCallback<'a> = &'a dyn Fn(bool, usize, Option<usize>);

/// The options for reading the files of a table.
struct IngestOptions<'a> {
    /// The number of lines of a file that are processed in parallel.
    threads: usize,
    /// Whether the bytes of each file are read even if they are cached.
    read_all: bool,
    /// Division of the flights into lines, which replaces the lines of the file.
    division: Option<&'a FlightDivision>,
}

/// The contents of the file, from the store if the file was read before, and the folder of its quality figures.
fn index(
    store: &Store,
    file: &FlightFile,
    how: &IngestOptions,
    tick: LineCallback,
) -> Result<(FileDigest, FileIndex, PathBuf), Fault> {
    let FlightFile { path, options, mapped, .. } = file;
    let bytes = fingerprint(store, path, how.read_all)?;
    let mut parts = vec![
        "flights".to_owned(),
        VERSION.to_owned(),
        checks::VERSION.to_owned(),
        datasets::VERSION.to_owned(),
        format!("{options:?}"),
        bytes.hash.to_string(),
    ];
    if let Some(mapped) = mapped {
        parts.push(mapped.key().to_string());
        if let Some(other) = mapped.companion(path) {
            parts.push(fingerprint(store, &other, how.read_all)?.hash.to_string());
        }
    }
    parts.extend(how.division.map(|division| division.key().to_string()));
    let made_from = file.made_from.map(|say| say(path)).transpose().map_err(Fault::from)?;
    for other in made_from.iter().flat_map(|m| &m.files) {
        parts.push(fingerprint(store, other, how.read_all)?.hash.to_string());
    }
    let (simulated, of_lines) = (made_from.is_some(), made_from.map(|m| m.lines));
    let key = HashKey::from_parts(parts.iter().map(String::as_bytes)).to_string();
    let note = store.root().join("sources").join(format!("{key}.json"));
    let quality = store.root().join("quality").join(key);
    let figures = quality.join("part-0.parquet");
    store.bring(&note)?;
    let known: Option<FileIndex> = paths::read_regular(&note).ok().and_then(|b| note::unsealed(&b));
    file.keep(store);
    let whole = |i: &FileIndex| {
        i.lines.iter().all(|l| l.fault.is_some() || HashKey::parse(&l.object).is_some_and(|k| store.has(k)))
    };
    let readable = || published(&quality, &COLUMNS).is_ok_and(|table| table.is_some());
    if let Some(index) = known.filter(|index| whole(index) && readable()) {
        return Ok((bytes, index, quality));
    }
    tick(simulated, 0, of_lines);
    let (index, table) = ingest(store, file, how, &|lines| tick(simulated, lines, of_lines))?;
    let unfinished = store.temporary();
    store.write_table(&unfinished, &table, &[])?;
    store.settle(&unfinished, &figures)?;
    store.write(&note, &note::sealed(&index)?)?;
    Ok((bytes, index, quality))
}

/// Divides the rows of a batch into the lines of a table of lines, if there is such a table.
pub(super) fn divided(
    divider: Option<&mut LineDivider>,
    batch: RecordBatch,
    faults: Vec<RowFault>,
) -> Result<(RecordBatch, Vec<RowFault>), Fault> {
    match divider {
        Some(divider) => divider.divide(&batch, &faults),
        None => Ok((batch, faults)),
    }
}

/// Reads a file once, with only the lines in progress in memory; twice if its lines are to be detected. Also returns
/// its quality figures.
fn ingest(
    store: &Store,
    file: &FlightFile,
    how: &IngestOptions,
    tick: &dyn Fn(usize),
) -> Result<(FileIndex, RecordBatch), Fault> {
    let found = match how.division {
        Some(FlightDivision::Found) => {
            Some(find_lines::table(file.read(how.threads).map_err(Fault::from)?, &file.path)?)
        }
        Some(FlightDivision::Table(_)) | None => None,
    };
    let table = found.as_ref().or(how.division.and_then(FlightDivision::table));
    let mut divider = table.map(|table| table.divider());
    let mut reader = file.read(how.threads).map_err(Fault::from)?;
    let canonical = FlightConversion::new(&reader.schema).map_err(|f| f.into_iter().next().unwrap_or_default())?;
    let origins = FileColumns::new(&reader.schema, &file.options.rename).of_mapping(file.mapped.is_some());
    let mut assembly = Some(LineAssembly::new(&file.options));
    let mut whole = VecDeque::new();
    let next = || loop {
        if let Some(line) = whole.pop_front() {
            return Some(Ok(line));
        }
        let assembled = assembly.as_mut()?;
        match reader.next_part().map(|part| part.map_err(Fault::from)) {
            Some(Ok(part)) => match canonical.apply_with_zeros(&part.batch) {
                Ok(batch) => match divided(divider.as_mut(), batch, part.faults) {
                    Ok((batch, faults)) => whole.extend(assembled.add(&batch, &faults)),
                    Err(fault) => return Some(Err(fault)),
                },
                Err(fault) => return Some(Err(fault)),
            },
            Some(Err(fault)) => return Some(Err(fault)),
            None => whole.extend(assembly.take()?.finish()),
        }
    };
    let packer = LinePacker::new(store);
    let put = |line: LineBatches| put(&packer, line, &origins, &file.options.accept);
    let lines = in_order(how.threads, next, put, tick)?;
    packer.finish()?;
    if let Some(fault) = lines.iter().find_map(|(line, _)| line.clock_in_digits()) {
        return Err(fault);
    }
    if let Some(table) = table.filter(|_| lines.is_empty()) {
        return Err(table.none_of(&file.path));
    }
    if lines.is_empty() {
        return Err(Fault::data("the file contains no samples"));
    }
    let rows: Vec<(&str, &str, &QualityMeasure)> =
        lines.iter().flat_map(|(l, all)| all.iter().map(move |m| (l.flight.as_str(), l.line.as_str(), m))).collect();
    let figures = checks::table::table(&rows)?;
    Ok((FileIndex { lines: lines.into_iter().map(|(line, _)| line).collect() }, figures))
}

/// Unwraps a line's time at midnight, checks the line, hashes its columns, and stores it. Also returns its quality
/// figures. Faults that the reader found in rows precede the other faults.
fn put(
    packer: &LinePacker,
    whole: LineBatches,
    origins: &FileColumns,
    accept: &[PlausibilityCheck],
) -> Result<(IndexLine, Vec<QualityMeasure>), Fault> {
    let LineBatches { flight, line, parts, rows, mut fault } = whole;
    let Some(schema) = parts.first().map(RecordBatch::schema) else {
        // These rows have no line; only their existence is recorded.
        let object = HashKey::from_parts(["no line", &flight, &line]).to_string();
        let fault = fault.map(unplaced);
        let (columns, more_faults, findings) = (BTreeMap::new(), vec![], vec![]);
        return Ok((IndexLine { flight, line, rows, object, columns, fault, more_faults, findings }, vec![]));
    };
    let mut batch = concat_batches(&schema, &parts).map_err(|e| Fault::data(e.to_string()))?;
    match midnight::unwrapped(&batch) {
        Ok(Some(unwrapped)) => batch = unwrapped,
        Ok(None) => {}
        Err(wrong) => fault = fault.or(Some(wrong)),
    }
    let LineExamination { batch, findings, faults } = examine(&batch, origins, accept)?;
    let mut columns = BTreeMap::new();
    for (field, array) in schema.fields().iter().zip(batch.columns()) {
        columns.insert(field.name().clone(), hash(array)?);
    }
    let described = schema.fields().iter().map(|f| describe_field(f));
    let spelt =
        described.flat_map(|c| [columns[&c.name].to_string(), c.unit, c.role.as_str().to_owned(), c.doc, c.name]);
    let object = HashKey::from_parts(["line".to_owned(), VERSION.to_owned()].into_iter().chain(spelt));
    let fault = fault.or_else(|| check_time(batch.column(2).as_primitive::<Float64Type>().values()).err());
    let mut faults = fault.into_iter().chain(faults).map(unplaced);
    let (fault, more_faults) = (faults.next(), faults.collect());
    let mut figures = of_findings(&findings, batch.column(2).as_primitive::<Float64Type>().values());
    figures.extend(measures(&batch));
    if fault.is_none() {
        packer.put(object, batch)?;
    }
    let columns = columns.into_iter().map(|(n, k)| (n, k.to_string())).collect();
    let object = object.to_string();
    Ok((IndexLine { flight, line, rows, object, columns, fault, more_faults, findings }, figures))
}

/// The hash of a column's type and values.
fn hash(array: &ArrayRef) -> Result<HashKey, Fault> {
    let mut hasher = blake3::Hasher::new();
    hasher.update(array.data_type().to_string().as_bytes()).update(&(array.len() as u64).to_le_bytes());
    match array.data_type() {
        DataType::Float64 if array.null_count() == 0 => {
            for x in array.as_primitive::<Float64Type>().values().iter() {
                hasher.update(&x.to_bits().to_le_bytes());
            }
        }
        DataType::Utf8 => {
            for text in array.as_string::<i32>() {
                let text = text.map(str::as_bytes);
                hasher.update(&text.map_or(u64::MAX, |t| t.len() as u64).to_le_bytes()).update(text.unwrap_or(&[]));
            }
        }
        _ => {
            let field = arrow_schema::Field::new("x", array.data_type().clone(), true);
            let schema = Arc::new(arrow_schema::Schema::new(vec![field]));
            let batch = RecordBatch::try_new(schema, vec![array.clone()]).map_err(|e| Fault::data(e.to_string()))?;
            let mut bytes = vec![];
            let encoded = parquet::arrow::ArrowWriter::try_new(&mut bytes, batch.schema(), None)
                .and_then(|mut w| w.write(&batch).and_then(|()| w.close()));
            encoded.map_err(|e| Fault::data(format!("cannot be stored: {e}")))?;
            hasher.update(&bytes);
        }
    }
    Ok(HashKey::finish(&hasher))
}
