//! Messages as DDS carries them, which others read and lay out.

use std::convert::Infallible;
use std::pin::Pin;

use futures::Stream;
use rustdds::no_key::{DataWriter, Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter};
use rustdds::rpc::SampleIdentity;
use rustdds::{DomainParticipant, GUID, RepresentationIdentifier, WriteOptions, bytes::Bytes};

/// Messages of a topic, each behind its four bytes of encapsulation.
pub(crate) type Incoming = Pin<Box<dyn Stream<Item = Vec<u8>> + Send>>;

/// A message as it came, behind its four bytes of encapsulation.
pub(crate) struct Raw(pub(crate) Vec<u8>);

/// Leaves messages as they came, or as they were laid out.
pub(crate) struct AsItIs;

impl DeserializerAdapter<Raw> for AsItIs {
    type Error = Infallible;
    type Decoded = Raw;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE, RepresentationIdentifier::CDR_BE]
    }

    fn transform_decoded(decoded: Raw) -> Raw {
        decoded
    }
}

impl DefaultDecoder<Raw> for AsItIs {
    type Decoder = Copying;
    const DECODER: Copying = Copying;
}

#[derive(Clone)]
pub(crate) struct Copying;

impl Decode<'_, Raw> for Copying {
    type Error = Infallible;

    fn decode_bytes(self, data: &[u8], encoding: RepresentationIdentifier) -> Result<Raw, Infallible> {
        let order = u8::from(encoding == RepresentationIdentifier::CDR_LE);
        let mut whole = Vec::with_capacity(data.len() + 4);
        whole.extend([0, order, 0, 0]);
        whole.extend_from_slice(data);
        Ok(Raw(whole))
    }
}

/// A message that is laid out, in little endian and without its encapsulation.
pub(crate) struct Body(Bytes);

impl SerializerAdapter<Body> for AsItIs {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(Body(data): &Body) -> Result<Bytes, Infallible> {
        Ok(data.clone())
    }
}

/// A message of somebody who may be answered.
pub(crate) struct Sample {
    pub(crate) data: Vec<u8>,
    /// Who wrote it, and which of theirs it is.
    pub(crate) identity: SampleIdentity,
    /// What it has to do with, if it says so.
    pub(crate) related: Option<SampleIdentity>,
}

/// Writes messages that are laid out.
pub(crate) struct RawWriter {
    topic: String,
    participant: DomainParticipant,
    writer: DataWriter<Body, AsItIs>,
}

impl RawWriter {
    pub(crate) fn new(topic: &str, participant: DomainParticipant, writer: DataWriter<Body, AsItIs>) -> Self {
        Self { topic: topic.to_owned(), participant, writer }
    }

    /// Writes a message, and says which of this writer's it is; one that DDS does not take is told in the log.
    pub(crate) fn write(&self, body: Vec<u8>, options: WriteOptions) -> Option<SampleIdentity> {
        let written = self.writer.write_with_options(Body(Bytes::from(body)), options);
        written.inspect_err(|error| tracing::warn!("{} was not written: {error}", self.topic)).ok()
    }

    /// The program that reads this, and writes a topic besides.
    pub(crate) fn reader_with(&self, written: &str) -> Option<[u8; 12]> {
        let readers = self.participant.discovered_readers();
        let writers = self.participant.discovered_writers();
        let prefix = |guid: GUID| {
            let whole = guid.to_bytes();
            std::array::from_fn(|at| whole[at])
        };
        let readers = readers.iter().filter(|reader| reader.subscription_topic_data.topic_name == self.topic);
        let mut served = readers.map(|reader| reader.reader_proxy.remote_reader_guid).filter(|reader| {
            writers.iter().any(|writer| {
                writer.publication_topic_data.topic_name == written
                    && writer.writer_proxy.remote_writer_guid.prefix == reader.prefix
            })
        });
        served.next().map(prefix)
    }

    /// Whether somebody reads this in the program of another reader or writer.
    pub(crate) fn is_read_beside(&self, of: GUID) -> bool {
        self.participant.discovered_readers().iter().any(|reader| {
            reader.subscription_topic_data.topic_name == self.topic
                && reader.reader_proxy.remote_reader_guid.prefix == of.prefix
        })
    }
}
