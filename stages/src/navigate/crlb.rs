//! The Cramér-Rao bound along the true path.

use arrow_array::ArrayRef;
use numerics::navigation::{
    crlb::{TruePath, run, run_aided},
    line::NavigationLine,
    output::NavigationOutput,
    pinson::STATES,
    transition::NoiseDiscretisation,
};
use schemas::{Column, Fault};

use super::aiding::{Aiding, both};
use super::filter::{FilterFlight, FilterInput, FilterTrack, NavigationFilter, filter, state_columns};
use super::further::{AuxiliaryMeasurements, updates};
use crate::columns::{array, data, floats, list};

/// Column of the bound.
pub(crate) const DRMS_BOUND: &str = "drms_bound";

/// Truth columns that the bound requires in addition to the inputs of every filter.
const TRUTH: [(&str, &str); 3] = [("lat", "deg"), ("lon", "deg"), ("alt", "m")];

filter! {
    /// The Cramér-Rao bound: the smallest error of any filter with the same models on the same flight. The filter
    /// `crlb` evaluates the covariance along the true positions (`lat`, `lon`, `alt`). Compare the bound with the error
    /// of another filter's track to see whether this error is due to the filter or to the flight.
    ///
    /// `crlb` makes no estimate: its track consists of the true positions, so `score` gives no error for it. The
    /// columns `sd_n`, `sd_e` and `drms_bound` hold the bound at each sample. The metric `drms_bound` is the bound over
    /// the line; a search never selects a point by this metric. `residual` is the measurement minus the field at the
    /// true position. `nis` is the square of this residual divided by its variance under the assumed noise. A mean
    /// `nis` of 1 confirms the assumed noise. `vn`, `ve` and `vd` hold the velocity of the INS.
    ///
    /// Source: Tichavský, Muravchik & Nehorai 1998; MagNav.jl's `crlb`, which agrees to 8 digits.
    Crlb = "crlb", version 2, groups [aiding: Aiding, further: AuxiliaryMeasurements],
    example "discretisation = \"trapezoidal\"";
    /// Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of first order as in
    /// MagNav.jl, and `van_loan` exact.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
    /// Appends the covariance `p` (row-major).
    save_state: bool, unit "", default false;
}

impl NavigationFilter for Crlb {
    fn reads(&self, flight: &FilterFlight) -> Result<Vec<String>, Vec<Fault>> {
        let faults: Vec<Fault> =
            TRUTH.iter().filter_map(|(name, unit)| flight.shape.number(name, unit).err()).collect();
        let truth = if faults.is_empty() { Ok(TRUTH.map(|(name, _)| name.to_owned()).to_vec()) } else { Err(faults) };
        both(truth, self.further.no_scalar_states())
    }

    fn takes_wide_start(&self) -> bool {
        true
    }

    fn columns(&self, _: &FilterFlight) -> Vec<Column> {
        let bound = Column::float(DRMS_BOUND, "m", "Cramér-Rao bound of the horizontal error (drms)");
        // The bound has a covariance but no state.
        let state = state_columns().into_iter().filter(|column| self.save_state && column.name == "p");
        [bound].into_iter().chain(state).collect()
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        let what = "`flat_over_m` has no effect on the bound, which uses every sample";
        (key == "flat_over_m").then(|| Fault::new(what).of_param(key))
    }

    fn navigate(&self, flown: &FilterInput) -> Result<FilterTrack, Fault> {
        let line = NavigationLine { fixes: flown.fixes(), ..flown.line_with(self.discretisation)? };
        let [lat_deg, lon_deg, alt_m] = TRUTH.map(|(name, _)| floats(flown.columns, name));
        let [lat_deg, lon_deg, alt_m] = [lat_deg?, lon_deg?, alt_m?];
        let path = TruePath { lat_deg, lon_deg, alt_m, velocity_ned_mps: None };
        let covariances = |out: &mut NavigationOutput| -> Result<Vec<ArrayRef>, Fault> {
            let bound = out.sd_n_m.iter().zip(&out.sd_e_m).map(|(north, east)| north.hypot(*east)).collect();
            let p = std::mem::take(&mut out.p).into_flattened().into_flattened();
            let p = if self.save_state { Some(list(p, STATES * STATES)?) } else { None };
            Ok([array(bound)].into_iter().chain(p).collect())
        };
        if self.further.is_any() {
            let measured = self.further.measured(flown)?;
            let aids = self.further.aids(flown, &measured)?;
            let mut out = run_aided(&line, &path, self.save_state, &aids).map_err(data)?;
            self.further.enough(flown, &out.navigation.report)?;
            let mut more = covariances(&mut out.navigation)?;
            more.extend(self.further.arrays(out.aids, out.slope_nt_per_m));
            return Ok(FilterTrack {
                more,
                update: updates(&out.usage),
                ..FilterTrack::without_updates(out.navigation)
            });
        }
        let mut out = run(&line, &path, self.save_state).map_err(data)?;
        let more = covariances(&mut out)?;
        Ok(FilterTrack { more, ..FilterTrack::from_output(flown, out, None)? })
    }
}

#[cfg(test)]
mod tests {
    use crate::navigate::testing::*;

    #[test]
    fn law_the_bound_is_at_the_truth_and_below_the_filter() {
        let (bound, ekf) = (run("crlb", "mag = 'mag_1_c'\nsave_state = true"), run("ekf", "mag = 'mag_1_c'"));
        assert!((0..ROWS).all(|row| bound.error_m(row) < 1e-6));
        assert!(!bound.has("x") && bound.numbers("p").len() == 324 * ROWS);
        let (north, east, both) = (bound.numbers("sd_n"), bound.numbers("sd_e"), bound.numbers("drms_bound"));
        assert!((0..ROWS).all(|row| both[row] == north[row].hypot(east[row])));
        // The filter linearises the map at its estimate instead of the truth, which changes the standard deviation
        // slightly.
        let (sd, ekf) = (bound.numbers("sd_n"), ekf.numbers("sd_n"));
        let (first, last, of_ekf) = (sd[0], sd[ROWS - 1], ekf[ROWS - 1]);
        assert!((last / of_ekf - 1.0).abs() < 0.5 && last < 0.5 * first, "{first} {last} {of_ekf}");
    }

    #[test]
    fn law_gnss_positions_lower_the_bound() {
        let free = run("crlb", "mag = 'mag_1_c'").numbers("sd_e");
        let aided = run("crlb", "mag = 'mag_1_c'\ngnss_lost_s = [300.0, 1e6]\ngnss_sigma_m = 1.0").numbers("sd_e");
        assert!(aided[299] < 0.5 && aided[299] < free[299] && aided[ROWS - 1] > 2.0 * aided[299]);
    }
}
