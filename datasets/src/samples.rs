//! The embedded samples: small real and simulated data sets, each with a manifest.

use std::path::PathBuf;

/// The path of a sample's file, such as `osborne/osborne_anomaly_100m_at_500m.tif`, in a checkout of
/// the project. The samples are not part of the binary.
pub fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("samples").join(name)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

    use std::{
        collections::BTreeMap,
        fs,
        path::{Path, PathBuf},
    };

    use super::path;

    fn files(folder: &Path) -> Vec<PathBuf> {
        let mut out = vec![];
        for entry in fs::read_dir(folder).unwrap() {
            let entry = entry.unwrap().path();
            if entry.is_dir() { out.extend(files(&entry)) } else { out.push(entry) }
        }
        out
    }

    fn folders() -> Vec<PathBuf> {
        let all = fs::read_dir(path("")).unwrap().map(|e| e.unwrap().path());
        let mut folders: Vec<_> = all.filter(|p| p.is_dir()).collect();
        folders.sort();
        folders
    }

    #[test]
    fn unit_every_sample_is_in_its_manifest_with_its_hash() {
        assert_eq!(folders().len(), 9);
        for folder in folders() {
            let text = fs::read_to_string(folder.join("MANIFEST.toml")).unwrap();
            let manifest: toml::Table = text.parse().unwrap();
            for key in ["name", "source", "licence", "changes"] {
                assert!(manifest[key].as_str().is_some_and(|s| !s.is_empty()), "{folder:?} {key}");
            }
            assert!(!manifest["faults"].as_array().unwrap().is_empty(), "{folder:?}");
            let mut listed = BTreeMap::new();
            for file in manifest["files"].as_array().unwrap() {
                listed.insert(folder.join(file["path"].as_str().unwrap()), file.clone());
            }
            for file in files(&folder).into_iter().filter(|f| !f.ends_with("MANIFEST.toml")) {
                let entry = listed.remove(&file).unwrap_or_else(|| panic!("{file:?} is not in the manifest"));
                let bytes = fs::read(&file).unwrap();
                assert_eq!(entry["bytes"].as_integer(), Some(bytes.len() as i64), "{file:?}");
                assert_eq!(entry["blake3"].as_str(), Some(blake3::hash(&bytes).to_hex().as_str()), "{file:?}");
                assert_eq!(entry["sha256"].as_str().map(str::len), Some(64), "{file:?}");
            }
            assert!(listed.is_empty(), "the manifest lists missing files: {listed:?}");
        }
    }

    #[test]
    fn unit_the_readme_lists_every_sample() {
        let readme = fs::read_to_string(path("README.md")).unwrap();
        for folder in folders() {
            let name = folder.file_name().unwrap().to_string_lossy().into_owned();
            assert!(readme.contains(&format!("[{name}]({name}/MANIFEST.toml)")), "{name}");
        }
    }
}
