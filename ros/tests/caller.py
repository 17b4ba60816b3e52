"""Who calls services as `rmw_cyclonedds` does.

Requests and answers begin with who asked, and which of theirs it is.
"""

# No `from __future__ import annotations`: Cyclone reads the annotations when the classes are made.

import itertools
import random
import time
from dataclasses import dataclass, field
from typing import Any

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int64, sequence, uint8, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from robot import DEFAULT, Robot, until

#: After this time a call is made again.
AGAIN_S = 8.0


@dataclass
class TriggerRequest(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Request_"):
    guid: uint64
    number: int64
    structure_needs_at_least_one_member: uint8 = 0


@dataclass
class TriggerResponse(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Response_"):
    guid: uint64
    number: int64
    success: bool
    message: str


@dataclass
class SetBoolRequest(IdlStruct, typename="std_srvs::srv::dds_::SetBool_Request_"):
    guid: uint64
    number: int64
    data: bool


@dataclass
class SetBoolResponse(IdlStruct, typename="std_srvs::srv::dds_::SetBool_Response_"):
    guid: uint64
    number: int64
    success: bool
    message: str


@dataclass
class ParameterValue(IdlStruct, typename="rcl_interfaces::msg::dds_::ParameterValue_"):
    type: uint8 = 0
    bool_value: bool = False
    integer_value: int64 = 0
    double_value: float64 = 0.0
    string_value: str = ""
    byte_array_value: sequence[uint8] = field(default_factory=list)
    bool_array_value: sequence[bool] = field(default_factory=list)
    integer_array_value: sequence[int64] = field(default_factory=list)
    double_array_value: sequence[float64] = field(default_factory=list)
    string_array_value: sequence[str] = field(default_factory=list)

    @staticmethod
    def of(value: bool | int | str) -> "ParameterValue":
        if isinstance(value, bool):
            return ParameterValue(type=1, bool_value=value)
        if isinstance(value, int):
            return ParameterValue(type=2, integer_value=value)
        return ParameterValue(type=4, string_value=value)

    @property
    def value(self) -> bool | str | None:
        return {0: None, 1: self.bool_value, 4: self.string_value}[self.type]


@dataclass
class Parameter(IdlStruct, typename="rcl_interfaces::msg::dds_::Parameter_"):
    name: str
    value: ParameterValue


@dataclass
class SetParametersResult(IdlStruct, typename="rcl_interfaces::msg::dds_::SetParametersResult_"):
    successful: bool
    reason: str


@dataclass
class SetParametersRequest(IdlStruct, typename="rcl_interfaces::srv::dds_::SetParameters_Request_"):
    guid: uint64
    number: int64
    parameters: sequence[Parameter]


@dataclass
class SetParametersResponse(IdlStruct, typename="rcl_interfaces::srv::dds_::SetParameters_Response_"):
    guid: uint64
    number: int64
    results: sequence[SetParametersResult]


@dataclass
class GetParametersRequest(IdlStruct, typename="rcl_interfaces::srv::dds_::GetParameters_Request_"):
    guid: uint64
    number: int64
    names: sequence[str]


@dataclass
class GetParametersResponse(IdlStruct, typename="rcl_interfaces::srv::dds_::GetParameters_Response_"):
    guid: uint64
    number: int64
    values: sequence[ParameterValue]


@dataclass
class ListParametersResult(IdlStruct, typename="rcl_interfaces::msg::dds_::ListParametersResult_"):
    names: sequence[str]
    prefixes: sequence[str]


@dataclass
class ListParametersRequest(IdlStruct, typename="rcl_interfaces::srv::dds_::ListParameters_Request_"):
    guid: uint64
    number: int64
    prefixes: sequence[str]
    depth: uint64


@dataclass
class ListParametersResponse(IdlStruct, typename="rcl_interfaces::srv::dds_::ListParameters_Response_"):
    guid: uint64
    number: int64
    result: ListParametersResult


class Caller:
    """A client of one service."""

    def __init__(self, robot: Robot, service: str, request: type[Any], response: type[Any]) -> None:
        self._guid, self._numbers = random.getrandbits(63), itertools.count(1)
        self._request, self._response = request, response
        asking = Topic(robot.participant, f"rq{service}Request", request)
        answered = Topic(robot.participant, f"rr{service}Reply", response)
        self._reader = DataReader(robot.participant, answered, qos=DEFAULT)
        self._writer = DataWriter(robot.participant, asking, qos=DEFAULT)
        self.others: list[Any] = []

    def __call__(self, *fields: Any, timeout_s: float = 30.0) -> Any:
        """Calls once somebody serves it, as `wait_for_service` does, and gives the answer to that call.

        Where both have just met, a request may come before its reader knows the writer, and is lost. So the call is made
        again after a while.
        """
        until(lambda: self._writer.get_matched_subscriptions(), what="nobody serves it")
        until(lambda: self._reader.get_matched_publications(), what="nobody answers")
        numbers: list[int] = []
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            if time.monotonic() > deadline - timeout_s + AGAIN_S * len(numbers):
                numbers.append(next(self._numbers))
                self._writer.write(self._request(self._guid, numbers[-1], *fields))
            for answer in self._reader.take(N=100):
                if not isinstance(answer, self._response):
                    continue
                if answer.guid == self._guid and answer.number in numbers:
                    return answer
                self.others.append(answer)
            time.sleep(0.005)
        raise AssertionError("there is no answer")
