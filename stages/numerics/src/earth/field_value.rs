//! The value of a scalar field at a position, with its gradient.

use std::ops::Add;

/// Value of a field and its gradient with respect to position, for the measurement Jacobian.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FieldValue {
    /// The value, in nT.
    pub value_nt: f64,
    /// Derivative with respect to latitude, in nT/rad.
    pub d_lat_nt_per_rad: f64,
    /// Derivative with respect to longitude, in nT/rad.
    pub d_lon_nt_per_rad: f64,
    /// Derivative with respect to height, in nT/m; zero for a map of one level.
    pub d_alt_nt_per_m: f64,
}

impl Add for FieldValue {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            value_nt: self.value_nt + other.value_nt,
            d_lat_nt_per_rad: self.d_lat_nt_per_rad + other.d_lat_nt_per_rad,
            d_lon_nt_per_rad: self.d_lon_nt_per_rad + other.d_lon_nt_per_rad,
            d_alt_nt_per_m: self.d_alt_nt_per_m + other.d_alt_nt_per_m,
        }
    }
}
