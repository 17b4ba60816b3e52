//! The parts of our own packages by their full names.

use std::collections::BTreeMap;

use prost_types::{
    DescriptorProto, EnumDescriptorProto, FileDescriptorProto, FileDescriptorSet, ServiceDescriptorProto,
};

/// Where an element is in its file: what source comments are found by.
pub(crate) type Path = Vec<i32>;

/// Field numbers of descriptor.proto that make up paths.
const FILE_MESSAGE: i32 = 4;
const FILE_ENUM: i32 = 5;
const FILE_SERVICE: i32 = 6;
const MESSAGE_NESTED: i32 = 3;
const MESSAGE_ENUM: i32 = 4;

pub(crate) struct Element<'a, T> {
    pub(crate) file: &'a FileDescriptorProto,
    pub(crate) path: Path,
    pub(crate) descriptor: &'a T,
}

/// All that is in the packages `waypost.*`; what others have written is theirs.
#[derive(Default)]
pub(crate) struct Elements<'a> {
    pub(crate) files: Vec<&'a FileDescriptorProto>,
    pub(crate) messages: BTreeMap<String, Element<'a, DescriptorProto>>,
    pub(crate) enums: BTreeMap<String, Element<'a, EnumDescriptorProto>>,
    pub(crate) services: BTreeMap<String, Element<'a, ServiceDescriptorProto>>,
}

impl<'a> Elements<'a> {
    pub(crate) fn of(set: &'a FileDescriptorSet) -> Self {
        let mut elements = Self::default();
        for file in set.file.iter().filter(|file| file.package().split('.').next() == Some("waypost")) {
            elements.files.push(file);
            for (index, message) in (0..).zip(&file.message_type) {
                elements.add_message(file, file.package(), vec![FILE_MESSAGE, index], message);
            }
            for (index, descriptor) in (0..).zip(&file.enum_type) {
                elements.add_enum(file, file.package(), vec![FILE_ENUM, index], descriptor);
            }
            for (index, descriptor) in (0..).zip(&file.service) {
                let name = format!("{}.{}", file.package(), descriptor.name());
                let path = vec![FILE_SERVICE, index];
                elements.services.insert(name, Element { file, path, descriptor });
            }
        }
        elements
    }

    fn add_message(
        &mut self,
        file: &'a FileDescriptorProto,
        scope: &str,
        path: Path,
        descriptor: &'a DescriptorProto,
    ) {
        let name = format!("{scope}.{}", descriptor.name());
        for (index, nested) in (0..).zip(&descriptor.nested_type) {
            self.add_message(file, &name, extended(&path, MESSAGE_NESTED, index), nested);
        }
        for (index, nested) in (0..).zip(&descriptor.enum_type) {
            self.add_enum(file, &name, extended(&path, MESSAGE_ENUM, index), nested);
        }
        self.messages.insert(name, Element { file, path, descriptor });
    }

    fn add_enum(
        &mut self,
        file: &'a FileDescriptorProto,
        scope: &str,
        path: Path,
        descriptor: &'a EnumDescriptorProto,
    ) {
        let name = format!("{scope}.{}", descriptor.name());
        self.enums.insert(name, Element { file, path, descriptor });
    }
}

impl<T> Element<'_, T> {
    /// The comment before the element at this one's path, extended by `further`.
    pub(crate) fn comment(&self, further: &[i32]) -> &str {
        let path: Path = self.path.iter().chain(further).copied().collect();
        let locations = self.file.source_code_info.iter().flat_map(|info| &info.location);
        let location = locations.into_iter().find(|location| location.path == path);
        location.map_or("", |location| location.leading_comments()).trim()
    }
}

fn extended(path: &[i32], field: i32, index: i32) -> Path {
    path.iter().copied().chain([field, index]).collect()
}
