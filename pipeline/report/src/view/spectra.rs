//! Spectra of the columns of a line.

use schemas::Fault;
use serde_json::{Value, json};

use super::{SeriesRequest, StoreView, ViewFault};
use crate::spectrum::{ColumnSpectrum, amplitude_spectrum};

impl StoreView {
    /// Amplitude spectral densities of the requested columns in the requested interval, from all samples in it, as
    /// JSON. The unit of a density is the unit of the column per √Hz.
    ///
    /// # Errors
    /// Returns the errors of [`StoreView::series`]. Also fails for times that are not evenly spaced.
    pub fn spectrum(&self, request: &SeriesRequest) -> Result<Value, ViewFault> {
        let (tt, columns) = self.samples(request)?;
        let (from, to) = (request.from.unwrap_or(f64::NEG_INFINITY), request.to.unwrap_or(f64::INFINITY));
        let (first, last) = (tt.partition_point(|t| *t < from), tt.partition_point(|t| *t <= to));
        let last = last.max(first);
        let values: Vec<&[f64]> = columns.iter().map(|column| &column.values[first..last]).collect();
        let found = amplitude_spectrum(&tt[first..last], &values).map_err(|e| {
            let fault = Fault::new(format!("this part of the line has no spectrum: {e}"));
            ViewFault::Wrong(fault.help("show a longer part, or add a stage `resample`"))
        })?;
        let described = columns.iter().zip(&found.columns).map(|(column, spectrum)| {
            let ColumnSpectrum { density, segments, left_out, why } = spectrum;
            json!({
                "name": column.name, "unit": column.unit, "density": density, "segments": segments,
                "left_out": left_out, "why": why,
            })
        });
        Ok(json!({
            "rate_hz": found.rate_hz, "segment": found.segment, "rows": last - first, "frequency": found.frequency_hz,
            "columns": described.collect::<Vec<_>>(),
        }))
    }
}
