"""A robot of a real ROS 2, in an environment of its own: ros2_robot.py DOMAIN IMAGES.

It chooses a map, drives, hears where it is, and finishes the session. What became of it is printed as JSON.
"""

from __future__ import annotations

import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as Way
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

PATIENCE_S = 30.0
FRAMES = 20


class Robot(Node):
    """Publishes as drivers do, and calls as a behaviour tree does."""

    def __init__(self, images: list[Path]) -> None:
        super().__init__("robot")
        self._images = images
        self._image = self.create_publisher(
            CompressedImage, "camera/image_raw/compressed", qos_profile_sensor_data
        )
        self._odometry = self.create_publisher(Odometry, "odom", qos_profile_sensor_data)
        self.heard: dict[str, list[Any]] = {"pose": [], "path": [], "new_place": []}
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        kinds = ((PoseWithCovarianceStamped, "pose", 10), (Way, "path", latched), (Float64, "new_place", 10))
        for kind, name, qos in kinds:
            self.create_subscription(kind, f"waypost/{name}", self.heard[name].append, qos)

    def met(self) -> None:
        self.until(lambda: self._image.get_subscription_count() and self._odometry.get_subscription_count())

    def until(self, is_so: Any) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not is_so():
            assert time.monotonic() < deadline, "it never became so"
            rclpy.spin_once(self, timeout_sec=0.02)

    def call(self, kind: Any, name: str, **fields: Any) -> Any:
        client = self.create_client(kind, f"/waypost/{name}")
        assert client.wait_for_service(PATIENCE_S), name
        answer = client.call_async(kind.Request(**fields))
        rclpy.spin_until_future_complete(self, answer, timeout_sec=PATIENCE_S)
        assert answer.done(), f"{name} does not answer"
        return answer.result()

    def set(self, name: str, value: str) -> Any:
        text = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
        return self.call(
            SetParameters, "set_parameters", parameters=[Parameter(name=name, value=text)]
        ).results[0]

    def drive(self, number: int) -> None:
        stamp = self.get_clock().now().to_msg()
        image = CompressedImage(format="jpeg", data=self._images[number].read_bytes())
        odometry = Odometry(child_frame_id="base_link")
        image.header.stamp = odometry.header.stamp = stamp
        odometry.header.frame_id = "odom"
        yaw = 0.04 * number
        odometry.pose.pose.position.x = 0.5 * number
        odometry.pose.pose.orientation.z = math.sin(yaw / 2)
        odometry.pose.pose.orientation.w = math.cos(yaw / 2)
        self._odometry.publish(odometry)
        self._image.publish(image)
        until = time.monotonic() + 0.12
        while time.monotonic() < until:
            rclpy.spin_once(self, timeout_sec=0.02)


def main() -> None:
    rclpy.init(domain_id=int(sys.argv[1]))
    robot = Robot(sorted(Path(sys.argv[2]).glob("*.jpg")))
    without = robot.call(Trigger, "start")
    nowhere = robot.set("map", "nowhere")
    robot.met()
    chosen = robot.set("map", "hall")
    localizes = robot.call(SetBool, "localize", data=False)
    for number in range(FRAMES):
        robot.drive(number)
    robot.until(lambda: all(robot.heard.values()))
    robot.until(lambda: ("waypost", "/") in robot.get_node_names_and_namespaces())
    written = [name for name, _ in robot.get_publisher_names_and_types_by_node("waypost", "/")]
    read = [name for name, _ in robot.get_subscriber_names_and_types_by_node("waypost", "/")]
    served = [name for name, _ in robot.get_service_names_and_types_by_node("waypost", "/")]
    finished = robot.call(Trigger, "finish")
    map_value = robot.call(GetParameters, "get_parameters", names=["map"]).values[0]
    told = {
        "middleware": rclpy.get_rmw_implementation_identifier(),
        "without": [without.success, without.message],
        "nowhere": [nowhere.successful, nowhere.reason],
        "chosen": [chosen.successful, chosen.reason],
        "mapping": [localizes.success, localizes.message],
        "finished": [finished.success, finished.message],
        "map": map_value.string_value,
        "pose_frame": robot.heard["pose"][-1].header.frame_id,
        "nodes": sorted(robot.get_node_names()),
        "written": written,
        "read": read,
        "served": served,
        "path": len(robot.heard["path"][-1].poses),
        "new_place": robot.heard["new_place"][-1].data,
    }
    print(json.dumps(told), flush=True)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
