//! `magline doctor`: checks of an installation, for its user and for reports of problems.

use std::{
    env, fs,
    path::{Path, PathBuf},
};

use clap::Args;
use nix::{
    sys::{
        resource::{RLIM_INFINITY, Resource, getrlimit},
        statvfs::statvfs,
    },
    unistd::{AccessFlags, access},
};
use plan::{Plan, read_spec};
use report::sql::memory;
use schemas::{Fault, StageEntry};
use store::{Store, scrub, shown, tend as stored};

use super::{ExitReason, counted, located, say, temporary::TemporaryFolder, tend, threads};

#[derive(Args)]
pub struct DoctorArgs {
    /// A spec to check as well, with its store.
    spec: Option<PathBuf>,
    /// The store's folder, or its address such as s3://BUCKET/PREFIX. By default the store of the spec, else the folder
    /// `store` here or in the folder above.
    #[arg(long, value_parser = located)]
    store: Option<PathBuf>,
}

/// Less free space than this causes a warning, in bytes. A simulated survey of an hour occupies a tenth of this space.
const LITTLE_SPACE: u64 = 2_000_000_000;
/// Limit of open files that a run over many lines requires.
const OPEN_FILES: u64 = 1024;

/// Outcome of a check.
enum Finding {
    Fine(String),
    /// A problem that does not prevent a run, and its remedy.
    Warning(String, String),
    /// A problem that prevents a run.
    Wrong(Fault),
}

/// Prints the checks. Fails if a problem would prevent a run.
pub fn run(catalogue: &[StageEntry], args: &DoctorArgs) -> Result<(), ExitReason> {
    let mut checks = vec![
        ("magline", program()),
        ("processor", Finding::Fine(counted(threads::cores(), "core"))),
        ("memory", Finding::Fine(format!("{} for each query by default", memory::shown(memory::by_default())))),
        ("temporary files", temporary()),
        ("open files", open_files()),
        ("file size", file_size()),
    ];
    let mut folder = args.store.clone();
    if let Some(path) = &args.spec {
        checks.push(match read_spec(path, &[]).and_then(|spec| Plan::new(spec, catalogue)) {
            Ok(plan) => {
                folder = folder.or(Some(plan.spec.store.clone()));
                ("spec", Finding::Fine(format!("{} is valid: {} tables", path.display(), plan.tables.len())))
            }
            Err(faults) => ("spec", Finding::Wrong(Fault::new(faults.to_string()))),
        });
    }
    checks.push(("store", store(&tend::found_store(folder.as_deref()))));
    let wide = checks.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    let mut wrong = 0;
    for (name, finding) in &checks {
        let (word, text) = match finding {
            Finding::Fine(text) => ("ok", text.clone()),
            Finding::Warning(text, help) => ("warning", format!("{text}\n  help: {help}")),
            Finding::Wrong(fault) => {
                wrong += 1;
                ("error", schemas::render(fault, "", "").trim_start_matches("error: ").to_owned())
            }
        };
        say::out_text(format!("{word:<7}  {name:<wide$}  {}\n", text.trim_end().replace('\n', "\n         ")));
    }
    if wrong > 0 {
        return Err(ExitReason::Failed(format!("error: {} failed", counted(wrong, "check"))));
    }
    Ok(())
}

fn program() -> Finding {
    let parts = [
        ("cluster", cfg!(feature = "cluster")),
        ("object-stores", cfg!(feature = "object-stores")),
        ("serve", cfg!(feature = "serve")),
    ];
    let built: Vec<&str> = parts.iter().filter(|(_, on)| *on).map(|(name, _)| *name).collect();
    let features = if built.is_empty() { "no optional features".to_owned() } else { built.join(", ") };
    let version = env!("CARGO_PKG_VERSION");
    Finding::Fine(format!("{version}, {}-{}, {features}", env::consts::OS, env::consts::ARCH))
}

/// Checks that a file can be written and that there is space for more files.
fn temporary() -> Finding {
    let folder = env::temp_dir();
    let tried = TemporaryFolder::new().and_then(|own| {
        let failed = |e: std::io::Error| Fault::machine(format!("cannot write in {}: {e}", own.path().display()));
        fs::write(own.path().join("doctor"), [0; 1 << 16]).map_err(failed)
    });
    match tried {
        Ok(()) => space(&folder, "set TMPDIR to a folder on a larger disk"),
        Err(fault) => Finding::Wrong(fault.help("set TMPDIR to a folder that you can write to")),
    }
}

/// The free space of a folder.
fn space(folder: &Path, help: &str) -> Finding {
    match statvfs(folder) {
        Ok(found) => {
            let free = found.blocks_available() * found.fragment_size();
            let text = format!("{}, {} free", folder.display(), memory::shown(free as usize));
            if free < LITTLE_SPACE { Finding::Warning(text, help.to_owned()) } else { Finding::Fine(text) }
        }
        Err(e) => Finding::Warning(format!("{}: unknown free space ({e})", folder.display()), help.to_owned()),
    }
}

fn open_files() -> Finding {
    match getrlimit(Resource::RLIMIT_NOFILE) {
        Ok((soft, _)) if soft < OPEN_FILES => {
            Finding::Warning(format!("at most {soft}"), format!("raise the limit: `ulimit -n {OPEN_FILES}`"))
        }
        Ok((soft, _)) => Finding::Fine(format!("at most {soft}")),
        Err(e) => Finding::Warning(format!("unknown limit ({e})"), "check `ulimit -n`".to_owned()),
    }
}

fn file_size() -> Finding {
    match getrlimit(Resource::RLIMIT_FSIZE) {
        Ok((RLIM_INFINITY, _)) => Finding::Fine("no limit".to_owned()),
        Ok((soft, _)) => Finding::Warning(
            format!("at most {}", memory::shown(soft as usize)),
            "larger results fail; raise the limit: `ulimit -f unlimited`".to_owned(),
        ),
        Err(e) => Finding::Warning(format!("unknown limit ({e})"), "check `ulimit -f`".to_owned()),
    }
}

/// Checks that the store opens, is writable, has no damaged files, and has free space.
fn store(root: &Path) -> Finding {
    if !tend::is_store(root) {
        return Finding::Fine(format!("there is none at {}; the first run makes it", shown(root)));
    }
    let tables = match store::pulled(root).and_then(|()| Store::open(root)).and_then(|_| stored::list(root)) {
        Ok(tables) => counted(tables.len(), "table"),
        Err(fault) => return Finding::Wrong(fault),
    };
    let name = shown(root).to_string();
    if scrub::mark_is_damaged(root) {
        let help = format!("run `magline verify --store {}`", crate::shell::shell_word(&name));
        return Finding::Wrong(Fault::data(format!("{name} ({tables}): the file `STORE` is damaged")).help(help));
    }
    if let Err(e) = access(root, AccessFlags::W_OK) {
        let help = "runs require write access; queries and reports do not";
        return Finding::Warning(format!("{name} ({tables}) cannot be written to: {e}"), help.to_owned());
    }
    match space(root, "remove unreferenced results: `magline gc`") {
        Finding::Fine(text) => Finding::Fine(format!("{tables}, {text}")),
        other => other,
    }
}
