//! Direction of the field in a scalar sensor. It determines the noise and the heading error of the sensor.

use arrow_array::RecordBatch;
use schemas::{Fault, Rule, TableShape, choice, params};

use crate::columns::{faults_of, floats, vector_axes};

choice! {
    /// Directions in which the signal of an optically pumped magnetometer vanishes.
    #[derive(Default)]
    pub enum DeadZones {
        /// No dead zone, or unknown dead zones.
        #[default]
        None = "none",
        /// Along the axis of the sensor: the amplitude is proportional to |sin θ|.
        Polar = "polar",
        /// Along and across the axis of the sensor: the amplitude of a self-oscillating sensor is proportional to |sin
        /// 2θ| [Bloom 1962].
        PolarAndEquatorial = "polar_and_equatorial",
    }
}

/// A sensor has no reading if its amplitude is below this fraction of the largest amplitude.
const LEAST_AMPLITUDE: f64 = 0.1;

params! {
    /// Orientation of a scalar sensor in the field.
    pub struct SensorGeometry;
    /// Vector magnetometer that gives the direction of the field, such as `flux_a`. The noise of this magnetometer, and
    /// the aircraft field at its position, are neglected.
    vector: Option<String>, unit "", absent "equal noise in all attitudes";
    /// Axis of the scalar sensor in the frame of the vector magnetometer: nose, right, down.
    sensor_axis: [f64; 3], unit "1", default [1.0, 0.0, 0.0], rule Rule::Finite;
    /// Dead zones of the scalar sensor: along its axis (`polar`), or also across its axis (`polar_and_equatorial`). The
    /// assumed noise is inversely proportional to the amplitude of the sensor's signal. At the largest amplitude, the
    /// noise is `measurement_sigma_nt`. A sample whose amplitude is below a tenth of the largest gives no measurement.
    dead_zones: DeadZones, unit "", default DeadZones::None;
}

impl SensorGeometry {
    /// Faults on a flight. `wanted` states whether the filter requires the direction.
    pub(super) fn faults(&self, shape: &TableShape, wanted: bool) -> Vec<Fault> {
        let Some(vector) = &self.vector else {
            let none = self.dead_zones == DeadZones::None;
            let what = "`dead_zones` requires the direction of the field: set `vector` to a vector magnetometer";
            return if none { vec![] } else { vec![Fault::new(what).of_param("dead_zones")] };
        };
        let mut faults = faults_of(vector_axes(vector).iter().map(|axis| shape.number(axis, "nT")), "vector");
        if self.sensor_axis.iter().all(|part| *part == 0.0) {
            faults.push(Fault::new("`sensor_axis` has length 0").of_param("sensor_axis"));
        }
        if self.dead_zones == DeadZones::None && !wanted {
            let what = "`vector` has no effect: neither the noise nor the filter depends on the field's direction";
            let help = "remove `vector`, or set `dead_zones`";
            faults.push(Fault::new(what).of_param("vector").help(help));
        }
        faults
    }

    /// Fault of a key that has no effect.
    pub(crate) fn unused_key(&self, key: &str) -> Option<Fault> {
        (key == "sensor_axis" && self.vector.is_none())
            .then(|| Fault::new("`sensor_axis` has no effect without `vector`").of_param(key))
    }

    /// Columns that are read.
    pub(super) fn reads(&self) -> Vec<String> {
        self.vector.iter().flat_map(|vector| vector_axes(vector)).collect()
    }

