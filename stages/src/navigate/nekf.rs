//! The extended Kalman filter whose noise a recurrent network sets at each sample.

use numerics::navigation::{
    line::NavigationLine,
    nekf::{FILTER_INPUTS, NekfParameters, NetworkNoise, NoiseNetwork, run},
    transition::NoiseDiscretisation,
};
use schemas::{Column, Fault, Rule};

use super::aiding::Aiding;
use super::calibrations::CalibrationPrior;
use super::filter::{FilterFlight, FilterInput, FilterTrack, NavigationFilter, filter, state_arrays, state_columns};
use crate::{
    columns::{array, data, floats, list, no_truth},
    trained::{TermLookup, TermValue, list as terms_of, named_list, term},
};

filter! {
    /// The filter `ekf`, with noise that a network sets at each sample (neural covariance). The network is a long
    /// short-term memory layer. Its inputs are the innovation of the previous sample, the slope of the map, the motion
    /// of the aircraft and the columns in `features`. Its output is a factor on the measurement noise, a factor on the
    /// noise of the temporal variation, or both.
    ///
    /// `model` is the table of a `noise_network` stage, which trains the network on other lines. The filter requires
    /// the same `features` and sample rate as that stage. Set the noise keys to the same values in both stages, because
    /// the factor multiplies the assumed noise. If all factors are 1, the results are bit-identical to `ekf`.
    ///
    /// The noise of a sample depends on earlier innovations, but not on the sample's own innovation. `noise_factor` is
    /// the factor on the standard deviation of the measurement, and `fogm_factor` is the factor on the noise of the
    /// temporal variation. A network is reliable only for noise like that of its training lines. If there are no lines
    /// for training, use `ekf_adaptive`.
    ///
    /// Source: Gnadt 2022, section 5.9.3; Hochreiter & Schmidhuber 1997.
    Nekf = "nekf", version 1, groups [aiding: Aiding], example "model = \"noise_network\"";
    /// Columns that are additional inputs of the network, such as electric currents. Values that are not finite are
    /// rejected.
    features: Option<Vec<String>>, unit "", absent "none";
    /// Largest accepted NIS (squared innovation divided by its variance) of a measurement.
    gate_nis: Option<f64>, unit "1",
        absent "no gate; with `tuning = \"auto\"`, outliers are rejected before filtering", rule Rule::Positive;
    /// Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of first order as in
    /// MagNav.jl, and `van_loan` exact.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
    /// Appends the inputs of the network before standardisation.
    save_inputs: bool, unit "", default false;
    /// Appends the state `x` and its covariance `p` (row-major).
    save_state: bool, unit "", default false;
}

/// Value of the term `family` in the table of a network.
const FAMILY: &str = "noise_network";
/// Largest relative difference between the sample rates of training and line.
const RATE_TOLERANCE: f64 = 0.05;

impl NavigationFilter for Nekf {
    fn gates(&self) -> bool {
        self.gate_nis.is_some()
    }

    fn reads(&self, flight: &FilterFlight) -> Result<Vec<String>, Vec<Fault>> {
        let names = self.features.clone().unwrap_or_default();
        let faults = feature_faults(flight.shape, &names);
        if faults.is_empty() { Ok(names) } else { Err(faults) }
    }

    fn takes_models(&self) -> bool {
        true
    }

    fn needs_model(&self) -> bool {
        true
    }

    fn columns(&self, _: &FilterFlight) -> Vec<Column> {
        let factor =
            |name: &str, of: &str| Column::float(name, "1", format!("factor on the standard deviation of {of}"));
        let mut columns =
            vec![factor("noise_factor", "the measurement"), factor("fogm_factor", "the temporal variation's noise")];
        if self.save_inputs {
            let names = input_names(self.features.as_deref().unwrap_or_default());
            columns.push(Column::list("noise_inputs", "", "inputs of the network", names));
        }
        if self.save_state {
            columns.extend(state_columns());
        }
        columns
    }

    fn navigate(&self, flown: &FilterInput) -> Result<FilterTrack, Fault> {
        let line = NavigationLine { fixes: flown.fixes(), ..flown.line_with(self.discretisation)? };
        let names = self.features.as_deref().unwrap_or_default();
        let [model] = flown.models else {
            let what = "the filter `nekf` requires a single network in `model`";
            return Err(Fault::data(what).of_param("model"));
        };
        let network = network_of(model, names, mean_rate_hz(flown.ins.tt_s))?;
        let further = features_of(flown, names)?;
        let parameters =
            NekfParameters { gate_nis: self.gate_nis, keep_states: self.save_state, keep_covariance: self.save_state };
        let mut out = run(&line, &network, &further, &parameters).map_err(data)?;
        let mut more = vec![array(out.measurement_factor), array(out.fogm_factor)];
        if self.save_inputs {
            more.push(list(out.inputs, network.inputs())?);
        }
        if self.save_state {
            more.extend(state_arrays(&mut out.navigation)?);
        }
        Ok(FilterTrack { more, ..FilterTrack::from_output(flown, out.navigation, self.gate_nis)? })
    }
}

/// Faults of the columns that are further inputs.
pub(crate) fn feature_faults(shape: &schemas::TableShape, names: &[String]) -> Vec<Fault> {
    let mut faults =
        if names.is_empty() { vec![] } else { crate::columns::not_numbers_among(shape, names, "features") };
    let truth = names.iter().filter_map(|name| shape.get(name)).map(|column| no_truth(column, "features", false));
    faults.extend(truth.filter_map(Result::err).map(|mut fault| {
        fault.help = Some("remove the column from `features`".to_owned());
        fault
    }));
    faults
}

