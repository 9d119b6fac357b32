//! magline with one more stage.

mod detrend;

use std::process::ExitCode;

fn main() -> ExitCode {
    let mut catalogue = pipeline::catalogue();
    catalogue.push(detrend::Detrend::entry());
    pipeline::main(&catalogue)
}
