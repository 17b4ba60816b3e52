//! Both listeners over TLS, with and without certificates of clients.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, ExtendedKeyUsagePurpose, IsCa, KeyPair};
use tempfile::TempDir;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore};
use waypost_client::{Client, ClientOptions, Error};
use waypost_server::{Tls, TlsFiles};

use crate::harness::{
    Built, CommandLine, Server, ServerProcess, answers, as_words, import_model, in_time, map_request,
    run_to_its_end,
};

/// A certificate and its key, PEM.
struct Pair {
    certificate: String,
    key: String,
}

/// Issues certificates.
struct Authority(CertifiedIssuer<'static, KeyPair>);

impl Authority {
    fn new() -> Self {
        let mut params = CertificateParams::new(Vec::new()).unwrap();
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        Self(CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap())
    }

    fn pem(&self) -> String {
        self.0.pem()
    }

    fn issue(&self, name: &str, purpose: ExtendedKeyUsagePurpose) -> Pair {
        let mut params = CertificateParams::new(vec![name.to_owned()]).unwrap();
        params.extended_key_usages = vec![purpose];
        let key = KeyPair::generate().unwrap();
        Pair { certificate: params.signed_by(&key, &self.0).unwrap().pem(), key: key.serialize_pem() }
    }

    fn server(&self) -> Pair {
        self.issue("127.0.0.1", ExtendedKeyUsagePurpose::ServerAuth)
    }

    fn client(&self) -> Pair {
        self.issue("robot", ExtendedKeyUsagePurpose::ClientAuth)
    }
}

fn write(directory: &Path, name: &str, content: &str) -> PathBuf {
    let path = directory.join(name);
    std::fs::write(&path, content).unwrap();
    path
}

/// Files of a server that shows a certificate of `authority`.
fn files(directory: &Path, authority: &Authority, clients: Option<&Authority>) -> TlsFiles {
    let Pair { certificate, key } = authority.server();
    TlsFiles {
        certificate: write(directory, "server.crt", &certificate),
        key: write(directory, "server.key", &key),
        client_ca: clients.map(|clients| write(directory, "clients.crt", &clients.pem())),
        fleet_ca: None,
    }
}

async fn server(authority: &Authority, clients: Option<&Authority>) -> (Server, TempDir) {
    let directory = tempfile::tempdir().unwrap();
    let tls = Tls::load(&files(directory.path(), authority, clients)).unwrap();
    let server = Server::start_as(directory.path(), |server| server.with_tls(tls)).await;
    (server, directory)
}

/// Where the server's gRPC is, encrypted.
fn encrypted(server: &Server) -> ClientOptions {
    ClientOptions::new(server.endpoint().replace("http://", "https://"))
}

/// Connects and makes one call.
async fn call(options: ClientOptions) -> Result<(), Error> {
    in_time(async { Client::connect(options).await?.maps().await.map(drop) }).await
}

#[track_caller]
fn no_connection(result: Result<(), Error>, says: &str) {
    match result {
        Err(Error::Connection { reason, .. }) => {
            assert!(reason.to_lowercase().contains(says), "{reason:?} does not say {says:?}");
        }
        other => panic!("it was served: {other:?}"),
    }
}

/// The first line that the server answers `GET path` with, over TLS.
async fn get(
    at: SocketAddr,
    path: &str,
    authority: &Authority,
    identity: Option<&Pair>,
) -> Result<String, std::io::Error> {
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_slice(authority.pem().as_bytes()).unwrap()).unwrap();
    let config = ClientConfig::builder().with_root_certificates(roots);
    let config = match identity {
        Some(Pair { certificate, key }) => config
            .with_client_auth_cert(
                vec![CertificateDer::from_pem_slice(certificate.as_bytes()).unwrap()],
                PrivateKeyDer::from_pem_slice(key.as_bytes()).unwrap(),
            )
            .unwrap(),
        None => config.with_no_client_auth(),
    };
    let name = ServerName::try_from("127.0.0.1").unwrap();
    let exchange = async {
        let stream = TcpStream::connect(at).await?;
        let mut stream = TlsConnector::from(Arc::new(config)).connect(name, stream).await?;
        let request = format!("GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).await?;
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).await?;
        Ok(String::from_utf8_lossy(&answer).lines().next().unwrap_or_default().to_owned())
    };
    in_time(exchange).await
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_and_people_are_served_encrypted() {
    let (authority, other) = (Authority::new(), Authority::new());
    let (server, _directory) = server(&authority, None).await;
    let client = Client::connect(encrypted(&server).with_ca(authority.pem())).await.unwrap();
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    assert_eq!(answers(&client, "drive", "robot", (1..=3).map(as_words)).await.len(), 3);
    assert_eq!(get(server.http(), "/healthz", &authority, None).await.unwrap(), "HTTP/1.1 200 OK");

    no_connection(call(encrypted(&server).with_ca(other.pem())).await, "certificate");
    no_connection(call(encrypted(&server)).await, "certificate");
    let plain = call(ClientOptions::new(server.endpoint())).await;
    assert!(matches!(plain, Err(Error::Connection { .. })), "{plain:?}");
    let distrusted = get(server.http(), "/healthz", &other, None).await.unwrap_err();
    assert!(distrusted.to_string().contains("certificate"), "{distrusted}");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_without_the_certificate_that_is_asked_for_is_shut_out() {
    let (authority, clients, other) = (Authority::new(), Authority::new(), Authority::new());
    let (server, _directory) = server(&authority, Some(&clients)).await;
    let options = || encrypted(&server).with_ca(authority.pem());
    let with = |pair: &Pair| options().with_identity(&pair.certificate, &pair.key);
    let (right, wrong) = (clients.client(), other.client());
    call(with(&right)).await.unwrap();
    let right_over_http = get(server.http(), "/healthz", &authority, Some(&right)).await;
    assert_eq!(right_over_http.unwrap(), "HTTP/1.1 200 OK");
    for shut_out in [call(options()).await, call(with(&wrong)).await] {
        assert!(matches!(shut_out, Err(Error::Connection { .. })), "{shut_out:?}");
    }
    for identity in [None, Some(&wrong)] {
        let shut_out = get(server.http(), "/healthz", &authority, identity).await;
        assert!(shut_out.is_err(), "{shut_out:?}");
    }
    // And nobody else was disturbed.
    call(with(&right)).await.unwrap();
    server.stop().await;
}

#[test]
fn the_command_lines_take_certificates_from_files() {
    let (authority, clients, directory) = (Authority::new(), Authority::new(), tempfile::tempdir().unwrap());
    let TlsFiles { certificate, key, client_ca, fleet_ca: _ } =
        files(directory.path(), &authority, Some(&clients));
    let text = |path: &PathBuf| path.to_str().unwrap().to_owned();
    let (certificate, key, client_ca) = (text(&certificate), text(&key), text(&client_ca.unwrap()));
    let options = [
        "--tls-certificate",
        &certificate,
        "--tls-key",
        &key,
        "--tls-client-ca",
        &client_ca,
        "--log-format=json",
    ];
    let data = directory.path().join("data");
    let server = ServerProcess::start_with(&data, &options);

    let endpoint = server.endpoint().replace("http://", "https://");
    let ca = text(&write(directory.path(), "ca.crt", &authority.pem()));
    let mine = clients.client();
    let mine_certificate = text(&write(directory.path(), "robot.crt", &mine.certificate));
    let mine_key = text(&write(directory.path(), "robot.key", &mine.key));
    let waypost = |arguments: &[&str]| {
        let mut command = Built::command("waypost");
        command.args(["map", "ls", "--server", &endpoint]).args(arguments);
        let output = run_to_its_end(command);
        (output.status.code().unwrap(), String::from_utf8(output.stderr).unwrap())
    };
    let right = ["--ca", &ca, "--client-cert", &mine_certificate, "--client-key", &mine_key];
    assert_eq!(waypost(&right), (0, String::new()));
    let (code, stderr) = waypost(&right[2..]);
    assert!(code == 3 && stderr.contains("--ca or WAYPOST_CA"), "{stderr}");
    let (code, stderr) = waypost(&right[..2]);
    assert!(code == 3 && stderr.contains("--client-cert and --client-key"), "{stderr}");
    let foreign = authority.client();
    let foreign_certificate = text(&write(directory.path(), "foreign.crt", &foreign.certificate));
    let foreign_key = text(&write(directory.path(), "foreign.key", &foreign.key));
    let (code, stderr) =
        waypost(&["--ca", &ca, "--client-cert", &foreign_certificate, "--client-key", &foreign_key]);
    assert!(code == 3 && stderr.contains("--client-cert and --client-key"), "{stderr}");
    let mut plain = Built::command("waypost");
    plain.args(["map", "ls", "--server", &server.endpoint()]);
    let output = run_to_its_end(plain);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(
        output.status.code() == Some(3) && stderr.contains("may speak TLS: name it with https://"),
        "{stderr}"
    );
    let (code, stderr) = waypost(&right[..4]);
    assert!(code == 1 && stderr.contains("give both --client-cert and --client-key"), "{stderr}");
    server.stop();

    // The key of another pair.
    let other = text(&write(directory.path(), "other.key", &authority.server().key));
    let mut command = Built::command("waypost-server");
    command.args(["--tls-certificate", &certificate, "--tls-key", &other, "--data-dir"]).arg(&data);
    let output = run_to_its_end(command);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr.contains("other.key is not the one of the certificate"), "{stderr}");
}

/// Certificates protect nothing on a way that is not encrypted: who gives some is told so.
#[test]
fn certificates_for_an_address_that_is_not_encrypted_are_refused() {
    let (authority, directory) = (Authority::new(), tempfile::tempdir().unwrap());
    let file = |name: &str, content: &str| {
        let path = write(directory.path(), name, content);
        path.to_str().unwrap().to_owned()
    };
    let ca = file("ca.crt", &authority.pem());
    let mine = authority.client();
    let (certificate, key) = (file("robot.crt", &mine.certificate), file("robot.key", &mine.key));
    let waypost = CommandLine::new();
    let expected = format!(
        "certificates are given, but {} is not encrypted; write https:// or leave them out",
        waypost.endpoint()
    );
    for given in [&["--ca", &ca][..], &["--client-cert", &certificate, "--client-key", &key]] {
        let (code, said) = waypost.fails(&[&["map", "create", "hall"][..], given].concat());
        assert_eq!(code, 2, "{said}");
        assert!(said.contains(&expected), "{said}");
    }
    let maps = waypost.json(&["map", "ls"]);
    assert_eq!(maps["maps"].as_array().unwrap().len(), 0, "{maps}");
}
