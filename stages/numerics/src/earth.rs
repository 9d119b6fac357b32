//! The earth: its shape, its core field, attitudes relative to it, and dates.
//!
//! | Module | Contents |
//! |:--|:--|
//! | [`geodesy`] | the WGS-84 ellipsoid; metres to radians of latitude and longitude and back |
//! | [`core_field`] | IGRF-14 and WMM: vector, magnitude and gradient, at one date or along a track |
//! | [`attitude`] | Euler angles, direction cosine matrices, and the tilt between two of them |
//! | [`dates`] | calendar dates as decimal years |
//! | [`field_value`] | the value of a scalar field with its gradient |
//!
//! # Equations
//!
//! The ellipsoid has semi-major axis a and eccentricity e. At latitude φ the radii of curvature of the ellipsoid are M
//! along the meridian and N across it. A small displacement at height h is [Titterton & Weston 2004, chapter 3]
//!
//! ```text
//! M = a (1 − e²)/(1 − e² sin²φ)^(3/2)      δnorth = (M + h) δφ
//! N = a/√(1 − e² sin²φ)                    δeast  = (N + h) cos φ δλ
//! ```
//!
//! MagNav.jl uses N, without h, for both directions; [`EarthModel::Compatible`] does the same.
//!
//! The core field is the gradient of a sum of spherical harmonics in the geocentric radius r, colatitude θ and
//! longitude λ. The reference radius is 6371.2 km. The coefficients g and h are linear in time between epochs [Blakely
//! 1996, chapter 8; IAGA, doi:10.5281/zenodo.14012302]
//!
//! ```text
//! V = R Σₙ (R/r)^(n+1) Σₘ (gₙᵐ cos mλ + hₙᵐ sin mλ) Pₙᵐ(cos θ),      B = −∇V
//! ```
//!
//! The matrix from body to north-east-down for roll φ, pitch θ and yaw ψ is [Titterton & Weston 2004, (3.47)]
//!
//! ```text
//!     ⎡ cθ cψ   sφ sθ cψ − cφ sψ   cφ sθ cψ + sφ sψ ⎤
//! C = ⎢ cθ sψ   sφ sθ sψ + cφ cψ   cφ sθ sψ − sφ cψ ⎥
//!     ⎣ −sθ     sφ cθ              cφ cθ            ⎦
//! ```
//!
//! # Example
//!
//! ```
//! use numerics::earth::{CoreField, CoreFieldModel, EarthModel, body_to_ned, decimal_year};
//!
//! // A degree of latitude and of longitude at the equator, in metres.
//! let (north_m, east_m) = EarthModel::Wgs84.north_east_m_per_rad(0.0, 0.0);
//! assert!((north_m.to_radians() - 110_574.3).abs() < 0.1);
//! assert!((east_m.to_radians() - 111_319.5).abs() < 0.1);
//!
//! // The first test value that NOAA publishes for WMM2025: 89° N, 121° W, 28 km.
//! let field = CoreField::new(CoreFieldModel::Wmm, decimal_year(2025, 1, 0.0)?)?;
//! let [north_nt, east_nt, down_nt] = field.field_ned_nt(89.0, -121.0, 28e3);
//! assert!((north_nt + 255.388_723).abs() < 1e-3);
//! assert!((east_nt + 1482.460_628).abs() < 1e-3);
//! assert!((down_nt - 56_194.288_771).abs() < 1e-3);
//!
//! // Heading east, the nose (1, 0, 0) points east and the right wing (0, 1, 0) south.
//! let c = body_to_ned(0.0, 0.0, 90_f64.to_radians());
//! assert!((c[(1, 0)] - 1.0).abs() < 1e-12 && (c[(0, 1)] + 1.0).abs() < 1e-12);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod attitude;
pub mod core_field;
pub mod dates;
pub mod field_value;
pub mod geodesy;

pub use attitude::{body_to_ned, euler_rad};
pub use core_field::{CoreField, CoreFieldError, CoreFieldModel, CoreFieldTrack};
pub use dates::decimal_year;
pub use field_value::FieldValue;
pub use geodesy::EarthModel;
