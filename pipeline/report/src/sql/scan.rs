//! The published tables of a version for DataFusion. Every byte is verified by its checksum, a file is opened only when
//! a query names its table, and data that statistics exclude are not decoded.
//!
//! A query that needs only columns in the files of a table reads these files, row group by row group. A query that
//! needs columns that pass through reads the table unit by unit, each column from the unit that holds it.

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    path::Path,
    sync::Arc,
};

use arrow_array::{
    Array, ArrayRef, BooleanArray, RecordBatch, RecordBatchOptions, UInt64Array,
    cast::AsArray,
    new_null_array,
    types::{Int64Type, UInt64Type},
};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use async_trait::async_trait;
use datafusion::{
    catalog::{Session, TableProvider},
    common::{Column, DFSchema, ScalarValue, pruning::PruningStatistics},
    error::DataFusionError,
    execution::{SendableRecordBatchStream, TaskContext},
    logical_expr::{Expr, TableProviderFilterPushDown, TableType, utils::conjunction},
    physical_optimizer::pruning::PruningPredicateBuilder,
    physical_plan::{
        ExecutionPlan,
        stream::RecordBatchStreamAdapter,
        streaming::{PartitionStream, StreamingTableExec},
    },
};
use parquet::{arrow::arrow_reader::statistics::StatisticsConverter, file::metadata::RowGroupMetaData};
use results::logical::{PATTERNS, SCHEMA};
use schemas::{Fault, casting::cast, keys::HashKey};
use store::{ManifestTable, PackReader, SealedFile, Version};

/// Number of rows of a batch.
const BATCH_ROWS: usize = 8192;

fn damaged(path: &Path, e: &dyn std::fmt::Display) -> Fault {
    Fault::machine(format!("cannot read {}: {e}", path.display()))
        .help("run the spec again to recompute damaged results")
}

/// A published table.
#[derive(Debug)]
pub struct PublishedTableProvider {
    schema: SchemaRef,
    source: Arc<ScanSource>,
}

/// Files, row groups and units of a table.
struct ScanSource {
    objects: Arc<PackReader>,
    files: Vec<SealedFile>,
    /// The row groups, each with its file and its position in the file.
    groups: Vec<(usize, usize)>,
    /// The columns of the files.
    stored: SchemaRef,
    /// The columns of the logical table, if the logical table has more columns than the files.
    logical: Option<LogicalUnits>,
}

impl std::fmt::Debug for ScanSource {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{} files", self.files.len())
    }
}

/// The units of a logical table.
struct LogicalUnits {
    /// One row per unit.
    units: RecordBatch,
    /// Patterns: each is the number of steps upstream to the table that holds a column, for all columns.
    patterns: Vec<BTreeMap<String, usize>>,
}

impl PublishedTableProvider {
    /// The table `table` of `version`.
    ///
    /// # Errors
    /// Fails if a file of the table is damaged.
    pub fn open(
        objects: &Arc<PackReader>,
        version: &Version,
        table: &ManifestTable,
    ) -> Result<PublishedTableProvider, Fault> {
        let path = |name: &str| version.folder.join(name);
        let open = |name: &str| SealedFile::open(&path(name)).map_err(|e| damaged(&path(name), &e));
        let files = table.files.iter().map(|f| open(&f.name)).collect::<Result<Vec<_>, Fault>>()?;
        let stored = files.first().map_or_else(|| Arc::new(Schema::empty()), |f| f.schema().clone());
        let (mut schema, mut logical) = (stored.clone(), None);
        if let Some(units) = &table.units {
            let file = open(&units.name)?;
            (schema, logical) =
                LogicalUnits::read(&file).map(|(s, l)| (s, Some(l))).map_err(|e| damaged(&path(&units.name), &e))?;
        }
        let groups = files.iter().enumerate().flat_map(|(i, f)| (0..f.starts().len() - 1).map(move |g| (i, g)));
        let groups = groups.collect();
        let source = ScanSource { objects: objects.clone(), files, groups, stored, logical };
        Ok(PublishedTableProvider { schema, source: Arc::new(source) })
    }

    /// The units of a table with columns that pass through, one row per unit: `flight`, `line`, and `axis NAME` for
    /// each axis. `None` for a table whose files hold all its columns.
    pub(crate) fn units(&self) -> Option<&RecordBatch> {
        self.source.logical.as_ref().map(|l| &l.units)
    }

