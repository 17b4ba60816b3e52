//! How the contract is written: names, and comments where they say something.

use std::collections::BTreeMap;

use prost_types::{DescriptorProto, EnumDescriptorProto, FileDescriptorSet, ServiceDescriptorProto};

use crate::Finding;
use crate::elements::{Element, Elements};

/// Field number of `method` in descriptor.proto's ServiceDescriptorProto.
const SERVICE_METHOD: i32 = 2;

/// All that is not written as it should be.
pub(crate) fn unclean(set: &FileDescriptorSet) -> Vec<Finding> {
    let elements = Elements::of(set);
    let mut findings = Vec::new();
    for file in &elements.files {
        if !is_versioned(file.package()) {
            findings.push(Finding::new(file.package(), "the package does not end in a version, as in .v1"));
        }
        let folder = file.name().rsplit_once('/').map_or("", |(folder, _)| folder);
        if folder != file.package().replace('.', "/") {
            findings.push(Finding::new(file.name(), "the file does not lie in the folder of its package"));
        }
    }
    for (name, service) in &elements.services {
        check_service(name, service, &mut findings);
    }
    for (name, message) in &elements.messages {
        check_message(name, message, &mut findings);
    }
    for (name, descriptor) in &elements.enums {
        check_enum(name, descriptor, &mut findings);
    }
    check_exchanges(&elements, &mut findings);
    findings.sort();
    findings
}

fn check_service(name: &str, service: &Element<'_, ServiceDescriptorProto>, findings: &mut Vec<Finding>) {
    if !name.ends_with("Service") || !is_pascal(service.descriptor.name()) {
        findings.push(Finding::new(name, "a service is named in PascalCase and ends in Service"));
    }
    if service.comment(&[]).is_empty() {
        findings.push(Finding::new(name, "the service has no comment"));
    }
    for (index, rpc) in (0..).zip(&service.descriptor.method) {
        let rpc_name = format!("{name}.{}", rpc.name());
        if !is_pascal(rpc.name()) {
            findings.push(Finding::new(&rpc_name, "an rpc is named in PascalCase"));
        }
        if service.comment(&[SERVICE_METHOD, index]).is_empty() {
            findings.push(Finding::new(&rpc_name, "the rpc has no comment"));
        }
    }
}

fn check_message(name: &str, message: &Element<'_, DescriptorProto>, findings: &mut Vec<Finding>) {
    let descriptor = message.descriptor;
    if !is_pascal(descriptor.name()) {
        findings.push(Finding::new(name, "a message is named in PascalCase"));
    }
    // The comment of its rpc is that of a request or a response.
    let is_exchanged = name.ends_with("Request") || name.ends_with("Response");
    if !is_exchanged && message.comment(&[]).is_empty() {
        findings.push(Finding::new(name, "the message has no comment"));
    }
    for field in &descriptor.field {
        let field_name = format!("{name}.{}", field.name());
        if !is_snake(field.name()) {
            findings.push(Finding::new(&field_name, "a field is named in lower_snake_case"));
        }
        let reserved_number = descriptor
            .reserved_range
            .iter()
            .any(|range| (range.start()..range.end()).contains(&field.number()));
        if reserved_number || descriptor.reserved_name.iter().any(|reserved| reserved == field.name()) {
            findings.push(Finding::new(&field_name, "the number or name of the field is reserved"));
        }
    }
    for oneof in descriptor.oneof_decl.iter().filter(|oneof| !oneof.name().starts_with('_')) {
        if !is_snake(oneof.name()) {
            let oneof_name = format!("{name}.{}", oneof.name());
            findings.push(Finding::new(&oneof_name, "a oneof is named in lower_snake_case"));
        }
    }
}

