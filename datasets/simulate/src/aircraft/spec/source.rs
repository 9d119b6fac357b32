//! Keys of the aircraft field at a magnetometer in a synth spec.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};
use schemas::{Fault, Literal, ParamValue, Rule, params};

use super::Current;
use crate::reading::SynthSection;

/// Quantity with a given value, or with a size from which the value is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum QuantitySpec<T> {
    /// The exact value.
    Exact(T),
    /// The size of a drawn value.
    Size(f64),
}

impl QuantitySpec<Matrix3<f64>> {
    /// Whether the matrix is zero, given or drawn.
    pub(crate) fn is_none(&self) -> bool {
        match self {
            QuantitySpec::Exact(matrix) => *matrix == Matrix3::zeros(),
            QuantitySpec::Size(size) => *size == 0.0,
        }
    }
}

/// The magnetic field of the aircraft at one position in it, in the body frame (nose, right, down).
#[derive(Clone, Debug)]
pub struct AircraftFieldSpec {
    /// Position relative to the aircraft's reference point, in metres; without it wires have no effect.
    pub position_m: Option<Vector3<f64>>,
    /// The permanent field in nT. Keys `permanent = [x, y, z]`, or `permanent_nt`, its magnitude (0), with a drawn
    /// direction.
    pub permanent: QuantitySpec<Vector3<f64>>,
    /// The induced tensor in nT per nT of the earth's field. Keys: `induced = [[..], [..], [..]]`, which need not be
    /// symmetric; or `induced_nt` for a random symmetric tensor: the standard deviation of its elements, multiplied by
    /// 50,000 nT (default 0).
    pub induced: QuantitySpec<Matrix3<f64>>,
    /// Whether a drawn tensor is symmetric.
    pub induced_symmetric: bool,
    /// The eddy matrix in seconds (nT per nT/s). Keys `eddy = [[..], [..], [..]]`, or `eddy_s`, the standard
    /// deviation of its elements (0).
    pub eddy: QuantitySpec<Matrix3<f64>>,
    /// Standard deviation of the change of each component of the permanent field between flights, in nT, as caused by
    /// the shock of a landing.
    pub shift_nt: f64,
    /// Random walk of each component of the permanent field from the flight's start, in nT/√h.
    pub walk_nt_per_sqrt_h: f64,
    /// Field caused by wing bending, in nT per m/s² of vertical specific force in excess of level flight.
    pub flex: QuantitySpec<Vector3<f64>>,
    /// Excess specific force at which wing bending saturates, in m/s².
    pub flex_limit_mps2: f64,
    /// Remanence of the airframe's iron, in nT: column j is the field that remains after the earth's field along body
    /// axis j has been cycled between ±50,000 nT and returned to zero. Keys `hysteresis`, or `hysteresis_nt`, the
    /// standard deviation of its elements (0).
    pub hysteresis: QuantitySpec<Matrix3<f64>>,
    /// Field of each current in nT/A: the table `currents`, with names of currents as keys. A value is a vector, or a
    /// magnitude whose direction is drawn. The field of wires is added.
    pub currents: Vec<(usize, QuantitySpec<Vector3<f64>>)>,
}

/// The field of a current: a magnitude or a vector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CurrentFieldSpec {
    /// The magnitude; the direction is drawn.
    Size(f64),
    /// The vector.
    Exact([f64; 3]),
}

impl ParamValue for CurrentFieldSpec {
    const TYPE: &'static str = "number or list of three";

    fn read(literal: &Literal) -> Option<CurrentFieldSpec> {
        f64::read(literal)
            .map(CurrentFieldSpec::Size)
            .or_else(|| <[f64; 3]>::read(literal).map(CurrentFieldSpec::Exact))
    }

    fn check(&self, rule: &Rule) -> Result<(), Fault> {
        match self {
            CurrentFieldSpec::Size(size) => size.check(rule),
            CurrentFieldSpec::Exact(vector) => vector.check(rule),
        }
    }

    fn canonical(&self) -> String {
        match self {
            CurrentFieldSpec::Size(size) => size.canonical(),
            CurrentFieldSpec::Exact(vector) => vector.canonical(),
        }
    }
}

