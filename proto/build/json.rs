//! Writes `serde::Serialize` for the messages, so that REST and the command line show one JSON.
//!
//! Every field is there: one without a value is null, also the members of a oneof that are not set.
//! An enum's value is its name without the prefix, in lower case. Bytes are left out: what they hold
//! is fetched as a file.

use std::fmt::Write;

use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto, FileDescriptorSet,
};

pub(crate) const PACKAGE: &str = "waypost.v1";

/// Messages that are read from JSON, too. What is left out or null has no value, and other fields are refused.
const READ: [&str; 2] = ["MapSettings", "Quotas"];

/// The Rust code of all implementations.
pub(crate) fn generate(set: &FileDescriptorSet) -> String {
    let mut code = String::new();
    for file in set.file.iter().filter(|file| file.package() == PACKAGE) {
        for message in &file.message_type {
            write_message(&mut code, message);
        }
        for descriptor in &file.enum_type {
            write_enum(&mut code, &format!("crate::v1::{}", descriptor.name()), descriptor);
        }
    }
    code
}

/// The Rust code that describes the same messages for OpenAPI.
pub(crate) fn describe(set: &FileDescriptorSet) -> String {
    let files = set.file.iter().filter(|file| file.package() == PACKAGE);
    let messages = files.flat_map(|file| &file.message_type).map(DescriptorProto::name);
    let shown = messages.filter(|name| !name.ends_with("Request"));
    shown
        .map(|name| {
            format!(
                "impl utoipa::PartialSchema for crate::v1::{name} {{
    fn schema() -> RefOr<Schema> {{
        schema(\".{PACKAGE}.{name}\")
    }}
}}

impl utoipa::ToSchema for crate::v1::{name} {{
    fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {{
        held(\".{PACKAGE}.{name}\", schemas);
    }}
}}
"
            )
        })
        .collect()
}

fn write_message(code: &mut String, message: &DescriptorProto) {
    let (name, module) = (message.name(), snake(message.name()));
    assert!(message.nested_type.is_empty(), "{name}: nested messages are not expected");
    for descriptor in &message.enum_type {
        write_enum(code, &format!("crate::v1::{module}::{}", descriptor.name()), descriptor);
    }
    // Requests are never shown.
    if name.ends_with("Request") {
        return;
    }
    let fields: Vec<_> = message.field.iter().filter(|field| field.r#type() != Type::Bytes).collect();
    let count = fields.len();
    let lines: String = fields.into_iter().map(|field| field_line(message, field)).collect();
    let _ = write!(
        code,
        "impl ::serde::Serialize for crate::v1::{name} {{
    fn serialize<S: ::serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {{
        use ::serde::ser::SerializeStruct;
        #[allow(unused_mut)]
        let mut object = serializer.serialize_struct({name:?}, {count})?;
{lines}        object.end()
    }}
}}
"
    );
    if READ.contains(&name) {
        write_reader(code, message);
    }
}

/// `serde::Deserialize`, for messages of numbers and enums.
fn write_reader(code: &mut String, message: &DescriptorProto) {
    let name = message.name();
    let mut fields = String::new();
    let mut values = String::new();
    for field in &message.field {
        let field_name = field.name();
        let (kind, value) = match field.r#type() {
            Type::Enum => {
                let path = enum_path(field.type_name());
                let named = format!(
                    "crate::json::named(fields.{field_name}, {path}::from_json_name, {path}::NAMES)?"
                );
                ("String", named)
            }
            Type::Double => ("f64", format!("fields.{field_name}")),
            Type::Uint32 => ("u32", format!("fields.{field_name}")),
            other => panic!("{name}.{field_name}: {other:?} is not expected"),
        };
        let _ = writeln!(fields, "            {field_name}: Option<{kind}>,");
        let _ = writeln!(values, "            {field_name}: {value},");
    }
    let _ = write!(
        code,
        "impl<'de> ::serde::Deserialize<'de> for crate::v1::{name} {{
    fn deserialize<D: ::serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {{
        #[derive(Default, ::serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        struct Fields {{
{fields}        }}
        let fields = Fields::deserialize(deserializer)?;
        Ok(Self {{
{values}        }})
    }}
}}
"
    );
}

