//! Batch look-ups of many positions.

use super::{CellPosition, MapGridError, MapSurface};
use crate::earth::field_value::FieldValue;

/// Values and gradients of many positions, one column each; NaN where the map is undefined.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FieldColumns {
    /// The values, in nT.
    pub value_nt: Vec<f64>,
    /// Derivatives with respect to latitude, in nT/rad.
    pub d_lat_nt_per_rad: Vec<f64>,
    /// Derivatives with respect to longitude, in nT/rad.
    pub d_lon_nt_per_rad: Vec<f64>,
    /// Derivatives with respect to height, in nT/m.
    pub d_alt_nt_per_m: Vec<f64>,
}

impl FieldColumns {
    /// The number of positions.
    pub fn len(&self) -> usize {
        self.value_nt.len()
    }

    /// Whether there are no positions.
    pub fn is_empty(&self) -> bool {
        self.value_nt.is_empty()
    }

    pub(crate) fn resize(&mut self, n: usize) {
        let Self { value_nt, d_lat_nt_per_rad, d_lon_nt_per_rad, d_alt_nt_per_m } = self;
        for column in [value_nt, d_lat_nt_per_rad, d_lon_nt_per_rad, d_alt_nt_per_m] {
            column.resize(n, 0.0);
        }
    }

    /// Sets the field of position `i`; `None` is stored as NaN.
    pub(crate) fn set(&mut self, i: usize, field: Option<FieldValue>) {
        let field = field.unwrap_or(NOWHERE);
        self.value_nt[i] = field.value_nt;
        self.d_lat_nt_per_rad[i] = field.d_lat_nt_per_rad;
        self.d_lon_nt_per_rad[i] = field.d_lon_nt_per_rad;
        self.d_alt_nt_per_m[i] = field.d_alt_nt_per_m;
    }

    /// The columns in blocks of at most [`BLOCK`] positions.
    fn blocks(&mut self) -> impl Iterator<Item = [&mut [f64]; 4]> {
        let value_and_lat = self.value_nt.chunks_mut(BLOCK).zip(self.d_lat_nt_per_rad.chunks_mut(BLOCK));
        let lon_and_alt = self.d_lon_nt_per_rad.chunks_mut(BLOCK).zip(self.d_alt_nt_per_m.chunks_mut(BLOCK));
        value_and_lat.zip(lon_and_alt).map(|((value, d_lat), (d_lon, d_alt))| [value, d_lat, d_lon, d_alt])
    }
}

/// Number of positions whose nodes are prefetched before the first of them is used. The number is large enough to keep
/// the memory busy, and small enough for the cache lines to fit the innermost cache.
const BLOCK: usize = 64;

const NOWHERE: FieldValue =
    FieldValue { value_nt: f64::NAN, d_lat_nt_per_rad: f64::NAN, d_lon_nt_per_rad: f64::NAN, d_alt_nt_per_m: f64::NAN };

/// Positions of a batch, in degrees and metres; `alt_m` is empty if heights are not used.
#[derive(Clone, Copy)]
pub(crate) struct LookupPositions<'a> {
    pub(crate) lat_deg: &'a [f64],
    pub(crate) lon_deg: &'a [f64],
    pub(crate) alt_m: &'a [f64],
}

impl LookupPositions<'_> {
    pub(crate) fn check(&self, with_alt: bool) -> Result<(), MapGridError> {
        let (lat, lon) = (self.lat_deg.len(), self.lon_deg.len());
        let alt = if with_alt { self.alt_m.len() } else { lat };
        if lat != lon || lat != alt { Err(MapGridError::Places { lat, lon, alt }) } else { Ok(()) }
    }
}

/// Field look-up by cell and height, for batches; heights are 0 if the positions have no heights.
pub(crate) trait FieldLookup {
    /// The cell of a position in degrees.
    fn cell(&self, lat_deg: f64, lon_deg: f64) -> Option<CellPosition>;
    /// Prefetches the data that [`Self::field`] reads.
    fn touch(&self, cell: CellPosition, alt_m: f64) -> f64;
    /// Value and gradient.
    fn field(&self, cell: CellPosition, alt_m: f64) -> Option<FieldValue>;
}

/// Looks up many positions; `out` is cleared but keeps its memory.
pub(crate) fn look_up_many(
    map: &impl FieldLookup,
    places: LookupPositions<'_>,
    with_alt: bool,
    out: &mut FieldColumns,
) -> Result<(), MapGridError> {
    places.check(with_alt)?;
    out.resize(places.lat_deg.len());
    pulp::Arch::new().dispatch(LookupBatch { map, places, out });
    Ok(())
}

