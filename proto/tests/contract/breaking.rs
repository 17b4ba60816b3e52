//! What would break a program that speaks an older contract: on the wire, in JSON, or where it compiles.

use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, FieldDescriptorProto, FileDescriptorSet, MethodDescriptorProto,
    ServiceDescriptorProto,
};

use crate::Finding;
use crate::elements::Elements;

/// All that `new` breaks of `old`. What is only in `new` breaks nothing.
pub(crate) fn broken(old: &FileDescriptorSet, new: &FileDescriptorSet) -> Vec<Finding> {
    let (old, new) = (Elements::of(old), Elements::of(new));
    let mut findings = Vec::new();
    for (name, message) in &old.messages {
        match new.messages.get(name) {
            Some(now) => compare_messages(name, message.descriptor, now.descriptor, &mut findings),
            None => findings.push(Finding::new(name, "the message was removed")),
        }
    }
    for (name, before) in &old.enums {
        match new.enums.get(name) {
            Some(now) => compare_enums(name, before.descriptor, now.descriptor, &mut findings),
            None => findings.push(Finding::new(name, "the enum was removed")),
        }
    }
    for (name, service) in &old.services {
        match new.services.get(name) {
            Some(now) => compare_services(name, service.descriptor, now.descriptor, &mut findings),
            None => findings.push(Finding::new(name, "the service was removed")),
        }
    }
    findings.sort();
    findings
}

fn compare_messages(name: &str, old: &DescriptorProto, new: &DescriptorProto, findings: &mut Vec<Finding>) {
    for field in &old.field {
        let field_name = format!("{name}.{}", field.name());
        if let Some(now) = new.field.iter().find(|now| now.number() == field.number()) {
            compare_fields(&field_name, (old, field), (new, now), findings);
            continue;
        }
        let moved = new.field.iter().find(|now| now.name() == field.name());
        let number_reserved =
            new.reserved_range.iter().any(|range| (range.start()..range.end()).contains(&field.number()));
        let name_reserved = new.reserved_name.iter().any(|reserved| reserved == field.name());
        if let Some(moved) = moved {
            let wrong = format!("the number was changed from {} to {}", field.number(), moved.number());
            findings.push(Finding::new(&field_name, wrong));
        } else if !number_reserved || !name_reserved {
            let wrong = format!("the field was removed without reserving {} and its name", field.number());
            findings.push(Finding::new(&field_name, wrong));
        }
    }
}

fn compare_fields(
    name: &str,
    (old_message, old): (&DescriptorProto, &FieldDescriptorProto),
    (new_message, new): (&DescriptorProto, &FieldDescriptorProto),
    findings: &mut Vec<Finding>,
) {
    if old.name() != new.name() {
        findings.push(Finding::new(name, format!("the field was renamed to {}", new.name())));
    }
    if json_name(old) != json_name(new) {
        let wrong = format!("the name in JSON was changed from {} to {}", json_name(old), json_name(new));
        findings.push(Finding::new(name, wrong));
    }
    if field_type(old) != field_type(new) {
        let wrong = format!("the type was changed from {:?} to {:?}", field_type(old), field_type(new));
        findings.push(Finding::new(name, wrong));
    }
    if cardinality(old) != cardinality(new) {
        let wrong = format!("the label was changed from {:?} to {:?}", cardinality(old), cardinality(new));
        findings.push(Finding::new(name, wrong));
    }
    let (before, now) = (oneof(old_message, old), oneof(new_message, new));
    if before != now {
        findings.push(Finding::new(name, format!("the oneof was changed from {before:?} to {now:?}")));
    }
}

fn compare_enums(
    name: &str,
    old: &EnumDescriptorProto,
    new: &EnumDescriptorProto,
    findings: &mut Vec<Finding>,
) {
    for value in &old.value {
        let value_name = format!("{name}.{}", value.name());
        let same_number = new.value.iter().find(|now| now.number() == value.number());
        let same_name = new.value.iter().find(|now| now.name() == value.name());
        let number_reserved =
            new.reserved_range.iter().any(|range| (range.start()..=range.end()).contains(&value.number()));
        let name_reserved = new.reserved_name.iter().any(|reserved| reserved == value.name());
        let wrong = match (same_number, same_name) {
            (_, Some(now)) if now.number() == value.number() => continue,
            (_, Some(now)) => format!("the number was changed from {} to {}", value.number(), now.number()),
            (Some(now), None) => format!("the value was renamed to {}", now.name()),
            (None, None) if number_reserved && name_reserved => continue,
            (None, None) => {
                format!("the value was removed without reserving {} and its name", value.number())
            }
        };
        findings.push(Finding::new(&value_name, wrong));
    }
}

