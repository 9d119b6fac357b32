//! Measurements in addition to the scalar field: the difference of two magnetometers, the field vector, a height. The
//! module also covers the map error as a state, and samples at which the map is too flat.

use arrow_array::ArrayRef;
use numerics::{
    maps::map_surface::MapInterpolation,
    navigation::{
        aided::{
            self, AidInnovations, AidedOutput, AidedParameters, Aids, DifferenceAid, HeightAid, MapErrorProcess,
            MapSlope, SampleUsage, SlopeError, VectorAid,
        },
        line::NavigationLine,
        output::NavigationReport,
    },
    signal::gauss_markov::GaussMarkov,
};
use schemas::{Column, Fault, NumberOrAuto, Role, Rule, params};

use super::filter::{FilterFlight, FilterInput, FilterTrack, PermanentStates, UpdateOutcome, enough, state_arrays};
use crate::columns::{array, data, faults_of, floats};

params! {
    /// Measurements in addition to the scalar field.
    pub struct AuxiliaryMeasurements;
    /// Two compensated scalar magnetometers. The difference between their readings, first minus second, measures the
    /// slope of the map along the baseline between them. The temporal variation and all other common errors cancel in
    /// this difference. This key cannot be combined with `map_interpolation = "linear"`, because the slope of a
    /// bilinear map has steps.
    gradient: Option<[String; 2]>, unit "nT", absent "the difference is not used";
    /// Vector from the second magnetometer of `gradient` to the first, in the body frame (nose, right, down). The INS
    /// attitude rotates this vector to the navigation frame. The measurement model includes the estimated error of the
    /// INS attitude.
    gradient_baseline_m: Option<[f64; 3]>, unit "m", absent "required with `gradient`", rule Rule::Finite;
    /// Standard deviation of the white noise in the difference between the two magnetometers' readings.
    gradient_sigma_nt: f64, unit "nT", default 0.1, rule Rule::Positive;
    /// Standard deviation of the slowly varying error in the difference between the two magnetometers' readings. Such
    /// an error is likely, because each calibration leaves a constant undetermined.
    gradient_bias_sigma_nt: f64, unit "nT", default 1.0, rule Rule::NotNegative;
    /// Time constant of the slowly varying error in the difference between the two magnetometers' readings.
    gradient_bias_tau_s: f64, unit "s", default 3600.0, rule Rule::Positive;
    /// Standard deviation of the error in the map's slope along the baseline. The error of the predicted difference is
    /// this error times the length of the baseline. The error is correlated along the track, over the same length as
    /// the map's anomalies. `"auto"` uses the maximum-likelihood value from the innovations of the difference. A large
    /// value can reveal a map made from widely spaced lines. A map at one height without `map_levels_m` has no vertical
    /// slope. The prediction then has an additional error: the height difference between the magnetometers times the
    /// rms slope.
    gradient_slope_sigma: NumberOrAuto, unit "nT/m", default NumberOrAuto::Auto, rule Rule::NotNegative;
    /// Uses the scalar measurement `mag` in the measurement update. `false` ignores `mag`, for example in a magnetic
    /// storm, and requires the difference (`gradient`) or the vector (`vector_sigma_nt`).
    use_scalar: bool, unit "", default true;
    /// Standard deviation of the white noise of each component of `vector`. If set, the components are used as
    /// measurements. They depend on the total field and on the attitude, but not on a rotation about the field
    /// direction. This key requires `core_field = true` and a calibrated vector magnetometer.
    vector_sigma_nt: Option<f64>, unit "nT", absent "the vector is not used as a measurement", rule Rule::Positive;
    /// Standard deviation of the bias of each component of `vector`. In a field of 50,000 nT, a bias of 50 nT
    /// corresponds to an attitude error of 0.06°.
    vector_bias_sigma_nt: f64, unit "nT", default 50.0, rule Rule::NotNegative;
    /// Time constant of the bias of each component of `vector`.
    vector_bias_tau_s: f64, unit "s", default 3600.0, rule Rule::Positive;
    /// Standard deviation, per component, of the crustal field that a map of the scalar anomaly leaves undetermined. A
    /// typical value is the standard deviation of the anomaly.
    vector_crustal_sigma_nt: f64, unit "nT", default 50.0, rule Rule::NotNegative;
    /// Correlation length of the crustal field that `vector_crustal_sigma_nt` describes. A typical value is the height
    /// above the sources.
    vector_crustal_length_m: f64, unit "m", default 1000.0, rule Rule::Positive;
    /// Column of measured heights above the ellipsoid, such as `baro`, from a barometer that does not already aid the
    /// INS.
    height: Option<String>, unit "m", absent "the height of the INS, aided by its barometer, is used";
    /// Standard deviation of the white noise of the measured height.
    height_sigma_m: f64, unit "m", default 3.0, rule Rule::Positive;
    /// Standard deviation of the slowly varying error of the measured height, caused by the weather and the geoid.
    height_bias_sigma_m: f64, unit "m", default 30.0, rule Rule::NotNegative;
    /// Time constant of the slowly varying error of the measured height.
    height_bias_tau_s: f64, unit "s", default 3600.0, rule Rule::Positive;
    /// Standard deviation of the map error. If set, the filter estimates the map error as a state that is correlated
    /// along the track.
    map_sigma_nt: Option<f64>, unit "nT", absent "the map error is not estimated", rule Rule::NotNegative;
    /// Distance over which the autocorrelation of the map error falls to 1/e.
    map_sigma_length_m: f64, unit "m", default 500.0, rule Rule::Positive;
    /// Prior standard deviation of the lag of the magnetometer's time stamps. If set, the filter estimates the lag as a
    /// state that is constant along the line. A sample with time stamp `t` was measured at `t` minus the lag. The lag
    /// may be negative. 0 omits this state. The columns `mag_latency` and `mag_latency_sigma` are appended. This key is
    /// available in `ekf`, `iekf` and `ukf`.
    mag_latency_sigma_s: Option<f64>, unit "s",
        absent "1.0 with `tuning = \"auto\"` if a state for the lag clearly increases the likelihood, otherwise 0 \
            (exact time stamps)",
        rule Rule::NotNegative;
    /// Prior standard deviation of a height bias: the true height of the aircraft minus its assumed height on the map.
    /// Possible causes are a constant error of the barometer, a missing geoid height, and a wrong map height. If set,
    /// the filter estimates the bias as a state that is constant along the line. The bias changes only the predicted
    /// total field, not `alt`. The heights to which the map is continued must include the true height of the aircraft.
    /// With `tuning = "auto"`, the map is continued to twice this standard deviation below and above the line.
    /// Otherwise, set `map_levels_m`. 0 omits this state. The columns `map_height_bias` and `map_height_bias_sigma` are
    /// appended. This key is available in `ekf`, `iekf` and `ukf`.
    map_height_sigma_m: Option<f64>, unit "m",
        absent "50 with `tuning = \"auto\"` if a bias clearly increases the likelihood, otherwise 0 (exact height). To \
            find a bias, `auto` continues the map up to 200 m below and above the line, unless `map_levels_m` is set",
        rule Rule::NotNegative;
    /// Standard deviation of the change in the aircraft's permanent field since calibration, per component (nose,
    /// right, down). The filter estimates the three components as additional states. The attitude and the core field
    /// determine the effect of these components on the total field. A fourth state is a constant offset with a standard
    /// deviation of 100 nT. 0 omits these states. This key requires `core_field = true`, and is available in `ekf`,
    /// `iekf` and `ukf`.
    permanent_change_sigma_nt: Option<f64>, unit "nT",
        absent "the maximum-likelihood estimate with `tuning = \"auto\"` if these states clearly increase the \
            likelihood, otherwise 0",
        rule Rule::NotNegative;
    /// Time constant of the change in the permanent field.
    permanent_change_tau_s: Option<f64>, unit "s",
        absent "the maximum-likelihood estimate with `tuning = \"auto\"`, otherwise infinite, so that the \
            change is constant along the line",
        rule Rule::Positive;
    /// A sample corrects the position only if the ratio of its measurement noise (standard deviation) to the map's
    /// horizontal slope is at most this value. At a larger ratio, the map is too flat to observe the position. The
    /// sample is then `flat`: it corrects only the temporal variation and the map error. The column `map_slope` is
    /// appended.
    flat_over_m: Option<f64>, unit "m", absent "all samples correct the position", rule Rule::Positive;
}

