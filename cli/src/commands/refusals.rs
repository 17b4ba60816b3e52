//! `waypost refusals`: what the server refused, and whom.

use serde_json::json;
use waypost_client::{Client, ClientOptions, v1};

use crate::failure::Failure;
use crate::output::{Output, in_words, table};

/// Show what the server refused since it began, newest first, with what it said
///
/// The last 1000 are kept: calls, requests, and frames, wheel reports and goals on open streams. Asks for a token of
/// an administrator of the whole server, where it has tokens.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Show no more than so many
    #[arg(long, value_name = "COUNT", default_value = "50")]
    most: usize,
}

pub(crate) async fn run(
    Arguments { most }: Arguments,
    server: &ClientOptions,
    output: Output,
) -> Result<(), Failure> {
    let mut refusals = Client::connect(server).await?.refusals().await?;
    let kept = refusals.len();
    refusals.truncate(most);
    output.result(&json!({ "refusals": refusals }), |out| {
        if refusals.is_empty() && kept == 0 {
            return writeln!(out, "nothing was refused since the server began");
        }
        table(out, ["LAST", "TIMES", "WHO", "WHAT", "WHY", "MESSAGE"], refusals.iter().map(row))?;
        match kept - refusals.len() {
            0 => Ok(()),
            older => writeln!(out, "and {older} older; --most {kept} shows all"),
        }
    })
}

fn row(refusal: &v1::Refusal) -> [String; 6] {
    let v1::Refusal { last_time_ns, first_time_ns: _, times, request, code, message, peer, token, stream } =
        refusal;
    let who = [token.strip_prefix("tokens/").unwrap_or(token), peer];
    let who: Vec<&str> = who.into_iter().filter(|part| !part.is_empty()).collect();
    let who = if who.is_empty() { "-".to_owned() } else { who.join(" from ") };
    let what = if stream.is_empty() { request } else { stream };
    [in_words(*last_time_ns), times.to_string(), who, what.clone(), code.clone(), message.clone()]
}
