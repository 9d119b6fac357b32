//! The scalar measurement: its Jacobian, the gain, and the covariance after it.

use crate::numerics::field_value::FieldValue;
use crate::numerics::pinson::{ALT, LAT, LON, S, STATES, StateMatrix, StateVector};
use crate::numerics::transition::{add_scaled, mirror_upper};

/// The row H of the measurement, which has entries for position and S only.
/// [thesis 000 (5.37), with the 1 of S that is missing in print]
pub(super) struct Sensitivity {
    d_lat: f64,
    d_lon: f64,
    d_alt: f64,
}

/// The gain K = P Hᵀ / (H P Hᵀ + R) and what it came from.
pub(super) struct Gain {
    pub(super) gain: StateVector,
    pub(super) innovation_variance: f64,
    /// P Hᵀ.
    covariance_with_measurement: StateVector,
}

impl Sensitivity {
    pub(super) fn of(field: &FieldValue) -> Self {
        Self { d_lat: field.d_lat_nt_per_rad, d_lon: field.d_lon_nt_per_rad, d_alt: field.d_alt_nt_per_m }
    }

    /// H v.
    #[inline(always)]
    fn dot(&self, v: &StateVector) -> f64 {
        self.d_lat * v[LAT] + self.d_lon * v[LON] + self.d_alt * v[ALT] + v[S]
    }

    #[inline(always)]
    pub(super) fn gain(&self, p: &StateMatrix, variance: f64) -> Gain {
        let mut ph = [0.0; STATES];
        add_scaled(&mut ph, self.d_lat, &p[LAT]);
        add_scaled(&mut ph, self.d_lon, &p[LON]);
        add_scaled(&mut ph, self.d_alt, &p[ALT]);
        add_scaled(&mut ph, 1.0, &p[S]);
        let innovation_variance = self.dot(&ph) + variance;
        let gain = ph.map(|entry| entry / innovation_variance);
        Gain { gain, innovation_variance, covariance_with_measurement: ph }
    }

    /// Joseph's form (I - K H) P (I - K H)ᵀ + K R Kᵀ, as A = P - K (P Hᵀ)ᵀ and then
    /// A + (R K - A Hᵀ) Kᵀ, made exactly symmetric.
    #[inline(always)]
    pub(super) fn update_covariance(&self, p: &mut StateMatrix, gain: &Gain, variance: f64) {
        for (row, factor) in p.iter_mut().zip(&gain.gain) {
            add_scaled(row, -factor, &gain.covariance_with_measurement);
        }
        for (row, factor) in p.iter_mut().zip(&gain.gain) {
            let correction = variance * factor - self.dot(row);
            add_scaled(row, correction, &gain.gain);
        }
        mirror_upper(p);
    }
}
