//! Keys of the earth's field in a synth spec: the core model, the map of the anomaly, sources in the ground, and the
//! temporal variation.

use std::path::{Path, PathBuf};

use datasets::MapOptions;
use numerics::{earth::core_field::CoreFieldModel, signal::gauss_markov::GaussMarkov};

use schemas::{Rule, VerbatimText, choice, params, plausible::PlausibilityCheck};

use crate::reading::{ComponentSwitches, SynthSection};

/// The earth's field.
#[derive(Clone, Debug)]
pub struct SynthEarth {
    /// The model of the core field.
    pub core: CoreFieldModel,
    /// The anomaly map and its reading options.
    pub map: Option<(PathBuf, MapOptions)>,
    /// Sources in the ground.
    pub sources: Vec<BuriedSource>,
    /// The temporal variation.
    pub diurnal: Diurnal,
}

impl SynthEarth {
    /// The files that the field depends on, each with a description.
    pub(in super::super) fn files(&self) -> Vec<(&'static str, &Path)> {
        let map = self.map.iter().map(|(path, _)| ("map", path.as_path()));
        let record = self.diurnal.observatory.iter().map(|(path, _)| ("record of the observatory", path.as_path()));
        map.chain(record).collect()
    }
}

/// A source in the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BuriedSource {
    /// Latitude in degrees.
    pub lat_deg: f64,
    /// Longitude in degrees.
    pub lon_deg: f64,
    /// The height of a dipole, or of the top of a prism, above the ellipsoid.
    pub alt_m: f64,
    /// Inclination (down from the horizontal) and declination of its magnetisation; `None` means along the core field.
    pub inclination_declination_deg: Option<(f64, f64)>,
    /// Kind and size.
    pub body: BuriedBody,
}

/// The kind of a source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BuriedBody {
    /// A dipole.
    Dipole {
        /// Moment, in A m².
        moment_am2: f64,
    },
    /// A rectangular prism.
    Prism {
        /// Magnetisation, in A/m.
        magnetisation_apm: f64,
        /// Length, width and thickness.
        size_m: [f64; 3],
        /// The direction of its length, clockwise from north.
        azimuth_deg: f64,
    },
}

/// The temporal variation.
#[derive(Clone, Debug, Default)]
pub struct Diurnal {
    /// Irregular variation along the core field, drawn for each flight.
    pub irregular: Option<GaussMarkov>,
    /// Maximum deviation of the quiet-day curve from its night value at a latitude of 35 degrees, in nT.
    pub quiet_nt: f64,
    /// Pulsations of a narrow band.
    pub pulsations: Option<Pulsations>,
    /// A magnetic storm.
    pub storm: Option<Storm>,
    /// An observatory's record, and whether its baseline is the quiet value instead of the mean.
    pub observatory: Option<(PathBuf, bool)>,
}

/// Pulsations of the field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pulsations {
    /// Standard deviation of the north component, in nT.
    pub sigma_nt: f64,
    /// Centre of the band, in seconds.
    pub period_s: f64,
    /// Standard deviation of the frequency, as a fraction of the centre frequency.
    pub width: f64,
}

/// A magnetic storm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Storm {
    /// Depth at the geomagnetic equator, in nT.
    pub depth_nt: f64,
    /// Sudden commencement, in seconds past midnight.
    pub start_tt_s: f64,
    /// Time from the commencement to the minimum, in seconds.
    pub main_s: f64,
    /// Time from the minimum to 1/e of the depth, in seconds.
    pub recovery_s: f64,
}

params! {
    /// The table `core_field`: the core field, which cannot be switched off.
    pub struct CoreKeys;
    /// Model of the core field. The World Magnetic Model covers 2020 to 2030.
    model: CoreFieldModel, unit "", default CoreFieldModel::Igrf14;
}

params! {
    /// The table `map`: the anomaly map. It is optional with `sources`, or with `anomaly = false` in `components`.
    pub struct MapKeys;
    /// Path of the map file, relative to the spec.
    path: String, unit "";
    /// Format of the file.
    format: Option<String>, unit "", absent "detected from content and extension";
    /// EPSG code of the file's coordinates.
    epsg: Option<usize>, unit "", absent "read from the file", rule Rule::Between(1.0, 65535.0);
    /// Height of the map above the WGS-84 ellipsoid.
    alt_m: Option<f64>, unit "m", absent "read from the file", rule Rule::Finite;
    /// Unit of the map's values.
    unit: Option<String>, unit "", absent "read from the file, else nT";
    /// Numbers that mark an unknown value.
    missing: Vec<VerbatimText>, unit "", default Vec::<VerbatimText>::new();
    /// Plausibility checks that are disabled for this map.
    accept: Vec<PlausibilityCheck>, unit "", default Vec::<PlausibilityCheck>::new();
}

