//! The aircraft field as states of a filter: terms of the field, and the prior of their coefficients.

use std::borrow::Cow;

use numerics::navigation::{
    likelihood::AircraftStates,
    online::{CoefficientPrior, check_sources, prior_from_calibrations},
};
use schemas::{ColumnType, Fault, MagneticCorrection, RateDependence, Rule, keys::HashKey, params};

use super::{
    CalibrationPrior,
    filter::{FilterFlight, FilterInput},
};
use crate::{
    columns::{data, matrix, rate_factor, sampling},
    corrections::twice,
};

params! {
    /// Linear model of the aircraft field whose coefficients are estimated in flight.
    pub struct AircraftModelKeys;
    /// List column of the terms, as made by `a_matrix`.
    terms: String, unit "", default "tl";
    /// Standard deviation of the zero-mean prior of a permanent coefficient, unless `model` supplies a prior.
    permanent_sigma_nt: f64, unit "nT", default 2000.0, rule Rule::Positive;
    /// Standard deviation of the zero-mean prior of an induced coefficient, unless `model` supplies a prior.
    induced_sigma_nt: f64, unit "nT", default 1000.0, rule Rule::Positive;
    /// Prior standard deviation of an eddy coefficient at one sample per second. An eddy term contains the change of
    /// the field from one sample to the next, so this value is multiplied by the sample rate of the line.
    eddy_sigma_nt_s: f64, unit "nT s", default 500.0, rule Rule::Positive;
    /// Prior standard deviation of the constant `bias`.
    bias_sigma_nt: f64, unit "nT", default 500.0, rule Rule::Positive;
    /// Prior standard deviation of the coefficient of any other term, such as an electric current, in nT per unit of
    /// the term. A current loop in the cabin causes a few nT per ampere.
    input_sigma_nt: f64, unit "nT", default 20.0, rule Rule::Positive;
    /// Prior standard deviation of each harmonic of the magnetometer's heading error. The terms `heading_1`,
    /// `heading_2` and `heading_4` are the first, second and fourth harmonics of the angle between the sensor axis and
    /// the field. This key requires `vector`.
    heading_error_sigma_nt: Option<f64>, unit "nT", absent "the heading error is not estimated", rule Rule::Positive;
    /// Factor on the prior standard deviations from `model`. A single calibration supplies the standard deviations of
    /// its fit. Several calibrations supply the scatter between them. Some terms, such as eddy terms, are differences
    /// between samples. The coefficients of these terms are converted from the sample rate of the fit to the sample
    /// rate of the line. At rates below about 5 Hz, the differences are inaccurate in manoeuvres: they underestimate a
    /// change at frequency f by the fraction (2 pi f / rate)^2 / 6.
    prior_factor: f64, unit "1", default 1.0, rule Rule::Positive;
}

/// Terms of the aircraft field along a line.
pub(super) struct AircraftTerms<'a> {
    pub(super) names: Vec<String>,
    /// Row-major, one row per sample.
    pub(super) values: Cow<'a, [f64]>,
    /// Terms that depend on the sample rate, and that rate.
    pub(super) sampling: RateDependence,
}

/// Default random walk of a calibrated coefficient in one hour, as a fraction of its prior standard deviation.
const WALK_PER_HOUR: f64 = 0.1;

/// Coefficients of the aircraft field along a line, as states of a filter.
pub(super) struct AircraftCoefficientStates<'a> {
    pub(super) terms: AircraftTerms<'a>,
    pub(super) prior: CoefficientPrior,
    /// Spectral density of each coefficient's random walk, in its unit squared per s.
    pub(super) walk_density: Vec<f64>,
}

impl AircraftCoefficientStates<'_> {
    /// Hash of the terms, their prior and their random walk.
    pub(super) fn hash(&self) -> HashKey {
        const PART: usize = 4096;
        let Self { terms, prior, walk_density } = self;
        let parts = [&*terms.values, &prior.mean, &prior.covariance, walk_density].into_iter();
        let bytes = |part: &[f64]| part.iter().flat_map(|x| x.to_bits().to_le_bytes()).collect::<Vec<u8>>();
        HashKey::from_parts(parts.flat_map(|numbers| numbers.chunks(PART)).map(bytes))
    }

    /// The states as input of the functions in `numerics`.
    pub(super) fn model(&self) -> AircraftStates<'_> {
        AircraftStates { terms: &self.terms.values, prior: &self.prior, walk_density: &self.walk_density }
    }
}

