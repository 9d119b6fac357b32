//! magline with a stage whose failures a worker must survive or be replaced after.
//!
//! A separate program, so that the example of an external stage stays minimal.

use std::{process::ExitCode, sync::Arc, thread::sleep, time::Duration};

use arrow_array::{Float64Array, RecordBatch, cast::AsArray, types::Float64Type};
use schemas::{Column, Fault, LineInput, LineOutput, LineStage, Stage, StageSchema, Table, stage};

stage! {
    /// Copies the time and fails on one line.
    ///
    /// Source: none.
    Trouble = "trouble", version 1, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name  = "trouble"
stage = "trouble"
input = "resample"
"#;
    /// Kind of failure: `none`, `fault`, `panic`, `abort` or `hang`.
    does: String, unit "", default "none";
    /// Line on which the stage fails.
    on: String, unit "", default "";
}

impl Stage for Trouble {
    fn yields(&self, _: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let copy = Column::float("copy", "s", "the time");
        Ok(StageSchema::append(vec![copy.from(0, &["tt"])], &["tt"]))
    }
}

impl LineStage for Trouble {
    type Prepared = ();

    fn prepare(&self, _: &[RecordBatch]) -> Result<(), Fault> {
        Ok(())
    }

    #[allow(clippy::panic)]
    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        match if line.line == self.on { self.does.as_str() } else { "none" } {
            "fault" => return Err(Fault::data("trouble was asked for")),
            "panic" => panic!("trouble was asked for"),
            "abort" => std::process::abort(),
            "hang" => loop {
                sleep(Duration::from_secs(1));
            },
            _ => {}
        }
        let time = line.inputs[0].column_by_name("tt").and_then(|c| c.as_primitive_opt::<Float64Type>());
        let time = time.ok_or_else(|| Fault::data("not a column of numbers").in_column("tt"))?;
        Ok(vec![Arc::new(Float64Array::from(time.values().to_vec()))])
    }
}

fn main() -> ExitCode {
    let mut catalogue = pipeline::Catalogue::default();
    catalogue.stages.push(Trouble::entry());
    pipeline::main(&catalogue.entries())
}
