//! `magline map vector`: the components of the anomaly field.

use std::path::PathBuf;

use clap::Args;
use schemas::Fault;
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
        value_parser = ["north", "east", "down"],
        default_values = ["north", "east", "down"]
    )]
    component: Vec<String>,
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

pub fn run(args: &VectorArgs) -> Result<(), ExitReason> {
    if args.component.len() > 1 && !args.output.to_string_lossy().contains("{component}") {
        let help = "use for example `-o map_{component}.tif`, or set `--component`";
        let what = "several components require `{component}` in the name of the output file";
        return Err(Fault::new(what).help(help).into());
    }
    let stage = args.stage.stage()?;
    stage.check().map_err(in_flags::<MapVector>)?;
    let output = |word: &str| PathBuf::from(args.output.to_string_lossy().replace("{component}", word));
    args.component.iter().try_for_each(|word| apart(&output(word), [&args.map]))?;
    args.threads.run(|| {
        let map = args.input.read(&args.map)?;
        for (place, word) in args.component.iter().enumerate() {
            let component = match word.as_str() {
                "north" => VectorComponent::North,
                "east" => VectorComponent::East,
                _ => VectorComponent::Down,
            };
            let stage = MapVector { component, ..stage.clone() };
            let done = stage.apply(&map).map_err(|fault| of_file(&args.map, in_flags::<MapVector>(fault)))?;
            // Warnings and notes are the same for all components.
            if place == 0 {
                done.warnings.iter().for_each(|text| warn(text));
                done.notes.iter().for_each(|text| note(text));
            }
            write_to(&output(word), &done.map, args.output_format.as_deref())?;
        }
        Ok(())
    })
}
