//! The further measurements of a sample: what a state predicts of them.

use nalgebra::{Matrix3, Vector3};

use crate::earth::attitude::{body_to_ned, skew};
use crate::earth::field_value::FieldValue;
use crate::navigation::field::PredictedField;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::line::NavigationLine;
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES, StateVector, TILT_N};

use super::{Aids, Difference, Vector};
use crate::navigation::gaussian::Layout;
use crate::signal::gauss_markov::GaussMarkov;

/// A distance over which the core field is linear, in m.
const CORE_STEP_M: f64 = 1000.0;

/// Where the further states are, and how long they last.
#[derive(Clone, Debug, Default)]
pub(super) struct Further {
    pub(super) layout: Layout,
    pub(super) difference: Option<usize>,
    pub(super) height: Option<usize>,
    pub(super) map_error: Option<usize>,
    /// The first of the three biases of the vector, and of the three parts of the crustal field.
    pub(super) vector: Option<(usize, usize)>,
    /// The states that last for a distance, with it in m.
    along_track: Vec<(usize, f64)>,
}

impl Further {
    pub(super) fn of(aids: &Aids<'_>) -> Self {
        let mut further = Self::default();
        further.difference = aids.difference.map(|of| further.add(of.bias));
        further.height = aids.height.map(|of| further.add(of.bias));
        further.map_error = aids.map_error.map(|of| further.add_along(of.sigma_nt, of.length_m));
        further.vector = aids.vector.map(|of| {
            let biases = [(); 3].map(|()| further.add(of.bias));
            let crustal = [(); 3].map(|()| further.add_along(of.crustal_sigma_nt, of.crustal_length_m));
            (biases[0], crustal[0])
        });
        further
    }

    fn add(&mut self, error: GaussMarkov) -> usize {
        self.layout.errors.push(error);
        STATES + self.layout.errors.len() - 1
    }

    fn add_along(&mut self, sigma: f64, length_m: f64) -> usize {
        let state = self.add(GaussMarkov { sigma, tau_s: f64::INFINITY });
        self.along_track.push((state - STATES, length_m));
        state
    }

    /// Sets the correlation times of a step at this ground speed.
    pub(super) fn at_speed(&mut self, speed_mps: f64) {
        for (error, length_m) in &self.along_track {
            self.layout.errors[*error].tau_s = length_m / speed_mps;
        }
    }
}

/// The rotation from body to north-east-down by the INS at a row.
pub(super) fn rotation(ins: &InsSeries<'_>, row: usize) -> Matrix3<f64> {
    let [roll, pitch, yaw] = ins.point(row).euler_rad;
    body_to_ned(roll, pitch, yaw)
}

impl Difference<'_> {
    /// The difference of the fields at both ends about an error of the INS, and its slope; `None` where either is off the
    /// map.
    pub(super) fn field(
        &self,
        field: &mut PredictedField<'_>,
        line: &NavigationLine<'_>,
        row: usize,
        [lat, lon, alt]: [f64; 3],
    ) -> Option<FieldValue> {
        let half = rotation(line.ins, row) * Vector3::from(self.baseline_m) * 0.5;
        let (lat_rad, alt_m) = (line.ins.lat_deg[row].to_radians(), line.ins.alt_m[row]);
        let (north, east) = line.errors.earth.north_east_m_per_rad(lat_rad, alt_m);
        let arm = [half.x / north, half.y / east, -half.z];
        let first = field.at_error(line.ins, row, [lat + arm[0], lon + arm[1], alt + arm[2]])?;
        let second = field.at_error(line.ins, row, [lat - arm[0], lon - arm[1], alt - arm[2]])?;
        Some(FieldValue {
            value_nt: first.value_nt - second.value_nt,
            d_lat_nt_per_rad: first.d_lat_nt_per_rad - second.d_lat_nt_per_rad,
            d_lon_nt_per_rad: first.d_lon_nt_per_rad - second.d_lon_nt_per_rad,
            d_alt_nt_per_m: first.d_alt_nt_per_m - second.d_alt_nt_per_m,
        })
    }
}

/// What a state predicts of the vector.
pub(super) struct PredictedVector {
    /// Along nose, right and down, without the further states, in nT.
    pub(super) body_nt: [f64; 3],
    /// The rows of H of the 18 states.
    pub(super) rows: [StateVector; 3],
    /// Those of the crustal field north, east and down.
    pub(super) crustal: [[f64; 3]; 3],
}

impl Vector<'_> {
    /// The vector and its derivatives at a state; `None` off the map.
    pub(super) fn predicted(&self, line: &NavigationLine<'_>, row: usize, x: &[f64]) -> Option<PredictedVector> {
        let ins = line.ins;
        let lat_deg = ins.lat_deg[row] + x[LAT].to_degrees();
        let (lon_deg, alt_m) = (ins.lon_deg[row] + x[LON].to_degrees(), ins.alt_m[row] + x[ALT]);
        let anomaly = line.map.at(lat_deg, lon_deg, alt_m)?;
        let (north, east) = line.errors.earth.north_east_m_per_rad(lat_deg.to_radians(), alt_m);
        let core = |lat_rad: f64, lon_rad: f64, up_m: f64| {
            let (lat, lon) = (lat_deg + lat_rad.to_degrees(), lon_deg + lon_rad.to_degrees());
            Vector3::from(self.core.field_ned_nt(lat, lon, alt_m + up_m))
        };
        let here = core(0.0, 0.0, 0.0);
        let direction = here / here.norm();
        let steps = [CORE_STEP_M / north, CORE_STEP_M / east, CORE_STEP_M];
        let slopes = [anomaly.d_lat_nt_per_rad, anomaly.d_lon_nt_per_rad, anomaly.d_alt_nt_per_m];
        let ned = here + direction * (anomaly.value_nt + x[S]);
        let tilt = Vector3::new(x[TILT_N], x[TILT_N + 1], x[TILT_N + 2]);
        let to_body = rotation(ins, row).transpose();
        // Cᵀ (I + [ψ×]) B: the derivative by B, and that by ψ, which is −Cᵀ [B×].
        let turn = to_body * (Matrix3::identity() + skew(&tilt));
        let by_tilt = -to_body * skew(&ned);
        let mut rows = [[0.0; STATES]; 3];
        for (state, (step, slope)) in [LAT, LON, ALT].into_iter().zip(steps.into_iter().zip(slopes)) {
            let ahead = [LAT, LON, ALT].map(|of| if of == state { step } else { 0.0 });
            let changed = (core(ahead[0], ahead[1], ahead[2]) - here) / step + direction * slope;
            let changed = turn * changed;
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
