//! Filters in the lanes of a vector register.

use pulp::Simd;

use super::EkfInput;
use crate::earth::field_value::FieldValue;
use crate::navigation::field::PredictedField;
use crate::navigation::gaussian::LaneStep;
use crate::navigation::gaussian::lanes::{
    MeasurementLanes, SensitivityLanes, StateMatrixLanes, StateVectorLanes, add_diagonals, add_to_all,
    correct_by_state, from_lanes, lane, propagate_covariances, propagate_states,
};
use crate::navigation::ins_series::InsSeries;
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES};
use crate::navigation::position_fixes::StateFix;
use crate::navigation::transition::NoiseDiscretisation;
use crate::signal::gauss_markov::GaussMarkov;

/// Maximum number of lanes of a register.
const MOST_LANES: usize = 8;

/// Data of one filter, except state and covariance.
pub(super) struct EkfLane<'a> {
    point: EkfInput<'a>,
    field: PredictedField<'a>,
    /// Temporal variation.
    fogm: GaussMarkov,
    offset_nt: f64,
    output: NavigationOutput,
    fault: Option<NavigationError>,
}

impl<'a> EkfLane<'a> {
    pub(super) fn new(point: EkfInput<'a>, ins: &InsSeries<'_>) -> Self {
        let (parameters, errors) = (point.parameters, &point.parameters.errors);
        let mut filter = Self {
            field: PredictedField::new(point.map, point.core).with_second_order(parameters.second_order),
            fogm: GaussMarkov { sigma: errors.fogm_sigma_nt, tau_s: errors.fogm_tau_s },
            offset_nt: 0.0,
            output: NavigationOutput::with_capacity(ins.len(), parameters.keep_states, parameters.keep_covariance),
            fault: None,
            point,
        };
        let (offset_nt, samples) = filter.field.offset(ins, point.measurement_nt, parameters.offset_window_s);
        filter.offset_nt = offset_nt;
        filter.output.report.offset_nt = offset_nt;
        filter.output.report.offset_samples = samples;
        filter
    }

    /// Output of the filter.
    pub(super) fn finish(self) -> Result<NavigationOutput, NavigationError> {
        self.fault.map_or(Ok(self.output), Err)
    }

    /// Measurement of a row and the field predicted there; `None` if measurement or field is missing; the sample is
    /// then counted.
    fn expected(&mut self, ins: &InsSeries<'_>, row: usize, error: [f64; 3]) -> Option<(f64, FieldValue)> {
        let measured_nt = self.point.measurement_nt[row] - self.offset_nt;
        let variance_nt2 = self.variance_nt2(row);
        if !(measured_nt.is_finite() && variance_nt2 > 0.0 && variance_nt2.is_finite()) {
            self.output.report.missing_measurements += 1;
            return None;
        }
        let field = self.field.at_error(ins, row, error);
        if field.is_none() {
            self.output.report.off_map += 1;
        }
        field.map(|field| (measured_nt, field))
    }

    /// Variance of the measurement of a row, in nT²; NaN if the standard deviation is not above 0.
    #[inline(always)]
    fn variance_nt2(&self, row: usize) -> f64 {
        let sigma_nt = self.point.sigma_nt.map_or(self.point.parameters.measurement_sigma_nt, |sigma_nt| sigma_nt[row]);
        if sigma_nt > 0.0 { sigma_nt * sigma_nt } else { f64::NAN }
    }

    /// Whether a measurement with this innovation is used. Counts the measurement.
    fn uses(&mut self, innovation: Innovation) -> bool {
        let gated = self.point.parameters.gate_nis.is_some_and(|gate| innovation.nis > gate);
        let report = &mut self.output.report;
        *(if gated { &mut report.gated } else { &mut report.updates }) += 1;
        !gated
    }
}

/// Pack of at most one filter per lane of a register. A lane without a filter repeats the last filter, and its result
/// is ignored.
pub(super) struct EkfPack<'a, S: Simd> {
    filters: Vec<EkfLane<'a>>,
    noise: NoiseDiscretisation,
    /// Spectral densities of the process noise.
    density: StateVectorLanes<S>,
    x: StateVectorLanes<S>,
    p: StateMatrixLanes<S>,
}

