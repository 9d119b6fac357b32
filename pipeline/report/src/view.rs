//! Answers of `magline view`: the tables of a store, series of lines, scores, maps and the progress of a run.
//!
//! Nothing is written. Tables are opened when they are first needed, and again after a run publishes a new version.

mod against;
mod catalogue;
mod coast;
mod lines;
mod map;
mod models;
mod notes;
mod progress;
mod scores;
mod spectra;
mod table;

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use arrow_schema::DataType;
use schemas::{Fault, metric::Metric};
use serde_json::Value;
use store::{PackReader, Version, current};

pub use crate::coast::GeographicRegion;
use crate::sql::{PublishedTableProvider, leads_out, pipeline_names};
pub use against::report_against;
pub use lines::SeriesRequest;
pub use map::MapBand;
use notes::{NotedTable, PipelineNotes};
pub use progress::RunProgress;
use scores::HeldBlocks;
use table::ViewTable;

/// Interval of checks for a new version of a pipeline.
const LOOK_AGAIN: Duration = Duration::from_secs(1);
/// Size of the cache of columns, in bytes.
const HELD_BYTES: usize = 128 << 20;

/// Sweep point: the name and the value of each axis, as text.
pub type ViewPoint = Vec<(String, String)>;

/// Reason why a request has no answer.
#[derive(Debug)]
pub enum ViewFault {
    /// The table, line, column or point does not exist.
    Missing(Fault),
    /// The request is wrong.
    Wrong(Fault),
    /// The store is damaged, or the machine failed.
    Failed(Fault),
}

impl ViewFault {
    /// The fault.
    pub fn fault(&self) -> &Fault {
        match self {
            ViewFault::Missing(fault) | ViewFault::Wrong(fault) | ViewFault::Failed(fault) => fault,
        }
    }
}

impl std::fmt::Display for ViewFault {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        self.fault().fmt(f)
    }
}

impl From<Fault> for ViewFault {
    fn from(fault: Fault) -> ViewFault {
        if fault.owner.is_lasting() { ViewFault::Wrong(fault) } else { ViewFault::Failed(fault) }
    }
}

/// The store that a view shows.
pub struct StoreView {
    root: PathBuf,
    objects: Arc<PackReader>,
    metrics: Vec<Metric>,
    pipelines: Mutex<HashMap<String, KnownPipeline>>,
    columns: Mutex<ColumnCache>,
    blocks: Mutex<HeldBlocks>,
}

/// A pipeline, and the time at which its version was last checked.
struct KnownPipeline {
    pipeline: Option<Arc<PublishedPipeline>>,
    seen: Instant,
}

/// A published version of a pipeline.
pub struct PublishedPipeline {
    /// The version.
    pub version: Version,
    /// The inputs of the pipeline's tables.
    pub notes: PipelineNotes,
    /// The store.
    root: PathBuf,
    objects: Arc<PackReader>,
    tables: Mutex<HashMap<String, Arc<ViewTable>>>,
}

/// Cached columns of lines, by table, version, column name and units.
#[derive(Default)]
struct ColumnCache {
    held: HashMap<ColumnKey, Arc<Vec<f64>>>,
    bytes: usize,
}