/// Further inputs of a line, row-major.
pub(crate) fn features_of(flown: &FilterInput, names: &[String]) -> Result<Vec<f64>, Fault> {
    let columns = names.iter().map(|name| floats(flown.columns, name)).collect::<Result<Vec<_>, Fault>>()?;
    for (name, column) in names.iter().zip(&columns) {
        if let Some(row) = column.iter().position(|x| !x.is_finite()) {
            let what = format!("`{name}` is {} at tt = {} s", column[row], flown.ins.tt_s[row]);
            return Err(Fault::data(what).in_column(name).help("fill the gap, or remove the column from `features`"));
        }
    }
    Ok((0..flown.ins.len()).flat_map(|row| columns.iter().map(move |column| column[row])).collect())
}

/// Mean sample rate of a line, in Hz; NaN for a single sample.
pub(crate) fn mean_rate_hz(tt_s: &[f64]) -> f64 {
    match tt_s {
        [first, .., last] => (tt_s.len() - 1) as f64 / (last - first),
        _ => f64::NAN,
    }
}

/// Whether a sample rate is close enough to the sample rate of the training.
pub(crate) fn is_near_rate(rate_hz: f64, trained_hz: f64) -> bool {
    (rate_hz / trained_hz - 1.0).abs() <= RATE_TOLERANCE
}

/// Names of all inputs of a network with these features.
fn input_names(features: &[String]) -> Vec<String> {
    FILTER_INPUTS.iter().map(ToString::to_string).chain(features.iter().cloned()).collect()
}

/// Terms of the table of a network.
pub(crate) fn network_terms(network: &NoiseNetwork, features: &[String]) -> Vec<TermValue> {
    let names = input_names(features);
    let mut terms = vec![
        term(format!("family {FAMILY}"), 1.0),
        term(format!("noise {}", network.noise.word()), 1.0),
        term("hidden", network.hidden as f64),
        term("limit", network.limit),
    ];
    terms.extend(named_list("mean", &names, &network.mean));
    terms.extend(named_list("inverse_deviation", &names, &network.inverse_deviation));
    terms.extend(terms_of("weight", &network.weights));
    terms
}

/// Network of a table, for a line with these features and this sample rate.
fn network_of(model: &CalibrationPrior, features: &[String], rate_hz: f64) -> Result<NoiseNetwork, Fault> {
    let lookup = TermLookup::new(&model.terms, &model.values_nt)?;
    if lookup.word("family").ok() != Some(FAMILY) {
        let what = "the model is not a network of the noise";
        return Err(Fault::data(what).of_param("model").help("set `model` to the table of a `noise_network` stage"));
    }
    let noise: NetworkNoise = lookup.choice("noise")?;
    let (names, mean) = lookup.list("mean")?;
    if names != input_names(features) {
        let trained = names.get(FILTER_INPUTS.len()..).unwrap_or_default();
        let what = format!("the network was trained with `features = {trained:?}`, not {features:?}");
        return Err(Fault::data(what).of_param("features").help("set the `features` of the training"));
    }
    if let Some(trained_hz) = model.rate_hz
        && !is_near_rate(rate_hz, trained_hz)
    {
        let what = format!("the network was trained at {trained_hz:.3} Hz, but the line is sampled at {rate_hz:.3} Hz");
        return Err(Fault::data(what).of_param("model").help("add a `resample` stage, or train at the line's rate"));
    }
    let network = NoiseNetwork {
        noise,
        hidden: lookup.count("hidden")?,
        limit: lookup.value("limit")?,
        mean,
        inverse_deviation: lookup.list("inverse_deviation")?.1,
        weights: lookup.list("weight")?.1,
    };
    network.check().map_err(|error| crate::trained::broken(error.to_string()))?;
    Ok(network)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(names: &[&str]) -> Vec<String> {
        names.iter().map(ToString::to_string).collect()
    }

    fn table(features: &[String], rate_hz: Option<f64>) -> (NoiseNetwork, CalibrationPrior) {
        let mut network = NoiseNetwork::initial(NetworkNoise::Both, 8 + features.len(), 3, 7.5, 4);
        network.mean.iter_mut().enumerate().for_each(|(at, mean)| *mean = 0.1 * at as f64);
        network.inverse_deviation.fill(2.5);
        let (terms, values_nt): (Vec<String>, Vec<f64>) =
            network_terms(&network, features).into_iter().map(|term| (term.name, term.value)).unzip();
        let sigmas_nt = vec![f64::NAN; terms.len()];
        (network, CalibrationPrior { terms, values_nt, sigmas_nt, rate_hz })
    }

    #[test]
    fn unit_a_table_gives_the_same_network() {
        let features = named(&["cur_strb", "vol_back"]);
        let (network, made) = table(&features, Some(10.0));
        assert_eq!(network_of(&made, &features, 10.2), Ok(network));
        let why = |features: &[&str], rate_hz: f64| network_of(&made, &named(features), rate_hz).unwrap_err().what;
        assert!(
            why(&["vol_back", "cur_strb"], 10.0).contains("trained with `features = [\"cur_strb\", \"vol_back\"]`")
        );
        assert!(
            why(&["cur_strb", "vol_back"], 1.0).contains("trained at 10.000 Hz, but the line is sampled at 1.000 Hz")
        );
        let linear = CalibrationPrior { terms: named(&["x"]), values_nt: vec![1.0], ..made.clone() };
        assert_eq!(network_of(&linear, &[], 10.0).unwrap_err().what, "the model is not a network of the noise");
        for lost in 0..made.terms.len() {
            let (mut terms, mut values_nt) = (made.terms.clone(), made.values_nt.clone());
            terms.remove(lost);
            values_nt.remove(lost);
            assert!(network_of(&CalibrationPrior { terms, values_nt, ..made.clone() }, &features, 10.0).is_err());
        }
    }
}
