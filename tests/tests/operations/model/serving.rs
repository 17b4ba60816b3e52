//! Calls made to the real server.

use std::collections::HashMap;
use std::error::Error as _;
use std::io::Cursor;

use tonic::metadata::MetadataMap;
use tonic::{Code, Status};
use waypost_client::v1::job::State as JobState;
use waypost_client::v1::stream_request::Content as Request;
use waypost_client::v1::stream_response::Content as Response;
use waypost_client::v1::trim_map_request::Mode;
use waypost_client::{Client, ClientOptions, Error, FrameContent, v1};

use super::calls::{Answer, Call, Heard, label_text, map_name};
use super::operations::Operation;
use super::plain::{
    Asked, MIN_SUPPORT, Outcome, Shown, of_answer, of_response, token_line, token_name, wanted_settings,
};
use super::seen::{histogram, view};
use crate::harness::{RawStream, channel, in_time, open};

/// The connections to one run of a server.
pub(super) struct Server<'a> {
    pub(super) endpoint: String,
    pub(super) clients: HashMap<String, Client>,
    pub(super) model: &'a str,
    pub(super) words_hash: &'a str,
}

/// Why there is no answer.
enum Failed {
    Refused(Code),
    Broken(String),
}

impl std::convert::From<Error> for Failed {
    fn from(error: Error) -> Self {
        match error {
            Error::Status { code, .. } => Self::Refused(code),
            other => Self::Broken(other.to_string()),
        }
    }
}

impl std::convert::From<Status> for Failed {
    fn from(status: Status) -> Self {
        // A status that was made here has what happened to the connection as its source.
        if status.source().is_some() {
            Self::Broken(status.to_string())
        } else {
            Self::Refused(status.code())
        }
    }
}

