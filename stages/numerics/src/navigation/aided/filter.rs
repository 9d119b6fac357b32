//! Recursion along a line. Its parts are shared with filters that use the scalar field differently.

use crate::earth::field_value::FieldValue;
use crate::navigation::aids::{AidStates, Aids, JacobianBlock, LinearisedAid, SampleInnovations, SampleUsage};
use crate::navigation::field::{PredictedField, remainder_nt2};
use crate::navigation::gaussian::covariance::add_scaled;
use crate::navigation::gaussian::linearise::{FieldRegression, ScalarProblem, ScalarSearch};
use crate::navigation::gaussian::{AugmentedSensitivity, Gaussian, StateLayout};
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES, StateVector, TILT_N, VD, VE, VN};

use super::{AidedOutput, AidedParameters, Linearisation};

/// Measurement that depends on the position through the field, and directly on some of the 18 states and one further
/// state.
#[derive(Clone, Copy)]
struct AidedFieldMeasurement {
    value_nt: f64,
    variance_nt2: f64,
    /// Entry of H for S.
    temporal: f64,
    /// Entries of H for the tilt.
    tilt: [f64; 3],
    /// Index of a further state, and the entry of H for this state.
    further: (usize, f64),
    /// Index of the lag state, and the entry of H for this state.
    latency: (usize, f64),
    /// Entries of H for the change of the permanent field and the height bias, or for the errors of the map's slope.
    lasting: JacobianBlock,
}

impl AidedFieldMeasurement {
    /// Part of the measurement that does not come from the field.
    fn own(&self, v: &[f64]) -> f64 {
        let tilt: f64 = self.tilt.iter().zip(&v[TILT_N..]).map(|(h, x)| h * x).sum();
        let lasting: f64 = self.lasting.iter().map(|(state, entry)| entry * v[state]).sum();
        self.temporal * v[S] + self.further.1 * v[self.further.0] + self.latency.1 * v[self.latency.0] + tilt + lasting
    }

    /// Row of H of the 18 states.
    fn row(&self, slope: [f64; 3]) -> StateVector {
        let mut row = [0.0; STATES];
        (row[LAT], row[LON], row[ALT], row[S]) = (slope[0], slope[1], slope[2], self.temporal);
        row[TILT_N..TILT_N + 3].copy_from_slice(&self.tilt);
        row
    }

    fn sensitivity<'a>(&'a self, row: &'a StateVector) -> AugmentedSensitivity<'a> {
        let (first, regressors) = (self.lasting.first, self.lasting.entries());
        AugmentedSensitivity {
            error: self.further,
            common: self.latency,
            first,
            regressors,
            ..AugmentedSensitivity::of_ins(row)
        }
    }
}

/// Sum of two displacements: latitude, longitude and height.
fn moved(from: [f64; 3], by: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| from[axis] + by[axis])
}

/// Outcome of one measurement.
#[derive(Clone, Copy)]
pub(crate) enum MeasurementOutcome {
    Missing,
    OffMap,
    Gated(Innovation),
    Flat(Innovation),
    Used(Innovation),
}

impl MeasurementOutcome {
    pub(crate) fn innovation(self) -> Innovation {
        match self {
            Self::Missing | Self::OffMap => Innovation::NONE,
            Self::Gated(innovation) | Self::Flat(innovation) | Self::Used(innovation) => innovation,
        }
    }

    /// Outcome of a sample, from the outcomes of all its measurements. The scalar field is the first of `all`.
    pub(crate) fn usage(all: &[Self]) -> SampleUsage {
        if all.iter().any(|one| matches!(one, Self::Used(_))) {
            SampleUsage::Used
        } else if matches!(all.first(), Some(Self::Flat(_))) {
            SampleUsage::Flat
        } else if all.iter().any(|one| matches!(one, Self::Gated(_))) {
            SampleUsage::Gated
        } else if all.iter().any(|one| matches!(one, Self::OffMap)) {
            SampleUsage::OffMap
        } else {
            SampleUsage::Missing
        }
    }
}

/// Linearisation of a field measurement.
struct FieldLinearisation {
    row: StateVector,
    /// Measurement minus prediction at the predicted state.
    residual_nt: f64,
    /// Variance of the nonlinearity, in nT².
    remainder_nt2: f64,
}

