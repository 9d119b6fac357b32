//! `magline map spectrum`: the power spectral density of a map.

use std::path::PathBuf;

use clap::{
    Args,
    builder::{PossibleValuesParser, TypedValueParser},
};
use numerics::maps::power_spectrum::{MapPowerSpectrum, MapTaper};
use schemas::{Fault, Literal, ParamValue};

use super::{ExitReason, InputArgs, ThreadArgs, of_file, say};

#[derive(Args)]
pub struct SpectrumArgs {
    /// The map, without unknown nodes.
    map: PathBuf,
    #[command(flatten)]
    input: InputArgs,
    /// The taper of the map before its Fourier transform. `none` is exact for a periodic map.
    #[arg(long, value_name = "TAPER", value_parser = taper(), default_value = MapTaper::Hann.word())]
    taper: MapTaper,
    #[command(flatten)]
    threads: ThreadArgs,
}

/// Parser of a taper from its name in a spec.
fn taper() -> impl TypedValueParser<Value = MapTaper> {
    let read = |word: String| MapTaper::read(&Literal::Text(word)).ok_or("it is not a taper");
    PossibleValuesParser::new(MapTaper::WORDS).try_map(read)
}

/// Prints one row of CSV for each ring of wavenumbers.
pub fn run(args: &SpectrumArgs) -> Result<(), ExitReason> {
    args.threads.run(|| {
        let map = args.input.read(&args.map)?;
        map.check_anomaly().map_err(Fault::from)?;
        let found = MapPowerSpectrum::new(&map.plane(), args.taper);
        let found = found.map_err(|e| of_file(&args.map, Fault::data(e.to_string()).help("use `magline map fill`")))?;
        let mut text = "wavenumber_per_m,wavelength_m,density_nt2_m2,waves\n".to_owned();
        for ring in &found.rings {
            let (k, density) = (ring.wavenumber_per_m, ring.density);
            text += &format!("{k:e},{:.3},{density:e},{}\n", 1.0 / k, ring.waves);
        }
        say(text)
    })
}