/// Column with the slope of the predicted field.
pub(crate) const MAP_SLOPE: &str = "map_slope";

impl AuxiliaryMeasurements {
    /// Whether any further measurement is set.
    pub(super) fn is_any(&self) -> bool {
        let Self { gradient, vector_sigma_nt, height, map_sigma_nt, flat_over_m, .. } = self;
        let numbers = [vector_sigma_nt, map_sigma_nt, flat_over_m];
        gradient.is_some() || height.is_some() || numbers.iter().any(|number| number.is_some())
    }

    /// Whether a line is filtered with states or measurements in addition to those of the scalar field.
    pub(super) fn applies_to(&self, flown: &FilterInput) -> bool {
        let constants = [flown.latency_sigma_s, flown.map_height_sigma_m];
        self.is_any() || flown.permanent.is_some() || constants.iter().any(Option::is_some)
    }

    /// Whether states for a change of the permanent field are requested.
    pub(super) fn has_permanent(&self) -> bool {
        self.permanent_change_sigma_nt.is_some_and(|sigma_nt| sigma_nt > 0.0)
    }

    /// Whether a state for the lag is requested.
    fn has_latency(&self) -> bool {
        self.mag_latency_sigma_s.is_some_and(|sigma_s| sigma_s > 0.0)
    }

