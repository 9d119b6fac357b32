//! Inertial navigation, its errors, and filters that correct it with the anomaly field.
//!
//! | Module | Contents |
//! |:--|:--|
//! | [`ins_series`] | the output of an INS along a line, as columns |
//! | [`ekf`] | the 18-state extended Kalman filter, over one line or several at once |
//! | [`linearity`] | the largest position uncertainty for which a Kalman filter may linearise the field |
//! | [`line`](mod@line) | a line with its map, the input of the filters, and its steps |
//! | [`map_noise`] | errors of a map's nodes, as measurement noise along a line |
//! | [`field`] | the field that a filter predicts: map and core field |
//! | [`loss`] | loss functions that limit the influence of outliers |
//! | [`output`] | output of a filter on a line |
//! | [`ins_only`] | the INS without measurements, with the covariance of its error |
//! | [`iekf`] | the iterated extended Kalman filter |
//! | [`rts`] | the fixed-interval smoother, iterated to the maximum a posteriori |
//! | [`ukf`] | the unscented Kalman filter |
//! | [`aided`] | these filters with a difference of magnetometers, the field vector and a height in addition to the
//! field |
//! | [`aids`] | further measurements: rows of H, predictions, noise |
//! | [`crlb`] | the posterior Cramér-Rao bound along the true path |
//! | [`adaptive`] | the filter that estimates the measurement noise |
//! | [`nekf`] | the filter with noise set by a recurrent network |
//! | [`online`] | the filter that estimates Tolles-Lawson coefficients in flight |
//! | [`online_nn`] | the same filter with the weights of a small network |
//! | [`fixed_lag`] | the sliding-window smoother with Tolles-Lawson coefficients |
//! | [`mpf`] | the marginalised particle filter, alone or followed by a Kalman filter |
//! | [`stream`] | `ekf`, `ekf_adaptive` and `ekf_online_tl` fed sample by sample |
//! | [`slam`] | navigation without a map, from revisits of the path |
//! | [`track_map`] | the map of a track, by Gaussian-process regression of reduced rank |
//! | [`fix_test`] | a test of aiding positions against the INS |
//! | [`position_fixes`] | aiding positions, such as from GNSS |
//! | [`pinson`] | the states and the matrix F of the error model |
//! | [`transition`] | Φ = exp(F Δt) and the process noise of a step |
//! | [`ins_error`] | error sources and grades of an INS; its errors simulated along a trajectory |
//! | [`mechanisation`] | strapdown mechanisation on the ellipsoid, and the sensor readings of a motion |
//! | [`strapdown`] | velocity, specific force and attitude derived from positions |
//!
//! # Equations
//!
//! The state x is truth minus INS: latitude, longitude (rad), altitude, velocity and tilt north-east-down,
//! accelerometer and gyroscope biases, two states of the barometer, and the temporal variation S of the field. At rest
//! on a sphere of radius R, the rows of F for the Schuler oscillation are [Gnadt 2022, (5.15)-(5.32); Titterton &
//! Weston 2004, chapter 12]
//!
//! ```text
//! ẋ = F x + w
//! δlat' = δv_n/R,   δv_n' = g ψ_e + (C a)_n − 2 Ω sin φ δv_e,   ψ_e' = −δv_n/R − (C b)_e + …
//! ```
//!
//! with the tilt ψ, the accelerometer and gyroscope biases a and b, and the earth's rotation rate Ω. The barometer's
//! gains, which Gnadt 2022 does not print, are those of MagNav.jl ([`pinson::K1`], [`pinson::K2`], [`pinson::K3`]).
//!
//! Starting from P₀, the filter alternates between the measurement z of the scalar field (nT) and the step to the next
//! sample [Brown & Hwang 2012, chapters 4 and 7; Gnadt 2022, section 5.3]
//!
//! ```text
//! h(x) = map(INS + x) + core(INS + x) + S
//! H    = [∂h/∂lat, ∂h/∂lon, ∂h/∂alt, 0 … 0, 1]
//! K    = P Hᵀ/(H P Hᵀ + σ²)
//! x ← x + K (z − h(x)),      P ← (I − K H) P (I − K H)ᵀ + K σ² Kᵀ
//! x ← Φ x,                   P ← Φ P Φᵀ + Q_d,      Q_d = ∫₀^Δt e^(F s) Q e^(Fᵀ s) ds
//! ```
//!
//! Differences from the published equations: Gnadt 2022 (5.37) omits the element 1 for S in H. Its (5.35) gives a
//! spectral density, which must be integrated over a step ([`NoiseDiscretisation`]). A measurement with a constant
//! offset beyond the range of S requires [`EkfParameters::offset_window_s`].
//!
//! # Examples
//!
//! Over a short time, the errors of an INS at rest increase with a power of time that depends on the error source.
//!
//! ```
//! use numerics::earth::geodesy::{SEMI_MAJOR_AXIS_M, STANDARD_GRAVITY_MPS2};
//! use numerics::navigation::pinson::{ACC, GYRO, LAT, VN};
//! use numerics::navigation::{InsErrorModel, InsPoint, PinsonForm, pinson_matrix, transition_matrix};
//!
//! let at_rest = InsPoint {
//!     lat_rad: 45_f64.to_radians(),
//!     force_ned_mps2: [0.0, 0.0, -STANDARD_GRAVITY_MPS2],
//!     ..InsPoint::default()
//! };
//! let f = pinson_matrix(&at_rest, &InsErrorModel::default().time_constants(), PinsonForm::Thesis);
//! let t = 60.0_f64;
//! let phi = transition_matrix(&f, t);
//! let north_m = |source: usize| phi[LAT][source] * SEMI_MAJOR_AXIS_M;
//! // A velocity of 1 m/s, a bias of 1 m/s² of the north accelerometer, and one of 1 rad/s of the east gyroscope. The
//! // Schuler oscillation (84 minutes) and the decay of the biases (3600 s) change them by less than 0.7 %.
//! for (found, expected) in [
//!     (north_m(VN), t),
//!     (north_m(ACC), t.powi(2) / 2.0),
//!     (north_m(GYRO + 1), -STANDARD_GRAVITY_MPS2 * t.powi(3) / 6.0),
//! ] {
//!     assert!((found / expected - 1.0).abs() < 0.007, "{found} {expected}");
//! }
//! ```
//!
//! One measurement over a map of constant slope, with a closed-form solution.
//!
//! ```
//! use numerics::earth::EarthModel;
//! use numerics::maps::{FieldMap, GeographicGrid, MapInterpolation, MapSurface};
//! use numerics::navigation::{EkfParameters, InsErrorModel, InsErrors, InsSeries, ekf};
//!
//! // A map that rises by 0.05 nT a metre northward.
//! let (lat_deg, lon_deg) = ([44.9, 45.0, 45.1], [-76.1, -76.0, -75.9]);
//! let m_per_deg = EarthModel::Wgs84.north_m_per_rad(45_f64.to_radians(), 300.0) / 1_f64.to_degrees();
//! let nodes_nt = lat_deg.map(|lat| [0.05 * m_per_deg * (lat - 45.0); 3]);
//! let grid = GeographicGrid::new(&lat_deg, &lon_deg, nodes_nt.as_flattened())?;
//! let map = FieldMap::Flat(MapSurface::new(&grid, MapInterpolation::Linear));
//!
//! // An INS at rest at 45° N, 76° W, 300 m, known to 100 m; the field is 6 nT above the map's there.
//! let columns = [0.0, 45.0, -76.0, 300.0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.80665, 0.0, 0.0, 0.0].map(|value| [value]);
//! let ins = InsSeries::from_columns(columns.each_ref().map(|column| column.as_slice()));
//! let sources = InsErrors { init_position_sigma_m: 100.0, ..InsErrors::default() };
//! let errors = InsErrorModel { fogm_sigma_nt: 0.0, ..InsErrorModel::from_sources(sources) };
//! let parameters = EkfParameters { errors, measurement_sigma_nt: 5.0, ..EkfParameters::default() };
//! let output = ekf::run(&parameters, &ins, &[6.0], &map, None)?;
//!
//! // 5 nT are 100 m on this map, as uncertain as the INS: the position moves by half of 6/0.05 = 120 m, and its
//! // standard deviation falls to 100/√2 m.
//! assert!(((output.lat_deg[0] - 45.0) * m_per_deg - 60.0).abs() < 1e-3);
//! assert!((output.sd_n_m[0] - 100.0 / 2_f64.sqrt()).abs() < 1e-3);
//! assert!((output.nis[0] - 36.0 / 50.0).abs() < 1e-9);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod adaptive;
pub mod aided;
pub mod aids;
pub mod crlb;
pub mod ekf;
pub mod field;
pub mod fix_test;
pub mod fixed_lag;
#[cfg(test)]
mod flights;
mod gaussian;
pub mod iekf;
pub mod ins_error;
pub mod ins_only;
pub mod ins_series;
pub mod likelihood;
pub mod line;
pub mod linearity;
pub mod loss;
pub mod map_noise;
mod measurement;
pub mod mechanisation;
pub mod mpf;
pub mod nekf;
pub mod online;
pub mod online_nn;
/// Flights over the real Osborne map, shared by the Monte Carlo test and the bench.
#[cfg(test)]
#[path = "../tests/osborne/mod.rs"]
mod osborne;
pub mod output;
pub mod pinson;
pub mod position_fixes;
pub mod rts;
#[cfg(test)]
mod scenes;
pub mod slam;
pub mod strapdown;
pub mod stream;
pub mod track_map;
pub mod transition;
pub mod ukf;

pub use ekf::EkfParameters;
pub use field::PredictedField;
pub use ins_error::{InsErrorModel, InsErrors, InsGrade, simulate_ins_error};
pub use ins_series::{InsSeries, SeriesError};
pub use line::{LineStep, NavigationLine};
pub use mechanisation::{ImuReading, Mechanisation, NavigationEarth, NavigationState};
pub use output::{NavigationError, NavigationOutput, NavigationReport};
pub use pinson::{InsPoint, PinsonForm, StateMatrix, StateVector, TimeConstants, pinson_matrix};
pub use transition::{NoiseDiscretisation, transition_matrix};

#[cfg(test)]
mod aided_tests;
