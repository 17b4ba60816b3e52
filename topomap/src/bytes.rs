//! Bytes of what the log and the map both store: optional values, beliefs, amounts of evidence.

use fabmap::PlaceId;
use fabmap::codec::{DecodeError, Reader, Writer};
use fabmap::place_filter::Belief;

pub(crate) fn encode_belief(belief: &Belief, writer: &mut Writer) {
    let Belief { places, new_place, remainder } = belief;
    writer.varint(places.len() as u64);
    for &(place, probability) in places {
        writer.u32(place.number());
        writer.f64(probability);
    }
    writer.f64(*new_place);
    writer.f64(*remainder);
}

pub(crate) fn decode_belief(reader: &mut Reader<'_>) -> Result<Belief, DecodeError> {
    let places = reader.count(12)?;
    if places > Belief::MAX_PLACES {
        return Err(DecodeError::invalid(format_args!("a belief of {places} places")));
    }
    let places = (0..places)
        .map(|_| Ok((PlaceId::new(reader.u32()?), reader.f64()?)))
        .collect::<Result<Vec<_>, DecodeError>>()?;
    Ok(Belief { places, new_place: reader.f64()?, remainder: reader.f64()? })
}

pub(crate) fn encode_option<T>(value: Option<&T>, writer: &mut Writer, encode: impl FnOnce(&T, &mut Writer)) {
    writer.u8(u8::from(value.is_some()));
    if let Some(value) = value {
        encode(value, writer);
    }
}

pub(crate) fn decode_option<'a, T>(
    reader: &mut Reader<'a>,
    decode: impl FnOnce(&mut Reader<'a>) -> Result<T, DecodeError>,
) -> Result<Option<T>, DecodeError> {
    if decode_flag(reader)? { decode(reader).map(Some) } else { Ok(None) }
}

pub(crate) fn decode_flag(reader: &mut Reader<'_>) -> Result<bool, DecodeError> {
    match reader.u8()? {
        0 => Ok(false),
        1 => Ok(true),
        other => Err(DecodeError::invalid(format_args!("flag {other}"))),
    }
}

/// A number.
pub(crate) fn finite(value: f64) -> Result<f64, DecodeError> {
    if value.is_finite() { Ok(value) } else { Err(DecodeError::invalid("a motion that is not finite")) }
}

/// An amount of evidence, in inliers, or of way.
pub(crate) fn not_negative(value: f64) -> Result<f64, DecodeError> {
    if value.is_finite() && value >= 0.0 {
        Ok(value)
    } else {
        Err(DecodeError::invalid(format_args!("an amount of {value}")))
    }
}
