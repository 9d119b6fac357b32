//! Predictions of the further measurements of a sample from a state, and their derivatives.

use nalgebra::{Matrix3, Vector3};

use crate::earth::attitude::{body_to_ned, skew};
use crate::earth::core_field::CoreField;
use crate::earth::field_value::FieldValue;
use crate::earth::geodesy::EarthModel;
use crate::navigation::field::PredictedField;
use crate::navigation::gaussian::AugmentedSensitivity;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::line::NavigationLine;
use crate::navigation::output::Innovation;
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES, StateMatrix, StateVector, TILT_N};

use super::{AidInnovations, AidStates, Aids, DifferenceAid, VectorAid};

/// Step, in metres, of the finite differences of the core field, over which the field is nearly linear.
const CORE_STEP_M: f64 = 1000.0;

/// A further measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Aid {
    Difference,
    /// A component of the vector, along nose, right or down.
    Vector(usize),
    Height,
}

/// Maximum number of further scalar measurements per sample.
const MOST: usize = 5;

impl Aid {
    /// All measurements in order of use.
    pub(crate) const ALL: [Self; MOST] =
        [Self::Difference, Self::Vector(0), Self::Vector(1), Self::Vector(2), Self::Height];

    /// Index in [`Self::ALL`].
    pub(crate) fn place(self) -> usize {
        match self {
            Self::Difference => 0,
            Self::Vector(axis) => 1 + axis,
            Self::Height => 4,
        }
    }
}

/// A measurement linearised about a state: value = H x + white noise.
#[derive(Clone, Debug)]
pub(crate) struct LinearisedAid {
    pub(crate) of: Aid,
    /// Measurement minus the prediction without H x, in the unit of the measurement.
    value: f64,
    /// Variance of the white noise of the measurement.
    pub(crate) variance: f64,
    ins: StateVector,
    /// Index of the bias state, and its entry of H.
    own: (usize, f64),
    /// Further slow errors: the three parts of the crustal field, or the two errors of the map's slope.
    lasting: JacobianBlock,
}

/// Entries of the measurement row H for consecutive states.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct JacobianBlock {
    pub(crate) first: usize,
    pub(crate) count: usize,
    pub(crate) entries: [f64; 5],
}

impl JacobianBlock {
    pub(crate) fn entries(&self) -> &[f64] {
        &self.entries[..self.count]
    }

    /// States with their entries.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (usize, f64)> {
        (self.first..).zip(self.entries).take(self.count)
    }
}

impl LinearisedAid {
    /// Row of H.
    pub(crate) fn sensitivity(&self) -> AugmentedSensitivity<'_> {
        let (first, regressors) = (self.lasting.first, self.lasting.entries());
        AugmentedSensitivity { error: self.own, first, regressors, ..AugmentedSensitivity::of_ins(&self.ins) }
    }

    /// Measurement minus prediction at a state, for this linearisation.
    pub(crate) fn residual(&self, x: &[f64]) -> f64 {
        self.value - self.sensitivity().dot(x)
    }

    /// Prior variance that slow errors add to the measurement: its further states, and a temporal variation with this
    /// standard deviation.
    pub(crate) fn lasting_variance(&self, states: &AidStates, temporal_nt: f64) -> f64 {
        let of = |(state, entry): (usize, f64)| states.variance(state).map_or(0.0, |of_state| entry * entry * of_state);
        let lasting: f64 = self.sensitivity().entries().filter(|(state, _)| *state >= STATES).map(of).sum();
        lasting + (self.ins[S] * temporal_nt).powi(2)
    }

    /// Converts to a measurement of the previous state, with Φ and the decays of the further states over the step.
    pub(crate) fn carried(mut self, phi: &StateMatrix, decay: impl Fn(usize) -> f64) -> Self {
        let mut ins = [0.0; STATES];
        for (entry, row) in self.ins.iter().zip(phi) {
            ins.iter_mut().zip(row).for_each(|(to, phi)| *to += entry * phi);
        }
        self.ins = ins;
        self.own.1 *= decay(self.own.0);
        let JacobianBlock { first, count, .. } = self.lasting;
        let entries = self.lasting.entries.iter_mut().enumerate().take(count);
        entries.for_each(|(part, entry)| *entry *= decay(first + part));
        self
    }
}

