//! Result of a query in the requested format, written while the query is computed.

use std::{
    fs::File,
    io::{self, BufWriter, IsTerminal, Write},
    path::{Path, PathBuf},
    sync::Arc,
};

use arrow_array::{Array, RecordBatch};
use arrow_cast::pretty::pretty_format_batches;
use arrow_schema::SchemaRef;
use parquet::{
    arrow::ArrowWriter,
    basic::Compression,
    file::properties::{WriterProperties, WriterVersion},
};
use report::sql::BatchSink;
use schemas::{Fault, visible};

use super::{say, temporary::TemporaryFile};

/// Output format of a query result.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum AnswerFormat {
    /// An aligned table.
    #[default]
    Table,
    /// Comma-separated values.
    Csv,
    /// One JSON object per line.
    Json,
    /// A Parquet file; requires `-o`.
    Parquet,
}

/// Temporary name under which the process with the id `process` writes the result for `path`.
pub fn unfinished(path: &Path, process: u32) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    path.with_file_name(format!(".{name}.{process}"))
}

/// Writer of a query result to a file or to standard output.
pub struct AnswerWriter {
    format: AnswerFormat,
    output: Option<PathBuf>,
    tmp: Option<TemporaryFile>,
    writer: Option<BatchWriter>,
}

type AnswerOutput = Box<dyn Write + Send>;

enum BatchWriter {
    /// The columns are as wide as their widest cell, so all rows are buffered.
    Table(AnswerOutput, Vec<RecordBatch>),
    Csv(Box<arrow_csv::Writer<AnswerOutput>>),
    Json(arrow_json::LineDelimitedWriter<AnswerOutput>),
    Parquet(Box<ArrowWriter<AnswerOutput>>),
}

impl AnswerWriter {
    /// Creates a writer to `output`, or to standard output.
    ///
    /// # Errors
    /// Fails if the output cannot be written in this format.
    pub fn new(format: AnswerFormat, output: Option<&Path>) -> Result<AnswerWriter, Fault> {
        if format == AnswerFormat::Parquet && output.is_none() {
            let fault = Fault::new("a Parquet file cannot be written to the terminal");
            return Err(fault.help("give an output file with `-o`"));
        }
        let tmp = output.map(|path| TemporaryFile::new(unfinished(path, std::process::id())));
        Ok(AnswerWriter { format, output: output.map(Path::to_owned), tmp, writer: None })
    }

    fn out(&self) -> Result<AnswerOutput, Fault> {
        match &self.tmp {
            None => {
                let terminal = io::stdout().is_terminal().then(Vec::new);
                Ok(Box::new(BufWriter::with_capacity(1 << 16, StandardOutput { terminal })))
            }
            Some(tmp) => {
                let file = File::create(tmp.path()).map_err(|e| self.failed(&e))?;
                Ok(Box::new(BufWriter::with_capacity(1 << 16, file)))
            }
        }
    }

    fn writer(&mut self, schema: &SchemaRef) -> Result<&mut BatchWriter, Fault> {
        let writer = match self.writer.take() {
            Some(writer) => writer,
            None => self.begin(schema)?,
        };
        Ok(self.writer.insert(writer))
    }

    fn begin(&self, schema: &SchemaRef) -> Result<BatchWriter, Fault> {
        let out = self.out()?;
        Ok(match self.format {
            AnswerFormat::Table => BatchWriter::Table(out, vec![]),
            AnswerFormat::Csv => {
                BatchWriter::Csv(Box::new(arrow_csv::WriterBuilder::new().with_header(true).build(out)))
            }
            AnswerFormat::Json => BatchWriter::Json(arrow_json::LineDelimitedWriter::new(out)),
            AnswerFormat::Parquet => {
                let properties = WriterProperties::builder()
                    .set_created_by("magline".to_owned())
                    .set_writer_version(WriterVersion::PARQUET_1_0)
                    .set_compression(Compression::LZ4_RAW)
                    .set_max_row_group_row_count(Some(1 << 17))
                    .build();
                let writer = ArrowWriter::try_new(out, schema.clone(), Some(properties));
                BatchWriter::Parquet(Box::new(writer.map_err(|e| self.failed(&e))?))
            }
        })
    }

