//! What the spec says of the earth's field: the core model, the map of the anomaly, sources in the ground, and
//! the temporal variation.
//!
//! ```toml
//! [core_field]
//! model = "igrf"            # or "wmm", 2020 to 2030; always on
//!
//! [map]                     # may be left out where there are sources, or no anomaly
//! path   = "anomaly.tif"    # relative to the spec
//! format = "geotiff"        # where content and extension do not tell
//! epsg   = 32654            # where the file names no system of coordinates
//! alt_m  = 500.0            # where the file holds no height
//! unit   = "nT"             # where the file names none
//!
//! [[sources]]               # dipoles and prisms, added to the map
//! kind              = "prism"                  # or "dipole", the default
//! lat               = -22.0                    # of its middle, degrees
//! lon               = 140.65
//! depth_m           = 300.0                    # of the dipole or the prism's top below the ellipsoid ...
//! alt_m             = -300.0                   # ... or its height above it, one of the two
//! size_m            = [2000.0, 500.0, 1000.0]  # prism: length along azimuth_deg, width, thickness
//! azimuth_deg       = 0.0                      # prism: of its length, clockwise from north
//! magnetisation_apm = 2.0                      # prism: A/m
//! moment_am2        = 1.0e9                    # dipole: A m²
//! inclination_deg   = -53.0                    # of the magnetisation; both left out: along the core field
//! declination_deg   = 6.0
//!
//! [diurnal]                 # every part is 0 unless it is given
//! sigma_nt             = 3.0       # Gauss-Markov along the core field: standard deviation ...
//! tau_s                = 600.0     # ... and correlation time
//! quiet_nt             = 30.0      # quiet-day curve: greatest departure from the night at 35 degrees of latitude
//! pulsation_nt         = 0.5       # standard deviation of the northward part of the pulsations
//! pulsation_period_s   = 30.0      # their middle period: Pc3 10 to 45 s, Pc4 to 150 s, Pc5 to 600 s
//! pulsation_width      = 0.1       # standard deviation of their frequency, as a part of it
//! storm_nt             = 150.0     # depth of a storm at the geomagnetic equator
//! storm_start_tt_s     = 39600.0   # its sudden commencement, seconds past midnight UTC
//! storm_main_s         = 21600.0   # from there to its deepest
//! storm_recovery_s     = 57600.0   # from there until 1/e of it is left
//! observatory          = "bou.min" # a real record (IAGA-2002), by time of day; relative to the spec
//! observatory_base     = "mean"    # what its departure is counted from: "mean", or "quiet", its first three
//!                                  # hours of local day
//! ```

use std::path::{Path, PathBuf};

use datasets::MapOptions;
use numerics::{earth::core_field::CoreModel, signal::gauss_markov::GaussMarkov};

use super::super::spec::{
    Components,
    section::{Need, Section},
};

/// The earth's field.
#[derive(Clone, Debug)]
pub struct Earth {
    /// The model of the core field.
    pub core: CoreModel,
    /// The anomaly map and how to read it.
    pub map: Option<(PathBuf, MapOptions)>,
    /// Sources in the ground.
    pub sources: Vec<Buried>,
    /// The temporal variation.
    pub diurnal: Diurnal,
}

impl Earth {
    /// The files that the field depends on, and what each is.
    pub(in super::super) fn files(&self) -> Vec<(&'static str, &Path)> {
        let map = self.map.iter().map(|(path, _)| ("map", path.as_path()));
        let record = self.diurnal.observatory.iter().map(|(path, _)| ("record of the observatory", path.as_path()));
        map.chain(record).collect()
    }
}

/// A source in the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Buried {
    /// Its latitude in degrees.
    pub lat_deg: f64,
    /// Its longitude in degrees.
    pub lon_deg: f64,
    /// The height of a dipole, or of the top of a prism, above the ellipsoid.
    pub alt_m: f64,
    /// Inclination (down from the horizontal) and declination of its magnetisation; `None` is along the core field.
    pub inclination_declination_deg: Option<(f64, f64)>,
    /// What it is.
    pub body: Body,
}

/// The kind of a source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Body {
    /// A dipole.
    Dipole {
        /// Its moment, in A m².
        moment_am2: f64,
    },
    /// A rectangular prism.
    Prism {
        /// Its magnetisation, in A/m.
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
    /// The greatest departure of the quiet-day curve from its night value at 35 degrees of latitude, in nT.
    pub quiet_nt: f64,
    /// Pulsations of a narrow band.
    pub pulsations: Option<Pulsations>,
    /// A magnetic storm.
    pub storm: Option<Storm>,
    /// An observatory's record, and whether its quiet value is its zero rather than its mean.
    pub observatory: Option<(PathBuf, bool)>,
}

/// Pulsations of the field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pulsations {
    /// Standard deviation of the northward part, in nT.
    pub sigma_nt: f64,
    /// The middle of the band.
    pub period_s: f64,
    /// Standard deviation of the frequency, as a part of it.
    pub width: f64,
}

/// A magnetic storm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Storm {
    /// Its depth at the geomagnetic equator, in nT.
    pub depth_nt: f64,
    /// Its sudden commencement, in seconds past midnight.
    pub start_tt_s: f64,
    /// From there to its deepest.
    pub main_s: f64,
    /// From there until 1/e of it is left.
    pub recovery_s: f64,
}

