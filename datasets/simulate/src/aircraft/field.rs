//! The aircraft's field at one magnetometer, by component.

use nalgebra::{Matrix3, Vector3};

use super::{
    super::random::RandomStream,
    feeds::EffectiveCurrents,
    spec::{Aircraft, AircraftFieldSpec, QuantitySpec},
};
use crate::reading::ComponentSwitches;

/// Field strength to which the sizes of induced terms and hysteresis refer, in nT.
pub(super) const SCALE_NT: f64 = 50_000.0;

/// Step of the random walk of the permanent field, in seconds. The walk is linear between steps.
const WALK_STEP_S: f64 = 10.0;

/// The components of the field at a magnetometer, in the order in which they are added.
pub(super) const FIELD_PARTS: [&str; 11] =
    ["core", "anomaly", "diurnal", "permanent", "induced", "eddy", "currents", "landing", "walk", "flex", "hysteresis"];

/// The sources of the aircraft's field at one magnetometer in one flight, in the body frame: P + M B + E dB/dt + the
/// sum of I_k D_k, plus the shift of P at a landing, the random walk of P, wing bending, and the remanence of the
/// airframe's iron. [Tolles & Lawson 1950; Gnadt 2022, (3.9)-(3.12)]
pub(super) struct AircraftField {
    permanent_nt: Vector3<f64>,
    induced: Matrix3<f64>,
    eddy_s: Matrix3<f64>,
    /// Fields of the currents, by the column of the effective current.
    currents_nt_per_a: Vec<(usize, Vector3<f64>)>,
    landing_nt: Vector3<f64>,
    flex_nt_per_mps2: Vector3<f64>,
    flex_limit_mps2: f64,
    hysteresis_nt: Matrix3<f64>,
    /// Values of the random walk at multiples of the time step after the start of the flight.
    walk_nt: Vec<Vector3<f64>>,
}

/// The inputs of the aircraft's field at one moment.
pub(super) struct AircraftFieldInput<'a> {
    /// The earth's field, in nT.
    pub(super) earth_nt: Vector3<f64>,
    /// Rate of the earth's field, in nT/s.
    pub(super) rate_ntps: Vector3<f64>,
    /// Effective currents along the line, in A: [`super::feeds::EffectiveCurrents`].
    pub(super) feeds_a: &'a [Vec<f64>],
    /// The sample.
    pub(super) row: usize,
    /// Seconds after the flight's start.
    pub(super) since_s: f64,
    /// Upward specific force in excess of level flight, in m/s².
    pub(super) lift_mps2: f64,
    /// The irreversible magnetisation of the airframe's iron along each axis, as a fraction of the reference loop's.
    pub(super) iron: Vector3<f64>,
}

impl AircraftField {
    /// Draws the quantities of the sensor `name` that the spec does not fix. The quantities are the same on all
    /// flights, except for the shift at a landing and the random walk. The walk is drawn up to `until_s` after the
    /// flight's start. Components that are switched off are zero.
    pub(super) fn draw(
        seed: u64,
        (flight, until_s): (&str, f64),
        (name, source): (&str, &AircraftFieldSpec),
        (aircraft, feeds): (&Aircraft, &EffectiveCurrents),
        components: &ComponentSwitches,
    ) -> AircraftField {
        let on = |component: &str| if components.on(component) { 1.0 } else { 0.0 };
        let mut random = RandomStream::new(seed, &["aircraft", name]);
        let permanent_nt = vector(source.permanent, &mut random);
        let m = Matrix3::from_fn(|_, _| random.normal());
        let induced = match source.induced {
            QuantitySpec::Exact(tensor) => tensor,
            // The tensor is symmetric, as for isotropic iron. The standard deviation of each element is the same as
            // without symmetry.
            QuantitySpec::Size(nt) if source.induced_symmetric => {
                Matrix3::from_fn(|i, j| m[(i.min(j), i.max(j))]) * (nt / SCALE_NT)
            }
            QuantitySpec::Size(nt) => m * (nt / SCALE_NT),
        };
        let e = Matrix3::from_fn(|_, _| random.normal());
        let eddy_s = match source.eddy {
            QuantitySpec::Exact(matrix) => matrix,
            QuantitySpec::Size(s) => e * s,
        };
        let flex_nt_per_mps2 = vector(source.flex, &mut RandomStream::new(seed, &["aircraft", name, "flex"]));
        let hysteresis = match source.hysteresis {
            QuantitySpec::Exact(matrix) => matrix,
            QuantitySpec::Size(nt) => {
                let mut random = RandomStream::new(seed, &["aircraft", name, "hysteresis"]);
                Matrix3::from_fn(|_, _| nt * random.normal())
            }
        };
        let landing = RandomStream::new(seed, &["flight", flight, "landing", name]);
        AircraftField {
            permanent_nt: permanent_nt * on("permanent"),
            induced: induced * on("induced"),
            eddy_s: eddy_s * on("eddy"),
            currents_nt_per_a: couplings(seed, name, source, (aircraft, feeds), on("currents")),
            landing_nt: normals(landing) * (source.shift_nt * on("landing")),
            flex_nt_per_mps2: flex_nt_per_mps2 * on("flex"),
            flex_limit_mps2: source.flex_limit_mps2,
            hysteresis_nt: hysteresis * on("hysteresis"),
            walk_nt: walk(
                source.walk_nt_per_sqrt_h * on("walk"),
                until_s,
                RandomStream::new(seed, &["flight", flight, "walk", name]),
            ),
        }
    }