    /// Whether a state for the height bias is requested.
    fn has_map_height(&self) -> bool {
        self.map_height_sigma_m.is_some_and(|sigma_m| sigma_m > 0.0)
    }

    /// Whether the direction of the field is required.
    pub(super) fn takes_direction(&self) -> bool {
        self.vector_sigma_nt.is_some()
    }

    /// Columns that are read.
    pub(super) fn reads(&self, flight: &FilterFlight) -> Result<Vec<String>, Vec<Fault>> {
        let mut faults = vec![];
        let mut reads: Vec<String> = vec![];
        if let Some(names) = &self.gradient {
            faults.extend(faults_of(names.iter().map(|name| flight.shape.number(name, "nT")), "gradient"));
            if names[0] == names[1] {
                faults.push(Fault::new(format!("`{}` is a duplicate", names[0])).of_param("gradient"));
            }
            match self.gradient_baseline_m {
                None => {
                    let fault =
                        Fault::new("`gradient` requires `gradient_baseline_m`, the vector between the magnetometers");
                    faults.push(fault.of_param("gradient"));
                }
                Some(baseline) if baseline.iter().all(|part| *part == 0.0) => {
                    faults.push(Fault::new("`gradient_baseline_m` has length 0").of_param("gradient_baseline_m"));
                }
                Some(_) => {}
            }
            if flight.interpolation == MapInterpolation::Linear {
                let what = "`gradient` measures the map's slope, which has steps in a bilinear map";
                faults.push(Fault::new(what).of_param("gradient").help("set `map_interpolation = \"cubic\"`"));
            }
            reads.extend(names.iter().cloned());
        }
        if !self.use_scalar && self.gradient.is_none() && self.vector_sigma_nt.is_none() {
            let what = "without the scalar field no measurement depends on the map";
            faults.push(Fault::new(what).of_param("use_scalar").help("name two magnetometers in `gradient`"));
        }
        if self.vector_sigma_nt.is_some() {
            if !flight.has_direction {
                let what = "`vector_sigma_nt` requires `vector`, the name of a vector magnetometer";
                faults.push(Fault::new(what).of_param("vector_sigma_nt"));
            }
            if !flight.core_field {
                let what = "`vector_sigma_nt` requires `core_field = true`: the vector contains the core field";
                faults.push(Fault::new(what).of_param("vector_sigma_nt"));
            }
        }
        if self.has_permanent() && !self.use_scalar {
            let what = "`permanent_change_sigma_nt` has no effect with `use_scalar = false`";
            faults.push(Fault::new(what).of_param("permanent_change_sigma_nt"));
        }
        if self.has_permanent() && !flight.core_field {
            let what =
                "`permanent_change_sigma_nt` requires `core_field = true`, which gives the direction of the field";
            faults.push(Fault::new(what).of_param("permanent_change_sigma_nt"));
        }
        if let Some(height) = &self.height {
            let found = flight.shape.number(height, "m");
            if found.is_ok() && flight.shape.get(height).is_some_and(|column| column.role == Role::Truth) {
                let what = format!("`{height}` is a truth column, not a measured height");
                faults.push(
                    Fault::new(what).of_param("height").help("name the column of a barometer or radar, such as `baro`"),
                );
            }
            faults.extend(faults_of([found], "height"));
            reads.push(height.clone());
        }
        if faults.is_empty() { Ok(reads) } else { Err(faults) }
    }

