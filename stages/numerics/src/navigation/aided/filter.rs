//! The recursion along a line.

use crate::earth::field_value::FieldValue;
use crate::navigation::field::PredictedField;
use crate::navigation::gaussian::{Gaussian, Sensitivity, Step, add_scaled};
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES, StateVector};
use crate::navigation::scalar_problem::{ScalarProblem, Search};
use crate::navigation::ukf::points::{Regression, Spread};

use super::measurements::Further;
use super::{AidedOutput, AidedParameters, Aids, Innovations, Linearisation, Usage};

/// A measurement that depends on the position by the field, and on one of the 18 states and one of the further ones by
/// itself.
#[derive(Clone, Copy)]
struct OfField {
    value_nt: f64,
    variance_nt2: f64,
    /// The entry of H for S.
    temporal: f64,
    /// A further state and its entry.
    further: (usize, f64),
}

/// What became of one measurement.
#[derive(Clone, Copy)]
enum Outcome {
    Missing,
    OffMap,
    Gated(Innovation),
    Flat(Innovation),
    Used(Innovation),
}

impl Outcome {
    fn innovation(self) -> Innovation {
        match self {
            Self::Missing | Self::OffMap => Innovation::NONE,
            Self::Gated(innovation) | Self::Flat(innovation) | Self::Used(innovation) => innovation,
        }
    }
}

/// A measurement of the field linearised.
struct Linear {
    row: StateVector,
    /// Measurement minus prediction at the predicted state.
    residual_nt: f64,
    /// What is not linear, in nT².
    remainder_nt2: f64,
}

/// The filter on its way along a line.
pub(super) struct Filter<'a> {
    line: &'a NavigationLine<'a>,
    aids: &'a Aids<'a>,
    parameters: &'a AidedParameters,
    field: PredictedField<'a>,
    further: Further,
    now: Gaussian,
    gain: Vec<f64>,
    spare: Vec<f64>,
    output: AidedOutput,
}

impl<'a> Filter<'a> {
    pub(super) fn new(line: &'a NavigationLine<'a>, aids: &'a Aids<'a>, parameters: &'a AidedParameters) -> Self {
        let further = Further::of(aids);
        let dim = further.layout.dim();
        let mut now = Gaussian { x: vec![0.0; dim], p: vec![0.0; dim * dim] };
        let first = line.errors.initial_covariance(line.ins.lat_deg[0].to_radians(), line.ins.alt_m[0]);
        for (row, entries) in first.iter().enumerate() {
            now.p[row * dim..row * dim + STATES].copy_from_slice(entries);
        }
        for (k, error) in further.layout.errors.iter().enumerate() {
            now.p[(STATES + k) * (dim + 1)] = error.sigma * error.sigma;
        }
        let mut field = line.predicted();
        let mut navigation =
            NavigationOutput::with_capacity(line.ins.len(), parameters.keep_states, parameters.keep_covariance);
        (navigation.report.offset_nt, navigation.report.offset_samples) =
            field.offset(line.ins, line.measurement_nt, line.offset_window_s);
        let output = AidedOutput { navigation, ..AidedOutput::default() };
        Self { line, aids, parameters, field, further, gain: vec![0.0; dim], now, spare: vec![], output }
    }

    pub(super) fn run(mut self) -> Result<AidedOutput, NavigationError> {
        let line = self.line;
        for row in 0..line.ins.len() {
            if row > 0 {
                self.propagate(row);
            }
            for fix in line.fixes_at(row).into_iter().flatten() {
                let mut of_state = [0.0; STATES];
                of_state[fix.state] = 1.0;
                let h = Sensitivity::of_ins(&of_state);
                let residual = fix.error - h.of(&self.now.x);
                let s = self.now.predict(&h, fix.variance, &mut self.gain);
                self.now.update(residual, s, &mut self.gain, &mut self.spare);
            }
            let innovation = self.measure(row);
            if !self.now.is_sound() {
                return Err(NavigationError::Diverged { row, tt_s: line.ins.tt_s[row] });
            }
            let (x, p, dim) = (&self.now.x, &self.now.p, self.now.dim());
            let covariance = |row: usize, column: usize| p[row * dim + column];
            self.output.navigation.push(line.ins, row, |k| x[k], covariance, innovation, line.errors.earth);
        }
        Ok(self.output)
    }