fn field_line(message: &DescriptorProto, field: &FieldDescriptorProto) -> String {
    let name = field.name();
    let rust_name = if name == "match" { "r#match" } else { name };
    let is_in_oneof = field.oneof_index.is_some() && !field.proto3_optional();
    let value = if is_in_oneof {
        let oneof = &message.oneof_decl[field.oneof_index() as usize];
        let module = snake(message.name());
        let path = format!("crate::v1::{module}::{}::{}", pascal(oneof.name()), pascal(name));
        format!("match &self.{} {{ Some({path}(value)) => Some(value), _ => None }}", oneof.name())
    } else if field.r#type() == Type::Enum {
        assert!(!field.proto3_optional(), "{name}: not expected");
        let shown = if field.label() == Label::Repeated { "shown_each(&" } else { "shown(" };
        format!("crate::json::{shown}self.{rust_name}, {}::json_name)", enum_path(field.type_name()))
    } else {
        format!("self.{rust_name}")
    };
    format!("        object.serialize_field({name:?}, &{value})?;\n")
}

fn write_enum(code: &mut String, path: &str, descriptor: &EnumDescriptorProto) {
    let words = descriptor.value.iter().map(|value| without_prefix(descriptor, value));
    let words: Vec<(String, String)> = words.map(|word| (pascal(&word), word)).collect();
    let names: String =
        words.iter().map(|(variant, word)| format!("            Self::{variant} => {word:?},\n")).collect();
    let known = || words.iter().filter(|(_, word)| word != "unspecified");
    let listed: String = known().map(|(_, word)| format!("{word:?}, ")).collect();
    let parsed: String =
        known().map(|(variant, word)| format!("            {word:?} => Some(Self::{variant}),\n")).collect();
    let _ = write!(
        code,
        "impl {path} {{
    /// All names that a value can be given by.
    pub const NAMES: &'static [&'static str] = &[{listed}];

    /// Its name in JSON and on the command line.
    pub fn json_name(self) -> &'static str {{
        match self {{
{names}        }}
    }}

    /// The value of that name; `None` for `unspecified` and what is no name.
    pub fn from_json_name(name: &str) -> Option<Self> {{
        match name {{
{parsed}            _ => None,
        }}
    }}
}}
"
    );
}

/// `DEPENDENCE_CHOW_LIU` of the enum `Dependence` as `chow_liu`.
pub(crate) fn without_prefix(descriptor: &EnumDescriptorProto, value: &EnumValueDescriptorProto) -> String {
    let prefix = format!("{}_", snake(descriptor.name()).to_ascii_uppercase());
    value.name().strip_prefix(&prefix).unwrap_or(value.name()).to_ascii_lowercase()
}

/// `.waypost.v1.Job.State` as `crate::v1::job::State`.
pub(crate) fn enum_path(type_name: &str) -> String {
    let local = type_name.strip_prefix(".waypost.v1.").unwrap_or(type_name);
    match local.split_once('.') {
        Some((message, name)) => format!("crate::v1::{}::{name}", snake(message)),
        None => format!("crate::v1::{local}"),
    }
}

pub(crate) fn snake(name: &str) -> String {
    let mut snake = String::new();
    for c in name.chars() {
        if c.is_ascii_uppercase() && !snake.is_empty() {
            snake.push('_');
        }
        snake.push(c.to_ascii_lowercase());
    }
    snake
}

pub(crate) fn pascal(name: &str) -> String {
    let capital = |part: &str| part[..1].to_ascii_uppercase() + &part[1..];
    name.split('_').filter(|part| !part.is_empty()).map(capital).collect()
}
