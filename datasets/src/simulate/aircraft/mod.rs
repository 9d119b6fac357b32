//! The magnetic field of the aircraft, and what the magnetometers make of it.

use nalgebra::{Matrix3, Vector3};

use super::{earth::Along, line::Scene, random::Random, trajectory::Trajectory};
use crate::motion::derivative;
pub use spec::{Aircraft, Current, Scalar, Source, Vector};

pub(super) mod spec;

/// The field strength that the sizes of induced terms refer to, in nT.
const SCALE_NT: f64 = 50_000.0;

/// The aircraft's field at one sensor, in the body frame: P + M B + E dB/dt + sum of I_k D_k.
/// [Tolles & Lawson 1950; thesis 000 (3.9)-(3.12)]
pub(super) struct Field {
    permanent_nt: Vector3<f64>,
    induced: Matrix3<f64>,
    eddy_s: Matrix3<f64>,
    currents_nt_per_a: Vec<(usize, Vector3<f64>)>,
}

impl Field {
    /// Draws the coefficients of the sensor `name`: the same on all flights, of the sizes in `source`.
    pub(super) fn draw(seed: u64, name: &str, source: &Source, currents: &[Current]) -> Field {
        let mut random = Random::of(seed, &["aircraft", name]);
        let permanent_nt = random.direction() * source.permanent_nt;
        let m = Matrix3::from_fn(|_, _| random.normal()) * (source.induced_nt / SCALE_NT);
        // Symmetric, as an induced tensor is; each element keeps its standard deviation.
        let induced = Matrix3::from_fn(|i, j| m[(i.min(j), i.max(j))]);
        let eddy_s = Matrix3::from_fn(|_, _| random.normal()) * source.eddy_s;
        let coupled = |(index, nt_per_a): &(usize, f64)| {
            let current = currents.get(*index).map_or("", |c| c.name.as_str());
            (*index, Random::of(seed, &["aircraft", name, current]).direction() * *nt_per_a)
        };
        let currents_nt_per_a = source.currents.iter().map(coupled).collect();
        Field { permanent_nt, induced, eddy_s, currents_nt_per_a }
    }

    /// The field in nT where the earth's is `b` (nT) and changes by `b_rate` (nT/s), both in the body
    /// frame, and the currents are `amperes`.
    pub(super) fn at(&self, b: &Vector3<f64>, b_rate: &Vector3<f64>, amperes: impl Fn(usize) -> f64) -> Vector3<f64> {
        let coupled: Vector3<f64> = self.currents_nt_per_a.iter().map(|(k, d)| d * amperes(*k)).sum();
        self.permanent_nt + self.induced * b + self.eddy_s * b_rate + coupled
    }
}

/// What surrounds the sensors along a line.
pub(super) struct Surroundings<'a> {
    /// Time, in s.
    pub(super) tt_s: &'a [f64],
    /// The earth's field in the body frame, in nT.
    pub(super) body_nt: &'a [Vector3<f64>],
    /// Its rate, in nT/s.
    pub(super) rate_ntps: &'a [Vector3<f64>],
    /// True currents in A: one column each.
    pub(super) amperes: &'a [Vec<f64>],
}