type ColumnKey = (String, u64, String, Vec<usize>);

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl StoreView {
    /// The store at `root`, whose scores have these metrics.
    ///
    /// # Errors
    /// Fails if the store cannot be read.
    pub fn new(root: &Path, metrics: Vec<Metric>) -> Result<StoreView, Fault> {
        let root = root.canonicalize().map_err(|e| Fault::machine(format!("cannot read the store: {e}")))?;
        let objects = Arc::new(PackReader::open(&root)?);
        let (pipelines, columns, blocks) = (Mutex::default(), Mutex::default(), Mutex::default());
        Ok(StoreView { root, objects, metrics, pipelines, columns, blocks })
    }

    /// The store's folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The names of the published pipelines.
    pub fn pipelines(&self) -> Vec<String> {
        pipeline_names(&self.root.join("tables"))
    }

    /// The current version of a pipeline.
    ///
    /// # Errors
    /// Fails if there is no such pipeline.
    pub fn pipeline(&self, name: &str) -> Result<Arc<PublishedPipeline>, ViewFault> {
        let missing = || {
            let fault = Fault::new(format!("the store has no published pipeline `{name}`"));
            ViewFault::Missing(fault.nearest(name, &self.pipelines()))
        };
        if store::pipeline_name(name).is_err() {
            return Err(missing());
        }
        let mut known = locked(&self.pipelines);
        let old = known.get(name);
        if let Some(KnownPipeline { pipeline, seen }) = old
            && seen.elapsed() < LOOK_AGAIN
        {
            return pipeline.clone().ok_or_else(missing);
        }
        let version = current(&self.root, name);
        let same = |old: &PublishedPipeline, new: &Version| {
            (old.version.number, old.version.manifest.sum()) == (new.number, new.manifest.sum())
        };
        let pipeline = match (old.and_then(|k| k.pipeline.clone()), version) {
            (Some(old), Some(new)) if same(&old, &new) => Some(old),
            (_, Some(version)) => {
                self.objects.refresh();
                let (root, objects) = (self.root.clone(), self.objects.clone());
                let notes = PipelineNotes::read(&root, name);
                Some(Arc::new(PublishedPipeline { version, notes, root, objects, tables: Mutex::default() }))
            }
            (_, None) => None,
        };
        if pipeline.is_some() || known.len() < 1000 {
            known.insert(name.to_owned(), KnownPipeline { pipeline: pipeline.clone(), seen: Instant::now() });
        }
        pipeline.ok_or_else(missing)
    }

    /// The table of a name PIPELINE.TABLE, and its pipeline.
    ///
    /// # Errors
    /// Fails if there is no such table, or the store is damaged.
    pub fn table(&self, name: &str) -> Result<(Arc<PublishedPipeline>, Arc<ViewTable>), ViewFault> {
        let Some((pipeline, table)) = name.split_once('.') else {
            let fault = Fault::new(format!("`{name}` is not the name of a table"));
            return Err(ViewFault::Wrong(fault.help("write PIPELINE.TABLE; `api/catalogue` lists the tables")));
        };
        let pipeline = self.pipeline(pipeline)?;
        let table = pipeline.table(table)?;
        Ok((pipeline, table))
    }

    /// The query for the download of a table with lists of varying length; `None` for other tables, which
    /// `magline export` writes. A CSV download omits these lists, a Parquet download keeps them, and `magline export`
    /// stores them as strings.
    ///
    /// # Errors
    /// Fails if there is no such table, or the store is damaged.
    pub fn download_query(&self, name: &str, is_csv: bool) -> Result<Option<String>, ViewFault> {
        let (_, table) = self.table(name)?;
        let columns = table.provider.columns();
        let varies = |kind: &DataType| matches!(kind, DataType::List(_) | DataType::LargeList(_));
        if !columns.fields().iter().any(|f| varies(f.data_type())) {
            return Ok(None);
        }
        let quoted = |name: &str| format!("\"{}\"", name.replace('"', "\"\""));
        let listed = columns.fields().iter().filter(|f| !is_csv || !varies(f.data_type())).map(|f| quoted(f.name()));
        let keys = table.axes.iter().map(String::as_str).chain(["flight", "line", "metric"]);
        let keys: Vec<String> = keys.filter(|key| columns.field_with_name(key).is_ok()).map(quoted).collect();
        let order = if keys.is_empty() { String::new() } else { format!(" ORDER BY {}", keys.join(", ")) };
        let from = name.split('.').map(quoted).collect::<Vec<_>>().join(".");
        Ok(Some(format!("SELECT {} FROM {from}{order}", listed.collect::<Vec<_>>().join(", "))))
    }

    /// The published tables of scores of a pipeline, as PIPELINE.TABLE.
    fn score_tables(&self, name: &str) -> Vec<String> {
        let Ok(pipeline) = self.pipeline(name) else { return vec![] };
        let scores = |table: &String| pipeline.notes.table(table).is_some_and(NotedTable::is_scores);
        pipeline.tables().iter().filter(|table| scores(table)).map(|table| format!("{name}.{table}")).collect()
    }

    /// The lineage of a table PIPELINE.TABLE as JSON.
    ///
    /// # Errors
    /// Fails if no stage made such a table.
    pub fn lineage(&self, name: &str) -> Result<Value, ViewFault> {
        let (pipeline, table) = name.split_once('.').unwrap_or((name, ""));
        self.pipeline(pipeline)?.notes.lineage(table).map_err(ViewFault::Missing)
    }

    /// The sources and tables of a pipeline with their parameters, as JSON.
    ///
    /// # Errors
    /// Fails if there is no such pipeline.
    pub fn parameters(&self, name: &str) -> Result<Value, ViewFault> {
        Ok(self.pipeline(name)?.notes.parameters())
    }

    /// Hash of the published versions, which changes whenever a run publishes tables.
    pub fn changed(&self) -> String {
        let state = |name: &String| {
            self.pipeline(name)
                .map_or(String::new(), |p| format!("{name} {} {}\n", p.version.number, p.version.manifest.sum()))
        };
        let all: String = self.pipelines().iter().map(state).collect();
        schemas::keys::HashKey::from_parts([all]).to_string()
    }

    /// A column of the given units of a table, from the cache if possible.
    fn column(&self, version: u64, table: &ViewTable, units: &[usize], name: &str) -> Result<Arc<Vec<f64>>, ViewFault> {
        let key = (table.name.clone(), version, name.to_owned(), units.to_vec());
        if let Some(values) = locked(&self.columns).held.get(&key) {
            return Ok(values.clone());
        }
        let values = Arc::new(table.floats(units, name)?);
        let mut cache = locked(&self.columns);
        let bytes = 8 * values.len();
        if cache.bytes + bytes > HELD_BYTES {
            *cache = ColumnCache::default();
        }
        if bytes <= HELD_BYTES / 2 && cache.held.insert(key, values.clone()).is_none() {
            cache.bytes += bytes;
        }
        Ok(values)
    }
}

