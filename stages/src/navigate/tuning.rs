//! Assumed noise of a line's measurements: from the spec, the calibration, or the likelihood of the innovations.

use arrow_array::{ArrayRef, RecordBatch};
use numerics::{
    maps::map_surface::MapInterpolation,
    navigation::{
        aided::field_direction,
        likelihood::{self, IntervalEstimate, NoiseParameters, PARAMETERS},
        line::NavigationLine,
        pinson::StateMatrix,
    },
    signal::gauss_markov::GaussMarkov,
};
use schemas::{Column, Fault, NumberOrAuto, Rule, TableShape, choice, flight, map::ERROR, params};

use super::{
    Navigate,
    aircraft::AircraftCoefficientStates,
    filter::{FilterInput, FilterMagnetometer, PermanentStates, UpdateOutcome},
    line_noise::{GivenNoise, LineNoiseEstimate, LineNoiseInputs},
    prepared::NavigationMap,
};
use crate::{
    columns::{array, data, faults_of, floats},
    compensate::NOISE,
    map_errors::NodeErrorSource,
};

choice! {
    /// Source of unset parameters.
    pub enum Tuning {
        /// Noise from the likelihood of each line's innovations, rejection of outliers, and continuation of the map to
        /// the flight heights. The effect of the map's curvature within the position uncertainty counts as measurement
        /// noise.
        Auto = "auto",
        /// Defaults of MagNav.jl, no gate, and the map at its own height.
        Magnav = "magnav",
    }
}

params! {
    /// Assumed noise of the measurement.
    pub struct MeasurementNoise;
    /// Standard deviation of the white noise of a measurement. It includes the noise of the sensor, the map and the
    /// compensation. `"auto"` uses the noise of the calibration residual, from the column `mag_sigma`.
    measurement_sigma_nt: Option<NumberOrAuto>, unit "nT",
        absent "the maximum-likelihood estimate with `tuning = \"auto\"`, otherwise 5.0", rule Rule::Positive;
    /// Standard deviation of the first-order Gauss-Markov process for the temporal variation and all other slow errors.
    /// `"auto"` uses the column `mag_fogm_sigma`.
    fogm_sigma_nt: Option<NumberOrAuto>, unit "nT",
        absent "the maximum-likelihood estimate with `tuning = \"auto\"`, otherwise 3.0", rule Rule::NotNegative;
    /// Time constant of the temporal variation. `"auto"` uses the column `mag_fogm_tau`.
    fogm_tau_s: Option<NumberOrAuto>, unit "s",
        absent "the maximum-likelihood estimate with `tuning = \"auto\"`, otherwise 600.0", rule Rule::Positive;
    /// Column with the standard deviation of an additional error of each sample: `mag_aircraft_sigma` of an ensemble,
    /// or the predicted error of a network. The square of this standard deviation is added to the square of
    /// `measurement_sigma_nt`. A sample without a value in this column has no measurement. Requires a single
    /// magnetometer.
    noise_column: Option<String>, unit "nT", absent "equal noise at all samples";
}

/// Assumed noise: white noise, and a first-order Gauss-Markov process with its time constant.
#[derive(Clone, Copy)]
pub(super) struct AssumedNoise {
    pub(super) sigma_nt: f64,
    pub(super) fogm_sigma_nt: f64,
    pub(super) fogm_tau_s: f64,
}

/// MagNav.jl's white noise (nT), standard deviation of the process (nT) and time constant (s).
const MAGNAV: [f64; 3] = [5.0, 3.0, 600.0];

/// Columns of the estimated noise: name, unit and meaning.
const FOUND: [(&str, &str, &str); PARAMETERS] = [
    ("noise_sigma", "nT", "standard deviation of the white noise of the measurements that are used"),
    ("noise_fogm_sigma", "nT", "standard deviation of the Gauss-Markov process"),
    ("noise_fogm_tau", "s", "time constant of the Gauss-Markov process"),
    (
        "noise_permanent_sigma",
        "nT",
        "standard deviation of the change of the permanent field; 0 unless the filter estimates this change",
    ),
    ("noise_permanent_tau", "s", "time constant of the change of the permanent field"),
];

