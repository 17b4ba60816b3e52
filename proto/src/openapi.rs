//! The JSON of messages, described for OpenAPI from the contract's own comments.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::OnceLock;

use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type as FieldType};
use prost_types::{DescriptorProto, EnumDescriptorProto, FieldDescriptorProto, FileDescriptorSet};
use utoipa::openapi::schema::{
    AllOfBuilder, ArrayBuilder, ObjectBuilder, OneOfBuilder, Schema, SchemaFormat, SchemaType, Type,
};
use utoipa::openapi::{Ref, RefOr};

include!(concat!(env!("OUT_DIR"), "/openapi.rs"));

/// Field numbers of descriptor.proto, which comments are found by.
const FILE_MESSAGES: i32 = 4;
const FILE_ENUMS: i32 = 5;
const MESSAGE_FIELDS: i32 = 2;
const MESSAGE_ENUMS: i32 = 4;
const ENUM_VALUES: i32 = 2;

/// The contract by full names, as `.waypost.v1.Job.State`.
#[derive(Default)]
struct Contract {
    messages: BTreeMap<String, (DescriptorProto, Comments)>,
    enums: BTreeMap<String, (EnumDescriptorProto, Comments)>,
}

/// The comments of an element: its own, and those of its fields or values.
#[derive(Default)]
struct Comments {
    own: String,
    parts: Vec<String>,
}

/// The schema of a message.
pub(crate) fn schema(name: &str) -> RefOr<Schema> {
    let (message, comments) = &contract().messages[name];
    let mut object = ObjectBuilder::new().description(Some(comments.own.clone()));
    for (field, comment) in message.field.iter().zip(&comments.parts) {
        if field.r#type() != FieldType::Bytes {
            object = object.property(field.name(), described(field, comment)).required(field.name());
        }
    }
    object.into()
}

/// The schemas of all messages that a message holds.
pub(crate) fn held(name: &str, schemas: &mut Vec<(String, RefOr<Schema>)>) {
    let mut waiting = vec![name.to_owned()];
    let mut seen = BTreeSet::from([name.to_owned()]);
    while let Some(name) = waiting.pop() {
        for field in &contract().messages[&name].0.field {
            if field.r#type() == FieldType::Message && seen.insert(field.type_name().to_owned()) {
                schemas.push((local(field.type_name()).to_owned(), schema(field.type_name())));
                waiting.push(field.type_name().to_owned());
            }
        }
    }
}

fn described(field: &FieldDescriptorProto, comment: &str) -> RefOr<Schema> {
    let may_be_absent = field.label() != Label::Repeated
        && (field.oneof_index.is_some() || field.r#type() == FieldType::Message);
    let description = Some(comment.to_owned()).filter(|comment| !comment.is_empty());
    if field.label() == Label::Repeated {
        return ArrayBuilder::new().description(description).items(value(field, false)).into();
    }
    match value(field, may_be_absent) {
        RefOr::Ref(reference) if may_be_absent => OneOfBuilder::new()
            .description(description)
            .item(ObjectBuilder::new().schema_type(Type::Null))
            .item(reference)
            .into(),
        RefOr::Ref(reference) => AllOfBuilder::new().description(description).item(reference).into(),
        RefOr::T(Schema::Object(mut object)) => {
            let both = [description, object.description.take()].into_iter().flatten();
            object.description = Some(both.collect::<Vec<_>>().join(" ")).filter(|text| !text.is_empty());
            RefOr::T(Schema::Object(object))
        }
        other => other,
    }
}

/// The schema of one value of a field.
fn value(field: &FieldDescriptorProto, may_be_absent: bool) -> RefOr<Schema> {
    let (kind, format) = match field.r#type() {
        FieldType::Message => return Ref::from_schema_name(local(field.type_name())).into(),
        FieldType::Enum => return enumeration(field.type_name()),
        FieldType::String => (Type::String, None),
        FieldType::Bool => (Type::Boolean, None),
        FieldType::Double => (Type::Number, Some("double")),
        FieldType::Float => (Type::Number, Some("float")),
        FieldType::Uint32 => (Type::Integer, Some("uint32")),
        FieldType::Uint64 => (Type::Integer, Some("uint64")),
        FieldType::Int64 => (Type::Integer, Some("int64")),
        other => unreachable!("{}: no field of the contract has the type {other:?}", field.name()),
    };
    let kinds =
        if may_be_absent { SchemaType::Array(vec![kind, Type::Null]) } else { SchemaType::Type(kind) };
    let minimum = format.filter(|format| format.starts_with('u')).map(|_| 0);
    let format = format.map(|format| SchemaFormat::Custom(format.to_owned()));
    ObjectBuilder::new().schema_type(kinds).format(format).minimum(minimum).into()
}

