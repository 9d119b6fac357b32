//! Rows of a published table, copied from the store into the order and the files of a set.
//!
//! Flight lines become one file per line, in folders by flight and line; other tables become one file. The keys in the
//! folder names are `flight_id` and `line_id`, and a word precedes each identifier. With a name such as `line=1003.10`,
//! readers of hive partitions would read the number 1003.1, and would reject the column `line` of the file, which has
//! another type.

use std::{cmp::Ordering, collections::BTreeMap, path::Path, sync::Arc};

use arrow_array::{
    Array, ArrayRef, RecordBatch, StringArray,
    cast::AsArray,
    new_null_array,
    types::{Float64Type, Int64Type},
};
use arrow_schema::{DataType, SchemaRef};
use plan::{PlanGraph, sources::map_batch};
use results::pooled;
use schemas::{Fault, Role, TableKind, casting::cast, field};
use store::{SealedFile, Store, Version};

use super::{
    checksums, parquet,
    set::{ColumnValueStatistics, DataFile, ReleaseTable},
};

/// Keys of the folders of a table of flight lines.
const PARTITIONS: [&str; 2] = ["flight_id", "line_id"];

/// Successive rows with the same key: a part of a row group.
struct RowGroupSlice {
    file: usize,
    group: usize,
    from: usize,
    rows: usize,
    /// Values of the axes.
    axes: Vec<SortKeyValue>,
    flight: Option<String>,
    line: Option<String>,
}

/// A value of a sort key, ordered within its type.
#[derive(Clone, Debug, PartialEq)]
enum SortKeyValue {
    Missing,
    Flag(bool),
    Whole(i64),
    Number(f64),
    Text(String),
}

impl SortKeyValue {
    fn from_array(array: &ArrayRef, row: usize) -> SortKeyValue {
        if array.is_null(row) {
            return SortKeyValue::Missing;
        }
        if let Some(texts) = array.as_string_opt::<i32>() {
            SortKeyValue::Text(texts.value(row).to_owned())
        } else if let Some(numbers) = array.as_primitive_opt::<Float64Type>() {
            SortKeyValue::Number(numbers.value(row))
        } else if let Some(numbers) = array.as_primitive_opt::<Int64Type>() {
            SortKeyValue::Whole(numbers.value(row))
        } else if let Some(flags) = array.as_boolean_opt() {
            SortKeyValue::Flag(flags.value(row))
        } else {
            SortKeyValue::Missing
        }
    }

    /// Whether this value equals the value in a row. The comparison copies no value.
    fn is(&self, array: &ArrayRef, row: usize) -> bool {
        match self {
            SortKeyValue::Text(text) => {
                array.is_valid(row) && array.as_string_opt::<i32>().is_some_and(|texts| texts.value(row) == text)
            }
            other => SortKeyValue::from_array(array, row) == *other,
        }
    }

    /// Missing values are last.
    fn order(&self, other: &SortKeyValue) -> Ordering {
        match (self, other) {
            (SortKeyValue::Flag(a), SortKeyValue::Flag(b)) => a.cmp(b),
            (SortKeyValue::Whole(a), SortKeyValue::Whole(b)) => a.cmp(b),
            (SortKeyValue::Number(a), SortKeyValue::Number(b)) => a.total_cmp(b),
            (SortKeyValue::Text(a), SortKeyValue::Text(b)) => a.cmp(b),
            (a, b) => (*a == SortKeyValue::Missing).cmp(&(*b == SortKeyValue::Missing)),
        }
    }
}

fn in_order(a: &[SortKeyValue], b: &[SortKeyValue]) -> Ordering {
    a.iter().zip(b).map(|(a, b)| a.order(b)).find(|o| o.is_ne()).unwrap_or(Ordering::Equal)
}

/// Reader of the rows of some files of the store.
struct StoreFileReader {
    files: Vec<SealedFile>,
    schema: SchemaRef,
    /// Last row group read.
    held: Option<(usize, usize, RecordBatch)>,
}

fn unreadable(sealed: &SealedFile, e: &dyn std::fmt::Display) -> Fault {
    Fault::machine(format!("cannot read {}: {e}", sealed.path().display()))
        .help("run the spec again to recompute damaged results")
}

impl StoreFileReader {
    fn open(version: &Version, table: &str) -> Result<StoreFileReader, Fault> {
        let listed = version.manifest.tables.iter().find(|t| t.name == table);
        let listed = listed.ok_or_else(|| Fault::machine(format!("the store has no table `{table}`")))?;
        version.at_hand(listed)?;
        let open = |path: &Path| {
            SealedFile::open(path).map_err(|e| Fault::machine(format!("cannot read {}: {e}", path.display())))
        };
        let files = listed.files.iter().map(|f| open(&version.folder.join(&f.name))).collect::<Result<Vec<_>, _>>()?;
        let schema = files.first().map(|f| f.schema().clone());
        let schema = schema.ok_or_else(|| Fault::machine(format!("the table `{table}` has no files")))?;
        Ok(StoreFileReader { files, schema, held: None })
    }

