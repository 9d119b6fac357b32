//! Estimates the noise of one line, and also the time of the INS alignment if this time is unknown.

use numerics::navigation::{
    ins_error::InsErrorModel,
    likelihood::{self, LineNoise, NoiseParameters, NoiseSearch},
    line::NavigationLine,
    output::NavigationError,
    pinson::StateMatrix,
};
use numerics::signal::gauss_markov::GaussMarkov;
use schemas::{Fault, keys::HashKey};

use super::{
    aircraft::AircraftCoefficientStates,
    filter::{FilterInput, UpdateOutcome},
    prepared::NavigationMap,
};
use crate::columns::data;

/// Time between two measurements used to estimate the noise, in seconds. Errors with a shorter correlation time are
/// treated as white noise.
pub(super) const INTERVAL_S: f64 = 5.0;
/// The error of a map is used if the ratio of its rms over the nodes to the white noise exceeds this value.
const LEAST_MAP_ERROR: f64 = 0.2;
/// Time between two measurements, in seconds, if the innovations at this interval are white.
const SHORT_INTERVAL_S: f64 = 1.0;

/// Inputs that determine the noise of a line.
#[derive(PartialEq)]
pub(super) struct LineNoiseInputs {
    map: *const u8,
    given: NoiseParameters,
    constants: [Option<f64>; 2],
    offset_window_s: f64,
    start: Vec<u64>,
    values: Vec<u64>,
    /// Hash of the terms of the aircraft field, of their prior and of their random walk. Only the hash is kept, because
    /// the terms occupy many times as much memory as the measurements.
    aircraft: Option<HashKey>,
}

impl LineNoiseInputs {
    pub(super) fn new(flown: &FilterInput, (given, aircraft, constants): GivenNoise) -> Self {
        let errors = &flown.errors;
        let first = errors.initial_covariance(flown.ins.lat_deg[0].to_radians(), flown.ins.alt_m[0]);
        let density = errors.noise_density();
        let start = first.as_flattened().iter().chain(&density).map(|x| x.to_bits()).collect();
        let fixes = flown.fixes().map(|fixes| [&fixes.lat_deg, &fixes.lon_deg, &fixes.alt_m]);
        let columns = [&flown.measured_nt].into_iter().chain(fixes.into_iter().flatten());
        let more = flown.scale().into_iter().chain(flown.known_nt().into_iter().flatten());
        let values = columns.flatten().copied().chain(more).map(f64::to_bits).collect();
        let aircraft = aircraft.map(AircraftCoefficientStates::hash);
        let map = flown.map.map_or(std::ptr::null(), |map| std::ptr::from_ref(map).cast());
        let offset_window_s = flown.offset_window_s;
        Self { map, given, constants, offset_window_s, start, values, aircraft }
    }
}

/// Fixed parameters, the aircraft field if its coefficients are states, and the prior standard deviations of the lag
/// and the height bias as in [`NoiseSearch`].
pub(super) type GivenNoise<'a> = (NoiseParameters, Option<&'a AircraftCoefficientStates<'a>>, [Option<f64>; 2]);

/// Estimated noise of a line.
#[derive(Clone)]
pub(super) struct LineNoiseEstimate {
    /// Covariance at the first sample; `None` for the initial standard deviations.
    start: Option<StateMatrix>,
    /// Noise; `None` if the line is too short.
    pub(super) noise: Option<LineNoise>,
    /// Rows whose measurements are used; `None` selects all samples.
    rows: Option<Vec<usize>>,
    /// Map error at each sample, in nT.
    map_nt: Option<Vec<f64>>,
}

impl LineNoiseEstimate {
    /// Estimate with the most likely of these covariances at the first sample.
    pub(super) fn most_likely(
        flown: &FilterInput,
        of_map: bool,
        map: &NavigationMap,
        starts: &[StateMatrix],
        given: GivenNoise,
    ) -> Result<Self, Fault> {
        let mut best = Self::new(flown, of_map, map, flown.errors.start, given)?;
        for start in starts.iter().skip(1) {
            let other = Self::new(flown, of_map, map, Some(*start), given)?;
            if let (Some(one), Some(two)) = (best.noise, other.noise)
                && two.log_likelihood > one.log_likelihood
                && two.used as f64 >= likelihood::LEAST_USED * one.used as f64
            {
                best = other;
            }
        }
        best.with_more_measurements(flown, given)
    }

    fn new(
        flown: &FilterInput,
        of_map: bool,
        map: &NavigationMap,
        start: Option<StateMatrix>,
        (given, aircraft, [latency_sigma_s, map_height_sigma_m]): GivenNoise,
    ) -> Result<Self, Fault> {
        let aircraft = aircraft.map(AircraftCoefficientStates::model);
        let errors = InsErrorModel { start, ..flown.errors };
        let line = NavigationLine { fixes: flown.fixes(), errors, ..flown.line()? };
        let rows = likelihood::rows_at(flown.ins.tt_s, INTERVAL_S);
        let (scale, known) = (flown.scale(), flown.known_nt());
        let known_nt = known.as_deref();
        let [_, _, _, permanent_nt, _] = given;
        let directions = if permanent_nt == Some(0.0) { None } else { flown.field_directions(&rows) };
        let direction = directions.as_deref();
        let (line, rows, scale) = (&line, &rows, &scale);
        let first = NoiseSearch {
            line,
            rows,
            scale,
            known_nt,
            map_nt: None,
            direction,
            aircraft,
            latency_sigma_s,
            map_height_sigma_m,
            given,
        };
        let mut noise = likelihood::search(&first).map_err(data)?;
        let mut map_nt = None;
        if let Some(found) = &noise
            && of_map
            && map.errors.rms_at_nodes_nt() > LEAST_MAP_ERROR * found.sigma_nt.value
        {
            let mut errors = line.errors;
            (errors.fogm_sigma_nt, errors.fogm_tau_s) = (found.fogm_sigma_nt.value, found.fogm_tau_s.value);
            let sigma_nt: Vec<f64> = scale.iter().map(|scale| scale * found.sigma_nt.value).collect();
            let mut line = NavigationLine { sigma_nt: &sigma_nt, errors, ..*line };
            let compensated_nt: Vec<f64>;
            if let Some(aircraft) = aircraft {
                let own_nt = aircraft.along(&line).map_err(data)?.aircraft_nt;
                compensated_nt = line.measurement_nt.iter().zip(own_nt).map(|(nt, own_nt)| nt - own_nt).collect();
                line.measurement_nt = &compensated_nt;
            }
            map_nt = map.errors.at_nodes_nt(&line)?;
            noise = likelihood::search(&NoiseSearch { map_nt: map_nt.as_deref(), ..first }).map_err(data)?;
        }
        let rows = (given[0].is_none() && noise.is_some()).then(|| rows.clone());
        Ok(Self { start, noise, rows, map_nt })
    }

