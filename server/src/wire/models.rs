//! Models as messages.

use waypost_proto::v1;

use crate::names::model_name;
use crate::service::models::ModelRow;

pub(crate) fn model(row: ModelRow) -> v1::Model {
    let ModelRow { hash, display_name, extractor, words, samples, words_hash, size_bytes, created_ns } = row;
    v1::Model {
        name: model_name(&hash),
        display_name,
        extractor,
        words: u32::try_from(words).unwrap_or(u32::MAX),
        samples: u32::try_from(samples).unwrap_or(u32::MAX),
        words_hash,
        size_bytes,
        create_time_ns: created_ns,
    }
}
