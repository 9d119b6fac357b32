//! Filters in the lanes of a vector register.

use pulp::Simd;

use super::{EkfInput, EkfParameters};
use crate::earth::field_value::FieldValue;
use crate::earth::geodesy::EarthModel;
use crate::navigation::field::PredictedField;
use crate::navigation::gaussian::LaneStep;
use crate::navigation::gaussian::lanes::{
    MeasurementLanes, SensitivityLanes, StateMatrixLanes, StateVectorLanes, add_diagonals, add_to_all,
    correct_by_state, from_lanes, lane, propagate_covariances, propagate_states,
};
use crate::navigation::ins_series::InsSeries;
use crate::navigation::measurement::{Reading, usable};
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES};
use crate::navigation::position_fixes::{NO_FIX, StateFix};
use crate::navigation::transition::NoiseDiscretisation;
use crate::signal::gauss_markov::GaussMarkov;

/// Maximum number of lanes of a register.
const MOST_LANES: usize = 8;

/// Source of the measurements and aiding positions of a filter, by row.
pub(super) trait EkfSamples {
    /// Measured field and its standard deviation, in nT.
    fn reading(&self, row: usize) -> Reading;

    /// Whether there are any aiding positions.
    fn has_fixes(&self) -> bool;

    /// Aiding positions, as measurements of states.
    fn fixes(&self, ins: &InsSeries<'_>, row: usize, earth: EarthModel) -> [Option<StateFix>; 3];
}

impl EkfSamples for EkfInput<'_> {
    #[inline(always)]
    fn reading(&self, row: usize) -> Reading {
        let sigma_nt = self.sigma_nt.map_or(self.parameters.measurement_sigma_nt, |sigma_nt| sigma_nt[row]);
        (self.measurement_nt[row], sigma_nt)
    }

    #[inline(always)]
    fn has_fixes(&self) -> bool {
        self.fixes.is_some()
    }

    #[inline(always)]
    fn fixes(&self, ins: &InsSeries<'_>, row: usize, earth: EarthModel) -> [Option<StateFix>; 3] {
        self.fixes.map_or(NO_FIX, |fixes| fixes.at(ins, row, earth))
    }
}

/// Data of one filter, except state and covariance.
#[derive(Clone)]
pub(super) struct EkfLane<'a, C> {
    pub(super) samples: C,
    parameters: EkfParameters,
    pub(super) field: PredictedField<'a>,
    /// Temporal variation.
    fogm: GaussMarkov,
    offset_nt: f64,
    pub(super) output: NavigationOutput,
    pub(super) fault: Option<NavigationError>,
}

impl<'a> EkfLane<'a, EkfInput<'a>> {
    pub(super) fn new(point: EkfInput<'a>, ins: &InsSeries<'_>) -> Self {
        Self::of_line(point, point, ins)
    }
}

impl<'a, C: EkfSamples> EkfLane<'a, C> {
    /// Filter of a line with these samples. The offset is computed from the measurements of `point`.
    pub(super) fn of_line(samples: C, point: EkfInput<'a>, ins: &InsSeries<'_>) -> Self {
        let parameters = *point.parameters;
        let field = PredictedField::new(point.map, point.core);
        let mut filter = Self::with_field(samples, parameters, field, ins.len());
        let (offset_nt, averaged) = filter.field.offset(ins, point.measurement_nt, parameters.offset_window_s);
        filter.offset_nt = offset_nt;
        filter.output.report.offset_nt = offset_nt;
        filter.output.report.offset_samples = averaged;
        filter
    }

    /// Filter of a predicted field, with capacity for the output of `rows`.
    pub(super) fn with_field(samples: C, parameters: EkfParameters, field: PredictedField<'a>, rows: usize) -> Self {
        let errors = &parameters.errors;
        Self {
            field: field.with_second_order(parameters.second_order),
            fogm: GaussMarkov { sigma: errors.fogm_sigma_nt, tau_s: errors.fogm_tau_s },
            offset_nt: 0.0,
            output: NavigationOutput::with_capacity(rows, parameters.keep_states, parameters.keep_covariance),
            fault: None,
            samples,
            parameters,
        }
    }

    /// Output of the filter.
    pub(super) fn finish(self) -> Result<NavigationOutput, NavigationError> {
        self.fault.map_or(Ok(self.output), Err)
    }

    /// Measurement of a row and the field predicted there; `None` if measurement or field is missing, and the sample is
    /// then counted.
    fn expected(&mut self, ins: &InsSeries<'_>, row: usize, error: [f64; 3]) -> Option<(f64, FieldValue)> {
        let Some((measured_nt, _)) = usable(self.samples.reading(row), self.offset_nt) else {
            self.output.report.missing_measurements += 1;
            return None;
        };
        let field = self.field.at_error(ins, row, error);
        if field.is_none() {
            self.output.report.off_map += 1;
        }
        field.map(|field| (measured_nt, field))
    }