impl Navigate {
    /// Parameters that may be estimated from the data, each with the column of its estimate.
    pub(super) fn of_calibration(&self) -> [(Option<NumberOrAuto>, &'static str, &'static str, &'static str); 3] {
        let [sigma, fogm_sigma, fogm_tau] = NOISE;
        [
            (self.noise.measurement_sigma_nt, "measurement_sigma_nt", sigma.0, sigma.1),
            (self.noise.fogm_sigma_nt, "fogm_sigma_nt", fogm_sigma.0, fogm_sigma.1),
            (self.noise.fogm_tau_s, "fogm_tau_s", fogm_tau.0, fogm_tau.1),
        ]
    }

    /// Faults of missing columns for parameters that are `auto`.
    pub(super) fn auto_faults(&self, shape: &TableShape) -> Vec<Fault> {
        let wanted = self.of_calibration().into_iter().filter(|(value, ..)| *value == Some(NumberOrAuto::Auto));
        let missing = wanted.filter_map(|(_, param, column, unit)| {
            let fault = shape.number(column, unit).err()?;
            let what = format!("`{param} = \"auto\"` uses the residual of the calibration, but {}", fault.what);
            let help =
                format!("set `input` to a table made by `compensate` or `assume_noise`, or set `{param}` to a number");
            Some(Fault::new(what).help(help).of_param(param))
        });
        missing.collect()
    }

    /// Noise of a line without estimation: from the spec, the calibration, or MagNav.jl.
    pub(super) fn expected(&self, batch: &RecordBatch) -> Result<AssumedNoise, Fault> {
        let mut values = [0.0; 3];
        for (at, (value, param, column, _)) in self.of_calibration().into_iter().enumerate() {
            values[at] = match value {
                None => MAGNAV[at],
                Some(NumberOrAuto::Given(x)) => x,
                Some(NumberOrAuto::Auto) => {
                    let first = floats(batch, column)?.iter().copied().find(|x| x.is_finite());
                    first.ok_or_else(|| {
                        let what = format!(
                            "`{param} = \"auto\"` has no value: the lines of the model's fit are too short to estimate \
                             it"
                        );
                        Fault::data(what).in_column(column).help(format!("set `{param}` to a number"))
                    })?
                }
            };
        }
        let [sigma_nt, mut fogm_sigma_nt, mut fogm_tau_s] = values;
        if self.field.offset_window_s > 0.0 {
            if self.noise.fogm_sigma_nt == Some(NumberOrAuto::Auto) {
                fogm_sigma_nt *= std::f64::consts::SQRT_2;
            }
            if self.noise.fogm_tau_s == Some(NumberOrAuto::Auto) {
                fogm_tau_s *= 2.0;
            }
        }
        Ok(AssumedNoise { sigma_nt, fogm_sigma_nt, fogm_tau_s })
    }

    /// Column with the noise of each sample, if the filter uses the measured field.
    pub(super) fn noise_column(&self) -> Option<&str> {
        self.noise.noise_column.as_deref().filter(|_| self.filter.keys.takes_field())
    }

    /// Faults of the column of the noise.
    pub(super) fn noise_faults(&self, shape: &TableShape) -> Vec<Fault> {
        let Some(column) = self.noise_column() else { return vec![] };
        let mut faults = faults_of([shape.number(column, "nT")], "noise_column");
        if self.field.mag.len() > 1 {
            let what = "`noise_column` requires a single magnetometer, but `mag` names several";
            faults.push(Fault::new(what).of_param("noise_column"));
        }
        if self.field.mag.iter().any(|mag| mag == column) {
            let what = format!("`{column}` is the measurement; `noise_column` requires the column of its noise");
            faults.push(Fault::new(what).of_param("noise_column"));
        }
        faults
    }

    /// Standard deviation of each sample's additional error, in nT; NaN if unknown.
    pub(super) fn sample_sigma_nt(&self, batch: &RecordBatch) -> Result<Option<Vec<f64>>, Fault> {
        let Some(column) = self.noise_column() else { return Ok(None) };
        let values = floats(batch, column)?;
        if let Some(row) = values.iter().position(|sigma| *sigma < 0.0) {
            let what = format!("the standard deviation is {} nT in row {}", values[row], row + 1);
            let help = format!("limit the column to 0 or more with a `derive` stage: `greatest({column}, 0)`");
            return Err(Fault::data(what).in_column(column).help(help));
        }
        Ok(Some(values.iter().map(|sigma| if sigma.is_finite() { *sigma } else { f64::NAN }).collect()))
    }
}

impl Navigate {
    /// Whether unset parameters are estimated from the data.
    pub(super) fn is_auto(&self) -> bool {
        self.field.tuning == Tuning::Auto
    }

