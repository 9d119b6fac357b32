//! Connections to object stores, with the credentials of the environment.

use schemas::Fault;

use super::{
    address::{ObjectAddress, ObjectStoreScheme},
    bucket::Bucket,
};

/// Checks that this program can use object stores.
///
/// # Errors
/// Fails if the program is built without object stores.
pub fn supported() -> Result<(), Fault> {
    if cfg!(feature = "object-stores") {
        return Ok(());
    }
    let fault = Fault::new("this magline was built without the feature `object-stores` (s3://, gs://, az://)");
    Err(fault.help("build magline with `cargo build --features object-stores`, or use a folder"))
}

/// Endpoint of a kind of store, or the account for Azure, from the environment; empty for the provider's own endpoint.
pub fn endpoint(scheme: ObjectStoreScheme) -> String {
    let set = |name: &&str| std::env::var(name).ok().filter(|v| !v.is_empty());
    let names: &[&str] = match scheme {
        ObjectStoreScheme::S3 => &["AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT"],
        ObjectStoreScheme::Gs => &["GOOGLE_BASE_URL"],
        ObjectStoreScheme::Az => &["AZURE_STORAGE_ENDPOINT", "AZURE_ENDPOINT", "AZURE_STORAGE_ACCOUNT_NAME"],
    };
    let named = names.iter().find_map(set);
    #[cfg(feature = "object-stores")]
    let named = named.or_else(|| match scheme {
        ObjectStoreScheme::S3 => super::profile::AwsProfile::chosen().ok().flatten()?.endpoint_url,
        ObjectStoreScheme::Gs | ObjectStoreScheme::Az => None,
    });
    named.unwrap_or_default()
}

/// Objects below `address`.
///
/// # Errors
/// Fails if this program is built without object stores, or if the environment is invalid. The first request checks
/// that the bucket exists and is accessible.
pub fn connect(address: &ObjectAddress) -> Result<Bucket, Fault> {
    supported()?;
    open(address)
}

#[cfg(not(feature = "object-stores"))]
fn open(_: &ObjectAddress) -> Result<Bucket, Fault> {
    Err(Fault::bug("a connection is requested from a build without object stores"))
}

