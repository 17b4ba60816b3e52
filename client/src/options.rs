//! Address, token and certificates.

use std::fmt;

use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::transport::{Certificate, ClientTlsConfig, Identity};
use tonic::{Request, Status};

use crate::error::Error;

/// A server's address, with the token and the certificates for it.
///
/// Where neither is needed, the address alone converts into options.
#[derive(Clone)]
pub struct ClientOptions {
    pub(crate) endpoint: String,
    token: Option<String>,
    ca: Option<Vec<u8>>,
    identity: Option<Identity>,
}

impl ClientOptions {
    /// A server at `http://HOST:PORT`, `https://HOST:PORT`, or `HOST:PORT`, which is encrypted if certificates are given.
    pub fn new(endpoint: impl Into<String>) -> Self {
        Self { endpoint: endpoint.into(), token: None, ca: None, identity: None }
    }

    /// Sends the secret of a token with every call, and when sessions reconnect.
    #[must_use]
    pub fn with_token(self, secret: impl Into<String>) -> Self {
        Self { token: Some(secret.into()), ..self }
    }

    /// Trusts only the authorities in `pem` to issue the server's certificate. Without this, those
    /// that the system trusts.
    #[must_use]
    pub fn with_ca(self, pem: impl Into<Vec<u8>>) -> Self {
        Self { ca: Some(pem.into()), ..self }
    }

    /// Authenticates with a certificate, for servers that require one; both in PEM.
    #[must_use]
    pub fn with_identity(self, certificate: impl AsRef<[u8]>, key: impl AsRef<[u8]>) -> Self {
        Self { identity: Some(Identity::from_pem(certificate, key)), ..self }
    }

    /// The server's address, with its scheme.
    pub(crate) fn address(&self) -> String {
        let Self { endpoint, token: _, ca, identity } = self;
        let scheme = match (ca, identity) {
            _ if endpoint.contains("://") => "",
            (None, None) => "http://",
            (Some(_), _) | (_, Some(_)) => "https://",
        };
        format!("{scheme}{endpoint}")
    }

    /// The header of every call.
    pub(crate) fn bearer(&self) -> Result<Bearer, Error> {
        let header = self.token.as_ref().map(|token| format!("Bearer {}", token.trim()).parse());
        let mut header: Option<MetadataValue<Ascii>> = header.transpose().map_err(|_| {
            Error::Options("the token has characters that no token has; copy it again".to_owned())
        })?;
        if let Some(header) = &mut header {
            header.set_sensitive(true);
        }
        Ok(Bearer { header })
    }

    /// The TLS configuration of an `https` address.
    pub(crate) fn tls(&self) -> Result<ClientTlsConfig, Error> {
        let mut tls = match &self.ca {
            Some(pem) if !pem.windows(CERTIFICATE.len()).any(|window| window == CERTIFICATE.as_bytes()) => {
                return Err(Error::Options(format!(
                    "the authority's certificate is not in PEM; it must have a part that begins with {CERTIFICATE}"
                )));
            }
            Some(pem) => ClientTlsConfig::new().ca_certificate(Certificate::from_pem(pem)),
            None => ClientTlsConfig::new().with_enabled_roots(),
        };
        if let Some(identity) = &self.identity {
            tls = tls.identity(identity.clone());
        }
        Ok(tls)
    }

    /// Checks an `http` address: it takes no certificates.
    pub(crate) fn check_plain(&self) -> Result<(), Error> {
        if self.ca.is_none() && self.identity.is_none() {
            return Ok(());
        }
        Err(Error::Options(format!(
            "certificates are given, but {} is not encrypted; write https:// or leave them out",
            self.endpoint
        )))
    }
}

const CERTIFICATE: &str = "-----BEGIN CERTIFICATE-----";

impl fmt::Debug for ClientOptions {
    /// Without secrets.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("ClientOptions").field("endpoint", &self.endpoint).finish_non_exhaustive()
    }
}

impl From<&str> for ClientOptions {
    fn from(endpoint: &str) -> Self {
        Self::new(endpoint)
    }
}

impl From<&String> for ClientOptions {
    fn from(endpoint: &String) -> Self {
        Self::new(endpoint)
    }
}

impl From<&ClientOptions> for ClientOptions {
    fn from(options: &ClientOptions) -> Self {
        options.clone()
    }
}

/// Adds the token to every call.
#[derive(Clone, Default)]
pub(crate) struct Bearer {
    header: Option<MetadataValue<Ascii>>,
}

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(header) = &self.header {
            request.metadata_mut().insert("authorization", header.clone());
        }
        Ok(request)
    }
}

impl fmt::Debug for Bearer {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Bearer")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_are_not_shown() {
        let options = ClientOptions::new("http://h:1").with_token("waypost_secret");
        let shown = format!("{options:?} {:?}", options.bearer().unwrap());
        assert!(shown.contains("http://h:1") && !shown.contains("secret"), "{shown}");
    }

    #[test]
    fn the_token_goes_with_a_call_and_none_without_one() {
        let sent = |options: ClientOptions| {
            let request = options.bearer().unwrap().call(Request::new(())).unwrap();
            request.metadata().get("authorization").map(|value| value.to_str().unwrap().to_owned())
        };
        assert_eq!(sent(ClientOptions::new("http://h:1")), None);
        let with_token = ClientOptions::new("http://h:1").with_token("waypost_1\n");
        assert_eq!(sent(with_token).as_deref(), Some("Bearer waypost_1"));
    }

    #[test]
    fn what_cannot_be_sent_or_trusted_is_refused() {
        let options = ClientOptions::new("https://h:1");
        assert!(matches!(options.clone().with_token("a\nb").bearer(), Err(Error::Options(_))));
        assert!(matches!(options.clone().with_ca("nonsense").tls(), Err(Error::Options(_))));
        assert!(matches!(options.clone().with_ca(CERTIFICATE).check_plain(), Err(Error::Options(_))));
        assert!(options.check_plain().is_ok());
    }
}
