//! `magline export`: a table of a store as a file for other programs.

use std::path::{Path, PathBuf};

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use clap::Args;
use report::{
    export::{self, TABLE_FORMATS, TableFormat, TableWriter},
    sql::{BatchSink, StoreQuery, memory},
};
use schemas::Fault;
use store::pulled;

use super::{
    ExitReason, answer, located,
    sql::{answered, confined, outside},
    temporary::TemporaryFile,
    tend::found_store,
};

#[derive(Args)]
pub struct ExportArgs {
    /// The table, as PIPELINE.TABLE.
    table: String,
    /// The output file; its extension selects the format: .csv, .parquet, .xyz (Geosoft), .gpkg (GeoPackage) or .mat
    /// (MATLAB). An existing file is replaced when the new file is complete.
    #[arg(short, long)]
    output: PathBuf,
    /// Append the unit to each column name in the header of a CSV file, such as `mag_c [nT]`.
    #[arg(long)]
    units: bool,
    /// Only these lines.
    #[arg(long, value_delimiter = ',')]
    line: Vec<String>,
    /// Only the rows that this SQL condition selects, such as "mag = 'mag_4_uc'".
    #[arg(long = "where", value_name = "CONDITION")]
    condition: Option<String>,
    /// The store's folder, or its address such as s3://BUCKET/PREFIX. By default the folder `store` here or in the
    /// folder above.
    #[arg(long, value_parser = located)]
    store: Option<PathBuf>,
}

/// File format of an export.
enum ExportFormat {
    Answer(answer::AnswerFormat),
    Table(TableFormat),
}

fn format(output: &Path) -> Result<ExportFormat, Fault> {
    let ending = output.extension().map(|e| e.to_string_lossy().to_lowercase());
    Ok(match ending.as_deref() {
        Some("csv") => ExportFormat::Answer(answer::AnswerFormat::Csv),
        Some("parquet") => ExportFormat::Answer(answer::AnswerFormat::Parquet),
        other => {
            if let Some(format) = TABLE_FORMATS.iter().find(|format| other == Some(format.extension)) {
                return Ok(ExportFormat::Table(*format));
            }
            let given = other.map_or("a file without an extension".to_owned(), |e| format!("`.{e}`"));
            let fault = Fault::new(format!("a table cannot be exported as {given}"));
            let more: String = TABLE_FORMATS.iter().map(|format| format!(", .{}", format.extension)).collect();
            return Err(fault.help(format!("use one of the extensions .csv, .parquet{more}")));
        }
    })
}

/// Writes the file.
pub fn run(args: &ExportArgs) -> Result<(), ExitReason> {
    let format = format(&args.output)?;
    if args.units && !matches!(format, ExportFormat::Answer(answer::AnswerFormat::Csv)) {
        let fault = Fault::new("`--units` requires the extension .csv");
        return Err(fault.help("remove `--units`; the other formats store the units anyway").into());
    }
    let query = export::query(&args.table, &args.line, args.condition.as_deref())?;
    let memory = memory::by_default();
    confined(memory, Some(&args.output), |spill| {
        let store = found_store(args.store.as_deref());
        outside(&args.output, &store)?;
        pulled(&store)?;
        let question = StoreQuery { store: &store, query: &query, memory, spill };
        match format {
            ExportFormat::Answer(format) => {
                let mut writer = answer::AnswerWriter::new(format, Some(&args.output))?;
                answered(&question, &mut writer, |question, sink| export::export(question, sink, args.units))?;
            }
            ExportFormat::Table(format) => {
                let table = args.table.split_once('.').map_or("", |(_, table)| table);
                let mut file = TableFile::new(&args.output, format, table.trim_matches('"'))?;
                answered(&question, &mut file, |question, sink| export::export(question, sink, false))?;
            }
        }
        Ok(())
    })
}

/// File that is written under a temporary name.
struct TableFile<'a> {
    path: &'a Path,
    tmp: TemporaryFile,
    writer: Option<Box<dyn TableWriter>>,
}

impl TableFile<'_> {
    fn new<'a>(path: &'a Path, format: TableFormat, table: &str) -> Result<TableFile<'a>, Fault> {
        let tmp = TemporaryFile::new(answer::unfinished(path, std::process::id()));
        let writer = (format.create)(tmp.path(), table)?;
        Ok(TableFile { path, tmp, writer: Some(writer) })
    }
}

impl BatchSink for TableFile<'_> {
    fn take(&mut self, batch: RecordBatch) -> Result<bool, Fault> {
        self.writer.as_mut().map_or(Ok(()), |writer| writer.write(&batch)).map(|()| true)
    }

    fn keeps(&self, _: &RecordBatch) -> usize {
        0
    }

    fn finish(&mut self, schema: &SchemaRef) -> Result<(), Fault> {
        let Some(writer) = self.writer.take() else { return Ok(()) };
        writer.finish(schema)?;
        let renamed = std::fs::rename(self.tmp.path(), self.path);
        renamed.map_err(|e| Fault::machine(format!("cannot write {}: {e}", self.path.display())))
    }
}
