//! Writes command-line flags, for programs that take enums or whole messages of the contract.
//! Names and help are those of the contract.

use std::fmt::Write;

use prost_types::field_descriptor_proto::Type;
use prost_types::source_code_info::Location;
use prost_types::{DescriptorProto, EnumDescriptorProto, FileDescriptorProto, FileDescriptorSet};

use crate::json::{PACKAGE, enum_path, pascal, snake, without_prefix};

/// Messages that are given as flags, a flag a field.
const MESSAGES: [&str; 2] = ["MapSettings", "Quotas"];
/// Flags that are given together or not at all.
const TOGETHER: [[&str; 2]; 1] = [["true_positive_rate", "false_positive_rate"]];

/// Numbers of fields in `descriptor.proto`, which paths to comments are made of.
const FILE_MESSAGES: i32 = 4;
const FILE_ENUMS: i32 = 5;
const MESSAGE_FIELDS: i32 = 2;
const MESSAGE_ENUMS: i32 = 4;
const ENUM_VALUES: i32 = 2;

/// The Rust code of all flags.
pub(crate) fn generate(set: &FileDescriptorSet) -> String {
    let mut code = String::new();
    for file in set.file.iter().filter(|file| file.package() == PACKAGE) {
        for (descriptor, index) in file.enum_type.iter().zip(0..) {
            let path = format!("crate::v1::{}", descriptor.name());
            write_enum(&mut code, file, descriptor, &path, &[FILE_ENUMS, index]);
        }
        for (message, number) in file.message_type.iter().zip(0..) {
            for (descriptor, index) in message.enum_type.iter().zip(0..) {
                let path = format!("crate::v1::{}::{}", snake(message.name()), descriptor.name());
                let place = [FILE_MESSAGES, number, MESSAGE_ENUMS, index];
                write_enum(&mut code, file, descriptor, &path, &place);
            }
            if MESSAGES.contains(&message.name()) {
                write_message(&mut code, file, message, number);
            }
        }
    }
    code
}

/// `clap::ValueEnum`: every value but the unspecified one.
fn write_enum(
    code: &mut String,
    file: &FileDescriptorProto,
    descriptor: &EnumDescriptorProto,
    path: &str,
    place: &[i32],
) {
    let mut variants = String::new();
    let mut helps = String::new();
    for (value, index) in descriptor.value.iter().zip(0..) {
        let name = pascal(&without_prefix(descriptor, value));
        let help = comment(file, &[place, &[ENUM_VALUES, index]].concat());
        let _ = writeln!(helps, "            Self::{name} => {help:?},");
        if value.number() != 0 {
            let _ = write!(variants, "Self::{name}, ");
        }
    }
    let _ = write!(
        code,
        "impl clap::ValueEnum for {path} {{
    fn value_variants<'a>() -> &'a [Self] {{
        &[{variants}]
    }}

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {{
        let help = match self {{
{helps}        }};
        let value = clap::builder::PossibleValue::new(self.json_name());
        Some(if help.is_empty() {{ value }} else {{ value.help(help) }})
    }}
}}
"
    );
}

/// `clap::Args` with an optional flag for each field, and the message made of them.
fn write_message(code: &mut String, file: &FileDescriptorProto, message: &DescriptorProto, number: i32) {
    let name = message.name();
    let mut fields = String::new();
    let mut values = String::new();
    for (field, index) in message.field.iter().zip(0..) {
        let flag = field.name();
        let help = comment(file, &[FILE_MESSAGES, number, MESSAGE_FIELDS, index]);
        assert!(!help.is_empty(), "{name}.{flag} is a flag: it needs a comment");
        let partner = TOGETHER.iter().find(|pair| pair.contains(&flag));
        let partner = partner.and_then(|pair| pair.iter().find(|&&other| other != flag));
        let requires = partner.map_or_else(String::new, |other| format!(", requires = {other:?}"));
        let (kind, options, value) = match field.r#type() {
            Type::Enum => (enum_path(field.type_name()), "value_enum", ".map_or(0, Into::into)"),
            Type::Double if flag.ends_with("_m") => ("f64".to_owned(), "value_name = \"M\"", ""),
            Type::Double if flag.ends_with("_rad") => ("f64".to_owned(), "value_name = \"RAD\"", ""),
            Type::Double => ("f64".to_owned(), "value_name = \"NUMBER\"", ""),
            Type::Uint32 => ("u32".to_owned(), "value_name = \"N\"", ""),
            other => panic!("{name}.{flag}: {other:?} is not expected"),
        };
        let _ = writeln!(fields, "    #[arg(long, help = {help:?}, {options}{requires})]");
        let _ = writeln!(fields, "    pub {flag}: Option<{kind}>,");
        let _ = writeln!(values, "            {flag}: flags.{flag}{value},");
    }
    let _ = write!(
        code,
        "/// `{name}` as flags of a command line.
#[derive(Clone, Debug, Default, PartialEq, clap::Args)]
pub struct {name}Flags {{
{fields}}}

impl From<{name}Flags> for crate::v1::{name} {{
    fn from(flags: {name}Flags) -> Self {{
        Self {{
{values}        }}
    }}
}}
"
    );
}

/// The comment before an element in the contract, on one line and without its last full stop.
fn comment(file: &FileDescriptorProto, place: &[i32]) -> String {
    let locations = file.source_code_info.iter().flat_map(|info| &info.location);
    let text: String =
        locations.filter(|location| location.path == place).map(Location::leading_comments).collect();
    let line = text.split_whitespace().collect::<Vec<_>>().join(" ");
    line.strip_suffix('.').unwrap_or(&line).to_owned()
}