impl PublishedPipeline {
    /// Names of the tables. Tables that are links to other places are omitted, as in SQL queries.
    pub fn tables(&self) -> Vec<String> {
        let names = self.version.manifest.tables.iter().map(|t| t.name.clone());
        names.filter(|name| !self.leads_out(name)).collect()
    }

    fn leads_out(&self, table: &str) -> bool {
        leads_out(&self.root.join("tables").join(&self.version.manifest.pipeline).join(table), &self.root)
    }

    /// A table, opened at first use.
    ///
    /// # Errors
    /// Fails if there is no such table, or the store is damaged.
    pub fn table(&self, name: &str) -> Result<Arc<ViewTable>, ViewFault> {
        if let Some(known) = locked(&self.tables).get(name) {
            return Ok(known.clone());
        }
        let pipeline = &self.version.manifest.pipeline;
        let listed = self.version.manifest.tables.iter().find(|t| t.name == name).filter(|_| !self.leads_out(name));
        let Some(listed) = listed else {
            let fault = Fault::new(format!("the store has no table `{pipeline}.{name}`"));
            return Err(ViewFault::Missing(fault.nearest(name, &self.tables())));
        };
        self.version.at_hand(listed)?;
        let provider = PublishedTableProvider::open(&self.objects, &self.version, listed)?;
        let columns = provider.columns().clone();
        let axes = self.notes.table(name).map(|t| t.axes.clone()).unwrap_or_default();
        let axes = axes.into_iter().filter(|axis| columns.field_with_name(axis).is_ok()).collect();
        let table = Arc::new(ViewTable::new(format!("{pipeline}.{name}"), axes, provider));
        locked(&self.tables).insert(name.to_owned(), table.clone());
        Ok(table)
    }

    /// Reader of the results.
    fn objects(&self) -> &PackReader {
        &self.objects
    }
}
