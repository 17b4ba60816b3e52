//! Certificates that a server shows, and asks for.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustls::crypto::ring;
use rustls::pki_types::pem::{Error as PemError, PemObject};
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::server::WebPkiClientVerifier;
use rustls::{ClientConfig, RootCertStore, ServerConfig};

/// Checked certificates, for both listeners.
#[derive(Clone)]
pub struct Tls {
    /// Authorities of clients, PEM.
    pub(crate) client_ca: Option<Vec<u8>>,
    /// For robots: HTTP/2 alone.
    pub(crate) grpc: Arc<ServerConfig>,
    /// For people: either version of HTTP.
    pub(crate) http: Arc<ServerConfig>,
    /// For asking other servers of the same fleet.
    pub(crate) neighbours: Arc<ClientConfig>,
}

/// Files that a server's certificates are in; all PEM.
#[derive(Clone, Debug, PartialEq)]
pub struct TlsFiles {
    /// The server's certificate, then those that lead from it to its authority.
    pub certificate: PathBuf,
    /// The private key of the certificate.
    pub key: PathBuf,
    /// Authorities of clients. If there are any, a client without a certificate of theirs is refused.
    pub client_ca: Option<PathBuf>,
    /// Authorities of the other servers of a fleet; `None` if their certificates are this one's, or lead to the same.
    pub fleet_ca: Option<PathBuf>,
}

/// Why certificates cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// A file cannot be read.
    #[error("cannot read {path}: {source}; give a file that exists and that this user may read")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file holds something else.
    #[error(
        "{path} holds no {what} in PEM ({reason}); it must have a part that begins with -----BEGIN {label}-----"
    )]
    Pem {
        /// The file.
        path: PathBuf,
        /// What it should hold.
        what: &'static str,
        /// How such a part begins.
        label: &'static str,
        /// What the parser said.
        reason: String,
    },
    /// Key and certificate belong to different pairs.
    #[error(
        "the key {key} is not the one of the certificate {certificate} (the first in the file); give the key that \
         the certificate was requested with"
    )]
    WrongKey {
        /// File of the key.
        key: PathBuf,
        /// File of the certificate.
        certificate: PathBuf,
    },
    /// Something else is wrong with them.
    #[error("{path} cannot be used: {reason}; have the certificate issued anew")]
    Unusable {
        /// The file.
        path: PathBuf,
        /// What rustls said.
        reason: String,
    },
}

impl Tls {
    /// Reads certificates and key, and checks that they fit.
    ///
    /// # Errors
    /// If a file is missing, is no PEM or does not fit with the others; the message says which.
    pub fn load(files: &TlsFiles) -> Result<Self, TlsError> {
        let TlsFiles { certificate, key, client_ca, fleet_ca } = files;
        let certificate_pem = read(certificate)?;
        let key_pem = read(key)?;
        let client_ca_pem = client_ca.as_deref().map(read).transpose()?;
        let chain = certificates(certificate, &certificate_pem)?;
        let private = PrivateKeyDer::from_pem_slice(&key_pem)
            .map_err(|error| not_pem(key, "private key", "PRIVATE KEY", &error))?;

        let unusable = |path: &Path, reason: String| TlsError::Unusable { path: path.to_owned(), reason };
        let provider = Arc::new(ring::default_provider());
        let builder = ServerConfig::builder_with_provider(provider.clone())
            .with_safe_default_protocol_versions()
            .map_err(|error| unusable(certificate, error.to_string()))?;
        let builder = match (client_ca, &client_ca_pem) {
            (Some(path), Some(pem)) => {
                let roots = Arc::new(authorities(path, pem)?);
                let verifier = WebPkiClientVerifier::builder_with_provider(roots, provider.clone())
                    .build()
                    .map_err(|error| unusable(path, error.to_string()))?;
                builder.with_client_cert_verifier(verifier)
            }
            (_, _) => builder.with_no_client_auth(),
        };
        let wrong_pair = |error| match error {
            rustls::Error::InconsistentKeys(_) => {
                TlsError::WrongKey { key: key.clone(), certificate: certificate.clone() }
            }
            other => unusable(certificate, other.to_string()),
        };
        let mut http = builder.with_single_cert(chain.clone(), private.clone_key()).map_err(wrong_pair)?;
        let neighbours = match fleet_ca {
            Some(path) => authorities(path, &read(path)?)?,
            None => authorities(certificate, &certificate_pem)?,
        };
        let mut neighbours = ClientConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .map_err(|error| unusable(certificate, error.to_string()))?
            .with_root_certificates(neighbours)
            .with_client_auth_cert(chain, private)
            .map_err(wrong_pair)?;
        neighbours.alpn_protocols = vec![b"h2".to_vec()];
        let mut grpc = http.clone();
        grpc.alpn_protocols = vec![b"h2".to_vec()];
        http.alpn_protocols = vec![b"h2".to_vec(), b"http/1.1".to_vec()];
        let neighbours = Arc::new(neighbours);
        Ok(Self { client_ca: client_ca_pem, grpc: Arc::new(grpc), http: Arc::new(http), neighbours })
    }
}