    /// The aircraft's components in nT, in the order of [`FIELD_PARTS`] from the permanent field on.
    pub(super) fn parts_nt(&self, drive: &AircraftFieldInput) -> [Vector3<f64>; 8] {
        let amperes = |k: usize| drive.feeds_a.get(k).and_then(|c| c.get(drive.row)).copied().unwrap_or(0.0);
        let lift = drive.lift_mps2.clamp(-self.flex_limit_mps2, self.flex_limit_mps2);
        [
            self.permanent_nt,
            self.induced * drive.earth_nt,
            self.eddy_s * drive.rate_ntps,
            self.currents_nt_per_a.iter().map(|(k, d)| d * amperes(*k)).sum(),
            self.landing_nt,
            self.walk_at(drive.since_s),
            self.flex_nt_per_mps2 * lift,
            self.hysteresis_nt * drive.iron,
        ]
    }

    fn walk_at(&self, since_s: f64) -> Vector3<f64> {
        let place = (since_s / WALK_STEP_S).max(0.0);
        let (k, share) = (place.floor() as usize, place.fract());
        match (self.walk_nt.get(k), self.walk_nt.get(k + 1)) {
            (Some(a), Some(b)) => a + (b - a) * share,
            (Some(a), None) => *a,
            _ => Vector3::zeros(),
        }
    }
}

pub(super) fn vector(drawn: QuantitySpec<Vector3<f64>>, random: &mut RandomStream) -> Vector3<f64> {
    let direction = random.direction();
    match drawn {
        QuantitySpec::Exact(v) => v,
        QuantitySpec::Size(size) => direction * size,
    }
}

fn normals(mut random: RandomStream) -> Vector3<f64> {
    Vector3::from_fn(|_, _| random.normal())
}

fn couplings(
    seed: u64,
    name: &str,
    source: &AircraftFieldSpec,
    (aircraft, feeds): (&Aircraft, &EffectiveCurrents),
    on: f64,
) -> Vec<(usize, Vector3<f64>)> {
    let given = source.currents.iter().map(|(index, amount)| {
        let current = aircraft.currents.get(*index).map_or("", |c| c.name.as_str());
        (*index, vector(*amount, &mut RandomStream::new(seed, &["aircraft", name, current])) * on)
    });
    let wires = || aircraft.wires.iter().zip(&feeds.of_wires);
    let at = |at_m: Vector3<f64>| wires().map(move |(w, feed)| (*feed, w.nt_per_a(&at_m) * on));
    given.chain(source.position_m.into_iter().flat_map(at)).collect()
}

fn walk(nt_per_sqrt_h: f64, until_s: f64, mut random: RandomStream) -> Vec<Vector3<f64>> {
    if nt_per_sqrt_h == 0.0 {
        return vec![];
    }
    let step_nt = nt_per_sqrt_h * (WALK_STEP_S / 3600.0).sqrt();
    let steps = (until_s / WALK_STEP_S).ceil().max(0.0) as usize + 1;
    let mut out = vec![Vector3::zeros()];
    for k in 0..steps {
        out.push(out[k] + Vector3::from_fn(|_, _| random.normal()) * step_nt);
    }
    out
}
