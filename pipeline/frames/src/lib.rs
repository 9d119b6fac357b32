//! Result tables of magline as Polars [`LazyFrame`]s.
//!
//! A published table is a folder of plain Parquet files, `<store>/tables/<pipeline>/<table>/`. Its first columns are
//! the axes of the sweep, flight, line and time; the columns that the stage made follow. [`scan`] opens a table by the
//! name that the table has in `magline sql`; filters and projections are pushed down into the files.
//!
//! ```no_run
//! use polars::prelude::*;
//! let scores = frames::scan("datasets/examples/store".as_ref(), "osborne.scores")?;
//! let best = scores.filter(col("metric").eq(lit("drms"))).group_by([col("mag")]).agg([col("value").min()]).collect()?;
//! # Ok::<(), PolarsError>(())
//! ```

use std::{fs, io, path::Path};

use polars::prelude::{LazyFrame, PlRefPath, PolarsError, PolarsResult, ScanArgsParquet};

/// The tables that are published in `store`, each as `<pipeline>.<table>`, sorted.
///
/// # Errors
/// Fails if the folder of tables cannot be read.
pub fn tables(store: &Path) -> PolarsResult<Vec<String>> {
    let mut found = vec![];
    for pipeline in names(&store.join("tables"))? {
        for table in names(&store.join("tables").join(&pipeline))? {
            found.push(format!("{pipeline}.{table}"));
        }
    }
    found.sort();
    Ok(found)
}

/// Names of the folders in a folder.
fn names(folder: &Path) -> PolarsResult<Vec<String>> {
    let is_folder = |path: &Path| fs::metadata(path).is_ok_and(|what| what.is_dir());
    let entries = fs::read_dir(folder)?.collect::<io::Result<Vec<_>>>()?;
    let folders = entries.iter().filter(|entry| is_folder(&entry.path()));
    Ok(folders.map(|entry| entry.file_name().to_string_lossy().into_owned()).filter(|n| !n.starts_with('.')).collect())
}

/// The published table `name`, as `<pipeline>.<table>`, of the store in the folder `store`.
///
/// # Errors
/// Fails for a table that is not published; the message lists the published tables.
pub fn scan(store: &Path, name: &str) -> PolarsResult<LazyFrame> {
    let folder = name.split_once('.').map(|(pipeline, table)| store.join("tables").join(pipeline).join(table));
    let Some(folder) = folder.filter(|folder| folder.is_dir()) else {
        let known = tables(store)?.join(", ");
        let what = format!("there is no table `{name}` in {}; there are {known}", store.display());
        return Err(PolarsError::ComputeError(what.into()));
    };
    LazyFrame::scan_parquet(PlRefPath::new(folder.to_string_lossy()), ScanArgsParquet::default())
}
