//! Locations: a path, or an address in an object store.

use std::{fmt, path::PathBuf};

use schemas::Fault;

/// Kind of object store.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ObjectStoreScheme {
    /// Amazon S3, and servers with the same interface, such as MinIO, Ceph and Garage.
    S3,
    /// Google Cloud Storage.
    Gs,
    /// Azure Blob Storage; its bucket is a container.
    Az,
}

impl ObjectStoreScheme {
    const ALL: [ObjectStoreScheme; 3] = [ObjectStoreScheme::S3, ObjectStoreScheme::Gs, ObjectStoreScheme::Az];

    /// Scheme of an address, without `://`.
    pub fn as_str(self) -> &'static str {
        match self {
            ObjectStoreScheme::S3 => "s3",
            ObjectStoreScheme::Gs => "gs",
            ObjectStoreScheme::Az => "az",
        }
    }
}

/// Location in an object store: a bucket, and the name of an object or a common prefix.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct ObjectAddress {
    /// Kind of store.
    pub scheme: ObjectStoreScheme,
    /// Name of the bucket.
    pub bucket: String,
    /// Name of an object or a common prefix, without slashes at either end; may be empty.
    pub key: String,
}

impl fmt::Display for ObjectAddress {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}://{}", self.scheme.as_str(), self.bucket)?;
        if self.key.is_empty() { Ok(()) } else { write!(f, "/{}", self.key) }
    }
}

/// Location of a file: a path or an object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StorageLocation {
    /// Path, which may be relative.
    Path(PathBuf),
    /// Address in an object store.
    Object(ObjectAddress),
}

/// Reads a location: `s3://`, `gs://` or `az://` with a bucket, `file://` with an absolute path, or a path.
///
/// # Errors
/// Fails for other addresses, or for an invalid bucket name.
pub fn place(text: &str) -> Result<StorageLocation, Fault> {
    let Some((scheme, rest)) = text.split_once("://") else { return Ok(StorageLocation::Path(text.into())) };
    if scheme == "file" {
        if rest.starts_with('/') {
            return Ok(StorageLocation::Path(rest.into()));
        }
        return Err(Fault::new("`file://` requires an absolute path, such as `file:///data/flights`"));
    }
    let Some(scheme) = ObjectStoreScheme::ALL.into_iter().find(|s| s.as_str() == scheme) else {
        // The rest of the address may contain a password and is not shown.
        let fault = Fault::new(format!("addresses that begin with `{}://` are not supported", shown(scheme)));
        return Err(fault.help("use s3://, gs://, az:// or file://"));
    };
    let (bucket, key) = rest.split_once('/').unwrap_or((rest, ""));
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_');
    if bucket.is_empty() || !bucket.chars().all(plain) {
        let fault = Fault::new(format!("the address {}:// lacks the name of a bucket", scheme.as_str()));
        return Err(
            fault.help(format!("write {}://BUCKET/NAME; put a key or password into the environment", scheme.as_str()))
        );
    }
    let key = key.trim_matches('/');
    if key.chars().any(char::is_control) || key.split('/').any(|part| matches!(part, "." | "..")) || key.contains("//")
    {
        return Err(Fault::new(format!("the address in the bucket `{bucket}` is not a valid object name"))
            .help("remove `.`, `..`, `//` and control characters"));
    }
    Ok(StorageLocation::Object(ObjectAddress { scheme, bucket: bucket.to_owned(), key: key.to_owned() }))
}

fn shown(scheme: &str) -> String {
    scheme.chars().filter(char::is_ascii_alphanumeric).take(20).collect()
}

impl ObjectAddress {
    /// Address of the object `key` below this address.
    pub fn below(&self, key: &str) -> ObjectAddress {
        let joined = [self.key.as_str(), key].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("/");
        ObjectAddress { key: joined, ..self.clone() }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_locations_are_paths_or_addresses_without_secrets() {
        let object = |text: &str| match place(text).unwrap() {
            StorageLocation::Object(address) => (address.bucket.clone(), address.key.clone(), address.to_string()),
            StorageLocation::Path(path) => unreachable!("{}", path.display()),
        };
        let of = |bucket: &str, key: &str, text: &str| (bucket.to_owned(), key.to_owned(), text.to_owned());
        assert_eq!(object("s3://b/x/y/"), of("b", "x/y", "s3://b/x/y"));
        assert_eq!(object("az://c"), of("c", "", "az://c"));
        assert_eq!(object("gs://my.bucket/a*.csv").1, "a*.csv");
        assert_eq!(place("logs/a.csv").unwrap(), StorageLocation::Path("logs/a.csv".into()));
        assert_eq!(place("file:///x/y").unwrap(), StorageLocation::Path("/x/y".into()));
        for wrong in [
            "file://x",
            "s3://",
            "s3:///x",
            "s3://id:geheim@b/x",
            "https://id:geheim@b/x",
            "s3://b/a/../c",
            "s3://b/a//c",
        ] {
            let fault = place(wrong).unwrap_err().to_string();
            assert!(!fault.contains("geheim"), "{fault}");
        }
    }
}