/// Harmonics of the heading error of an optically pumped magnetometer.
const HEADING: [(&str, u32); 3] = [("heading_1", 1), ("heading_2", 2), ("heading_4", 4)];

/// cos kθ for each of the harmonics.
fn heading_terms(cosine: f64) -> impl Iterator<Item = f64> {
    let angle = cosine.acos();
    HEADING.iter().map(move |(_, k)| (f64::from(*k) * angle).cos())
}

impl AircraftModelKeys {
    /// Columns that are read.
    pub(super) fn reads(&self, flight: &FilterFlight) -> Result<Vec<String>, Vec<Fault>> {
        let column = flight.shape.need(&self.terms).map_err(|fault| vec![fault.of_param("terms")])?;
        let ColumnType::List(names) = &column.column_type else {
            let what = format!("`{}` is not a list of terms", self.terms);
            return Err(vec![
                Fault::new(what).of_param("terms").help("set `terms` to the list column of a stage `a_matrix`"),
            ]);
        };
        check_sources(names).map_err(|e| vec![Fault::new(e.to_string()).of_param("terms")])?;
        if self.heading_error_sigma_nt.is_some() && !flight.has_direction {
            let what =
                "`heading_error_sigma_nt` requires the direction of the field: set `vector` to a vector magnetometer";
            return Err(vec![Fault::new(what).of_param("heading_error_sigma_nt")]);
        }
        let key = ("heading_error_sigma_nt", "remove `heading_error_sigma_nt`");
        let asked = Some(self.heading_error_sigma_nt.is_some());
        if let Some(fault) = twice(flight.shape, flight.mags, MagneticCorrection::Heading, asked, key) {
            return Err(vec![fault]);
        }
        Ok(vec![self.terms.clone()])
    }

