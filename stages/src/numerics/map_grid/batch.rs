//! Look-ups of many places at once.

use super::{AnomalyMap, MapError};
use crate::numerics::field_value::FieldValue;

/// Values and gradients of many places, a column each; NaN where the map has none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FieldColumns {
    /// The values, in nT.
    pub value_nt: Vec<f64>,
    /// Changes with latitude, in nT/rad.
    pub d_lat_nt_per_rad: Vec<f64>,
    /// Changes with longitude, in nT/rad.
    pub d_lon_nt_per_rad: Vec<f64>,
    /// Changes with height, in nT/m.
    pub d_alt_nt_per_m: Vec<f64>,
}

impl FieldColumns {
    /// How many places there are.
    pub fn len(&self) -> usize {
        self.value_nt.len()
    }

    /// Whether there are no places.
    pub fn is_empty(&self) -> bool {
        self.value_nt.is_empty()
    }

    /// Fills the columns with `look_up` of each of `n` places; what they held before is dropped, their memory kept.
    #[inline(always)]
    fn fill(&mut self, n: usize, look_up: impl Fn(usize) -> Option<FieldValue>) {
        let Self { value_nt, d_lat_nt_per_rad, d_lon_nt_per_rad, d_alt_nt_per_m } = self;
        for column in [&mut *value_nt, d_lat_nt_per_rad, d_lon_nt_per_rad, d_alt_nt_per_m] {
            column.resize(n, 0.0);
        }
        let gradient = d_lat_nt_per_rad.iter_mut().zip(d_lon_nt_per_rad).zip(d_alt_nt_per_m);
        for (place, (value, ((d_lat, d_lon), d_alt))) in value_nt.iter_mut().zip(gradient).enumerate() {
            let at = look_up(place).unwrap_or(NOWHERE);
            (*value, *d_lat) = (at.value_nt, at.d_lat_nt_per_rad);
            (*d_lon, *d_alt) = (at.d_lon_nt_per_rad, at.d_alt_nt_per_m);
        }
    }
}

const NOWHERE: FieldValue =
    FieldValue { value_nt: f64::NAN, d_lat_nt_per_rad: f64::NAN, d_lon_nt_per_rad: f64::NAN, d_alt_nt_per_m: f64::NAN };

/// The places of a batch, in degrees and metres; `alt_m` is empty where none is asked for.
#[derive(Clone, Copy)]
pub(in crate::numerics) struct Places<'a> {
    pub(in crate::numerics) lat_deg: &'a [f64],
    pub(in crate::numerics) lon_deg: &'a [f64],
    pub(in crate::numerics) alt_m: &'a [f64],
}

impl Places<'_> {
    pub(in crate::numerics) fn check(&self, with_alt: bool) -> Result<(), MapError> {
        let (lat, lon) = (self.lat_deg.len(), self.lon_deg.len());
        let alt = if with_alt { self.alt_m.len() } else { lat };
        if lat != lon || lat != alt { Err(MapError::Places { lat, lon, alt }) } else { Ok(()) }
    }
}

/// A batch in the form in which it is compiled for the vector width of each processor; the same arithmetic in the
/// same order on all of them, so the same bits as one look-up at a time.
pub(in crate::numerics) struct Batch<'a, F> {
    pub(in crate::numerics) places: Places<'a>,
    pub(in crate::numerics) out: &'a mut FieldColumns,
    /// Of latitude, longitude and height; the height is 0 where the places have none.
    pub(in crate::numerics) look_up: F,
}

impl<F: Fn(f64, f64, f64) -> Option<FieldValue>> pulp::NullaryFnOnce for Batch<'_, F> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Places { lat_deg, lon_deg, alt_m } = self.places;
        self.out.fill(lat_deg.len(), |place| {
            let alt = alt_m.get(place).copied().unwrap_or(0.0);
            (self.look_up)(*lat_deg.get(place)?, *lon_deg.get(place)?, alt)
        });
    }
}

impl AnomalyMap {
    /// [`Self::at`] for many places in degrees; places without a value are NaN. Allocates only where `out` has to
    /// grow, and runs on the caller's thread.
    pub fn at_many(&self, lat_deg: &[f64], lon_deg: &[f64], out: &mut FieldColumns) -> Result<(), MapError> {
        let places = Places { lat_deg, lon_deg, alt_m: &[] };
        places.check(false)?;
        pulp::Arch::new().dispatch(Batch { places, out, look_up: |lat, lon, _| self.at(lat, lon) });
        Ok(())
    }

    /// [`Self::at_height`] for many places in degrees and metres; places without a value are NaN.
    pub fn at_heights(
        &self,
        lat_deg: &[f64],
        lon_deg: &[f64],
        alt_m: &[f64],
        out: &mut FieldColumns,
    ) -> Result<(), MapError> {
        let places = Places { lat_deg, lon_deg, alt_m };
        places.check(true)?;
        pulp::Arch::new().dispatch(Batch { places, out, look_up: |lat, lon, alt| self.at_height(lat, lon, alt) });
        Ok(())
    }
}