    fn failed(&self, e: &dyn std::fmt::Display) -> Fault {
        let to = self.output.as_ref().map(|p| format!(" to {}", p.display())).unwrap_or_default();
        Fault::machine(format!("cannot write the result{to}: {e}"))
    }

    /// Outcome of a write. A failure of standard output sets the exit status; a failure of a file is a fault.
    fn outcome(&self, written: Result<(), io::Error>) -> Result<bool, Fault> {
        match written {
            Ok(()) => Ok(true),
            Err(_) if say::gone() || say::lost().is_some() => Ok(false),
            Err(e) => Err(self.failed(&e)),
        }
    }
}

impl BatchWriter {
    fn write(&mut self, batch: RecordBatch) -> io::Result<()> {
        match self {
            BatchWriter::Table(_, kept) => {
                kept.push(batch);
                Ok(())
            }
            BatchWriter::Csv(csv) => csv.write(&batch).map_err(io::Error::other),
            BatchWriter::Json(json) => json.write(&batch).map_err(io::Error::other),
            BatchWriter::Parquet(parquet) => parquet.write(&batch).map_err(io::Error::other),
        }
    }

    fn finish(self) -> io::Result<()> {
        match self {
            BatchWriter::Table(mut out, batches) => {
                let shown = pretty_format_batches(&batches).map_err(io::Error::other)?.to_string();
                writeln!(out, "{}", visible(&shown))?;
                out.flush()
            }
            BatchWriter::Csv(csv) => csv.into_inner().flush(),
            BatchWriter::Json(mut json) => {
                json.finish().map_err(io::Error::other)?;
                json.into_inner().flush()
            }
            BatchWriter::Parquet(parquet) => parquet.into_inner().map_err(io::Error::other)?.flush(),
        }
    }
}

impl BatchSink for AnswerWriter {
    fn take(&mut self, batch: RecordBatch) -> Result<bool, Fault> {
        let written = self.writer(&batch.schema())?.write(batch);
        self.outcome(written)
    }

    fn keeps(&self, batch: &RecordBatch) -> usize {
        /// Additional memory that the table format needs for the text of a cell, in bytes.
        const CELL: usize = 160;
        let bytes =
            |c: &Arc<dyn Array>| c.to_data().get_slice_memory_size().unwrap_or_else(|_| c.get_array_memory_size());
        match self.format {
            AnswerFormat::Table => {
                batch.columns().iter().map(bytes).sum::<usize>() + CELL * batch.num_rows() * batch.num_columns()
            }
            AnswerFormat::Csv | AnswerFormat::Json | AnswerFormat::Parquet => 0,
        }
    }

    fn finish(&mut self, schema: &SchemaRef) -> Result<(), Fault> {
        if self.writer.is_none() {
            // A result without rows still has its columns.
            let written = self.writer(schema)?.write(RecordBatch::new_empty(schema.clone()));
            self.outcome(written)?;
        }
        let Some(writer) = self.writer.take() else { return Ok(()) };
        let whole = self.outcome(writer.finish())?;
        match (&self.tmp, &self.output) {
            (Some(tmp), Some(path)) if whole => std::fs::rename(tmp.path(), path).map_err(|e| self.failed(&e)),
            _ => Ok(()),
        }
    }
}

/// Standard output. A failure sets the exit status. A file or a pipe receives the bytes unchanged.
struct StandardOutput {
    /// Bytes of an incomplete character that wait for the rest; `None` if the output is not a terminal.
    terminal: Option<Vec<u8>>,
}

impl Write for StandardOutput {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let Some(begun) = &mut self.terminal else { return kept(io::stdout().write(bytes)) };
        begun.extend_from_slice(bytes);
        let whole = match std::str::from_utf8(begun) {
            Err(e) if e.error_len().is_none() => e.valid_up_to(),
            _ => begun.len(),
        };
        let rest = begun.split_off(whole);
        let text = String::from_utf8_lossy(&std::mem::replace(begun, rest)).into_owned();
        kept(io::stdout().write_all(visible(&text).as_bytes())).map(|()| bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        kept(io::stdout().flush())
    }
}

fn kept<T>(written: io::Result<T>) -> io::Result<T> {
    let same = |e: &io::Error| e.raw_os_error().map_or_else(|| e.kind().into(), io::Error::from_raw_os_error);
    written.inspect_err(|e| say::note(Err(same(e))))
}