    /// Number of row groups of the files.
    pub(crate) fn groups(&self) -> usize {
        self.source.groups.len()
    }

    /// Number of rows of a row group.
    pub(crate) fn group_rows(&self, group: usize) -> usize {
        self.source.rows(ScanPiece::Group(group))
    }

    /// Columns of the logical table.
    pub(crate) fn columns(&self) -> &SchemaRef {
        &self.schema
    }

    /// Number of rows of a unit, 0 if the store no longer contains it.
    pub(crate) fn unit_rows(&self, unit: usize) -> usize {
        self.source.rows(ScanPiece::Unit(unit))
    }

    /// The columns `names` of a unit.
    ///
    /// # Errors
    /// Fails for an unknown column. Also fails if the store is damaged.
    pub(crate) fn read_unit(&self, unit: usize, names: &[&str]) -> Result<RecordBatch, Fault> {
        self.source.read(ScanPiece::Unit(unit), &self.projection(names)?)
    }

    /// The columns `names` of a row group.
    ///
    /// # Errors
    /// Fails for an unknown column. Also fails if a file is damaged.
    pub(crate) fn read_group(&self, group: usize, names: &[&str]) -> Result<RecordBatch, Fault> {
        self.source.read(ScanPiece::Group(group), &self.projection(names)?)
    }

    /// The columns that have a single value in each part of the table, with one row per part. A part is a unit or a row
    /// group, which queries read or skip as a whole.
    pub(crate) fn parts(&self) -> Result<RecordBatch, Fault> {
        let of_units = |logical: &LogicalUnits, field: &Field| {
            let values = logical.of_units(field.name())?.clone();
            let unit = |i: usize| logical.steps(i, field.name()).is_none() || values.is_valid(i);
            (0..values.len()).all(unit).then_some(values)
        };
        let statistics = RowGroupStatistics(&self.source);
        let found = |field: &Field| match &self.source.logical {
            Some(logical) => of_units(logical, field),
            None => statistics.single_values(field.name()),
        };
        let (mut fields, mut columns) = (vec![], vec![]);
        for field in self.schema.fields() {
            if let Some(values) = found(field) {
                columns.push(typed(values, field)?);
                fields.push(field.clone());
            }
        }
        let rows = self.source.logical.as_ref().map_or(self.source.groups.len(), |logical| logical.units.num_rows());
        let options = RecordBatchOptions::new().with_row_count(Some(rows));
        RecordBatch::try_new_with_options(Arc::new(Schema::new(fields)), columns, &options)
            .map_err(|e| Fault::machine(e.to_string()))
    }

    fn projection(&self, names: &[&str]) -> Result<SchemaRef, Fault> {
        let field = |name: &&str| {
            let known = || self.schema.fields().iter().map(|f| f.name().clone()).collect::<Vec<_>>();
            let found = self.schema.field_with_name(name);
            found.cloned().map_err(|_| Fault::new(format!("the table has no column `{name}`")).nearest(name, &known()))
        };
        Ok(Arc::new(Schema::new(names.iter().map(field).collect::<Result<Vec<Field>, Fault>>()?)))
    }
}

impl LogicalUnits {
    fn read(file: &SealedFile) -> Result<(SchemaRef, LogicalUnits), Box<dyn std::error::Error>> {
        let text = |key: &str| file.text(key).ok_or_else(|| format!("its metadata has no {key}"));
        let hex = text(SCHEMA)?;
        let byte = |i: usize| hex.get(2 * i..2 * i + 2).and_then(|h| u8::from_str_radix(h, 16).ok());
        let message: Option<Vec<u8>> = (0..hex.len() / 2).map(byte).collect();
        let message = message.ok_or("its schema is unreadable")?;
        let schema = arrow_ipc::root_as_schema(&message).map_err(|e| e.to_string())?;
        let schema = arrow_ipc::convert::fb_to_schema(schema);
        let patterns = serde_json::from_str(text(PATTERNS)?)?;
        let mut groups = vec![RecordBatch::new_empty(file.schema().clone())];
        for group in 0..file.starts().len() - 1 {
            let columns = (0..file.schema().fields().len()).map(|c| file.column(group, c).map_err(|e| e.to_string()));
            groups.push(RecordBatch::try_new(file.schema().clone(), columns.collect::<Result<_, _>>()?)?);
        }
        let units = arrow_select::concat::concat_batches(file.schema(), &groups)?;
        Ok((Arc::new(schema), LogicalUnits { units, patterns }))
    }