    /// Rows of each key, in the order of the store.
    fn pieces(&self, axes: &[String]) -> Result<Vec<RowGroupSlice>, Fault> {
        let mut pieces: Vec<RowGroupSlice> = vec![];
        for (at, file) in self.files.iter().enumerate() {
            let place = |name: &str| file.schema().index_of(name).ok();
            let keys: Vec<usize> = axes.iter().filter_map(|a| place(a)).collect();
            let names = [place("flight"), place("line")];
            for (group, span) in file.starts().windows(2).enumerate() {
                let [from, to] = span else { continue };
                let column = |i: usize| file.column(group, i).map_err(|e| unreadable(file, &e));
                let arrays = keys.iter().map(|i| column(*i)).collect::<Result<Vec<_>, _>>()?;
                let names = names.iter().map(|i| i.map(&column).transpose()).collect::<Result<Vec<_>, _>>()?;
                let text = |i: usize, row: usize| {
                    let array = names.get(i)?.as_ref()?.as_string_opt::<i32>()?;
                    array.is_valid(row).then(|| array.value(row))
                };
                for row in 0..to - from {
                    let same = |p: &RowGroupSlice| {
                        p.file == at
                            && p.group == group
                            && p.flight.as_deref() == text(0, row)
                            && p.line.as_deref() == text(1, row)
                            && arrays.iter().zip(&p.axes).all(|(array, cell)| cell.is(array, row))
                    };
                    match pieces.last_mut() {
                        Some(piece) if same(piece) => piece.rows += 1,
                        _ => pieces.push(RowGroupSlice {
                            file: at,
                            group,
                            from: row,
                            rows: 1,
                            axes: arrays.iter().map(|a| SortKeyValue::from_array(a, row)).collect(),
                            flight: text(0, row).map(str::to_owned),
                            line: text(1, row).map(str::to_owned),
                        }),
                    }
                }
            }
        }
        Ok(pieces)
    }

    fn rows(&mut self, piece: &RowGroupSlice) -> Result<RecordBatch, Fault> {
        let held = self.held.as_ref().filter(|(file, group, _)| (*file, *group) == (piece.file, piece.group));
        let batch = match held {
            Some((_, _, batch)) => batch.clone(),
            None => {
                let file = self.files.get(piece.file).ok_or_else(|| Fault::bug("a file is not open"))?;
                let columns = (0..file.schema().fields().len())
                    .map(|i| file.column(piece.group, i).map_err(|e| unreadable(file, &e)))
                    .collect::<Result<Vec<_>, _>>()?;
                let batch = RecordBatch::try_new(self.schema.clone(), columns).map_err(|e| unreadable(file, &e))?;
                self.held = Some((piece.file, piece.group, batch.clone()));
                batch
            }
        };
        Ok(batch.slice(piece.from, piece.rows))
    }
}

/// Folder name for an identifier: special bytes are written as `%` and two hexadecimal digits.
fn folder_name(identifier: &str) -> String {
    let plain = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'-' | b'_');
    identifier.bytes().map(|b| if plain(b) { char::from(b).to_string() } else { format!("%{b:02X}") }).collect()
}

/// File of a line.
fn line_path(table: &str, flight: &str, line: &str) -> String {
    let [flight_key, line_key] = PARTITIONS;
    let (flight, line) = (folder_name(flight), folder_name(line));
    format!("data/{table}/{flight_key}=flight-{flight}/{line_key}=line-{line}/part-0.parquet")
}

/// Writer of the files of a table, with statistics of their values.
struct TableFileWriter<'a> {
    root: &'a Path,
    schema: SchemaRef,
    sorted_by: Vec<String>,
    values: Vec<ColumnValueStatistics>,
    files: Vec<DataFile>,
}

