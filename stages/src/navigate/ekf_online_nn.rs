//! The extended Kalman filter that trains a small network of the aircraft field in flight.

use std::borrow::Cow;

use numerics::navigation::{
    line::NavigationLine,
    online::{OnlineParameters, check_sources},
    online_nn::{self, NetworkCalibration, NetworkPrior, OnlineActivation, OnlineNetwork, TrainingParameters, train},
    position_fixes::PositionFixes,
    transition::NoiseDiscretisation,
};
use numerics::regression::statistics::std;
use schemas::{Column, ColumnType, Fault, Rule};

use super::aiding::{Aiding, both};
use super::calibrations::CalibrationPrior as Fitted;
use super::filter::{FilterFlight, FilterInput, FilterTrack, NavigationFilter, filter};
use super::further::{AuxiliaryMeasurements, updates};
use crate::{
    columns::{array, data, list, matrix, rate_factor, sampling},
    trained::LearnedModel,
};

filter! {
    /// The 18-state extended Kalman filter with the weights of a network as additional states. The network has one
    /// hidden layer; its output is the aircraft field at the magnetometer. The measurement is uncompensated. Use it for
    /// aircraft fields that are nonlinear in the features, such as the fields of switched electric currents. For linear
    /// aircraft fields `ekf_online_tl` is more accurate.
    ///
    /// The weights are first trained on the part of the line before GNSS is lost; `gnss_lost_s` is required. In this
    /// part the aircraft field is the measurement minus the map and the core field at the GNSS position. Training uses
    /// recursive least squares. During training, GNSS aids the INS, and `update` is `missing`, because the measurement
    /// is already used for training. Afterwards, the assumed measurement noise is the larger of the training residual
    /// and `measurement_sigma_nt`. The network also estimates a constant, so `offset_window_s` is ignored.
    ///
    /// `model` is the table of a fit of `m1` with one hidden layer to the aircraft field (targets `c` and `d`). The
    /// weights then start from this network, and `hidden` and `activation` must equal the values of that fit. Training
    /// then estimates the covariance of the weights, and their changes since that fit. Features that are differences
    /// between samples are converted to the sample rate of that fit.
    ///
    /// A scalar magnetometer among the features is rejected, because the filter would subtract its own measurement.
    /// `aircraft` is the aircraft field computed with the weights estimated at the sample. The covariance of the
    /// weights excludes the modelling error of the network. The filter is therefore overconfident in conditions outside
    /// the training data.
    ///
    /// Source: Gnadt 2022, section 5.6, with the regressor ∂m/∂w in (5.44) and (5.45).
    EkfOnlineNn = "ekf_online_nn", version 1, groups [aiding: Aiding, further: AuxiliaryMeasurements],
    example r#"features = "tl"
gnss_lost_s = [20.0, 1e6]"#;
    /// List column of the network's inputs, as made by `features` or `a_matrix`.
    features: String, unit "", default "features";
    /// Number of units in the hidden layer.
    hidden: usize, unit "1", default 8usize, rule Rule::Between(1.0, 64.0);
    /// Activation function.
    activation: OnlineActivation, unit "", default OnlineActivation::Swish;
    /// Seed of the initial weights.
    seed: usize, unit "", default 0usize;
    /// Number of training passes over the samples.
    passes: usize, unit "1", default 10usize, rule Rule::Between(1.0, 1000.0);
    /// Time in which the random walk changes each weight by at least the weight's standard deviation at the end of
    /// training.
    memory_s: f64, unit "s", default 3600.0, rule Rule::Positive;
    /// Largest accepted NIS (squared innovation divided by its variance) of a measurement.
    gate_nis: Option<f64>, unit "1",
        absent "no gate; with `tuning = \"auto\"`, outliers are rejected before filtering", rule Rule::Positive;
    /// Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of first order as in
    /// MagNav.jl, and `van_loan` exact.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
    /// Appends the weights at each sample: the input weights of each hidden unit, the biases of the units, the output
    /// weights, and the output bias.
    save_weights: bool, unit "", default false;
}

