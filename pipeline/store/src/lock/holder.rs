//! The process that holds a lock: its host, boot and number.

use std::{fmt, fs, process::Command};

use schemas::keys::HashKey;
use serde::{Deserialize, Serialize};

use crate::clock;

/// Process that holds a lock.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LockHolder {
    /// Name of the host of the process.
    pub host: String,
    /// Identifier of the boot of the host, equal only for processes under one kernel. Empty if unknown.
    pub boot: String,
    /// Process identifier.
    pub pid: u32,
    /// Time of acquisition, UTC.
    pub since: String,
    /// Checksum of the fields above.
    #[serde(default)]
    pub(super) sum: String,
    /// Whether the holder has released the lock.
    pub(super) free: bool,
}

impl LockHolder {
    pub(crate) fn this() -> LockHolder {
        let (host, boot) = (host(), boot());
        let (pid, since) = (std::process::id(), clock::now());
        LockHolder { host, boot, pid, since, sum: String::new(), free: false }.signed()
    }

    /// Returns the holder with its checksum.
    pub(super) fn signed(mut self) -> LockHolder {
        self.sum = self.sum_of();
        self
    }

    fn sum_of(&self) -> String {
        HashKey::from_parts([&self.host, &self.boot, &self.pid.to_string(), &self.since]).to_string()
    }

    /// Checksum of the holder.
    pub(crate) fn sum(&self) -> &str {
        &self.sum
    }

    /// Whether the checksum is correct.
    pub(crate) fn is_whole(&self) -> bool {
        self.sum == self.sum_of()
    }

    /// Reads the holder from the text of a lease. Only `verify` checks the checksum: a lease is valid with any content.
    pub(super) fn read(bytes: &[u8]) -> Option<LockHolder> {
        serde_json::from_slice(bytes).ok()
    }

    /// Whether the holder has released the lock.
    pub(crate) fn is_free(&self) -> bool {
        self.free
    }

    /// Records the release.
    pub(crate) fn release(&mut self) {
        self.free = true;
    }
}

impl fmt::Display for LockHolder {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "process {} on {}, since {}", self.pid, self.host, self.since)
    }
}

/// Name of this host.
pub fn host() -> String {
    let named = fs::read_to_string("/proc/sys/kernel/hostname").ok();
    let asked = || Command::new("uname").arg("-n").output().ok().and_then(|o| String::from_utf8(o.stdout).ok());
    let name = named.or_else(asked).map(|n| n.trim().to_owned()).filter(|n| !n.is_empty());
    name.unwrap_or_else(|| "localhost".to_owned())
}

/// Identifier of this host's boot; empty if unknown.
pub fn boot() -> String {
    fs::read_to_string("/proc/sys/kernel/random/boot_id").map(|t| t.trim().to_owned()).unwrap_or_default()
}
