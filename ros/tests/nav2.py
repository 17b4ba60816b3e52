"""A server of Nav2's action NavigateToPose, as `rmw_cyclonedds` has it.

It takes goals, drives, is cancelled and gives up as it is told.
"""

# No `from __future__ import annotations`: Cyclone reads the annotations when the classes are made.

from dataclasses import dataclass, field
from typing import Any

import ros_types as ros
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, int8, int16, int64, sequence, uint8, uint16, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from robot import DEFAULT, Robot

NAME = "nav2_msgs::action::dds_::NavigateToPose"
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


@dataclass
class SendGoalRequest(IdlStruct, typename=f"{NAME}_SendGoal_Request_"):
    guid: uint64
    number: int64
    goal_id: array[uint8, 16]
    pose: ros.PoseStamped
    behavior_tree: str


@dataclass
class SendGoalResponse(IdlStruct, typename=f"{NAME}_SendGoal_Response_"):
    guid: uint64
    number: int64
    accepted: bool
    stamp: ros.Time = field(default_factory=ros.Time)


@dataclass
class GetResultRequest(IdlStruct, typename=f"{NAME}_GetResult_Request_"):
    guid: uint64
    number: int64
    goal_id: array[uint8, 16]


@dataclass
class GetResultResponse(IdlStruct, typename=f"{NAME}_GetResult_Response_"):
    guid: uint64
    number: int64
    status: int8
    error_code: uint16
    error_msg: str


@dataclass
class GoalInfo(IdlStruct, typename="action_msgs::msg::dds_::GoalInfo_"):
    goal_id: array[uint8, 16]
    stamp: ros.Time


@dataclass
class CancelGoalRequest(IdlStruct, typename="action_msgs::srv::dds_::CancelGoal_Request_"):
    guid: uint64
    number: int64
    goal_info: GoalInfo


@dataclass
class CancelGoalResponse(IdlStruct, typename="action_msgs::srv::dds_::CancelGoal_Response_"):
    guid: uint64
    number: int64
    return_code: int8
    goals_canceling: sequence[GoalInfo]


@dataclass
class Feedback(IdlStruct, typename=f"{NAME}_FeedbackMessage_"):
    goal_id: array[uint8, 16]
    current_pose: ros.PoseStamped
    navigation_time: ros.Duration
    estimated_time_remaining: ros.Duration
    number_of_recoveries: int16
    distance_remaining: float32


class Served:
    """One service: requests as they come, and answers to them."""

    def __init__(self, robot: Robot, service: str, request: type[Any], response: type[Any]) -> None:
        self._request, self._response = request, response
        asked = Topic(robot.participant, f"rq{service}Request", request)
        answered = Topic(robot.participant, f"rr{service}Reply", response)
        self._reader = DataReader(robot.participant, asked, qos=DEFAULT)
        self._writer = DataWriter(robot.participant, answered, qos=DEFAULT)

    def requests(self) -> list[Any]:
        return [sample for sample in self._reader.take(N=100) if isinstance(sample, self._request)]

    def answer(self, request: Any, *fields: Any) -> None:
        self._writer.write(self._response(request.guid, request.number, *fields))


class Nav2:
    """Answers when it is turned; what it was asked is in its lists."""

    def __init__(self, robot: Robot, accepts: bool = True) -> None:
        at = f"{robot.namespace}/navigate_to_pose/_action"
        self.accepts = accepts
        self._send = Served(robot, f"{at}/send_goal", SendGoalRequest, SendGoalResponse)
        self._result = Served(robot, f"{at}/get_result", GetResultRequest, GetResultResponse)
        self._cancel = Served(robot, f"{at}/cancel_goal", CancelGoalRequest, CancelGoalResponse)
        told = Topic(robot.participant, f"rt{at}/feedback", Feedback)
        self._feedback = DataWriter(robot.participant, told, qos=DEFAULT)
        self.goals: list[SendGoalRequest] = []
        self.waiting: dict[bytes, GetResultRequest] = {}
        self.cancelled: list[bytes] = []

    def turn(self) -> "Nav2":
        for request in self._send.requests():
            self.goals.append(request)
            self._send.answer(request, self.accepts)
        for request in self._result.requests():
            self.waiting[bytes(request.goal_id)] = request
        for request in self._cancel.requests():
            goal = bytes(request.goal_info.goal_id)
            assert request.goal_info.stamp == ros.Time()
            self.cancelled.append(goal)
            self._cancel.answer(request, 0, [request.goal_info])
            self.end(goal, CANCELED)
        return self

    def leave(self) -> None:
        """Serves nothing any more."""
        del self._send, self._result, self._cancel, self._feedback

    @property
    def latest(self) -> bytes:
        return bytes(self.goals[-1].goal_id)

    def drive(self, goal: bytes, remaining_m: float) -> None:
        now = ros.Duration(1, 0)
        at = self.goals[-1].pose
        self._feedback.write(Feedback(list(goal), at, now, now, 0, remaining_m))

    def end(self, goal: bytes, status: int, code: int = 0, message: str = "") -> None:
        self._result.answer(self.waiting.pop(goal), status, code, message)