fn enumeration(name: &str) -> RefOr<Schema> {
    let (descriptor, comments) = &contract().enums[name];
    let mut description = vec![comments.own.clone()];
    let mut names = Vec::new();
    for (value, comment) in descriptor.value.iter().zip(&comments.parts).skip(1) {
        let name = json_name(descriptor, value.name());
        if !comment.is_empty() {
            description.push(format!("`{name}`: {comment}"));
        }
        names.push(name);
    }
    description.retain(|part| !part.is_empty());
    let description = Some(description.join(" ")).filter(|text| !text.is_empty());
    ObjectBuilder::new().schema_type(Type::String).description(description).enum_values(Some(names)).into()
}

/// A value without the prefix that its enum gives it, in lower case.
fn json_name(descriptor: &EnumDescriptorProto, value: &str) -> String {
    // The first value is named {PREFIX}_UNSPECIFIED.
    let first = descriptor.value.first().map_or("", |first| first.name());
    let prefix = first.strip_suffix("UNSPECIFIED").unwrap_or_default();
    value.strip_prefix(prefix).unwrap_or(value).to_ascii_lowercase()
}

fn contract() -> &'static Contract {
    static CONTRACT: OnceLock<Contract> = OnceLock::new();
    CONTRACT.get_or_init(|| {
        let set = FileDescriptorSet::decode(crate::FILE_DESCRIPTOR_SET)
            .unwrap_or_else(|error| unreachable!("the descriptors were encoded by the build: {error}"));
        Contract::of(&set)
    })
}

impl Contract {
    fn of(set: &FileDescriptorSet) -> Self {
        let names = json_names(set);
        let mut contract = Self::default();
        for file in &set.file {
            let locations = file.source_code_info.iter().flat_map(|info| &info.location);
            let comments: BTreeMap<&[i32], String> = locations
                .map(|location| (location.path.as_slice(), readable(location.leading_comments(), &names)))
                .collect();
            let at = |path: &[i32]| comments.get(path).cloned().unwrap_or_default();
            let of = |path: &[i32], part: i32, count: usize| Comments {
                own: at(path),
                parts: (0..count as i32).map(|index| at(&[path, &[part, index]].concat())).collect(),
            };
            for (index, message) in (0..).zip(&file.message_type) {
                let name = format!(".{}.{}", file.package(), message.name());
                let path = [FILE_MESSAGES, index];
                for (index, descriptor) in (0..).zip(&message.enum_type) {
                    let path = [path.as_slice(), &[MESSAGE_ENUMS, index]].concat();
                    let comments = of(&path, ENUM_VALUES, descriptor.value.len());
                    let name = format!("{name}.{}", descriptor.name());
                    contract.enums.insert(name, (descriptor.clone(), comments));
                }
                let comments = of(&path, MESSAGE_FIELDS, message.field.len());
                contract.messages.insert(name, (message.clone(), comments));
            }
            for (index, descriptor) in (0..).zip(&file.enum_type) {
                let comments = of(&[FILE_ENUMS, index], ENUM_VALUES, descriptor.value.len());
                let name = format!(".{}.{}", file.package(), descriptor.name());
                contract.enums.insert(name, (descriptor.clone(), comments));
            }
        }
        // Its code is shown by name, and its details not at all.
        if let Some((status, comments)) = contract.messages.get_mut(".google.rpc.Status") {
            status.field.truncate(2);
            status.field[0].r#type = Some(FieldType::String.into());
            comments.parts[0] = "The gRPC status code in lower snake case, as in `not_found`.".to_owned();
        }
        contract
    }
}

/// What comments call the values of enums, and what JSON calls them; long names before their beginnings.
fn json_names(set: &FileDescriptorSet) -> Vec<(String, String)> {
    let nested = set.file.iter().flat_map(|file| &file.message_type).flat_map(|message| &message.enum_type);
    let enums = set.file.iter().flat_map(|file| &file.enum_type).chain(nested);
    let mut names: Vec<(String, String)> = enums
        .flat_map(|descriptor| {
            let values = descriptor.value.iter();
            values
                .map(|value| (value.name().to_owned(), format!("`{}`", json_name(descriptor, value.name()))))
        })
        .collect();
    names.sort_by_key(|(name, _)| std::cmp::Reverse(name.len()));
    names.dedup();
    names
}

/// A comment on one line, with the values of enums as JSON has them.
fn readable(comment: &str, names: &[(String, String)]) -> String {
    let line = comment.split_whitespace().collect::<Vec<_>>().join(" ");
    names.iter().fold(line, |line, (name, json)| line.replace(name, json))
}

/// `Frame` of `.waypost.v1.Frame`.
fn local(name: &str) -> &str {
    name.rsplit('.').next().unwrap_or(name)
}
