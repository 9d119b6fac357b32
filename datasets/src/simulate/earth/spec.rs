//! What the spec says of the earth's field: the map of the anomaly, and the temporal variation.

use std::path::{Path, PathBuf};

use stages::numerics::gauss_markov::GaussMarkov;

use super::super::spec::{
    gauss_markov,
    section::{Need, Section},
};
use crate::MapOptions;

/// The earth's field.
#[derive(Clone, Debug)]
pub struct Earth {
    /// The anomaly map and how to read it.
    pub map: (PathBuf, MapOptions),
    /// The temporal variation.
    pub diurnal: Option<GaussMarkov>,
}

/// Reads the tables `map` and `diurnal`; paths are relative to `folder`.
pub(in super::super) fn earth(root: &Section, folder: &Path) -> Earth {
    Earth {
        map: map(root, folder),
        diurnal: root.section("diurnal").and_then(|s| gauss_markov(&s, "sigma_nt", "tau_s", 600.0)),
    }
}

fn map(root: &Section, folder: &Path) -> (PathBuf, MapOptions) {
    let Some(s) = root.section("map") else {
        root.fault("the spec needs a table `map`".to_owned());
        return Default::default();
    };
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