#[cfg(feature = "object-stores")]
fn open(address: &ObjectAddress) -> Result<Bucket, Fault> {
    use std::{sync::Arc, time::Duration};

    use object_store::{
        BackoffConfig, ClientConfigKey, ObjectStore, RetryConfig,
        aws::{AmazonS3Builder, AmazonS3ConfigKey, Checksum},
        azure::{AzureConfigKey, MicrosoftAzureBuilder},
        gcp::{GoogleCloudStorageBuilder, GoogleConfigKey},
    };

    use super::client::SameOriginConnector;

    /// Default time limits of a request and of establishing its connection.
    const TIMES: [(ClientConfigKey, &str, &str); 2] = [
        (ClientConfigKey::Timeout, "TIMEOUT", "60 seconds"),
        (ClientConfigKey::ConnectTimeout, "CONNECT_TIMEOUT", "5 seconds"),
    ];
    // Up to eight retries within two minutes, with pauses of 0.2 s, 0.4 s and so on, up to 10 s.
    let retry = RetryConfig {
        backoff: BackoffConfig {
            init_backoff: Duration::from_millis(200),
            max_backoff: Duration::from_secs(10),
            base: 2.0,
        },
        max_retries: 8,
        retry_timeout: super::bucket::RETRY_TIMEOUT,
    };
    let unset = |prefix: &str| {
        let prefix = prefix.to_owned();
        TIMES.into_iter().filter(move |(_, name, _)| std::env::var_os(format!("{prefix}_{name}")).is_none())
    };
    let bucket = address.bucket.as_str();
    let wrong = |e: object_store::Error| {
        let text = super::redacted(&e.to_string());
        Fault::machine(format!("cannot use {}://{bucket}: {text}", address.scheme.as_str()))
            .help("set endpoint and credentials in the environment as described in pipeline/OBJECTS.md")
    };
    let objects: Arc<dyn ObjectStore> = match address.scheme {
        ObjectStoreScheme::S3 => {
            let mut builder = AmazonS3Builder::new()
                .with_bucket_name(bucket)
                .with_retry(retry)
                .with_http_connector(SameOriginConnector);
            builder = builder.with_checksum_algorithm(Checksum::SHA256);
            // An empty variable counts as unset.
            for (name, value) in std::env::vars_os() {
                let (Some(name), Some(value)) = (name.to_str(), value.to_str().filter(|v| !v.is_empty())) else {
                    continue;
                };
                if let (true, Ok(key)) = (name.starts_with("AWS_"), name.to_ascii_lowercase().parse()) {
                    builder = builder.with_config(key, value);
                }
            }
            if let Some(profile) = super::profile::AwsProfile::chosen()? {
                builder = profile.into_builder(builder)?;
            }
            let endpoint = endpoint(address.scheme);
            if !endpoint.is_empty() {
                allowed(&endpoint)?;
                builder = builder.with_endpoint(endpoint);
            }
            for (key, _, value) in unset("AWS") {
                builder = builder.with_config(AmazonS3ConfigKey::Client(key), value);
            }
            Arc::new(builder.build().map_err(wrong)?)
        }
        ObjectStoreScheme::Gs => {
            no_password(&endpoint(address.scheme))?;
            let mut builder = GoogleCloudStorageBuilder::from_env().with_bucket_name(bucket).with_retry(retry);
            builder = builder.with_http_connector(SameOriginConnector);
            for (key, _, value) in unset("GOOGLE") {
                builder = builder.with_config(GoogleConfigKey::Client(key), value);
            }
            Arc::new(builder.build().map_err(wrong)?)
        }
        ObjectStoreScheme::Az => {
            no_password(&endpoint(address.scheme))?;
            let mut builder = MicrosoftAzureBuilder::from_env().with_container_name(bucket).with_retry(retry);
            builder = builder.with_http_connector(SameOriginConnector);
            for (key, _, value) in unset("AZURE") {
                builder = builder.with_config(AzureConfigKey::Client(key), value);
            }
            Arc::new(builder.build().map_err(wrong)?)
        }
    };
    Ok(Bucket::new(objects, address.clone()))
}

/// Checks an S3 endpoint: it must be an address, with TLS unless the environment permits plain HTTP.
#[cfg(feature = "object-stores")]
fn allowed(endpoint: &str) -> Result<(), Fault> {
    no_password(endpoint)?;
    let plain = std::env::var("AWS_ALLOW_HTTP").is_ok_and(|v| matches!(v.to_ascii_lowercase().as_str(), "true" | "1"));
    match url::Url::parse(endpoint).ok().filter(|url| url.has_host()).as_ref().map(url::Url::scheme) {
        Some("https") => Ok(()),
        Some("http") if plain => Ok(()),
        Some("http") => Err(Fault::machine("the S3 endpoint does not use TLS")
            .help("set AWS_ALLOW_HTTP=true to permit a connection without TLS, or use an https:// endpoint")),
        Some(_) | None => Err(Fault::machine("the S3 endpoint (AWS_ENDPOINT_URL) is not a valid address")
            .help("write the endpoint as https://HOST or http://HOST:PORT")),
    }
}

/// Rejects an endpoint with a user or a password, which would be displayed with the endpoint.
#[cfg(feature = "object-stores")]
fn no_password(endpoint: &str) -> Result<(), Fault> {
    match url::Url::parse(endpoint) {
        Ok(url) if !url.username().is_empty() || url.password().is_some() || url.query().is_some() => {
            Err(Fault::machine("the endpoint of the object store contains a user, a password or a query").help(
                "write the endpoint as https://HOST or http://HOST:PORT; set credentials as described in \
                 pipeline/OBJECTS.md",
            ))
        }
        _ => Ok(()),
    }
}