/// Kalman filter with further measurements, with its state along a line.
pub(crate) struct AidedFilter<'a> {
    pub(crate) line: &'a NavigationLine<'a>,
    pub(crate) aids: &'a Aids<'a>,
    parameters: AidedParameters,
    field: PredictedField<'a>,
    pub(crate) states: AidStates,
    layout: StateLayout,
    pub(crate) now: Gaussian,
    pub(crate) gain: Vec<f64>,
    pub(crate) spare: Vec<f64>,
    pub(crate) output: AidedOutput,
    /// Number of consecutive rejections of a measurement of the field.
    rejected: usize,
    /// Whether the INS of the line is treated as the truth, about which the filter computes the covariance. No
    /// measurement then changes the state. An innovation is measurement minus truth, and its NIS uses the variance of
    /// noise and slow errors.
    bound: bool,
}

impl<'a> AidedFilter<'a> {
    pub(crate) fn new(line: &'a NavigationLine<'a>, aids: &'a Aids<'a>, parameters: &AidedParameters) -> Self {
        let states = AidStates::new(aids, STATES);
        let mut layout = StateLayout::default();
        states.extend(&mut layout);
        let now = Gaussian::start_of(line, &layout);
        let mut field = line.predicted();
        let mut navigation =
            NavigationOutput::with_capacity(line.ins.len(), parameters.keep_states, parameters.keep_covariance);
        (navigation.report.offset_nt, navigation.report.offset_samples) =
            field.offset(line.ins, line.measurement_nt, line.offset_window_s);
        let output = AidedOutput { navigation, ..AidedOutput::default() };
        let (gain, parameters) = (vec![0.0; layout.dim()], *parameters);
        Self {
            line,
            aids,
            parameters,
            field,
            states,
            layout,
            gain,
            now,
            spare: vec![],
            output,
            rejected: 0,
            bound: false,
        }
    }

    /// Creates the filter for a Cramér-Rao bound, which treats the INS of the line as the truth.
    pub(crate) fn of_bound(line: &'a NavigationLine<'a>, aids: &'a Aids<'a>, parameters: &AidedParameters) -> Self {
        Self { bound: true, ..Self::new(line, aids, parameters) }
    }

    pub(crate) fn run(mut self) -> Result<AidedOutput, NavigationError> {
        for row in 0..self.line.ins.len() {
            self.advance(row);
            let scalar = self.scalar(row);
            self.finish(row, scalar)?;
        }
        Ok(self.output)
    }

    /// Advances to a row and uses its aiding positions.
    pub(crate) fn advance(&mut self, row: usize) {
        if row > 0 {
            self.now.propagate(&self.layout, &self.line.step(row), &mut self.spare);
        }
        for fix in self.line.fixes_at(row).into_iter().flatten() {
            let mut of_state = [0.0; STATES];
            of_state[fix.state] = 1.0;
            let h = AugmentedSensitivity::of_ins(&of_state);
            let residual = fix.error - h.dot(&self.now.x);
            let s = self.now.predict(&h, fix.variance, &mut self.gain);
            self.update(residual, s);
        }
    }

    /// Uses the further measurements of a row after its scalar field, and writes its output.
    pub(crate) fn finish(&mut self, row: usize, scalar: MeasurementOutcome) -> Result<(), NavigationError> {
        let mut sample = SampleInnovations::default();
        let difference = self.difference(row);
        sample.difference = difference.innovation();
        let vector = self.vector(row, &mut sample);
        if let Some(height) = self.aids.height_row(&self.states, self.line, row) {
            sample.note(height.of, self.take(&height).innovation());
        }
        let usage = MeasurementOutcome::usage(&[scalar, difference, vector]);
        self.output.navigation.report.count(usage);
        self.output.usage.push(usage);
        self.output.aids.push(self.aids, &sample);
        let of_scalar = scalar.innovation();
        let innovation = if of_scalar.nis.is_nan() { sample.difference } else { of_scalar };
        if !self.now.is_sound() {
            return Err(NavigationError::Diverged { row, tt_s: self.line.ins.tt_s[row] });
        }
        let x = &self.now.x;
        let covariance = |row: usize, column: usize| self.now.p.at(row, column);
        let constants = [
            (self.states.latency, &mut self.output.latency_s),
            (self.states.map_height, &mut self.output.map_height_m),
        ];
        for (state, [values, sigmas]) in constants {
            values.extend(state.map(|state| x[state]));
            sigmas.extend(state.map(|state| covariance(state, state).sqrt()));
        }
        self.output.navigation.push(self.line.ins, row, |k| x[k], covariance, innovation, self.line.errors.earth);
        Ok(())
    }

