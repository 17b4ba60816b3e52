//! Several robots at once in one map: in which order the server took their frames, it says itself; taken in that order, they
//! are to come to the same.

use std::collections::BTreeMap;

use futures::future::join_all;
use waypost_client::v1::map_event::Event;

use super::calls::{Answer, Call, Heard, map_name};
use super::operations::{By, From, Operation, Step};
use super::plain::Outcome;
use super::runner::{Runner, agree};
use crate::harness::in_time;

impl Runner {
    /// Each robot opens its session by itself, then all send at once.
    pub(super) async fn together(
        &mut self,
        by: By,
        map: u8,
        robots: u8,
        (frames, noise): (u8, u64),
    ) -> Result<(), String> {
        let name = map_name(map);
        let drives = (0..robots).map(|session| {
            let noise = noise + 1000 * u64::from(session);
            let drive =
                |frames| Operation::Drive { map, session, from: From::Next, start: None, frames, noise };
            let step = |frames| Step { by, operation: drive(frames), killed: None };
            (step(0), step(frames))
        });
        let drives: Vec<(Step, Step)> = drives.collect();
        let mut open = Vec::new();
        for (opening, driving) in &drives {
            if let Answer::Frames(_) = self.quietly(&Call::of(opening, &self.world)).await? {
                open.push(driving);
            }
        }
        let Some(known) = self.world.maps.get(&name).filter(|_| !open.is_empty()) else { return Ok(()) };
        let before = known.log.len() as u64;
        let calls: Vec<Call<'_>> = open.into_iter().map(|driving| Call::of(driving, &self.world)).collect();
        let server = self.connected();
        let heard = join_all(calls.iter().map(|call| server.drive(call, &name))).await;
        let mut told = BTreeMap::new();
        for (call, heard) in calls.iter().zip(heard) {
            match heard {
                Heard::Answer(Answer::Frames(outcomes)) => told.insert(call.session.clone(), outcomes),
                other => return Err(format!("{} of several robots: {other:?}", call.session)),
            };
        }
        let taken = |outcome: &&Outcome| matches!(outcome, Outcome::Answered(_));
        let count = told.values().flatten().filter(taken).count();
        let order = self.order(&name, before, count).await?;
        let sent = calls.into_iter().map(|call| (call.session, call.frames)).collect();
        let expected = self.world.see_in_order(&name, sent, &order);
        agree(&told, &expected)?;
        *self.counts.entry("frames of robots at once".to_owned()).or_default() += count as u64;
        self.check_maps(&[name]).await
    }

    /// The sessions whose frames came next, in the order of the map's log.
    async fn order(&mut self, map: &str, from: u64, count: usize) -> Result<Vec<(String, u64)>, String> {
        let client = self.operator().await?;
        let mut events = client.watch_map(map, Some(from)).await.map_err(|error| error.to_string())?;
        let mut order = Vec::new();
        while order.len() < count {
            let event = in_time(events.next()).await.map_err(|error| error.to_string())?;
            let Some(Event::Frame(decided)) = event.event else { continue };
            let frame = decided.frame.unwrap_or_default();
            let mut parts = frame.name.rsplit('/');
            let sequence = parts.next().and_then(|sequence| sequence.parse().ok());
            let session = parts.nth(1).map(str::to_owned);
            order.push(session.zip(sequence).ok_or_else(|| format!("{:?} is no frame", frame.name))?);
        }
        Ok(order)
    }
}
