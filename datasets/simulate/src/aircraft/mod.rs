//! The magnetic field of the aircraft, and the readings of the magnetometers and the other sensors on board.

use nalgebra::Vector3;

use super::{earth::Along, scene::Scene, trajectory::Trajectory};
use field::{Drive, FIELD_PARTS, Field};
use motion::Motion;
use sensors::{Bench, FieldParts, SCALAR_PARTS, VECTOR_PARTS};
pub use spec::{
    Aircraft, Current, Drawn, Engine, Heading, Input, Kind, Sampling, Scalar, Signal, Source, Temperature, Thermostat,
    Vector, Voltage, Wire,
};

mod currents;
mod field;
mod motion;
mod sampling;
mod sensors;
pub(super) mod spec;
mod wires;

const AXES: [&str; 3] = ["x", "y", "z"];

/// The names of the columns of [`readings`], in their order.
pub(super) fn columns(aircraft: &Aircraft) -> Vec<String> {
    let scalars: Vec<String> = aircraft.scalars.iter().map(|s| s.name.clone()).collect();
    let axes = |name: &String| AXES.map(|axis| format!("{name}_{axis}"));
    let vectors: Vec<String> = aircraft.vectors.iter().flat_map(|v| axes(&v.name)).collect();
    let mut names = [scalars.clone(), vectors.clone()].concat();
    names.extend(aircraft.currents.iter().filter(|c| c.measured).map(|c| c.name.clone()));
    names.extend(aircraft.voltages.iter().map(|v| v.name.clone()));
    names.extend(aircraft.inputs.iter().map(|i| i.name.clone()));
    if aircraft.component_columns {
        names.extend(scalars.iter().flat_map(|name| part_names(name, &SCALAR_PARTS)));
        names.extend(vectors.iter().flat_map(|name| part_names(name, &VECTOR_PARTS)));
    }
    names
}

fn part_names<'a>(column: &'a str, own: &'a [&'static str]) -> impl Iterator<Item = String> + 'a {
    FIELD_PARTS.iter().chain(own).map(move |part| format!("part_{part}_{column}"))
}

/// The environment of the sensors along a line.
struct Surroundings<'a> {
    scene: &'a Scene<'a>,
    truth: &'a Trajectory,
    earth: &'a Along,
    motion: Motion,
    /// The earth's field in the body frame in nT: core, anomaly, variation.
    body_nt: [Vec<Vector3<f64>>; 3],
    /// True currents in A: one column each.
    amperes: Vec<Vec<f64>>,
    /// The duration of the flight up to the line's end, in seconds.
    until_s: f64,
}

impl<'a> Surroundings<'a> {
    fn new(scene: &'a Scene, truth: &'a Trajectory, earth: &'a Along) -> Self {
        let start_tt_s = scene.flight.lines.first().map_or(0.0, |l| l.start_tt_s);
        let motion = Motion::of(truth, start_tt_s);
        let to_body: Vec<_> = (0..truth.tt_s.len()).map(|i| truth.attitude(i).transpose()).collect();
        let body_nt = [&earth.core_ned_nt, &earth.anomaly_ned_nt, &earth.diurnal_ned_nt]
            .map(|part| to_body.iter().zip(part).map(|(turn, b)| turn * b).collect());
        let aircraft = &scene.spec.aircraft;
        let currents = aircraft.currents.iter();
        let amperes = currents.map(|c| c.amperes(&motion, &aircraft.temperature, &mut scene.random(&c.name)));
        let amperes = amperes.collect();
        let until_s = motion.since_s.last().copied().unwrap_or(0.0);
        Self { scene, truth, earth, motion, body_nt, amperes, until_s }
    }

    /// The components of the field at a sensor, sample by sample.
    fn field_at(&'a self, name: &str, source: &'a spec::Source) -> impl Iterator<Item = FieldParts> + 'a {
        let spec = self.scene.spec;
        let flight = (self.scene.flight.name.as_str(), self.until_s);
        let field = Field::draw(spec.seed, flight, (name, source), &spec.aircraft, &spec.components);
        (0..self.truth.tt_s.len()).map(move |i| self.parts(&field, i))
    }

    fn parts(&self, field: &Field, i: usize) -> FieldParts {
        let drive = Drive {
            earth_nt: self.earth.body_nt[i],
            rate_ntps: self.earth.body_rate_ntps[i],
            amperes: &self.amperes,
            row: i,
            since_s: self.motion.since_s[i],
            lift_mps2: self.motion.lift_mps2[i],
        };
        let [permanent, induced, eddy, currents, landing, walk, flex] = field.parts_nt(&drive);
        let [core, anomaly, diurnal] = self.body_nt.each_ref().map(|part| part[i]);
        [core, anomaly, diurnal, permanent, induced, eddy, currents, landing, walk, flex]
    }
}

