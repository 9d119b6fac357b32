//! `magline map fill`: gaps filled from their surroundings, or from other maps.

use std::path::PathBuf;

use clap::Args;
use datasets::AnomalyGrid;
use stages::map_fill::MapFill;

use super::{
    ExitReason, InputArgs, OutputArgs, ThreadArgs,
    flags::{StageFlags, in_flags},
    note, of_file, warn,
};

#[derive(Args)]
pub struct FillArgs {
    /// The map.
    map: PathBuf,
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    stage: StageFlags<MapFill>,
    /// Other maps that fill the gaps, in order of preference. They are transformed to the coordinate system of the map.
    /// A lower map is continued upward to the height of the map.
    #[arg(long, num_args = 1.., value_name = "MAP")]
    with: Vec<PathBuf>,
    #[command(flatten)]
    threads: ThreadArgs,
}

pub fn run(args: &FillArgs) -> Result<(), ExitReason> {
    let stage = args.stage.stage()?;
    stage.check(!args.with.is_empty()).map_err(in_flags::<MapFill>)?;
    args.output.check(args.with.iter().chain([&args.map]))?;
    args.threads.run(|| {
        let map = args.input.read(&args.map)?;
        // The options for format, coordinates, height and unit apply only to the map itself. The other maps are read
        // with the heights and units of their files.
        let input =
            InputArgs { format: None, epsg: None, alt: None, unit: None, field_component: None, ..args.input.clone() };
        let other = |path: &PathBuf| Ok((path.display().to_string(), input.read(path)?));
        let others: Vec<(String, AnomalyGrid)> = args.with.iter().map(other).collect::<Result<_, ExitReason>>()?;
        let filled = stage.apply(&map, &others).map_err(|fault| of_file(&args.map, in_flags::<MapFill>(fault)))?;
        filled.warnings.iter().for_each(|text| warn(text));
        filled.notes.iter().for_each(|text| note(text));
        args.output.write(&filled.map)
    })
}