    fn key(&self, unit: usize, step: usize) -> Option<HashKey> {
        let keys = self.units.column_by_name(&format!("key {step}"))?.as_fixed_size_binary_opt()?;
        keys.is_valid(unit).then(|| keys.value(unit).try_into().ok().map(HashKey::from_bytes))?
    }

    fn steps(&self, unit: usize, column: &str) -> Option<usize> {
        let pattern = self.units.column_by_name("pattern")?.as_primitive_opt::<Int64Type>()?.value(unit);
        self.patterns.get(usize::try_from(pattern).ok()?)?.get(column).copied()
    }

    /// The values of a key for each unit: an axis or an identifier.
    fn of_units(&self, column: &str) -> Option<&ArrayRef> {
        let identifier = matches!(column, "flight" | "line").then(|| self.units.column_by_name(column)).flatten();
        self.units.column_by_name(&format!("axis {column}")).or(identifier)
    }
}

/// Part of a table that is read at once.
#[derive(Clone, Copy, Debug)]
enum ScanPiece {
    /// A row group, by its position among all row groups.
    Group(usize),
    /// A unit of the logical table.
    Unit(usize),
}

impl ScanSource {
    fn rows(&self, piece: ScanPiece) -> usize {
        match piece {
            ScanPiece::Group(i) => self.groups.get(i).map_or(0, |(file, group)| {
                let starts = self.files[*file].starts();
                starts[group + 1] - starts[*group]
            }),
            ScanPiece::Unit(i) => {
                let own = self.logical.as_ref().and_then(|l| l.key(i, 0));
                own.and_then(|key| self.objects.find(key)?.rows).unwrap_or(0)
            }
        }
    }

    /// The columns of `schema`, read from one piece.
    fn read(&self, piece: ScanPiece, schema: &SchemaRef) -> Result<RecordBatch, Fault> {
        let (columns, rows) = match piece {
            ScanPiece::Group(i) => (self.group(i, schema)?, self.rows(piece)),
            ScanPiece::Unit(i) => self.unit(i, schema)?,
        };
        let options = RecordBatchOptions::new().with_row_count(Some(rows));
        RecordBatch::try_new_with_options(schema.clone(), columns, &options).map_err(|e| Fault::machine(e.to_string()))
    }

    fn group(&self, i: usize, schema: &SchemaRef) -> Result<Vec<ArrayRef>, Fault> {
        let Some((file, group)) = self.groups.get(i) else { return Err(Fault::bug("a row group is missing")) };
        let file = &self.files[*file];
        let column = |field: &Arc<Field>| {
            let at = file.schema().index_of(field.name()).map_err(|e| damaged(file.path(), &e))?;
            let array = file.column(*group, at).map_err(|e| damaged(file.path(), &e))?;
            typed(array, field)
        };
        schema.fields().iter().map(column).collect()
    }

    fn unit(&self, i: usize, schema: &SchemaRef) -> Result<(Vec<ArrayRef>, usize), Fault> {
        let logical = self.logical.as_ref().ok_or_else(|| Fault::bug("a table without units"))?;
        let own = logical.key(i, 0).ok_or_else(|| Fault::bug("a unit has no key"))?;
        let rows = self.objects.find(own).and_then(|p| p.rows);
        let rows = rows.ok_or_else(|| {
            Fault::machine(format!("the store no longer contains {own}"))
                .help("run the spec again to recompute missing results")
        })?;
        let mut wanted: HashMap<HashKey, Vec<&str>> = HashMap::new();
        for field in schema.fields() {
            if let Some(key) = logical.steps(i, field.name()).and_then(|s| logical.key(i, s)) {
                wanted.entry(key).or_default().push(field.name());
            }
        }
        let mut found: HashMap<String, ArrayRef> = HashMap::new();
        for (key, names) in wanted {
            // A line may lack a column that other lines of the table have.
            let there = self.objects.columns(key)?;
            let names: Vec<&str> = names.into_iter().filter(|n| there.field_with_name(n).is_ok()).collect();
            let batch = self.objects.get(key, &names)?;
            for (name, array) in names.into_iter().zip(batch.columns()) {
                found.insert(name.to_owned(), array.clone());
            }
        }
        let column = |field: &Arc<Field>| match (found.get(field.name()), logical.of_units(field.name())) {
            (_, Some(values)) if logical.steps(i, field.name()).is_none() || values.is_valid(i) => {
                let value = ScalarValue::try_from_array(values, i).and_then(|v| v.to_array_of_size(rows));
                typed(value.map_err(|e| Fault::machine(e.to_string()))?, field)
            }
            (Some(array), _) if array.len() == rows => typed(array.clone(), field),
            (Some(_), _) => {
                Err(Fault::machine(format!("the rows of `{}` differ from the rows of the table", field.name())))
            }
            (None, _) => Ok(new_null_array(field.data_type(), rows)),
        };
        Ok((schema.fields().iter().map(column).collect::<Result<Vec<_>, Fault>>()?, rows))
    }
}