/// Inputs of a network.
fn inputs(flight: &FilterFlight, column: &str) -> Result<Vec<String>, Vec<Fault>> {
    let found = flight.shape.need(column).map_err(|fault| vec![fault.of_param("features")])?;
    match &found.column_type {
        ColumnType::List(names) => Ok(names.clone()),
        _ => {
            let what = format!("`{column}` is not a list of features");
            let help = "set `features` to the list column of a stage `features` or `a_matrix`";
            Err(vec![Fault::new(what).of_param("features").help(help)])
        }
    }
}

impl NavigationFilter for EkfOnlineNn {
    fn gates(&self) -> bool {
        self.gate_nis.is_some()
    }

    fn reads(&self, flight: &FilterFlight) -> Result<Vec<String>, Vec<Fault>> {
        let features = inputs(flight, &self.features).and_then(|names| {
            check_sources(&names).map_err(|e| vec![Fault::new(e.to_string()).of_param("features")])?;
            Ok(vec![self.features.clone()])
        });
        let features = match self.aiding.gnss_lost_s {
            Some([lost_s, _]) if lost_s > 0.0 => features,
            Some(_) | None => {
                let what = "the network is trained until GNSS is lost, but `gnss_lost_s` is unset";
                let fault =
                    Fault::new(what).of_param("gnss_lost_s").help("set `gnss_lost_s`, for example to `[600.0, 1e6]`");
                both(features, Err(vec![fault]))
            }
        };
        both(features, self.further.needs_scalar("the aircraft's field"))
    }

    fn columns(&self, flight: &FilterFlight) -> Vec<Column> {
        let what = "aircraft field computed with the weights estimated at the sample";
        let mut columns = vec![Column::float("aircraft", "nT", what)];
        if self.save_weights {
            let inputs = inputs(flight, &self.features).unwrap_or_default();
            let unit = |of: &str| (1..=self.hidden).map(|unit| format!("{of}_{unit}")).collect::<Vec<_>>();
            let mut names: Vec<String> =
                (1..=self.hidden).flat_map(|unit| inputs.iter().map(move |input| format!("{input}_{unit}"))).collect();
            names.extend(unit("bias").into_iter().chain(unit("output")).chain(["output_bias".to_owned()]));
            columns.push(Column::list("weights", "", "weights of the network", names));
        }
        columns
    }

    fn takes_models(&self) -> bool {
        true
    }

    fn navigate(&self, flown: &FilterInput) -> Result<FilterTrack, Fault> {
        let fixes = flown.fixes().ok_or_else(|| Fault::bug("the network cannot be trained without GNSS"))?;
        let line = NavigationLine { fixes: Some(fixes), ..flown.line_with(self.discretisation)? };
        let (features, names) = self.features(flown)?;
        let features = features.as_ref();
        let (network, prior, training) = self.train(flown, &line, fixes, (features, &names))?;
        let mut measured_nt = flown.measured_nt.clone();
        measured_nt[..training].fill(f64::NAN);
        let sigma_nt: Vec<f64> = flown
            .sigma_nt
            .iter()
            // `max` ignores NaN, which denotes a missing measurement.
            .map(|sigma| if sigma.is_nan() { *sigma } else { sigma.max(prior.misfit_nt) })
            .collect();
        // The bias of the network holds the offset.
        let line = NavigationLine { measurement_nt: &measured_nt, sigma_nt: &sigma_nt, offset_window_s: 0.0, ..line };
        let parameters = OnlineParameters {
            gate_nis: self.gate_nis,
            recover_after: None,
            keep_states: false,
            keep_covariance: false,
            keep_coefficients: self.save_weights,
        };
        let measured = self.further.measured(flown)?;
        let aids = self.further.aids(flown, &measured)?;
        let mut out = online_nn::run(&line, &network, features, &prior, &aids, &parameters).map_err(data)?;
        out.navigation.report.offset_samples = training;
        let mut more = vec![array(out.track.aircraft_nt)];
        if self.save_weights {
            more.push(list(out.weights_by_row, network.weights())?);
        }
        more.extend(self.further.arrays(out.aids, out.slope_nt_per_m));
        let mut track = FilterTrack::from_output(flown, out.navigation, self.gate_nis)?;
        if self.further.is_any() {
            track.update = updates(&out.usage);
        } else {
            track.update[..training].fill(super::UpdateOutcome::Missing);
        }
        Ok(FilterTrack { more, ..track })
    }
}

