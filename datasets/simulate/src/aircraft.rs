//! The magnetic field of the aircraft, and the readings of the magnetometers and the other sensors on board.

use nalgebra::{Rotation3, Vector3};

use super::{earth::LineEarthField, scene::SynthLineContext, trajectory::TrueTrajectory};
use feeds::EffectiveCurrents;
use field::{AircraftField, AircraftFieldInput, FIELD_PARTS, SCALE_NT};
use motion::AircraftMotion;
use response::{RayleighHysteresis, delayed, first_order};
use sensors::{MagnetometerSimulation, SCALAR_PARTS, SensorFieldParts, VECTOR_PARTS};
pub use spec::{
    Aircraft, AircraftFieldSpec, ChannelErrors, ControlQuantity, ControlSignal, Current, CurrentControl,
    EngineThrottle, HeadingErrorModel, QuantitySpec, ScalarMagnetometer, SensorSampling, Temperature, Thermostat,
    VectorMagnetometer, Voltage, Wire,
};

mod currents;
mod feeds;
mod field;
mod motion;
mod response;
mod sampling;
mod sensors;
pub(super) mod spec;
mod wires;

/// Number of steps of the turn before a line.
const TURN_STEPS: u32 = 72;

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

/// The core field, the anomaly and the variation along a line, in nT. The components are north, east and down, or those
/// in the body frame.
type EarthFieldParts = [Vec<Vector3<f64>>; 3];

/// Environment of the sensors along a line.
struct SensorEnvironment<'a> {
    scene: &'a SynthLineContext<'a>,
    truth: &'a TrueTrajectory,
    earth: &'a LineEarthField,
    motion: AircraftMotion,
    /// The earth's field in the body frame in nT: core, anomaly, variation.
    body_nt: EarthFieldParts,
    /// True currents in A: one column each.
    amperes: Vec<Vec<f64>>,
    /// Effective currents, to which the fields are proportional.
    feeds: EffectiveCurrents,
    /// The irreversible magnetisation of the airframe's iron, as a fraction of the reference loop's; empty without
    /// iron.
    iron: Vec<Vector3<f64>>,
    /// The duration of the flight up to the line's end, in seconds.
    until_s: f64,
}

impl<'a> SensorEnvironment<'a> {
    fn new(scene: &'a SynthLineContext, truth: &'a TrueTrajectory, earth: &'a LineEarthField) -> Self {
        let start_tt_s = scene.flight.lines.first().map_or(0.0, |l| l.start_tt_s);
        let motion = AircraftMotion::from_truth(truth, start_tt_s);
        let body_nt = in_body(truth, [&earth.core_ned_nt, &earth.anomaly_ned_nt, &earth.diurnal_ned_nt]);
        let aircraft = &scene.spec.aircraft;
        let currents = aircraft.currents.iter();
        let amperes = currents.map(|c| c.amperes(&motion, &aircraft.temperature, &mut scene.random(&c.name)));
        let amperes: Vec<Vec<f64>> = amperes.collect();
        let feeds = EffectiveCurrents::from_currents(aircraft, &amperes, scene.spec.rate_hz, &scene.spec.components);
        let until_s = motion.since_s.last().copied().unwrap_or(0.0);
        let iron = iron(scene, &earth.body_nt);
        Self { scene, truth, earth, motion, body_nt, amperes, feeds, iron, until_s }
    }

    /// The components of the field at a sensor, sample by sample; `earth_nt` is the earth's field there, in the body
    /// frame.
    fn field_at(
        &'a self,
        name: &str,
        source: &'a spec::AircraftFieldSpec,
        earth_nt: &'a EarthFieldParts,
    ) -> impl Iterator<Item = SensorFieldParts> + 'a {
        let spec = self.scene.spec;
        let flight = (self.scene.flight.name.as_str(), self.until_s);
        let field =
            AircraftField::draw(spec.seed, flight, (name, source), (&spec.aircraft, &self.feeds), &spec.components);
        (0..self.truth.tt_s.len()).map(move |i| self.parts(&field, earth_nt, i))
    }

    fn parts(&self, field: &AircraftField, earth_nt: &EarthFieldParts, i: usize) -> SensorFieldParts {
        let drive = AircraftFieldInput {
            earth_nt: self.earth.body_nt[i],
            rate_ntps: self.earth.body_rate_ntps[i],
            feeds_a: &self.feeds.series_a,
            row: i,
            since_s: self.motion.since_s[i],
            lift_mps2: self.motion.lift_mps2[i],
            iron: self.iron.get(i).copied().unwrap_or_default(),
        };
        let [permanent, induced, eddy, currents, landing, walk, flex, hysteresis] = field.parts_nt(&drive);
        let [core, anomaly, diurnal] = earth_nt.each_ref().map(|part| part[i]);
        [core, anomaly, diurnal, permanent, induced, eddy, currents, landing, walk, flex, hysteresis]
    }
}

