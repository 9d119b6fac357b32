//! The readings of the magnetometers.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};

use super::{
    super::{random::RandomStream, scene::SynthLineContext},
    currents::switched,
    field::{FIELD_PARTS, SCALE_NT, vector},
    response::{RayleighHysteresis, first_order},
    sampling::SensorClock,
    spec::{ScalarMagnetometer, SensorSampling, Temperature, VectorMagnetometer},
};

/// The components that a scalar magnetometer adds, in order.
pub(super) const SCALAR_PARTS: [&str; 6] = ["heading", "lag", "drift", "spikes", "noise", "quantisation"];

/// The components that a vector magnetometer adds, in order.
pub(super) const VECTOR_PARTS: [&str; 13] = [
    "calibration",
    "linearity",
    "core_hysteresis",
    "offset",
    "temperature",
    "temperature_scale",
    "crosstalk",
    "bandwidth",
    "axis_lag",
    "lag",
    "drift",
    "noise",
    "quantisation",
];

/// The components of the field at a sensor, sample by sample.
pub(super) type SensorFieldParts = [Vector3<f64>; FIELD_PARTS.len()];

/// Values of a magnetometer column in nT, and their components if requested.
#[derive(Default)]
pub(super) struct MagnetometerColumn {
    pub(super) values_nt: Vec<f64>,
    pub(super) parts_nt: Vec<Vec<f64>>,
}

impl MagnetometerColumn {
    /// Adds a component to the values.
    fn add(&mut self, wanted: bool, part_nt: Vec<f64>) {
        self.values_nt.iter_mut().zip(&part_nt).for_each(|(x, p)| *x += p);
        if wanted {
            self.parts_nt.push(part_nt);
        }
    }

    /// Replaces the values; the change is recorded as a component.
    fn replace(&mut self, wanted: bool, values_nt: Vec<f64>) {
        if wanted {
            self.parts_nt.push(values_nt.iter().zip(&self.values_nt).map(|(new, old)| new - old).collect());
        }
        self.values_nt = values_nt;
    }

    fn quantise(&mut self, wanted: bool, step_nt: f64) {
        let rounded = |x: &f64| if step_nt > 0.0 { (x / step_nt).round() * step_nt } else { *x };
        self.replace(wanted, self.values_nt.iter().map(rounded).collect());
    }
}

/// Simulation of the magnetometers on a line: its times, true currents and random numbers.
pub(super) struct MagnetometerSimulation<'a> {
    pub(super) scene: &'a SynthLineContext<'a>,
    pub(super) tt_s: &'a [f64],
    /// Seconds after the flight's start.
    pub(super) since_s: &'a [f64],
    /// True currents in A: one column each.
    pub(super) amperes: &'a [Vec<f64>],
    /// Whether the components are requested.
    pub(super) wanted: bool,
}