fn typed(array: ArrayRef, field: &Field) -> Result<ArrayRef, Fault> {
    cast(&array, field.data_type()).map_err(|fault| fault.in_column(field.name()))
}

/// Pruning statistics of the row groups, from their metadata.
struct RowGroupStatistics<'a>(&'a ScanSource);

impl RowGroupStatistics<'_> {
    fn all(&self) -> Vec<&RowGroupMetaData> {
        self.0.groups.iter().filter_map(|(file, group)| self.0.files.get(*file)?.row_groups().get(*group)).collect()
    }

    /// SQL orders NaN above all numbers, but statistics ignore NaN: only columns without NaN can exclude rows.
    fn converter<'b>(&'b self, column: &'b Column) -> Option<StatisticsConverter<'b>> {
        let field = self.0.stored.field_with_name(&column.name).ok()?;
        let role = field.metadata().get("role").map(String::as_str);
        if field.data_type() == &DataType::Float64 && !matches!(role, Some("key" | "time")) {
            return None;
        }
        StatisticsConverter::try_new(&column.name, &self.0.stored, self.0.files.first()?.parquet_schema()).ok()
    }

    /// The value of a column in each row group, if the column has a single value and no null in every row group.
    fn single_values(&self, name: &str) -> Option<ArrayRef> {
        let column = Column::from_name(name);
        let (least, most) = (self.min_values(&column)?, self.max_values(&column)?);
        let nulls = self.null_counts(&column)?;
        let nulls = nulls.as_primitive_opt::<UInt64Type>()?;
        let whole = nulls.null_count() == 0 && nulls.values().iter().all(|count| *count == 0);
        (whole && least.null_count() == 0 && least.to_data() == most.to_data()).then_some(least)
    }
}

impl PruningStatistics for RowGroupStatistics<'_> {
    fn min_values(&self, column: &Column) -> Option<ArrayRef> {
        self.converter(column)?.row_group_mins(self.all()).ok()
    }
    fn max_values(&self, column: &Column) -> Option<ArrayRef> {
        self.converter(column)?.row_group_maxes(self.all()).ok()
    }
    fn num_containers(&self) -> usize {
        self.0.groups.len()
    }
    fn null_counts(&self, column: &Column) -> Option<ArrayRef> {
        self.converter(column)?.row_group_null_counts(self.all()).ok().map(|c| Arc::new(c) as ArrayRef)
    }
    fn row_counts(&self) -> Option<ArrayRef> {
        let rows = |g: &&RowGroupMetaData| u64::try_from(g.num_rows()).unwrap_or(0);
        Some(Arc::new(self.all().iter().map(rows).collect::<UInt64Array>()))
    }
    fn contained(&self, _: &Column, _: &HashSet<ScalarValue>) -> Option<BooleanArray> {
        None
    }
}

/// Pruning statistics of the units, from their keys.
struct UnitStatistics<'a>(&'a LogicalUnits);

impl PruningStatistics for UnitStatistics<'_> {
    fn min_values(&self, column: &Column) -> Option<ArrayRef> {
        self.0.of_units(&column.name).cloned()
    }
    fn max_values(&self, column: &Column) -> Option<ArrayRef> {
        self.0.of_units(&column.name).cloned()
    }
    fn num_containers(&self) -> usize {
        self.0.units.num_rows()
    }
    fn null_counts(&self, _: &Column) -> Option<ArrayRef> {
        None
    }
    fn row_counts(&self) -> Option<ArrayRef> {
        None
    }
    fn contained(&self, _: &Column, _: &HashSet<ScalarValue>) -> Option<BooleanArray> {
        None
    }
}

