//! Every built-in stage of magline, one file each.
//!
//! A stage file reads top to bottom: declaration, the columns it reads and makes, the run, tests. The mathematics is
//! in the crate `numerics`; the stage borrows columns, calls one routine, and wraps the answer. A new stage is one file here
//! and one line in [`catalogue`].

mod a_matrix;
mod bandpass;
mod columns;
mod compensate;
mod core_field;
mod dates;
mod features;
mod fit;
mod made_map;
mod magnitude;
pub mod map_continue;
pub mod map_convert;
mod map_errors;
pub mod map_fill;
pub mod map_grid;
mod map_value;
mod maps;
mod navigate;
mod noise;
mod resample;
mod score;
mod summary;
mod target;

use schemas::Entry;

/// Every built-in stage, in the order of the reference.
pub fn catalogue() -> Vec<Entry> {
    vec![
        resample::Resample::entry(),
        core_field::CoreFieldStage::entry(),
        bandpass::Bandpass::entry(),
        magnitude::Magnitude::entry(),
        a_matrix::AMatrix::entry(),
        features::Features::entry(),
        target::Target::entry(),
        Entry { more: fit::reference, ..fit::Fit::entry() },
        compensate::Compensate::entry(),
        noise::ResidualNoise::entry(),
        noise::AssumeNoise::entry(),
        navigate::Navigate::entry(),
        map_value::MapValue::entry(),
        map_grid::MapGrid::entry(),
        map_fill::MapFill::entry(),
        map_continue::MapContinue::entry(),
        map_convert::MapConvert::entry(),
        Entry { metrics: score::METRICS, ..score::Score::entry() },
        Entry { metrics: summary::METRICS, ..summary::Summary::entry() },
    ]
}