    /// Fault of a key that has no effect.
    pub(super) fn unused_key(&self, key: &str) -> Option<Fault> {
        let owner = match key {
            "gradient_baseline_m"
            | "gradient_sigma_nt"
            | "gradient_bias_sigma_nt"
            | "gradient_bias_tau_s"
            | "gradient_slope_sigma"
                if self.gradient.is_none() =>
            {
                "gradient"
            }
            "vector_bias_sigma_nt" | "vector_bias_tau_s" | "vector_crustal_sigma_nt" | "vector_crustal_length_m"
                if self.vector_sigma_nt.is_none() =>
            {
                "vector_sigma_nt"
            }
            "height_sigma_m" | "height_bias_sigma_m" | "height_bias_tau_s" if self.height.is_none() => "height",
            "map_sigma_length_m" if self.map_sigma_nt.is_none() => "map_sigma_nt",
            "permanent_change_tau_s" if self.permanent_change_sigma_nt == Some(0.0) => "permanent_change_sigma_nt",
            _ => return None,
        };
        Some(Fault::new(format!("`{key}` has no effect without `{owner}`")).of_param(key))
    }

    /// Columns in addition to those of the filter.
    pub(super) fn columns(&self) -> Vec<Column> {
        let mut columns = vec![];
        if self.gradient.is_some() {
            columns.push(Column::float("gradient_residual", "nT", "innovation of the difference of two magnetometers"));
            columns.push(Column::float("gradient_nis", "1", "normalised innovation squared of the difference"));
        }
        if self.vector_sigma_nt.is_some() {
            columns.push(Column::float(
                "vector_residual",
                "nT",
                "magnitude of the innovation of the vector-magnetometer measurement",
            ));
            columns.push(Column::float(
                "vector_nis",
                "1",
                "mean normalised innovation squared of the components of the vector",
            ));
        }
        if self.height.is_some() {
            columns.push(Column::float("height_residual", "m", "innovation of the height"));
            columns.push(Column::float("height_nis", "1", "normalised innovation squared of the height"));
        }
        if self.flat_over_m.is_some() {
            let what = "horizontal slope of the predicted field at the estimate; NaN off the map";
            columns.push(Column::float(MAP_SLOPE, "nT/m", what));
        }
        columns
    }

    /// Rejects `use_scalar = false`, and states of the scalar measurement, in a filter that requires the scalar field.
    pub(super) fn needs_scalar(&self, what_for: &str) -> Result<Vec<String>, Vec<Fault>> {
        if self.use_scalar {
            return self.no_scalar_states();
        }
        Err(vec![Fault::new(format!("without the scalar field {what_for} cannot be estimated")).of_param("use_scalar")])
    }

    /// Rejects the lag of the magnetometer, the height bias and the change of the permanent field in a filter that does
    /// not estimate them.
    pub(super) fn no_scalar_states(&self) -> Result<Vec<String>, Vec<Fault>> {
        let states = [
            (self.has_latency(), "mag_latency_sigma_s", "the lag"),
            (self.has_map_height(), "map_height_sigma_m", "this bias"),
            (self.has_permanent(), "permanent_change_sigma_nt", "this change"),
        ];
        let fault = |(_, key, what): (bool, &str, &str)| {
            Fault::new(format!("`{key}` is available only in `ekf`, `iekf` and `ukf`"))
                .of_param(key)
                .help(format!("set `filter` to `ekf`, `iekf` or `ukf` to estimate {what}"))
        };
        let faults: Vec<Fault> = states.into_iter().filter(|(set, ..)| *set).map(fault).collect();
        if faults.is_empty() { Ok(vec![]) } else { Err(faults) }
    }

    /// Rejects `flat_over_m` in a filter with particles.
    pub(super) fn no_flat(&self) -> Result<Vec<String>, Vec<Fault>> {
        if self.flat_over_m.is_none() {
            return Ok(vec![]);
        }
        let what = "the weights of particles do not depend on the map slope: `flat_over_m` is not available";
        let help = "remove `flat_over_m`, and set `map_sigma_nt` to the map error";
        Err(vec![Fault::new(what).of_param("flat_over_m").help(help)])
    }

