//! The answer to a query, in the form that was asked for.

use std::{
    fs::File,
    io::{self, Write},
    path::Path,
};

use arrow_array::RecordBatch;
use arrow_cast::pretty::pretty_format_batches;
use arrow_schema::SchemaRef;
use arrow_select::concat::concat_batches;
use pipeline::store::write_parquet;
use schemas::Fault;

/// How an answer is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// For people.
    #[default]
    Table,
    /// Comma-separated values.
    Csv,
    /// One JSON object per line.
    Json,
    /// A Parquet file; needs `-o`.
    Parquet,
}

/// Writes the answer to `output`, or to standard output.
///
/// # Errors
/// When it cannot be written, or not in this form.
pub fn write(schema: &SchemaRef, batches: &[RecordBatch], format: Format, output: Option<&Path>) -> Result<(), Fault> {
    let whole = concat_batches(schema, batches).map_err(|e| Fault::machine(e.to_string()))?;
    let failed = |e: &dyn std::fmt::Display| Fault::machine(format!("cannot write the answer: {e}"));
    match (format, output) {
        (Format::Parquet, None) => {
            Err(Fault::new("a Parquet file cannot be written to the terminal").help("name a file with `-o`"))
        }
        (Format::Parquet, Some(path)) => {
            let tmp = path.with_extension("parquet.tmp");
            write_parquet(&tmp, &whole)?;
            std::fs::rename(&tmp, path).map_err(|e| failed(&e))
        }
        (_, Some(path)) => {
            let tmp = path.with_extension("tmp");
            let mut file = File::create(&tmp).map_err(|e| failed(&e))?;
            text(&whole, format, &mut file).map_err(|e| failed(&e))?;
            std::fs::rename(&tmp, path).map_err(|e| failed(&e))
        }
        (_, None) => match text(&whole, format, &mut io::stdout().lock()) {
            Err(e) if e.kind() == io::ErrorKind::BrokenPipe => Ok(()),
            other => other.map_err(|e| failed(&e)),
        },
    }
}

fn text(batch: &RecordBatch, format: Format, out: &mut dyn Write) -> io::Result<()> {
    match format {
        Format::Csv => {
            let mut writer = arrow_csv::WriterBuilder::new().with_header(true).build(out);
            writer.write(batch).map_err(io::Error::other)
        }
        Format::Json => {
            let mut writer = arrow_json::LineDelimitedWriter::new(out);
            writer.write(batch).and_then(|()| writer.finish()).map_err(io::Error::other)
        }
        Format::Table | Format::Parquet => {
            let shown = pretty_format_batches(std::slice::from_ref(batch)).map_err(io::Error::other)?;
            writeln!(out, "{shown}")
        }
    }
}
