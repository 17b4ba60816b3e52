//! `waypost token`: access to the server.

use std::io::{self, Write};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use clap::{Args, Subcommand};
use serde_json::json;
use waypost_client::{Client, ClientOptions, v1};
use waypost_proto::flags::{QuotasFlags, seconds};

use crate::failure::Failure;
use crate::files::Asking;
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
        #[command(flatten)]
        limits: Limits,
    },
    /// Give a token a new secret and print it; the one before stays good for a while
    Rotate {
        /// Name of the token
        name: String,
        /// How long the secret before stays good, at most 7d; 0s ends it at once [default: 1h]
        #[arg(long, value_name = "TIME", value_parser = seconds)]
        overlap: Option<u32>,
        /// After how long from now the token expires; when it would have, if left out
        #[arg(long, value_name = "TIME", value_parser = seconds)]
        expires_in: Option<u32>,
    },
    /// Change how much the holder of a token may have and send; its secret stays, and open streams go on
    #[command(visible_alias = "update")]
    Limit {
        /// Name of the token
        name: String,
        #[command(flatten)]
        quotas: QuotasFlags,
        /// Quotas that are lifted; names with commas between them
        #[arg(long, value_name = "QUOTA", value_delimiter = ',', value_enum)]
        lift: Vec<v1::quotas::Kind>,
    },
    /// List tokens by name
    #[command(visible_alias = "list")]
    Ls,
    /// Delete a token; calls and streams that use it end
    #[command(visible_alias = "delete")]
    Rm {
        /// Name of the token
        name: String,
        /// Do not ask: needed where nobody can answer, as in a script
        #[arg(long)]
        yes: bool,
    },
}

/// How a token is limited.
#[derive(Args)]
pub(crate) struct Limits {
    /// What a robot's token may do, where that is less than all; names with commas between them
    #[arg(long, value_name = "ABILITY", value_delimiter = ',', value_enum)]
    may: Vec<v1::token::Ability>,
    /// A map that it reaches, or the beginning of names and an asterisk, as in 'floor2-*'; may be given several times
    #[arg(long = "map", value_name = "MAP")]
    maps: Vec<String>,
    /// After how long it expires, as in 90s, 12h or 30d
    #[arg(long, value_name = "TIME", value_parser = seconds)]
    expires_in: Option<u32>,
    #[command(flatten)]
    quotas: QuotasFlags,
}

pub(crate) async fn run(command: Command, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let client = Client::connect(server).await?;
    match command {
        Command::Create { name, role, limits } => {
            let Limits { may, maps, expires_in, quotas } = limits;
            let request = v1::CreateTokenRequest {
                token_id: name,
                role: role.into(),
                abilities: may.into_iter().map(Into::into).collect(),
                maps: maps.iter().map(|map| map_id(map)).collect(),
                lifetime_s: expires_in,
                quotas: Some(quotas.into()),
            };
            // Who may not list them has one.
            let is_first = client.tokens().await.is_ok_and(|tokens| tokens.is_empty());
            let (token, secret) = client.create_limited_token(request).await?;
            output.result(&json!({ "token": token, "secret": secret }), |out| {
                tell(out, &token, &secret)?;
                if is_first {
                    writeln!(out, "  it is the first: from now on the server hears nobody without a token")?;
                }
                Ok(())
            })
        }
        Command::Rotate { name, overlap, expires_in } => {
            let request = v1::RotateTokenRequest { name, overlap_s: overlap, lifetime_s: expires_in };
            let (token, secret) = client.rotate_token(request).await?;
            output.result(&json!({ "token": token, "secret": secret }), |out| {
                tell(out, &token, &secret)?;
                let left = token.overlap_end_time_ns.map_or(Duration::ZERO, time_left);
                writeln!(out, "  the secret before is good for another {}", in_words(left))
            })
        }
        Command::Limit { name, quotas, lift } => {
            let lifted = lift.into_iter().map(Into::into).collect();
            let request = v1::UpdateTokenRequest { name, quotas: Some(quotas.into()), lifted };
            let token = client.update_token(request).await?;
            output.result(&json!({ "token": token }), |out| {
                writeln!(out, "{} {}", token.name, token.role().json_name())?;
                writeln!(out, "  quotas  {}", quotas_in_words(&token))
            })
        }
        Command::Ls => {
            let tokens = client.tokens().await?;
            output.result(&json!({ "tokens": tokens }), |out| {
                table(out, ["TOKEN", "ROLE", "MAY", "MAPS", "EXPIRES", "QUOTAS"], tokens.iter().map(row))
            })
        }
        Command::Rm { name, yes } => {
            Asking::unless(yes)
                .confirm_loss(&format!("delete the token {name}? calls and streams that use it end"))?;
            client.delete_token(&name).await?;
            // With the last one, whoever asks is heard without.
            let none_left = client.tokens().await.is_ok_and(|left| left.is_empty());
            output.result(&json!({ "deleted": name }), |out| {
                writeln!(out, "deleted {name}")?;
                if none_left {
                    writeln!(out, "no token is left: who reaches the server may do everything; `waypost token create` makes one")?;
                }
                Ok(())
            })
        }
    }
}

