//! DDS: readers that hand out messages as bytes, and writers of the messages of ROS.

use std::net::IpAddr;
use std::sync::Arc;

use futures::{Stream, StreamExt};
use rustdds::no_key::{DataReader, DataWriter};
use rustdds::policy::{Durability, History, Reliability};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, Duration, GUID, Publisher, QosPolicies, QosPolicyBuilder,
    RTPSEntity, Subscriber, Topic, TopicKind,
};

use crate::graph::{Entities, Presence, TOPIC};
use crate::names::{in_dds, type_in_dds, type_in_ros};
use crate::raw::{AsItIs, Incoming, Raw, RawWriter, Sample};
use crate::settings::SensorQos;
use crate::viewers::{Screen, Viewers};
use waypost_ros_messages::{Message, NODES, Participant};

/// For farewells of readers and writers to go out before the participant's own: RustDDS sends nothing more once that is dropped.
const FAREWELLS: std::time::Duration = std::time::Duration::from_millis(200);

/// Messages that are images, as ROS writes their types.
const IMAGES: [&str; 2] = ["sensor_msgs/Image", "sensor_msgs/CompressedImage"];

/// Messages of a sensor that a busy machine may leave unread.
const SENSOR_DEPTH: i32 = 32;

/// What topics are read and written with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Qos {
    /// Sensors: what is new counts.
    Sensor(SensorQos),
    /// Nothing is lost between those who are there.
    Reliable,
    /// As `/tf_static`: who comes late gets what all said before.
    Latched,
    /// What is whole in each message: who comes late gets the latest.
    Latest,
}

impl Qos {
    /// How many messages those get who come late.
    pub(crate) fn kept(self) -> usize {
        match self {
            Qos::Sensor(_) | Qos::Reliable => 0,
            Qos::Latched => 32,
            Qos::Latest => 1,
        }
    }

    fn policies(self) -> QosPolicies {
        let reliable = Reliability::Reliable { max_blocking_time: Duration::from_millis(100) };
        let (reliability, durability, depth) = match self {
            Qos::Sensor(SensorQos::BestEffort) => {
                (Reliability::BestEffort, Durability::Volatile, SENSOR_DEPTH)
            }
            Qos::Sensor(SensorQos::Reliable) => (reliable, Durability::Volatile, SENSOR_DEPTH),
            Qos::Reliable => (reliable, Durability::Volatile, 10),
            Qos::Latched => (reliable, Durability::TransientLocal, 100),
            Qos::Latest => (reliable, Durability::TransientLocal, 1),
        };
        let builder = QosPolicyBuilder::new().reliability(reliability).durability(durability);
        builder.history(History::KeepLast { depth }).build()
    }
}

/// DDS could not do what it was asked to.
#[derive(Debug, thiserror::Error)]
#[error(
    "DDS failed with {what}: {reason}; see that the domain's ports are free and --network names an address of this machine"
)]
pub(crate) struct BusError {
    what: String,
    reason: String,
}

fn failed<E: std::fmt::Debug>(what: &str) -> impl FnOnce(E) -> BusError {
    move |reason| BusError { what: what.to_owned(), reason: format!("{reason:?}") }
}

/// A topic that is read.
#[derive(Clone, Debug)]
struct Wanted {
    topic: String,
    type_name: &'static str,
    qos: Qos,
}

/// This program among those of a DDS domain.
pub(crate) struct Bus {
    participant: DomainParticipant,
    publisher: Publisher,
    subscriber: Subscriber,
    wanted: Vec<Wanted>,
    entities: Entities,
    viewers: Option<Arc<Viewers>>,
}

impl Bus {
    pub(crate) fn join(
        domain: u16,
        networks: &[IpAddr],
        viewers: Option<Arc<Viewers>>,
    ) -> Result<Self, BusError> {
        let mut builder = DomainParticipantBuilder::new(domain);
        if !networks.is_empty() {
            builder = builder.with_only_networks(networks.iter().copied());
        }
        let participant = builder.build().map_err(failed("joining the domain"))?;
        let qos = QosPolicies::qos_none();
        let publisher = participant.create_publisher(&qos).map_err(failed("making a publisher"))?;
        let subscriber = participant.create_subscriber(&qos).map_err(failed("making a subscriber"))?;
        let (wanted, entities) = (Vec::new(), Entities::default());
        Ok(Self { participant, publisher, subscriber, wanted, entities, viewers })
    }

    /// Keeps this program in the domain until it says farewell.
    pub(crate) fn membership(&self) -> Membership {
        Membership(self.participant.clone())
    }