impl EkfOnlineNn {
    /// Features of the line, row-major, and their names. Differences are converted to the sample rate of the model that
    /// gives the initial weights.
    fn features<'a>(&self, flown: &'a FilterInput) -> Result<(Cow<'a, [f64]>, Vec<String>), Fault> {
        let (features, names) = matrix(flown.columns, &self.features)?;
        let Some(model) = flown.models.first() else { return Ok((Cow::Borrowed(features), names)) };
        let own = sampling(flown.columns, &self.features)?;
        let factor = |name: &String| rate_factor(&own, name, model.rate_hz).map_err(|fault| fault.of_param("model"));
        let factors = names.iter().map(factor).collect::<Result<Vec<f64>, Fault>>()?;
        if factors.iter().all(|factor| *factor == 1.0) {
            return Ok((Cow::Borrowed(features), names));
        }
        Ok((features.iter().zip(factors.iter().cycle()).map(|(x, factor)| x * factor).collect(), names))
    }

    /// Trains the network. Returns the network, its weights at the loss of GNSS, and the number of samples before the
    /// loss.
    fn train(
        &self,
        flown: &FilterInput,
        line: &NavigationLine,
        fixes: &PositionFixes,
        (features, names): (&[f64], &[String]),
    ) -> Result<(OnlineNetwork, NetworkPrior, usize), Fault> {
        let tt_s = flown.ins.tt_s;
        let lost_s = self.aiding.gnss_lost_s.map_or(0.0, |[lost_s, _]| lost_s);
        let training = tt_s.partition_point(|t| t - tt_s[0] < lost_s);
        let aircraft_nt = aircraft_field(line, fixes, training);
        let known: Vec<f64> = aircraft_nt.iter().copied().filter(|nt| nt.is_finite()).collect();
        if known.len() < 4 {
            let what = format!(
                "before GNSS is lost, {} samples have a measurement, a position and a map value: too few for training",
                known.len()
            );
            return Err(Fault::data(what).help("check that the map covers these samples, or begin `gnss_lost_s` later"));
        }
        let width = features.len() / tt_s.len();
        let first = &features[..training * width];
        let (network, start) = match flown.models {
            [] => {
                let network = OnlineNetwork::new(first, width, self.hidden, self.activation, std(&known).value);
                (network.map_err(data)?, None)
            }
            [model] => {
                let (network, start) = from_model(model, names, self.hidden, self.activation)?;
                (network, Some(start))
            }
            _ => {
                return Err(Fault::new("the filter `ekf_online_nn` requires a single trained network in `model`")
                    .of_param("model"));
            }
        };
        let parameters = TrainingParameters {
            seed: self.seed as u64,
            sigma_nt: flown.measurement_sigma_nt.hypot(flown.errors.fogm_sigma_nt),
            passes: self.passes,
            memory_s: self.memory_s,
        };
        let calibration = NetworkCalibration { tt_s: &tt_s[..training], features: first, aircraft_nt: &aircraft_nt };
        let prior = train(&network, &calibration, start.as_deref(), &parameters).map_err(data)?;
        Ok((network, prior, training))
    }
}

