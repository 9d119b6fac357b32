//! Key of a cluster: a secret that scheduler, workers and runs share. Each of their connections is encrypted by TLS,
//! and both sides prove in the handshake that they hold the key. The key itself is never sent.
//!
//! A signing key is derived from the secret. Both sides show the certificate made from it, and trust no other
//! certificate.

use std::{net::IpAddr, path::Path, sync::Arc, time::Duration};

use ballista_core::extension::EndpointOverrideFn;
use base64::{Engine, prelude::BASE64_STANDARD};
use graviola::signing::eddsa::Ed25519SigningKey;
use ports::cryptography;
use schemas::Fault;
use tokio_rustls::rustls::{
    RootCertStore, ServerConfig,
    pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer},
    server::WebPkiClientVerifier,
};
use tonic::transport::{Certificate, ClientTlsConfig, Endpoint, Identity};

/// Minimum number of characters of a key. A key must be long because an attacker may make any number of guesses.
const SHORTEST: usize = 32;
/// Environment variable that may hold the key.
pub const VARIABLE: &str = "MAGLINE_CLUSTER_KEY";
/// Name in the certificate.
const NAME: &str = "cluster.magline.invalid";
/// Maximum time of a connection attempt, and maximum waiting time for the head of an answer.
const LONGEST: Duration = Duration::from_secs(20);
/// Interval of keep-alive checks of a connection.
const ALIVE: Duration = Duration::from_secs(30);

/// Mutual authentication of the members of a cluster.
#[derive(Clone)]
pub enum ClusterTrust {
    /// Authentication by the key of the cluster.
    Key(Arc<ClusterIdentity>),
    /// No authentication, for tests on the loopback only.
    Loopback,
}

/// Identity of a member of a cluster: certificate and private key.
pub struct ClusterIdentity {
    /// Certificate, DER.
    certificate: Vec<u8>,
    /// Private key, PKCS #8.
    key: Vec<u8>,
}

impl std::fmt::Debug for ClusterTrust {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(match self {
            ClusterTrust::Key(_) => "by key",
            ClusterTrust::Loopback => "all",
        })
    }
}

impl ClusterTrust {
    /// Reads the key from a file, or else from the environment variable; `insecure` uses no key.
    ///
    /// # Errors
    /// Fails if there is no key, or if others can read or guess it.
    pub fn read(file: Option<&Path>, insecure: bool) -> Result<ClusterTrust, Fault> {
        let secret =
            match (file, insecure) {
                (None, true) => return Ok(ClusterTrust::Loopback),
                (Some(file), _) => secret_of(file)?,
                (None, false) => std::env::var(VARIABLE).map_err(|_| {
                    Fault::new("the cluster has no key, so anyone who can connect to its ports could run \
                            computations").help(format!(
                    "create a key with `openssl rand -hex 32 > cluster.key && chmod 600 cluster.key`, copy it to all \
                     machines, and give it with `--key-file cluster.key` or in the environment variable {VARIABLE}"
                ))
                })?,
            };
        ClusterIdentity::derive(&secret).map(|key| ClusterTrust::Key(Arc::new(key)))
    }

    /// Rejects an address that others can reach if no key is used.
    ///
    /// # Errors
    /// Fails with the address.
    pub fn admits(&self, address: IpAddr) -> Result<(), Fault> {
        match self {
            ClusterTrust::Loopback if !address.is_loopback() => {
                let what =
                    format!("`--insecure-loopback` requires no key, but other machines can connect to {address}");
                Err(Fault::new(what).help("listen on 127.0.0.1, or give a key with `--key-file`"))
            }
            ClusterTrust::Loopback | ClusterTrust::Key(_) => Ok(()),
        }
    }