    fn propagate(&mut self, row: usize) {
        let (step, ins) = (self.line.step(row), self.line.ins);
        self.further.at_speed(ins.vn_mps[row - 1].hypot(ins.ve_mps[row - 1]));
        let step = Step { dt_s: step.dt_s, phi: step.phi, noise: step.noise };
        self.now.propagate(&self.further.layout, &step, &mut self.spare);
    }

    /// The measurements of a row; what is handed out as its innovation.
    fn measure(&mut self, row: usize) -> Innovation {
        let scalar = self.scalar(row);
        let difference = self.difference(row);
        let vector = self.vector(row);
        self.height(row);
        let all = [scalar, difference, vector];
        let usage = if all.iter().any(|one| matches!(one, Outcome::Used(_))) {
            Usage::Used
        } else if matches!(scalar, Outcome::Flat(_)) {
            Usage::Flat
        } else if all.iter().any(|one| matches!(one, Outcome::Gated(_))) {
            Usage::Gated
        } else if all.iter().any(|one| matches!(one, Outcome::OffMap)) {
            Usage::OffMap
        } else {
            Usage::Missing
        };
        let report = &mut self.output.navigation.report;
        *match usage {
            Usage::Used | Usage::Flat => &mut report.updates,
            Usage::Missing => &mut report.missing_measurements,
            Usage::OffMap => &mut report.off_map,
            Usage::Gated => &mut report.gated,
        } += 1;
        self.output.usage.push(usage);
        let of_scalar = scalar.innovation();
        if of_scalar.nis.is_nan() { difference.innovation() } else { of_scalar }
    }

    fn position(&self) -> [f64; 3] {
        [LAT, LON, ALT].map(|state| self.now.x[state])
    }

    fn scalar(&mut self, row: usize) -> Outcome {
        let centre = self.field.at_error(self.line.ins, row, self.position());
        let (lat_rad, alt_m) = (self.line.ins.lat_deg[row].to_radians(), self.line.ins.alt_m[row]);
        let (north, east) = self.line.errors.earth.north_east_m_per_rad(lat_rad, alt_m);
        let slope = centre.map_or(f64::NAN, |at| (at.d_lat_nt_per_rad / north).hypot(at.d_lon_nt_per_rad / east));
        self.output.slope_nt_per_m.push(slope);
        self.output.nonlinear_sd_nt.push(f64::NAN);
        let Some((value_nt, variance_nt2)) = self.line.measured(row, self.output.navigation.report.offset_nt) else {
            return Outcome::Missing;
        };
        let Some(centre) = centre else { return Outcome::OffMap };
        let further = self.further.map_error.map_or((S, 0.0), |state| (state, 1.0));
        let of = OfField { value_nt, variance_nt2, temporal: 1.0, further };
        let flat = self.aids.flat_over_m.is_some_and(|flat_m| variance_nt2.sqrt() > slope * flat_m);
        let line = self.line;
        self.correct(of, row, centre, flat, |field, error| field.at_error(line.ins, row, error))
    }

    fn difference(&mut self, row: usize) -> Outcome {
        let (Some(of), Some(bias)) = (&self.aids.difference, self.further.difference) else { return Outcome::Missing };
        let (line, position) = (self.line, self.position());
        let outcome = match of.difference_nt[row] {
            value_nt if !value_nt.is_finite() => Outcome::Missing,
            value_nt => match of.field(&mut self.field, line, row, position) {
                None => Outcome::OffMap,
                Some(centre) => {
                    let variance_nt2 = of.sigma_nt * of.sigma_nt;
                    let measured = OfField { value_nt, variance_nt2, temporal: 0.0, further: (bias, 1.0) };
                    self.correct(measured, row, centre, false, |field, error| of.field(field, line, row, error))
                }
            },
        };
        self.output.difference.push(outcome.innovation());
        outcome
    }

