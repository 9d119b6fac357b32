//! Maps of the magnetic anomaly: grids, levelling, gridding, filling, continuation, look-up.
//!
//! | Module | Contents |
//! |:--|:--|
//! | [`levelling`] | survey lines levelled by their differences at crossovers |
//! | [`gridding`] | from survey points to a grid: minimum curvature or equivalent sources, with cross-validation |
//! | [`plane_grid`] | a map on a plane: an even grid of eastings and northings in metres |
//! | [`fill`] | gaps filled from the nearest nodes or with a smooth surface; maps trimmed and cropped |
//! | [`combine`] | overlapping maps on one grid, levelled to each other, with feathered edges |
//! | [`continuation`] | maps at other heights; derivatives, field components, drapes, the error of the edges |
//! | [`map_surface`] | a map on latitude and longitude, looked up with its exact gradient |
//! | [`map_stack`] | maps at several heights, draped maps, and [`FieldMap`], an enum of all kinds of map |
//! | [`grid_projection`] | latitude and longitude to the nodes of a projected grid, with derivatives |
//! | [`projection`] | map projections by their PROJ definition |
//! | [`magnetic_sources`] | dipoles and rectangular prisms in closed form |
//! | [`anomaly_retention`] | the fraction of the crustal anomaly that a compensation keeps |
//! | [`information`] | the Cramér-Rao bound of a position along a line on a map |
//! | [`power_spectrum`] | the power spectral density of a map by wavenumber |
//! | [`undersampling`] | the error of a map between its nodes |
//! | [`crossings`] | the misclosure of a line where its track crosses itself |
//!
//! A survey is processed in this order: [`levelling`], [`gridding`], [`fill`], [`continuation`], [`map_surface`].
//!
//! # Equations
//!
//! A field F has all its sources below. At height h above the map, and with k² = k_e² + k_n² from the wavenumbers k_e
//! and k_n along easting and northing (rad/m), its spectrum is [Blakely 1996, (12.8)]
//!
//! ```text
//! F(k, h) = e^(−k h) F(k, 0)
//! F(k, h) = e^(−k h)/(1 + α k² e^(−k h)) F(k, 0)      downward, h < 0, damped by α in m²
//!
//! ∂/∂east = i k_e,   ∂/∂north = i k_n,   ∂/∂up = −k
//! ```
//!
//! MagNav.jl uses α = 200 m² ([`continuation::MAGNAV_ALPHA_M2`]); [`downward`] uses the corner of the L-curve.
//!
//! The anomaly is the component of the sources' field along the unit vector f of the core field B₀. To first order it
//! is the change of the magnitude [Blakely 1996, (8.20)]. The field of a dipole of moment m at distance r is [Blakely
//! 1996, (4.14)]
//!
//! ```text
//! B = µ₀/4π (3 (m·r̂) r̂ − m)/r³,      ΔT = f·B ≈ |B₀ + B| − |B₀|
//! ```
//!
//! Away from the data, minimum curvature with tension T solves [Briggs 1974; Smith & Wessel 1990]
//!
//! ```text
//! (1 − T) ∇²(∇²u) − T ∇²u = 0
//! ```
//!
//! # Example
//!
//! ```
//! use numerics::maps::{EvenAxis, GeographicGrid, MapInterpolation, MapSurface, Padding, PlaneGrid, upward};
//!
//! // Each interpolation returns a plane and its slope.
//! let lat_deg: Vec<f64> = (0..6).map(|k| 45.0 + 0.01 * f64::from(k)).collect();
//! let lon_deg: Vec<f64> = (0..8).map(|k| -76.0 + 0.02 * f64::from(k)).collect();
//! let plane_nt = |lat: f64, lon: f64| 10.0 + 200.0 * (lat - 45.0) - 150.0 * (lon + 76.0);
//! let nodes_nt: Vec<f64> =
//!     lat_deg.iter().flat_map(|lat| lon_deg.iter().map(move |lon| plane_nt(*lat, *lon))).collect();
//! let grid = GeographicGrid::new(&lat_deg, &lon_deg, &nodes_nt)?;
//! for interpolation in [MapInterpolation::Linear, MapInterpolation::Quadratic, MapInterpolation::Cubic] {
//!     let map = MapSurface::new(&grid, interpolation);
//!     let at = map.at(45.023, -75.931).ok_or("off the map")?;
//!     assert!((at.value_nt - plane_nt(45.023, -75.931)).abs() < 1e-9);
//!     assert!((at.d_lat_nt_per_rad - 200.0 * 1_f64.to_degrees()).abs() < 1e-6); // 200 nT a degree
//! }
//!
//! // 300 m higher, a wave of 1000 m along easting has e^(−k h) of its amplitude.
//! let axis = EvenAxis { first: 0.0, step: 50.0, len: 40 };
//! let k = std::f64::consts::TAU / 1000.0;
//! let wave = |amplitude_nt: f64| -> Vec<f64> {
//!     (0..1600).map(|node| amplitude_nt * (k * axis.at(f64::from(node % 40))).cos()).collect()
//! };
//! let map = PlaneGrid { east_m: axis, north_m: axis, values: wave(100.0) };
//! let above = upward(&map, 300.0, &Padding::none())?; // the map is periodic as it is
//! let expected = wave(100.0 * (-k * 300.0).exp());
//! assert!(above.values.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-10));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod anomaly_retention;
pub mod combine;
pub mod continuation;
pub mod crossings;
pub mod fill;
pub mod grid_projection;
pub mod gridding;
pub mod information;
pub mod levelling;
pub mod magnetic_sources;
pub mod map_stack;
pub mod map_surface;
pub mod plane_grid;
pub mod power_spectrum;
pub mod projection;
pub mod undersampling;

pub use continuation::{Padding, downward, upward};
pub use gridding::{GriddingOptions, GriddingResult, SurveyPoints};
pub use levelling::{LevellingOptions, find_crossovers, level_lines};
pub use map_stack::{DrapeMap, FieldMap, MapStack};
pub use map_surface::{FieldColumns, GeographicGrid, MapGridError, MapInterpolation, MapSurface};
pub use plane_grid::{EvenAxis, PlaneGrid};
pub use projection::Projection;
