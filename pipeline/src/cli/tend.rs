//! `gc`, `ls`, `rm`, `runs` and `verify`: maintenance of a store.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use clap::Args;
use results::{history, text};
use schemas::{Fault, one_line};
use store::{Store, is_copy, pulled, scrub, shown, tend};

use super::{ExitReason, counted, located, progress::ProgressDisplay, say};
use ::run::RECORD_CHECKS;

/// A store.
#[derive(Args)]
pub struct StoreArgs {
    /// The store's folder, or its address such as s3://BUCKET/PREFIX; `store` by default.
    #[arg(long, value_parser = located)]
    store: Option<PathBuf>,
}

/// The store `given`, otherwise the folder `store` in the current folder or in its parent. The location of a store that
/// was not given is printed to standard error, unless it is in the current folder.
pub fn found_store(given: Option<&Path>) -> PathBuf {
    let here = PathBuf::from("store");
    if let Some(given) = given {
        return given.to_owned();
    }
    let above = Path::new("..").join("store");
    if is_store(&here) || !is_store(&above) {
        return here;
    }
    super::note(&format!("using the store {}; `--store` selects another", above.display()));
    above
}

/// Whether a folder holds a store.
pub fn is_store(folder: &Path) -> bool {
    folder.join("STORE").is_file() || is_copy(folder)
}

impl StoreArgs {
    /// The store in a folder.
    pub fn new(store: PathBuf) -> StoreArgs {
        StoreArgs { store: Some(store) }
    }

    /// Opens the store, which must exist.
    fn open(&self) -> Result<Store, Fault> {
        Store::open(self.root()?)
    }

    /// Folder of the store, which must exist but may be read-only.
    fn root(&self) -> Result<&Path, Fault> {
        let store = self.store.as_deref().unwrap_or(Path::new("store"));
        pulled(store)?;
        if !store.join("STORE").is_file() {
            let fault = Fault::new(format!("there is no store {}", shown(store)));
            return Err(fault.help("give its folder or address with `--store`"));
        }
        Ok(store)
    }
}

/// The results to remove.
#[derive(Args)]
pub struct GcArgs {
    #[command(flatten)]
    store: StoreArgs,
    /// The number of versions of each pipeline to keep; the newest is always kept.
    #[arg(long, default_value_t = 1)]
    keep: usize,
    /// Keep results newer than this age, such as 30m, 12h or 7d.
    #[arg(long, value_name = "AGE", default_value = "0s", value_parser = age)]
    older_than: Duration,
    /// List the results without removing them; the default without `--yes`.
    #[arg(long, conflicts_with = "yes")]
    dry_run: bool,
    /// Remove the listed results.
    #[arg(long)]
    yes: bool,
}

/// Parses a duration: a number and s, m, h, d or w.
///
/// # Errors
/// Fails for any other text.
pub fn age(text: &str) -> Result<Duration, String> {
    let wrong = || format!("`{text}` is not a duration: write for example 90s, 30m, 12h, 7d or 4w");
    let (number, unit) = text.split_at(text.find(|c: char| !c.is_ascii_digit()).ok_or_else(wrong)?);
    let seconds = match unit {
        "s" => 1,
        "m" => 60,
        "h" => 3600,
        "d" => 86_400,
        "w" => 604_800,
        _ => return Err(wrong()),
    };
    let number: u64 = number.parse().map_err(|_| wrong())?;
    number.checked_mul(seconds).map(Duration::from_secs).ok_or_else(wrong)
}

/// Bytes as readable text.
pub fn bytes(n: u64) -> String {
    let n = n as f64;
    match n {
        n if n < 1e3 => format!("{n} B"),
        n if n < 1e6 => format!("{:.1} kB", n / 1e3),
        n if n < 1e9 => format!("{:.1} MB", n / 1e6),
        n => format!("{:.2} GB", n / 1e9),
    }
}