    /// Terms of the aircraft field along a line.
    pub(super) fn terms<'a>(&self, flown: &'a FilterInput) -> Result<AircraftTerms<'a>, Fault> {
        let (values, mut names) = matrix(flown.columns, &self.terms)?;
        let sampling = sampling(flown.columns, &self.terms)?;
        let (Some(_), Some(cosines)) = (self.heading_error_sigma_nt, &flown.cosines) else {
            return Ok(AircraftTerms { names, values: Cow::Borrowed(values), sampling });
        };
        let rows = values.chunks_exact(names.len().max(1)).zip(cosines);
        let values = rows.flat_map(|(row, cosine)| row.iter().copied().chain(heading_terms(*cosine))).collect();
        names.extend(HEADING.iter().map(|(name, _)| (*name).to_owned()));
        Ok(AircraftTerms { names, values: Cow::Owned(values), sampling })
    }

    /// Coefficients of a line's terms with their prior. `walk_per_hour` is the standard deviation of the random walk of
    /// each coefficient after one hour, divided by its prior standard deviation. If unset, it is 0.1 with calibrations
    /// and 0 without.
    ///
    /// # Errors
    /// Fails if the model has none of the terms, or a term has no equivalent at the rate of the line.
    pub(super) fn states<'a>(
        &self,
        flown: &'a FilterInput,
        walk_per_hour: Option<f64>,
    ) -> Result<AircraftCoefficientStates<'a>, Fault> {
        let terms = self.terms(flown)?;
        let prior = self.prior(&terms, flown.models)?;
        let walk_per_hour = walk_per_hour.unwrap_or(if flown.models.is_empty() { 0.0 } else { WALK_PER_HOUR });
        let walk_density = prior.sigma().iter().map(|sigma| (walk_per_hour * sigma).powi(2) / 3600.0).collect();
        Ok(AircraftCoefficientStates { terms, prior, walk_density })
    }

    /// The prior of the coefficients of a line's terms.
    ///
    /// # Errors
    /// Fails if the model has none of the terms, or a term has no equivalent at the rate of the line.
    pub(super) fn prior(&self, terms: &AircraftTerms, models: &[CalibrationPrior]) -> Result<CoefficientPrior, Fault> {
        let names = &terms.names;
        let cold: Vec<f64> = names.iter().map(|name| self.cold_sigma_nt(name, &terms.sampling)).collect();
        let mut prior = CoefficientPrior::independent(&vec![0.0; names.len()], &cold);
        // Coefficients that all calibrations contain.
        let known: Vec<usize> = (0..names.len())
            .filter(|i| !models.is_empty() && models.iter().all(|m| m.term(&names[*i]).is_some()))
            .collect();
        if !models.is_empty() && known.is_empty() {
            let what = format!("the model has none of the terms of `{}`", self.terms);
            return Err(Fault::data(what).help("fit the model with the same set of terms").of_param("model"));
        }
        let of = |model: &CalibrationPrior| -> Result<(Vec<f64>, Vec<f64>), Fault> {
            let own = known.iter().filter_map(|i| Some((&names[*i], model.term(&names[*i])?)));
            let own = own.map(|(name, (value, sigma))| {
                let factor = rate_factor(&terms.sampling, name, model.rate_hz).map_err(|f| f.of_param("model"))?;
                Ok((factor * value, factor * sigma))
            });
            Ok(own.collect::<Result<Vec<_>, Fault>>()?.into_iter().unzip())
        };
        let calibrations = models.iter().map(of).collect::<Result<Vec<(Vec<f64>, Vec<f64>)>, Fault>>()?;
        let told = match calibrations.as_slice() {
            [] => return Ok(prior),
            [(values, sigmas)] => CoefficientPrior::independent(values, sigmas),
            several => {
                let values: Vec<&[f64]> = several.iter().map(|(values, _)| values.as_slice()).collect();
                prior_from_calibrations(&values, None).map_err(data)?
            }
        };
        for (a, i) in known.iter().enumerate() {
            prior.mean[*i] = told.mean[a];
            for (b, j) in known.iter().enumerate() {
                let entry = told.covariance[a * known.len() + b] * self.prior_factor * self.prior_factor;
                prior.covariance[i * names.len() + j] = entry;
            }
        }
        Ok(prior)
    }

    /// Prior standard deviation of an uncalibrated coefficient. It depends on the group of the coefficient's name: `x`,
    /// `xy` or `xy_dot`, also after the prefix `TL_A_flux_a_` of `features`.
    fn cold_sigma_nt(&self, term: &str, sampling: &RateDependence) -> f64 {
        if let Some(sigma_nt) = self.heading_error_sigma_nt
            && HEADING.iter().any(|(name, _)| *name == term)
        {
            return sigma_nt;
        }
        let (name, changes) = match term.strip_suffix("_dot") {
            Some(name) => (name, true),
            None => (term, false),
        };
        let name = match name.strip_prefix("TL_A_") {
            Some(of_vector) => of_vector.rsplit('_').next().unwrap_or(of_vector),
            None => name,
        };
        let axes = !name.is_empty() && name.chars().all(|axis| matches!(axis, 'x' | 'y' | 'z'));
        match (name.len(), changes) {
            (2, true) if axes => self.eddy_sigma_nt_s * sampling.law(term).and(sampling.rate_hz).unwrap_or(1.0),
            (1, false) if axes => self.permanent_sigma_nt,
            (2, false) if axes => self.induced_sigma_nt,
            _ if name == "bias" => self.bias_sigma_nt,
            _ => self.input_sigma_nt,
        }
    }
}

