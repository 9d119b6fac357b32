//! `magline onnx`: a trained network as a file that other programs run.

use std::path::PathBuf;

use arrow_array::{Array, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_schema::SchemaRef;
use clap::Args;
use report::sql::{BatchSink, StoreQuery, memory, sql};
use schemas::Fault;
use stages::trained::LearnedModel;
use store::pulled;

use super::{ExitReason, located, say::err, temporary::TemporaryFolder};

#[derive(Args)]
pub struct OnnxArgs {
    /// The table of a `fit`, as PIPELINE.TABLE.
    table: String,
    /// An SQL condition on the axes, such as "model = 'm2c' AND mag = 'mag_4_uc'". Required if the table has several
    /// models.
    #[arg(long = "where", value_name = "CONDITION")]
    condition: Option<String>,
    /// The store's folder, or its address such as s3://BUCKET/PREFIX.
    #[arg(long, default_value = "store", value_parser = located)]
    store: PathBuf,
    /// The output file.
    #[arg(short, long)]
    output: PathBuf,
}

/// Names and values of the terms of a model.
#[derive(Default)]
struct OnnxTerms {
    names: Vec<String>,
    values: Vec<f64>,
}

impl BatchSink for OnnxTerms {
    fn take(&mut self, batch: RecordBatch) -> Result<bool, Fault> {
        let wrong = || Fault::new("the table is not made by a stage `fit`: it has no terms and values");
        let names = batch.column(0).as_string_opt::<i32>().ok_or_else(wrong)?;
        let values = batch.column(1).as_primitive_opt::<Float64Type>().ok_or_else(wrong)?;
        self.names.extend(names.iter().map(|name| name.unwrap_or_default().to_owned()));
        self.values.extend((0..values.len()).map(|i| if values.is_null(i) { f64::NAN } else { values.value(i) }));
        Ok(true)
    }

    fn keeps(&self, batch: &RecordBatch) -> usize {
        batch.get_array_memory_size()
    }

    fn finish(&mut self, _: &SchemaRef) -> Result<(), Fault> {
        Ok(())
    }
}

/// Writes the file.
pub fn run(args: &OnnxArgs) -> Result<(), ExitReason> {
    let condition = args.condition.as_ref().map(|c| format!(" WHERE {c}")).unwrap_or_default();
    let query = format!("SELECT arrow_cast(term, 'Utf8'), value FROM {}{condition}", args.table);
    let spill = TemporaryFolder::new()?;
    let question =
        StoreQuery { store: &args.store, query: &query, memory: memory::by_default(), spill: spill.path().to_owned() };
    pulled(&args.store)?;
    let mut terms = OnnxTerms::default();
    sql(&question, &mut terms)?;
    let mut sorted = terms.names.clone();
    sorted.sort_unstable();
    if sorted.windows(2).any(|pair| pair[0] == pair[1]) {
        let fault = Fault::new(format!("{} has several models", args.table));
        return Err(fault.help("select one model by its axes with `--where`").into());
    }
    let Some(LearnedModel::Network(network)) = LearnedModel::read(&terms.names, &terms.values)? else {
        let fault = Fault::new(format!("{} has no dense network", args.table));
        return Err(fault
            .help(
                "only networks that take one sample at a time can be exported: `m1`, `m2a` to `m2d`, `m3tl` to \
                               `m3vc`, `tlnn` and `etlnn`",
            )
            .into());
    };
    let bytes = network.to_onnx()?;
    std::fs::write(&args.output, &bytes)
        .map_err(|e| Fault::machine(format!("cannot write {}: {e}", args.output.display())))?;
    if !network.inputs().is_empty() {
        err!("input `x`: {}", network.inputs().join(", "));
    }
    if !network.linear().is_empty() {
        err!("input `a`: {}", network.linear().join(", "));
    }
    Ok(())
}
