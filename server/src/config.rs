//! What a server is told when it starts.

use std::net::SocketAddr;
use std::path::PathBuf;

/// Command line and environment; every setting has both.
#[derive(Clone, Debug, clap::Parser)]
#[command(name = "waypost-server", version, about = "Tells robots where they have been before")]
pub struct Config {
    /// Directory of the database; made if it is missing.
    #[arg(long, env = "WAYPOST_DATA_DIR", default_value = "waypost-data", value_name = "DIR")]
    pub data_dir: PathBuf,
    /// Where robots connect (gRPC). Port 0 picks a free one.
    #[arg(long, env = "WAYPOST_GRPC_ADDRESS", default_value = "127.0.0.1:7600", value_name = "ADDRESS")]
    pub grpc_address: SocketAddr,
    /// Where people look (HTTP). Port 0 picks a free one.
    #[arg(long, env = "WAYPOST_HTTP_ADDRESS", default_value = "127.0.0.1:7601", value_name = "ADDRESS")]
    pub http_address: SocketAddr,
    /// Once the server listens, its addresses are written to this file as JSON: {"grpc": …, "http": …}.
    #[arg(long, env = "WAYPOST_READY_FILE", value_name = "FILE")]
    pub ready_file: Option<PathBuf>,
}
