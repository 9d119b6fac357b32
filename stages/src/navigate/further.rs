//! Measurements beside the scalar field: the difference of two magnetometers, the field's vector, a height; the map's error
//! as a state, and samples where the map is too flat.

use arrow_array::ArrayRef;
use numerics::{
    maps::map_surface::Interpolation,
    navigation::{
        aided::{
            self, AidInnovations, AidedOutput, AidedParameters, Aids, Difference, Height, MapError, MapSlope,
            SlopeError, Usage, Vector,
        },
        line::NavigationLine,
        output::NavigationReport,
    },
    signal::gauss_markov::GaussMarkov,
};
use schemas::{Column, Fault, OrAuto, Role, Rule, params};

use super::filter::{Flight, Flown, Track, Update, enough, state_arrays};
use crate::columns::{array, data, faults_of, floats};

params! {
    /// Measurements beside the scalar field.
    pub struct Further;
    /// Two scalar magnetometers, each compensated by itself, whose difference (first minus second) is a measurement of the
    /// map's slope along the line between them. Free of the temporal variation, and of all else that they have in common.
    /// Needs `map_interpolation = "cubic"`: the slope of a bilinear map has steps.
    gradient: Option<[String; 2]>, unit "nT", absent "no difference is measured";
    /// From the second of `gradient` to the first, along nose, right and down. It is turned by the INS' attitude, whose estimated
    /// error is part of the measurement.
    gradient_baseline_m: Option<[f64; 3]>, unit "m", absent "it has to be said with `gradient`", rule Rule::Finite;
    /// One sigma of the white noise of the difference.
    gradient_sigma_nt: f64, unit "nT", default 0.1, rule Rule::Positive;
    /// One sigma of what lasts of the difference, such as what two calibrations leave undetermined.
    gradient_bias_sigma_nt: f64, unit "nT", default 1.0, rule Rule::NotNegative;
    /// Time constant of what lasts of the difference.
    gradient_bias_tau_s: f64, unit "s", default 3600.0, rule Rule::Positive;
    /// One sigma of the error of the map's slope along that line, which the difference has times the baseline: it lasts along the
    /// track, as the map's anomalies do. `"auto"` takes the value with the most likely innovations of the difference, so that a
    /// map of sparse lines is known to be one. Where the map has no slope upwards (one height, no `map_levels_m`), the error
    /// moreover holds the height between the two times the root mean square of the slope.
    gradient_slope_sigma: OrAuto, unit "nT/m", default OrAuto::Auto, rule Rule::NotNegative;
    /// Whether `mag` corrects the INS too. `false` leaves that to the difference and the vector, as in a magnetic storm.
    use_scalar: bool, unit "", default true;
    /// One sigma of the white noise of each component of `vector`, which makes the vector a measurement: of the attitude
    /// about the field, and of the scalar field once more. It needs `core_field`, and a vector magnetometer calibrated by
    /// itself.
    vector_sigma_nt: Option<f64>, unit "nT", absent "the vector is no measurement", rule Rule::Positive;
    /// One sigma of the bias of each component: of 50,000 nT, 50 are 0.06 degrees.
    vector_bias_sigma_nt: f64, unit "nT", default 50.0, rule Rule::NotNegative;
    /// Time constant of the bias.
    vector_bias_tau_s: f64, unit "s", default 3600.0, rule Rule::Positive;
    /// One sigma of each component of the crustal field that a map of the scalar anomaly does not tell: about that of the
    /// anomaly.
    vector_crustal_sigma_nt: f64, unit "nT", default 50.0, rule Rule::NotNegative;
    /// The distance over which that lasts: about the height above the sources.
    vector_crustal_length_m: f64, unit "m", default 1000.0, rule Rule::Positive;
    /// Heights above the ellipsoid as a measurement, such as `baro` of a barometer that does not aid the INS already.
    height: Option<String>, unit "m", absent "the height is that of the INS and its barometer";
    /// One sigma of the white noise of the height.
    height_sigma_m: f64, unit "m", default 3.0, rule Rule::Positive;
    /// One sigma of what lasts of the height's error: the weather, or the geoid.
    height_bias_sigma_m: f64, unit "m", default 30.0, rule Rule::NotNegative;
    /// Time constant of what lasts of the height's error.
    height_bias_tau_s: f64, unit "s", default 3600.0, rule Rule::Positive;
    /// One sigma of the map's error as a state that lasts along the track.
    map_sigma_nt: Option<f64>, unit "nT", absent "the map's error is no state", rule Rule::NotNegative;
    /// The distance over which the correlation of that error falls to 1/e.
    map_sigma_length_m: f64, unit "m", default 500.0, rule Rule::Positive;
    /// One sigma of the delay of the magnetometer's time stamps before the line: the delay is then a state of the filter,
    /// constant along the line. A sample that is stamped `t` was measured at `t` less the delay, which may be negative. Appends
    /// `mag_latency` and `mag_latency_sigma`. Of `ekf`, `iekf` and `ukf`.
    mag_latency_sigma_s: Option<f64>, unit "s", absent "time stamps are exact", rule Rule::Positive;
    /// Where one sigma of a measurement is more than so many metres of the map's horizontal slope, the sample tells no
    /// position: it is `flat`, and corrects the temporal variation and the map's error alone. Appends `map_slope`.
    flat_over_m: Option<f64>, unit "m", absent "no sample is too flat", rule Rule::Positive;
}