impl<'a, S: Simd> EkfPack<'a, S> {
    /// Zero errors and the initial covariances at the first sample. The number of filters is between 1 and the number
    /// of lanes.
    pub(super) fn new(simd: S, filters: Vec<EkfLane<'a>>, noise: NoiseDiscretisation, ins: &InsSeries<'_>) -> Self {
        let (lat_rad, alt_m) = (ins.lat_deg[0].to_radians(), ins.alt_m[0]);
        let zero = simd.splat_f64s(0.0);
        let (mut density, mut p) = ([zero; STATES], [[zero; STATES]; STATES]);
        let parameters = |lane: usize| filters[lane.min(filters.len() - 1)].point.parameters;
        let covariances: Vec<_> =
            filters.iter().map(|filter| filter.point.parameters.errors.initial_covariance(lat_rad, alt_m)).collect();
        for state in 0..STATES {
            density[state] = from_lanes(simd, |lane| parameters(lane).errors.noise_density()[state]);
            for column in 0..STATES {
                p[state][column] = from_lanes(simd, |lane| covariances[lane.min(filters.len() - 1)][state][column]);
            }
        }
        Self { filters, noise, density, x: [zero; STATES], p }
    }

    /// Filters at the end of the line.
    pub(super) fn into_filters(self) -> Vec<EkfLane<'a>> {
        self.filters
    }

    /// Processes the first sample.
    #[inline(always)]
    pub(super) fn start(&mut self, simd: S, ins: &InsSeries<'_>) {
        self.measure(simd, ins, 0);
    }

    /// Processes the samples from `first` on, each after a time update.
    #[inline(always)]
    pub(super) fn advance(&mut self, simd: S, ins: &InsSeries<'_>, first: usize, steps: &[LaneStep]) {
        if self.filters.iter().all(|filter| filter.fault.is_some()) {
            return;
        }
        for (step, row) in steps.iter().zip(first..) {
            self.propagate(simd, step);
            self.measure(simd, ins, row);
        }
    }

    /// Value of every filter; consecutive equal values are computed once.
    #[inline(always)]
    fn of_fogm(&self, simd: S, of: impl Fn(GaussMarkov) -> f64) -> S::f64s {
        let mut last = self.filters[0].fogm;
        let mut value = of(last);
        from_lanes(simd, |lane| {
            if let Some(filter) = self.filters.get(lane)
                && filter.fogm != last
            {
                last = filter.fogm;
                value = of(last);
            }
            value
        })
    }

    #[inline(always)]
    fn propagate(&mut self, simd: S, step: &LaneStep) {
        let dt_s = step.dt_s;
        let decay = self.of_fogm(simd, |fogm| fogm.decay(dt_s));
        propagate_states(simd, &step.phi, decay, &mut self.x);
        // Parts of the noise before and after the step.
        let (before_s, after_s) = match self.noise {
            NoiseDiscretisation::Rectangular => (0.0, dt_s),
            NoiseDiscretisation::Trapezoidal => (0.5 * dt_s, 0.5 * dt_s),
            NoiseDiscretisation::VanLoan => (0.0, 0.0),
        };
        if before_s > 0.0 {
            add_diagonals(simd, &mut self.p, before_s, &self.density);
        }
        propagate_covariances(simd, &step.phi, decay, &mut self.p);
        if after_s > 0.0 {
            add_diagonals(simd, &mut self.p, after_s, &self.density);
        }
        if let Some(noise) = &step.noise {
            add_to_all(simd, &mut self.p, noise);
            let fogm = self.of_fogm(simd, |fogm| fogm.step_variance(dt_s));
            self.p[S][S] = simd.add_f64s(self.p[S][S], fogm);
        }
    }

    /// Corrects states and covariances with the usable measurements of `row`, and outputs them.
    #[inline(always)]
    fn measure(&mut self, simd: S, ins: &InsSeries<'_>, row: usize) {
        self.aid(simd, ins, row);
        let innovations = self.update(simd, ins, row);
        // A finite value times zero is zero. A NaN is not equal to anything.
        let zero = simd.splat_f64s(0.0);
        let (mut finite, mut least) = (zero, zero);
        for state in 0..STATES {
            let variance = self.p[state][state];
            let both = simd.add_f64s(simd.mul_f64s(self.x[state], zero), simd.mul_f64s(variance, zero));
            finite = simd.add_f64s(finite, both);
            least = simd.min_f64s(least, variance);
        }
        for (at, (filter, innovation)) in self.filters.iter_mut().zip(innovations).enumerate() {
            if filter.fault.is_some() {
                continue;
            }
            if lane::<S>(&finite, at) != 0.0 || lane::<S>(&least, at) < 0.0 {
                filter.fault = Some(NavigationError::Diverged { row, tt_s: ins.tt_s[row] });
                filter.output = NavigationOutput::default();
                continue;
            }
            let x = |state: usize| lane::<S>(&self.x[state], at);
            let p = |row: usize, column: usize| lane::<S>(&self.p[row][column], at);
            filter.output.push(ins, row, x, p, innovation, filter.point.parameters.errors.earth);
        }
    }

    /// Corrects states and covariances with the aiding positions.
    #[inline(always)]
    fn aid(&mut self, simd: S, ins: &InsSeries<'_>, row: usize) {
        if self.filters.iter().all(|filter| filter.point.fixes.is_none()) {
            return;
        }
        for (coordinate, state) in [LAT, LON, ALT].into_iter().enumerate() {
            let mut fixes: [Option<StateFix>; MOST_LANES] = [None; MOST_LANES];
            for (filter, fix) in self.filters.iter().zip(&mut fixes) {
                let earth = filter.point.parameters.errors.earth;
                *fix = filter.point.fixes.and_then(|fixes| fixes.at(ins, row, earth)[coordinate]);
            }
            if fixes.iter().all(Option::is_none) {
                continue;
            }
            let of = |none: f64, part: fn(&StateFix) -> f64| {
                from_lanes(simd, |at| fixes.get(at).and_then(Option::as_ref).map_or(none, part))
            };
            let (there, variance) = (of(0.0, |_| 1.0), of(1.0, |fix| fix.variance));
            let correction = MeasurementLanes {
                residual: simd.sub_f64s(of(0.0, |fix| fix.error), self.x[state]),
                weight: simd.div_f64s(simd.splat_f64s(1.0), simd.add_f64s(self.p[state][state], variance)),
                variance,
                used: simd.less_than_f64s(simd.splat_f64s(0.0), there),
            };
            correct_by_state(simd, state, &correction, &mut self.x, &mut self.p);
        }
    }

    #[inline(always)]
    fn update(&mut self, simd: S, ins: &InsSeries<'_>, row: usize) -> [Innovation; MOST_LANES] {
        let mut innovations = [Innovation::NONE; MOST_LANES];
        let mut fields = [None; MOST_LANES];
        for (at, (filter, field)) in self.filters.iter_mut().zip(&mut fields).enumerate() {
            if filter.fault.is_none() {
                let error = [LAT, LON, ALT].map(|state| lane::<S>(&self.x[state], at));
                *field = filter.expected(ins, row, error);
            }
        }
        if fields.iter().all(Option::is_none) {
            return innovations;
        }
        let slope = |at: usize, of: fn(&FieldValue) -> f64| fields[at].as_ref().map_or(0.0, |(_, field)| of(field));
        let h = SensitivityLanes {
            d_lat: from_lanes(simd, |at| slope(at, |field| field.d_lat_nt_per_rad)),
            d_lon: from_lanes(simd, |at| slope(at, |field| field.d_lon_nt_per_rad)),
            d_alt: from_lanes(simd, |at| slope(at, |field| field.d_alt_nt_per_m)),
        };
        let ph = h.covariances(simd, &self.p);
        // A lane without a measurement is not corrected; only the variance of the lane must not be zero.
        let mut noise_nt2 = [1.0; MOST_LANES];
        for (at, (filter, field)) in self.filters.iter_mut().zip(&fields).enumerate() {
            let Some((_, field)) = field else { continue };
            noise_nt2[at] = filter.variance_nt2(row);
            if filter.point.parameters.second_order {
                let error = [LAT, LON, ALT].map(|state| lane::<S>(&self.x[state], at));
                let of = |[row, column]: [usize; 2]| lane::<S>(&self.p[row][column], at);
                let covariance = [[LAT, LAT], [LAT, LON], [LON, LON]].map(of);
                noise_nt2[at] += filter.field.curvature_nt2(ins, row, error, field.value_nt, covariance);
            }
        }
        let variance = from_lanes(simd, |at| noise_nt2.get(at).copied().unwrap_or(1.0));
        let variances = h.innovation_variances(simd, &ph, variance);
        let mut used = [0.0; MOST_LANES];
        for (at, (filter, field)) in self.filters.iter_mut().zip(&fields).enumerate() {
            if let Some((measured_nt, field)) = field {
                let residual_nt = measured_nt - (field.value_nt + lane::<S>(&self.x[S], at));
                let nis = residual_nt * residual_nt / lane::<S>(&variances, at);
                innovations[at] = Innovation { residual_nt, nis };
                used[at] = if filter.uses(innovations[at]) { 1.0 } else { 0.0 };
            }
        }
        let correction = MeasurementLanes {
            residual: from_lanes(simd, |at| innovations[at].residual_nt),
            weight: simd.div_f64s(simd.splat_f64s(1.0), variances),
            variance,
            used: simd.less_than_f64s(simd.splat_f64s(0.0), from_lanes(simd, |at| used[at])),
        };
        h.correct(simd, &correction, &ph, &mut self.x, &mut self.p);
        innovations
    }
}
