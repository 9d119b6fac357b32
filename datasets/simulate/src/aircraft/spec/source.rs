//! What the spec says of the aircraft's own field at a magnetometer.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};
use schemas::{Fault, Literal, Rule, Value, params};

use super::Current;
use crate::reading::Section;

/// Something that the spec gives exactly, or of which it gives the size so that the seed decides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drawn<T> {
    /// As it is.
    Exact(T),
    /// Drawn with this size.
    Size(f64),
}

impl Drawn<Matrix3<f64>> {
    /// Whether it is zero whatever is drawn.
    pub(crate) fn is_none(&self) -> bool {
        match self {
            Drawn::Exact(matrix) => *matrix == Matrix3::zeros(),
            Drawn::Size(size) => *size == 0.0,
        }
    }
}

/// The magnetic field of the aircraft at one place in it, in the body frame (nose, right, down).
#[derive(Clone, Debug)]
pub struct Source {
    /// Where, in metres from the aircraft's reference point; without it no wire is felt.
    pub position_m: Option<Vector3<f64>>,
    /// The permanent field in nT. Keys `permanent = [x, y, z]`, or `permanent_nt`, its magnitude (0), the
    /// direction drawn.
    pub permanent: Drawn<Vector3<f64>>,
    /// The induced tensor in nT per nT of the earth's field. Keys `induced = [[..], [..], [..]]`, of any symmetry,
    /// or `induced_nt`, the standard deviation of a symmetric tensor's elements times 50,000 nT (0).
    pub induced: Drawn<Matrix3<f64>>,
    /// Whether a tensor that is drawn is symmetric.
    pub induced_symmetric: bool,
    /// The eddy matrix in seconds (nT per nT/s). Keys `eddy = [[..], [..], [..]]`, or `eddy_s`, the standard
    /// deviation of its elements (0).
    pub eddy: Drawn<Matrix3<f64>>,
    /// How much the permanent field of a flight differs: the standard deviation of each component in nT, drawn
    /// anew for each flight, as when the landing shakes it.
    pub shift_nt: f64,
    /// Random walk of each component of the permanent field from the flight's start on, in nT per root hour.
    pub walk_nt_per_sqrt_h: f64,
    /// What the bending of the wings adds, in nT per m/s² of vertical specific force beyond that of level flight.
    pub flex: Drawn<Vector3<f64>>,
    /// The specific force beyond which the wings bend no further, in m/s².
    pub flex_limit_mps2: f64,
    /// What the airframe's iron remembers, in nT: column j is the field that remains here when the earth's field along
    /// the body's axis j has gone through a loop between ±50,000 nT and is back at zero. Keys `hysteresis`, or
    /// `hysteresis_nt`, the standard deviation of its elements (0).
    pub hysteresis: Drawn<Matrix3<f64>>,
    /// Field of each current in nT/A: the table `currents`, whose keys are names of currents and whose values a
    /// vector, or a magnitude whose direction is drawn. What wires give is added.
    pub currents: Vec<(usize, Drawn<Vector3<f64>>)>,
}

/// The field of a current: its magnitude, or exactly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Amount {
    /// Its magnitude, the direction drawn.
    Size(f64),
    /// The vector.
    Exact([f64; 3]),
}

impl Value for Amount {
    const TYPE: &'static str = "number or list of three";

    fn read(literal: &Literal) -> Option<Amount> {
        f64::read(literal).map(Amount::Size).or_else(|| <[f64; 3]>::read(literal).map(Amount::Exact))
    }

    fn check(&self, rule: &Rule) -> Result<(), Fault> {
        match self {
            Amount::Size(size) => size.check(rule),
            Amount::Exact(vector) => vector.check(rule),
        }
    }

    fn canonical(&self) -> String {
        match self {
            Amount::Size(size) => size.canonical(),
            Amount::Exact(vector) => vector.canonical(),
        }
    }
}