#[async_trait]
impl TableProvider for PublishedTableProvider {
    fn schema(&self) -> SchemaRef {
        self.schema.clone()
    }

    fn table_type(&self) -> TableType {
        TableType::Base
    }

    fn supports_filters_pushdown(
        &self,
        filters: &[&Expr],
    ) -> Result<Vec<TableProviderFilterPushDown>, DataFusionError> {
        Ok(vec![TableProviderFilterPushDown::Inexact; filters.len()])
    }

    async fn scan(
        &self,
        state: &dyn Session,
        projection: Option<&Vec<usize>>,
        filters: &[Expr],
        limit: Option<usize>,
    ) -> Result<Arc<dyn ExecutionPlan>, DataFusionError> {
        let schema = match projection {
            Some(columns) => Arc::new(self.schema.project(columns)?),
            None => self.schema.clone(),
        };
        let held = |name: &str| self.source.stored.field_with_name(name).is_ok();
        let units = self.source.logical.as_ref().filter(|_| !schema.fields().iter().all(|f| held(f.name())));
        let count = units.map_or(self.source.groups.len(), |l| l.units.num_rows());
        let mut kept = vec![true; count];
        if let Some(filter) = conjunction(filters.iter().cloned()) {
            let known = DFSchema::try_from(self.schema.clone())?;
            // Filters that statistics cannot decide are evaluated row by row, above this scan.
            if let Ok(predicate) = state
                .create_physical_expr(filter, &known)
                .and_then(|expr| PruningPredicateBuilder::new().with_file_schema(self.schema.clone()).try_build(expr))
            {
                let found = match units {
                    Some(logical) => predicate.prune(&UnitStatistics(logical)),
                    None => predicate.prune(&RowGroupStatistics(&self.source)),
                };
                kept = found.unwrap_or(kept);
            }
        }
        let piece = |i| if units.is_some() { ScanPiece::Unit(i) } else { ScanPiece::Group(i) };
        let mut pieces: Vec<ScanPiece> = (0..count).filter(|i| kept[*i]).map(piece).collect();
        if let Some(limit) = limit.filter(|_| filters.is_empty()) {
            let mut rows = 0;
            pieces.retain(|p| {
                let wanted = rows < limit;
                rows += if wanted { self.source.rows(*p) } else { 0 };
                wanted
            });
        }
        let partitions = state.config().target_partitions().clamp(1, pieces.len().max(1));
        let share = pieces.len().div_ceil(partitions).max(1);
        let part = |pieces: &[ScanPiece]| -> Arc<dyn PartitionStream> {
            Arc::new(ScanPartition { source: self.source.clone(), pieces: pieces.to_vec(), schema: schema.clone() })
        };
        let mut parts: Vec<Arc<dyn PartitionStream>> = pieces.chunks(share).map(part).collect();
        if parts.is_empty() {
            parts.push(part(&[]));
        }
        Ok(Arc::new(StreamingTableExec::try_new(schema.clone(), parts, None, vec![], false, None)?))
    }
}

/// Pieces of a table that one stream reads in sequence.
#[derive(Debug)]
struct ScanPartition {
    source: Arc<ScanSource>,
    pieces: Vec<ScanPiece>,
    schema: SchemaRef,
}

impl PartitionStream for ScanPartition {
    fn schema(&self) -> &SchemaRef {
        &self.schema
    }

    fn execute(&self, _: Arc<TaskContext>) -> SendableRecordBatchStream {
        let (source, schema) = (self.source.clone(), self.schema.clone());
        let pieces = self.pieces.clone().into_iter().flat_map(move |piece| match source.read(piece, &schema) {
            Ok(batch) => {
                let starts = (0..batch.num_rows()).step_by(BATCH_ROWS);
                let cut = |from| Ok(batch.slice(from, BATCH_ROWS.min(batch.num_rows() - from)));
                starts.map(cut).collect::<Vec<_>>()
            }
            Err(fault) => vec![Err(DataFusionError::External(Box::new(ScanFault(fault))))],
        });
        Box::pin(RecordBatchStreamAdapter::new(self.schema.clone(), futures::stream::iter(pieces)))
    }
}

/// Fault of the store as an error of DataFusion.
#[derive(Debug)]
pub struct ScanFault(pub Fault);

impl std::fmt::Display for ScanFault {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

impl std::error::Error for ScanFault {}