/// The readings of every sensor along a line, by column.
pub(super) fn readings(scene: &Scene, truth: &Trajectory, earth: &Along) -> Vec<(String, Vec<f64>)> {
    let aircraft = &scene.spec.aircraft;
    let around = Surroundings::new(scene, truth, earth);
    let (since_s, wanted) = (&around.motion.since_s, aircraft.component_columns);
    let bench = Bench { scene, tt_s: &truth.tt_s, since_s, wanted };
    let (mut values, mut parts) = (vec![], vec![]);
    for sensor in &aircraft.scalars {
        let reading = bench.scalar(sensor, around.field_at(&sensor.name, &sensor.source));
        values.push(reading.values_nt);
        parts.extend(reading.parts_nt);
    }
    for sensor in &aircraft.vectors {
        let field = around.field_at(&sensor.name, &sensor.source);
        for reading in bench.vector(sensor, &aircraft.temperature, field) {
            values.push(reading.values_nt);
            parts.extend(reading.parts_nt);
        }
    }
    values.extend(around.electric());
    values.extend(parts);
    columns(aircraft).into_iter().zip(values).collect()
}

impl Surroundings<'_> {
    /// The readings of the sensors of currents, voltages and control signals.
    fn electric(&self) -> Vec<Vec<f64>> {
        let (aircraft, scene) = (&self.scene.spec.aircraft, self.scene);
        let noisy = |x: &[f64], sigma: f64, what: &str, name: &str| -> Vec<f64> {
            let mut random = scene.random(&format!("{what} {name}"));
            let sigma = if scene.spec.components.on("noise") { sigma } else { 0.0 };
            x.iter().map(|x| x + sigma * random.normal()).collect()
        };
        let mut out = vec![];
        for (current, true_a) in aircraft.currents.iter().zip(&self.amperes).filter(|(c, _)| c.measured) {
            let read: Vec<f64> = true_a.iter().map(|a| current.scale * a).collect();
            out.push(noisy(&read, current.noise_a, "sensor of", &current.name));
        }
        for voltage in &aircraft.voltages {
            let at = |(i, t): (usize, &f64)| {
                let sag: f64 = voltage.ohm.iter().map(|(k, ohm)| ohm * self.amperes[*k][i]).sum();
                voltage.volts - sag - voltage.discharge_v_per_h * t / 3600.0
            };
            let volts: Vec<f64> = self.motion.since_s.iter().enumerate().map(at).collect();
            out.push(noisy(&volts, voltage.noise_v, "sensor of", &voltage.name));
        }
        for input in &aircraft.inputs {
            let signal: Vec<f64> = self.signal(&input.signal).iter().map(|s| input.offset + input.gain * s).collect();
            let read = noisy(&signal, input.noise, "input", &input.name);
            let step = input.resolution;
            out.push(read.iter().map(|x| if step > 0.0 { (x / step).round() * step } else { *x }).collect());
        }
        out
    }

    fn signal(&self, signal: &Signal) -> Vec<f64> {
        let aircraft = &self.scene.spec.aircraft;
        match signal {
            Signal::Level(index) => {
                let (off_a, on_a) = aircraft.currents[*index].off_on_a;
                self.amperes[*index]
                    .iter()
                    .map(|a| if on_a == off_a { 1.0 } else { (a - off_a) / (on_a - off_a) })
                    .collect()
            }
            Signal::Rate(axis) => self.motion.rates_dps[*axis].clone(),
            Signal::Speed => self.motion.speed_mps.clone(),
            Signal::Temperature => self.motion.since_s.iter().map(|t| aircraft.temperature.at(*t)).collect(),
        }
    }
}

#[cfg(test)]
mod tests;
