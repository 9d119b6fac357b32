//! The embedded samples: small real and simulated data sets, each with a manifest.

use std::path::PathBuf;

/// The path of a sample's file, such as `osborne/osborne_anomaly_100m_at_500m.tif`, in a checkout of
/// the project. The samples are not part of the binary.
pub fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("samples").join(name)
}
