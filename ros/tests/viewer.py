"""Who looks on by Foxglove's protocol, written from its specification: not the library that the bridge has.

https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md, with the subprotocol of their SDK.
"""

from __future__ import annotations

import json
import re
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import ros_types as ros
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from websockets.sync.client import connect
from websockets.typing import Subprotocol

MESSAGE_DATA = 1


def address_in(said: str) -> str:
    """Where the bridge says that viewers may connect to."""
    found = re.search(r"ws://\S+", said)
    return found.group() if found else ""


@dataclass
class Shown:
    """A message by Foxglove's decoder, which rosbags' agrees with."""

    topic: str
    kind: str
    time_ns: int
    data: Any


@dataclass
class Viewer:
    """A connection that reads when it is asked to."""

    address: str
    channels: dict[str, dict[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        protocol = Subprotocol("foxglove.sdk.v1")
        # Who reads nothing for long would end it by itself, missing answers to its pings.
        self._socket = connect(
            self.address, subprotocols=[protocol], max_size=None, max_queue=4, ping_interval=None
        )
        assert self._socket.subprotocol == protocol
        self.info = json.loads(self._socket.recv(10))
        self._topics: dict[int, str] = {}
        self._store = get_typestore(Stores.EMPTY)
        self._decoders: dict[str, Callable[[bytes], Any]] = {}
        self.subscribed: list[str] = []

    def close(self) -> None:
        self._socket.close()

    def subscribe(self, *topics: str) -> None:
        """Waits until these are advertised, and asks for them."""
        deadline = time.monotonic() + 20
        while not set(topics) <= set(self.channels):
            assert time.monotonic() < deadline, f"only {sorted(self.channels)}"
            self.read(0.2)
        wanted = []
        for topic in topics:
            self.subscribed.append(topic)
            self._topics[len(self.subscribed)] = topic
            wanted.append({"id": len(self.subscribed), "channelId": self.channels[topic]["id"]})
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def read(self, timeout_s: float) -> Shown | None:
        """The next message, if one comes in time; none if it was about channels."""
        try:
            told = self._socket.recv(timeout_s)
        except TimeoutError:
            return None
        if isinstance(told, str):
            self._told(json.loads(told))
            return None
        code, subscription, time_ns = struct.unpack_from("<BIQ", told)
        assert code == MESSAGE_DATA
        topic = self._topics[subscription]
        return Shown(topic, self.channels[topic]["schemaName"], time_ns, self._decoded(topic, told[13:]))

    def until(self, is_wanted: Callable[[Shown], bool], timeout_s: float = 30.0) -> Shown:
        """The first message that is as wanted."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            shown = self.read(0.2)
            if shown is not None and is_wanted(shown):
                return shown
        raise AssertionError("nothing as wanted was shown")

    def _told(self, message: dict[str, Any]) -> None:
        assert message["op"] == "advertise", message
        for channel in message["channels"]:
            assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
            self.channels[channel["topic"]] = channel

    def _decoded(self, topic: str, data: bytes) -> Any:
        name, text = self.channels[topic]["schemaName"], self.channels[topic]["schema"]
        if name not in self._decoders:
            schema = Schema(id=1, data=text.encode(), encoding="ros2msg", name=name)
            decoder = DecoderFactory().decoder_for("cdr", schema)
            assert decoder is not None
            self._decoders[name] = decoder
            types = get_types_from_msg(text, name)
            self._store.register({kind: of for kind, of in types.items() if kind not in self._store.types})
        other = self._store.deserialize_cdr(data, name)
        again = bytes(self._store.serialize_cdr(other, name))
        # What came by DDS is filled up to four bytes.
        assert data == again + bytes(-len(again) % 4)[: len(data) - len(again)], (
            f"{topic} is not of its schema"
        )
        return self._decoders[name](data)


def stamp_of(message: Any) -> int:
    return ros.Time(message.header.stamp.sec, message.header.stamp.nanosec).ns