    /// Vector along a line, in nT.
    pub(super) fn field<'a>(&self, batch: &'a RecordBatch) -> Result<Option<[&'a [f64]; 3]>, Fault> {
        let Some(vector) = &self.vector else { return Ok(None) };
        let [x, y, z] = vector_axes(vector).map(|axis| floats(batch, &axis));
        Ok(Some([x?, y?, z?]))
    }

    /// The cosine of the angle between the sensor's axis and the field; NaN if the vector is unknown or zero.
    pub(super) fn cosines(&self, [x, y, z]: [&[f64]; 3]) -> Vec<f64> {
        let [a, b, c] = self.sensor_axis;
        let size = a.hypot(b).hypot(c);
        let of = |(x, (y, z)): (&f64, (&f64, &f64))| {
            let norm = x.hypot(*y).hypot(*z);
            if norm > 0.0 { (a * x + b * y + c * z) / (size * norm) } else { f64::NAN }
        };
        x.iter().zip(y.iter().zip(z)).map(of).collect()
    }

    /// Factor on the standard deviation at the angle with this cosine; NaN if the signal vanishes or the angle is
    /// unknown.
    pub(super) fn noise_factor(&self, cosine: f64) -> f64 {
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        let amplitude = match self.dead_zones {
            DeadZones::None => return 1.0,
            DeadZones::Polar => sine,
            DeadZones::PolarAndEquatorial => 2.0 * sine * cosine.abs(),
        };
        if amplitude >= LEAST_AMPLITUDE { 1.0 / amplitude } else { f64::NAN }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn geometry(dead_zones: DeadZones) -> SensorGeometry {
        SensorGeometry { vector: Some("flux_a".to_owned()), sensor_axis: [0.0, 2.0, 0.0], dead_zones }
    }

    #[test]
    fn law_the_angle_between_two_vectors_is_correct() {
        let (x, y, z) = ([3.0, 0.0, 0.0, 0.0, 1.0], [4.0, -7.0, 0.0, f64::NAN, 0.0], [0.0, 0.0, 0.0, 1.0, 1.0]);
        let cosines = geometry(DeadZones::None).cosines([&x, &y, &z]);
        assert_eq!((cosines[0], cosines[1], cosines[4]), (0.8, -1.0, 0.0));
        assert!(cosines[2].is_nan() && cosines[3].is_nan(), "{cosines:?}");
    }

    #[test]
    fn law_noise_is_smallest_at_the_largest_signal() {
        let of = |zones, deg: f64| geometry(zones).noise_factor(deg.to_radians().cos());
        for deg in [0.0_f64, 3.0, 45.0, 90.0] {
            assert_eq!(of(DeadZones::None, deg), 1.0);
        }
        // sin 90° and sin 2·45° are 1, sin 30° and sin 2·15° are 1/2; sin 5° is 0.087, sin 2·2° is 0.07.
        assert!((of(DeadZones::Polar, 90.0) - 1.0).abs() < 1e-12 && (of(DeadZones::Polar, 30.0) - 2.0).abs() < 1e-12);
        let both = DeadZones::PolarAndEquatorial;
        assert!((of(both, 45.0) - 1.0).abs() < 1e-12 && (of(both, 165.0) - 2.0).abs() < 1e-12);
        assert!(of(DeadZones::Polar, 5.0).is_nan() && of(both, 2.0).is_nan() && of(both, 88.0).is_nan());
        assert!(of(both, f64::NAN).is_nan(), "without a direction nothing is known of the noise");
    }

    #[test]
    fn unit_missing_inputs_are_reported() {
        let axes = ["flux_a_x", "flux_a_y"].map(|name| schemas::Column::float(name, "nT", "")).to_vec();
        let shape = TableShape { columns: axes.into(), rate_hz: None };
        let faults = geometry(DeadZones::Polar).faults(&shape, false);
        assert!(faults.len() == 1 && faults[0].what.contains("flux_a_z"), "{faults:?}");
        let idle = SensorGeometry { vector: None, ..geometry(DeadZones::Polar) };
        assert!(idle.faults(&shape, true)[0].what.contains("requires the direction"));
        assert!(idle.unused_key("sensor_axis").is_some() && idle.unused_key("vector").is_none());
        let none = geometry(DeadZones::None).faults(&shape, false);
        assert!(none.iter().any(|fault| fault.what.contains("has no effect")), "{none:?}");
        let flat = SensorGeometry { sensor_axis: [0.0; 3], ..geometry(DeadZones::Polar) };
        assert!(flat.faults(&shape, false).iter().any(|fault| fault.what.contains("length 0")));
    }
}
