//! `magline sql`: a query and its result.

use std::{
    io::{IsTerminal, Read},
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
    process::exit,
};

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use clap::Args;
use report::sql::{BatchSink, StoreQuery, memory, sql};
use schemas::Fault;
use store::pulled;

use super::{
    ExitReason, answer, guard, located,
    say::err,
    temporary::{self, TemporaryFolder},
    tend::found_store,
};

/// Maximum number of rows of a table on a terminal.
const SCREEN_ROWS: usize = 50;

/// The arguments of a query.
#[derive(Args)]
pub struct SqlArgs {
    /// The query. Without it, or with `-`, the query is read from standard input.
    #[arg(conflicts_with = "file")]
    query: Option<String>,
    /// The file with the query.
    #[arg(short, long)]
    file: Option<PathBuf>,
    /// The store's folder, or its address such as s3://BUCKET/PREFIX. By default the folder `store` here or in the
    /// folder above.
    #[arg(long, value_parser = located)]
    store: Option<PathBuf>,
    /// The output format.
    #[arg(long, value_enum, default_value_t)]
    format: answer::AnswerFormat,
    /// The output file; standard output by default.
    #[arg(short, long)]
    output: Option<PathBuf>,
    /// The maximum number of rows. A note on standard error reports a truncated result. A table on a terminal has at
    /// most 50 rows by default.
    #[arg(long, value_name = "N")]
    max_rows: Option<usize>,
    /// The memory limit of the query, such as 4GB. Larger operations use temporary files. By default a quarter of the
    /// machine's memory, at most 8 GB.
    #[arg(long, value_name = "SIZE", value_parser = memory::size)]
    memory_limit: Option<usize>,
}

/// Runs the query.
pub fn run(args: &SqlArgs) -> Result<(), ExitReason> {
    let memory = args.memory_limit.unwrap_or_else(memory::by_default);
    confined(memory, args.output.as_deref(), |spill| write(args, memory, spill))
}

/// Runs `work` in a process with limited memory. The argument of `work` is the folder for temporary files, and `output`
/// is the file that `work` writes.
pub fn confined(
    memory: usize,
    output: Option<&Path>,
    work: impl FnOnce(PathBuf) -> Result<(), ExitReason>,
) -> Result<(), ExitReason> {
    let Some(spill) = guard::folder() else {
        let folder = TemporaryFolder::new()?;
        let unfinished = |process| output.map(|path| answer::unfinished(path, process));
        return guard::run(memory, folder.path(), unfinished);
    };
    guard::limit(memory);
    // An interrupt ends the process without waiting for the threads of the query.
    let _ = ctrlc::set_handler(|| {
        temporary::remove_all();
        err!("interrupted");
        exit(130)
    });
    work(spill)
}

/// Writes the result of the query.
fn write(args: &SqlArgs, memory: usize, spill: PathBuf) -> Result<(), ExitReason> {
    let store = found_store(args.store.as_deref());
    if let Some(output) = &args.output {
        outside(output, &store)?;
    }
    let query = query(args)?;
    pulled(&store)?;
    let question = StoreQuery { store: &store, query: &query, memory, spill };
    let answer = answer::AnswerWriter::new(args.format, args.output.as_deref())?;
    let on_screen = args.format == answer::AnswerFormat::Table && args.output.is_none();
    if args.max_rows.is_none() && on_screen && std::io::stdout().is_terminal() {
        let mut first = ScreenLimiter { answer, left: SCREEN_ROWS, hidden: 0 };
        answered(&question, &mut first, sql)?;
        if first.hidden > 0 {
            let all = SCREEN_ROWS + first.hidden;
            err!("note: {} of {all} rows are hidden; `--max-rows {all}` shows all rows", first.hidden);
        }
        return Ok(());
    }
    let Some(most) = args.max_rows else {
        let mut answer = answer;
        return Ok(answered(&question, &mut answer, sql)?);
    };
    let mut first = RowLimiter { answer, left: most, cut: None };
    answered(&question, &mut first, sql)?;
    if let Some(schema) = first.cut.take() {
        first.answer.finish(&schema)?;
        err!("note: the result has more than {most} rows; `--max-rows` truncated it");
    }
    Ok(())
}

