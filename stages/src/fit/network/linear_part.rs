//! Linear model combined with a network.

use numerics::{
    compensation::model_terms::core_term_names,
    regression::least_squares::{ColumnScaling, RegressionMoments},
    signal::{filter::ConstantColumns, segments::filter_matrix},
};
use schemas::{Fault, Rule, params};

use crate::{bandpass::design, columns::data, fit::samples::FitSamples};

params! {
    /// Linear model combined with a network: a ridge fit to band-passed terms, as in `tolles_lawson`.
    pub struct LinearPart;
    /// Entries of `features` that are terms of the linear model. A name selects one entry; a prefix such as
    /// `TL_A_flux_a` selects all entries whose names begin with `TL_A_flux_a_`. Other features can only be inputs of
    /// the network.
    linear: Option<Vec<String>>, unit "", absent "for `etlnn`, all features; for other models, the Tolles-Lawson \
        terms in `features` or, if there are none, the terms of the core-field model";
    /// Ridge parameter of the linear model.
    lambda: f64, unit "", default 0.025, rule Rule::NotNegative;
    /// Lower corner frequency of the filter for the ridge fit. With 0 the filter has no lower corner.
    linear_low_hz: f64, unit "Hz", default 0.1, rule Rule::NotNegative;
    /// Upper corner frequency of the filter for the ridge fit. With 0 the filter has no upper corner.
    linear_high_hz: f64, unit "Hz", default 0.9, rule Rule::NotNegative;
}

/// Order of the Butterworth prototype, and number of samples removed at each end: the defaults of `fit`.
const ORDER: usize = 4;
const TRIM: usize = 20;

/// Names of the Tolles-Lawson terms, as `a_matrix` makes them.
const TOLLES_LAWSON: [&str; 22] = [
    "x", "y", "z", "xx", "xy", "xz", "yy", "yz", "zz", "xx_dot", "xy_dot", "xz_dot", "yx_dot", "yy_dot", "yz_dot",
    "zx_dot", "zy_dot", "zz_dot", "x_dot", "y_dot", "z_dot", "bias",
];

impl LinearPart {
    /// Positions of the terms.
    ///
    /// # Errors
    /// Fails if an entry is missing, or no term remains.
    pub fn places(&self, samples: &FitSamples, all: bool) -> Result<Vec<usize>, Fault> {
        if self.linear.is_some() || all {
            return samples.places(self.linear.as_ref()).map_err(|f| f.of_param("linear"));
        }
        let is_term = |name: &str| TOLLES_LAWSON.contains(&name) || name.starts_with("TL_");
        let among = |is: &dyn Fn(&str) -> bool| -> Vec<usize> {
            (0..samples.names.len()).filter(|i| is(&samples.names[*i])).collect()
        };
        let found = among(&is_term);
        if !found.is_empty() {
            return Ok(found);
        }
        let core = core_term_names();
        let found = among(&|name| core.iter().any(|term| term == name));
        if found.is_empty() {
            let what = "the features include no Tolles-Lawson terms and no terms of the core-field model";
            let help = "add `tl` to `features`, or name the terms of the linear model in `linear`";
            return Err(Fault::data(what).of_param("linear").help(help));
        }
        Ok(found)
    }

    /// Coefficients of the terms at `places`, fitted to `lines`.
    ///
    /// # Errors
    /// Fails if no run is long enough for the filter, or the data do not determine the coefficients.
    pub fn fit(&self, samples: &FitSamples, lines: &[usize], places: &[usize]) -> Result<Vec<f64>, Fault> {
        let (width, terms) = (samples.names.len(), places.len());
        let mut moments = vec![];
        for line in lines.iter().filter_map(|&i| samples.lines.get(i)) {
            let (mut a, mut y) = (line.columns(places, width), line.y.to_vec());
            let mut trim = 0;
            let mut least = 1;
            if let Some(filter) = design(self.linear_low_hz, self.linear_high_hz, ORDER, line.rate_hz)? {
                (trim, least) = (TRIM, filter.least_rows());
                let runs: Vec<_> = line.runs.iter().filter(|r| r.len() >= least).cloned().collect();
                filter_matrix(&filter, &mut a, terms, &runs, ConstantColumns::Keep).map_err(data)?;
                filter_matrix(&filter, &mut y, 1, &runs, ConstantColumns::Filter).map_err(data)?;
            }
            for run in line.runs.iter().filter(|r| r.len() >= least.max(2 * trim + 1)) {
                let run = run.start + trim..run.end - trim;
                moments.push(
                    RegressionMoments::from_matrix(&a[run.start * terms..run.end * terms], terms, &[&y[run]])
                        .map_err(data)?,
                );
            }
        }
        if moments.is_empty() {
            let what = "no run is long enough for the filter of the linear model";
            return Err(Fault::data(what).help("select longer lines, or set `linear_low_hz` and `linear_high_hz` to 0"));
        }
        let prepared = RegressionMoments::merged(&moments)
            .and_then(|all| all.prepare(ColumnScaling::Standardise, true))
            .map_err(data)?;
        let names: Vec<&String> = places.iter().map(|&i| &samples.names[i]).collect();
        let path = prepared.ridge(&[self.lambda], &names).map_err(data)?;
        let found = path.solutions.into_iter().next().and_then(|s| s.coefficients.into_iter().next());
        found.ok_or_else(|| Fault::bug("the result of a fit is missing"))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_default_linear_terms_are_tolles_lawson_or_core_field_terms() {
        let part = LinearPart { linear: None, lambda: 0.0, linear_low_hz: 0.0, linear_high_hz: 0.0 };
        let places = |names: &[&str], all: bool| {
            let names: Vec<String> = names.iter().map(ToString::to_string).collect();
            part.places(&FitSamples { names: &names, lines: vec![] }, all)
        };
        assert_eq!(places(&["cur", "x", "core_x", "TL_A_flux_a_x"], false).unwrap(), [1, 3]);
        assert_eq!(places(&["cur", "core_x", "core_xy_dot", "easting"], false).unwrap(), [1, 2]);
        assert_eq!(places(&["cur", "easting"], true).unwrap(), [0, 1]);
        let fault = places(&["cur", "easting", "cur_1"], false).unwrap_err();
        assert!(fault.param.as_deref() == Some("linear") && fault.help.unwrap().contains("in `linear`"));
    }
}
