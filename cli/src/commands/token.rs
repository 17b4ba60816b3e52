//! `waypost token`: access to the server.

use clap::Subcommand;
use serde_json::json;
use waypost_client::{Client, ClientOptions, v1};

use crate::failure::Failure;
use crate::output::{Output, table};

#[derive(Subcommand)]
pub(crate) enum Command {
    /// Create a token and print its secret, which is shown only once
    Create {
        /// 1 to 63 of a-z, 0-9, - and _, beginning with a letter or digit
        name: String,
        /// What the token permits
        #[arg(long, value_enum)]
        role: v1::token::Role,
    },
    /// List tokens by name
    #[command(visible_alias = "list")]
    Ls,
    /// Delete a token; calls and streams that use it end
    #[command(visible_alias = "delete")]
    Rm {
        /// Name of the token
        name: String,
    },
}

pub(crate) async fn run(command: Command, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let client = Client::connect(server).await?;
    match command {
        Command::Create { name, role } => {
            let (token, secret) = client.create_token(&name, role).await?;
            output.result(&json!({ "token": token, "secret": secret }), |out| {
                writeln!(out, "{} {}", token.name, token.role().json_name())?;
                writeln!(out, "  secret  {secret}")?;
                writeln!(out, "  the server does not keep it: note it now, for --token or WAYPOST_TOKEN")
            })
        }
        Command::Ls => {
            let tokens = client.tokens().await?;
            output.result(&json!({ "tokens": tokens }), |out| {
                let rows = tokens.iter().map(|token| {
                    let name = token.name.strip_prefix("tokens/").unwrap_or(&token.name);
                    [name.to_owned(), token.role().json_name().to_owned()]
                });
                table(out, ["TOKEN", "ROLE"], rows)
            })
        }
        Command::Rm { name } => {
            client.delete_token(&name).await?;
            output.result(&json!({ "deleted": name }), |out| writeln!(out, "deleted {name}"))
        }
    }
}