    /// What each of our messages begins with, behind RTPS's own words.
    pub(crate) fn prefix(&self) -> [u8; 12] {
        let whole = self.participant.guid().to_bytes();
        std::array::from_fn(|at| whole[at])
    }

    fn topic(&self, topic: &str, type_name: &str, qos: Qos) -> Result<Topic, BusError> {
        self.topic_in_dds(&in_dds(topic), type_name, qos)
    }

    fn topic_in_dds(&self, name: &str, type_name: &str, qos: Qos) -> Result<Topic, BusError> {
        let (policies, type_name) = (qos.policies(), type_name.to_owned());
        let made = self.participant.create_topic(name.to_owned(), type_name, &policies, TopicKind::NoKey);
        made.map_err(failed(name))
    }

    /// Reads a topic by its name in DDS, with who wrote what, and by which reader.
    pub(crate) fn read_raw(
        &self,
        name: &str,
        type_name: &str,
    ) -> Result<(impl Stream<Item = Result<Sample, String>> + Send + use<>, GUID), BusError> {
        let made = self.topic_in_dds(name, type_name, Qos::Reliable)?;
        let reader = self.subscriber.create_datareader_no_key::<Raw, AsItIs>(&made, None);
        let reader = reader.map_err(failed(name))?;
        let guid = reader.guid();
        self.entities.add_reader(guid);
        let samples = reader.async_sample_stream().map(|message| {
            let message = message.map_err(|error| format!("{error:?}"))?;
            let info = message.sample_info();
            let (identity, related) = (info.sample_identity(), info.related_sample_identity());
            let Raw(data) = message.into_value();
            Ok(Sample { data, identity, related })
        });
        Ok((samples, guid))
    }

    /// Writes a topic by its name in DDS.
    pub(crate) fn write_raw(&self, name: &str, type_name: &str) -> Result<RawWriter, BusError> {
        let made = self.topic_in_dds(name, type_name, Qos::Reliable)?;
        let writer = self.publisher.create_datawriter_no_key(&made, None).map_err(failed(name))?;
        self.entities.add_writer(writer.guid());
        Ok(RawWriter::new(name, self.participant.clone(), writer))
    }

    pub(crate) fn read(
        &mut self,
        topic: &str,
        type_name: &'static str,
        qos: Qos,
    ) -> Result<Incoming, BusError> {
        let made = self.topic(topic, type_name, qos)?;
        let reader = self.subscriber.create_datareader_no_key::<Raw, AsItIs>(&made, None);
        let reader = reader.map_err(failed(topic))?;
        self.entities.add_reader(reader.guid());
        self.wanted.push(Wanted { topic: topic.to_owned(), type_name, qos });
        Ok(messages(reader, topic))
    }

    pub(crate) fn write<M: Message>(&self, topic: &str, qos: Qos) -> Result<Outgoing<M>, BusError> {
        let made = self.topic(topic, &type_in_dds(M::TYPE), qos)?;
        let writer = self.publisher.create_datawriter_no_key(&made, None).map_err(failed(topic))?;
        self.entities.add_writer(writer.guid());
        let screen = match &self.viewers {
            Some(viewers) => Some(viewers.screen::<M>(topic, qos.kept()).map_err(failed(topic))?),
            None => None,
        };
        Ok(Outgoing { topic: topic.to_owned(), writer, screen })
    }

    /// This program as a node of ROS, with all that is read and written so far.
    pub(crate) fn presence(&self, namespace: &str) -> Result<Presence, BusError> {
        let made = self.topic_in_dds(TOPIC, &type_in_dds(NODES), Qos::Latest)?;
        let reader = self.subscriber.create_datareader_no_key::<Raw, AsItIs>(&made, None);
        let others = messages(reader.map_err(failed(TOPIC))?, TOPIC);
        let writer = self.publisher.create_datawriter_no_key(&made, None).map_err(failed(TOPIC))?;
        let writer = RawWriter::new(TOPIC, self.participant.clone(), writer);
        let gid = self.participant.guid().to_bytes();
        let bridge = Participant { gid, nodes: vec![self.entities.of_node(namespace)] };
        Ok(Presence { others, writer, bridge })
    }

    /// Topics on which somebody publishes images, by their names in ROS.
    pub(crate) fn topics_of_images(&self) -> Vec<String> {
        let writers = self.participant.discovered_writers();
        let topics = writers.iter().map(|writer| &writer.publication_topic_data).filter_map(|writer| {
            let is_image = IMAGES.contains(&type_in_ros(&writer.type_name).as_str());
            is_image.then(|| writer.topic_name.strip_prefix("rt").unwrap_or(&writer.topic_name).to_owned())
        });
        let mut topics: Vec<String> = topics.collect();
        topics.sort();
        topics.dedup();
        topics
    }