/// Network of a trained model for the features `names`, and its weights. `hidden` and `activation` are the values in
/// the spec.
fn from_model(
    model: &Fitted,
    names: &[String],
    hidden: usize,
    activation: OnlineActivation,
) -> Result<(OnlineNetwork, Vec<f64>), Fault> {
    let learned = LearnedModel::read(&model.terms, &model.values_nt)?;
    let Some(LearnedModel::Network(trained)) = learned else {
        let what = "the model is not a network";
        return Err(Fault::data(what)
            .of_param("model")
            .help("set `model` to the table of a fit with `model = \"m1\"`"));
    };
    let layer = trained.one_layer()?;
    let wrong = |what: String, key: &'static str| Fault::data(what).of_param(key);
    if layer.b.len() != hidden {
        let what = format!("the trained network has {} hidden units: set `hidden = {0}`", layer.b.len());
        return Err(wrong(what, "hidden"));
    }
    if layer.activation.word() != activation.word() {
        let what =
            format!("the trained network has the activation `{}`: set `activation` to it", layer.activation.word());
        return Err(wrong(what, "activation"));
    }
    if let Some(name) = layer.names.iter().find(|name| !names.contains(name)) {
        let what = format!("the trained network has the input `{name}`, which is not in the features");
        return Err(wrong(what, "features"));
    }
    // A feature that is constant in the training data has no weight.
    let place = |name: &String| layer.names.iter().position(|known| known == name);
    let places: Vec<Option<usize>> = names.iter().map(place).collect();
    let of = |values: &[f64], without: f64| {
        places.iter().map(|at| at.map_or(without, |at| values[at])).collect::<Vec<f64>>()
    };
    let w = layer.w.chunks_exact(layer.names.len().max(1));
    let mut weights: Vec<f64> = w.flat_map(|unit| of(unit, 0.0)).collect();
    let (mean_nt, scale_nt) = layer.target;
    weights.extend(layer.b.iter().chain(layer.v));
    weights.push(layer.last + mean_nt / scale_nt);
    let network = OnlineNetwork::scaled(of(layer.mean, 0.0), of(layer.scale, 1.0), hidden, activation, scale_nt);
    Ok((network.map_err(data)?, weights))
}

/// Measurement minus the field at the GNSS position, in nT, one value per sample. NaN if the measurement or the
/// position is missing.
fn aircraft_field(line: &NavigationLine, fixes: &PositionFixes, rows: usize) -> Vec<f64> {
    let (ins, mut field) = (line.ins, line.predicted());
    let of = |row: usize| {
        let error = [
            (fixes.lat_deg[row] - ins.lat_deg[row]).to_radians(),
            (fixes.lon_deg[row] - ins.lon_deg[row]).to_radians(),
            fixes.alt_m[row] - ins.alt_m[row],
        ];
        let there = error.iter().all(|error| error.is_finite());
        let predicted = if there { field.at_error(ins, row, error) } else { None };
        predicted.map_or(f64::NAN, |field| line.measurement_nt[row] - field.value_nt)
    };
    (0..rows).map(of).collect()
}

#[cfg(test)]
mod tests {
    use learning::{
        inputs::InputScaling,
        network::{self, NetworkForm, NetworkShape},
    };

    use super::*;
    use crate::{
        navigate::testing::*,
        trained::{self, LearnedModel},
    };

    fn named(names: &[&str]) -> Vec<String> {
        names.iter().map(ToString::to_string).collect()
    }

    /// A trained network with the inputs `b` and `a`, and its table.
    fn model(members: usize) -> (trained::NetworkEnsemble, Fitted) {
        let scaling = InputScaling { mean: vec![1.0, -2.0], scale: vec![2.0, 0.5], components: None };
        let activation = network::ActivationFunction::Swish;
        let shape = NetworkShape { inputs: 2, linear: 0, hidden: vec![3], activation, form: NetworkForm::Plain };
        let columns = trained::NetworkColumns::new(named(&["b", "a"]), vec![], None);
        let members = (0..members).map(|m| shape.initial(m as u64, &[])).collect();
        let made = trained::NetworkEnsemble::new(columns, scaling, shape, members, (40.0, 7.0)).unwrap();
        let terms = LearnedModel::Network(made.clone()).terms();
        let (terms, values_nt): (Vec<String>, Vec<f64>) = terms.into_iter().map(|t| (t.name, t.value)).unzip();
        let sigmas_nt = vec![f64::NAN; terms.len()];
        (made, Fitted { terms, values_nt, sigmas_nt, rate_hz: None })
    }

