//! Object stores: `s3://`, `gs://` and `az://` as locations of stores, inputs and published sets.
//!
//! Other modules use object stores through [`Bucket`]: it reads and writes whole objects by name below an address, with
//! optional conditions on writes. Copies are kept in a folder of this machine, the cache: see [`cache`].

mod address;
mod bucket;
pub mod cache;
#[cfg(feature = "object-stores")]
mod client;
mod connect;
mod errors;
mod files;
#[cfg(feature = "object-stores")]
mod profile;
mod redact;

pub use address::{ObjectAddress, StorageLocation, place};
pub use bucket::{Bucket, ObjectEntry, each};
pub use connect::{connect, supported};
pub use files::{fetch_companion, find, fixed, whole};
pub use redact::{address as without_password, redacted};