    /// TLS configuration of a server; `None` without encryption.
    ///
    /// # Errors
    /// Fails if this processor cannot encrypt.
    pub fn server(&self) -> Result<Option<Arc<ServerConfig>>, Fault> {
        let ClusterTrust::Key(key) = self else { return Ok(None) };
        let wrong = |e: &dyn std::fmt::Display| Fault::bug(format!("cannot make the certificate of the cluster: {e}"));
        let provider = cryptography()?;
        let certificate = CertificateDer::from(key.certificate.clone());
        let mut roots = RootCertStore::empty();
        roots.add(certificate.clone()).map_err(|e| wrong(&e))?;
        let clients = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider.clone()).build();
        let own = PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(key.key.clone()));
        let builder = ServerConfig::builder_with_provider(provider).with_safe_default_protocol_versions();
        let builder = builder.map_err(|e| wrong(&e))?.with_client_cert_verifier(clients.map_err(|e| wrong(&e))?);
        let mut config = builder.with_single_cert(vec![certificate], own).map_err(|e| wrong(&e))?;
        config.alpn_protocols = vec![b"h2".to_vec()];
        Ok(Some(Arc::new(config)))
    }

    /// URL `https://HOST:PORT`, or `http://` without a key.
    pub fn url(&self, authority: &str) -> String {
        let scheme = if self.encrypts() { "https" } else { "http" };
        format!("{scheme}://{authority}")
    }

    /// Whether connections are encrypted.
    pub fn encrypts(&self) -> bool {
        matches!(self, ClusterTrust::Key(_))
    }

    /// Endpoint for a connection to HOST:PORT.
    ///
    /// # Errors
    /// Fails if the address is invalid.
    pub fn endpoint(&self, authority: &str) -> Result<Endpoint, tonic::transport::Error> {
        let endpoint = Endpoint::from_shared(self.url(authority))?
            .connect_timeout(LONGEST)
            .timeout(LONGEST)
            .tcp_nodelay(true)
            .http2_keep_alive_interval(ALIVE)
            .keep_alive_while_idle(true);
        let ClusterTrust::Key(key) = self else { return Ok(endpoint) };
        let certificate = pem("CERTIFICATE", &key.certificate);
        let tls = ClientTlsConfig::new()
            .domain_name(NAME)
            .ca_certificate(Certificate::from_pem(&certificate))
            .identity(Identity::from_pem(&certificate, pem("PRIVATE KEY", &key.key)));
        endpoint.tls_config(tls)
    }

    /// Function that configures the endpoints that Ballista connects to.
    pub fn endpoints(&self) -> EndpointOverrideFn {
        let trust = self.clone();
        Arc::new(move |endpoint| {
            let authority = endpoint.uri().authority().map(ToString::to_string).unwrap_or_default();
            Ok(trust.endpoint(&authority)?)
        })
    }
}

/// Secret in a file that no other user may read.
fn secret_of(file: &Path) -> Result<String, Fault> {
    use std::os::unix::fs::PermissionsExt;

    let shown = file.display();
    let unreadable = |e: std::io::Error| Fault::new(format!("cannot read the key in {shown}: {e}"));
    let about = std::fs::metadata(file).map_err(unreadable)?;
    if about.is_file() && about.permissions().mode() & 0o077 != 0 {
        let fault = Fault::new(format!("other users of this machine can read the key in {shown}"));
        return Err(fault.help(format!("run `chmod 600 {shown}`, and create a new key if others may have read it")));
    }
    std::fs::read_to_string(file).map_err(unreadable)
}

impl ClusterIdentity {
    /// Derives the identity from a secret.
    ///
    /// # Errors
    /// Fails if the secret is too short, or contains invalid characters.
    fn derive(secret: &str) -> Result<ClusterIdentity, Fault> {
        let secret = secret.trim();
        let fault = |what: String| Fault::new(what).help("create one with `openssl rand -hex 32`");
        if !secret.chars().all(|c| c.is_ascii_graphic()) {
            return Err(fault("the key must be one word of visible ASCII characters".to_owned()));
        }
        if secret.len() < SHORTEST {
            return Err(fault(format!("the key has {} characters; at least {SHORTEST} are required", secret.len())));
        }
        cryptography()?;
        let seed = blake3::derive_key("magline 2026-11 cluster: the signing key of its members", secret.as_bytes());
        // RFC 8410: PKCS #8 of an Ed25519 key.
        let inner = der(0x04, &[&seed]);
        let key = der(0x30, &[&der(0x02, &[&[0]]), &ed25519(), &der(0x04, &[&inner])]);
        let signing = Ed25519SigningKey::from_pkcs8_der(&key);
        let signing = signing.map_err(|e| Fault::bug(format!("cannot use the key of the cluster: {e:?}")))?;
        let certificate = certificate(&signing);
        Ok(ClusterIdentity { certificate, key })
    }
}

