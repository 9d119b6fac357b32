//! `magline sql`: DataFusion over every table of a store, as `<pipeline>.<table>`.

mod functions;

use std::{path::Path, sync::Arc};

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use datafusion::{
    catalog::{MemorySchemaProvider, SchemaProvider},
    datasource::{
        file_format::parquet::ParquetFormat,
        listing::{ListingOptions, ListingTable, ListingTableConfig, ListingTableUrl},
    },
    error::DataFusionError,
    prelude::{SessionConfig, SessionContext},
};
use schemas::Fault;

/// The answer to `query` over the store at `root`.
///
/// # Errors
/// When the query is wrong, or asks for a table that the store does not have.
pub fn sql(root: &Path, query: &str) -> Result<(SchemaRef, Vec<RecordBatch>), Fault> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let runtime = runtime.map_err(|e| Fault::machine(e.to_string()))?;
    runtime.block_on(ask(root, query))
}

async fn ask(root: &Path, query: &str) -> Result<(SchemaRef, Vec<RecordBatch>), Fault> {
    let context = SessionContext::new_with_config(SessionConfig::new().with_information_schema(true));
    functions::register(&context);
    let known = register(&context, root).await?;
    let wrong = |e: DataFusionError| explain(&e, &known, root);
    let frame = context.sql(query).await.map_err(wrong)?;
    let schema: SchemaRef = Arc::new(frame.schema().as_arrow().clone());
    let batches = frame.collect().await.map_err(wrong)?;
    Ok((batches.first().map_or(schema, RecordBatch::schema), batches))
}

/// Makes every table of the store known; the names come back.
async fn register(context: &SessionContext, root: &Path) -> Result<Vec<String>, Fault> {
    let fail = |e: &dyn std::fmt::Display| Fault::machine(format!("cannot read the store {}: {e}", root.display()));
    let catalog = context.catalog("datafusion").ok_or_else(|| fail(&"no catalogue"))?;
    let mut known = vec![];
    for (pipeline, folder) in folders(&root.join("tables")) {
        let schema = Arc::new(MemorySchemaProvider::new());
        for (table, folder) in folders(&folder) {
            if folders_or_files(&folder) == 0 {
                continue;
            }
            let url = format!("{}/", folder.canonicalize().map_err(|e| fail(&e))?.display());
            let url = ListingTableUrl::parse(url).map_err(|e| fail(&e))?;
            let options = ListingOptions::new(Arc::new(ParquetFormat::default())).with_file_extension(".parquet");
            let config = ListingTableConfig::new(url).with_listing_options(options);
            let config = config.infer_schema(&context.state()).await.map_err(|e| fail(&e))?;
            let listing = ListingTable::try_new(config).map_err(|e| fail(&e))?;
            schema.register_table(table.clone(), Arc::new(listing)).map_err(|e| fail(&e))?;
            known.push(format!("{pipeline}.{table}"));
        }
        catalog.register_schema(&pipeline, schema).map_err(|e| fail(&e))?;
    }
    Ok(known)
}

fn folders(root: &Path) -> Vec<(String, std::path::PathBuf)> {
    let entries = std::fs::read_dir(root).into_iter().flatten().flatten().filter(|e| e.path().is_dir());
    let mut found: Vec<_> = entries.map(|e| (e.file_name().to_string_lossy().into_owned(), e.path())).collect();
    found.sort();
    found
}

fn folders_or_files(folder: &Path) -> usize {
    std::fs::read_dir(folder).into_iter().flatten().flatten().count()
}

/// DataFusion's complaint, with the tables or columns there are.
fn explain(e: &DataFusionError, known: &[String], root: &Path) -> Fault {
    let text = e.strip_backtrace();
    let text = text.lines().next().unwrap_or_default().to_owned();
    let fault = Fault::new(format!("the query cannot be answered: {text}"));
    if text.contains("not found") && text.contains("table") && known.is_empty() {
        let fault = Fault::new(format!("there are no tables in the store {}", root.display()));
        fault.help("run a spec first, and name its store with `--store`")
    } else if text.contains("not found") && text.contains("table") {
        fault.help(format!("there are: {}", known.join(", ")))
    } else {
        fault
    }
}