impl Surroundings<'_> {
    /// The total field at a sensor, sample by sample.
    fn total<'b>(&'b self, field: &'b Field) -> impl Iterator<Item = Vector3<f64>> + 'b {
        let at = move |i: usize| {
            let amperes = |k: usize| self.amperes.get(k).and_then(|c| c.get(i)).copied().unwrap_or(0.0);
            self.body_nt[i] + field.at(&self.body_nt[i], &self.rate_ntps[i], amperes)
        };
        (0..self.tt_s.len()).map(at)
    }

    /// What a scalar magnetometer reads, in nT: the magnitude of the vector sum, drift and noise.
    pub(super) fn scalar_nt(&self, sensor: &Scalar, field: &Field, random: &mut Random) -> Vec<f64> {
        let drift = sensor.drift.map(|d| d.realisation(self.tt_s, || random.normal()));
        let exact = self.total(field).map(|b| b.norm());
        let read = |(i, b): (usize, f64)| {
            let slow = drift.as_ref().map_or(0.0, |d| d[i]);
            b + slow + sensor.noise_nt * random.normal()
        };
        exact.enumerate().map(read).collect()
    }

    /// What a vector magnetometer reads, in nT: scale and offset of each axis, and noise.
    pub(super) fn vector_nt(&self, sensor: &Vector, field: &Field, seed: u64, random: &mut Random) -> [Vec<f64>; 3] {
        let mut made = Random::of(seed, &["calibration", &sensor.name]);
        let scale = Vector3::from_fn(|_, _| 1.0 + sensor.scale * made.normal());
        let offset = Vector3::from_fn(|_, _| sensor.offset_nt * made.normal());
        let mut out = [vec![], vec![], vec![]];
        for b in self.total(field) {
            for (axis, column) in out.iter_mut().enumerate() {
                column.push(scale[axis] * b[axis] + offset[axis] + sensor.noise_nt * random.normal());
            }
        }
        out
    }
}

/// The readings of every sensor along a line, by column.
pub(super) fn readings(scene: &Scene, truth: &Trajectory, earth: &Along) -> Vec<(String, Vec<f64>)> {
    let (spec, mut out) = (scene.spec, vec![]);
    let parts: [Vec<f64>; 3] = std::array::from_fn(|k| {
        let component: Vec<f64> = earth.body_nt.iter().map(|b| b[k]).collect();
        derivative(&truth.tt_s, &component)
    });
    let rate_ntps: Vec<_> = (0..truth.tt_s.len()).map(|i| Vector3::from_fn(|k, _| parts[k][i])).collect();
    let amperes: Vec<Vec<f64>> =
        spec.aircraft.currents.iter().map(|c| switched(c, &truth.tt_s, &mut scene.random(&c.name))).collect();
    let around = Surroundings { tt_s: &truth.tt_s, body_nt: &earth.body_nt, rate_ntps: &rate_ntps, amperes: &amperes };
    for sensor in &spec.aircraft.scalars {
        let field = Field::draw(spec.seed, &sensor.name, &sensor.source, &spec.aircraft.currents);
        let values = around.scalar_nt(sensor, &field, &mut scene.random(&sensor.name));
        out.push((sensor.name.clone(), values));
    }
    for sensor in &spec.aircraft.vectors {
        let field = Field::draw(spec.seed, &sensor.name, &sensor.source, &spec.aircraft.currents);
        let axes = around.vector_nt(sensor, &field, spec.seed, &mut scene.random(&sensor.name));
        for (axis, values) in ["x", "y", "z"].iter().zip(axes) {
            out.push((format!("{}_{axis}", sensor.name), values));
        }
    }
    for (current, true_a) in spec.aircraft.currents.iter().zip(&amperes) {
        let mut random = scene.random(&format!("sensor of {}", current.name));
        let values = true_a.iter().map(|a| a + current.noise_a * random.normal()).collect();
        out.push((current.name.clone(), values));
    }
    out
}

/// A current that is on and off in turns, in A at the times `tt_s`.
pub(super) fn switched(current: &Current, tt_s: &[f64], random: &mut Random) -> Vec<f64> {
    let (off_s, on_s) = current.mean_off_on_s;
    let mut on = random.uniform() < on_s / (off_s + on_s);
    let mut wait = |on: bool| random.exponential(if on { on_s } else { off_s });
    let mut until = tt_s.first().copied().unwrap_or(0.0) + wait(on);
    let at = |tt: &f64| {
        while *tt >= until {
            on = !on;
            until += wait(on);
        }
        if on { current.off_on_a.1 } else { current.off_on_a.0 }
    };
    tt_s.iter().map(at).collect()
}