    /// Difference of the two magnetometers in `gradient`, with the slope of the map and the error of this slope.
    pub(super) fn measured(&self, flown: &FilterInput) -> Result<GradientSeries, Fault> {
        let Some(names) = &self.gradient else { return Ok(GradientSeries::default()) };
        let [first, second] = names.each_ref().map(|name| floats(flown.columns, name));
        let difference_nt = first?.iter().zip(second?).map(|(first, second)| first - second).collect();
        let line = NavigationLine { fixes: flown.fixes(), ..flown.line()? };
        let mut measured = GradientSeries { difference_nt, slope: MapSlope::along(&line), slope_sigma: 0.0 };
        measured.slope_sigma = match self.gradient_slope_sigma {
            NumberOrAuto::Given(nt_per_m) => nt_per_m,
            NumberOrAuto::Auto => aided::likely_slope_error(&line, &self.aids(flown, &measured)?, &measured.slope),
        };
        Ok(measured)
    }

    /// The measurements along a line.
    pub(super) fn aids<'a>(&'a self, flown: &'a FilterInput, measured: &'a GradientSeries) -> Result<Aids<'a>, Fault> {
        let lasting = |sigma, tau_s| GaussMarkov { sigma, tau_s };
        let difference = self.gradient.as_ref().zip(self.gradient_baseline_m).map(|(_, baseline_m)| DifferenceAid {
            difference_nt: &measured.difference_nt,
            sigma_nt: self.gradient_sigma_nt,
            baseline_m,
            slope: measured.slope_error(),
            bias: lasting(self.gradient_bias_sigma_nt, self.gradient_bias_tau_s),
        });
        let vector = self.vector_sigma_nt.zip(flown.field_nt).zip(flown.core.as_ref());
        let vector = vector.map(|((sigma_nt, field_nt), core)| VectorAid {
            field_nt,
            sigma_nt,
            bias: lasting(self.vector_bias_sigma_nt, self.vector_bias_tau_s),
            crustal_sigma_nt: self.vector_crustal_sigma_nt,
            crustal_length_m: self.vector_crustal_length_m,
            core,
        });
        let alt_m = self.height.as_ref().map(|name| floats(flown.columns, name)).transpose()?;
        let height = alt_m.map(|alt_m| HeightAid {
            alt_m,
            sigma_m: self.height_sigma_m,
            bias: lasting(self.height_bias_sigma_m, self.height_bias_tau_s),
        });
        let map_error =
            self.map_sigma_nt.map(|sigma_nt| MapErrorProcess { sigma_nt, length_m: self.map_sigma_length_m });
        let flat_over_m = self.flat_over_m;
        Ok(Aids { difference, vector, height, map_error, flat_over_m, ..flown.scalar_states() })
    }

    /// Filters a line with these measurements.
    pub(super) fn filter(
        &self,
        flown: &FilterInput,
        line: &NavigationLine<'_>,
        parameters: &AidedParameters,
    ) -> Result<AidedOutput, Fault> {
        let measured = self.measured(flown)?;
        aided::run(line, &self.aids(flown, &measured)?, parameters).map_err(data)
    }

    /// Rejects a line without a usable measurement.
    pub(super) fn enough(&self, flown: &FilterInput, report: &NavigationReport) -> Result<(), Fault> {
        if self.use_scalar {
            return enough(flown, report);
        }
        if report.updates == 0 {
            return Err(Fault::data("no sample of the field difference or of the vector magnetometer could be used")
                .help("check that the map covers the flight"));
        }
        Ok(())
    }

    /// The arrays of [`AuxiliaryMeasurements::columns`].
    pub(super) fn arrays(&self, innovations: AidInnovations, slope_nt_per_m: Vec<f64>) -> Vec<ArrayRef> {
        let mut more = vec![];
        let AidInnovations { difference, vector, height } = innovations;
        let there = [self.gradient.is_some(), self.vector_sigma_nt.is_some(), self.height.is_some()];
        for (of, _) in [difference, vector, height].into_iter().zip(there).filter(|(_, there)| *there) {
            more.extend([array(of.residual), array(of.nis)]);
        }
        if self.flat_over_m.is_some() {
            more.push(array(slope_nt_per_m));
        }
        more
    }

    /// Track of the output of [`AuxiliaryMeasurements::filter`]. The track has the columns of the map's nonlinearity
    /// (if `bend`), of the states (if `states`), and of [`AuxiliaryMeasurements::columns`].
    pub(super) fn track(
        &self,
        flown: &FilterInput,
        mut out: AidedOutput,
        bend: bool,
        states: bool,
    ) -> Result<FilterTrack, Fault> {
        self.enough(flown, &out.navigation.report)?;
        let mut more = vec![];
        if bend {
            more.push(array(std::mem::take(&mut out.nonlinear_sd_nt)));
        }
        if states {
            more.extend(state_arrays(&mut out.navigation)?);
        }
        let constants = [&mut out.latency_s, &mut out.map_height_m].map(std::mem::take);
        more.extend(flown.constant_arrays(constants));
        more.extend(self.arrays(std::mem::take(&mut out.aids), std::mem::take(&mut out.slope_nt_per_m)));
        Ok(FilterTrack { update: updates(&out.usage), more, ..FilterTrack::without_updates(out.navigation) })
    }
}