/// Rejects models if there are several magnetometers, because a model does not name the magnetometer to which it
/// belongs.
pub(super) fn one_with_models(flown: &FilterInput) -> Result<(), Fault> {
    if flown.magnetometers.len() > 1 && !flown.models.is_empty() {
        let what = "`model` requires a single magnetometer, but `mag` names several";
        return Err(Fault::data(what).help("remove `model`, or set `mag` to one magnetometer").of_param("model"));
    }
    Ok(())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn model() -> AircraftModelKeys {
        AircraftModelKeys {
            terms: "tl".to_owned(),
            permanent_sigma_nt: 2000.0,
            induced_sigma_nt: 1000.0,
            eddy_sigma_nt_s: 500.0,
            bias_sigma_nt: 500.0,
            input_sigma_nt: 20.0,
            heading_error_sigma_nt: Some(20.0),
            prior_factor: 2.0,
        }
    }

    fn terms(names: &[&str], rate_hz: f64) -> AircraftTerms<'static> {
        let names: Vec<String> = names.iter().map(ToString::to_string).collect();
        let sampling = RateDependence { rate_hz: Some(rate_hz), ..RateDependence::of_names(&names) };
        AircraftTerms { names, values: Cow::Owned(vec![]), sampling }
    }

    const NAMES: [&str; 5] = ["x", "xy", "zz_dot", "bias", "x_dot"];

    fn calibration(values: [f64; 2]) -> CalibrationPrior {
        let terms = ["xy", "x"].map(str::to_owned).to_vec();
        CalibrationPrior { terms, values_nt: values.to_vec(), sigmas_nt: vec![3.0, 4.0], rate_hz: None }
    }

    #[test]
    fn unit_uncalibrated_terms_have_the_sigma_of_their_family() {
        let prior = model().prior(&terms(&NAMES, 10.0), &[]).unwrap();
        assert_eq!(prior.sigma(), [2000.0, 1000.0, 5000.0, 500.0, 20.0]);
        assert_eq!(prior.mean, [0.0; 5]);
        let of_features = ["TL_A_flux_d_x", "TL_A_flux_d_zz", "TL_A_flux_d_xy_dot", "TL_A_flux_d_bias", "cur_strb"];
        let prior = model().prior(&terms(&of_features, 10.0), &[]).unwrap();
        assert_eq!(prior.sigma(), [2000.0, 1000.0, 5000.0, 500.0, 20.0]);
    }

    #[test]
    fn law_the_heading_error_has_three_harmonics_of_the_angle() {
        // cos 60°, cos 120°, cos 240°.
        let harmonics: Vec<f64> = heading_terms(0.5).collect();
        assert!(
            harmonics.iter().zip([0.5, -0.5, -0.5]).all(|(a, b): (&f64, f64)| (a - b).abs() < 1e-12),
            "{harmonics:?}"
        );
        assert!(heading_terms(f64::NAN).all(f64::is_nan));
        let names = HEADING.map(|(name, _)| name);
        assert_eq!(model().prior(&terms(&names, 10.0), &[]).unwrap().sigma(), [20.0; 3]);
    }

    #[test]
    fn unit_a_calibration_sets_the_prior_of_its_terms_only() {
        let prior = model().prior(&terms(&NAMES, 10.0), &[calibration([30.0, 40.0])]).unwrap();
        assert_eq!(prior.mean, [40.0, 30.0, 0.0, 0.0, 0.0]);
        assert_eq!(prior.sigma(), [8.0, 6.0, 5000.0, 500.0, 20.0]);
        let (cur, one) = (vec!["cur_ac_hi".to_owned()], vec![1.0]);
        let foreign = CalibrationPrior { terms: cur, values_nt: one.clone(), sigmas_nt: one, rate_hz: None };
        assert!(model().prior(&terms(&NAMES, 10.0), &[foreign]).unwrap_err().what.contains("none of the terms"));
    }

    #[test]
    fn unit_a_calibration_of_another_rate_is_converted_or_rejected() {
        let of = |rate_hz: Option<f64>| {
            let terms = ["zz_dot", "x"].map(str::to_owned).to_vec();
            CalibrationPrior { terms, values_nt: vec![300.0, 40.0], sigmas_nt: vec![5.0, 1.0], rate_hz }
        };
        // A difference at 1 Hz is ten times the difference at 10 Hz, so the coefficient at 1 Hz is a tenth of the
        // coefficient at 10 Hz.
        let prior = model().prior(&terms(&NAMES, 1.0), &[of(Some(10.0))]).unwrap();
        assert_eq!((prior.mean[2], prior.mean[0]), (30.0, 40.0));
        let sigma = prior.sigma();
        assert!((sigma[2] - 1.0).abs() < 1e-12 && (sigma[0] - 2.0).abs() < 1e-12, "{sigma:?}");
        let fault = model().prior(&terms(&NAMES, 1.0), &[of(None)]).unwrap_err();
        assert!(fault.what.contains("no `rate_hz`"), "{fault}");
        assert_eq!(fault.param.as_deref(), Some("model"));
        // Terms that do not depend on the rate require no rate.
        assert!(model().prior(&terms(&["x"], 1.0), &[of(None)]).is_ok());
        let per_second = AircraftTerms { sampling: RateDependence::default(), ..terms(&["zz_dot"], 1.0) };
        assert_eq!(model().prior(&per_second, &[]).unwrap().sigma(), [500.0], "a change per second has no rate");
    }

    #[test]
    fn law_the_scatter_of_calibrations_gives_the_prior() {
        let several = [[30.0, 40.0], [34.0, 40.0], [32.0, 46.0]].map(calibration);
        let prior = model().prior(&terms(&NAMES, 10.0), &several).unwrap();
        assert_eq!(prior.mean[..2], [42.0, 32.0]);
        // Variances of 12 and 4 nT². These variances are multiplied by 4/3 for the mean, by 3 because they are
        // estimates, and by the factor.
        for (sigma, variance) in prior.sigma().iter().zip([12.0, 4.0]) {
            assert!((sigma.powi(2) / (variance * 4.0 * 4.0) - 1.0).abs() < 1e-12, "{sigma}");
        }
    }
}