    fn update(&mut self, residual: f64, s: f64) {
        let moved = if self.bound { 0.0 } else { residual };
        self.now.update(moved, s, &mut self.gain, &mut self.spare);
    }

    /// Innovation with the variance `s`; for a Cramér-Rao bound, with the variance of the noise and slow errors
    /// instead.
    fn innovation(&self, residual_nt: f64, s: f64, by_truth: impl Fn() -> f64) -> Innovation {
        let variance = if self.bound { by_truth() } else { s };
        Innovation { residual_nt, nis: residual_nt * residual_nt / variance }
    }

    /// Corrects with a linear measurement.
    fn take(&mut self, linear: &LinearisedAid) -> MeasurementOutcome {
        let residual = linear.residual(&self.now.x);
        let s = self.now.predict(&linear.sensitivity(), linear.variance, &mut self.gain);
        let temporal_nt = self.line.errors.fogm_sigma_nt;
        let by_truth = || linear.variance + linear.lasting_variance(&self.states, temporal_nt);
        let innovation = self.innovation(residual, s, by_truth);
        if self.parameters.gate_nis.is_some_and(|gate| innovation.nis > gate) {
            return MeasurementOutcome::Gated(innovation);
        }
        self.update(residual, s);
        MeasurementOutcome::Used(innovation)
    }

    /// Field at the predicted position of a row. Outputs the horizontal slope of the field, in nT/m.
    pub(crate) fn look(&mut self, row: usize) -> Option<(FieldValue, f64)> {
        let at = moved(self.position(), self.displaced(row));
        let centre = self.field.at_error(self.line.ins, row, at);
        let slope = centre.map_or(f64::NAN, |at| self.line.slope_nt_per_m(row, &at));
        self.output.slope_nt_per_m.push(slope);
        self.output.nonlinear_sd_nt.push(f64::NAN);
        centre.map(|centre| (centre, slope))
    }

    fn position(&self) -> [f64; 3] {
        [LAT, LON, ALT].map(|state| self.now.x[state])
    }

    /// Displacement in one second at the estimated velocity of a row: latitude, longitude (rad) and height (m).
    fn per_second(&self, row: usize) -> [f64; 3] {
        let (ins, x) = (self.line.ins, &self.now.x);
        let (lat_rad, alt_m) = (ins.lat_deg[row].to_radians(), ins.alt_m[row]);
        let (north_m, east_m) = self.line.errors.earth.north_east_m_per_rad(lat_rad, alt_m);
        [(ins.vn_mps[row] + x[VN]) / north_m, (ins.ve_mps[row] + x[VE]) / east_m, -(ins.vd_mps[row] + x[VD])]
    }

    /// Displacement from the position of a row to the position on the map where its scalar field was measured.
    fn displaced(&self, row: usize) -> [f64; 3] {
        let delay_s = self.states.latency.map(|state| self.now.x[state]);
        let mut by = delay_s.map_or([0.0; 3], |delay_s| self.per_second(row).map(|way| -delay_s * way));
        by[2] += self.height_bias_m();
        by
    }

    /// Estimated height bias on the map, in metres.
    fn height_bias_m(&self) -> f64 {
        self.states.map_height.map_or(0.0, |state| self.now.x[state])
    }

    /// Index of the lag, its entry of H for a field of this slope, and the contribution of its present estimate.
    fn latency(&self, row: usize, at: &FieldValue) -> ((usize, f64), f64) {
        let Some(state) = self.states.latency else { return ((S, 0.0), 0.0) };
        let slope = [at.d_lat_nt_per_rad, at.d_lon_nt_per_rad, at.d_alt_nt_per_m];
        let entry = -self.per_second(row).iter().zip(slope).map(|(way, slope)| way * slope).sum::<f64>();
        ((state, entry), entry * self.now.x[state])
    }