params! {
    /// The magnetic field of the aircraft at a magnetometer, in the body frame (nose, right, down).
    pub struct AircraftFieldKeys;
    /// Position relative to the aircraft's reference point.
    position_m: Option<[f64; 3]>, unit "m", absent "wires have no effect", rule Rule::Finite;
    /// Permanent field.
    permanent: Option<[f64; 3]>, unit "nT",
        absent "drawn at random with the magnitude `permanent_nt`", rule Rule::Finite;
    /// Magnitude of a permanent field whose direction is drawn.
    permanent_nt: Option<f64>, unit "nT", absent "0", rule Rule::NotNegative;
    /// Induced tensor, symmetric or not: induced field in nT per nT of the earth's field.
    induced: Option<[[f64; 3]; 3]>, unit "1", absent "drawn at random with the size `induced_nt`", rule Rule::Finite;
    /// Standard deviation of the elements of a drawn induced tensor, times 50,000 nT.
    induced_nt: Option<f64>, unit "nT", absent "0", rule Rule::NotNegative;
    /// Draws a symmetric induced tensor.
    induced_symmetric: bool, unit "", default true;
    /// Eddy matrix, in nT per nT/s.
    eddy: Option<[[f64; 3]; 3]>, unit "s", absent "drawn at random with the size `eddy_s`", rule Rule::Finite;
    /// Standard deviation of the elements of a drawn eddy matrix.
    eddy_s: Option<f64>, unit "s", absent "0", rule Rule::NotNegative;
    /// Standard deviation of the change in each component of the permanent field between flights, such as the shock of
    /// a landing causes. The change is drawn for each flight.
    permanent_shift_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Random walk of each component of the permanent field from the flight's start, in nT/√h.
    permanent_walk_nt_per_sqrt_h: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Field caused by wing bending, in nT per m/s² of vertical specific force in excess of level flight.
    flex: Option<[f64; 3]>, unit "nT",
        absent "drawn at random with the magnitude `flex_nt_per_mps2`", rule Rule::Finite;
    /// Magnitude of the field caused by wing bending, in nT per m/s². Its direction is drawn.
    flex_nt_per_mps2: Option<f64>, unit "nT", absent "0", rule Rule::NotNegative;
    /// Excess specific force at which wing bending saturates.
    flex_limit_mps2: f64, unit "m/s2", default 20.0, rule Rule::Positive;
    /// Remanence of the airframe's iron. Column j is the remaining field after the earth's field along body axis j has
    /// been cycled between ±50,000 nT and returned to zero. It is half the width of the hysteresis loop.
    hysteresis: Option<[[f64; 3]; 3]>, unit "nT",
        absent "drawn at random with the size `hysteresis_nt`", rule Rule::Finite;
    /// Standard deviation of the elements of a drawn matrix `hysteresis`. Iron in the earth's field retains up to 3 %
    /// of the induced field.
    hysteresis_nt: Option<f64>, unit "nT", absent "0", rule Rule::NotNegative;
    /// Field of each electric current per ampere. Keys are names of currents. A value is a vector, or a magnitude whose
    /// direction is drawn. The field of `wires` is added.
    currents: Option<BTreeMap<String, CurrentFieldSpec>>, unit "nT", absent "only the field of `wires`",
        rule Rule::Finite;
}

pub(super) fn source(s: &SynthSection, keys: AircraftFieldKeys, currents: &[Current]) -> AircraftFieldSpec {
    let matrix = |m: [[f64; 3]; 3]| Matrix3::from_fn(|i, j| m[i][j]);
    AircraftFieldSpec {
        position_m: keys.position_m.map(Vector3::from),
        permanent: either(s, "permanent", keys.permanent.map(Vector3::from), "permanent_nt", keys.permanent_nt),
        induced: either(s, "induced", keys.induced.map(matrix), "induced_nt", keys.induced_nt),
        induced_symmetric: keys.induced_symmetric,
        eddy: either(s, "eddy", keys.eddy.map(matrix), "eddy_s", keys.eddy_s),
        shift_nt: keys.permanent_shift_nt,
        walk_nt_per_sqrt_h: keys.permanent_walk_nt_per_sqrt_h,
        flex: either(s, "flex", keys.flex.map(Vector3::from), "flex_nt_per_mps2", keys.flex_nt_per_mps2),
        flex_limit_mps2: keys.flex_limit_mps2,
        hysteresis: either(s, "hysteresis", keys.hysteresis.map(matrix), "hysteresis_nt", keys.hysteresis_nt),
        currents: couplings(s, "currents", keys.currents.unwrap_or_default(), currents),
    }
}

fn either<T>(
    s: &SynthSection,
    exactly: &str,
    exact: Option<T>,
    sized: &'static str,
    size: Option<f64>,
) -> QuantitySpec<T> {
    match exact {
        Some(_) if size.is_some() => {
            s.fault_at(sized, format!("`{exactly}` cannot be combined with `{sized}`; remove one of them"));
            QuantitySpec::Size(0.0)
        }
        Some(exact) => QuantitySpec::Exact(exact),
        None => QuantitySpec::Size(size.unwrap_or(0.0)),
    }
}

/// The couplings in the table `key`, by the names of currents.
pub(super) fn couplings(
    s: &SynthSection,
    key: &'static str,
    given: BTreeMap<String, CurrentFieldSpec>,
    currents: &[Current],
) -> Vec<(usize, QuantitySpec<Vector3<f64>>)> {
    let mut coupled = vec![];
    for (name, amount) in given {
        let amount = match amount {
            CurrentFieldSpec::Size(size) => QuantitySpec::Size(size),
            CurrentFieldSpec::Exact(v) => QuantitySpec::Exact(Vector3::from(v)),
        };
        match index_of(currents, &name) {
            Ok(index) => coupled.push((index, amount)),
            Err(fault) => s.push(fault.at(s.key_at(key, &name))),
        }
    }
    coupled
}

/// The index of the current `name`.
pub(super) fn index_of(currents: &[Current], name: &str) -> Result<usize, Fault> {
    let names: Vec<&str> = currents.iter().map(|c| c.name.as_str()).collect();
    let found = names.iter().position(|n| *n == name);
    found.ok_or_else(|| Fault::new(format!("there is no current `{name}`")).nearest(name, &names))
}