fn tell(out: &mut dyn Write, token: &v1::Token, secret: &str) -> io::Result<()> {
    writeln!(out, "{} {}", token.name, token.role().json_name())?;
    writeln!(out, "  secret  {secret}")?;
    writeln!(out, "  the server does not keep it: note it now, for --token or WAYPOST_TOKEN")
}

fn row(token: &v1::Token) -> [String; 6] {
    let name = token.name.strip_prefix("tokens/").unwrap_or(&token.name);
    let may: Vec<&str> = token.abilities().map(v1::token::Ability::json_name).collect();
    let maps = if token.maps.is_empty() { "all".to_owned() } else { token.maps.join(",") };
    let expires = match token.expire_time_ns.map(time_left) {
        None => "never".to_owned(),
        Some(Duration::ZERO) => "expired".to_owned(),
        Some(left) => format!("in {}", in_words(left)),
    };
    let quotas = quotas_in_words(token);
    [name.to_owned(), token.role().json_name().to_owned(), may.join(","), maps, expires, quotas]
}

/// What a token is limited to, and how much of that there is.
fn quotas_in_words(token: &v1::Token) -> String {
    let v1::Quotas { max_maps, max_sessions, max_frames_per_second, max_kept_mib } =
        token.quotas.unwrap_or_default();
    let v1::QuotaUse { maps, sessions, kept_bytes } = token.used.unwrap_or_default();
    let words = [
        max_maps.map(|most| format!("maps {maps}/{most}")),
        max_sessions.map(|most| format!("sessions {sessions}/{most}")),
        max_frames_per_second.map(|most| format!("frames {most}/s")),
        max_kept_mib.map(|most| format!("kept {:.0}/{most} MiB", kept_bytes as f64 / MIB)),
    ];
    let words: Vec<String> = words.into_iter().flatten().collect();
    if words.is_empty() { "none".to_owned() } else { words.join(", ") }
}

const MIB: f64 = (1_u32 << 20) as f64;

/// Maps are named as `hall` here and as `maps/hall` in lists.
fn map_id(name: &str) -> String {
    name.strip_prefix("maps/").unwrap_or(name).to_owned()
}

/// How long it is from now to a time; nothing if that has passed.
fn time_left(time_ns: i64) -> Duration {
    let until = Duration::from_nanos(u64::try_from(time_ns).unwrap_or_default());
    until.saturating_sub(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default())
}

const MINUTE_S: u32 = 60;
const HOUR_S: u32 = 60 * MINUTE_S;
const DAY_S: u32 = 24 * HOUR_S;

/// A length of time in its largest unit, rounded: `30 d` for anything nearer to that than to 29 or 31.
fn in_words(time: Duration) -> String {
    let seconds = time.as_secs_f64();
    let (unit_s, unit) = match seconds {
        seconds if seconds < 2.0 * f64::from(MINUTE_S) => (1, "s"),
        seconds if seconds < 2.0 * f64::from(HOUR_S) => (MINUTE_S, "min"),
        seconds if seconds < 2.0 * f64::from(DAY_S) => (HOUR_S, "h"),
        _ => (DAY_S, "d"),
    };
    format!("{:.0} {unit}", seconds / f64::from(unit_s))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_is_told_in_one_unit() {
        for (seconds, told) in [(0.2, "0 s"), (119.0, "119 s"), (3599.6, "60 min"), (172_799.0, "48 h")] {
            assert_eq!(in_words(Duration::from_secs_f64(seconds)), told);
        }
        assert_eq!(in_words(Duration::from_secs_f64(2_591_999.5)), "30 d");
    }

    #[test]
    fn quotas_are_told_with_what_there_is() {
        let quotas = v1::Quotas {
            max_sessions: Some(3),
            max_frames_per_second: Some(0.5),
            max_kept_mib: Some(2048),
            ..v1::Quotas::default()
        };
        let used = v1::QuotaUse { maps: 7, sessions: 2, kept_bytes: 12 << 20 };
        let token = v1::Token { quotas: Some(quotas), used: Some(used), ..v1::Token::default() };
        assert_eq!(quotas_in_words(&token), "sessions 2/3, frames 0.5/s, kept 12/2048 MiB");
        assert_eq!(quotas_in_words(&v1::Token::default()), "none");
    }
}