fn check_enum(name: &str, element: &Element<'_, EnumDescriptorProto>, findings: &mut Vec<Finding>) {
    let descriptor = element.descriptor;
    if !is_pascal(descriptor.name()) {
        findings.push(Finding::new(name, "an enum is named in PascalCase"));
    }
    let prefix = upper_snake(descriptor.name());
    for value in &descriptor.value {
        let value_name = format!("{name}.{}", value.name());
        let is_upper = value.name().chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_');
        if !is_upper || !value.name().starts_with(&format!("{prefix}_")) {
            findings.push(Finding::new(&value_name, format!("a value of this enum begins with {prefix}_")));
        }
        let reserved_number = descriptor
            .reserved_range
            .iter()
            .any(|range| (range.start()..=range.end()).contains(&value.number()));
        if reserved_number || descriptor.reserved_name.iter().any(|reserved| reserved == value.name()) {
            findings.push(Finding::new(&value_name, "the number or name of the value is reserved"));
        }
    }
    let unspecified = format!("{prefix}_UNSPECIFIED");
    if !descriptor.value.iter().any(|value| value.number() == 0 && value.name() == unspecified) {
        findings.push(Finding::new(name, format!("value 0 of this enum is named {unspecified}")));
    }
}

/// Requests are named after their rpc, and responses as well if they are not a resource; neither is
/// shared.
fn check_exchanges(elements: &Elements<'_>, findings: &mut Vec<Finding>) {
    let mut users: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for (service_name, service) in &elements.services {
        for rpc in &service.descriptor.method {
            let rpc_name = format!("{service_name}.{}", rpc.name());
            let (request, response) = (local(rpc.input_type()), local(rpc.output_type()));
            users.entry(rpc.input_type().trim_start_matches('.')).or_default().push(rpc_name.clone());
            users.entry(rpc.output_type().trim_start_matches('.')).or_default().push(rpc_name.clone());
            if request != format!("{}Request", rpc.name()) {
                findings.push(Finding::new(&rpc_name, format!("the request is named {}Request", rpc.name())));
            }
            let is_resource = !response.ends_with("Response") && !response.ends_with("Request");
            if !is_resource && response != format!("{}Response", rpc.name()) {
                let wrong = format!("the response is named {}Response, or is a resource", rpc.name());
                findings.push(Finding::new(&rpc_name, wrong));
            }
        }
    }
    for name in elements.messages.keys() {
        let used = users.get(name.as_str()).map_or(0, Vec::len);
        if (name.ends_with("Request") || name.ends_with("Response")) && used != 1 {
            findings.push(Finding::new(name, format!("a request or response has one rpc, not {used}")));
        }
    }
}

fn is_versioned(package: &str) -> bool {
    let version = package.rsplit('.').next().and_then(|last| last.strip_prefix('v'));
    version.is_some_and(|version| version.parse::<u32>().is_ok_and(|version| version > 0))
}

fn is_pascal(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_uppercase()) && name.chars().all(|c| c.is_ascii_alphanumeric())
}

fn is_snake(name: &str) -> bool {
    let allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    name.starts_with(|c: char| c.is_ascii_lowercase())
        && name.chars().all(allowed)
        && !name.contains("__")
        && !name.ends_with('_')
}

/// `SessionMode` as `SESSION_MODE`.
fn upper_snake(name: &str) -> String {
    let mut upper = String::new();
    for c in name.chars() {
        if c.is_ascii_uppercase() && !upper.is_empty() {
            upper.push('_');
        }
        upper.push(c.to_ascii_uppercase());
    }
    upper
}

/// `Frame` of `.waypost.v1.Frame`.
fn local(name: &str) -> &str {
    name.rsplit('.').next().unwrap_or(name)
}

#[cfg(test)]
mod tests {
    use prost_types::descriptor_proto::ReservedRange;
    use prost_types::enum_descriptor_proto::EnumReservedRange;
    use prost_types::{FileDescriptorProto, FileDescriptorSet};

    use super::unclean;
    use crate::contract;

