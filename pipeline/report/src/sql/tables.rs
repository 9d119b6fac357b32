//! The tables of a store for DataFusion: read-only, opened when a query names them, and without access to other files.

use std::{collections::BTreeMap, path::Path, sync::Arc};

use arrow_array::RecordBatch;
use arrow_schema::Schema;
use async_trait::async_trait;
use datafusion::{
    catalog::{SchemaProvider, TableProvider},
    common::plan_err,
    error::DataFusionError,
    execution::object_store::ObjectStoreRegistry,
    object_store::ObjectStore,
    prelude::SessionContext,
};
use schemas::Fault;
use store::{PackReader, Version, current};
use url::Url;

use super::scan::{PublishedTableProvider, ScanFault};

/// The version of each pipeline: its number, and the checksum of its manifest.
pub type VersionPins = BTreeMap<String, (u64, String)>;

/// Tables that can be queried.
#[derive(Debug, Default)]
pub struct QueryTables {
    /// The versions of the tables.
    pub pins: VersionPins,
    /// The tables, as `pipeline.table`.
    pub tables: Vec<String>,
    /// Tables that are not read, because they are links to other places.
    pub elsewhere: Vec<String>,
}

/// Object store registry without stores: queries read only the tables of the magline store.
#[derive(Debug)]
pub struct ClosedStoreRegistry;

impl ObjectStoreRegistry for ClosedStoreRegistry {
    fn register_store(&self, _: &Url, _: Arc<dyn ObjectStore>) -> Option<Arc<dyn ObjectStore>> {
        None
    }

    fn get_store(&self, url: &Url) -> Result<Arc<dyn ObjectStore>, DataFusionError> {
        plan_err!("{url} is not in the store; queries read only the store")
    }
}

/// The tables of one pipeline.
struct PipelineTables {
    objects: Arc<PackReader>,
    version: Version,
    elsewhere: Vec<String>,
}

impl std::fmt::Debug for PipelineTables {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{}", self.version.manifest.pipeline)
    }
}

#[async_trait]
impl SchemaProvider for PipelineTables {
    fn table_names(&self) -> Vec<String> {
        let names = self.version.manifest.tables.iter().map(|t| t.name.clone());
        names.filter(|n| !self.elsewhere.contains(n)).collect()
    }

    async fn table(&self, name: &str) -> Result<Option<Arc<dyn TableProvider>>, DataFusionError> {
        let Some(table) = self.version.manifest.tables.iter().find(|t| t.name == name && self.table_exist(name)) else {
            return Ok(None);
        };
        let unreadable = |fault| DataFusionError::External(Box::new(ScanFault(fault)));
        self.version.at_hand(table).map_err(unreadable)?;
        let published = PublishedTableProvider::open(&self.objects, &self.version, table);
        let published = published.map_err(unreadable)?;
        Ok(Some(Arc::new(published)))
    }

    fn table_exist(&self, name: &str) -> bool {
        !self.elsewhere.iter().any(|n| n == name) && self.version.manifest.tables.iter().any(|t| t.name == name)
    }
}

/// Registers every table of the store at `root`, in the versions `pins` or in the current versions.
///
/// # Errors
/// Fails if the store cannot be read, or one of these versions no longer exists.
pub fn register(context: &SessionContext, root: &Path, pins: Option<&VersionPins>) -> Result<QueryTables, Fault> {
    let mut known = QueryTables::default();
    let Ok(root) = root.canonicalize() else { return Ok(known) };
    let fail = |e: &dyn std::fmt::Display| Fault::machine(format!("cannot read the store's {}: {e}", root.display()));
    let catalog = context.catalog("datafusion").ok_or_else(|| fail(&"no catalogue"))?;
    let objects = Arc::new(PackReader::open(&root)?);
    for pipeline in names(&root.join("tables")) {
        let folder = root.join("tables").join(&pipeline);
        let leads_out: Vec<String> =
            names(&folder).into_iter().filter(|table| leads_out(&folder.join(table), &root)).collect();
        known.elsewhere.extend(leads_out.iter().map(|table| format!("{pipeline}.{table}")));
        let version = match pins {
            None => current(&root, &pipeline),
            Some(pins) => pins.get(&pipeline).map(|pin| pinned(&root, &pipeline, pin)).transpose()?,
        };
        let Some(version) = version else { continue };
        known.pins.insert(pipeline.clone(), (version.number, version.manifest.sum().to_owned()));
        let one = PipelineTables { objects: objects.clone(), version, elsewhere: leads_out };
        known.tables.extend(one.table_names().into_iter().map(|table| format!("{pipeline}.{table}")));
        catalog.register_schema(&pipeline, Arc::new(one)).map_err(|e| fail(&e))?;
    }
    known.tables.sort();
    Ok(known)
}

/// The columns that have a single value in each part of the published table `table`, given as `pipeline.table`: flight,
/// line and axes. The result has one row per part. A part is a unit or a row group, which queries read or skip as a
/// whole. Returns no columns for an unknown table.
///
/// # Errors
/// Fails if the store or the table cannot be read.
pub fn parts(root: &Path, table: &str) -> Result<RecordBatch, Fault> {
    let none = || Ok(RecordBatch::new_empty(Arc::new(Schema::empty())));
    let (Ok(root), Some((pipeline, name))) = (root.canonicalize(), table.split_once('.')) else { return none() };
    let Some(version) = current(&root, pipeline) else { return none() };
    let listed = version.manifest.tables.iter().find(|listed| listed.name == name);
    let listed = listed.filter(|_| !leads_out(&root.join("tables").join(pipeline).join(name), &root));
    let Some(listed) = listed else { return none() };
    version.at_hand(listed)?;
    PublishedTableProvider::open(&Arc::new(PackReader::open(&root)?), &version, listed)?.parts()
}

/// The version of a pipeline with this number and checksum, which was current at an earlier moment.
fn pinned(root: &Path, pipeline: &str, (number, sum): &(u64, String)) -> Result<Version, Fault> {
    let version = Version::open(&root.join("versions").join(pipeline).join(number.to_string()));
    version.filter(|version| version.manifest.sum() == sum).ok_or_else(|| {
        let what = format!("the version of `{pipeline}` for which the query was planned no longer exists");
        Fault::machine(what).help("repeat the query, which then reads the current version")
    })
}

/// Whether a table's folder, or a file in it, is a link to somewhere outside of `root`.
pub(crate) fn leads_out(folder: &Path, root: &Path) -> bool {
    let inside = |path: &Path| path.canonicalize().is_ok_and(|p| p.starts_with(root));
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let link = |f: &std::fs::DirEntry| f.file_type().map_or(true, |kind| kind.is_symlink());
    !inside(folder) || files.into_iter().any(|f| link(&f) && !inside(&f.path()))
}

/// The folders in `root` with names that a spec permits.
pub(crate) fn names(root: &Path) -> Vec<String> {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    let entries = std::fs::read_dir(root).into_iter().flatten().flatten().filter(|e| e.path().is_dir());
    let mut found: Vec<String> = entries.filter_map(|e| e.file_name().into_string().ok()).collect();
    found.retain(|n| n.chars().all(plain));
    found.sort();
    found
}
