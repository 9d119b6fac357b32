//! `magline sql`: a question and its answer.

use std::{
    path::{Path, PathBuf},
    process::exit,
    sync::Mutex,
};

use clap::Args;
use pipeline::views::sql::{Question, memory, sql};
use schemas::Fault;

use super::{Stop, answer, say::err};

/// A question.
#[derive(Args)]
pub struct SqlArgs {
    /// The query.
    query: String,
    /// The store's folder.
    #[arg(long, default_value = "store")]
    store: PathBuf,
    /// How the answer is written.
    #[arg(long, value_enum, default_value_t)]
    format: answer::Format,
    /// The file it is written to.
    #[arg(short, long)]
    output: Option<PathBuf>,
    /// How much memory the query may take, such as 4GB; more goes to temporary files. A quarter of the machine's when
    /// left out, at most 8 GB.
    #[arg(long, value_name = "SIZE", value_parser = memory::size)]
    memory_limit: Option<usize>,
}

/// What is removed when the command ends early.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(vec![]);

/// Something temporary: removed when it goes out of scope, or when the command is interrupted.
pub struct Temporary(PathBuf);

impl Temporary {
    /// Whatever will be made at `path`.
    pub fn new(path: PathBuf) -> Temporary {
        if let Ok(mut list) = UNFINISHED.lock() {
            list.push(path.clone());
        }
        Temporary(path)
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        remove(&self.0);
    }
}

fn remove(path: &Path) {
    // Nothing may be there, and nothing can be done where it cannot be removed.
    let _ = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
}

/// Answers the question.
pub fn run(args: &SqlArgs) -> Result<(), Stop> {
    // A query computes and writes on many threads, and none of them is worth waiting for.
    let _ = ctrlc::set_handler(|| {
        if let Ok(list) = UNFINISHED.lock() {
            list.iter().for_each(|path| remove(path));
        }
        err!("interrupted");
        exit(130)
    });
    if let Some(output) = &args.output {
        outside(output, &args.store)?;
    }
    let spill = Temporary::new(std::env::temp_dir().join(format!("magline-sql-{}", std::process::id())));
    let question = Question {
        store: &args.store,
        query: &args.query,
        memory: args.memory_limit.unwrap_or_else(memory::by_default),
        spill: spill.path().to_owned(),
    };
    let mut answer = answer::Answer::new(args.format, args.output.as_deref())?;
    Ok(sql(&question, &mut answer)?)
}

/// An answer is not written over what the store holds.
fn outside(output: &Path, store: &Path) -> Result<(), Fault> {
    let folder = output.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match (folder.canonicalize(), store.canonicalize()) {
        (Ok(folder), Ok(store)) if folder.starts_with(&store) => {
            let fault = Fault::new(format!("{} lies in the store, which a question does not change", output.display()));
            Err(fault.help("name a file outside of it with `-o`"))
        }
        _ => Ok(()),
    }
}
