//! `waypost token`: who may use the server.

use clap::{Subcommand, ValueEnum};
use serde::Serialize;
use serde_json::json;
use waypost_client::{Client, ClientOptions, v1};

use crate::failure::Failure;
use crate::output::{Output, table};

#[derive(Subcommand)]
pub(crate) enum Command {
    /// Make a token and print its secret, which is shown this once
    Create {
        /// 1 to 63 of a-z, 0-9, - and _, beginning with a letter or digit
        name: String,
        /// What its holder may do
        #[arg(long, value_enum)]
        role: Role,
    },
    /// List tokens by name
    #[command(visible_alias = "list")]
    Ls,
    /// Delete a token; what is being done with it ends
    Rm {
        /// Name of the token
        name: String,
    },
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum Role {
    /// May stream into maps, query and read
    Robot,
    /// May do everything
    Admin,
}

#[derive(Serialize)]
struct TokenView {
    name: String,
    role: &'static str,
    create_time_ns: i64,
}

impl From<v1::Token> for TokenView {
    fn from(token: v1::Token) -> Self {
        let role = match token.role() {
            v1::token::Role::Unspecified => "unspecified",
            v1::token::Role::Robot => "robot",
            v1::token::Role::Admin => "admin",
        };
        let v1::Token { name, role: _, create_time_ns } = token;
        Self { name, role, create_time_ns }
    }
}

pub(crate) async fn run(command: Command, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let client = Client::connect(server).await?;
    match command {
        Command::Create { name, role } => {
            let role = match role {
                Role::Robot => v1::token::Role::Robot,
                Role::Admin => v1::token::Role::Admin,
            };
            let (token, secret) = client.create_token(&name, role).await?;
            let TokenView { name, role, create_time_ns } = token.into();
            let object =
                json!({ "name": name, "role": role, "create_time_ns": create_time_ns, "secret": secret });
            output.result(&object, |out| {
                writeln!(out, "{name} {role}")?;
                writeln!(out, "  secret  {secret}")?;
                writeln!(out, "  the server does not keep it: note it now, for --token or WAYPOST_TOKEN")
            })
        }
        Command::Ls => {
            let tokens: Vec<TokenView> = client.tokens().await?.into_iter().map(TokenView::from).collect();
            output.result(&json!({ "tokens": tokens }), |out| {
                let rows = tokens.iter().map(|token| {
                    let name = token.name.strip_prefix("tokens/").unwrap_or(&token.name);
                    [name.to_owned(), token.role.to_owned()]
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