/// Measurements of a sample, or their averages over an interval.
#[derive(Clone, Debug, Default)]
pub(crate) struct AidMeasurements {
    rows: [Option<Box<LinearisedAid>>; MOST],
    /// Whether a measurement was skipped because the map has no value.
    pub(crate) off_map: bool,
}

impl AidMeasurements {
    /// Available measurements, in order of use.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &LinearisedAid> {
        self.rows.iter().flatten().map(AsRef::as_ref)
    }

    /// One measurement.
    pub(crate) fn get(&self, aid: Aid) -> Option<&LinearisedAid> {
        self.rows[aid.place()].as_deref()
    }

    /// Converts to measurements of the previous state; see [`LinearisedAid::carried`].
    pub(crate) fn carried(self, phi: &StateMatrix, decay: impl Fn(usize) -> f64) -> Self {
        let carried = |row: Option<Box<LinearisedAid>>| row.map(|row| Box::new(row.carried(phi, &decay)));
        Self { rows: self.rows.map(carried), off_map: self.off_map }
    }

    fn put(&mut self, row: LinearisedAid) {
        let place = row.of.place();
        self.rows[place] = Some(Box::new(row));
    }

    /// Means of the measurements over several samples. `off_map` is set if it is set for any of the samples.
    pub(crate) fn mean(samples: Vec<Self>) -> Self {
        let mut mean = Self { off_map: samples.iter().any(|sample| sample.off_map), ..Self::default() };
        for aid in Aid::ALL {
            let lost = samples.iter().any(|sample| sample.off_map && sample.get(aid).is_none() && aid != Aid::Height);
            let all: Vec<&LinearisedAid> = samples.iter().filter_map(|sample| sample.get(aid)).collect();
            let Some((first, others)) = all.split_first().filter(|_| !lost) else { continue };
            let mut sum = (*first).clone();
            for one in others {
                sum.value += one.value;
                sum.own.1 += one.own.1;
                sum.ins.iter_mut().zip(&one.ins).for_each(|(sum, entry)| *sum += entry);
                sum.lasting.entries.iter_mut().zip(&one.lasting.entries).for_each(|(sum, entry)| *sum += entry);
            }
            let part = 1.0 / all.len() as f64;
            sum.value *= part;
            sum.variance *= part;
            sum.own.1 *= part;
            sum.ins.iter_mut().chain(&mut sum.lasting.entries).for_each(|entry| *entry *= part);
            mean.put(sum);
        }
        mean
    }
}

/// Innovations of one sample.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SampleInnovations {
    pub(crate) difference: Innovation,
    vector: (f64, f64, u32),
    pub(crate) height: Innovation,
}

impl Default for SampleInnovations {
    fn default() -> Self {
        Self { difference: Innovation::NONE, vector: (0.0, 0.0, 0), height: Innovation::NONE }
    }
}

impl SampleInnovations {
    /// Records the innovation of a measurement.
    pub(crate) fn note(&mut self, of: Aid, innovation: Innovation) {
        match of {
            Aid::Difference => self.difference = innovation,
            Aid::Height => self.height = innovation,
            Aid::Vector(_) => {
                let (squares, nis, count) = &mut self.vector;
                *squares += innovation.residual_nt.powi(2);
                *nis += innovation.nis;
                *count += 1;
            }
        }
    }

    /// Whether difference and vector are both missing.
    pub(crate) fn is_none(&self) -> bool {
        self.difference.nis.is_nan() && self.vector.2 == 0
    }

    /// Innovation of the vector: its length, and the mean NIS over its components.
    pub(crate) fn vector(&self) -> Innovation {
        match self.vector {
            (_, _, 0) => Innovation::NONE,
            (squares, nis, count) => Innovation { residual_nt: squares.sqrt(), nis: nis / f64::from(count) },
        }
    }
}

impl AidInnovations {
    /// Appends the innovations of a sample for each configured measurement.
    pub(crate) fn push(&mut self, aids: &Aids<'_>, sample: &SampleInnovations) {
        if aids.difference.is_some() {
            self.difference.push(sample.difference);
        }
        if aids.vector.is_some() {
            self.vector.push(sample.vector());
        }
        if aids.height.is_some() {
            self.height.push(sample.height);
        }
    }
}