fn compare_services(
    name: &str,
    old: &ServiceDescriptorProto,
    new: &ServiceDescriptorProto,
    findings: &mut Vec<Finding>,
) {
    for rpc in &old.method {
        let rpc_name = format!("{name}.{}", rpc.name());
        let Some(now) = new.method.iter().find(|now| now.name() == rpc.name()) else {
            findings.push(Finding::new(&rpc_name, "the rpc was removed"));
            continue;
        };
        if rpc.input_type() != now.input_type() {
            findings.push(Finding::new(&rpc_name, format!("the request is now {}", now.input_type())));
        }
        if rpc.output_type() != now.output_type() {
            findings.push(Finding::new(&rpc_name, format!("the response is now {}", now.output_type())));
        }
        if streaming(rpc) != streaming(now) {
            let wrong = format!("streaming was changed from {:?} to {:?}", streaming(rpc), streaming(now));
            findings.push(Finding::new(&rpc_name, wrong));
        }
    }
}

/// Type, and which message or enum it is.
fn field_type(field: &FieldDescriptorProto) -> (Type, &str) {
    (field.r#type(), field.type_name())
}

/// Label, and whether presence is told apart from the default.
fn cardinality(field: &FieldDescriptorProto) -> (Label, bool) {
    (field.label(), field.proto3_optional())
}

/// Name of the oneof that a field is in; one made up for `optional` is none.
fn oneof<'a>(message: &'a DescriptorProto, field: &FieldDescriptorProto) -> Option<&'a str> {
    let index = field.oneof_index.filter(|_| !field.proto3_optional())?;
    message.oneof_decl.get(usize::try_from(index).ok()?).map(prost_types::OneofDescriptorProto::name)
}

/// Whether the client and the server stream.
fn streaming(rpc: &MethodDescriptorProto) -> (bool, bool) {
    (rpc.client_streaming(), rpc.server_streaming())
}

/// The name in JSON: the one declared, or lowerCamelCase.
fn json_name(field: &FieldDescriptorProto) -> String {
    if let Some(declared) = &field.json_name {
        return declared.clone();
    }
    let mut parts = field.name().split('_');
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |name, part| {
        let (initial, rest) = part.split_at(part.len().min(1));
        name + &initial.to_ascii_uppercase() + rest
    })
}

#[cfg(test)]
mod tests {
    use prost_types::descriptor_proto::ReservedRange;
    use prost_types::enum_descriptor_proto::EnumReservedRange;
    use prost_types::field_descriptor_proto::{Label, Type};
    use prost_types::{
        DescriptorProto, EnumDescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet,
        MethodDescriptorProto,
    };

    use super::broken;
    use crate::{Finding, released};

    const SESSION: &str = "waypost/v1/session.proto";

    fn file(set: &mut FileDescriptorSet) -> &mut FileDescriptorProto {
        set.file.iter_mut().find(|file| file.name() == SESSION).expect(SESSION)
    }