/// Reads the tables `core_field`, `map`, `sources` and `diurnal`; paths are relative to `folder`.
pub(in super::super) fn earth(root: &Section, folder: &Path, components: &Components) -> Earth {
    let sources: Vec<Buried> = root.sections("sources").iter().filter_map(buried).collect();
    let map = root.section("map").map(|s| map(&s, folder));
    if map.is_none() && sources.is_empty() && components.on("anomaly") {
        root.fault("the spec needs a table `map` or `sources`, or `anomaly = false` in `components`".to_owned());
    }
    let diurnal = root.section("diurnal").map(|s| diurnal(&s, folder)).unwrap_or_default();
    Earth { core: core(root), map, sources, diurnal }
}

fn core(root: &Section) -> CoreModel {
    let Some(s) = root.section("core_field") else { return CoreModel::default() };
    let model = if s.word("model", &["igrf", "wmm"]) == 1 { CoreModel::Wmm } else { CoreModel::Igrf14 };
    s.finish();
    model
}

fn map(s: &Section, folder: &Path) -> (PathBuf, MapOptions) {
    let options = MapOptions {
        format: s.optional_text("format"),
        epsg: s.optional("epsg", Need::Between(1.0, 65535.0)).map(|x| x as u16),
        alt_m: s.optional("alt_m", Need::Any),
        unit: s.optional_text("unit"),
    };
    let path = folder.join(s.text("path"));
    s.finish();
    (path, options)
}

fn buried(s: &Section) -> Option<Buried> {
    let lat_deg = s.needed("lat", Need::Between(-90.0, 90.0));
    let lon_deg = s.needed("lon", Need::Between(-360.0, 360.0));
    let (depth_m, alt_m) = (s.optional("depth_m", Need::Any), s.optional("alt_m", Need::Any));
    if depth_m.is_some() == alt_m.is_some() {
        s.fault("a source needs `depth_m` or `alt_m`, one of the two".to_owned());
    }
    let inclination = s.optional("inclination_deg", Need::Between(-90.0, 90.0));
    let declination = s.optional("declination_deg", Need::Between(-360.0, 360.0));
    if declination.is_some() && inclination.is_none() {
        s.fault_at("declination_deg", "a source with `declination_deg` needs `inclination_deg` too".to_owned());
    }
    let body = if s.word("kind", &["dipole", "prism"]) == 1 {
        let size_m = s.numbers("size_m", [f64::NAN; 3], Need::Positive);
        if size_m.iter().any(|x| x.is_nan()) {
            s.fault("a prism needs `size_m`, its length, width and thickness".to_owned());
        }
        Body::Prism {
            magnetisation_apm: s.needed("magnetisation_apm", Need::Any),
            size_m,
            azimuth_deg: s.number("azimuth_deg", 0.0, Need::Between(-360.0, 360.0)),
        }
    } else {
        Body::Dipole { moment_am2: s.needed("moment_am2", Need::Any) }
    };
    s.finish();
    let inclination_declination_deg = inclination.map(|i| (i, declination.unwrap_or(0.0)));
    let alt_m = alt_m.or(depth_m.map(|d| -d))?;
    Some(Buried { lat_deg, lon_deg, alt_m, inclination_declination_deg, body })
}

fn diurnal(s: &Section, folder: &Path) -> Diurnal {
    let size = |key: &'static str| s.number(key, 0.0, Need::NotNegative);
    let irregular = GaussMarkov { sigma: size("sigma_nt"), tau_s: s.number("tau_s", 600.0, Need::Positive) };
    let pulsations = Pulsations {
        sigma_nt: size("pulsation_nt"),
        period_s: s.number("pulsation_period_s", 30.0, Need::Between(0.1, 3600.0)),
        width: s.number("pulsation_width", 0.1, Need::Between(0.001, 0.3)),
    };
    let observatory = s.optional_text("observatory").map(|file| folder.join(file));
    let quiet_base = s.word("observatory_base", &["mean", "quiet"]) == 1;
    let diurnal = Diurnal {
        irregular: (irregular.sigma > 0.0).then_some(irregular),
        quiet_nt: size("quiet_nt"),
        pulsations: (pulsations.sigma_nt > 0.0).then_some(pulsations),
        storm: storm(s),
        observatory: observatory.map(|path| (path, quiet_base)),
    };
    s.finish();
    diurnal
}

fn storm(s: &Section) -> Option<Storm> {
    let depth_nt = s.number("storm_nt", 0.0, Need::NotNegative);
    let start = s.optional("storm_start_tt_s", Need::Any);
    let main_s = s.number("storm_main_s", 21_600.0, Need::Positive);
    let recovery_s = s.number("storm_recovery_s", 57_600.0, Need::Positive);
    if depth_nt > 0.0 && start.is_none() {
        s.fault_at("storm_nt", "a storm needs `storm_start_tt_s`, when it begins".to_owned());
    }
    start.filter(|_| depth_nt > 0.0).map(|start_tt_s| Storm { depth_nt, start_tt_s, main_s, recovery_s })
}