choice! {
    /// The kind of a source.
    pub enum BuriedBodyKind {
        /// A dipole.
        Dipole = "dipole",
        /// A rectangular prism.
        Prism = "prism",
    }
}

params! {
    /// A table of `sources`: a dipole or prism in the ground, added to the map.
    pub struct BuriedSourceKeys;
    /// Kind of the source.
    kind: BuriedBodyKind, unit "", default BuriedBodyKind::Dipole;
    /// Latitude of the centre.
    lat: f64, unit "deg", rule Rule::Between(-90.0, 90.0);
    /// Longitude of the centre.
    lon: f64, unit "deg", rule Rule::Between(-360.0, 360.0);
    /// Depth of a dipole, or of a prism's top, below the WGS-84 ellipsoid. Cannot be combined with `alt_m`.
    depth_m: Option<f64>, unit "m", absent "`alt_m` is given", rule Rule::Finite;
    /// Height of a dipole, or of a prism's top, above the WGS-84 ellipsoid. Cannot be combined with `depth_m`.
    alt_m: Option<f64>, unit "m", absent "`depth_m` is given", rule Rule::Finite;
    /// Magnetic moment of a dipole. Required for a dipole.
    moment_am2: Option<f64>, unit "A m2", absent "a prism", rule Rule::Finite;
    /// Magnetisation of a prism. Required for a prism.
    magnetisation_apm: Option<f64>, unit "A/m", absent "a dipole", rule Rule::Finite;
    /// Length along `azimuth_deg`, width and thickness of a prism. Required for a prism.
    size_m: Option<[f64; 3]>, unit "m", absent "a dipole", rule Rule::Positive;
    /// Azimuth of a prism's length, clockwise from true north.
    azimuth_deg: Option<f64>, unit "deg", absent "north", rule Rule::Between(-360.0, 360.0);
    /// Inclination of the magnetisation, down from the horizontal.
    inclination_deg: Option<f64>, unit "deg", absent "along the core field", rule Rule::Between(-90.0, 90.0);
    /// Declination of the magnetisation, clockwise from true north.
    declination_deg: Option<f64>, unit "deg", absent "0 with `inclination_deg`", rule Rule::Between(-360.0, 360.0);
}

choice! {
    /// Baseline of an observatory's record.
    pub enum ObservatoryBaseline {
        /// The mean of the record.
        Mean = "mean",
        /// The first three hours of the local day.
        Quiet = "quiet",
    }
}

params! {
    /// The table `diurnal`: the temporal variation. Each part defaults to 0.
    pub struct DiurnalKeys, all default;
    /// Standard deviation of a first-order Gauss-Markov process along the core field, drawn for each flight.
    sigma_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Time constant of that process.
    tau_s: f64, unit "s", default 600.0, rule Rule::Positive;
    /// Maximum deviation of the quiet-day curve from its night value, at a latitude of 35 degrees.
    quiet_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Standard deviation of the north component of the pulsations.
    pulsation_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Centre period of the pulsations: 10 to 45 s for Pc3, 45 to 150 s for Pc4, 150 to 600 s for Pc5.
    pulsation_period_s: f64, unit "s", default 30.0, rule Rule::Between(0.1, 3600.0);
    /// Standard deviation of the pulsation frequency, as a fraction of the centre frequency.
    pulsation_width: f64, unit "1", default 0.1, rule Rule::Between(0.001, 0.3);
    /// Depth of a magnetic storm at the geomagnetic equator.
    storm_nt: f64, unit "nT", default 0.0, rule Rule::NotNegative;
    /// Time of the storm's sudden commencement, in seconds past midnight UTC. Required with `storm_nt`.
    storm_start_tt_s: Option<f64>, unit "s", default None, absent "no storm", rule Rule::Finite;
    /// Time from the commencement to the minimum of the storm.
    storm_main_s: f64, unit "s", default 21_600.0, rule Rule::Positive;
    /// Time from the minimum to 1/e of the storm's depth.
    storm_recovery_s: f64, unit "s", default 57_600.0, rule Rule::Positive;
    /// Path of an observatory's record in IAGA-2002 format, relative to the spec. The date of the record is ignored.
    observatory: Option<String>, unit "", default None, absent "no record";
    /// Baseline that is subtracted from the observatory's record.
    observatory_base: ObservatoryBaseline, unit "", default ObservatoryBaseline::Mean;
}