impl<'a> TableFileWriter<'a> {
    fn new(root: &'a Path, schema: &SchemaRef, sorted_by: Vec<String>) -> TableFileWriter<'a> {
        let values = vec![ColumnValueStatistics::default(); schema.fields().len()];
        TableFileWriter { root, schema: schema.clone(), sorted_by, values, files: vec![] }
    }

    fn write(
        &mut self,
        path: String,
        key: Option<(&str, &str)>,
        batches: impl IntoIterator<Item = Result<RecordBatch, Fault>>,
    ) -> Result<(), Fault> {
        let full = self.root.join(&path);
        let mut writer = parquet::ReleaseFileWriter::new(&full, &self.schema, &self.sorted_by)?;
        for batch in batches {
            let batch = batch?;
            self.values.iter_mut().zip(batch.columns()).for_each(|(values, array)| parquet::count(values, array));
            writer.add(batch)?;
        }
        let rows = writer.finish()?;
        let sum = checksums::of_file(&full, |_| {});
        let (bytes, sha256) = sum.map_err(|e| Fault::machine(format!("cannot read {}: {e}", full.display())))?;
        let (flight, line) = key.map(|(f, l)| (f.to_owned(), l.to_owned())).unzip();
        self.files.push(DataFile { path, flight, line, rows, bytes, sha256 });
        Ok(())
    }

    fn table(self, name: &str, kind: &str, axes: &[String], by_line: bool) -> ReleaseTable {
        let mut columns = parquet::columns(&self.schema);
        columns.iter_mut().zip(&self.values).for_each(|(column, values)| column.values = *values);
        ReleaseTable {
            name: name.to_owned(),
            kind: kind.to_owned(),
            stage: None,
            description: String::new(),
            axes: axes.to_vec(),
            sorted_by: self.sorted_by,
            partitions: if by_line { PARTITIONS.map(str::to_owned).to_vec() } else { vec![] },
            rows: self.files.iter().map(|f| f.rows).sum(),
            columns,
            files: self.files,
        }
    }
}

/// Writes the table `t` of a plan below `root`, from its last run in `version`.
///
/// # Errors
/// Fails if the store is damaged, or the file system reports an error.
pub fn of_stage(graph: &PlanGraph, version: &Version, t: usize, root: &Path) -> Result<ReleaseTable, Fault> {
    let plan = graph.plan;
    let node = plan.tables.get(t).ok_or_else(|| Fault::bug("a table is not in the plan"))?;
    let axes = node.axes.iter().filter_map(|i| plan.spec.axes.get(*i)).map(|a| a.name.clone());
    let mut parts = StoreFileReader::open(version, &node.name)?;
    let axes: Vec<String> = axes.filter(|a| parts.schema.index_of(a).is_ok()).collect();
    let mut pieces = parts.pieces(&axes)?;
    let has = |name: &str| parts.schema.index_of(name).is_ok();
    let (kind, by_line) = match node.entry.yields {
        TableKind::Lines => ("flight lines", has("flight") && has("line")),
        TableKind::Scores => ("scores", false),
        TableKind::Model => ("model", false),
        TableKind::Map => ("map", false),
    };
    let mut sorted_by = axes.clone();
    if by_line {
        sorted_by.extend(has("tt").then(|| "tt".to_owned()));
    } else if node.entry.yields == TableKind::Scores {
        sorted_by.extend(["flight", "line"].into_iter().filter(|k| has(k)).map(str::to_owned));
    }
    let key = |p: &RowGroupSlice| (p.flight.clone(), p.line.clone());
    let schema = parts.schema.clone();
    let mut files = TableFileWriter::new(root, &schema, sorted_by);
    if by_line {
        let mut lines: BTreeMap<(Option<String>, Option<String>), Vec<RowGroupSlice>> = BTreeMap::new();
        pieces.into_iter().for_each(|p| lines.entry(key(&p)).or_default().push(p));
        for ((flight, line), mut pieces) in lines {
            // The sort is stable: rows with equal keys stay in the order of time.
            pieces.sort_by(|a, b| in_order(&a.axes, &b.axes));
            let (flight, line) = (flight.unwrap_or_default(), line.unwrap_or_default());
            let path = line_path(&node.name, &flight, &line);
            files.write(path, Some((&flight, &line)), pieces.iter().map(|p| parts.rows(p)))?;
        }
    } else {
        pieces.sort_by(|a, b| in_order(&a.axes, &b.axes).then_with(|| key(a).cmp(&key(b))));
        files.write(format!("data/{}/part-0.parquet", node.name), None, pieces.iter().map(|p| parts.rows(p)))?;
    }
    Ok(files.table(&node.name, kind, &axes, by_line))
}

/// Writes the pooled scores of a plan below `root`, from its last run in `version`.
///
/// # Errors
/// Fails if the store is damaged, or the file system reports an error.
pub fn of_pooled(graph: &PlanGraph, version: &Version, root: &Path) -> Result<ReleaseTable, Fault> {
    let mut parts = StoreFileReader::open(version, pooled::TABLE)?;
    let axes = graph.plan.spec.axes.iter().map(|a| a.name.clone());
    let axes: Vec<String> = axes.filter(|a| parts.schema.index_of(a).is_ok()).collect();
    let mut pieces = parts.pieces(&axes)?;
    pieces.sort_by(|a, b| in_order(&a.axes, &b.axes));
    let schema = parts.schema.clone();
    let mut files = TableFileWriter::new(root, &schema, axes.clone());
    files.write(format!("data/{}/part-0.parquet", pooled::TABLE), None, pieces.iter().map(|p| parts.rows(p)))?;
    let description = "Scores pooled over the lines of each point. In-sample lines are pooled separately.".to_owned();
    Ok(ReleaseTable { description, ..files.table(pooled::TABLE, "scores", &axes, false) })
}

/// Writes the table of flights `i` of a plan below `root`, as read from files.
///
/// # Errors
/// Fails if the store is damaged, or the file system reports an error.
pub fn of_flights(graph: &PlanGraph, store: &Store, i: usize, root: &Path) -> Result<ReleaseTable, Fault> {
    let flights = graph.plan.flights.get(i).ok_or_else(|| Fault::bug("a table is not in the plan"))?;
    let keys = [("flight", "flight identifier"), ("line", "line identifier")];
    let of_keys = keys.map(|(name, about)| Arc::new(field(name, DataType::Utf8, "", Role::Key, about)));
    let others = flights.schema.fields().iter().filter(|f| keys.iter().all(|(name, _)| f.name() != name)).cloned();
    let schema: SchemaRef = Arc::new(arrow_schema::Schema::new(of_keys.into_iter().chain(others).collect::<Vec<_>>()));
    let sorted_by = schema.index_of("tt").map(|_| "tt".to_owned()).into_iter().collect();
    let mut files = TableFileWriter::new(root, &schema, sorted_by);
    for record in graph.records.get(i).into_iter().flat_map(BTreeMap::values).filter(|r| r.fault.is_none()) {
        let whole = store.whole(record.object)?;
        let column = |f: &Arc<arrow_schema::Field>| -> Result<ArrayRef, Fault> {
            let name = match f.name().as_str() {
                "flight" => Some(&record.flight),
                "line" => Some(&record.line),
                _ => None,
            };
            match (name, whole.column_by_name(f.name())) {
                (Some(name), _) => Ok(Arc::new(StringArray::from(vec![name.as_str(); whole.num_rows()]))),
                (None, Some(array)) => cast(array, f.data_type()),
                (None, None) => Ok(new_null_array(f.data_type(), whole.num_rows())),
            }
        };
        let columns = schema.fields().iter().map(column).collect::<Result<Vec<_>, _>>()?;
        let batch = RecordBatch::try_new(schema.clone(), columns).map_err(|e| Fault::machine(e.to_string()));
        let path = line_path(&flights.name, &record.flight, &record.line);
        files.write(path, Some((&record.flight, &record.line)), [batch])?;
    }
    Ok(files.table(&flights.name, "flight lines", &[], true))
}

/// Writes the map `i` of a plan below `root`, as read from its file.
///
/// # Errors
/// Fails if the store is damaged, or the file system reports an error.
pub fn of_map(graph: &PlanGraph, store: &Store, i: usize, root: &Path) -> Result<ReleaseTable, Fault> {
    let (map, key) =
        graph.plan.maps.get(i).zip(graph.maps.get(i)).ok_or_else(|| Fault::bug("a map is not in the plan"))?;
    let batch = map_batch(store, *key)?;
    let mut files = TableFileWriter::new(root, &batch.schema(), vec![]);
    files.write(format!("data/{}/part-0.parquet", map.name), None, [Ok(batch)])?;
    Ok(files.table(&map.name, map.word(), &[], false))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_folder_names_round_trip_and_are_not_numeric() {
        assert_eq!(
            line_path("clean", "1003", "1003.10"),
            "data/clean/flight_id=flight-1003/line_id=line-1003.10/part-0.parquet"
        );
        assert_eq!(folder_name("a b/../c=\u{e9}%"), "a%20b%2F..%2Fc%3D%C3%A9%25");
    }

    #[test]
    fn law_sort_keys_have_a_total_order_with_missing_values_last() {
        let cells =
            [SortKeyValue::Number(-1.0), SortKeyValue::Number(0.5), SortKeyValue::Number(10.0), SortKeyValue::Missing];
        for (i, a) in cells.iter().enumerate() {
            for (j, b) in cells.iter().enumerate() {
                assert_eq!(a.order(b), i.cmp(&j), "{a:?} {b:?}");
            }
        }
        assert_eq!(SortKeyValue::Text("10".into()).order(&SortKeyValue::Text("9".into())), Ordering::Less);
    }
}