    /// Who publishes what is read here in a way that cannot be read, and how to mend it.
    pub(crate) fn mismatches(&self) -> Vec<String> {
        let writers = self.participant.discovered_writers();
        let told = self.wanted.iter().flat_map(|wanted| {
            let name = in_dds(&wanted.topic);
            let requested = wanted.qos.policies();
            writers.iter().map(|writer| &writer.publication_topic_data).filter_map(move |writer| {
                if writer.topic_name != name {
                    return None;
                }
                mismatch(wanted, &writer.type_name, &writer.qos(), &requested)
            })
        });
        let mut told: Vec<String> = told.collect();
        told.sort();
        told.dedup();
        told
    }
}

/// This program's being in the domain. Others hear that it leaves only if this ends last, and before the process does.
pub(crate) struct Membership(DomainParticipant);

impl Membership {
    /// Leaves the domain, once all readers and writers are dropped.
    pub(crate) async fn farewell(self) {
        tokio::time::sleep(FAREWELLS).await;
        // Waits for threads of RustDDS, which send it.
        drop(self.0);
    }
}

/// What comes to a reader, but for what cannot be read.
fn messages(reader: DataReader<Raw, AsItIs>, topic: &str) -> Incoming {
    let told = topic.to_owned();
    Box::pin(reader.async_bare_sample_stream().filter_map(move |message| {
        let message = message.inspect_err(|error| tracing::warn!("{told}: {error:?}")).ok();
        std::future::ready(message.map(|Raw(data)| data))
    }))
}

fn mismatch(
    wanted: &Wanted,
    type_name: &str,
    offered: &QosPolicies,
    requested: &QosPolicies,
) -> Option<String> {
    let topic = &wanted.topic;
    if type_name != wanted.type_name {
        return Some(format!(
            "{topic} is published as {}, and read as {}; name a topic of that type",
            type_in_ros(type_name),
            type_in_ros(wanted.type_name)
        ));
    }
    let failure = offered.compliance_failure_wrt(requested)?;
    let mend = match wanted.qos {
        Qos::Sensor(_) => "set sensor_qos to best-effort, which takes both",
        Qos::Reliable => "publish it as reliable",
        Qos::Latched | Qos::Latest => "publish it as reliable and transient local",
    };
    Some(format!("{topic} is published with a quality of service that is not heard ({failure:?}): {mend}"))
}

/// A writer of one topic, which viewers see as well.
pub(crate) struct Outgoing<M: Message> {
    topic: String,
    writer: DataWriter<M>,
    screen: Option<Screen>,
}

impl<M: Message> Outgoing<M> {
    /// Publishes a message. One that DDS does not take is told in the log: the next one follows soon.
    pub(crate) fn publish(&self, message: M) {
        if let Some(screen) = &self.screen {
            screen.show(&message);
        }
        if let Err(error) = self.writer.write(message, None) {
            tracing::warn!("{} was not published: {error}", self.topic);
        }
    }

    /// Waits until all who read have what was published, or the time is over.
    pub(crate) fn flush(&self, most: std::time::Duration) {
        if !matches!(self.writer.wait_for_acknowledgments(most), Ok(true)) {
            tracing::debug!("{} was not acknowledged by all", self.topic);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IMAGE: &str = "sensor_msgs::msg::dds_::Image_";

    fn told(qos: Qos, type_name: &str, offered: Qos) -> Option<String> {
        let wanted = Wanted { topic: "/image".to_owned(), type_name: IMAGE, qos };
        mismatch(&wanted, type_name, &offered.policies(), &qos.policies())
    }

    #[test]
    fn best_effort_hears_both_and_reliable_only_the_reliable() {
        let best_effort = Qos::Sensor(SensorQos::BestEffort);
        let reliable = Qos::Sensor(SensorQos::Reliable);
        assert_eq!([told(best_effort, IMAGE, best_effort), told(best_effort, IMAGE, reliable)], [None, None]);
        assert!(told(reliable, IMAGE, best_effort).unwrap().contains("best-effort"));
        assert!(told(Qos::Latched, IMAGE, Qos::Reliable).unwrap().contains("transient local"));
    }

    #[test]
    fn another_type_is_told_as_ros_writes_it() {
        let qos = Qos::Sensor(SensorQos::BestEffort);
        let told = told(qos, "sensor_msgs::msg::dds_::CompressedImage_", qos).unwrap();
        assert!(told.contains("/image is published as sensor_msgs/CompressedImage"), "{told}");
    }
}
