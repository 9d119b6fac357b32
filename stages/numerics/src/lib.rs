//! Numerics of aeromagnetic compensation and magnetic navigation.
//!
//! A magnetometer on an aircraft measures the sum of the earth's field and the aircraft's field. This crate separates
//! the two fields and finds a position from the remaining anomaly. It contains models of the earth's core field,
//! filters, linear regression, maps of the magnetic anomaly, the Tolles-Lawson model, and an inertial error model with
//! an extended Kalman filter. Functions accept slices and matrices and return vectors; the crate reads no files.
//!
//! # Folders
//!
//! A folder depends only on folders above it in this table.
//!
//! | Folder | Contents |
//! |:--|:--|
//! | [`earth`] | the WGS-84 ellipsoid, IGRF-14 and WMM, attitude, dates |
//! | [`signal`] | zero-phase filters, differences, resampling, spectra, gaps, noise |
//! | [`regression`] | least squares, ridge, elastic net, partial least squares, robust and recursive fits |
//! | [`maps`] | gridding, levelling, filling, continuation and look-up of anomaly maps |
//! | [`compensation`] | the Tolles-Lawson matrix, its extensions, diagnostics of a calibration |
//! | [`navigation`] | strapdown mechanisation, the Pinson error model, the 18-state extended Kalman filter |
//!
//! [`earth`], [`signal`] and [`regression`] are independent of each other, as are [`maps`] and [`compensation`].
//! Periodic angles ([`angle`]), inner products ([`inner_product`]), reproducible random numbers ([`random`]) and
//! sources of differences in the last bits ([`arithmetic`]) are outside the folders. Each folder re-exports its most
//! important items; all other items are in its modules.
//!
//! # Example
//!
//! A calibration: the aircraft's permanent and induced fields are estimated from the readings on a circle flown with
//! rolls and pitches. The coefficients are recovered within four standard deviations.
//!
//! ```
//! use nalgebra::Vector3;
//! use numerics::compensation::tolles_lawson::{DEFAULT_SCALE_NT, BodyFieldColumns, TermSelection, matrix};
//! use numerics::{earth::{CoreField, body_to_ned}, random::NormalGenerator, regression::QrAccumulator};
//!
//! // The core field at 45.4° N, 75.7° W and 1000 m, in the body frame of 2000 samples at 10 Hz.
//! let core = CoreField::at(2023.5)?;
//! let core_nt = Vector3::from(core.field_ned_nt(45.4, -75.7, 1000.0));
//! let mut body_nt: [Vec<f64>; 3] = Default::default();
//! for t in (0..2000).map(|k| 0.1 * f64::from(k)) {
//!     let (roll_rad, pitch_rad, yaw_rad) = (0.2 * (0.9 * t).sin(), 0.1 * (0.7 * t).cos(), 0.0314 * t);
//!     let b = body_to_ned(roll_rad, pitch_rad, yaw_rad).transpose() * core_nt;
//!     (0..3).for_each(|axis| body_nt[axis].push(b[axis]));
//! }
//! let [x, y, z] = &body_nt;
//! let terms = TermSelection::new(&["permanent", "induced"])?;
//! let a = matrix(&BodyFieldColumns { x, y, z, bt: None }, &terms, DEFAULT_SCALE_NT)?;
//!
//! // A scalar magnetometer less the core field: what the aircraft adds (nT), and 0.1 nT of noise.
//! let truth = [30.0, -12.0, 8.0, 150.0, -40.0, 20.0, 90.0, 10.0, 60.0];
//! let mut normals = NormalGenerator::new(1);
//! let added = |row: &[f64]| row.iter().zip(truth).map(|(a, c)| a * c).sum::<f64>();
//! let y_nt: Vec<f64> = a.chunks(terms.len()).map(|row| added(row) + 0.1 * normals.draw()).collect();
//!
//! let mut qr = QrAccumulator::new(terms.len(), 1);
//! qr.push(&a, &[&y_nt])?;
//! let path = qr.solve(&[0.0, 0.025], &terms.names())?; // without and with a ridge
//! let covariance = path.covariance(0, 0).ok_or("no such solution")?;
//! for (k, (found, truth)) in path.solutions[0].coefficients[0].iter().zip(truth).enumerate() {
//!     assert!((found - truth).abs() < 4.0 * covariance[10 * k].sqrt());
//! }
//! // The residual is the noise; the ridge shrinks the coefficients and cannot make it smaller.
//! assert!((path.solutions[0].residual_variances[0].sqrt() / 0.1 - 1.0).abs() < 0.05);
//! assert!(path.solutions[1].residual_squares[0] >= path.solutions[0].residual_squares[0]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Conventions
//!
//! - **Units** form the suffix of a name: `_nt`, `_m`, `_s`, `_hz`, `_deg`, `_rad`, `_mps` (m/s), `_mps2` (m/s²),
//!   `_radps` (rad/s), `_nt_per_m`.
//! - **Frames**: the navigation frame is north-east-down, the body frame nose-right-down; `body_to_ned` transforms body
//!   components into north, east and down components. Field components of maps and sources are east-north-up
//!   ([`maps::magnetic_sources`], [`maps::continuation`]).
//! - **Positions** are geodetic latitude and longitude on WGS-84; `alt_m` is the height above the ellipsoid.
//! - **Attitude**: roll is positive right wing down, pitch nose up, yaw clockwise from true north; yaw is applied
//!   first, then pitch, then roll.
//! - **Errors** of an inertial navigation system are truth minus INS. The specific force at rest is (0, 0, −g).
//! - **Missing values** are NaN. A routine excludes and counts such samples, returns NaN there, or rejects them; its
//!   documentation states which. Zero is a valid value.
//! - **Matrices** are slices in row-major order, one row per sample; small matrices of fixed size are nalgebra types or
//!   arrays of arrays. Rows of a grid ascend to the north and columns to the east.
//! - **Statistics**: variances divide by n − 1 unless the item states otherwise. A ridge parameter λ is absolute, not
//!   divided by the number of rows. Differences are per sample, not per second.
//! - **Failure**: a fallible function returns `Result` with a typed error, nearly always an enum whose variants hold
//!   the invalid values. The cases are listed under "Errors". The library does not call `unwrap`, `expect` or `panic!`.
//! - **Determinism**: results are bit-identical for any number of threads (rayon). Random draws require a seed, or a
//!   source of normal deviates from the caller. The last bits may differ between kinds of processors, unless a module
//!   states otherwise; [`arithmetic`] distinguishes such machines.
//!
//! # Sources
//!
//! The documentation of each routine cites the source of its formula and notes errors of the printed formula. Frequent
//! sources:
//!
//! - W. E. Tolles and J. D. Lawson 1950, *Magnetic compensation of MAD equipped aircraft*, Airborne Instruments
//!   Laboratory, report 201-1.
//! - P. Leliak 1961, *Identification and evaluation of magnetic-field sources of magnetic airborne detector equipped
//!   aircraft*, IRE Trans. Aeronautical and Navigational Electronics ANE-8(3), 95-105.
//! - A. R. Gnadt et al. 2020, *Signal enhancement for magnetic navigation challenge problem*, arXiv:2007.12158; A. R.
//!   Gnadt, A. B. Wollaber and A. P. Nielsen 2022, *Derivation and extensions of the Tolles-Lawson model for
//!   aeromagnetic compensation*, arXiv:2212.09899; and the program MagNav.jl, version 1.3.3, whose definitions are
//!   available for comparison of results.
//! - A. J. Canciani 2016, *Absolute positioning using the Earth's magnetic anomaly field*, dissertation, Air Force
//!   Institute of Technology; A. J. Canciani and J. F. Raquet 2017, *Airborne magnetic anomaly navigation*, IEEE
//!   Trans. Aerospace and Electronic Systems 53(1), 67-80.
//! - R. J. Blakely 1996, *Potential Theory in Gravity and Magnetic Applications*, Cambridge University Press.
//! - D. H. Titterton and J. L. Weston 2004, *Strapdown Inertial Navigation Technology*, 2nd edition.
//! - R. G. Brown and P. Y. C. Hwang 2012, *Introduction to Random Signals and Applied Kalman Filtering*, 4th edition.
//!
//! Three theses are cited by number:
//!
//! - Gnadt 2022: A. R. Gnadt 2022, *Advanced Aeromagnetic Compensation Models for Airborne Magnetic Anomaly
//!   Navigation*, PhD, Massachusetts Institute of Technology;
//! - Lee 2019: T. N. Lee 2019, *Aerial Simultaneous Localization and Mapping Using Earth's Magnetic Anomaly Field*,
//!   MS, Air Force Institute of Technology;
//! - van der Meer 2025: F. van der Meer 2025, *Reference-Free Aeromagnetic Platform Noise Compensation for Magnetic
//!   Aided Navigation*, MS, Delft University of Technology.

// The shared test flights refer to the crate by its external name.
#[cfg(test)]
extern crate self as numerics;

pub mod angle;
pub mod arithmetic;
pub mod compensation;
pub mod earth;
pub mod inner_product;
pub mod maps;
pub mod navigation;
pub mod random;
pub mod regression;
pub mod signal;

#[cfg(test)]
mod reference_csv;
