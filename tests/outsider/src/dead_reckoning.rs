//! Example of a custom filter: the uncorrected INS with an error that grows with time.

use schemas::{Fault, Rule};
use stages::navigate::{FilterInput, FilterTrack, NavigationFilter, UpdateOutcome, filter};

filter! {
    /// The INS without measurement updates. The standard deviation of the position starts at `init_position_sigma_m`
    /// and grows by `drift_mps` each second.
    DeadReckoning = "dead_reckoning", version 1, example "drift_mps = 0.5";
    /// Growth rate of the position error.
    drift_mps: f64, unit "m/s", default 0.5, rule Rule::NotNegative;
}

impl NavigationFilter for DeadReckoning {
    fn navigate(&self, input: &FilterInput) -> Result<FilterTrack, Fault> {
        let (ins, first_m) = (&input.ins, input.errors.sources.init_position_sigma_m);
        let sigma_m = |tt_s: &f64| first_m + self.drift_mps * (tt_s - ins.tt_s[0]);
        let sigmas_m: Vec<f64> = ins.tt_s.iter().map(sigma_m).collect();
        let all = |value: f64| vec![value; ins.len()];
        Ok(FilterTrack {
            lat_deg: ins.lat_deg.to_vec(),
            lon_deg: ins.lon_deg.to_vec(),
            alt_m: ins.alt_m.to_vec(),
            vn_mps: ins.vn_mps.to_vec(),
            ve_mps: ins.ve_mps.to_vec(),
            vd_mps: ins.vd_mps.to_vec(),
            sd_n_m: sigmas_m.clone(),
            sd_e_m: sigmas_m,
            cov_ne_m2: all(0.0),
            residual_nt: all(f64::NAN),
            nis: all(f64::NAN),
            update: vec![UpdateOutcome::Missing; ins.len()],
            more: vec![],
        })
    }
}