/// Runs a query. Turns a panic of DataFusion into an error. DataFusion panics, for example, if a string is too long for
/// its offsets.
pub fn answered(
    question: &StoreQuery,
    sink: &mut dyn BatchSink,
    ask: impl FnOnce(&StoreQuery, &mut dyn BatchSink) -> Result<(), Fault>,
) -> Result<(), Fault> {
    let asked = catch_unwind(AssertUnwindSafe(|| ask(question, sink)));
    asked.unwrap_or_else(|_| Err(memory::fault(question.memory)))
}

/// The query: an argument, a file, or standard input.
fn query(args: &SqlArgs) -> Result<String, Fault> {
    match (&args.query, &args.file) {
        (Some(query), _) if query != "-" => Ok(query.clone()),
        (_, Some(file)) if file.as_os_str() != "-" => std::fs::read_to_string(file)
            .map_err(|e| Fault::new(format!("cannot read the query in {}: {e}", file.display()))),
        (None, None) if std::io::stdin().is_terminal() => Err(Fault::new("there is no query")
            .help("give the query as an argument, in a file (`-f FILE`) or on standard input")),
        _ => {
            let mut text = String::new();
            let read = std::io::stdin().read_to_string(&mut text);
            read.map_err(|e| Fault::new(format!("cannot read the query from standard input: {e}")))?;
            Ok(text)
        }
    }
}

/// Writer of the first rows of a query result, up to a limit.
struct RowLimiter {
    answer: answer::AnswerWriter,
    left: usize,
    /// Schema of the result; set once rows are truncated.
    cut: Option<SchemaRef>,
}

impl BatchSink for RowLimiter {
    fn take(&mut self, batch: RecordBatch) -> Result<bool, Fault> {
        let rows = batch.num_rows().min(self.left);
        self.left -= rows;
        let wanted = self.answer.take(batch.slice(0, rows))?;
        if wanted && rows < batch.num_rows() {
            self.cut = Some(batch.schema());
        }
        Ok(wanted && self.cut.is_none())
    }

    fn keeps(&self, batch: &RecordBatch) -> usize {
        self.answer.keeps(batch)
    }

    fn finish(&mut self, schema: &SchemaRef) -> Result<(), Fault> {
        self.answer.finish(schema)
    }
}

/// Writer of the first rows of a query result; it counts the other rows.
struct ScreenLimiter {
    answer: answer::AnswerWriter,
    left: usize,
    hidden: usize,
}

impl BatchSink for ScreenLimiter {
    fn take(&mut self, batch: RecordBatch) -> Result<bool, Fault> {
        let rows = batch.num_rows().min(self.left);
        self.left -= rows;
        self.hidden += batch.num_rows() - rows;
        if rows == 0 { Ok(true) } else { self.answer.take(batch.slice(0, rows)) }
    }

    fn keeps(&self, batch: &RecordBatch) -> usize {
        self.answer.keeps(&batch.slice(0, batch.num_rows().min(self.left)))
    }

    fn finish(&mut self, schema: &SchemaRef) -> Result<(), Fault> {
        self.answer.finish(schema)
    }
}

/// Rejects an output file inside the store.
pub fn outside(output: &Path, store: &Path) -> Result<(), Fault> {
    let folder = output.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match (folder.canonicalize(), store.canonicalize()) {
        (Ok(folder), Ok(store)) if folder.starts_with(&store) => {
            let fault =
                Fault::new(format!("{} is in the store; a query does not write to the store", output.display()));
            Err(fault.help("give a file outside the store with `-o`"))
        }
        _ => Ok(()),
    }
}