    fn message<'a>(set: &'a mut FileDescriptorSet, name: &str) -> &'a mut DescriptorProto {
        file(set).message_type.iter_mut().find(|message| message.name() == name).expect(name)
    }

    fn field<'a>(set: &'a mut FileDescriptorSet, of: &str, name: &str) -> &'a mut FieldDescriptorProto {
        message(set, of).field.iter_mut().find(|field| field.name() == name).expect(name)
    }

    fn reason(set: &mut FileDescriptorSet) -> &mut EnumDescriptorProto {
        file(set).enum_type.iter_mut().find(|descriptor| descriptor.name() == "Reason").expect("Reason")
    }

    fn stream(set: &mut FileDescriptorSet) -> &mut MethodDescriptorProto {
        &mut file(set).service[0].method[0]
    }

    fn findings(change: impl FnOnce(&mut FileDescriptorSet)) -> Vec<Finding> {
        let mut new = released();
        change(&mut new);
        broken(&released(), &new)
    }

    /// A change of the released contract is found, and nothing else is.
    #[track_caller]
    fn assert_found(change: impl FnOnce(&mut FileDescriptorSet), element: &str, wrong: &str) {
        let findings = findings(change);
        assert_eq!(findings.len(), 1, "{element}: {wrong}: {findings:?}");
        assert_eq!(findings[0].element, format!("waypost.v1.{element}"));
        assert!(findings[0].wrong.contains(wrong), "{findings:?}");
    }

    #[test]
    fn nothing_changed_breaks_nothing() {
        assert_eq!(findings(|_| {}), []);
    }

    #[test]
    fn what_is_gone_is_found() {
        let no_frame = |set: &mut FileDescriptorSet| {
            file(set).message_type.retain(|message| message.name() != "Timings");
        };
        assert_found(no_frame, "Timings", "message was removed");
        let no_reason = |set: &mut FileDescriptorSet| {
            file(set).enum_type.retain(|descriptor| descriptor.name() != "Reason");
        };
        assert_found(no_reason, "Reason", "enum was removed");
        assert_found(|set| file(set).service.clear(), "SessionService", "service was removed");
        assert_found(
            |set| drop(file(set).service[0].method.remove(0)),
            "SessionService.Stream",
            "rpc was removed",
        );
        assert_found(
            |set| message(set, "Frame").field.retain(|field| field.name() != "odometry"),
            "Frame.odometry",
            "removed without reserving 4",
        );
        assert_found(
            |set| reason(set).value.retain(|value| value.number() != 3),
            "Reason.REASON_LOOP_CLOSURE",
            "removed without reserving 3",
        );
    }

    #[test]
    fn what_is_gone_and_reserved_by_number_and_name_breaks_nothing() {
        let gone = |set: &mut FileDescriptorSet| {
            let frame = message(set, "Frame");
            frame.field.retain(|field| field.name() != "odometry");
            frame.reserved_range.push(ReservedRange { start: Some(4), end: Some(5) });
            frame.reserved_name.push("odometry".to_owned());
            let reason = reason(set);
            reason.value.retain(|value| value.number() != 3);
            reason.reserved_range.push(EnumReservedRange { start: Some(3), end: Some(3) });
            reason.reserved_name.push("REASON_LOOP_CLOSURE".to_owned());
        };
        assert_eq!(findings(gone), []);
        let half_reserved = |set: &mut FileDescriptorSet| {
            gone(set);
            message(set, "Frame").reserved_name.clear();
        };
        assert_found(half_reserved, "Frame.odometry", "removed without reserving 4");
        let half_reserved = |set: &mut FileDescriptorSet| {
            gone(set);
            reason(set).reserved_range.clear();
        };
        assert_found(half_reserved, "Reason.REASON_LOOP_CLOSURE", "removed without reserving 3");
    }

    #[test]
    fn a_field_that_changed_is_found() {
        assert_found(
            |set| field(set, "Frame", "odometry").number = Some(40),
            "Frame.odometry",
            "number was changed from 4 to 40",
        );
        assert_found(
            |set| field(set, "Frame", "sequence").set_type(Type::Int64),
            "Frame.sequence",
            "type was changed",
        );
        assert_found(
            |set| field(set, "Frame", "odometry").type_name = Some(".waypost.v1.Pose".to_owned()),
            "Frame.odometry",
            "type was changed",
        );
        assert_found(
            |set| field(set, "Frame", "stamp_ns").set_label(Label::Repeated),
            "Frame.stamp_ns",
            "label was changed",
        );
        assert_found(
            |set| {
                let place = field(set, "FrameAnswer", "place_number");
                (place.proto3_optional, place.oneof_index) = (None, None);
            },
            "FrameAnswer.place_number",
            "label was changed",
        );
        assert_found(
            |set| field(set, "Frame", "image").oneof_index = None,
            "Frame.image",
            "oneof was changed",
        );
        let renamed = findings(|set| message(set, "Frame").oneof_decl[0].name = Some("picture".to_owned()));
        let elements: Vec<&str> = renamed.iter().map(|finding| finding.element.as_str()).collect();
        assert_eq!(
            elements,
            ["waypost.v1.Frame.histogram", "waypost.v1.Frame.image", "waypost.v1.Frame.words"]
        );
        assert!(renamed.iter().all(|finding| finding.wrong.contains("oneof was changed")), "{renamed:?}");
        assert_found(
            |set| field(set, "Frame", "stamp_ns").json_name = Some("stamp".to_owned()),
            "Frame.stamp_ns",
            "name in JSON was changed from stampNs to stamp",
        );
        assert_found(
            |set| field(set, "Frame", "stamp_ns").name = Some("time_ns".to_owned()),
            "Frame.stamp_ns",
            "renamed to time_ns",
        );
    }

    #[test]
    fn an_enum_value_that_changed_is_found() {
        assert_found(
            |set| reason(set).value[3].number = Some(30),
            "Reason.REASON_LOOP_CLOSURE",
            "number was changed from 3 to 30",
        );
        assert_found(
            |set| reason(set).value[3].name = Some("REASON_LOOP".to_owned()),
            "Reason.REASON_LOOP_CLOSURE",
            "renamed to REASON_LOOP",
        );
    }

    #[test]
    fn an_rpc_that_changed_is_found() {
        const RPC: &str = "SessionService.Stream";
        assert_found(
            |set| stream(set).input_type = Some(".waypost.v1.Frame".to_owned()),
            RPC,
            "request is now",
        );
        assert_found(
            |set| stream(set).output_type = Some(".waypost.v1.Frame".to_owned()),
            RPC,
            "response is now",
        );
        assert_found(|set| stream(set).client_streaming = Some(false), RPC, "streaming was changed");
        assert_found(|set| stream(set).server_streaming = Some(false), RPC, "streaming was changed");
    }

    #[test]
    fn what_is_new_breaks_nothing() {
        let more = |set: &mut FileDescriptorSet| {
            let field = FieldDescriptorProto {
                name: Some("colour".to_owned()),
                number: Some(99),
                ..Default::default()
            };
            message(set, "Frame").field.push(field);
            file(set)
                .message_type
                .push(DescriptorProto { name: Some("Colour".to_owned()), ..Default::default() });
            let rpc = MethodDescriptorProto { name: Some("Paint".to_owned()), ..Default::default() };
            file(set).service[0].method.push(rpc);
        };
        assert_eq!(findings(more), []);
    }
}