/// DER encoding of a value.
fn der(tag: u8, parts: &[&[u8]]) -> Vec<u8> {
    let content = parts.concat();
    let length = content.len();
    let mut value = vec![tag];
    match length {
        0..0x80 => value.push(length as u8),
        0x80..0x100 => value.extend([0x81, length as u8]),
        _ => value.extend([0x82, (length >> 8) as u8, length as u8]),
    }
    value.extend(content);
    value
}

/// DER name of the algorithm Ed25519.
fn ed25519() -> Vec<u8> {
    der(0x30, &[&der(0x06, &[&[0x2b, 0x65, 0x70]])])
}

/// Self-signed certificate of a key: X.509 version 3, without an expiry date.
fn certificate(key: &Ed25519SigningKey) -> Vec<u8> {
    let common_name = der(0x30, &[&der(0x06, &[&[0x55, 0x04, 0x03]]), &der(0x0c, &[NAME.as_bytes()])]);
    let name = der(0x30, &[&der(0x31, &[&common_name])]);
    let valid = der(0x30, &[&der(0x17, &[b"200101000000Z"]), &der(0x18, &[b"99991231235959Z"])]);
    let public = der(0x30, &[&ed25519(), &der(0x03, &[&[0], &key.public_key().as_bytes()])]);
    let names = der(0x30, &[&der(0x82, &[NAME.as_bytes()])]);
    let alternative = der(0x30, &[&der(0x06, &[&[0x55, 0x1d, 0x11]]), &der(0x04, &[&names])]);
    let extensions = der(0xa3, &[&der(0x30, &[&alternative])]);
    let version = der(0xa0, &[&der(0x02, &[&[2]])]);
    let serial = der(0x02, &[&[1]]);
    let body = der(0x30, &[&version, &serial, &ed25519(), &name, &valid, &name, &public, &extensions]);
    let signature = key.sign(&body);
    der(0x30, &[&body, &ed25519(), &der(0x03, &[&[0], &signature])])
}

fn pem(what: &str, der: &[u8]) -> String {
    format!("-----BEGIN {what}-----\n{}\n-----END {what}-----\n", BASE64_STANDARD.encode(der))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::os::unix::fs::PermissionsExt;

    use super::*;

    const SECRET: &str = "0123456789abcdef0123456789abcdef";

    #[test]
    fn unit_key_depends_only_on_the_secret() {
        let one = ClusterIdentity::derive(SECRET).unwrap();
        let same = ClusterIdentity::derive(&format!(" {SECRET}\n")).unwrap();
        let other = ClusterIdentity::derive("0123456789abcdef0123456789abcdeg").unwrap();
        assert!(one.certificate == same.certificate && one.certificate != other.certificate);
        // The certificate does not contain the secret.
        assert!(!one.certificate.windows(16).any(|w| SECRET.as_bytes().windows(16).any(|s| s == w)));
        for wrong in
            ["", "0123456789abcdef", "0123456789abcdef 0123456789abcdef", "\u{e9}123456789abcdef0123456789abcdef"]
        {
            assert!(ClusterIdentity::derive(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn unit_key_file_readable_by_others_is_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("cluster.key");
        std::fs::write(&file, SECRET).unwrap();
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o640)).unwrap();
        let fault = ClusterTrust::read(Some(&file), false).unwrap_err().to_string();
        assert!(fault.contains("can read the key") && !fault.contains(SECRET), "{fault}");
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).unwrap();
        assert!(ClusterTrust::read(Some(&file), false).unwrap().encrypts());
    }

    #[test]
    fn unit_only_the_loopback_is_served_without_a_key() {
        let insecure = ClusterTrust::read(None, true).unwrap();
        assert!(insecure.admits("127.0.0.1".parse().unwrap()).is_ok() && insecure.server().unwrap().is_none());
        for wide in ["0.0.0.0", "10.0.0.1", "::", "fe80::1"] {
            assert!(insecure.admits(wide.parse().unwrap()).is_err(), "{wide}");
        }
    }
}
