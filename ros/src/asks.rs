//! Services of others, over DDS: requests go out, and answers are known again as [`crate::calls`] tells.

use std::marker::PhantomData;
use std::pin::Pin;
use std::time::{Duration, Instant};

use futures::{Stream, StreamExt};
use rustdds::rpc::SampleIdentity;
use rustdds::{GUID, SequenceNumber, WriteOptionsBuilder};
use waypost_ros_messages::{CdrError, Service, decoded, laid_out};

use crate::bus::{Bus, BusError};
use crate::names::type_in_dds;
use crate::raw::{RawWriter, Sample};

/// For whoever serves it to be found, and then for its readers and writers to be joined with ours.
const SERVER_PATIENCE: Duration = Duration::from_secs(5);
const LOOKING_PERIOD: Duration = Duration::from_millis(20);
const JOINING_TIME: Duration = Duration::from_millis(100);
/// What programs with Cyclone DDS call themselves by.
const CYCLONE: [u8; 2] = [1, 16];
/// What CDR and then a request or answer of `rmw_cyclonedds` begin with.
const ENCAPSULATION: usize = 4;
const HEADER: usize = 16;

/// Which answer is waited for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ticket {
    /// One that begins with this.
    Header { caller: u64, number: i64 },
    /// One that has this beside it.
    Beside(SequenceNumber),
}

/// A service that somebody else serves.
pub(crate) struct Asks<S: Service> {
    name: String,
    requests: RawWriter,
    answers: Pin<Box<dyn Stream<Item = Result<Sample, String>> + Send>>,
    /// Of our reader of answers.
    reader: GUID,
    caller: u64,
    number: i64,
    kind: PhantomData<S>,
}

impl<S: Service> Asks<S> {
    /// Of a name as in `/navigate_to_pose/_action/send_goal`; `caller` tells us from others.
    pub(crate) fn of(bus: &Bus, name: &str, caller: u64) -> Result<Self, BusError> {
        let dds_type = |part: &str| type_in_dds(&format!("{}_{part}", S::TYPE));
        let (answers, reader) = bus.read_raw(&format!("rr{name}Reply"), &dds_type("Response"))?;
        let requests = bus.write_raw(&format!("rq{name}Request"), &dds_type("Request"))?;
        let answers = Box::pin(answers);
        Ok(Self { name: name.to_owned(), requests, answers, reader, caller, number: 0, kind: PhantomData })
    }

    /// Whether somebody serves it now, and who.
    pub(crate) fn server(&self) -> Option<[u8; 12]> {
        self.requests.reader_with(&format!("rr{}Reply", self.name))
    }

    /// Asks, once somebody serves it.
    ///
    /// # Errors
    /// If nobody does, or the request cannot be sent.
    pub(crate) async fn ask(&mut self, request: &S::Request) -> Result<Ticket, String> {
        let server = self.found().await?;
        let told = |error: CdrError| format!("{} cannot be asked: {error}", self.name);
        if server.starts_with(&CYCLONE) {
            self.number += 1;
            let (caller, number) = (self.caller, self.number);
            let body = laid_out(&((caller, number), request)).map_err(told)?;
            self.requests.write(body, WriteOptionsBuilder::new().build());
            return Ok(Ticket::Header { caller, number });
        }
        let answered = SampleIdentity { writer_guid: self.reader, sequence_number: SequenceNumber::UNKNOWN };
        let options = WriteOptionsBuilder::new().related_sample_identity(answered).build();
        let sent = self.requests.write(laid_out(request).map_err(told)?, options);
        let sent = sent.ok_or_else(|| format!("{} cannot be asked: DDS does not take it", self.name))?;
        Ok(Ticket::Beside(sent.sequence_number))
    }

    async fn found(&mut self) -> Result<[u8; 12], String> {
        if let Some(server) = self.server() {
            return Ok(server);
        }
        let late = Instant::now() + SERVER_PATIENCE;
        while Instant::now() < late {
            tokio::time::sleep(LOOKING_PERIOD).await;
            if let Some(server) = self.server() {
                tokio::time::sleep(JOINING_TIME).await;
                return Ok(server);
            }
        }
        Err(format!("nobody serves {}; start it, in this domain and namespace", self.name))
    }

    /// The answer, behind its four bytes of encapsulation. Other answers that come are forgotten.
    pub(crate) async fn answer(&mut self, ticket: Ticket) -> Vec<u8> {
        while let Some(sample) = self.answers.next().await {
            match sample.map(|sample| answers(ticket, self.reader, sample)) {
                Ok(Some(data)) => return data,
                Ok(None) => {}
                Err(problem) => tracing::debug!("an answer of {} is left out: {problem}", self.name),
            }
        }
        // The bridge is ending.
        std::future::pending().await
    }
}

/// What a sample says, if it is the answer.
fn answers(ticket: Ticket, reader: GUID, Sample { data, related, .. }: Sample) -> Option<Vec<u8>> {
    match ticket {
        Ticket::Header { caller, number } => {
            let (found, found_number) = decoded::<(u64, i64)>(&data).ok()?;
            let is_ours = related.is_none() && (found, found_number) == (caller, number);
            // What comes behind it is aligned as before: 16 is a multiple of 8.
            let body = data.get(ENCAPSULATION + HEADER..).filter(|_| is_ours)?;
            Some([&data[..ENCAPSULATION], body].concat())
        }
        Ticket::Beside(number) => {
            let related = related?;
            let is_ours = related.writer_guid.prefix == reader.prefix && related.sequence_number == number;
            is_ours.then_some(data)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(data: &[u8], related: Option<SampleIdentity>) -> Sample {
        Sample { data: data.to_vec(), identity: SampleIdentity::default(), related }
    }

    #[test]
    fn answers_are_known_by_what_they_begin_with_or_have_beside_them() {
        let header = [&[0, 1, 0, 0][..], &7_u64.to_le_bytes(), &3_i64.to_le_bytes(), &[42]].concat();
        let (ours, others) =
            (Ticket::Header { caller: 7, number: 3 }, Ticket::Header { caller: 7, number: 4 });
        let reader = GUID::GUID_UNKNOWN;
        assert_eq!(answers(ours, reader, sample(&header, None)), Some(vec![0, 1, 0, 0, 42]));
        assert_eq!(answers(others, reader, sample(&header, None)), None);
        let number = SequenceNumber::new(5);
        let related = Some(SampleIdentity { writer_guid: reader, sequence_number: number });
        let beside = Ticket::Beside(number);
        assert_eq!(answers(beside, reader, sample(&[0, 1, 0, 0, 9], related)), Some(vec![0, 1, 0, 0, 9]));
        assert_eq!(answers(beside, reader, sample(&header, None)), None);
        assert_eq!(answers(ours, reader, sample(&header, related)), None);
        for cut in 0..header.len() - 1 {
            assert_eq!(answers(ours, reader, sample(&header[..cut], None)), None, "{cut}");
        }
    }
}