impl MagnetometerSimulation<'_> {
    fn on(&self, component: &str) -> bool {
        self.scene.spec.components.on(component)
    }

    fn random(&self, what: &str, name: &str) -> RandomStream {
        self.scene.random(&format!("{what} of {name}"))
    }

    fn clock(&self, sampling: &SensorSampling) -> SensorClock {
        SensorClock::new(sampling, self.tt_s.len(), self.scene.spec.rate_hz, self.on("lag"))
    }

    fn late(&self, reading: &mut MagnetometerColumn, clock: &SensorClock) {
        let read = if clock.is_the_tables() { reading.values_nt.clone() } else { clock.read(&reading.values_nt) };
        reading.replace(self.wanted, read);
    }

    fn noise(&self, reading: &mut MagnetometerColumn, clock: &SensorClock, sigma_nt: f64, random: &mut RandomStream) {
        let sigma_nt = if self.on("noise") { sigma_nt } else { 0.0 };
        reading.add(self.wanted, clock.spread(|_| sigma_nt * random.normal()));
    }

    fn drift(
        &self,
        reading: &mut MagnetometerColumn,
        drift: Option<numerics::signal::gauss_markov::GaussMarkov>,
        name: &str,
    ) {
        let mut random = self.random("drift", name);
        let drift = drift.filter(|_| self.on("drift")).map(|d| d.realisation(self.tt_s, || random.normal()));
        reading.add(self.wanted, drift.unwrap_or_else(|| vec![0.0; self.tt_s.len()]));
    }

    /// The readings of a scalar magnetometer, in nT: the magnitude of the vector sum plus the sensor's errors. Each
    /// component of the field is the increment of the magnitude when that component is added, in order.
    pub(super) fn scalar(
        &self,
        sensor: &ScalarMagnetometer,
        field: impl Iterator<Item = SensorFieldParts>,
    ) -> MagnetometerColumn {
        let mut reading = MagnetometerColumn::default();
        if self.wanted {
            reading.parts_nt = vec![vec![]; FIELD_PARTS.len()];
        }
        let (mut heading, mut dead) = (vec![], vec![]);
        let amplitude_nt = if self.on("heading") { sensor.heading.amplitude_nt } else { 0.0 };
        for parts in field {
            let (mut sum, mut before_nt) = (Vector3::zeros(), 0.0);
            for (k, part) in parts.iter().enumerate() {
                sum += part;
                if self.wanted {
                    let magnitude_nt = sum.norm();
                    reading.parts_nt[k].push(magnitude_nt - before_nt);
                    before_nt = magnitude_nt;
                }
            }
            let exact_nt = sum.norm();
            let cosine = if exact_nt > 0.0 { sum.dot(&sensor.heading.axis) / exact_nt } else { 0.0 };
            reading.values_nt.push(exact_nt);
            heading.push(amplitude_nt * cosine);
            dead.push(is_dead(sensor, cosine));
        }
        reading.add(self.wanted, heading);
        let clock = self.clock(&sensor.sampling);
        self.late(&mut reading, &clock);
        self.drift(&mut reading, sensor.drift, &sensor.name);
        reading.add(self.wanted, self.spikes(sensor));
        self.noise(&mut reading, &clock, sensor.noise_nt, &mut self.scene.random(&sensor.name));
        reading.quantise(self.wanted, if self.on("quantisation") { sensor.resolution_nt } else { 0.0 });
        self.lose(sensor, &mut reading.values_nt, &dead);
        reading
    }

    fn spikes(&self, sensor: &ScalarMagnetometer) -> Vec<f64> {
        let Some((mean_s, sigma_nt)) = sensor.spikes.filter(|_| self.on("spikes")) else {
            return vec![0.0; self.tt_s.len()];
        };
        let share = 1.0 / (mean_s * self.scene.spec.rate_hz);
        let mut random = self.random("spikes", &sensor.name);
        let spike = |_| if random.uniform() < share { sigma_nt * random.normal() } else { 0.0 };
        self.tt_s.iter().map(spike).collect()
    }

    /// Removes the readings in a dead zone or a dropout.
    fn lose(&self, sensor: &ScalarMagnetometer, values_nt: &mut [f64], dead: &[bool]) {
        let lost_nt = if sensor.lost_is_zero { 0.0 } else { f64::NAN };
        let zones = self.on("dead_zones");
        let bursts = sensor.dropouts.filter(|_| self.on("dropouts")).map_or_else(Vec::new, |means| {
            let (first, last) = (self.since_s.first(), self.since_s.last());
            let mut random = self.random("dropouts", &sensor.name);
            switched(means, first.copied().unwrap_or(0.0), last.copied().unwrap_or(0.0), &mut random)
        });
        let mut next = bursts.iter().peekable();
        for (i, value) in values_nt.iter_mut().enumerate() {
            let since_s = self.since_s[i];
            while next.next_if(|[_, until]| *until <= since_s).is_some() {}
            let dropped = next.peek().is_some_and(|[from, _]| *from <= since_s);
            if dropped || (zones && dead[i]) {
                *value = lost_nt;
            }
        }
    }

    /// The readings of the three axes of a vector magnetometer, in nT.
    pub(super) fn vector(
        &self,
        sensor: &VectorMagnetometer,
        temperature: &Temperature,
        field: impl Iterator<Item = SensorFieldParts>,
    ) -> [MagnetometerColumn; 3] {
        let made = VectorMagnetometerErrors::draw(self.scene.spec.seed, sensor);
        let (calibrated, moved) = (self.on("calibration"), self.on("offset"));
        let mut axes: [MagnetometerColumn; 3] = Default::default();
        let mut calibration: [Vec<f64>; 3] = Default::default();
        for axis in &mut axes {
            axis.parts_nt = if self.wanted { vec![vec![]; FIELD_PARTS.len()] } else { vec![] };
        }
        for parts in field {
            let sum: Vector3<f64> = parts.iter().sum();
            let off = if calibrated { made.skew * sum } else { Vector3::zeros() };
            for (axis, reading) in axes.iter_mut().enumerate() {
                reading.values_nt.push(sum[axis]);
                calibration[axis].push(off[axis]);
                for (column, part) in reading.parts_nt.iter_mut().zip(&parts) {
                    column.push(part[axis]);
                }
            }
        }
        let warmth = self.warmth(sensor, temperature);
        let crosstalk = self.crosstalk(sensor);
        let rate_hz = self.scene.spec.rate_hz;
        let clock = self.clock(&sensor.sampling);
        let mut random = self.scene.random(&sensor.name);
        for (axis, reading) in axes.iter_mut().enumerate() {
            let name = format!("{}_{}", sensor.name, ["x", "y", "z"][axis]);
            reading.add(self.wanted, std::mem::take(&mut calibration[axis]));
            self.linearity(reading, made.linearity[axis], sensor.full_scale_nt);
            self.core_hysteresis(reading, sensor.core_hysteresis_nt);
            // The reading without the effect of the temperature on the scale.
            let felt_nt = reading.values_nt.clone();
            reading.add(self.wanted, vec![if moved { made.offset_nt[axis] } else { 0.0 }; self.tt_s.len()]);
            let per_degc = if self.on("temperature") { made.nt_per_degc[axis] } else { 0.0 };
            reading.add(self.wanted, warmth.iter().map(|degc| per_degc * degc).collect());
            let per_degc = if self.on("temperature_scale") { made.scale_per_degc[axis] } else { 0.0 };
            reading.add(self.wanted, felt_nt.iter().zip(&warmth).map(|(x, degc)| x * per_degc * degc).collect());
            reading.add(self.wanted, crosstalk.iter().map(|added_nt| added_nt[axis]).collect());
            let tau_s = sensor.bandwidth_hz.filter(|_| self.on("bandwidth")).map_or(0.0, |hz| 1.0 / (TAU * hz));
            reading.replace(self.wanted, first_order(&reading.values_nt, rate_hz, tau_s));
            let axis_lag = SensorSampling { rate_hz: None, lag_s: sensor.axis_lag_s[axis], hold: false };
            let turn = SensorClock::new(&axis_lag, self.tt_s.len(), rate_hz, self.on("axis_lag"));
            self.late(reading, &turn);
            self.late(reading, &clock);
            self.drift(reading, sensor.drift, &name);
            self.noise(reading, &clock, sensor.noise_nt, &mut random);
            reading.quantise(self.wanted, if self.on("quantisation") { sensor.resolution_nt } else { 0.0 });
        }
        axes
    }

    /// Temperature of the sensor above the reference temperature, in degrees.
    fn warmth(&self, sensor: &VectorMagnetometer, temperature: &Temperature) -> Vec<f64> {
        let tau_s = if self.on("thermal_lag") { sensor.thermal_tau_s } else { 0.0 };
        self.since_s.iter().map(|t| temperature.followed_at(*t, tau_s) - temperature.reference_degc).collect()
    }

    /// The coupling of currents into the readings, in nT.
    fn crosstalk(&self, sensor: &VectorMagnetometer) -> Vec<Vector3<f64>> {
        let mut added_nt = vec![Vector3::zeros(); self.tt_s.len()];
        let wanted = if self.on("crosstalk") { sensor.crosstalk.as_slice() } else { &[] };
        for (index, amount) in wanted {
            let current = self.scene.spec.aircraft.currents.get(*index).map_or("", |c| c.name.as_str());
            let names = ["aircraft", &sensor.name, current, "crosstalk"];
            let nt_per_a = vector(*amount, &mut RandomStream::new(self.scene.spec.seed, &names));
            let amperes = self.amperes.get(*index).into_iter().flatten();
            added_nt.iter_mut().zip(amperes).for_each(|(sum, a)| *sum += nt_per_a * *a);
        }
        added_nt
    }

    /// The nonlinearity: the third Chebyshev polynomial, with the maximum `linearity` within the full scale.
    fn linearity(&self, reading: &mut MagnetometerColumn, linearity: f64, full_scale_nt: f64) {
        let size_nt = if self.on("linearity") { linearity * full_scale_nt } else { 0.0 };
        let off = |x: &f64| {
            let u = x / full_scale_nt;
            size_nt * (4.0 * u.powi(3) - 3.0 * u)
        };
        reading.add(self.wanted, reading.values_nt.iter().map(off).collect());
    }

    /// The hysteresis of the core. Before the line begins, the core has passed through the loop between plus and minus
    /// its first reading.
    fn core_hysteresis(&self, reading: &mut MagnetometerColumn, remanent_nt: f64) {
        let part = if remanent_nt == 0.0 || !self.on("core_hysteresis") {
            vec![0.0; self.tt_s.len()]
        } else {
            let mut core = RayleighHysteresis::demagnetised(SCALE_NT);
            let first_nt = reading.values_nt.first().copied().unwrap_or(0.0);
            core.follow(-first_nt);
            reading.values_nt.iter().map(|x| remanent_nt * core.follow(*x)).collect()
        };
        reading.add(self.wanted, part);
    }
}