    /// Variance of the usable measurement of a row, in nT².
    #[inline(always)]
    fn variance_nt2(&self, row: usize) -> f64 {
        let (_, sigma_nt) = self.samples.reading(row);
        sigma_nt * sigma_nt
    }

    /// Whether a measurement with this innovation is used. Counts the measurement.
    fn uses(&mut self, innovation: Innovation) -> bool {
        let gated = self.parameters.gate_nis.is_some_and(|gate| innovation.nis > gate);
        let report = &mut self.output.report;
        *(if gated { &mut report.gated } else { &mut report.updates }) += 1;
        !gated
    }
}

/// Pack of at most one filter per lane of a register. A lane without a filter repeats the last filter, and its result
/// is ignored.
#[derive(Clone)]
pub(super) struct EkfPack<'a, S: Simd, C> {
    pub(super) filters: Vec<EkfLane<'a, C>>,
    noise: NoiseDiscretisation,
    /// Spectral densities of the process noise.
    density: StateVectorLanes<S>,
    pub(super) x: StateVectorLanes<S>,
    pub(super) p: StateMatrixLanes<S>,
}

impl<'a, S: Simd, C: EkfSamples> EkfPack<'a, S, C> {
    /// Pack before the first sample. The number of filters is between 1 and the number of lanes.
    pub(super) fn new(simd: S, filters: Vec<EkfLane<'a, C>>, noise: NoiseDiscretisation) -> Self {
        let zero = simd.splat_f64s(0.0);
        let mut density = [zero; STATES];
        let parameters = |lane: usize| &filters[lane.min(filters.len() - 1)].parameters;
        for (state, density) in density.iter_mut().enumerate() {
            *density = from_lanes(simd, |lane| parameters(lane).errors.noise_density()[state]);
        }
        Self { filters, noise, density, x: [zero; STATES], p: [[zero; STATES]; STATES] }
    }

    /// Multiplies the standard deviation of the noise that drives the temporal variation by a factor, from the next
    /// step on. The factor is relative to the parameters and replaces earlier factors.
    #[inline(always)]
    pub(super) fn scale_fogm(&mut self, simd: S, factor: f64) {
        for filter in &mut self.filters {
            filter.fogm.sigma = filter.parameters.errors.fogm_sigma_nt * factor;
        }
        self.density[S] = self.of_fogm(simd, |fogm| fogm.noise_density());
    }

    /// Filters at the end of the line.
    pub(super) fn into_filters(self) -> Vec<EkfLane<'a, C>> {
        self.filters
    }

    /// Processes the first sample, with zero errors and the initial covariances before it.
    #[inline(always)]
    pub(super) fn start(&mut self, simd: S, ins: &InsSeries<'_>) {
        let (lat_rad, alt_m) = (ins.lat_deg[0].to_radians(), ins.alt_m[0]);
        let last = self.filters.len() - 1;
        let mut covariances = [[[0.0; STATES]; STATES]; MOST_LANES];
        for (covariance, filter) in covariances.iter_mut().zip(&self.filters) {
            *covariance = filter.parameters.errors.initial_covariance(lat_rad, alt_m);
        }
        for (state, row) in self.p.iter_mut().enumerate() {
            for (column, entry) in row.iter_mut().enumerate() {
                *entry = from_lanes(simd, |lane| covariances[lane.min(last)][state][column]);
            }
        }
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

    /// Value of a function of each filter's temporal variation, by lane; equal consecutive processes are evaluated
    /// once.
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
            filter.output.push(ins, row, x, p, innovation, filter.parameters.errors.earth);
        }
    }

    /// Corrects states and covariances with the aiding positions.
    #[inline(always)]
    fn aid(&mut self, simd: S, ins: &InsSeries<'_>, row: usize) {
        if !self.filters.iter().any(|filter| filter.samples.has_fixes()) {
            return;
        }
        for (coordinate, state) in [LAT, LON, ALT].into_iter().enumerate() {
            let mut fixes: [Option<StateFix>; MOST_LANES] = [None; MOST_LANES];
            for (filter, fix) in self.filters.iter().zip(&mut fixes) {
                *fix = filter.samples.fixes(ins, row, filter.parameters.errors.earth)[coordinate];
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
        // A lane without a measurement is not corrected, but its variance is a divisor and must not be zero.
        let mut noise_nt2 = [1.0; MOST_LANES];
        for (at, (filter, field)) in self.filters.iter_mut().zip(&fields).enumerate() {
            let Some((_, field)) = field else { continue };
            noise_nt2[at] = filter.variance_nt2(row);
            if filter.parameters.second_order {
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