impl Server<'_> {
    /// A client that shows this; kept, if it is a token's.
    pub(super) async fn client(&mut self, shown: &Shown) -> Result<Client, Error> {
        let secret = shown.secret.clone().unwrap_or_default();
        if let Some(client) = self.clients.get(&secret).filter(|_| shown.token.is_some()) {
            return Ok(client.clone());
        }
        let options = ClientOptions::new(self.endpoint.clone());
        let options = if secret.is_empty() { options } else { options.with_token(secret.clone()) };
        let client = in_time(Client::connect(options)).await?;
        if shown.token.is_some() {
            self.clients.insert(secret, client.clone());
        }
        Ok(client)
    }

    /// Streams the frames of a call into a map, beside others.
    pub(super) async fn drive(&self, call: &Call<'_>, map: &str) -> Heard {
        self.stream(channel(&self.endpoint).await, call, map).await
    }

    /// Makes a call, once `connected` was told that nothing but the call comes now.
    pub(super) async fn make(&mut self, call: &Call<'_>, connected: impl FnOnce()) -> Heard {
        let client = match self.client(&call.shown).await {
            Ok(client) => client,
            Err(error) => return Heard::Broken(vec![], 0, error.to_string()),
        };
        if let Operation::Drive { map, .. } | Operation::Localize { map, .. } = call.operation {
            let channel = channel(&self.endpoint).await;
            connected();
            return self.stream(channel, call, &map_name(*map)).await;
        }
        connected();
        match in_time(self.call(&client, call)).await {
            Ok(heard) => heard,
            Err(Failed::Refused(code)) => Heard::Answer(Answer::Refused(code)),
            Err(Failed::Broken(error)) => Heard::Broken(vec![], 0, error),
        }
    }

    async fn call(&self, client: &Client, call: &Call<'_>) -> Result<Heard, Failed> {
        let answer = match call.operation {
            Operation::CreateMap { map, careful } => {
                let settings = Some(wanted_settings(*careful));
                let (map_id, model) = (map_name(*map), self.model.to_owned());
                client.create_map(v1::CreateMapRequest { map_id, model, settings }).await?;
                Answer::Done
            }
            Operation::DeleteMap { map } => {
                client.delete_map(&map_name(*map)).await?;
                Answer::Done
            }
            Operation::Query { map, place, noise } => {
                let content = FrameContent::Histogram(histogram(&view(*place, *noise)));
                let found = client.query(&map_name(*map), content, self.words_hash, None).await?;
                Answer::Told(of_response(&found))
            }
            Operation::SetLabel { map, place, label } => {
                let place = format!("maps/{}/places/{place}", map_name(*map));
                client.set_label(&place, &label_text(*label), v1::LabelScope::Place).await?;
                Answer::Done
            }
            Operation::DeleteLabel { map, .. } => {
                client.delete_label(&format!("maps/{}/places/{}", map_name(*map), call.place)).await?;
                Answer::Done
            }
            Operation::DeleteSession { map, .. } => {
                let session = format!("maps/{}/sessions/{}", map_name(*map), call.session);
                let job = client.delete_session(&session).await?;
                self.ended(client, &job.name).await?
            }
            Operation::Trim { map, places } => {
                let name = format!("maps/{}", map_name(*map));
                let mode = Mode::Apply.into();
                let trim = v1::TrimMapRequest { name, max_places: *places, mode };
                let dropped = client.trim_map(trim).await?.dropped;
                Answer::Places(dropped.into_iter().map(|dropped| dropped.place_number).collect())
            }
            Operation::Compact { map } => {
                let job = client.compact_map(&map_name(*map)).await?;
                self.ended(client, &job.name).await?
            }
            Operation::Copy { from, to } => {
                let mut snapshot = Vec::new();
                client.export_map(&map_name(*from), &mut snapshot).await?;
                let job = client.import_map(&map_name(*to), Cursor::new(snapshot)).await?;
                self.ended(client, &job.name).await?
            }
            Operation::Merge { sources, target } => {
                let request = v1::MergeMapsRequest {
                    sources: sources.iter().map(|map| format!("maps/{}", map_name(*map))).collect(),
                    target: format!("maps/{}", map_name(*target)),
                    auto_commit: true,
                    min_support: Some(MIN_SUPPORT),
                };
                let merge = client.merge_maps(request).await?;
                match self.ended(client, &merge.job).await? {
                    Answer::Done => Answer::Merge(client.merge(&merge.name).await?.state()),
                    refused => refused,
                }
            }
            Operation::UndoMerge { .. } => {
                let merge = client.undo_merge(&format!("merges/{}", call.merge)).await?;
                self.ended(client, &merge.job).await?
            }
            Operation::Withdraw { map, .. } => {
                return Ok(Heard::Said(client.withdraw_loop_closure(&call.frame(*map, 0)).await?));
            }
            Operation::Confirm { map, .. } => {
                let (later, earlier) = (call.frame(*map, 0), call.frame(*map, 1));
                return Ok(Heard::Said(client.confirm_loop_closure(&later, &earlier).await?));
            }
            Operation::UndoCorrection { .. } => {
                let name = format!("maps/{}/corrections/{}", call.corrected, call.correction);
                return Ok(Heard::Said(client.undo_correction(&name).await?));
            }
            Operation::CreateToken { token, role, reach, lifetime_s, limited } => {
                let asked = Asked::of(*role, *reach, *limited);
                let Asked { role, abilities, maps, max_maps, max_sessions } = asked;
                let quotas = v1::Quotas { max_maps, max_sessions, ..v1::Quotas::default() };
                let request = v1::CreateTokenRequest {
                    token_id: token_name(*token),
                    role: role.into(),
                    abilities: abilities.into_iter().map(i32::from).collect(),
                    maps,
                    lifetime_s: *lifetime_s,
                    quotas: limited.then_some(quotas),
                };
                let (token, secret) = client.create_limited_token(request).await?;
                return Ok(Heard::Secret(token, secret));
            }
            Operation::DeleteToken { token } => {
                client.delete_token(&token_name(*token)).await?;
                Answer::Done
            }
            Operation::RotateToken { token, overlap_s } => {
                let (name, overlap_s) = (token_name(*token), Some(*overlap_s));
                let rotation = v1::RotateTokenRequest { name, overlap_s, lifetime_s: None };
                let (token, secret) = client.rotate_token(rotation).await?;
                return Ok(Heard::Secret(token, secret));
            }
            Operation::ListMaps => {
                let maps = client.maps().await?;
                let own = |map: v1::Map| map.name.trim_start_matches("maps/").to_owned();
                Answer::Names(maps.into_iter().map(own).collect())
            }
            Operation::WhoAmI => {
                let caller = client.caller().await?;
                let abilities: Vec<_> = caller.abilities().collect();
                Answer::Told(token_line(&caller.token, caller.role(), &abilities, &caller.maps))
            }
            Operation::Drive { .. }
            | Operation::Localize { .. }
            | Operation::Together { .. }
            | Operation::Restart { .. } => Answer::Done,
        };
        Ok(Heard::Answer(answer))
    }

    /// Waits for a job.
    async fn ended(&self, client: &Client, job: &str) -> Result<Answer, Failed> {
        let mut steps = match client.watch_job(job).await {
            Ok(steps) => steps,
            // It was begun by one who may not read.
            Err(Error::Status { code, message }) => {
                return Err(Failed::Broken(format!("{job} cannot be watched: {code:?} {message}")));
            }
            Err(error) => return Err(error.into()),
        };
        let mut last = None;
        while let Some(step) = steps.next().await? {
            last = Some(step);
        }
        match last {
            Some(job) if job.state() == JobState::Succeeded => Ok(Answer::Done),
            Some(job) if job.state() == JobState::Failed => {
                Ok(Answer::Refused(Code::from(job.error.map_or(0, |error| error.code))))
            }
            other => Err(Failed::Broken(format!("{job} ended as {other:?}"))),
        }
    }

    /// Streams frames, all at once, and hears what becomes of each.
    async fn stream(&self, channel: tonic::transport::Channel, call: &Call<'_>, map: &str) -> Heard {
        let looks = matches!(call.operation, Operation::Localize { .. });
        let mode = if looks { v1::SessionMode::Localize } else { v1::SessionMode::Map };
        let session = if looks { "" } else { &call.session };
        let words_hash = self.words_hash.to_owned();
        let first = v1::OpenSession { mode: mode.into(), words_hash, ..open(map, session) };
        let mut metadata = MetadataMap::new();
        if let Some(secret) = &call.shown.secret {
            metadata.insert("authorization", format!("Bearer {secret}").parse().unwrap());
        }
        let mut outcomes = Vec::new();
        // One that only looks leaves nothing behind.
        let kept = |outcomes: &Vec<Outcome>| if looks { 0 } else { 1 + outcomes.len() };
        let mut opened = false;
        let streamed = async {
            let mut stream = RawStream::begin_with(channel, Request::Open(first), metadata).await?;
            let Some(Response::Opened(_)) = stream.next().await? else {
                return Err(Failed::Broken("the session was not opened".to_owned()));
            };
            opened = true;
            for sent in &call.frames {
                stream.send(Request::Frame(sent.message())).await;
            }
            for _ in &call.frames {
                outcomes.push(match stream.next().await? {
                    Some(Response::Answer(answer)) if answer.resent => Outcome::Resent(of_answer(&answer)),
                    Some(Response::Answer(answer)) => Outcome::Answered(of_answer(&answer)),
                    Some(Response::Refusal(refusal)) => {
                        Outcome::Refused(Code::from(refusal.status.map_or(0, |status| status.code)))
                    }
                    other => return Err(Failed::Broken(format!("in place of an answer: {other:?}"))),
                });
            }
            Ok(())
        };
        match streamed.await {
            Ok(()) => Heard::Answer(Answer::Frames(outcomes)),
            Err(Failed::Refused(code)) if !opened => Heard::Answer(Answer::Refused(code)),
            Err(Failed::Broken(error)) if !opened => Heard::Broken(outcomes, 0, error),
            Err(Failed::Refused(code)) => {
                let acknowledged = kept(&outcomes);
                Heard::Broken(outcomes, acknowledged, format!("the stream ended with {code:?}"))
            }
            Err(Failed::Broken(error)) => {
                let acknowledged = kept(&outcomes);
                Heard::Broken(outcomes, acknowledged, error)
            }
        }
    }
}