/// Columns of the constant states of the scalar measurement: the lag of the magnetometer, and the bias between the
/// height of the INS and the height on the map.
pub(super) fn constant_columns([has_latency, has_map_height]: [bool; 2]) -> Vec<Column> {
    let none = "unless the filter estimates it";
    let lag = format!("estimated lag of the magnetometer's time stamps; 0 {none}");
    let height = format!("estimated height of the aircraft above its assumed height on the map; 0 {none}");
    let named = [(has_latency, "mag_latency", "s", lag), (has_map_height, "map_height_bias", "m", height)];
    let of = |(_, name, unit, what): (bool, &str, &'static str, String)| {
        let sigma = format!("standard deviation of `{name}`; NaN {none}");
        [Column::float(name, unit, what), Column::float(format!("{name}_sigma"), unit, sigma)]
    };
    named.into_iter().filter(|(is, ..)| *is).flat_map(of).collect()
}

impl FilterInput<'_> {
    /// Arrays of [`constant_columns`], from the estimates of lag and height bias and the standard deviations of these
    /// estimates. Values are empty if the quantity is not a state.
    pub(super) fn constant_arrays(&self, constants: [[Vec<f64>; 2]; 2]) -> Vec<ArrayRef> {
        let rows = self.ins.len();
        let of = |[values, sigmas]: [Vec<f64>; 2]| match values.is_empty() {
            true => [0.0, f64::NAN].map(|value| array(vec![value; rows])),
            false => [values, sigmas].map(array),
        };
        let there = constants.into_iter().zip(self.has_constants).filter(|(_, has)| *has);
        there.flat_map(|(constant, _)| of(constant)).collect()
    }

    /// Further states of the scalar measurement.
    pub(super) fn scalar_states(&self) -> Aids<'_> {
        Aids {
            permanent: self.permanent.as_ref().map(PermanentStates::model),
            latency_sigma_s: self.latency_sigma_s,
            map_height_sigma_m: self.map_height_sigma_m,
            ..Aids::default()
        }
    }
}

/// Difference of two magnetometers along a line, with the slope of the map. Computed before the line is filtered.
#[derive(Default)]
pub(super) struct GradientSeries {
    difference_nt: Vec<f64>,
    slope: MapSlope,
    /// Standard deviation of the error of the map's slope along the baseline, in nT/m.
    slope_sigma: f64,
}

impl GradientSeries {
    fn slope_error(&self) -> SlopeError<'_> {
        self.slope.error(self.slope_sigma)
    }
}

/// Outcomes of the samples.
pub(super) fn updates(usage: &[SampleUsage]) -> Vec<UpdateOutcome> {
    let word = |usage: &SampleUsage| match usage {
        SampleUsage::Used => UpdateOutcome::Used,
        SampleUsage::Flat => UpdateOutcome::Flat,
        SampleUsage::Missing => UpdateOutcome::Missing,
        SampleUsage::OffMap => UpdateOutcome::OffMap,
        SampleUsage::Gated => UpdateOutcome::Gated,
    };
    usage.iter().map(word).collect()
}

#[cfg(test)]
mod tests;