/// Removes results that no version references.
pub fn gc(args: &GcArgs) -> Result<(), ExitReason> {
    let store = args.store.open()?;
    let what = tend::GcOptions { keep: args.keep, older_than: args.older_than, dry: !args.yes };
    let done = tend::collect(&store, what)?;
    let verb = if args.yes { "removed" } else { "would remove" };
    let packs = format!("{} of unreferenced results ({})", counted(done.packs, "file"), bytes(done.bytes));
    let mut text = format!("{verb} {}, {packs}", counted(done.versions.len(), "old version"));
    if done.damaged > 0 {
        text += &format!(", {}", counted(done.damaged, "damaged file"));
    }
    text += "\n";
    for folder in &done.foreign {
        text += &format!("kept {}: it contains files that magline did not write\n", folder.display());
    }
    if done.busy {
        text += "results are kept, because a run is using the store\n";
    }
    if !args.yes {
        text += "nothing was removed; `--yes` removes these files\n";
    }
    say(text)
}

/// Lists the tables.
pub fn ls(args: &StoreArgs, pipeline: Option<&str>) -> Result<(), ExitReason> {
    let args = StoreArgs::new(found_store(args.store.as_deref()));
    let root = args.root()?;
    let found = tend::list(root)?;
    let names = tend::pipelines(root);
    if let Some(name) = pipeline.filter(|p| !names.iter().any(|n| n == p)) {
        return Err(Fault::new(format!("there is no pipeline `{name}` in the store")).nearest(name, &names).into());
    }
    let mut rows = vec![["table", "rows", "files", "size", "version"].map(str::to_owned).to_vec()];
    for one in found.iter().filter(|f| pipeline.is_none_or(|p| p == f.pipeline)) {
        rows.push(vec![
            format!("{}.{}", one.pipeline, one.table),
            one.rows.to_string(),
            one.files.to_string(),
            bytes(one.bytes),
            one.version.to_string(),
        ]);
    }
    say(text::columns(&rows, 1))
}

/// Removes a pipeline or a table.
pub fn rm(args: &StoreArgs, name: &str) -> Result<(), ExitReason> {
    let store = args.open()?;
    let (pipeline, table) = name.split_once('.').map_or((name, None), |(p, t)| (p, Some(t)));
    tend::remove(&store, pipeline, table)?;
    say(format!("removed {name}; its computed results stay in the store until `magline gc --yes`\n"))
}

/// Prints the history of runs, or the changes between two runs.
pub fn runs(args: &StoreArgs, pipeline: Option<&str>, between: Option<(u64, u64)>) -> Result<(), ExitReason> {
    let root = args.root()?;
    say(match (pipeline, between) {
        (Some(pipeline), Some((a, b))) => history::between(root, pipeline, a, b)?,
        _ => history::table(root, pipeline)?,
    })
}

/// Verifies every byte of a store.
pub fn verify(args: &StoreArgs) -> Result<(), ExitReason> {
    let root = args.root()?;
    let damaged_mark = scrub::mark_is_damaged(root);
    let store = Store::open(root);
    let progress = ProgressDisplay::new(false);
    progress.stage("reading the store");
    progress.detail("files", "");
    let tick = |i, all| progress.set(i, all);
    let mut found = match store {
        Ok(store) => scrub::scrub(&store, RECORD_CHECKS, &tick)?,
        // The store may be on a read-only disk, or may belong to another user.
        Err(fault) if !fault.owner.is_lasting() => scrub::scrub_read_only(root, RECORD_CHECKS, &tick)?,
        Err(fault) => return Err(fault.into()),
    };
    if damaged_mark {
        found.damaged.insert(root.join("STORE"), "its content is damaged".to_owned());
    }
    drop(progress);
    let read = format!("{}, {}", counted(found.files, "file"), bytes(found.bytes));
    if found.damaged.is_empty() {
        return say(format!("{read}: all verified\n"));
    }
    let mut text = format!("{read}: {} damaged", found.damaged.len());
    for (path, why) in &found.damaged {
        text += &format!("\n  {}: {}", one_line(&path.to_string_lossy()), one_line(why));
    }
    text += "\nrun the specs again: damaged results are recomputed and published again";
    Err(ExitReason::Failed(text))
}