/// A batch, compiled for the vector width of each processor. The operations and their order are the same for all vector
/// widths, so the results are bit-identical to single look-ups.
struct LookupBatch<'a, M> {
    map: &'a M,
    places: LookupPositions<'a>,
    out: &'a mut FieldColumns,
}

impl<M: FieldLookup> pulp::NullaryFnOnce for LookupBatch<'_, M> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let LookupPositions { lat_deg, lon_deg, alt_m } = self.places;
        let mut cells = [None; BLOCK];
        for (block, [value, d_lat, d_lon, d_alt]) in self.out.blocks().enumerate() {
            let start = block * BLOCK;
            let alt_of = |k: usize| alt_m.get(start + k).copied().unwrap_or(0.0);
            for (cell, (lat, lon)) in cells.iter_mut().zip(lat_deg.iter().zip(lon_deg).skip(start)) {
                *cell = self.map.cell(*lat, *lon);
            }
            // A separate loop, short enough for the processor to issue loads far ahead.
            let mut touched = 0.0;
            for (k, cell) in cells.iter().enumerate().take(value.len()) {
                if let Some(cell) = cell {
                    touched += self.map.touch(*cell, alt_of(k));
                }
            }
            // The sum is not used; computing it prefetches the data.
            std::hint::black_box(touched);
            for (k, cell) in cells.iter().enumerate().take(value.len()) {
                let at = cell.and_then(|cell| self.map.field(cell, alt_of(k))).unwrap_or(NOWHERE);
                (value[k], d_lat[k]) = (at.value_nt, at.d_lat_nt_per_rad);
                (d_lon[k], d_alt[k]) = (at.d_lon_nt_per_rad, at.d_alt_nt_per_m);
            }
        }
    }
}

/// Look-up at a map's own level, regardless of the height.
struct OwnLevelLookup<'a>(&'a MapSurface);

impl FieldLookup for OwnLevelLookup<'_> {
    #[inline(always)]
    fn cell(&self, lat_deg: f64, lon_deg: f64) -> Option<CellPosition> {
        self.0.axes.cell(lat_deg, lon_deg)
    }

    #[inline(always)]
    fn touch(&self, cell: CellPosition, _: f64) -> f64 {
        self.0.touch(cell)
    }

    #[inline(always)]
    fn field(&self, cell: CellPosition, _: f64) -> Option<FieldValue> {
        self.0.on_map(cell)
    }
}

/// Look-up of a map, extrapolated to first order in height.
struct HeightLookup<'a>(&'a MapSurface);

impl FieldLookup for HeightLookup<'_> {
    #[inline(always)]
    fn cell(&self, lat_deg: f64, lon_deg: f64) -> Option<CellPosition> {
        self.0.axes.cell(lat_deg, lon_deg)
    }

    #[inline(always)]
    fn touch(&self, cell: CellPosition, _: f64) -> f64 {
        self.0.touch(cell)
    }

    #[inline(always)]
    fn field(&self, cell: CellPosition, alt_m: f64) -> Option<FieldValue> {
        self.0.off_map(cell, alt_m)
    }
}

impl MapSurface {
    /// Same as [`Self::at`], for many positions in degrees; positions without a value are NaN. Allocates only where
    /// `out` has to grow, and runs on the caller's thread. Faster than single look-ups if the map does not fit the
    /// cache, especially for scattered positions.
    ///
    /// # Errors
    /// Fails with [`MapGridError::Places`] for columns of different lengths.
    pub fn at_many(&self, lat_deg: &[f64], lon_deg: &[f64], out: &mut FieldColumns) -> Result<(), MapGridError> {
        look_up_many(&OwnLevelLookup(self), LookupPositions { lat_deg, lon_deg, alt_m: &[] }, false, out)
    }

    /// Same as [`Self::at_height`], for many positions in degrees and metres; positions without a value are NaN.
    ///
    /// # Errors
    /// Fails with [`MapGridError::Places`] for columns of different lengths.
    pub fn at_heights(
        &self,
        lat_deg: &[f64],
        lon_deg: &[f64],
        alt_m: &[f64],
        out: &mut FieldColumns,
    ) -> Result<(), MapGridError> {
        look_up_many(&HeightLookup(self), LookupPositions { lat_deg, lon_deg, alt_m }, true, out)
    }
}