    #[test]
    fn unit_a_trained_network_predicts_the_same_within_the_filter() {
        let (made, table) = model(1);
        let (network, weights) =
            from_model(&table, &named(&["a", "constant", "b"]), 3, OnlineActivation::Swish).unwrap();
        for [a, b] in [[0.3, -1.0], [4.0, 2.5], [-7.0, 0.1]] {
            let inputs = network.standardised(&[a, 5.0, b]);
            let within = network.value(&inputs, &weights);
            assert!((within - made.predict(&[b, a]).field_nt[0]).abs() < 1e-12, "{within}");
        }
    }

    #[test]
    fn unit_a_model_of_another_kind_is_rejected() {
        let (_, table) = model(1);
        let why = |table: &Fitted, names: &[&str], hidden: usize, activation: OnlineActivation| {
            from_model(table, &named(names), hidden, activation).unwrap_err().what
        };
        let both = ["a", "b"];
        assert_eq!(
            why(&table, &both, 8, OnlineActivation::Swish),
            "the trained network has 3 hidden units: set `hidden = 3`"
        );
        assert!(why(&table, &both, 3, OnlineActivation::Tanh).contains("activation `swish`"));
        assert!(
            why(&table, &["a"], 3, OnlineActivation::Swish).contains("the input `b`, which is not in the features")
        );
        assert!(why(&model(2).1, &both, 3, OnlineActivation::Swish).contains("is the mean of several networks"));
        let (terms, one) = (named(&["x"]), vec![1.0]);
        let linear = Fitted { terms, values_nt: one.clone(), sigmas_nt: one, rate_hz: None };
        assert_eq!(why(&linear, &both, 3, OnlineActivation::Swish), "the model is not a network");
    }

    #[test]
    fn unit_the_network_learns_the_aircraft_field_and_bounds_the_error() {
        let keys = "mag = 'mag_1_uc'\nfeatures = 'attitude'\ngnss_lost_s = [300.0, 1e6]";
        let found = flown("ekf_online_nn", keys, &flight()).unwrap();
        assert_eq!((found.updates("missing"), found.updates("used")), (300, 300));
        assert!(found.error_m(299) < 5.0 && found.error_m(ROWS - 1) < 40.0, "{}", found.error_m(ROWS - 1));
        // The same seed gives the same weights; another seed gives different weights.
        let again = flown("ekf_online_nn", keys, &flight()).unwrap();
        assert_eq!(found.numbers("lat"), again.numbers("lat"));
        let other = flown("ekf_online_nn", &format!("{keys}\nseed = 5\nsave_weights = true"), &flight()).unwrap();
        assert_ne!(found.numbers("lat"), other.numbers("lat"));
        assert_eq!(other.numbers("weights").len(), ROWS * (8 * (2 + 2) + 1));
    }

    #[test]
    fn unit_missing_inputs_are_reported() {
        assert_refused("ekf_online_nn", "features = 'tl'", "`gnss_lost_s` is unset");
        assert_refused("ekf_online_nn", "features = 'tl'\ngnss_lost_s = [0.0, 100.0]", "`gnss_lost_s` is unset");
        assert_refused("ekf_online_nn", "features = 'tt'\ngnss_lost_s = [100.0, 1e6]", "not a list of features");
        let constant = "mag = 'mag_1_uc'\nfeatures = 'tl'\ngnss_lost_s = [300.0, 1e6]";
        assert!(flown("ekf_online_nn", constant, &flight()).unwrap_err().what.contains("constant"));
        let short = "mag = 'mag_1_uc'\nfeatures = 'attitude'\ngnss_lost_s = [2.0, 1e6]";
        assert!(flown("ekf_online_nn", short, &flight()).unwrap_err().what.contains("too few for training"));
    }
}