impl Aids<'_> {
    /// Whether a kind of measurement is configured.
    pub(crate) fn has(&self, aid: Aid) -> bool {
        match aid {
            Aid::Difference => self.difference.is_some(),
            Aid::Vector(_) => self.vector.is_some(),
            Aid::Height => self.height.is_some(),
        }
    }

    /// All further measurements of a row, linearised about a state `x` whose further states are at `states`. A value
    /// that is not finite counts as missing.
    pub(crate) fn rows(
        &self,
        states: &AidStates,
        field: &mut PredictedField<'_>,
        line: &NavigationLine<'_>,
        row: usize,
        x: &[f64],
    ) -> AidMeasurements {
        let mut rows = AidMeasurements::default();
        match self.difference_row(states, field, line, row, x) {
            Some(Some(difference)) => rows.put(difference),
            Some(None) => rows.off_map = true,
            None => {}
        }
        match self.vector_rows(states, line, row, x) {
            Some(Some(vector)) => vector.into_iter().for_each(|component| rows.put(component)),
            Some(None) => rows.off_map = true,
            None => {}
        }
        if let Some(height) = self.height_row(states, line, row) {
            rows.put(height);
        }
        rows
    }

    /// Difference of a row, if it is measured; `Some(None)` off the map.
    pub(crate) fn difference_row(
        &self,
        states: &AidStates,
        field: &mut PredictedField<'_>,
        line: &NavigationLine<'_>,
        row: usize,
        x: &[f64],
    ) -> Option<Option<LinearisedAid>> {
        let (of, bias) = self.difference.as_ref().zip(states.difference)?;
        let value_nt = of.difference_nt[row];
        if !value_nt.is_finite() {
            return None;
        }
        let Some((at, tilt)) = of.field(field, line, row, [x[LAT], x[LON], x[ALT]]) else { return Some(None) };
        let mut ins = [0.0; STATES];
        (ins[LAT], ins[LON], ins[ALT]) = (at.d_lat_nt_per_rad, at.d_lon_nt_per_rad, at.d_alt_nt_per_m);
        ins[TILT_N..TILT_N + 3].copy_from_slice(&tilt);
        let moved = ins[LAT] * x[LAT] + ins[LON] * x[LON] + ins[ALT] * x[ALT];
        Some(Some(LinearisedAid {
            of: Aid::Difference,
            value: value_nt - at.value_nt + moved,
            variance: of.sigma_nt * of.sigma_nt,
            ins,
            own: (bias, 1.0),
            lasting: of.slope_block(states, line, row),
        }))
    }

    /// Components of the vector of a row, if all are measured; `Some(None)` off the map.
    pub(crate) fn vector_rows(
        &self,
        states: &AidStates,
        line: &NavigationLine<'_>,
        row: usize,
        x: &[f64],
    ) -> Option<Option<[LinearisedAid; 3]>> {
        let (of, (bias, crustal)) = self.vector.as_ref().zip(states.vector)?;
        let measured_nt = of.field_nt.map(|column| column[row]);
        if measured_nt.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let Some(predicted) = of.predicted(line, row, x) else { return Some(None) };
        Some(Some(std::array::from_fn(|axis| {
            let ins = predicted.rows[axis];
            let moved: f64 = ins.iter().zip(x).map(|(h, x)| h * x).sum();
            LinearisedAid {
                of: Aid::Vector(axis),
                value: measured_nt[axis] - predicted.body_nt[axis] + moved,
                variance: of.sigma_nt * of.sigma_nt,
                ins,
                own: (bias + axis, 1.0),
                lasting: {
                    let [north, east, down] = predicted.crustal[axis];
                    JacobianBlock { first: crustal, count: 3, entries: [north, east, down, 0.0, 0.0] }
                },
            }
        })))
    }

    /// Height of a row, if it is measured.
    pub(crate) fn height_row(
        &self,
        states: &AidStates,
        line: &NavigationLine<'_>,
        row: usize,
    ) -> Option<LinearisedAid> {
        let (of, bias) = self.height.as_ref().zip(states.height)?;
        let value = of.alt_m[row] - line.ins.alt_m[row];
        let mut ins = [0.0; STATES];
        ins[ALT] = 1.0;
        let variance = of.sigma_m * of.sigma_m;
        let height = LinearisedAid {
            of: Aid::Height,
            value,
            variance,
            ins,
            own: (bias, 1.0),
            lasting: JacobianBlock::default(),
        };
        value.is_finite().then_some(height)
    }
}