/// Reads the tables `core_field`, `map`, `sources` and `diurnal`; paths are relative to `folder`.
pub(in super::super) fn earth(root: &SynthSection, folder: &Path, components: &ComponentSwitches) -> SynthEarth {
    let sources: Vec<BuriedSource> = root.sections("sources").iter().filter_map(buried).collect();
    let map = root.section("map");
    if map.is_none() && sources.is_empty() && components.on("anomaly") {
        root.fault("the spec needs a table `map`, a list `sources`, or `anomaly = false` in `components`".to_owned());
    }
    let core = root.section("core_field").and_then(|s| s.group::<CoreKeys>(None)).map(|keys| keys.model);
    let diurnal = root.section("diurnal").and_then(|s| diurnal(&s, folder)).unwrap_or_default();
    SynthEarth { core: core.unwrap_or_default(), map: map.and_then(|s| self::map(&s, folder)), sources, diurnal }
}

fn map(s: &SynthSection, folder: &Path) -> Option<(PathBuf, MapOptions)> {
    let MapKeys { path, format, epsg, alt_m, unit, missing, accept } = s.group(None)?;
    let epsg = epsg.and_then(|code| u16::try_from(code).ok());
    Some((folder.join(path), MapOptions { format, epsg, alt_m, unit, field_component: None, missing, accept }))
}

fn buried(s: &SynthSection) -> Option<BuriedSource> {
    let keys: BuriedSourceKeys = s.group(None)?;
    if keys.depth_m.is_some() == keys.alt_m.is_some() {
        s.fault("a source needs either `depth_m` or `alt_m`".to_owned());
    }
    if keys.declination_deg.is_some() && keys.inclination_deg.is_none() {
        s.fault_at("declination_deg", "a source with `declination_deg` needs `inclination_deg` too".to_owned());
    }
    let foreign = |given: [(&'static str, bool); 3], kind: BuriedBodyKind| {
        for (key, _) in given.into_iter().filter(|(_, given)| *given) {
            s.fault_at(key, format!("`{key}` is a key of `kind = \"{}\"`", kind.word()));
        }
    };
    let body = match keys.kind {
        BuriedBodyKind::Dipole => {
            let given = [
                ("magnetisation_apm", keys.magnetisation_apm.is_some()),
                ("size_m", keys.size_m.is_some()),
                ("azimuth_deg", keys.azimuth_deg.is_some()),
            ];
            foreign(given, BuriedBodyKind::Prism);
            if keys.moment_am2.is_none() {
                s.fault("a dipole needs `moment_am2`, its magnetic moment in A m2".to_owned());
            }
            BuriedBody::Dipole { moment_am2: keys.moment_am2? }
        }
        BuriedBodyKind::Prism => {
            foreign([("moment_am2", keys.moment_am2.is_some()), ("", false), ("", false)], BuriedBodyKind::Dipole);
            if keys.size_m.is_none() {
                s.fault("a prism needs `size_m`, its length, width and thickness".to_owned());
            }
            if keys.magnetisation_apm.is_none() {
                s.fault("a prism needs `magnetisation_apm`, its magnetisation in A/m".to_owned());
            }
            let azimuth_deg = keys.azimuth_deg.unwrap_or(0.0);
            BuriedBody::Prism { magnetisation_apm: keys.magnetisation_apm?, size_m: keys.size_m?, azimuth_deg }
        }
    };
    let inclination_declination_deg = keys.inclination_deg.map(|i| (i, keys.declination_deg.unwrap_or(0.0)));
    let alt_m = keys.alt_m.or(keys.depth_m.map(|depth_m| -depth_m))?;
    Some(BuriedSource { lat_deg: keys.lat, lon_deg: keys.lon, alt_m, inclination_declination_deg, body })
}

fn diurnal(s: &SynthSection, folder: &Path) -> Option<Diurnal> {
    let keys: DiurnalKeys = s.group(None)?;
    let irregular = GaussMarkov { sigma: keys.sigma_nt, tau_s: keys.tau_s };
    let (sigma_nt, period_s, width) = (keys.pulsation_nt, keys.pulsation_period_s, keys.pulsation_width);
    if keys.storm_nt > 0.0 && keys.storm_start_tt_s.is_none() {
        s.fault_at(
            "storm_nt",
            "`storm_nt` needs `storm_start_tt_s`, the start in seconds past midnight UTC".to_owned(),
        );
    }
    let storm = |start_tt_s| {
        let (main_s, recovery_s) = (keys.storm_main_s, keys.storm_recovery_s);
        Storm { depth_nt: keys.storm_nt, start_tt_s, main_s, recovery_s }
    };
    let quiet_base = keys.observatory_base == ObservatoryBaseline::Quiet;
    Some(Diurnal {
        irregular: (irregular.sigma > 0.0).then_some(irregular),
        quiet_nt: keys.quiet_nt,
        pulsations: (sigma_nt > 0.0).then_some(Pulsations { sigma_nt, period_s, width }),
        storm: keys.storm_start_tt_s.filter(|_| keys.storm_nt > 0.0).map(storm),
        observatory: keys.observatory.map(|file| (folder.join(file), quiet_base)),
    })
}