impl fmt::Debug for Tls {
    /// Without the key.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let asks_for_certificates = self.client_ca.is_some();
        formatter.debug_struct("Tls").field("asks_for_certificates", &asks_for_certificates).finish()
    }
}

fn read(path: &Path) -> Result<Vec<u8>, TlsError> {
    std::fs::read(path).map_err(|source| TlsError::Unreadable { path: path.to_owned(), source })
}

/// At least one.
fn certificates(path: &Path, pem: &[u8]) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let bad = |error: &PemError| not_pem(path, "certificate", "CERTIFICATE", error);
    let chain: Vec<CertificateDer<'static>> =
        CertificateDer::pem_slice_iter(pem).collect::<Result<_, _>>().map_err(|error| bad(&error))?;
    if chain.is_empty() {
        return Err(bad(&PemError::NoItemsFound));
    }
    Ok(chain)
}

/// The certificates of a file, as those that others must come from.
fn authorities(path: &Path, pem: &[u8]) -> Result<RootCertStore, TlsError> {
    let mut roots = RootCertStore::empty();
    for authority in certificates(path, pem)? {
        roots
            .add(authority)
            .map_err(|error| TlsError::Unusable { path: path.to_owned(), reason: error.to_string() })?;
    }
    Ok(roots)
}

fn not_pem(path: &Path, what: &'static str, label: &'static str, error: &PemError) -> TlsError {
    TlsError::Pem { path: path.to_owned(), what, label, reason: error.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Pair {
        certificate: String,
        key: String,
    }

    fn pair() -> Pair {
        let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
        Pair { certificate: made.cert.pem(), key: made.signing_key.serialize_pem() }
    }

    /// Loads files of that content; `None` is a file that is missing.
    fn load(certificate: &str, key: &str, client_ca: Option<&str>) -> Result<Tls, String> {
        let directory = tempfile::tempdir().unwrap();
        let file = |name: &str, content: &str| {
            let path = directory.path().join(name);
            std::fs::write(&path, content).unwrap();
            path
        };
        let files = TlsFiles {
            certificate: file("server.crt", certificate),
            key: file("server.key", key),
            client_ca: client_ca.map(|content| file("clients.crt", content)),
            fleet_ca: None,
        };
        Tls::load(&files).map_err(|error| error.to_string())
    }

    #[test]
    fn a_pair_is_taken_with_and_without_authorities_of_clients() {
        let Pair { certificate, key } = pair();
        assert!(load(&certificate, &key, None).unwrap().client_ca.is_none());
        assert!(load(&certificate, &key, Some(&pair().certificate)).unwrap().client_ca.is_some());
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let (one, other) = (pair(), pair());
        let cases = [
            (load(&one.certificate, &other.key, None), "server.key is not the one of the certificate"),
            (load(&one.key, &one.key, None), "server.crt holds no certificate in PEM"),
            (load("", &one.key, None), "server.crt holds no certificate in PEM"),
            (load(&one.certificate, "nonsense", None), "server.key holds no private key in PEM"),
            (load(&one.certificate, &one.certificate, None), "-----BEGIN PRIVATE KEY-----"),
            (load(&one.certificate, &one.key, Some("")), "clients.crt holds no certificate in PEM"),
        ];
        for (loaded, says) in cases {
            let message = loaded.unwrap_err();
            assert!(message.contains(says), "{message:?} does not say {says:?}");
        }
        let missing = TlsFiles {
            certificate: PathBuf::from("/nowhere/server.crt"),
            key: PathBuf::from("/nowhere/server.key"),
            client_ca: None,
            fleet_ca: None,
        };
        let message = Tls::load(&missing).unwrap_err().to_string();
        assert!(message.contains("cannot read /nowhere/server.crt"), "{message}");
    }

    #[test]
    fn the_key_is_not_shown() {
        let Pair { certificate, key } = pair();
        let shown = format!("{:?}", load(&certificate, &key, None).unwrap());
        assert_eq!(shown, "Tls { asks_for_certificates: false }");
    }
}
