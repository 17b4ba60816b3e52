//! Flags for command lines: the contract's enums as their values, `MapSettings` as a flag a field.

include!(concat!(env!("OUT_DIR"), "/flags.rs"));
