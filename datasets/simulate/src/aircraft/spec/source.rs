//! What the spec says of the aircraft's own field at a magnetometer.

use nalgebra::{Matrix3, Vector3};
use schemas::Fault;

use super::{
    super::super::spec::section::{Amount, Need, Section},
    Current,
};

/// Something that the spec gives exactly, or of which it gives the size so that the seed decides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drawn<T> {
    /// As it is.
    Exact(T),
    /// Drawn with this size.
    Size(f64),
}

/// The magnetic field of the aircraft at one place in it, in the body frame (nose, right, down).
#[derive(Clone, Debug)]
pub struct Source {
    /// Where, in metres from the aircraft's reference point; without it no wire is felt.
    /// Key `position_m`, none.
    pub position_m: Option<Vector3<f64>>,
    /// The permanent field in nT. Keys `permanent = [x, y, z]`, or `permanent_nt`, its magnitude (0), the
    /// direction drawn.
    pub permanent: Drawn<Vector3<f64>>,
    /// The induced tensor in nT per nT of the earth's field. Keys `induced = [[..], [..], [..]]`, of any symmetry,
    /// or `induced_nt`, the standard deviation of a symmetric tensor's elements times 50,000 nT (0).
    pub induced: Drawn<Matrix3<f64>>,
    /// Whether a tensor that is drawn is symmetric. Key `induced_symmetric`, true.
    pub induced_symmetric: bool,
    /// The eddy matrix in seconds (nT per nT/s). Keys `eddy = [[..], [..], [..]]`, or `eddy_s`, the standard
    /// deviation of its elements (0).
    pub eddy: Drawn<Matrix3<f64>>,
    /// How much the permanent field of a flight differs: the standard deviation of each component in nT, drawn
    /// anew for each flight, as when the landing shakes it. Key `permanent_shift_nt`, 0.
    pub shift_nt: f64,
    /// Random walk of each component of the permanent field from the flight's start on, in nT per root hour.
    /// Key `permanent_walk_nt_per_sqrt_h`, 0.
    pub walk_nt_per_sqrt_h: f64,
    /// What the bending of the wings adds, in nT per m/s² of vertical specific force beyond that of level flight.
    /// Keys `flex = [x, y, z]`, or `flex_nt_per_mps2`, its magnitude (0), the direction drawn.
    pub flex: Drawn<Vector3<f64>>,
    /// The specific force beyond which the wings bend no further, in m/s². Key `flex_limit_mps2`, 20.
    pub flex_limit_mps2: f64,
    /// Field of each current in nT/A: the table `currents`, whose keys are names of currents and whose values a
    /// vector, or a magnitude whose direction is drawn. What wires give is added.
    pub currents: Vec<(usize, Drawn<Vector3<f64>>)>,
}

pub(super) fn source(s: &Section, currents: &[Current]) -> Source {
    let vector = |v: [f64; 3]| Vector3::from(v);
    let matrix = |m: [[f64; 3]; 3]| Matrix3::from_fn(|i, j| m[i][j]);
    Source {
        position_m: s.vector("position_m").map(vector),
        permanent: either(s, "permanent", s.vector("permanent").map(vector), "permanent_nt"),
        induced: either(s, "induced", s.matrix("induced").map(matrix), "induced_nt"),
        induced_symmetric: s.flag("induced_symmetric", true),
        eddy: either(s, "eddy", s.matrix("eddy").map(matrix), "eddy_s"),
        shift_nt: s.number("permanent_shift_nt", 0.0, Need::NotNegative),
        walk_nt_per_sqrt_h: s.number("permanent_walk_nt_per_sqrt_h", 0.0, Need::NotNegative),
        flex: either(s, "flex", s.vector("flex").map(vector), "flex_nt_per_mps2"),
        flex_limit_mps2: s.number("flex_limit_mps2", 20.0, Need::Positive),
        currents: couplings(s, currents),
    }
}

fn either<T>(s: &Section, exactly: &'static str, exact: Option<T>, sized: &'static str) -> Drawn<T> {
    let size = s.optional(sized, Need::NotNegative);
    match exact {
        Some(_) if size.is_some() => {
            s.fault_at(sized, format!("`{exactly}` says exactly what `{sized}` would draw: keep one"));
            Drawn::Size(0.0)
        }
        Some(exact) => Drawn::Exact(exact),
        None => Drawn::Size(size.unwrap_or(0.0)),
    }
}

fn couplings(s: &Section, currents: &[Current]) -> Vec<(usize, Drawn<Vector3<f64>>)> {
    let Some(table) = s.section("currents") else { return vec![] };
    let mut coupled = vec![];
    for (name, amount, at) in table.amounts() {
        let amount = match amount {
            Amount::Size(size) => Drawn::Size(size),
            Amount::Exact(v) => Drawn::Exact(Vector3::from(v)),
        };
        match index_of(currents, &name) {
            Ok(index) => coupled.push((index, amount)),
            Err(fault) => s.push(fault.at(at)),
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
