//! The manifest of a version: its tables, with the files of each, and their checksums.

use schemas::{keys::HashKey, paths};
use serde::{Deserialize, Serialize};

/// Manifest of a version.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Name of the pipeline.
    pub pipeline: String,
    /// Run that made the version.
    pub run: String,
    /// Tables of the version.
    pub tables: Vec<ManifestTable>,
    /// All packs that the version references, published or not.
    pub packs: Vec<String>,
    /// Checksum of the fields above.
    pub(super) sum: String,
}

/// Table of a version.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ManifestTable {
    /// Name of the table.
    pub name: String,
    /// Files, in the order of the rows.
    pub files: Vec<ManifestFile>,
    /// File with the origin of each row.
    pub units: Option<ManifestFile>,
}

/// File of a version.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ManifestFile {
    /// Name, below the folder of the version.
    pub name: String,
    /// Name of the pack, if the file is a pack.
    pub pack: Option<String>,
    /// Hash of the bytes, if the file is not a pack.
    pub hash: Option<String>,
    /// Size, in bytes.
    pub size: u64,
    /// Time of writing, ns since 1970.
    pub(super) modified_ns: u64,
}

impl ManifestFile {
    /// Whether two versions are equal except for the time.
    pub(super) fn same(&self, other: &ManifestFile) -> bool {
        (&self.name, &self.pack, &self.hash, self.size) == (&other.name, &other.pack, &other.hash, other.size)
    }
}

impl Manifest {
    /// Manifest in these bytes, if they are intact.
    pub(crate) fn read(bytes: &[u8]) -> Option<Manifest> {
        let manifest: Manifest = serde_json::from_slice(bytes).ok()?;
        (sum_of(&manifest)? == manifest.sum && manifest.is_inside()).then_some(manifest)
    }

    /// Whether all names are valid, and all files are in the folders that a run uses. The checksum only detects
    /// accidental changes.
    fn is_inside(&self) -> bool {
        let is_key = |text: &String| HashKey::parse(text).is_some_and(|key| key.to_string() == *text);
        let is_file = |file: &ManifestFile, folder: &str| {
            let own = file.name.strip_prefix(folder).is_some_and(|name| !name.contains('/'));
            own && paths::check_path(&file.name).is_ok() && file.pack.iter().chain(&file.hash).all(is_key)
        };
        let is_table = |table: &ManifestTable| {
            let folder = format!("tables/{}/", table.name);
            paths::check_name(&table.name).is_ok()
                && table.files.iter().all(|file| is_file(file, &folder))
                && table.units.iter().all(|file| is_file(file, "units/"))
        };
        paths::check_name(&self.pipeline).is_ok() && self.tables.iter().all(is_table) && self.packs.iter().all(is_key)
    }

    /// Checksum of the manifest.
    pub fn sum(&self) -> &str {
        &self.sum
    }
}

/// Checksum of the fields of a manifest; `None` if it cannot be written.
pub(super) fn sum_of(manifest: &Manifest) -> Option<String> {
    let plain = Manifest { sum: String::new(), ..manifest.clone() };
    serde_json::to_vec(&plain).ok().map(|bytes| HashKey::from_parts([bytes]).to_string())
}