/// Rotation from body to north-east-down by the INS at a row.
pub(crate) fn rotation(ins: &InsSeries<'_>, row: usize) -> Matrix3<f64> {
    let [roll, pitch, yaw] = ins.point(row).euler_rad;
    body_to_ned(roll, pitch, yaw)
}

/// Unit vector of the core field along nose, right and down at a row, by position and attitude of the INS.
pub fn field_direction(core: &CoreField, ins: &InsSeries<'_>, row: usize) -> [f64; 3] {
    let field = Vector3::from(core.field_ned_nt(ins.lat_deg[row], ins.lon_deg[row], ins.alt_m[row]));
    (rotation(ins, row).transpose() * (field / field.norm())).into()
}

/// Half of the baseline between the magnetometers, oriented by the attitude of the INS.
pub(crate) struct BaselineArm {
    /// Full baseline north, east and down, in metres.
    along: Vector3<f64>,
    /// Half of the baseline in latitude and longitude, in rad, and height, in metres.
    pub(crate) offset: [f64; 3],
    /// Metres per radian north and east.
    m_per_rad: (f64, f64),
}

impl BaselineArm {
    /// Derivative of the difference with respect to the tilt, in nT/rad, from the mean slope of the fields at both
    /// ends.
    ///
    /// The true baseline is (I − [ψ×]) C r = C r + C r × ψ, and g · (C r × ψ) = (g × C r) · ψ.
    pub(crate) fn by_tilt(&self, d_lat_nt_per_rad: f64, d_lon_nt_per_rad: f64, d_alt_nt_per_m: f64) -> [f64; 3] {
        let (north, east) = self.m_per_rad;
        let mean = Vector3::new(d_lat_nt_per_rad / north, d_lon_nt_per_rad / east, -d_alt_nt_per_m);
        mean.cross(&self.along).into()
    }
}

impl DifferenceAid<'_> {
    /// Entries of H for the two errors of the map's slope, in nT; empty without these states.
    pub(crate) fn slope_block(&self, states: &AidStates, line: &NavigationLine<'_>, row: usize) -> JacobianBlock {
        let Some(first) = states.slope else { return JacobianBlock::default() };
        let along = rotation(line.ins, row) * Vector3::from(self.baseline_m);
        let horizontal_nt = along.x.hypot(along.y) * self.slope.horizontal_nt_per_m;
        let upward_nt = -along.z * self.slope.upward_at(row);
        JacobianBlock { first, count: 2, entries: [horizontal_nt, upward_nt, 0.0, 0.0, 0.0] }
    }

    /// Half of the baseline at a row.
    pub(crate) fn arm(&self, line: &NavigationLine<'_>, row: usize) -> BaselineArm {
        let along = rotation(line.ins, row) * Vector3::from(self.baseline_m);
        let half = along * 0.5;
        let (lat_rad, alt_m) = (line.ins.lat_deg[row].to_radians(), line.ins.alt_m[row]);
        let (north, east) = line.errors.earth.north_east_m_per_rad(lat_rad, alt_m);
        BaselineArm { along, offset: [half.x / north, half.y / east, -half.z], m_per_rad: (north, east) }
    }

    /// Difference between the fields at both ends for an error of the INS, its slope, and its derivative with respect
    /// to the tilt, in nT/rad; `None` if either end is off the map.
    pub(crate) fn field(
        &self,
        field: &mut PredictedField<'_>,
        line: &NavigationLine<'_>,
        row: usize,
        [lat, lon, alt]: [f64; 3],
    ) -> Option<(FieldValue, [f64; 3])> {
        let arm = self.arm(line, row);
        let [north, east, up] = arm.offset;
        let first = field.at_error(line.ins, row, [lat + north, lon + east, alt + up])?;
        let second = field.at_error(line.ins, row, [lat - north, lon - east, alt - up])?;
        let tilt = arm.by_tilt(
            0.5 * (first.d_lat_nt_per_rad + second.d_lat_nt_per_rad),
            0.5 * (first.d_lon_nt_per_rad + second.d_lon_nt_per_rad),
            0.5 * (first.d_alt_nt_per_m + second.d_alt_nt_per_m),
        );
        let difference = FieldValue {
            value_nt: first.value_nt - second.value_nt,
            d_lat_nt_per_rad: first.d_lat_nt_per_rad - second.d_lat_nt_per_rad,
            d_lon_nt_per_rad: first.d_lon_nt_per_rad - second.d_lon_nt_per_rad,
            d_alt_nt_per_m: first.d_alt_nt_per_m - second.d_alt_nt_per_m,
        };
        Some((difference, tilt))
    }
}