params! {
    /// The magnetic field of the aircraft at a magnetometer, in the body frame (nose, right, down).
    pub struct SourceKeys;
    /// Where it is, from the aircraft's reference point.
    position_m: Option<[f64; 3]>, unit "m", absent "no wire is felt", rule Rule::Finite;
    /// The permanent field.
    permanent: Option<[f64; 3]>, unit "nT", absent "drawn with the magnitude `permanent_nt`", rule Rule::Finite;
    /// Magnitude of the permanent field, the direction drawn.
    permanent_nt: Option<f64>, unit "nT", absent "0", rule Rule::NotNegative;
    /// The induced tensor, of any symmetry, per nT of the earth's field.
    induced: Option<[[f64; 3]; 3]>, unit "1", absent "drawn with the size `induced_nt`", rule Rule::Finite;
    /// Standard deviation of the elements of an induced tensor that is drawn, times 50,000 nT.
    induced_nt: Option<f64>, unit "nT", absent "0", rule Rule::NotNegative;
    /// Whether a tensor that is drawn is symmetric.
    induced_symmetric: bool, unit "", default true;
    /// The eddy matrix (nT per nT/s).
    eddy: Option<[[f64; 3]; 3]>, unit "s", absent "drawn with the size `eddy_s`", rule Rule::Finite;
    /// Standard deviation of the elements of an eddy matrix that is drawn.
    eddy_s: Option<f64>, unit "s", absent "0", rule Rule::NotNegative;
    /// Standard deviation of each component by which the permanent field of a flight differs, drawn anew for each flight, as
    /// when the landing shakes it.
    permanent_shift_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Random walk of each component of the permanent field from the flight's start on, per root hour.
    permanent_walk_nt_per_sqrt_h: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// What the bending of the wings adds, per m/s² of vertical specific force beyond that of level flight.
    flex: Option<[f64; 3]>, unit "nT", absent "drawn with the magnitude `flex_nt_per_mps2`", rule Rule::Finite;
    /// The magnitude of that, the direction drawn.
    flex_nt_per_mps2: Option<f64>, unit "nT", absent "0", rule Rule::NotNegative;
    /// The specific force beyond which the wings bend no further.
    flex_limit_mps2: f64, unit "m/s2", default 20.0, rule Rule::Positive;
    /// Hysteresis of the airframe's iron: column j is the field that remains when the earth's field along the body's axis j
    /// has gone through a loop between ±50,000 nT and is back at zero, half the loop's width.
    hysteresis: Option<[[f64; 3]; 3]>, unit "nT", absent "drawn with the size `hysteresis_nt`", rule Rule::Finite;
    /// Standard deviation of the elements of that where it is drawn. Of iron in the earth's field it is up to 3 % of the
    /// induced field.
    hysteresis_nt: Option<f64>, unit "nT", absent "0", rule Rule::NotNegative;
    /// Field of each current for an ampere, by the names of currents: a vector, or a magnitude whose direction is drawn.
    /// What wires give is added.
    currents: Option<BTreeMap<String, Amount>>, unit "nT", absent "what wires give", rule Rule::Finite;
}

pub(super) fn source(s: &Section, keys: SourceKeys, currents: &[Current]) -> Source {
    let matrix = |m: [[f64; 3]; 3]| Matrix3::from_fn(|i, j| m[i][j]);
    Source {
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

fn either<T>(s: &Section, exactly: &str, exact: Option<T>, sized: &'static str, size: Option<f64>) -> Drawn<T> {
    match exact {
        Some(_) if size.is_some() => {
            s.fault_at(sized, format!("`{exactly}` says exactly what `{sized}` would draw: keep one"));
            Drawn::Size(0.0)
        }
        Some(exact) => Drawn::Exact(exact),
        None => Drawn::Size(size.unwrap_or(0.0)),
    }
}

/// The couplings that the table `key` gives by the names of currents.
pub(super) fn couplings(
    s: &Section,
    key: &'static str,
    given: BTreeMap<String, Amount>,
    currents: &[Current],
) -> Vec<(usize, Drawn<Vector3<f64>>)> {
    let mut coupled = vec![];
    for (name, amount) in given {
        let amount = match amount {
            Amount::Size(size) => Drawn::Size(size),
            Amount::Exact(v) => Drawn::Exact(Vector3::from(v)),
        };
        match index_of(currents, &name) {
            Ok(index) => coupled.push((index, amount)),
            Err(fault) => s.push(fault.at(s.key_at(key, &name))),
        }
    }
    coupled
}

/// Which of the currents is called `name`.
pub(super) fn index_of(currents: &[Current], name: &str) -> Result<usize, Fault> {
    let names: Vec<&str> = currents.iter().map(|c| c.name.as_str()).collect();
    let found = names.iter().position(|n| *n == name);
    found.ok_or_else(|| Fault::new(format!("there is no current `{name}`")).nearest(name, &names))
}