/// Whether the field is in a dead zone of the sensor; `cosine` is the cosine of the angle between the field and the
/// optical axis.
fn is_dead(sensor: &ScalarMagnetometer, cosine: f64) -> bool {
    let from_axis_deg = cosine.abs().min(1.0).acos().to_degrees();
    from_axis_deg < sensor.dead_polar_deg || 90.0 - from_axis_deg < sensor.dead_equatorial_deg
}

/// Manufacturing errors of a vector magnetometer, the same on all flights.
struct VectorMagnetometerErrors {
    /// Matrix of the scale errors, the non-orthogonality and the misalignment.
    skew: Matrix3<f64>,
    offset_nt: Vector3<f64>,
    nt_per_degc: Vector3<f64>,
    /// Change of the scale, per degree.
    scale_per_degc: Vector3<f64>,
    /// Maximum deviation from the best straight line, as a fraction of the full scale.
    linearity: Vector3<f64>,
}

impl VectorMagnetometerErrors {
    /// Draws the errors, which are the same on all flights. The rows of the matrix are the axes: x is unchanged, y is
    /// rotated in the xy plane, z is rotated by two angles. All rows are then rotated and scaled.
    fn draw(seed: u64, sensor: &VectorMagnetometer) -> VectorMagnetometerErrors {
        let mut random = RandomStream::new(seed, &["calibration", &sensor.name]);
        let mut three = |size: f64| Vector3::from_fn(|_, _| size * random.normal());
        let scale = Matrix3::from_diagonal(&three(sensor.scale).add_scalar(1.0));
        let offset_nt = three(sensor.offset_nt);
        let square = three(sensor.non_orthogonal_deg.to_radians());
        let turn = three(sensor.misaligned_deg.to_radians());
        let nt_per_degc = three(sensor.temperature_nt_per_degc);
        let (sy, sz) = (square.x.sin(), [square.y.sin(), square.z.sin()]);
        let axes = Matrix3::new(
            1.0,
            0.0,
            0.0,
            sy,
            (1.0 - sy * sy).sqrt(),
            0.0,
            sz[0],
            sz[1],
            (1.0 - sz[0] * sz[0] - sz[1] * sz[1]).max(0.0).sqrt(),
        );
        let turned = *nalgebra::Rotation3::new(turn).matrix();
        let another = |what: &str, ppm: f64| {
            let mut random = RandomStream::new(seed, &["calibration", &sensor.name, what]);
            Vector3::from_fn(|_, _| 1e-6 * ppm * random.normal())
        };
        VectorMagnetometerErrors {
            skew: scale * axes * turned - Matrix3::identity(),
            offset_nt,
            nt_per_degc,
            scale_per_degc: another("temperature_scale", sensor.temperature_scale_ppm_per_degc),
            linearity: another("linearity", sensor.linearity_ppm),
        }
    }
}