    /// Uses the scalar field of a row.
    pub(crate) fn scalar(&mut self, row: usize) -> MeasurementOutcome {
        let centre = self.look(row);
        let Some((value_nt, variance_nt2)) = self.line.measured(row, self.output.navigation.report.offset_nt) else {
            return MeasurementOutcome::Missing;
        };
        let Some((centre, slope)) = centre else { return MeasurementOutcome::OffMap };
        // The field is evaluated at the position that corresponds to the estimated lag and height, so H x is the change
        // from that position.
        let (latency, mut part_nt) = self.latency(row, &centre);
        if self.states.map_height.is_some() {
            part_nt += centre.d_alt_nt_per_m * self.height_bias_m();
        }
        let (value_nt, further, displaced) = (value_nt + part_nt, self.states.of_map(), self.displaced(row));
        let of = AidedFieldMeasurement {
            value_nt,
            variance_nt2,
            temporal: 1.0,
            tilt: [0.0; 3],
            further,
            latency,
            lasting: self.states.of_scalar(self.aids, row, centre.d_alt_nt_per_m),
        };
        let (line, flat) = (self.line, self.aids.is_flat(variance_nt2, slope));
        self.correct(of, row, centre, flat, |field, error| field.at_error(line.ins, row, moved(error, displaced)))
    }

    fn difference(&mut self, row: usize) -> MeasurementOutcome {
        if self.parameters.linearisation == Linearisation::Once {
            return match self.aids.difference_row(&self.states, &mut self.field, self.line, row, &self.now.x) {
                None => MeasurementOutcome::Missing,
                Some(None) => MeasurementOutcome::OffMap,
                Some(Some(linear)) => self.take(&linear),
            };
        }
        let Some((of, bias)) = self.aids.difference.as_ref().zip(self.states.difference) else {
            return MeasurementOutcome::Missing;
        };
        let (line, value_nt, position) = (self.line, of.difference_nt[row], self.position());
        if !value_nt.is_finite() {
            return MeasurementOutcome::Missing;
        }
        let Some((centre, tilt)) = of.field(&mut self.field, line, row, position) else {
            return MeasurementOutcome::OffMap;
        };
        let variance_nt2 = of.sigma_nt * of.sigma_nt;
        let lasting = of.slope_block(&self.states, line, row);
        let (further, latency) = ((bias, 1.0), (S, 0.0));
        let measured = AidedFieldMeasurement { value_nt, variance_nt2, temporal: 0.0, tilt, further, latency, lasting };
        let look_up = |field: &mut PredictedField<'a>, error| of.field(field, line, row, error).map(|(at, _)| at);
        self.correct(measured, row, centre, false, look_up)
    }