/// The slope of the predicted field.
pub(crate) const MAP_SLOPE: &str = "map_slope";

impl Further {
    /// Whether there is any.
    pub(super) fn is_any(&self) -> bool {
        let Self { gradient, vector_sigma_nt, height, map_sigma_nt, mag_latency_sigma_s, flat_over_m, .. } = self;
        let numbers = [vector_sigma_nt, map_sigma_nt, mag_latency_sigma_s, flat_over_m];
        gradient.is_some() || height.is_some() || numbers.iter().any(|number| number.is_some())
    }

    /// Whether it needs the direction of the field.
    pub(super) fn takes_direction(&self) -> bool {
        self.vector_sigma_nt.is_some()
    }

    /// The columns that are read.
    pub(super) fn reads(&self, flight: &Flight) -> Result<Vec<String>, Vec<Fault>> {
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
                        Fault::new("`gradient` needs the line between the magnetometers, `gradient_baseline_m`");
                    faults.push(fault.of_param("gradient"));
                }
                Some(baseline) if baseline.iter().all(|part| *part == 0.0) => {
                    faults.push(Fault::new("`gradient_baseline_m` has no length").of_param("gradient_baseline_m"));
                }
                Some(_) => {}
            }
            if flight.interpolation == Interpolation::Linear {
                let what = "`gradient` measures the map's slope, which has steps where the map is bilinear";
                faults.push(Fault::new(what).of_param("gradient").help("say `map_interpolation = \"cubic\"`"));
            }
            reads.extend(names.iter().cloned());
        }
        if !self.use_scalar && self.gradient.is_none() && self.vector_sigma_nt.is_none() {
            let what = "without the scalar field nothing of the map is measured";
            faults.push(Fault::new(what).of_param("use_scalar").help("name two magnetometers in `gradient`"));
        }
        if self.vector_sigma_nt.is_some() {
            if !flight.has_direction {
                let what = "`vector_sigma_nt` is of a measured vector: `vector`, the name of a vector magnetometer";
                faults.push(Fault::new(what).of_param("vector_sigma_nt"));
            }
            if !flight.core_field {
                let what = "a measured vector holds the core field, of which `core_field = false` is without";
                faults.push(Fault::new(what).of_param("vector_sigma_nt"));
            }
        }
        if let Some(height) = &self.height {
            let found = flight.shape.number(height, "m");
            if found.is_ok() && flight.shape.get(height).is_some_and(|column| column.role == Role::Truth) {
                let what = format!("`{height}` is a truth column, and no height that an aircraft measures");
                faults
                    .push(Fault::new(what).of_param("height").help("name a barometer's or a radar's, such as `baro`"));
            }
            faults.extend(faults_of([found], "height"));
            reads.push(height.clone());
        }
        if faults.is_empty() { Ok(reads) } else { Err(faults) }
    }

    /// Why a key has no say.
    pub(super) fn idle(&self, key: &str) -> Option<Fault> {
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
            _ => return None,
        };
        Some(Fault::new(format!("`{key}` has no say without `{owner}`")).of_param(key))
    }

    /// What is handed out beside the columns of the filter.
    pub(super) fn columns(&self) -> Vec<Column> {
        let mut columns = vec![];
        if self.gradient.is_some() {
            columns.push(Column::float("gradient_residual", "nT", "innovation of the difference of two magnetometers"));
            columns.push(Column::float("gradient_nis", "1", "the same squared over its variance"));
        }
        if self.vector_sigma_nt.is_some() {
            columns.push(Column::float("vector_residual", "nT", "length of the innovation of the vector"));
            columns.push(Column::float("vector_nis", "1", "mean of its squared components over their variances"));
        }
        if self.height.is_some() {
            columns.push(Column::float("height_residual", "m", "innovation of the height"));
            columns.push(Column::float("height_nis", "1", "the same squared over its variance"));
        }
        if self.mag_latency_sigma_s.is_some() {
            columns.push(Column::float("mag_latency", "s", "estimated delay of the magnetometer's time stamps"));
            columns.push(Column::float("mag_latency_sigma", "s", "one sigma of the same"));
        }
        if self.flat_over_m.is_some() {
            let what = "horizontal slope of the predicted field at the estimate; NaN off the map";
            columns.push(Column::float(MAP_SLOPE, "nT/m", what));
        }
        columns
    }

    /// Why it needs the scalar field, in a filter that finds what only that tells, and takes its time stamps as exact.
    pub(super) fn needs_scalar(&self, what_for: &str) -> Result<Vec<String>, Vec<Fault>> {
        if self.use_scalar {
            return self.no_latency();
        }
        Err(vec![
            Fault::new(format!("without the scalar field there is nothing to find {what_for} by"))
                .of_param("use_scalar"),
        ])
    }

    /// Rejects a delay of the magnetometer in a filter that does not estimate it.
    pub(super) fn no_latency(&self) -> Result<Vec<String>, Vec<Fault>> {
        let fault = |_| {
            let what = "`mag_latency_sigma_s` is a state of `ekf`, `iekf` and `ukf` alone";
            vec![Fault::new(what).of_param("mag_latency_sigma_s").help("choose one of these filters to find the delay")]
        };
        self.mag_latency_sigma_s.map_or(Ok(vec![]), |sigma_s| Err(fault(sigma_s)))
    }

    /// What is computed of the columns.
    pub(super) fn measured(&self, flown: &Flown) -> Result<Measured, Fault> {
        let Some(names) = &self.gradient else { return Ok(Measured::default()) };
        let [first, second] = names.each_ref().map(|name| floats(flown.columns, name));
        let difference_nt = first?.iter().zip(second?).map(|(first, second)| first - second).collect();
        let line = NavigationLine { fixes: flown.fixes(), ..flown.line()? };
        let mut measured = Measured { difference_nt, slope: MapSlope::along(&line), slope_sigma: 0.0 };
        measured.slope_sigma = match self.gradient_slope_sigma {
            OrAuto::Given(nt_per_m) => nt_per_m,
            OrAuto::Auto => aided::likely_slope_error(&line, &self.aids(flown, &measured)?, &measured.slope),
        };
        Ok(measured)
    }

    /// The measurements along a line.
    pub(super) fn aids<'a>(&'a self, flown: &'a Flown, measured: &'a Measured) -> Result<Aids<'a>, Fault> {
        let lasting = |sigma, tau_s| GaussMarkov { sigma, tau_s };
        let difference = self.gradient.as_ref().zip(self.gradient_baseline_m).map(|(_, baseline_m)| Difference {
            difference_nt: &measured.difference_nt,
            sigma_nt: self.gradient_sigma_nt,
            baseline_m,
            slope: measured.slope_error(),
            bias: lasting(self.gradient_bias_sigma_nt, self.gradient_bias_tau_s),
        });
        let vector = self.vector_sigma_nt.zip(flown.field_nt).zip(flown.core.as_ref());
        let vector = vector.map(|((sigma_nt, field_nt), core)| Vector {
            field_nt,
            sigma_nt,
            bias: lasting(self.vector_bias_sigma_nt, self.vector_bias_tau_s),
            crustal_sigma_nt: self.vector_crustal_sigma_nt,
            crustal_length_m: self.vector_crustal_length_m,
            core,
        });
        let alt_m = self.height.as_ref().map(|name| floats(flown.columns, name)).transpose()?;
        let height = alt_m.map(|alt_m| Height {
            alt_m,
            sigma_m: self.height_sigma_m,
            bias: lasting(self.height_bias_sigma_m, self.height_bias_tau_s),
        });
        let map_error = self.map_sigma_nt.map(|sigma_nt| MapError { sigma_nt, length_m: self.map_sigma_length_m });
        let (latency_sigma_s, flat_over_m) = (self.mag_latency_sigma_s, self.flat_over_m);
        Ok(Aids { difference, vector, height, map_error, latency_sigma_s, flat_over_m })
    }

    /// Filters a line with these measurements.
    pub(super) fn filter(
        &self,
        flown: &Flown,
        line: &NavigationLine<'_>,
        parameters: &AidedParameters,
    ) -> Result<AidedOutput, Fault> {
        let measured = self.measured(flown)?;
        aided::run(line, &self.aids(flown, &measured)?, parameters).map_err(data)
    }

    /// Refuses a line of which no measurement could be used.
    pub(super) fn enough(&self, flown: &Flown, report: &NavigationReport) -> Result<(), Fault> {
        if self.use_scalar {
            return enough(flown, report);
        }
        if report.updates == 0 {
            return Err(Fault::data("no sample of the difference or the vector could be used")
                .help("does the map cover the flight?"));
        }
        Ok(())
    }

    /// The arrays of [`Further::columns`].
    pub(super) fn arrays(
        &self,
        innovations: AidInnovations,
        latency_s: [Vec<f64>; 2],
        slope_nt_per_m: Vec<f64>,
    ) -> Vec<ArrayRef> {
        let mut more = vec![];
        let AidInnovations { difference, vector, height } = innovations;
        let there = [self.gradient.is_some(), self.vector_sigma_nt.is_some(), self.height.is_some()];
        for (of, _) in [difference, vector, height].into_iter().zip(there).filter(|(_, there)| *there) {
            more.extend([array(of.residual), array(of.nis)]);
        }
        if self.mag_latency_sigma_s.is_some() {
            more.extend(latency_s.map(array));
        }
        if self.flat_over_m.is_some() {
            more.push(array(slope_nt_per_m));
        }
        more
    }

    /// The track of what [`Further::filter`] answers: of a filter's own columns first the bend of the map (where `bend`),
    /// then the states, then those of [`Further::columns`].
    pub(super) fn track(&self, flown: &Flown, mut out: AidedOutput, bend: bool, states: bool) -> Result<Track, Fault> {
        self.enough(flown, &out.navigation.report)?;
        let mut more = vec![];
        if bend {
            more.push(array(std::mem::take(&mut out.nonlinear_sd_nt)));
        }
        if states {
            more.extend(state_arrays(&mut out.navigation)?);
        }
        let latency_s = std::mem::take(&mut out.latency_s);
        more.extend(self.arrays(std::mem::take(&mut out.aids), latency_s, std::mem::take(&mut out.slope_nt_per_m)));
        Ok(Track { update: updates(&out.usage), more, ..Track::without_updates(out.navigation) })
    }
}

/// What is computed of the columns before a line is filtered.
#[derive(Default)]
pub(super) struct Measured {
    difference_nt: Vec<f64>,
    slope: MapSlope,
    /// One sigma of the error of the map's slope along the baseline, in nT/m.
    slope_sigma: f64,
}

impl Measured {
    fn slope_error(&self) -> SlopeError<'_> {
        self.slope.error(self.slope_sigma)
    }
}

/// What became of the samples.
pub(super) fn updates(usage: &[Usage]) -> Vec<Update> {
    let word = |usage: &Usage| match usage {
        Usage::Used => Update::Used,
        Usage::Flat => Update::Flat,
        Usage::Missing => Update::Missing,
        Usage::OffMap => Update::OffMap,
        Usage::Gated => Update::Gated,
    };
    usage.iter().map(word).collect()
}

#[cfg(test)]
mod tests;
