"""A robot that Cyclone DDS plays: not the bridge's own DDS, with ROS 2's names of topics and types."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, TypeVar

import ros_types as ros
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

#: No multicast, which loopback often lacks: whoever is on this machine is asked by its ports.
CONFIGURATION = """<CycloneDDS><Domain>
  <General>
    <Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>
    <AllowMulticast>false</AllowMulticast>
  </General>
  <Discovery>
    <ParticipantIndex>auto</ParticipantIndex>
    <MaxAutoParticipantIndex>11</MaxAutoParticipantIndex>
    <Peers><Peer Address="127.0.0.1"/></Peers>
  </Discovery>
</Domain></CycloneDDS>"""

RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))
SENSOR = Qos(Policy.Reliability.BestEffort, Policy.Durability.Volatile, Policy.History.KeepLast(5))
#: A driver that loses nothing, so that a test may count.
LOSSLESS = Qos(RELIABLE, Policy.Durability.Volatile, Policy.History.KeepAll)
DEFAULT = Qos(RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(10))
LATCHED = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(100))

OPTICAL = ros.Quaternion(-0.5, 0.5, -0.5, 0.5)
SECOND_NS = 1_000_000_000

T = TypeVar("T")


class Robot:
    """Publishes and subscribes as a robot does."""

    def __init__(self, domain: int, namespace: str = "", beside: Robot | None = None) -> None:
        self.namespace = namespace
        self._domain = beside._domain if beside else Domain(domain, CONFIGURATION)
        self.participant = DomainParticipant(domain)
        self._topics: dict[str, Topic[Any]] = {}
        self._writers: dict[str, DataWriter[Any]] = {}
        self._readers: dict[str, DataReader[Any]] = {}
        #: Ends those who read on threads of their own: what a failed test leaves must not read what is gone.
        self.endings: list[Callable[[], None]] = []

    def close(self) -> None:
        for end in self.endings:
            end()
        self._writers.clear()
        self._readers.clear()
        self._topics.clear()
        del self.participant
        del self._domain

    def topic(self, name: str, kind: type[T]) -> Topic[T]:
        full = name if name.startswith("/") else f"{self.namespace}/{name}"
        # One for all writers of it that come and go: Cyclone's library crashes now and then where topics do.
        if full not in self._topics:
            self._topics[full] = Topic(self.participant, f"rt{full}", kind)
        topic = self._topics[full]
        assert topic.data_type is kind, f"{full} is of another type"
        return topic

    def advertise(self, name: str, kind: type[Any], qos: Qos = SENSOR) -> None:
        """Says what will be published there. What is said already stays."""
        if name not in self._writers:
            self._writers[name] = DataWriter(self.participant, self.topic(name, kind), qos=qos)

    def forget(self, *names: str) -> None:
        """Publishes nothing there any more."""
        for name in names:
            del self._writers[name]

    def publish(self, name: str, message: Any, qos: Qos = SENSOR) -> None:
        self.advertise(name, type(message), qos)
        self._writers[name].write(message)

    def is_heard(self, name: str) -> bool:
        """Whether somebody reads what is published there."""
        return bool(self._writers[name].get_matched_subscriptions())

    def listen(self, name: str, kind: type[T], qos: Qos = DEFAULT) -> Callable[[], list[T]]:
        """Gives what has come since it was asked last."""
        reader = DataReader(self.participant, self.topic(name, kind), qos=qos)
        self._readers[name] = reader
        # A writer that leaves is a sample, too.
        return lambda: [sample for sample in reader.take(N=1000) if isinstance(sample, kind)]

    # What a robot tells of itself.

    def compressed(self, stamp_ns: int, image: bytes, topic: str = "camera/image_raw/compressed") -> None:
        header = ros.Header(ros.Time.of(stamp_ns), "camera_optical")
        self.publish(topic, ros.CompressedImage(header, "jpeg", list(image)), LOSSLESS)

    def odometry(self, stamp_ns: int, x: float, y: float, yaw: float, topic: str = "odom") -> None:
        pose = ros.Pose(ros.Point(x, y, 0.0), turned(yaw))
        unknown = [0.0] * 36
        message = ros.Odometry(
            ros.Header(ros.Time.of(stamp_ns), "odom"),
            "base_link",
            ros.PoseWithCovariance(pose, unknown),
            ros.TwistWithCovariance(ros.Twist(), unknown),
        )
        self.publish(topic, message, LOSSLESS)

    def camera_info(
        self, size_px: tuple[int, int], focal_px: float, topic: str = "camera/camera_info"
    ) -> None:
        width, height = size_px
        matrix = [focal_px, 0.0, width / 2, 0.0, focal_px, height / 2, 0.0, 0.0, 1.0]
        header = ros.Header(ros.Time.of(SECOND_NS), "camera_optical")
        turned_not = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
        message = ros.CameraInfo(
            header, height, width, "plumb_bob", [0.0] * 5, matrix, turned_not, [0.0] * 12
        )
        self.publish(topic, message, LOSSLESS)

    def mounting(self) -> None:
        """The camera is ahead of the base and looks ahead."""

        def joint(
            parent: str, child: str, moved: ros.Vector3, rotation: ros.Quaternion
        ) -> ros.TransformStamped:
            header = ros.Header(ros.Time.of(SECOND_NS), parent)
            return ros.TransformStamped(header, child, ros.Transform(moved, rotation))

        joints = [
            joint("base_link", "camera", ros.Vector3(0.25, 0.0, 0.5), ros.Quaternion()),
            joint("camera", "camera_optical", ros.Vector3(), OPTICAL),
        ]
        self.publish("tf_static" if self.namespace else "/tf_static", ros.TFMessage(joints), LATCHED)


def turned(yaw: float) -> ros.Quaternion:
    return ros.Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


def until(is_so: Callable[[], T], timeout_s: float = 30.0, what: str = "it never became so") -> T:
    """Waits until something is so, and gives it."""
    deadline = time.monotonic() + timeout_s
    while not (found := is_so()):
        assert time.monotonic() < deadline, what
        time.sleep(0.01)
    return found