    /// Corrects with a measurement of the field, whose value at the predicted position is `centre`.
    fn correct(
        &mut self,
        of: AidedFieldMeasurement,
        row: usize,
        centre: FieldValue,
        flat: bool,
        mut look_up: impl FnMut(&mut PredictedField<'a>, [f64; 3]) -> Option<FieldValue>,
    ) -> MeasurementOutcome {
        let first = self.linearised(&of, row, &centre, &mut look_up);
        let variance_nt2 = of.variance_nt2 + first.remainder_nt2;
        let s = self.now.predict(&of.sensitivity(&first.row), variance_nt2, &mut self.gain);
        let lasting = (of.temporal * self.line.errors.fogm_sigma_nt).powi(2);
        let by_truth = || {
            let of_state =
                |state, entry: f64| self.states.variance(state).map_or(0.0, |variance| entry.powi(2) * variance);
            let of_block: f64 = of.lasting.iter().map(|(state, entry)| of_state(state, entry)).sum();
            of.variance_nt2 + lasting + of_state(of.further.0, of.further.1) + of_block
        };
        let innovation = self.innovation(first.residual_nt, s, by_truth);
        if self.parameters.gate_nis.is_some_and(|gate| innovation.nis > gate) {
            self.rejected += 1;
            if self.parameters.recover_after.is_none_or(|most| self.rejected <= most) {
                return MeasurementOutcome::Gated(innovation);
            }
        }
        self.rejected = 0;
        if flat {
            let of_block = of.lasting.first..of.lasting.first + of.lasting.count;
            let height = self.states.map_height;
            let in_block = |state: usize| of_block.contains(&state) && Some(state) != height;
            let corrects = |state: usize| state == S || state == of.further.0 || in_block(state);
            self.now.consider(first.residual_nt, s, &mut self.gain, &mut self.spare, corrects);
            return MeasurementOutcome::Flat(innovation);
        }
        if let Linearisation::Iterated { iterations, tolerance_m } = self.parameters.linearisation {
            self.iterate(&of, row, centre, (iterations, tolerance_m), look_up);
        } else {
            self.update(first.residual_nt, s);
        }
        MeasurementOutcome::Used(innovation)
    }

    /// Linearises a measurement of the field at the predicted state.
    fn linearised(
        &mut self,
        of: &AidedFieldMeasurement,
        row: usize,
        centre: &FieldValue,
        look_up: &mut impl FnMut(&mut PredictedField<'a>, [f64; 3]) -> Option<FieldValue>,
    ) -> FieldLinearisation {
        let position = self.position();
        let mut found = FieldRegression::at(centre);
        if let Linearisation::Unscented(parameters) = &self.parameters.linearisation {
            let field = &mut self.field;
            let value_at = |away: [f64; 3]| {
                let there = std::array::from_fn(|axis| position[axis] + away[axis]);
                look_up(field, there).map(|field| field.value_nt)
            };
            let regression = parameters.sigma_points().regression(&self.now.p.ins(), centre.value_nt, value_at);
            if let Some(regression) = regression {
                found = regression;
                if of.temporal != 0.0
                    && let Some(last) = self.output.nonlinear_sd_nt.get_mut(row)
                {
                    *last = regression.remainder_nt2.sqrt();
                }
            }
        }
        if self.line.second_order && self.parameters.linearisation == Linearisation::Once {
            let covariance = [[LAT, LAT], [LAT, LON], [LON, LON]].map(|[row, column]| self.now.p.at(row, column));
            let [lat, lon, alt] = position;
            let field = &mut self.field;
            found.remainder_nt2 = remainder_nt2(covariance, centre.value_nt, |north, east| {
                look_up(field, [lat + north, lon + east, alt])
            });
        }
        let residual_nt = of.value_nt - (found.mean_nt + of.own(&self.now.x));
        FieldLinearisation { row: of.row(found.slope), residual_nt, remainder_nt2: found.remainder_nt2 }
    }

    /// Iterates to the most probable state, and corrects the covariance with the last linearisation.
    fn iterate(
        &mut self,
        of: &AidedFieldMeasurement,
        row: usize,
        centre: FieldValue,
        (iterations, tolerance_m): (usize, f64),
        mut look_up: impl FnMut(&mut PredictedField<'a>, [f64; 3]) -> Option<FieldValue>,
    ) {
        let ins = self.line.ins;
        let search = ScalarSearch {
            iterations,
            tolerance_m,
            m_per_rad: self.line.errors.earth.north_east_m_per_rad(ins.lat_deg[row].to_radians(), ins.alt_m[row]),
        };
        // Columns of P for the position, and for the sum of the states that the measurement contains directly.
        let mut columns: [Vec<f64>; 4] = [LAT, LON, ALT, S].map(|state| self.now.p.row(state).to_vec());
        columns[3].iter_mut().for_each(|entry| *entry *= of.temporal);
        for (state, entry) in [of.further, of.latency].into_iter().chain(of.lasting.iter()) {
            add_scaled(&mut columns[3], entry, self.now.p.row(state));
        }
        for (state, entry) in (TILT_N..).zip(of.tilt).filter(|(_, entry)| *entry != 0.0) {
            add_scaled(&mut columns[3], entry, self.now.p.row(state));
        }
        let reduced = |v: &[f64]| [v[LAT], v[LON], v[ALT], of.own(v)];
        let p = columns.each_ref().map(|column| reduced(column));
        let problem = ScalarProblem::new(reduced(&self.now.x), p, of.value_nt, of.variance_nt2);
        let field = &mut self.field;
        let optimum = problem.most_probable(&search, centre, |error| look_up(field, error));
        let [lat, lon, alt, _] = optimum.h.0;
        let last = of.row([lat, lon, alt]);
        let s = self.now.predict(&of.sensitivity(&last), of.variance_nt2, &mut self.gain);
        self.now.update(0.0, s, &mut self.gain, &mut self.spare);
        for (factor, column) in optimum.v.into_iter().zip(&columns) {
            add_scaled(&mut self.now.x, factor, column);
        }
    }

    fn vector(&mut self, row: usize, sample: &mut SampleInnovations) -> MeasurementOutcome {
        // All components are linearised at the state before the update with the first component.
        let components = match self.aids.vector_rows(&self.states, self.line, row, &self.now.x) {
            None => return MeasurementOutcome::Missing,
            Some(None) => return MeasurementOutcome::OffMap,
            Some(Some(components)) => components,
        };
        let mut used = false;
        for component in &components {
            let outcome = self.take(component);
            used |= matches!(outcome, MeasurementOutcome::Used(_));
            sample.note(component.of, outcome.innovation());
        }
        if used { MeasurementOutcome::Used(sample.vector()) } else { MeasurementOutcome::Gated(sample.vector()) }
    }
}
