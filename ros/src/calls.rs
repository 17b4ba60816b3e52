//! Services of ROS 2 over DDS: requests come, and each answer says to which it belongs, as the caller's middleware has it.
//!
//! Topics and types are the same everywhere. By `rmw_cyclonedds` a request and its answer begin with 16 bytes that name
//! them (<https://github.com/ros2/rmw_cyclonedds>, `serdata.hpp`); by `rmw_fastrtps` they have these beside the message, as
//! DDS-RPC's related sample identity (<https://github.com/ros2/rmw_fastrtps>, `rmw_response.cpp`).

use std::marker::PhantomData;
use std::pin::Pin;
use std::time::Duration;

use futures::{Stream, StreamExt};
use rustdds::rpc::SampleIdentity;
use rustdds::{GUID, WriteOptions, WriteOptionsBuilder};
use waypost_ros_messages::{Service, decoded, laid_out};

use crate::bus::{Bus, BusError};
use crate::names::type_in_dds;
use crate::raw::{RawWriter, Sample};

/// A caller's reader of answers is found about when its request is.
const CALLER_PATIENCE: Duration = Duration::from_secs(2);
const LOOKING_PERIOD: Duration = Duration::from_millis(10);

/// How a caller knows its answer again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Asked {
    /// By what its request began with.
    Header { caller: u64, number: i64 },
    /// By what its request had beside it.
    Beside(SampleIdentity),
}

/// Something that was asked.
pub(crate) struct Call<S: Service> {
    pub(crate) request: S::Request,
    asked: Asked,
    /// Who wrote the request.
    from: GUID,
}

/// One service.
pub(crate) struct Calls<S: Service> {
    name: String,
    requests: Pin<Box<dyn Stream<Item = Result<Call<S>, String>> + Send>>,
    answers: RawWriter,
    kind: PhantomData<S>,
}

impl<S: Service> Calls<S> {
    /// Serves a name as in `/waypost/finish`.
    pub(crate) fn serve(bus: &Bus, name: &str) -> Result<Self, BusError> {
        let dds_type = |part: &str| type_in_dds(&format!("{}_{part}", S::TYPE));
        let answers = bus.write_raw(&format!("rr{name}Reply"), &dds_type("Response"))?;
        let (requests, _) = bus.read_raw(&format!("rq{name}Request"), &dds_type("Request"))?;
        let requests = requests.map(|message| {
            let Sample { data, identity, related } = message?;
            let (asked, request) = read::<S>(&data, identity, related)?;
            Ok(Call { request, asked, from: identity.writer_guid })
        });
        Ok(Self { name: name.to_owned(), requests: Box::pin(requests), answers, kind: PhantomData })
    }

    /// The next that can be read; what cannot is told in the log.
    pub(crate) async fn next(&mut self) -> Option<Call<S>> {
        loop {
            match self.requests.next().await? {
                Ok(call) => return Some(call),
                Err(problem) => tracing::warn!("a call of {} is left out: {problem}", self.name),
            }
        }
    }

    /// Answers a call.
    pub(crate) async fn answer(&mut self, Call { asked, from, .. }: Call<S>, response: &S::Response) {
        // What is written before the caller's reader is known would never come there.
        let looking = async {
            while !self.answers.is_read_beside(from) {
                tokio::time::sleep(LOOKING_PERIOD).await;
            }
        };
        if tokio::time::timeout(CALLER_PATIENCE, looking).await.is_err() {
            tracing::debug!("who called {} does not read answers", self.name);
        }
        let (body, options) = match written::<S>(asked, response) {
            Ok(written) => written,
            Err(error) => return tracing::warn!("{} cannot be answered: {error}", self.name),
        };
        self.answers.write(body, options);
    }
}

fn read<S: Service>(
    data: &[u8],
    identity: SampleIdentity,
    related: Option<SampleIdentity>,
) -> Result<(Asked, S::Request), String> {
    let told = |error: waypost_ros_messages::CdrError| error.to_string();
    let Some(related) = related else {
        let ((caller, number), request) = decoded::<((u64, i64), S::Request)>(data).map_err(told)?;
        return Ok((Asked::Header { caller, number }, request));
    };
    // The writer's part of it names the caller's reader of answers; the number is that of the request itself.
    let writer_guid = match related.writer_guid {
        GUID::GUID_UNKNOWN => identity.writer_guid,
        reader => reader,
    };
    let asked = SampleIdentity { writer_guid, ..identity };
    Ok((Asked::Beside(asked), decoded::<S::Request>(data).map_err(told)?))
}

fn written<S: Service>(
    asked: Asked,
    response: &S::Response,
) -> Result<(Vec<u8>, WriteOptions), waypost_ros_messages::CdrError> {
    let options = WriteOptionsBuilder::new();
    Ok(match asked {
        Asked::Header { caller, number } => (laid_out(&((caller, number), response))?, options.build()),
        Asked::Beside(identity) => (laid_out(response)?, options.related_sample_identity(identity).build()),
    })
}
