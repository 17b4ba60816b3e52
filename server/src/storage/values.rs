//! Values as columns keep them, in whichever database.

use fabmap::appearance::PlaceId;
use sqlx::any::{AnyTypeInfo, AnyValueRef};
use sqlx::encode::IsNull;
use sqlx::error::BoxDynError;
use sqlx::{Any, Database, Decode, Encode, Type};

use super::StorageError;

/// An integer of the database. Databases have signed ones alone; ours are counts and numbers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Whole(i64);

/// The same, where there may be none.
#[derive(Clone, Copy, Debug)]
pub(super) struct MaybeWhole(Option<i64>);

/// A number for a column that may have none.
#[derive(Clone, Copy, Debug)]
pub(super) struct MaybeReal(pub(super) Option<f64>);

impl Type<Any> for MaybeReal {
    fn type_info() -> AnyTypeInfo {
        <f64 as Type<Any>>::type_info()
    }
}

impl Encode<'_, Any> for MaybeReal {
    fn encode_by_ref(&self, buffer: &mut <Any as Database>::ArgumentBuffer) -> Result<IsNull, BoxDynError> {
        let Self(number) = *self;
        // sqlx 0.9 tells PostgreSQL that no f64 is an f32, and a statement that was prepared for the one does not take the
        // other. It tells it the reverse, too.
        match number {
            Some(number) => Encode::<Any>::encode(number, buffer),
            None => Encode::<Any>::encode(None::<f32>, buffer),
        }
    }
}

impl Type<Any> for Whole {
    fn type_info() -> AnyTypeInfo {
        <i64 as Type<Any>>::type_info()
    }

    fn compatible(found: &AnyTypeInfo) -> bool {
        <i64 as Type<Any>>::compatible(found)
    }
}

impl<'row> Decode<'row, Any> for Whole {
    fn decode(value: AnyValueRef<'row>) -> Result<Self, BoxDynError> {
        Ok(Self(<i64 as Decode<Any>>::decode(value)?))
    }
}

impl Type<Any> for MaybeWhole {
    fn type_info() -> AnyTypeInfo {
        <Option<i64> as Type<Any>>::type_info()
    }

    fn compatible(found: &AnyTypeInfo) -> bool {
        <Option<i64> as Type<Any>>::compatible(found)
    }
}

impl<'row> Decode<'row, Any> for MaybeWhole {
    fn decode(value: AnyValueRef<'row>) -> Result<Self, BoxDynError> {
        Ok(Self(<Option<i64> as Decode<Any>>::decode(value)?))
    }
}

impl TryFrom<Whole> for PlaceId {
    type Error = std::num::TryFromIntError;

    fn try_from(Whole(number): Whole) -> Result<Self, Self::Error> {
        Ok(Self::new(number.try_into()?))
    }
}

impl TryFrom<MaybeWhole> for Option<u64> {
    type Error = std::num::TryFromIntError;

    fn try_from(MaybeWhole(number): MaybeWhole) -> Result<Self, Self::Error> {
        number.map(u64::try_from).transpose()
    }
}

impl TryFrom<MaybeWhole> for Option<u32> {
    type Error = std::num::TryFromIntError;

    fn try_from(MaybeWhole(number): MaybeWhole) -> Result<Self, Self::Error> {
        number.map(u32::try_from).transpose()
    }
}

/// Databases have signed integers alone; ours are counts and never reach 2^63.
pub(super) fn to_sql(count: u64) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

/// A count or a number, as it was before [`to_sql`].
pub(super) fn from_sql<T: TryFrom<i64>>(count: i64) -> Result<T, StorageError> {
    T::try_from(count).map_err(|_| StorageError::Damaged(format!("the count {count}")))
}

/// A list of numbers is JSON already, which databases can read.
pub(super) fn json_list(numbers: impl IntoIterator<Item = i64>) -> String {
    format!("{:?}", numbers.into_iter().collect::<Vec<_>>())
}

/// A column that has one word for each variant of an enum.
macro_rules! words {
    ($enum:ident { $($variant:ident = $word:literal),+ $(,)? }) => {
        impl $enum {
            /// As the column, the API and people have it.
            pub(crate) fn word(self) -> &'static str {
                match self {
                    $(Self::$variant => $word,)+
                }
            }
        }

        impl sqlx::Type<sqlx::Any> for $enum {
            fn type_info() -> sqlx::any::AnyTypeInfo {
                <str as sqlx::Type<sqlx::Any>>::type_info()
            }
        }

        impl<'row> sqlx::Decode<'row, sqlx::Any> for $enum {
            fn decode(value: sqlx::any::AnyValueRef<'row>) -> Result<Self, sqlx::error::BoxDynError> {
                match <&str as sqlx::Decode<sqlx::Any>>::decode(value)? {
                    $($word => Ok(Self::$variant),)+
                    other => Err(format!("the word {other:?} in a column of {}", stringify!($enum)).into()),
                }
            }
        }

        impl sqlx::Encode<'_, sqlx::Any> for $enum {
            fn encode_by_ref(
                &self,
                buffer: &mut <sqlx::Any as sqlx::Database>::ArgumentBuffer,
            ) -> Result<sqlx::encode::IsNull, sqlx::error::BoxDynError> {
                sqlx::Encode::<sqlx::Any>::encode(self.word(), buffer)
            }
        }
    };
}

pub(super) use words;
