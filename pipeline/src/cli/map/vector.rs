//! `magline map vector`: the components of the anomaly field.

use std::path::PathBuf;

use clap::{
    Args,
    builder::{PossibleValuesParser, TypedValueParser},
};
use schemas::{Fault, Literal, ParamValue};
use stages::map_vector::{MapVector, VectorComponent};

use super::{
    ExitReason, InputArgs, ThreadArgs, apart,
    flags::{StageFlags, in_flags},
    note, of_file, warn, write_to,
};

#[derive(Args)]
pub struct VectorArgs {
    /// The map.
    map: PathBuf,
    #[command(flatten)]
    input: InputArgs,
    /// The components, separated by commas.
    #[arg(
        long,
        value_name = "COMPONENT",
        value_delimiter = ',',
        value_parser = component(),
        default_values = ["north", "east", "down"]
    )]
    component: Vec<VectorComponent>,
    #[command(flatten)]
    stage: StageFlags<MapVector>,
    /// The output file. With several components, its name must contain `{component}`, which is replaced by the
    /// component.
    #[arg(short, long)]
    output: PathBuf,
    /// The output format, if the extension of the file does not determine it.
    #[arg(long)]
    output_format: Option<String>,
    #[command(flatten)]
    threads: ThreadArgs,
}

/// Parser of a component from its name in a spec.
pub fn component() -> impl TypedValueParser<Value = VectorComponent> {
    let read = |word: String| VectorComponent::read(&Literal::Text(word)).ok_or("it is not a component");
    PossibleValuesParser::new(VectorComponent::WORDS).try_map(read)
}

pub fn run(args: &VectorArgs) -> Result<(), ExitReason> {
    if args.component.len() > 1 && !args.output.to_string_lossy().contains("{component}") {
        let help = "use for example `-o map_{component}.tif`, or set `--component`";
        let what = "several components require `{component}` in the name of the output file";
        return Err(Fault::new(what).help(help).into());
    }
    let stage = args.stage.stage()?;
    stage.check().map_err(in_flags::<MapVector>)?;
    let output = |word: &str| PathBuf::from(args.output.to_string_lossy().replace("{component}", word));
    args.component.iter().try_for_each(|component| apart(&output(component.word()), [&args.map]))?;
    args.threads.run(|| {
        let map = args.input.read(&args.map)?;
        for (place, component) in args.component.iter().copied().enumerate() {
            let stage = MapVector { component, ..stage.clone() };
            let done = stage.apply(&map).map_err(|fault| of_file(&args.map, in_flags::<MapVector>(fault)))?;
            // Warnings and notes are the same for all components.
            if place == 0 {
                done.warnings.iter().for_each(|text| warn(text));
                done.notes.iter().for_each(|text| note(text));
            }
            write_to(&output(component.word()), &done.map, args.output_format.as_deref())?;
        }
        Ok(())
    })
}