    /// Whether noise and outliers of each line are estimated. Otherwise the noise from the spec or MagNav.jl's default
    /// noise applies. Nothing is estimated without a map, for `ekf_online_nn` with an uncompensated magnetometer, or
    /// for the aircraft field of several magnetometers.
    pub(super) fn finds_noise(&self, has_map: bool) -> bool {
        let filter = &self.filter.keys;
        let compensated = |mag: &String| mag == "mag_c" || flight::is_compensated(mag);
        let of_aircraft = filter.aircraft().is_some() && self.field.mag.len() == 1;
        let alone = !filter.takes_models() || of_aircraft || self.field.mag.iter().all(compensated);
        self.is_auto() && has_map && alone && filter.takes_field() && filter.needs_map()
    }

    /// Fixed parameters of the search.
    fn not_searched(&self, expected: &AssumedNoise) -> NoiseParameters {
        let values = [expected.sigma_nt, expected.fogm_sigma_nt, expected.fogm_tau_s];
        let given = self.of_calibration().map(|(value, ..)| value.is_some());
        let [sigma, fogm_sigma, fogm_tau] = [0, 1, 2].map(|at| given[at].then_some(values[at]));
        let further = self.filter.keys.further().filter(|_| self.filter.keys.takes_scalar_states());
        let permanent = further.map_or(Some(0.0), |further| further.permanent_change_sigma_nt);
        let permanent_tau = further.and_then(|further| further.permanent_change_tau_s);
        [sigma, fogm_sigma, fogm_tau, permanent, permanent_tau]
    }

    /// States for the change of the permanent field, if the keys set its standard deviation.
    pub(super) fn given_permanent(&self, flown: &FilterInput) -> Option<PermanentStates> {
        let keys = self.filter.keys.further().filter(|_| self.filter.keys.takes_scalar_states())?;
        let sigma = keys.permanent_change_sigma_nt.filter(|sigma| *sigma > 0.0)?;
        flown.permanent_states(GaussMarkov { sigma, tau_s: keys.permanent_change_tau_s.unwrap_or(f64::INFINITY) })
    }

    /// Prior standard deviations of the lag of the magnetometer, in seconds, and of the bias between the height of the
    /// INS and the height on the map, in metres. 0 if the quantity is not a state; `None` if the likelihood decides
    /// whether it is.
    pub(super) fn given_constants(&self) -> [Option<f64>; 2] {
        let keys = self.filter.keys.further().filter(|_| self.filter.keys.takes_scalar_states());
        keys.map_or([Some(0.0); 2], |keys| [keys.mag_latency_sigma_s, keys.map_height_sigma_m])
    }

    /// Whether the likelihood decides on a state for the height bias.
    pub(super) fn searches_height(&self) -> bool {
        let [_, height] = self.given_constants();
        height.is_none() && self.finds_noise(true) && self.filter.keys.aircraft().is_none()
    }

    /// Whether the track has the columns of the lag, and whether it has the columns of the height bias.
    pub(super) fn has_constants(&self, has_map: bool) -> [bool; 2] {
        self.given_constants().map(|given| given.map_or_else(|| self.finds_noise(has_map), |sigma| sigma > 0.0))
    }

    /// Distance below and above a line to which the map is continued for a height bias that a key requests, in metres.
    pub(super) fn height_reach_m(&self) -> f64 {
        let [_, map_height_sigma_m] = self.given_constants();
        2.0 * map_height_sigma_m.unwrap_or(0.0)
    }

