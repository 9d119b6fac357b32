//! `magline map convert`: a map in another format, coordinate system or extent.

use std::path::PathBuf;

use clap::Args;
use stages::map_convert::MapConvert;

use super::{
    ExitReason, InputArgs, OutputArgs, ThreadArgs,
    flags::{StageFlags, in_flags},
    of_file,
};

#[derive(Args)]
pub struct ConvertArgs {
    /// The map.
    map: PathBuf,
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    stage: StageFlags<MapConvert>,
    #[command(flatten)]
    threads: ThreadArgs,
}

pub fn run(args: &ConvertArgs) -> Result<(), ExitReason> {
    let stage = args.stage.stage()?;
    stage.check().map_err(in_flags::<MapConvert>)?;
    args.output.check([&args.map])?;
    args.threads.run(|| {
        let map = args.input.read(&args.map)?;
        args.output.write(&stage.apply(&map).map_err(|fault| of_file(&args.map, in_flags::<MapConvert>(fault)))?)
    })
}
