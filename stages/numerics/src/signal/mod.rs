//! Evenly sampled signals: filters, derivatives, resampling, spectra, gaps and noise.

pub mod difference;
pub mod filter;
pub mod gauss_markov;
pub mod natural_cubic;
pub mod noise;
pub mod resample;
pub mod segments;
pub mod spectrum;
