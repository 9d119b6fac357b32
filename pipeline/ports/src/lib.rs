//! Ports that this program listens on: encryption and authentication.

mod auth;
mod door;

use std::sync::Arc;

use schemas::Fault;
use tokio_rustls::rustls::{
    self, ServerConfig,
    crypto::CryptoProvider,
    pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject},
};

pub use auth::{Token, TokenInterceptor};
pub use door::{PortClient, PortListener};

/// Cryptography provider of encrypted connections.
///
/// # Errors
/// Fails if this processor lacks the instructions that it needs.
pub fn cryptography() -> Result<Arc<CryptoProvider>, Fault> {
    #[cfg(target_arch = "x86_64")]
    let able = std::arch::is_x86_feature_detected!("aes")
        && std::arch::is_x86_feature_detected!("pclmulqdq")
        && std::arch::is_x86_feature_detected!("bmi1")
        && std::arch::is_x86_feature_detected!("bmi2")
        && std::arch::is_x86_feature_detected!("adx")
        && std::arch::is_x86_feature_detected!("avx2");
    #[cfg(target_arch = "aarch64")]
    let able = std::arch::is_aarch64_feature_detected!("aes")
        && std::arch::is_aarch64_feature_detected!("pmull")
        && std::arch::is_aarch64_feature_detected!("sha2");
    if !able {
        return Err(Fault::new(
            "encryption requires processor instructions that this machine lacks (AES, AVX2, ADX; SHA-2 on ARM)",
        ));
    }
    let provider = rustls_graviola::default_provider();
    // The call fails if a provider is already installed. This is no error, because this program installed it.
    let _ = provider.clone().install_default();
    Ok(Arc::new(provider))
}

/// TLS configuration of a server with a certificate chain and its key, PEM.
///
/// # Errors
/// Fails if the chain or the key is invalid.
pub fn encryption(certificates: &[u8], key: &[u8]) -> Result<Arc<ServerConfig>, Fault> {
    let wrong = |why: &dyn std::fmt::Display| {
        Fault::new(format!("the certificate or its key is invalid: {why}"))
            .help("give PEM files with `--tls-cert` and `--tls-key`")
    };
    let provider = cryptography().map_err(|fault| {
        fault.help(
            "listen on the loopback address, and encrypt the connections with a proxy that supports \
                                     HTTP/2",
        )
    })?;
    let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(certificates).collect();
    let chain = chain.map_err(|e| wrong(&e))?;
    let key = PrivateKeyDer::from_pem_slice(key).map_err(|e| wrong(&e))?;
    let builder = ServerConfig::builder_with_provider(provider).with_safe_default_protocol_versions();
    let builder = builder.map_err(|e| wrong(&e))?.with_no_client_auth();
    let config: Result<ServerConfig, rustls::Error> = builder.with_single_cert(chain, key);
    let mut config = config.map_err(|e| wrong(&e))?;
    config.alpn_protocols = vec![b"h2".to_vec()];
    Ok(Arc::new(config))
}