    /// Source of the error of the map's nodes.
    pub(super) fn node_error(&self, map: &RecordBatch) -> NodeErrorSource {
        let known = || floats(map, ERROR).is_ok_and(|error| error.iter().any(|nt| *nt > 0.0));
        match self.interpolation() {
            _ if self.field.map_error_length_m.is_some() || self.is_auto() && known() => NodeErrorSource::Column,
            MapInterpolation::Cubic if self.is_auto() => NodeErrorSource::Interpolation,
            MapInterpolation::Cubic | MapInterpolation::Quadratic | MapInterpolation::Linear => NodeErrorSource::None,
        }
    }

    /// Columns of the estimated noise.
    pub(super) fn noise_columns(&self, has_map: bool) -> Vec<Column> {
        if !self.finds_noise(has_map) {
            return vec![];
        }
        let mut columns = vec![];
        let count = if self.filter.keys.takes_scalar_states() { PARAMETERS } else { PARAMETERS - 2 };
        for (name, unit, what) in FOUND.into_iter().take(count) {
            columns.push(Column::float(name, unit, format!("{what}; NaN where the line is too short to estimate it")));
            columns.push(Column::float(format!("{name}_low"), unit, "lower end of the parameter's 95 % interval"));
            columns.push(Column::float(format!("{name}_high"), unit, "upper end of the parameter's 95 % interval"));
        }
        columns.push(Column::float(
            "noise_inflation",
            "1",
            "factor by which `noise_sigma` is increased for correlated innovations; 1 if the innovations are white. \
             `noise_permanent_tau` is divided by the square of this factor",
        ));
        columns
    }

    /// Arrays of the columns of the estimated noise.
    pub(super) fn noise_arrays(&self, flown: &FilterInput) -> Vec<ArrayRef> {
        if !self.finds_noise(flown.map.is_some()) {
            return vec![];
        }
        let none = IntervalEstimate { value: f64::NAN, low: f64::NAN, high: f64::NAN };
        let found = flown.tuned.as_ref().and_then(|tuned| tuned.noise);
        let mut estimates =
            found.map_or(vec![none; 3], |noise| vec![noise.sigma_nt, noise.fogm_sigma_nt, noise.fogm_tau_s]);
        if self.filter.keys.takes_scalar_states() {
            let constant = IntervalEstimate { value: 0.0, low: 0.0, high: 0.0 };
            let permanent = found.map(|noise| noise.permanent.unwrap_or([constant, none]));
            estimates.extend(permanent.unwrap_or([none; 2]));
        }
        let inflation = found.map_or(f64::NAN, |noise| noise.inflation);
        let values = estimates.iter().flat_map(|of| [of.value, of.low, of.high]).chain([inflation]);
        values.map(|value| array(vec![value; flown.ins.len()])).collect()
    }

