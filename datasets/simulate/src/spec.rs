//! The synth spec, checked.

use std::path::Path;

use datasets::ReadError;
use numerics::earth::dates;
use schemas::{Fault, Rule, params};
use toml::de::DeTable;

use crate::{
    aircraft::spec::{self as aircraft, Aircraft},
    earth::spec::{self as earth, SynthEarth},
    gnss::{self, GnssReceiver},
    ins::spec::{self as ins, SynthIns},
    reading::{ComponentSwitches, SynthFaultList, SynthSection, preset},
    trajectory::{self, FlightConditions, SynthFlight},
};

/// A synth spec, checked.
#[derive(Clone, Debug)]
pub struct SynthSpec {
    /// Seed of all random draws.
    pub seed: u64,
    /// Calendar year and day of the year, UTC.
    pub date: (i32, u32),
    /// Sampling rate.
    pub rate_hz: f64,
    /// Components that are switched off.
    pub components: ComponentSwitches,
    /// Standard deviation of small motions in roll, pitch and yaw, in degrees.
    pub gusts_deg: [f64; 3],
    /// Wind, turbulence and the performance of the aircraft.
    pub air: FlightConditions,
    /// The INS.
    pub ins: SynthIns,
    /// The GNSS receiver, if the aircraft has one.
    pub gnss: Option<GnssReceiver>,
    /// The earth's field.
    pub earth: SynthEarth,
    /// The aircraft and its sensors.
    pub aircraft: Aircraft,
    /// The flights.
    pub flights: Vec<SynthFlight>,
}

impl SynthSpec {
    /// Reads a spec.
    ///
    /// # Errors
    /// Fails with all faults of the spec, each with file, line and column.
    pub fn read(path: &Path) -> Result<SynthSpec, ReadError> {
        let text = std::fs::read_to_string(path).map_err(|e| ReadError::io(path, &e))?;
        let root = DeTable::parse(&text).map_err(|e| {
            let fault = Fault::new(e.message()).at(e.span().unwrap_or(0..0));
            ReadError::spec(path, &text, &[fault])
        })?;
        let faults = SynthFaultList::default();
        let root = preset::applied(root.into_inner(), &faults);
        let section = SynthSection::new("synth", &root, 0..0, &faults);
        let spec = spec(&section, path.parent().unwrap_or(Path::new("")));
        section.finish();
        let mut found = std::mem::take(&mut *faults.borrow_mut());
        // Faults are in the order of the file. Faults at the same place are in the order of the checks.
        found.sort_by_key(|fault| fault.at.as_ref().map_or(0, |at| at.start));
        if found.is_empty() { Ok(spec) } else { Err(ReadError::spec(path, &text, &found)) }
    }
}

params! {
    /// The keys of the spec itself.
    pub struct RootKeys, all default;
    /// Seed of all random draws.
    seed: usize, unit "", default 0usize;
    /// Calendar year, UTC.
    year: usize, unit "", default 2020usize, rule Rule::Between(1900.0, 2030.0);
    /// Day of the year.
    doy: usize, unit "", default 1usize, rule Rule::Between(1.0, 366.0);
    /// Sampling rate.
    rate_hz: f64, unit "Hz", default 10.0, rule Rule::Between(0.1, 1000.0);
    /// Standard deviation of small motions in roll, pitch and yaw. They do not change the track.
    gusts_deg: [f64; 3], unit "deg", default [0.0; 3], rule Rule::Between(0.0, 20.0);
    /// Writes each part of each reading to a column `part_<part>_<column>`.
    component_columns: bool, unit "", default false;
}

fn spec(root: &SynthSection, folder: &Path) -> SynthSpec {
    let keys: RootKeys = root.some_keys().unwrap_or_default();
    let components = ComponentSwitches::read(root);
    let air = trajectory::air::air(root);
    SynthSpec {
        seed: keys.seed as u64,
        date: date(root, &keys),
        rate_hz: keys.rate_hz,
        gusts_deg: keys.gusts_deg,
        air,
        ins: ins::ins(root),
        gnss: gnss::gnss(root),
        earth: earth::earth(root, folder, &components),
        aircraft: aircraft::aircraft(root, keys.component_columns),
        flights: trajectory::spec::flights(root, &air),
        components,
    }
}

fn date(root: &SynthSection, keys: &RootKeys) -> (i32, u32) {
    let (year, doy) = (keys.year as i32, keys.doy as u32);
    let days = dates::days_in_year(year);
    if doy > days {
        root.fault_at("doy", format!("`doy` must be 1 to {days} in {year}, not {doy}"));
    }
    (year, doy)
}
