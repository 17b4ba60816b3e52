"""A client that knows nothing but the address: neither this package nor the contract's files."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator
from typing import Any

import grpc
import pytest
from conftest import IMAGES, MODEL, SECOND_NS, Server, frame
from google.protobuf import descriptor_pool, json_format, message_factory
from google.protobuf.descriptor import MethodDescriptor
from grpc_reflection.v1alpha.proto_reflection_descriptor_database import ProtoReflectionDescriptorDatabase

import waypost


class Stranger:
    """Calls any method that reflection tells of, with messages as plain dictionaries."""

    def __init__(self, channel: grpc.Channel) -> None:
        self._channel = channel
        self._database = ProtoReflectionDescriptorDatabase(channel)
        # A pool of its own: what this package registered must not help.
        self._pool = descriptor_pool.DescriptorPool(self._database)

    def services(self) -> set[str]:
        return set(self._database.get_services())

    def method(self, service: str, name: str) -> MethodDescriptor:
        found: MethodDescriptor = self._pool.FindServiceByName(service).methods_by_name[name]  # type: ignore[no-untyped-call]
        return found

    def call(self, service: str, name: str, requests: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
        method = self.method(service, name)
        request_type = message_factory.GetMessageClass(method.input_type)
        response_type = message_factory.GetMessageClass(method.output_type)
        call: Any = self._channel.stream_stream(
            f"/{service}/{name}",
            request_serializer=lambda message: message.SerializeToString(),
            response_deserializer=response_type.FromString,
        )
        messages = [json_format.ParseDict(request, request_type()) for request in requests]
        for response in call(iter(messages)):
            yield json_format.MessageToDict(response, preserving_proto_field_name=True)


@pytest.fixture
def stranger(server: Server) -> Iterator[Stranger]:
    with grpc.insecure_channel(server.address) as channel:
        yield Stranger(channel)


def base64(content: bytes) -> str:
    return b64encode(content).decode()


def test_reflection_tells_of_every_service(stranger: Stranger) -> None:
    services = stranger.services()
    for service in ("Model", "Job", "Map", "Session"):
        assert f"waypost.v1.{service}Service" in services
    assert "grpc.health.v1.Health" in services
    stream = stranger.method("waypost.v1.SessionService", "Stream")
    assert (stream.client_streaming, stream.server_streaming) == (True, True)
    assert stream.input_type.full_name == "waypost.v1.StreamRequest"


def test_a_stranger_maps_a_drive(stranger: Stranger, client: waypost.Client) -> None:
    model = MODEL.read_bytes()
    chunks = [{"chunk": base64(model[at : at + (1 << 20)])} for at in range(0, len(model), 1 << 20)]
    [imported] = stranger.call("waypost.v1.ModelService", "ImportModel", chunks)
    maps = "waypost.v1.MapService"
    request = {"map_id": "strange", "model": imported["name"]}
    [made] = stranger.call(maps, "CreateMap", [request])
    assert made["name"] == "maps/strange"
    assert made["settings"]["new_place"] == "NEW_PLACE_TAIL"

    opening = {"map": made["name"], "session_id": "visitor", "mode": "SESSION_MODE_MAP"}
    images = [
        {"sequence": sequence, "stamp_ns": sequence * SECOND_NS, "image": base64(image.read_bytes())}
        for sequence, image in enumerate(IMAGES[:3], start=1)
    ]
    requests = [{"open": opening}, *({"frame": image} for image in images)]
    opened, *responses = stranger.call("waypost.v1.SessionService", "Stream", requests)
    assert opened["opened"]["session"] == "maps/strange/sessions/visitor"
    # JSON has 64-bit numbers as text.
    assert [response["answer"]["sequence"] for response in responses] == ["1", "2", "3"]

    [listed] = stranger.call(maps, "ListMaps", [{}])
    [found] = [found for found in listed["maps"] if found["name"] == "maps/strange"]
    assert (found["frames"], found["model"]) == ("3", imported["name"])
    # Our own client is told the same of these frames.
    with client.session("strange", "visitor") as session:
        stored = list(session.stream(map(frame, (1, 2, 3))))
    for response, answer in zip(responses, stored):
        assert isinstance(answer, waypost.Answer)
        assert answer.resent
        told = response["answer"]
        assert (answer.reason.name, answer.posterior) == (told["reason"][len("REASON_") :], told["posterior"])


def test_a_stranger_is_told_what_is_wrong(stranger: Stranger) -> None:
    with pytest.raises(grpc.RpcError) as refused:
        list(stranger.call("waypost.v1.MapService", "GetMap", [{"name": "maps/nowhere"}]))
    assert refused.value.code() == grpc.StatusCode.NOT_FOUND
    assert "nowhere" in (refused.value.details() or "")
    image = {"sequence": 1, "stamp_ns": 1, "image": base64(b"x")}
    with pytest.raises(grpc.RpcError) as refused:
        list(stranger.call("waypost.v1.SessionService", "Stream", [{"frame": image}]))
    assert refused.value.code() == grpc.StatusCode.INVALID_ARGUMENT