    /// Coefficients of the aircraft field that are states of the filter while the noise is estimated.
    fn aircraft_states<'a>(&self, flown: &'a FilterInput) -> Result<Option<AircraftCoefficientStates<'a>>, Fault> {
        let of_filter = self.filter.keys.aircraft().filter(|_| self.field.mag.len() == 1);
        of_filter.map(|(keys, walk_per_hour)| keys.states(flown, walk_per_hour)).transpose()
    }

    /// Estimates the noise of a line, and removes the measurements that are not used. `starts` are the possible
    /// covariances at the first sample; the most likely one is used.
    pub(super) fn tune(
        &self,
        flown: &mut FilterInput,
        map: &NavigationMap,
        starts: &[StateMatrix],
        expected: &AssumedNoise,
        known: &mut Vec<(LineNoiseInputs, LineNoiseEstimate)>,
    ) -> Result<(), Fault> {
        let given = self.not_searched(expected);
        let aircraft = self.aircraft_states(flown)?;
        let constants = if aircraft.is_some() { [Some(0.0); 2] } else { self.given_constants() };
        let given: GivenNoise = (given, aircraft.as_ref(), constants);
        let asked = LineNoiseInputs::new(flown, given);
        let tuned = match known.iter().find(|(other, _)| *other == asked) {
            Some((_, tuned)) => tuned.clone(),
            None => {
                let of_map = self.field.map_error_length_m.is_none();
                let tuned = LineNoiseEstimate::most_likely(flown, of_map, map, starts, given)?;
                known.push((asked, tuned.clone()));
                tuned
            }
        };
        drop(aircraft);
        tuned.apply(flown);
        flown.tuned = Some(tuned);
        Ok(())
    }

    /// Removes outliers: from each magnetometer if the filter processes them separately, otherwise from their mean.
    ///
    /// # Errors
    /// Fails in the cases of [`likelihood::outliers`] and [`AircraftStates::along`](likelihood::AircraftStates::along).
    pub(super) fn reject_outliers(&self, flown: &mut FilterInput) -> Result<(), Fault> {
        let Some(aircraft) = self.aircraft_states(flown)? else { return flown.reject_outliers() };
        let line = NavigationLine { fixes: flown.fixes(), ..flown.line()? };
        let rejected = aircraft.model().along(&line).map_err(data)?.rejected;
        drop(aircraft);
        flown.leave_out(UpdateOutcome::Gated, &rejected);
        let each = std::mem::take(&mut flown.magnetometers);
        flown.restore(each);
        Ok(())
    }
}

impl FilterInput<'_> {
    /// Unit vectors of the core field along nose, right and down at some samples; `None` without a core field.
    pub(super) fn field_directions(&self, rows: &[usize]) -> Option<Vec<[f64; 3]>> {
        let core = self.core.as_ref()?;
        Some(rows.iter().map(|row| field_direction(core, &self.ins, *row)).collect())
    }

    /// States for a change of the permanent field that follows this process; `None` without a core field.
    pub(super) fn permanent_states(&self, process: GaussMarkov) -> Option<PermanentStates> {
        let rows: Vec<usize> = (0..self.ins.len()).collect();
        Some(PermanentStates { direction: self.field_directions(&rows)?, process })
    }

    /// White noise of each measurement, divided by the white noise of one magnetometer.
    pub(super) fn scale(&self) -> Vec<f64> {
        let factor = |row: usize| self.noise_factors.as_ref().map_or(1.0, |factors| factors[row]);
        (0..self.ins.len()).map(|row| factor(row) / self.counts[row].sqrt()).collect()
    }

    /// Standard deviation of the known error of each measurement, in nT: the additional error of each sample, averaged
    /// over the magnetometers.
    pub(super) fn known_nt(&self) -> Option<Vec<f64>> {
        let own = self.sample_sigma_nt.as_ref()?;
        Some(own.iter().zip(&self.counts).map(|(sigma, count)| sigma / count.sqrt()).collect())
    }

    /// Removes measurements and records their outcome.
    pub(super) fn leave_out(&mut self, fate: UpdateOutcome, which: &[bool]) {
        self.left_out.resize(self.ins.len(), None);
        for (row, _) in which.iter().enumerate().filter(|(_, is)| **is) {
            if self.measured_nt[row].is_finite() {
                self.left_out[row] = Some(fate);
            }
            self.measured_nt[row] = f64::NAN;
        }
    }

    /// Removes outliers of compensated magnetometers.
    fn reject_outliers(&mut self) -> Result<(), Fault> {
        let line = NavigationLine { fixes: self.fixes(), ..self.line()? };
        let states = self.scalar_states();
        let rejected = likelihood::outliers(&line, &states).map_err(data)?;
        let mut of_each = vec![];
        for FilterMagnetometer { measured_nt, .. } in &self.magnetometers {
            let line = NavigationLine { measurement_nt: measured_nt, ..line };
            let rejected = likelihood::outliers(&line, &states).map_err(data)?;
            of_each.push(measured_nt.iter().zip(rejected).map(|(nt, out)| if out { f64::NAN } else { *nt }).collect());
        }
        self.magnetometers.iter_mut().zip(of_each).for_each(|(mag, own)| mag.measured_nt = own);
        self.leave_out(UpdateOutcome::Gated, &rejected);
        Ok(())
    }
}
