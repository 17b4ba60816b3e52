"""The bridge among the nodes of ROS, as `ros2 node list` asks for them, in the words of each ROS 2.

A real one asks in test_ros2.py; here Cyclone DDS plays one of either kind.
"""

# No `from __future__ import annotations`: Cyclone reads the annotations when the classes are made.

from dataclasses import dataclass, field
from typing import Any

import pytest
from conftest import COMPRESSED, Stage
from cyclonedds.core import Policy, Qos
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, sequence, uint8
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from robot import RELIABLE, until

#: As ROS has it.
LATEST = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
NAME = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"


@dataclass
class Gid(IdlStruct, typename="rmw_dds_common::msg::dds_::Gid_"):
    data: array[uint8, 16] = field(default_factory=lambda: [7] * 16)


@dataclass
class Node(IdlStruct, typename="rmw_dds_common::msg::dds_::NodeEntitiesInfo_"):
    node_namespace: str
    node_name: str
    readers: sequence[Gid]
    writers: sequence[Gid]


@dataclass
class Nodes(IdlStruct, typename=NAME):
    gid: Gid = field(default_factory=Gid)
    nodes: sequence[Node] = field(default_factory=list)


@dataclass
class HumbleGid(IdlStruct, typename="rmw_dds_common::msg::dds_::Gid_"):
    data: array[uint8, 24] = field(default_factory=lambda: [7] * 16 + [0] * 8)


@dataclass
class HumbleNode(IdlStruct, typename="rmw_dds_common::msg::dds_::NodeEntitiesInfo_"):
    node_namespace: str
    node_name: str
    readers: sequence[HumbleGid]
    writers: sequence[HumbleGid]


@dataclass
class HumbleNodes(IdlStruct, typename=NAME):
    gid: HumbleGid = field(default_factory=HumbleGid)
    nodes: sequence[HumbleNode] = field(default_factory=list)


@pytest.mark.parametrize("kind", [Nodes, HumbleNodes])
def test_the_bridge_is_a_node_as_the_ros_that_is_there_says_it(stage: Stage, kind: Any) -> None:
    robot = stage.robot()
    stage.bridge("--map", "hall", "--namespace", "robot1", "--image-topic", COMPRESSED)
    topic = Topic(robot.participant, "ros_discovery_info", kind)
    reader, writer = (
        DataReader(robot.participant, topic, LATEST),
        DataWriter(robot.participant, topic, LATEST),
    )
    until(writer.get_matched_subscriptions, what="the bridge does not ask who is there")
    # Until somebody says of themselves the bridge does not know how.
    writer.write(kind())
    told: list[Any] = []

    def bridge() -> bool:
        told.extend(
            one for one in reader.take(N=100) if isinstance(one, kind) and list(one.gid.data[:16]) != [7] * 16
        )
        return bool(told)

    until(bridge, what="the bridge does not say that it is there")
    [node] = told[-1].nodes
    assert (node.node_namespace, node.node_name) == ("/robot1", "waypost")
    program = list(told[-1].gid.data[:12])
    entities = [list(gid.data) for gid in [*node.readers, *node.writers]]
    assert len(node.readers) >= 4
    assert len(node.writers) >= 8
    assert all(entity[:12] == program for entity in entities)
    assert all(entity[16:] == [0] * (len(entity) - 16) for entity in entities)
    assert len({tuple(entity) for entity in entities}) == len(entities)
