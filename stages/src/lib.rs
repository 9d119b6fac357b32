//! Every built-in stage of magline, one file each.
//!
//! A stage file contains, in this order: the declaration, the columns that the stage reads and makes, the run, and
//! tests. The mathematics is in the crate `numerics`. A new stage is one file here and one line in [`catalogue`].

mod a_matrix;
mod bandpass;
mod columns;
mod compensate;
mod core_field;
mod corrections;
mod dates;
mod derivative;
mod derive;
mod despike;
mod diurnal;
mod features;
mod filtered;
pub mod fit;
mod fitted;
mod fogm_noise;
mod importance;
mod join;
mod lag;
mod lowpass;
mod made_map;
mod magnitude;
pub mod map_continue;
pub mod map_convert;
mod map_errors;
pub mod map_fill;
pub mod map_grid;
mod map_quality;
mod map_value;
pub mod map_vector;
mod maps;
mod model_columns;
pub mod navigate;
mod noise;
mod noise_network;
mod notch;
mod resample;
pub mod score;
mod segments;
mod select;
mod simulate_ins;
pub mod summary;
mod target;
#[cfg(test)]
mod testing;
mod track_map;
pub mod trained;
mod whole_numbers;

use schemas::StageEntry;

/// Stages, models, filters and metrics of a program. [`Catalogue::default`] holds the built-in ones. A program with
/// other stages, models, filters or metrics adds them and passes on [`Catalogue::entries`].
///
/// ```
/// let catalogue = stages::Catalogue::default();
/// assert!(catalogue.entries().iter().any(|entry| entry.name == "navigate"));
/// ```
pub struct Catalogue {
    /// Models of `fit`.
    pub models: Vec<&'static fit::FitModelDecl>,
    /// Filters of `navigate`.
    pub filters: Vec<&'static navigate::FilterDecl>,
    /// Metrics of `score`.
    pub metrics: Vec<&'static score::Scorer>,
    /// Stages in addition to the built-in ones.
    pub stages: Vec<StageEntry>,
}

impl Default for Catalogue {
    fn default() -> Catalogue {
        Catalogue {
            models: fit::MODELS.to_vec(),
            filters: navigate::FILTERS.to_vec(),
            metrics: score::metrics::SCORERS.to_vec(),
            stages: vec![],
        }
    }
}

impl Catalogue {
    /// Every stage, in the order of the reference.
    pub fn entries(&self) -> Vec<StageEntry> {
        let built_in = [
            resample::Resample::entry(),
            core_field::CoreFieldStage::entry(),
            simulate_ins::SimulateIns::entry(),
            bandpass::Bandpass::entry(),
            lowpass::Lowpass::entry(),
            notch::Notch::entry(),
            derivative::Derivative::entry(),
            despike::Despike::entry(),
            derive::Derive::entry(),
            select::Select::entry(),
            join::Join::entry(),
            lag::LagStage::entry(),
            diurnal::Diurnal::entry(),
            segments::Segments::entry(),
            magnitude::Magnitude::entry(),
            a_matrix::AMatrix::entry(),
            features::Features::entry(),
            target::Target::entry(),
            fit::entry(self.models.clone()),
            compensate::Compensate::entry(),
            importance::Importance::entry(),
            noise::ResidualNoise::entry(),
            noise::AssumeNoise::entry(),
            fogm_noise::FogmNoise::entry(),
            noise_network::NoiseNetworkStage::entry(),
            navigate::entry(self.filters.clone()),
            map_value::MapValue::entry(),
            map_quality::MapQuality::entry(),
            map_grid::MapGrid::entry(),
            track_map::TrackMap::entry(),
            map_fill::MapFill::entry(),
            map_continue::MapContinue::entry(),
            map_convert::MapConvert::entry(),
            map_vector::MapVector::entry(),
            score::entry(self.metrics.clone()),
            summary::entry(self.metrics.clone()),
        ];
        built_in.into_iter().chain(self.stages.iter().cloned()).collect()
    }
}

/// Every built-in stage, in the order of the reference.
pub fn catalogue() -> Vec<StageEntry> {
    Catalogue::default().entries()
}