/// Parts of the earth's field (north, east, down) in the body frame.
fn in_body(truth: &TrueTrajectory, ned_nt: [&Vec<Vector3<f64>>; 3]) -> EarthFieldParts {
    let to_body: Vec<_> = (0..truth.tt_s.len()).map(|i| truth.attitude(i).transpose()).collect();
    ned_nt.map(|part| to_body.iter().zip(part).map(|(turn, b)| turn * b).collect())
}

/// The irreversible magnetisation of the airframe's iron along each axis of the body, as a fraction of the
/// magnetisation of the reference loop. The list is empty if no sensor has hysteresis. Before the line begins, the
/// aircraft has flown a level full circle, to the right or to the left.
fn iron(scene: &SynthLineContext, earth_nt: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let aircraft = &scene.spec.aircraft;
    let sources = aircraft.scalars.iter().map(|s| &s.source).chain(aircraft.vectors.iter().map(|v| &v.source));
    let none = sources.into_iter().all(|s| s.hysteresis.is_none());
    let Some(first_nt) = earth_nt.first().filter(|_| !none && scene.spec.components.on("hysteresis")) else {
        return vec![];
    };
    let direction = if scene.random("turn before").uniform() < 0.5 { 1.0 } else { -1.0 };
    let turning = (0..TURN_STEPS).map(|k| {
        let angle = direction * std::f64::consts::TAU * f64::from(k) / f64::from(TURN_STEPS);
        Rotation3::from_axis_angle(&Vector3::z_axis(), angle) * first_nt
    });
    let mut axes = [0, 1, 2].map(|_| RayleighHysteresis::demagnetised(SCALE_NT));
    let mut follow = |b: Vector3<f64>| Vector3::from_fn(|k, _| axes[k].follow(b[k]));
    turning.for_each(|b| {
        follow(b);
    });
    earth_nt.iter().map(|b| follow(*b)).collect()
}

/// The readings of every sensor along a line, by column. `at_arms` holds the earth's field (north, east, down) at each
/// scalar magnetometer that is not at the INS.
pub(super) fn readings(
    scene: &SynthLineContext,
    truth: &TrueTrajectory,
    earth: &LineEarthField,
    at_arms: Vec<Option<EarthFieldParts>>,
) -> Vec<(String, Vec<f64>)> {
    let aircraft = &scene.spec.aircraft;
    let around = SensorEnvironment::new(scene, truth, earth);
    let (since_s, wanted) = (&around.motion.since_s, aircraft.component_columns);
    let bench = MagnetometerSimulation { scene, tt_s: &truth.tt_s, since_s, amperes: &around.amperes, wanted };
    let (mut values, mut parts) = (vec![], vec![]);
    for (sensor, at_arm) in aircraft.scalars.iter().zip(at_arms) {
        let at_arm = at_arm.map(|ned_nt| in_body(truth, ned_nt.each_ref()));
        let earth_nt = at_arm.as_ref().unwrap_or(&around.body_nt);
        let reading = bench.scalar(sensor, around.field_at(&sensor.name, &sensor.source, earth_nt));
        values.push(reading.values_nt);
        parts.extend(reading.parts_nt);
    }
    for sensor in &aircraft.vectors {
        let field = around.field_at(&sensor.name, &sensor.source, &around.body_nt);
        for reading in bench.vector(sensor, &aircraft.temperature, field) {
            values.push(reading.values_nt);
            parts.extend(reading.parts_nt);
        }
    }
    values.extend(around.electric());
    values.extend(parts);
    columns(aircraft).into_iter().zip(values).collect()
}