    /// Estimate with measurements at a shorter interval, if the innovations at this interval are white. An estimate
    /// with coefficients of the aircraft field is returned unchanged.
    fn with_more_measurements(
        mut self,
        flown: &FilterInput,
        (given, aircraft, [latency_sigma_s, map_height_sigma_m]): GivenNoise,
    ) -> Result<Self, Fault> {
        let (Some(noise), Some(few), None) = (&self.noise, &self.rows, aircraft) else { return Ok(self) };
        let rows = likelihood::rows_at(flown.ins.tt_s, SHORT_INTERVAL_S);
        if rows.len() <= few.len() {
            return Ok(self);
        }
        let constants = [latency_sigma_s, map_height_sigma_m];
        let denser = |search: &NoiseSearch| likelihood::denser(search, noise, few.len());
        if let Some(more) = self.with_search(flown, &rows, (given, constants), denser)? {
            (self.noise, self.rows) = (Some(more), Some(rows));
        }
        Ok(self)
    }

    /// Whether a height bias increases the likelihood on a map that is continued above and below the line. `false` if
    /// the noise is unknown or the bias is already a state.
    pub(super) fn may_be_biased(&self, flown: &FilterInput, map: &NavigationMap) -> Result<bool, Fault> {
        let Some(noise) = self.noise.filter(|noise| noise.map_height_sigma_m.is_none()) else { return Ok(false) };
        let flown = FilterInput { map: Some(&map.field), ..flown.clone() };
        let usual = || likelihood::rows_at(flown.ins.tt_s, INTERVAL_S);
        let rows = self.rows.clone().unwrap_or_else(usual);
        let gain = |search: &NoiseSearch| likelihood::height_gain(search, &noise);
        Ok(self.with_search(&flown, &rows, Default::default(), gain)? > 0.0)
    }

    /// Calls `of` with the given rows of the line, and with the initial covariance and the map error of this estimate.
    fn with_search<T>(
        &self,
        flown: &FilterInput,
        rows: &[usize],
        (given, [latency_sigma_s, map_height_sigma_m]): (NoiseParameters, [Option<f64>; 2]),
        of: impl FnOnce(&NoiseSearch) -> Result<T, NavigationError>,
    ) -> Result<T, Fault> {
        let errors = InsErrorModel { start: self.start, ..flown.errors };
        let line = NavigationLine { fixes: flown.fixes(), errors, ..flown.line()? };
        let (scale, known) = (flown.scale(), flown.known_nt());
        let permanent = self.noise.and_then(|noise| noise.permanent);
        let directions = permanent.and_then(|_| flown.field_directions(rows));
        let search = NoiseSearch {
            line: &line,
            rows,
            scale: &scale,
            known_nt: known.as_deref(),
            map_nt: self.map_nt.as_deref(),
            direction: directions.as_deref(),
            aircraft: None,
            latency_sigma_s,
            map_height_sigma_m,
            given,
        };
        of(&search).map_err(data)
    }

    /// Whether the line is long enough to estimate its noise.
    pub(super) fn has_noise(&self) -> bool {
        self.noise.is_some()
    }

    /// Sets the noise, and removes the measurements that are not used.
    pub(super) fn apply(&self, flown: &mut FilterInput) {
        flown.errors.start = self.start;
        if let Some(noise) = &self.noise {
            flown.measurement_sigma_nt = noise.sigma_nt.value;
            flown.errors.fogm_sigma_nt = noise.fogm_sigma_nt.value;
            flown.errors.fogm_tau_s = noise.fogm_tau_s.value;
            let process = noise.permanent.map(|[sigma, tau_s]| GaussMarkov { sigma: sigma.value, tau_s: tau_s.value });
            flown.permanent = process.and_then(|process| flown.permanent_states(process));
            flown.latency_sigma_s = noise.latency_sigma_s;
            flown.map_height_sigma_m = noise.map_height_sigma_m;
            let factor = noise.map_factor.sqrt();
            let of_map = |nt: &Vec<f64>| nt.iter().map(|nt| if nt.is_finite() { factor * nt } else { 0.0 }).collect();
            flown.map_sigma_nt = self.map_nt.as_ref().filter(|_| factor > 0.0).map(of_map);
            flown.set_sigma();
        }
        if let Some(rows) = &self.rows {
            let mut used = vec![false; flown.ins.len()];
            rows.iter().for_each(|row| used[*row] = true);
            flown.leave_out(UpdateOutcome::Unused, &used.iter().map(|used| !used).collect::<Vec<_>>());
        }
    }
}
