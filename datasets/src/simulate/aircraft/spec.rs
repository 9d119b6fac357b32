//! What the spec says of the aircraft: the currents on board, and its magnetometers.

use schemas::Fault;
use stages::numerics::gauss_markov::GaussMarkov;

use super::super::spec::{
    gauss_markov,
    section::{Need, Section},
    unique,
};

/// The aircraft.
#[derive(Clone, Debug)]
pub struct Aircraft {
    /// The currents on board.
    pub currents: Vec<Current>,
    /// The scalar magnetometers.
    pub scalars: Vec<Scalar>,
    /// The vector magnetometers.
    pub vectors: Vec<Vector>,
}

/// A current that is switched on and off at random, and its sensor.
#[derive(Clone, Debug)]
pub struct Current {
    /// The column, `cur_*`.
    pub name: String,
    /// Amperes while off, and while on.
    pub off_on_a: (f64, f64),
    /// Mean durations of off and on, in seconds; each is drawn from an exponential distribution.
    pub mean_off_on_s: (f64, f64),
    /// White noise of the sensor, in A.
    pub noise_a: f64,
}

/// The magnetic field of the aircraft at one place in it.
#[derive(Clone, Debug)]
pub struct Source {
    /// Magnitude of the permanent field, in nT.
    pub permanent_nt: f64,
    /// Standard deviation of the induced tensor's elements times 50,000 nT, in nT.
    pub induced_nt: f64,
    /// Standard deviation of the eddy matrix' elements, in seconds (nT per nT/s).
    pub eddy_s: f64,
    /// Field of each current in nT/A, its direction drawn.
    pub currents: Vec<(usize, f64)>,
}

/// A scalar magnetometer.
#[derive(Clone, Debug)]
pub struct Scalar {
    /// The column, `mag_N_uc` or `mag_1_c`.
    pub name: String,
    /// The aircraft's field there.
    pub source: Source,
    /// White noise, in nT.
    pub noise_nt: f64,
    /// Its own slow drift.
    pub drift: Option<GaussMarkov>,
}

/// A vector magnetometer, aligned with the body.
#[derive(Clone, Debug)]
pub struct Vector {
    /// The columns without `_x`, `_y`, `_z`.
    pub name: String,
    /// The aircraft's field there.
    pub source: Source,
    /// White noise of each axis, in nT.
    pub noise_nt: f64,
    /// Standard deviation of each axis' offset, in nT.
    pub offset_nt: f64,
    /// Standard deviation of each axis' relative scale error.
    pub scale: f64,
}

/// Reads the aircraft's tables.
pub(in super::super) fn aircraft(root: &Section) -> Aircraft {
    let currents: Vec<Current> = root.sections("currents").iter().map(current).collect();
    let scalars: Vec<_> = root.sections("magnetometers").iter().map(|s| scalar(s, &currents)).collect();
    let vectors: Vec<_> = root.sections("vector_magnetometers").iter().map(|s| vector(s, &currents)).collect();
    unique(root, "current", currents.iter().map(|c| c.name.clone()));
    unique(root, "magnetometer", scalars.iter().map(|c| c.name.clone()));
    unique(root, "vector magnetometer", vectors.iter().map(|c| c.name.clone()));
    Aircraft { currents, scalars, vectors }
}

fn current(s: &Section) -> Current {
    let name = s.text("name");
    if !name.is_empty() && !name.starts_with("cur_") {
        s.fault_at("name", format!("a current is called `cur_...`, not `{name}`"));
    }
    let current = Current {
        name,
        off_on_a: (s.number("off_a", 0.0, Need::Any), s.needed("on_a", Need::Any)),
        mean_off_on_s: (s.number("mean_off_s", 20.0, Need::Positive), s.number("mean_on_s", 20.0, Need::Positive)),
        noise_a: s.number("noise_a", 0.0, Need::NotNegative),
    };
    s.finish();
    current
}

fn source(s: &Section, currents: &[Current]) -> Source {
    let names: Vec<&str> = currents.iter().map(|c| c.name.as_str()).collect();
    let mut coupled = vec![];
    for (name, nt_per_a, at) in s.section("currents").map(|c| c.entries()).unwrap_or_default() {
        match names.iter().position(|n| *n == name) {
            Some(i) => coupled.push((i, nt_per_a)),
            None => s.push(Fault::new(format!("there is no current `{name}`")).at(at).nearest(&name, &names)),
        }
    }
    Source {
        permanent_nt: s.number("permanent_nt", 0.0, Need::NotNegative),
        induced_nt: s.number("induced_nt", 0.0, Need::NotNegative),
        eddy_s: s.number("eddy_s", 0.0, Need::NotNegative),
        currents: coupled,
    }
}

fn scalar(s: &Section, currents: &[Current]) -> Scalar {
    let name = s.text("name");
    let known = schemas::flight::describe(&name);
    if !name.is_empty() && (known.unit != "nT" || !name.starts_with("mag_")) {
        s.fault_at("name", format!("a scalar magnetometer is called `mag_N_uc` or `mag_1_c`, not `{name}`"));
    }
    let sensor = Scalar {
        name,
        source: source(s, currents),
        noise_nt: s.number("noise_nt", 0.0, Need::NotNegative),
        drift: s.section("drift").and_then(|d| gauss_markov(&d, "sigma_nt", "tau_s", 600.0)),
    };
    s.finish();
    sensor
}

fn vector(s: &Section, currents: &[Current]) -> Vector {
    let name = s.text("name");
    if !name.is_empty() && name.strip_prefix("flux_").is_none_or(str::is_empty) {
        s.fault_at("name", format!("a vector magnetometer is called `flux_X`, not `{name}`"));
    }
    let sensor = Vector {
        name,
        source: source(s, currents),
        noise_nt: s.number("noise_nt", 0.0, Need::NotNegative),
        offset_nt: s.number("offset_nt", 0.0, Need::NotNegative),
        scale: s.number("scale", 0.0, Need::Between(0.0, 0.5)),
    };
    s.finish();
    sensor
}
