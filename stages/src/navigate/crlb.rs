//! The Cramér-Rao bound along the true path.

use numerics::navigation::{
    crlb::{TruePath, run},
    pinson::STATES,
    transition::NoiseDiscretisation,
};
use schemas::{Column, Fault};

use super::filter::{Flight, Flown, NavigationFilter, Track, filter, state_columns};
use crate::columns::{data, floats, list};

/// The truth that it reads of the flight, beside what every filter is handed.
const TRUTH: [(&str, &str); 3] = [("lat", "deg"), ("lon", "deg"), ("alt", "m")];

filter! {
    /// The Cramér-Rao bound: how good any filter with these models could be on this flight. It reads the truth (`lat`,
    /// `lon`, `alt`), evaluates the filter's covariance there, and needs no estimate. Beside another filter's track it
    /// tells whether an error is the filter's or the flight's.
    ///
    /// The estimate is the truth: what `score` makes of its positions is 0, and its `sd_n`, `sd_e` are the bound.
    /// `residual` is the measurement minus the field at the truth, and `nis` its square over the variance that the
    /// noise keys give it: its mean says whether they are those of the data. `vn`, `ve`, `vd` are the INS's.
    ///
    /// Source: Tichavský, Muravchik & Nehorai 1998; MagNav.jl's `crlb`, with which it agrees to 8 digits.
    Crlb = "crlb", version 1, example "discretisation = \"trapezoidal\"";
    /// How the process noise becomes a step's covariance: to second order, to first order as MagNav.jl, or exactly.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
    /// Append the covariance `p` (row-major).
    save_state: bool, unit "", default false;
}

impl NavigationFilter for Crlb {
    fn reads(&self, flight: &Flight) -> Result<Vec<String>, Vec<Fault>> {
        let faults: Vec<Fault> =
            TRUTH.iter().filter_map(|(name, unit)| flight.shape.number(name, unit).err()).collect();
        if faults.is_empty() { Ok(TRUTH.map(|(name, _)| name.to_owned()).to_vec()) } else { Err(faults) }
    }

    fn columns(&self, _: &Flight) -> Vec<Column> {
        // There is no state.
        if self.save_state { state_columns().into_iter().filter(|c| c.name == "p").collect() } else { vec![] }
    }

    fn navigate(&self, flown: &Flown) -> Result<Track, Fault> {
        let line = flown.line_with(self.discretisation)?;
        let [lat_deg, lon_deg, alt_m] = TRUTH.map(|(name, _)| floats(flown.columns, name));
        let [lat_deg, lon_deg, alt_m] = [lat_deg?, lon_deg?, alt_m?];
        let path = TruePath { lat_deg, lon_deg, alt_m, velocity_ned_mps: None };
        let mut out = run(&line, &path, self.save_state).map_err(data)?;
        let p = std::mem::take(&mut out.p);
        let mut track = Track::of(flown, out, None)?;
        if self.save_state {
            track.more.push(list(p.into_flattened().into_flattened(), STATES * STATES)?);
        }
        Ok(track)
    }
}
