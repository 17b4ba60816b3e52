"""A real ROS 2, rclpy over Fast DDS, with the bridge: not the DDS of the other tests."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest
from conftest import COMPRESSED, IMAGES, PATIENCE_S, REPOSITORY, Stage, environment

TARGET = Path(os.environ.get("CARGO_TARGET_DIR") or REPOSITORY / "target")
PYTHON = Path(os.environ.get("WAYPOST_ROS2") or TARGET / "ros2") / "bin" / "python"


def test_a_robot_of_a_real_ros_2_is_served(stage: Stage) -> None:
    if not PYTHON.is_file():
        pytest.skip(f"there is no ROS 2 at {PYTHON}: scripts/setup-ros2 makes it for Python 3.11")
    flags = ("--services", "--image-topic", COMPRESSED, "--camera-info-topic", "none", "--most-hz", "0")
    bridge = stage.bridge(*flags)
    command = [PYTHON, Path(__file__).with_name("ros2_robot.py"), str(stage.domain), IMAGES[0].parent]
    ran = subprocess.run(
        command,
        # On this machine alone, as the bridge is.
        env=environment() | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        capture_output=True,
        text=True,
        timeout=3 * PATIENCE_S,
        check=False,
    )
    assert ran.returncode == 0, f"{ran.stderr}\n{bridge.said()}"
    told = json.loads(ran.stdout)
    assert told["middleware"] == "rmw_fastrtps_cpp"
    assert told["without"][0] is False
    assert "no map is chosen" in told["without"][1]
    assert told["nowhere"][0] is False
    assert "the server has no map `nowhere`" in told["nowhere"][1]
    assert told["chosen"] == [True, ""]
    [session] = stage.client.sessions("hall")
    assert told["mapping"] == [True, f"{session.name} is open"]
    assert told["finished"] == [True, f"{session.name} is finished; 0 frames could not be sent"]
    assert (told["map"], told["pose_frame"]) == ("hall", "map")
    # Sensors are best effort: a frame may be lost on its way.
    frames = stage.client.frames(session.name)
    assert 15 <= len(frames) <= 20
    assert 1 <= told["path"] <= len(frames)
    assert 0.0 <= told["new_place"] <= 1.0
    # `ros2 node list` and `ros2 node info` ask so.
    assert told["nodes"] == ["robot", "waypost"]
    assert {"/tf", "/waypost/pose", "/waypost/path", "/diagnostics"} <= set(told["written"])
    assert {"/camera/image_raw/compressed", "/odom"} <= set(told["read"])
    assert {"/waypost/finish", "/waypost/set_parameters"} <= set(told["served"])