    /// Corrects by a measurement of the field, whose value at the predicted position is `centre`.
    fn correct(
        &mut self,
        of: OfField,
        row: usize,
        centre: FieldValue,
        flat: bool,
        mut look_up: impl FnMut(&mut PredictedField<'a>, [f64; 3]) -> Option<FieldValue>,
    ) -> Outcome {
        let first = self.linearised(&of, row, &centre, &mut look_up);
        let variance_nt2 = of.variance_nt2 + first.remainder_nt2;
        let h = sensitivity_of(&first.row, &of);
        let s = self.now.predict(&h, variance_nt2, &mut self.gain);
        let innovation = Innovation { residual_nt: first.residual_nt, nis: first.residual_nt.powi(2) / s };
        if self.parameters.gate_nis.is_some_and(|gate| innovation.nis > gate) {
            return Outcome::Gated(innovation);
        }
        if flat {
            let corrects = |state: usize| state == S || state == of.further.0;
            self.now.consider(first.residual_nt, s, &mut self.gain, &mut self.spare, corrects);
            return Outcome::Flat(innovation);
        }
        if let Linearisation::Iterated { iterations, tolerance_m } = self.parameters.linearisation {
            self.iterate(&of, row, centre, (iterations, tolerance_m), look_up);
        } else {
            self.now.update(first.residual_nt, s, &mut self.gain, &mut self.spare);
        }
        Outcome::Used(innovation)
    }

    /// A measurement of the field at the predicted state.
    fn linearised(
        &mut self,
        of: &OfField,
        row: usize,
        centre: &FieldValue,
        look_up: &mut impl FnMut(&mut PredictedField<'a>, [f64; 3]) -> Option<FieldValue>,
    ) -> Linear {
        let (x, position) = (&self.now.x, self.position());
        let mut found = Regression::at(centre);
        if let Linearisation::Unscented(parameters) = &self.parameters.linearisation {
            let field = &mut self.field;
            let value_at = |away: [f64; 3]| {
                let there = std::array::from_fn(|axis| position[axis] + away[axis]);
                look_up(field, there).map(|field| field.value_nt)
            };
            let regression = Spread::of(parameters).regression(&self.now.ins_covariance(), centre.value_nt, value_at);
            if let Some(regression) = regression {
                found = regression;
                if of.temporal != 0.0
                    && let Some(last) = self.output.nonlinear_sd_nt.get_mut(row)
                {
                    *last = regression.remainder_nt2.sqrt();
                }
            }
        }
        let own_nt = of.temporal * x[S] + of.further.1 * x[of.further.0];
        let residual_nt = of.value_nt - (found.mean_nt + own_nt);
        Linear { row: row_of(found.slope, of.temporal), residual_nt, remainder_nt2: found.remainder_nt2 }
    }

    /// Moves to the most probable state, and corrects the covariance with the last linearisation.
    fn iterate(
        &mut self,
        of: &OfField,
        row: usize,
        centre: FieldValue,
        (iterations, tolerance_m): (usize, f64),
        mut look_up: impl FnMut(&mut PredictedField<'a>, [f64; 3]) -> Option<FieldValue>,
    ) {
        let (ins, dim) = (self.line.ins, self.now.dim());
        let search = Search {
            iterations,
            tolerance_m,
            m_per_rad: self.line.errors.earth.north_east_m_per_rad(ins.lat_deg[row].to_radians(), ins.alt_m[row]),
        };
        // Position, and the sum of the states that the measurement holds by themselves.
        let mut columns: [Vec<f64>; 4] = [LAT, LON, ALT, S].map(|state| self.now.p[state * dim..][..dim].to_vec());
        columns[3].iter_mut().for_each(|entry| *entry *= of.temporal);
        add_scaled(&mut columns[3], of.further.1, &self.now.p[of.further.0 * dim..][..dim]);
        let sum = |v: &[f64]| of.temporal * v[S] + of.further.1 * v[of.further.0];
        let reduced = |v: &[f64]| [v[LAT], v[LON], v[ALT], sum(v)];
        let p = columns.each_ref().map(|column| reduced(column));
        let problem = ScalarProblem::new(reduced(&self.now.x), p, of.value_nt, of.variance_nt2);
        let field = &mut self.field;
        let optimum = problem.most_probable(&search, centre, |error| look_up(field, error));
        let [lat, lon, alt, _] = optimum.h.0;
        let last = row_of([lat, lon, alt], of.temporal);
        let s = self.now.predict(&sensitivity_of(&last, of), of.variance_nt2, &mut self.gain);
        self.now.update(0.0, s, &mut self.gain, &mut self.spare);
        for (factor, column) in optimum.v.into_iter().zip(&columns) {
            add_scaled(&mut self.now.x, factor, column);
        }
    }

    fn vector(&mut self, row: usize) -> Outcome {
        let (Some(of), Some((bias, crustal))) = (&self.aids.vector, self.further.vector) else {
            return Outcome::Missing;
        };
        let measured_nt = of.field_nt.map(|column| column[row]);
        if measured_nt.iter().any(|value| !value.is_finite()) {
            self.output.vector.push(Innovation::NONE);
            return Outcome::Missing;
        }
        let before = self.now.x.clone();
        let Some(predicted) = of.predicted(self.line, row, &before) else {
            self.output.vector.push(Innovation::NONE);
            return Outcome::OffMap;
        };
        let (mut squares, mut sum, mut used) = (0.0, 0.0, false);
        for (axis, measured_nt) in measured_nt.into_iter().enumerate() {
            let h = Sensitivity {
                ins: &predicted.rows[axis],
                error: (bias + axis, 1.0),
                first: crustal,
                regressors: &predicted.crustal[axis],
            };
            // The further states enter linearly; the others in the linearisation at the state before.
            let moved: f64 = (0..STATES).map(|k| predicted.rows[axis][k] * (self.now.x[k] - before[k])).sum();
            let own: f64 = (0..3).map(|part| predicted.crustal[axis][part] * self.now.x[crustal + part]).sum();
            let expected_nt = predicted.body_nt[axis] + moved + own + self.now.x[bias + axis];
            let residual = measured_nt - expected_nt;
            let s = self.now.predict(&h, of.sigma_nt * of.sigma_nt, &mut self.gain);
            let nis = residual * residual / s;
            (squares, sum) = (squares + residual * residual, sum + nis);
            if self.parameters.gate_nis.is_none_or(|gate| nis <= gate) {
                self.now.update(residual, s, &mut self.gain, &mut self.spare);
                used = true;
            }
        }
        let innovation = Innovation { residual_nt: squares.sqrt(), nis: sum / 3.0 };
        self.output.vector.push(innovation);
        if used { Outcome::Used(innovation) } else { Outcome::Gated(innovation) }
    }

    fn height(&mut self, row: usize) {
        let (Some(of), Some(bias)) = (&self.aids.height, self.further.height) else { return };
        let mut innovation = Innovation::NONE;
        let error = of.alt_m[row] - self.line.ins.alt_m[row];
        if error.is_finite() {
            let mut of_height = [0.0; STATES];
            of_height[ALT] = 1.0;
            let h = Sensitivity { error: (bias, 1.0), ..Sensitivity::of_ins(&of_height) };
            let residual = error - h.of(&self.now.x);
            let s = self.now.predict(&h, of.sigma_m * of.sigma_m, &mut self.gain);
            innovation = Innovation { residual_nt: residual, nis: residual * residual / s };
            if self.parameters.gate_nis.is_none_or(|gate| innovation.nis <= gate) {
                self.now.update(residual, s, &mut self.gain, &mut self.spare);
            }
        }
        self.output.height.push(innovation);
    }
}

impl Innovations {
    fn push(&mut self, innovation: Innovation) {
        self.residual.push(innovation.residual_nt);
        self.nis.push(innovation.nis);
    }
}

/// The row of H of the 18 states.
fn row_of(slope: [f64; 3], temporal: f64) -> StateVector {
    let mut row = [0.0; STATES];
    (row[LAT], row[LON], row[ALT], row[S]) = (slope[0], slope[1], slope[2], temporal);
    row
}

fn sensitivity_of<'a>(row: &'a StateVector, of: &OfField) -> Sensitivity<'a> {
    Sensitivity { error: of.further, ..Sensitivity::of_ins(row) }
}
