//! magline with an additional stage, model, filter and metric.

mod dead_reckoning;
mod detrend;
mod final_error;
mod uniform_shrinkage;

use std::process::ExitCode;

fn main() -> ExitCode {
    let mut catalogue = pipeline::Catalogue::default();
    catalogue.stages.push(detrend::Detrend::entry());
    catalogue.models.push(&uniform_shrinkage::UniformShrinkage::MODEL);
    catalogue.filters.push(&dead_reckoning::DeadReckoning::FILTER);
    catalogue.metrics.push(&final_error::FINAL_ERROR);
    pipeline::main(&catalogue.entries())
}
