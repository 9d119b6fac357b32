//! Inertial navigation, its errors, and filters that correct it with the anomaly field.

pub mod ekf;
pub mod ins_error;
pub mod ins_series;
pub mod mechanisation;
pub mod pinson;
pub mod strapdown;
pub mod transition;
