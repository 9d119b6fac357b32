//! The aircraft field: the Tolles-Lawson terms and their fit to a flight.
//!
//! | Module | Contents |
//! |:--|:--|
//! | [`tolles_lawson`] | the Tolles-Lawson matrix, its groups of terms and their names |
//! | [`model_terms`] | terms of extended models: inputs along the field, the core field, the slope of the anomaly |
//! | [`attitude_terms`] | direction cosines and products of sines and cosines of the attitude |
//! | [`diagnostics`] | weakly excited terms, the trivial solution, the scatter of calibrations |
//! | [`figure_of_merit`] | the manoeuvres of a calibration box and Noriega's figure of merit |
//!
//! The coefficients are fitted with [`regression`](crate::regression). Usually terms and scalar are first band-passed
//! by the same [filter](crate::signal::filter).
//!
//! # Equations
//!
//! The aircraft's field at the magnetometer has a permanent part, a part induced by the field B, and a part from eddy
//! currents driven by the change of B. With B̂ = B/B_t and the reading B_t of the scalar magnetometer, to first order
//! [Tolles & Lawson 1950; Leliak 1961; Gnadt 2022, (3.13)-(3.22)]
//!
//! ```text
//! F = a + b B + c Ḃ
//! B_t − B_e = F·B̂ = Σ βₖ Aₖ
//!
//! permanent    B̂_i            i = x, y, z                       3 terms
//! induced      B̂_i B_j/s      i ≤ j                             6
//! eddy         B̂_i Ḃ_j/s      all i, j                          9
//! derivative   Ḃ_i                                              3
//! bias         1                                                1
//! ```
//!
//! with the scale s = 50,000 nT ([`DEFAULT_SCALE_NT`]) and the central difference Ḃ per sample. A term xy of the
//! induced field is the sum b_xy + b_yx, because a scalar magnetometer cannot separate the two. The band-pass removes
//! the slowly varying part of the earth's field B_e.
//!
//! Differences from the published equations: Gnadt 2022 (3.20) omits s, but its Tables 3.1 and 3.2 and its ridge
//! parameter of 0.025 include it. In its (3.16) and (3.19) the dots of the eddy terms are missing or misplaced: the
//! terms contain the rate of the vector, not |B| times the rate of the unit vector.
//!
//! The band-passed equations also have the trivial solution a = 0, b = 1, c = 0, which attributes the whole field to
//! the aircraft. [`trivial_solution`] measures the distance of a fit from it [van der Meer 2025, 4.2.1]. The error of
//! the linear form itself is at most [van der Meer 2025, section 4.1]
//!
//! ```text
//! (|a| + ‖b‖ B)²/(2 B)
//! ```
//!
//! # Example
//!
//! ```
//! use nalgebra::Vector3;
//! use numerics::compensation::{
//!     BodyFieldColumns, DEFAULT_SCALE_NT, TermSelection, approximation_bound_nt, tolles_lawson,
//! };
//! use numerics::earth::body_to_ned;
//!
//! // Level flight north, east and south in a field of 50,000 nT that dips by 60° to the north.
//! let dip_rad = 60_f64.to_radians();
//! let field_nt = Vector3::new(dip_rad.cos(), 0.0, dip_rad.sin()) * 50_000.0;
//! let yaw_rad = [0.0_f64, 90.0, 180.0].map(f64::to_radians);
//! let body = yaw_rad.map(|yaw_rad| body_to_ned(0.0, 0.0, yaw_rad).transpose() * field_nt);
//! let [x, y, z] = [0, 1, 2].map(|axis| body.map(|b| b[axis]));
//! let terms = TermSelection::new(&["permanent", "induced"])?;
//! let a = tolles_lawson::matrix(&BodyFieldColumns { x: &x, y: &y, z: &z, bt: None }, &terms, DEFAULT_SCALE_NT)?;
//!
//! // The cosines of the heading times cos I = 1/2, sin I below, and their products.
//! assert_eq!(terms.names(), ["x", "y", "z", "xx", "xy", "xz", "yy", "yz", "zz"]);
//! let s = 0.75_f64.sqrt();
//! let expected = [
//!     [0.5, 0.0, s, 0.25, 0.0, 0.5 * s, 0.0, 0.0, 0.75],
//!     [0.0, -0.5, s, 0.0, 0.0, 0.0, 0.25, -0.5 * s, 0.75],
//!     [-0.5, 0.0, s, 0.25, 0.0, -0.5 * s, 0.0, 0.0, 0.75],
//! ];
//! assert!(a.iter().zip(expected.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-12));
//!
//! // The published error of the linear form: 0.4 nT for 200 nT in 50,000 nT.
//! assert!((approximation_bound_nt([200.0, 0.0, 0.0], [0.0; 6], 50_000.0) - 0.4).abs() < 1e-12);
//! # Ok::<(), tolles_lawson::AMatrixError>(())
//! ```

pub mod attitude_terms;
pub mod diagnostics;
pub mod figure_of_merit;
pub mod model_terms;
pub mod tolles_lawson;

pub use attitude_terms::AttitudeColumns;
pub use diagnostics::{Excitation, TrivialSolution, approximation_bound_nt, excitation, trivial_solution};
pub use model_terms::{AnomalySlopeModel, core_term_names, core_terms, extended_terms};
pub use tolles_lawson::{AMatrixError, BodyFieldColumns, DEFAULT_SCALE_NT, TermSelection};