    fn file<'a>(set: &'a mut FileDescriptorSet, name: &str) -> &'a mut FileDescriptorProto {
        set.file.iter_mut().find(|file| file.name() == name).expect(name)
    }

    /// What is said of the contract once it has been changed.
    #[track_caller]
    fn assert_found(change: impl FnOnce(&mut FileDescriptorSet), element: &str, wrong: &str) {
        let mut set = contract();
        change(&mut set);
        let findings = unclean(&set);
        let found =
            findings.iter().any(|finding| finding.element == element && finding.wrong.contains(wrong));
        assert!(found, "{element}: {wrong:?} is not among {findings:?}");
    }

    #[test]
    fn each_rule_finds_what_it_is_for() {
        const MAP: &str = "waypost/v1/map.proto";
        const SESSION: &str = "waypost/v1/session.proto";
        assert_found(
            |set| file(set, MAP).package = Some("waypost.maps".to_owned()),
            "waypost.maps",
            "does not end in a version",
        );
        assert_found(
            |set| file(set, MAP).name = Some("maps/map.proto".to_owned()),
            "maps/map.proto",
            "folder",
        );
        assert_found(
            |set| file(set, MAP).service[0].name = Some("Maps".to_owned()),
            "waypost.v1.Maps",
            "ends in Service",
        );
        assert_found(
            |set| file(set, MAP).service[0].method[0].name = Some("create_map".to_owned()),
            "waypost.v1.MapService.create_map",
            "PascalCase",
        );
        assert_found(
            |set| file(set, SESSION).message_type[0].name = Some("stream_request".to_owned()),
            "waypost.v1.stream_request",
            "PascalCase",
        );
        assert_found(
            |set| file(set, SESSION).message_type[0].field[0].name = Some("openSession".to_owned()),
            "waypost.v1.StreamRequest.openSession",
            "lower_snake_case",
        );
        assert_found(
            |set| file(set, SESSION).message_type[0].oneof_decl[0].name = Some("Content".to_owned()),
            "waypost.v1.StreamRequest.Content",
            "lower_snake_case",
        );
        assert_found(
            |set| {
                let range = ReservedRange { start: Some(2), end: Some(3) };
                file(set, SESSION).message_type[0].reserved_range.push(range);
            },
            "waypost.v1.StreamRequest.frame",
            "reserved",
        );
        assert_found(
            |set| file(set, SESSION).message_type[0].reserved_name.push("open".to_owned()),
            "waypost.v1.StreamRequest.open",
            "reserved",
        );
    }

    #[test]
    fn each_rule_about_enums_finds_what_it_is_for() {
        const SESSION: &str = "waypost/v1/session.proto";
        assert_found(
            |set| file(set, SESSION).enum_type[0].name = Some("session_mode".to_owned()),
            "waypost.v1.session_mode",
            "PascalCase",
        );
        assert_found(
            |set| file(set, SESSION).enum_type[0].value[1].name = Some("MAP".to_owned()),
            "waypost.v1.SessionMode.MAP",
            "SESSION_MODE_",
        );
        assert_found(
            |set| file(set, SESSION).enum_type[0].value[0].name = Some("SESSION_MODE_NONE".to_owned()),
            "waypost.v1.SessionMode",
            "SESSION_MODE_UNSPECIFIED",
        );
        assert_found(
            |set| {
                let range = EnumReservedRange { start: Some(1), end: Some(1) };
                file(set, SESSION).enum_type[0].reserved_range.push(range);
            },
            "waypost.v1.SessionMode.SESSION_MODE_MAP",
            "reserved",
        );
    }

    #[test]
    fn comments_and_exchanges_are_looked_at() {
        const SESSION: &str = "waypost/v1/session.proto";
        const RECOGNITION: &str = "waypost/v1/recognition.proto";
        let bare = |set: &mut FileDescriptorSet| file(set, SESSION).source_code_info = None;
        assert_found(bare, "waypost.v1.SessionService", "no comment");
        assert_found(bare, "waypost.v1.SessionService.Stream", "no comment");
        assert_found(bare, "waypost.v1.Frame", "no comment");
        assert_found(
            |set| {
                file(set, RECOGNITION).service[0].method[0].input_type = Some(".waypost.v1.Frame".to_owned());
            },
            "waypost.v1.RecognitionService.Query",
            "QueryRequest",
        );
        assert_found(
            |set| {
                let response = Some(".waypost.v1.StreamResponse".to_owned());
                file(set, RECOGNITION).service[0].method[0].output_type = response;
            },
            "waypost.v1.RecognitionService.Query",
            "QueryResponse",
        );
        assert_found(
            |set| drop(file(set, RECOGNITION).service[0].method.remove(0)),
            "waypost.v1.QueryRequest",
            "one rpc, not 0",
        );
    }
}
