//! The synth spec: what is simulated.

use std::path::Path;

use datasets::ReadError;
use numerics::{earth::dates, signal::gauss_markov::GaussMarkov};
use schemas::Fault;
use toml::de::DeTable;

use super::{
    aircraft::{self, Aircraft},
    earth::{self, Earth},
    ins::{self, spec::Ins},
    trajectory::{self, Air, Flight},
};
pub use components::{COMPONENTS, Components};
pub use preset::PRESETS;
use section::{Faults, Need, Section};

mod components;
mod preset;
pub(super) mod section;

/// A synth spec, checked.
#[derive(Clone, Debug)]
pub struct Spec {
    /// Where every random draw begins.
    pub seed: u64,
    /// Calendar year and day of the year, UTC.
    pub date: (i32, u32),
    /// Samples a second.
    pub rate_hz: f64,
    /// What is switched off.
    pub components: Components,
    /// Standard deviation of the attitude's small motions in roll, pitch and yaw, in degrees.
    pub gusts_deg: [f64; 3],
    /// Wind, turbulence and what the aircraft can.
    pub air: Air,
    /// The INS.
    pub ins: Ins,
    /// The earth's field.
    pub earth: Earth,
    /// The aircraft and its sensors.
    pub aircraft: Aircraft,
    /// The flights.
    pub flights: Vec<Flight>,
}

impl Spec {
    /// Reads a spec.
    ///
    /// # Errors
    /// All that is wrong with it at once, each fault with file, line and column.
    pub fn read(path: &Path) -> Result<Spec, ReadError> {
        let text = std::fs::read_to_string(path).map_err(|e| ReadError::io(path, &e))?;
        let root = DeTable::parse(&text).map_err(|e| {
            let fault = Fault::new(e.message()).at(e.span().unwrap_or(0..0));
            ReadError::spec(path, &text, &[fault])
        })?;
        let faults = Faults::default();
        let root = preset::applied(root.into_inner(), &faults);
        let section = Section::new("synth", &root, 0..0, &faults);
        let spec = spec(&section, path.parent().unwrap_or(Path::new("")));
        section.finish();
        let found = std::mem::take(&mut *faults.borrow_mut());
        if found.is_empty() { Ok(spec) } else { Err(ReadError::spec(path, &text, &found)) }
    }
}

fn spec(root: &Section, folder: &Path) -> Spec {
    let components = Components::read(root);
    let air = trajectory::air::air(root);
    Spec {
        seed: root.whole("seed", 0, 0, i64::MAX) as u64,
        date: date(root),
        rate_hz: root.number("rate_hz", 10.0, Need::Between(0.1, 1000.0)),
        gusts_deg: root.numbers("gusts_deg", [0.0; 3], Need::Between(0.0, 20.0)),
        air,
        ins: ins::spec::ins(root),
        earth: earth::spec::earth(root, folder, &components),
        aircraft: aircraft::spec::aircraft(root),
        flights: trajectory::spec::flights(root, &air),
        components,
    }
}

/// Notes two things of one name.
pub(super) fn unique(root: &Section, kind: &str, names: impl Iterator<Item = String>) {
    let names: Vec<String> = names.collect();
    for (i, name) in names.iter().enumerate() {
        if names.iter().take(i).any(|n| n == name) {
            root.fault(format!("there are two of the {kind} `{name}`"));
        }
    }
}

fn date(root: &Section) -> (i32, u32) {
    let year = root.whole("year", 2020, 1900, 2030) as i32;
    let doy = root.whole("doy", 1, 1, i64::from(dates::days_in_year(year))) as u32;
    (year, doy)
}

/// Reads a Gauss-Markov process: its standard deviation under the key `sigma`, its correlation time under `tau`.
pub(super) fn gauss_markov(s: &Section, sigma: &'static str, tau: &'static str, tau_s: f64) -> Option<GaussMarkov> {
    let process =
        GaussMarkov { sigma: s.needed(sigma, Need::NotNegative), tau_s: s.number(tau, tau_s, Need::Positive) };
    s.finish();
    (process.sigma > 0.0).then_some(process)
}
