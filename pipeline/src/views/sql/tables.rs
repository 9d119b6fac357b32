//! The tables of a store as DataFusion sees them: read-only, and with no way to any other file.

use std::{
    borrow::Cow,
    path::{Path, PathBuf},
    sync::Arc,
};

use arrow_schema::SchemaRef;
use async_trait::async_trait;
use datafusion::{
    catalog::{MemorySchemaProvider, ScanArgs, ScanResult, SchemaProvider, Session, TableProvider},
    common::{Constraints, Statistics, plan_err},
    datasource::{
        file_format::parquet::ParquetFormat,
        listing::{ListingOptions, ListingTable, ListingTableConfig, ListingTableUrl},
    },
    error::DataFusionError,
    execution::object_store::ObjectStoreRegistry,
    logical_expr::{Expr, LogicalPlan, TableProviderFilterPushDown, TableType},
    object_store::{ObjectStore, local::LocalFileSystem},
    physical_plan::ExecutionPlan,
    prelude::SessionContext,
};
use schemas::Fault;
use url::Url;

/// The address of the folder of tables; no other can be opened.
const ADDRESS: &str = "magline://tables/";

/// What there is to ask.
#[derive(Debug, Default)]
pub struct Known {
    /// The tables, as `pipeline.table`.
    pub tables: Vec<String>,
    /// Those that are links to somewhere else, which are not read.
    pub elsewhere: Vec<String>,
}

/// The one place that can be read: the folder of published tables.
#[derive(Debug)]
struct OnlyTables(Option<Arc<LocalFileSystem>>);

impl ObjectStoreRegistry for OnlyTables {
    fn register_store(&self, _: &Url, _: Arc<dyn ObjectStore>) -> Option<Arc<dyn ObjectStore>> {
        None
    }

    fn get_store(&self, url: &Url) -> Result<Arc<dyn ObjectStore>, DataFusionError> {
        match &self.0 {
            Some(tables) if url.as_str().starts_with(ADDRESS) => Ok(tables.clone()),
            _ => plan_err!("{url} is not in the store, and nothing else can be read"),
        }
    }
}

/// The registry that knows the tables of the store at `root`, and their folder where there is one.
pub fn registry(root: &Path) -> Result<(Arc<dyn ObjectStoreRegistry>, Option<PathBuf>), Fault> {
    let Ok(folder) = root.join("tables").canonicalize() else { return Ok((Arc::new(OnlyTables(None)), None)) };
    let files = LocalFileSystem::new_with_prefix(&folder).map_err(|e| trouble(&folder, &e))?;
    Ok((Arc::new(OnlyTables(Some(Arc::new(files)))), Some(folder)))
}

fn trouble(root: &Path, e: &dyn std::fmt::Display) -> Fault {
    Fault::machine(format!("cannot read the store's {}: {e}", root.display()))
}

/// Makes every table below `root` known.
pub async fn register(context: &SessionContext, root: Option<&Path>) -> Result<Known, Fault> {
    let mut known = Known::default();
    let Some(root) = root else { return Ok(known) };
    let fail = |e: &dyn std::fmt::Display| trouble(root, e);
    let catalog = context.catalog("datafusion").ok_or_else(|| fail(&"no catalogue"))?;
    for (pipeline, folder) in folders(root) {
        let schema = Arc::new(MemorySchemaProvider::new());
        for (table, folder) in folders(&folder) {
            let name = format!("{pipeline}.{table}");
            if leads_out(&folder, root) {
                known.elsewhere.push(name);
                continue;
            }
            if std::fs::read_dir(&folder).into_iter().flatten().flatten().next().is_none() {
                continue;
            }
            let url = ListingTableUrl::parse(format!("{ADDRESS}{pipeline}/{table}/")).map_err(|e| fail(&e))?;
            let options = ListingOptions::new(Arc::new(ParquetFormat::default())).with_file_extension(".parquet");
            let config = ListingTableConfig::new(url).with_listing_options(options);
            let config = config.infer_schema(&context.state()).await.map_err(|e| fail(&e))?;
            let listing = ListingTable::try_new(config).map_err(|e| fail(&e))?;
            schema.register_table(table, Arc::new(ReadOnly(listing))).map_err(|e| fail(&e))?;
            known.tables.push(name);
        }
        catalog.register_schema(&pipeline, schema).map_err(|e| fail(&e))?;
    }
    Ok(known)
}

/// Whether a table's folder, or a file in it, is a link to somewhere outside of `root`.
fn leads_out(folder: &Path, root: &Path) -> bool {
    let inside = |path: &Path| path.canonicalize().is_ok_and(|p| p.starts_with(root));
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    !inside(folder) || files.into_iter().any(|f| !inside(&f.path()))
}

/// The folders in `root` whose names a spec may have.
fn folders(root: &Path) -> Vec<(String, PathBuf)> {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    let entries = std::fs::read_dir(root).into_iter().flatten().flatten().filter(|e| e.path().is_dir());
    let named = entries.filter_map(|e| Some((e.file_name().into_string().ok()?, e.path())));
    let mut found: Vec<_> = named.filter(|(n, _)| n.chars().all(plain)).collect();
    found.sort();
    found
}

/// A table that can be read and nothing else.
#[derive(Debug)]
struct ReadOnly(ListingTable);

#[async_trait]
impl TableProvider for ReadOnly {
    fn schema(&self) -> SchemaRef {
        self.0.schema()
    }

    fn constraints(&self) -> Option<&Constraints> {
        self.0.constraints()
    }

    fn table_type(&self) -> TableType {
        self.0.table_type()
    }

    fn get_logical_plan(&'_ self) -> Option<Cow<'_, LogicalPlan>> {
        self.0.get_logical_plan()
    }

    async fn scan(
        &self,
        state: &dyn Session,
        projection: Option<&Vec<usize>>,
        filters: &[Expr],
        limit: Option<usize>,
    ) -> Result<Arc<dyn ExecutionPlan>, DataFusionError> {
        self.0.scan(state, projection, filters, limit).await
    }

    async fn scan_with_args<'a>(&self, state: &dyn Session, args: ScanArgs<'a>) -> Result<ScanResult, DataFusionError> {
        self.0.scan_with_args(state, args).await
    }

    fn supports_filters_pushdown(
        &self,
        filters: &[&Expr],
    ) -> Result<Vec<TableProviderFilterPushDown>, DataFusionError> {
        self.0.supports_filters_pushdown(filters)
    }

    fn statistics(&self) -> Option<Statistics> {
        self.0.statistics()
    }
}