/// Prediction of the vector from a state.
struct PredictedVector {
    /// Components along nose, right and down, without the further states, in nT.
    body_nt: [f64; 3],
    /// Rows of H of the 18 states.
    rows: [StateVector; 3],
    /// Rows of H of the crustal field north, east and down.
    crustal: [[f64; 3]; 3],
}

impl VectorAid<'_> {
    /// Core field about a position (degrees, degrees, m) north, east and down, and its changes with latitude, longitude
    /// (per rad) and height (per m).
    pub(crate) fn core_about(
        &self,
        earth: EarthModel,
        [lat_deg, lon_deg, alt_m]: [f64; 3],
    ) -> (Vector3<f64>, [Vector3<f64>; 3]) {
        let (north, east) = earth.north_east_m_per_rad(lat_deg.to_radians(), alt_m);
        let core = |[lat_rad, lon_rad, up_m]: [f64; 3]| {
            let (lat, lon) = (lat_deg + lat_rad.to_degrees(), lon_deg + lon_rad.to_degrees());
            Vector3::from(self.core.field_ned_nt(lat, lon, alt_m + up_m))
        };
        let here = core([0.0; 3]);
        let steps = [CORE_STEP_M / north, CORE_STEP_M / east, CORE_STEP_M];
        let slope = |axis: usize| {
            let mut ahead = [0.0; 3];
            ahead[axis] = steps[axis];
            (core(ahead) - here) / steps[axis]
        };
        (here, [slope(0), slope(1), slope(2)])
    }

    /// Vector and its derivatives at a state; `None` off the map.
    fn predicted(&self, line: &NavigationLine<'_>, row: usize, x: &[f64]) -> Option<PredictedVector> {
        let ins = line.ins;
        let lat_deg = ins.lat_deg[row] + x[LAT].to_degrees();
        let (lon_deg, alt_m) = (ins.lon_deg[row] + x[LON].to_degrees(), ins.alt_m[row] + x[ALT]);
        let anomaly = line.map.at(lat_deg, lon_deg, alt_m)?;
        let (here, core) = self.core_about(line.errors.earth, [lat_deg, lon_deg, alt_m]);
        let direction = here / here.norm();
        let slopes = [anomaly.d_lat_nt_per_rad, anomaly.d_lon_nt_per_rad, anomaly.d_alt_nt_per_m];
        let ned = here + direction * (anomaly.value_nt + x[S]);
        let tilt = Vector3::new(x[TILT_N], x[TILT_N + 1], x[TILT_N + 2]);
        let to_body = rotation(ins, row).transpose();
        // Derivatives of Cᵀ (I + [ψ×]) B with respect to B and ψ. The derivative with respect to ψ is −Cᵀ [B×].
        let turn = to_body * (Matrix3::identity() + skew(&tilt));
        let by_tilt = -to_body * skew(&ned);
        let mut rows = [[0.0; STATES]; 3];
        for (state, (of_core, slope)) in [LAT, LON, ALT].into_iter().zip(core.into_iter().zip(slopes)) {
            let changed = turn * (of_core + direction * slope);
            (0..3).for_each(|axis| rows[axis][state] = changed[axis]);
        }
        let along = turn * direction;
        for axis in 0..3 {
            rows[axis][S] = along[axis];
            (0..3).for_each(|part| rows[axis][TILT_N + part] = by_tilt[(axis, part)]);
        }
        let body = turn * ned;
        let crustal = std::array::from_fn(|axis| std::array::from_fn(|part| turn[(axis, part)]));
        Some(PredictedVector { body_nt: [body.x, body.y, body.z], rows, crustal })
    }
}
