//! Evenly sampled signals: filters, derivatives, resampling, spectra, gaps and noise.
//!
//! | Module | Contents |
//! |:--|:--|
//! | [`filter`] | zero-phase Butterworth low-, high- and band-passes; notches |
//! | [`spikes`] | outliers of single samples, by a running median or the fourth difference |
//! | [`savitzky_golay`] | values and derivatives of polynomials fitted to a moving window |
//! | [`lag`] | the lag of one signal against another, by cross-correlation |
//! | [`segments`] | runs of usable samples between gaps, each filtered separately; checks of a time column |
//! | [`difference`] | differences per sample, the substitute for time derivatives in Tolles-Lawson terms |
//! | [`resample`] | resampling from arbitrary times to an even grid; low-pass filter before resampling to a lower rate
//! |
//! | [`local_fit`] | smoothing of samples at arbitrary times, by local parabolas |
//! | [`spectrum`] | power spectral density by Welch's method |
//! | [`noise`] | the Allan variance of a line, and the white and Gauss-Markov noise that bound it |
//! | [`gauss_markov`] | the first-order Gauss-Markov process: exponentially correlated noise |
//! | [`natural_cubic`] | natural cubic splines on even steps, as B-spline coefficients |
//!
//! # Equations
//!
//! A Butterworth filter of order n by the bilinear transform is run forwards and backwards. It multiplies the amplitude
//! of a sinusoid of frequency f by G and does not shift its phase [Gustafsson 1996]. With the sample rate f_s and the
//! corners f₁ and f₂,
//!
//! ```text
//! G(f) = 1/(1 + Ω^(2n)),      w(f) = tan(π f/f_s)
//!
//! low-pass    Ω = w(f)/w(f₂)
//! high-pass   Ω = w(f₁)/w(f)
//! band-pass   Ω = (w(f)² − w(f₁) w(f₂))/(w(f) (w(f₂) − w(f₁)))
//! ```
//!
//! so half of the amplitude remains at a corner. MagNav.jl's filter for compensation has n = 4, f₁ = 0.1 Hz and f₂ =
//! 0.9 Hz at 10 Hz.
//!
//! A Gauss-Markov process of standard deviation σ and correlation time τ has the following steps, autocorrelation and
//! driving spectral density [Brown & Hwang 2012]
//!
//! ```text
//! x(t + Δt) = e^(−Δt/τ) x(t) + w,      var w = σ² (1 − e^(−2 Δt/τ))
//! E[x(t) x(t + s)] = σ² e^(−|s|/τ),    q = 2 σ²/τ
//! ```
//!
//! # Example
//!
//! ```
//! use numerics::signal::{FilterBand, ZeroPhaseFilter};
//! use std::f64::consts::{PI, TAU};
//!
//! let (low_hz, high_hz, rate_hz) = (0.1, 0.9, 10.0);
//! let filter = ZeroPhaseFilter::new(FilterBand::Band { low_hz, high_hz }, rate_hz, 4)?;
//! let w = |f_hz: f64| (PI * f_hz / rate_hz).tan();
//! for f_hz in [0.05, 0.1, 0.3, 0.9, 2.0] {
//!     // A sinusoid of 10 nT on a field of 50,000 nT, with a crest in the middle.
//!     let x_nt: Vec<f64> =
//!         (-2000..=2000).map(|k| 50_000.0 + 10.0 * (TAU * f_hz * f64::from(k) / rate_hz).cos()).collect();
//!     let y_nt = filter.apply(&x_nt)?;
//!     let omega = (w(f_hz).powi(2) - w(low_hz) * w(high_hz)) / (w(f_hz) * (w(high_hz) - w(low_hz)));
//!     assert!((y_nt[2000] - 10.0 / (1.0 + omega.powi(8))).abs() < 1e-6);
//! }
//! # Ok::<(), numerics::signal::FilterError>(())
//! ```

pub mod difference;
pub mod filter;
pub mod gauss_markov;
pub mod lag;
pub mod local_fit;
pub mod natural_cubic;
pub mod noise;
pub mod resample;
pub mod savitzky_golay;
pub mod segments;
pub mod spectrum;
pub mod spikes;

pub use filter::{FilterBand, FilterError, ZeroPhaseFilter, band_pass};
pub use gauss_markov::GaussMarkov;
pub use segments::{GapFilterReport, RowMask, TimeError, filter_column, filter_matrix, sample_rate};
pub use spectrum::{SpectralTaper, welch};
