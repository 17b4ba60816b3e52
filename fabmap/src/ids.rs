//! Numbers of places and words as types of their own, so that one cannot be taken for another.

use std::fmt;

macro_rules! ids {
    ($($(#[$doc:meta])* $name:ident;)+) => {
        $(
            $(#[$doc])*
            #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
            #[repr(transparent)]
            pub struct $name(u32);

            impl $name {
                /// The largest number there can be.
                pub const MAX: Self = Self(u32::MAX);

                /// From its number.
                #[must_use]
                #[inline(always)]
                pub const fn new(number: u32) -> Self {
                    Self(number)
                }

                /// From an index below 2^32.
                #[must_use]
                #[inline(always)]
                pub const fn from_index(index: usize) -> Self {
                    Self(index as u32)
                }

                /// Its number.
                #[must_use]
                #[inline(always)]
                pub const fn number(self) -> u32 {
                    self.0
                }

                /// Its number, as an index.
                #[must_use]
                #[inline(always)]
                pub const fn index(self) -> usize {
                    self.0 as usize
                }

                /// The number after it, which must be below the largest.
                #[must_use]
                #[inline(always)]
                pub const fn next(self) -> Self {
                    Self(self.0 + 1)
                }

                /// The same, counted from `first` on in place of 0; the sum must be below 2^32.
                #[must_use]
                #[inline(always)]
                pub const fn counted_from(self, first: Self) -> Self {
                    Self(first.0 + self.0)
                }

                /// The first `count`, from number 0 on.
                #[inline(always)]
                pub fn first(count: usize) -> impl ExactSizeIterator<Item = Self> + DoubleEndedIterator + Clone {
                    (0..count as u32).map(Self)
                }

                /// It and all that follow.
                #[inline(always)]
                pub fn onwards(self) -> impl Iterator<Item = Self> + Clone {
                    (self.0..).map(Self)
                }

                /// All that follow number 0, itself included.
                #[inline(always)]
                pub fn all() -> impl Iterator<Item = Self> + Clone {
                    (0..).map(Self)
                }
            }

            impl From<u32> for $name {
                #[inline(always)]
                fn from(number: u32) -> Self {
                    Self(number)
                }
            }

            impl From<$name> for u32 {
                #[inline(always)]
                fn from(id: $name) -> Self {
                    id.0
                }
            }

            impl From<$name> for u64 {
                #[inline(always)]
                fn from(id: $name) -> Self {
                    id.0.into()
                }
            }

            impl fmt::Display for $name {
                fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                    self.0.fmt(formatter)
                }
            }
        )+
    };
}

ids! {
    /// Number of a visual word, counted from 0.
    WordId;
    /// Number of a place within its map, counted from 0 in order of creation.
    PlaceId;
}