impl SensorEnvironment<'_> {
    /// Readings of the sensors of currents, voltages and control signals.
    fn electric(&self) -> Vec<Vec<f64>> {
        let (aircraft, scene) = (&self.scene.spec.aircraft, self.scene);
        let noisy = |x: &[f64], sigma: f64, what: &str, name: &str| -> Vec<f64> {
            let mut random = scene.random(&format!("{what} {name}"));
            let sigma = if scene.spec.components.on("noise") { sigma } else { 0.0 };
            x.iter().map(|x| x + sigma * random.normal()).collect()
        };
        let recorded = |x: Vec<f64>, channel: &ChannelErrors| recorded(x, channel, scene);
        let step = |step: f64| if scene.spec.components.on("channel_resolution") { step } else { 0.0 };
        let mut out = vec![];
        for (current, true_a) in aircraft.currents.iter().zip(&self.amperes).filter(|(c, _)| c.measured) {
            let scale = if scene.spec.components.on("channel_scale") { current.scale } else { 1.0 };
            let read = recorded(true_a.iter().map(|a| scale * a).collect(), &current.channel);
            let read = noisy(&read, current.noise_a, "sensor of", &current.name);
            out.push(rounded(read, step(current.resolution_a)));
        }
        for voltage in &aircraft.voltages {
            let at = |(i, t): (usize, &f64)| {
                let sag: f64 = voltage.ohm.iter().map(|(k, ohm)| ohm * self.amperes[*k][i]).sum();
                voltage.volts - sag - voltage.discharge_v_per_h * t / 3600.0
            };
            let volts = self.motion.since_s.iter().enumerate().map(at).collect();
            let read = noisy(&recorded(volts, &voltage.channel), voltage.noise_v, "sensor of", &voltage.name);
            out.push(rounded(read, step(voltage.resolution_v)));
        }
        for input in &aircraft.inputs {
            let signal = self.signal(&input.signal).iter().map(|s| input.offset + input.gain * s).collect();
            let read = noisy(&recorded(signal, &input.channel), input.noise, "input", &input.name);
            out.push(rounded(read, input.resolution));
        }
        out
    }

    fn signal(&self, signal: &ControlQuantity) -> Vec<f64> {
        let aircraft = &self.scene.spec.aircraft;
        match signal {
            ControlQuantity::Level(index) => {
                let (off_a, on_a) = aircraft.currents[*index].off_on_a;
                self.amperes[*index]
                    .iter()
                    .map(|a| if on_a == off_a { 1.0 } else { (a - off_a) / (on_a - off_a) })
                    .collect()
            }
            ControlQuantity::Rate(axis) => self.motion.rates_dps[*axis].clone(),
            ControlQuantity::Speed => self.motion.speed_mps.clone(),
            ControlQuantity::Temperature => self.motion.since_s.iter().map(|t| aircraft.temperature.at(*t)).collect(),
        }
    }
}

/// The value that a channel records, before noise.
fn recorded(x: Vec<f64>, channel: &ChannelErrors, scene: &SynthLineContext) -> Vec<f64> {
    let on = |component: &str| scene.spec.components.on(component);
    if let Some(stuck) = channel.stuck_at.filter(|_| on("channel_stuck")) {
        return vec![stuck; x.len()];
    }
    let rate_hz = scene.spec.rate_hz;
    let response_s = if on("channel_response") { channel.response_s } else { 0.0 };
    let delay_s = if on("channel_delay") { channel.delay_s } else { 0.0 };
    let limit = channel.limit.filter(|_| on("channel_limit")).unwrap_or(f64::INFINITY);
    let read = first_order(&delayed(&x, rate_hz, delay_s), rate_hz, response_s);
    read.into_iter().map(|x| x.clamp(-limit, limit)).collect()
}

fn rounded(x: Vec<f64>, step: f64) -> Vec<f64> {
    if step > 0.0 { x.iter().map(|x| (x / step).round() * step).collect() } else { x }
}

#[cfg(test)]
mod tests;
