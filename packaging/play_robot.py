"""Plays a ROS 2 robot over DDS: play_robot.py FOLDER publishes its images, each a second later by its stamps.

Needs ros/tests on the PYTHONPATH, which has the messages, and Cyclone DDS. ROS_DOMAIN_ID names the domain, as for ROS. It waits for a
bridge, and ends once all is published.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import ros_types as ros
from robot import LOSSLESS, SECOND_NS, Robot, until

TOPIC = "camera/image_raw/compressed"

robot = Robot(domain=int(os.environ.get("ROS_DOMAIN_ID", "0")))
robot.advertise(TOPIC, ros.CompressedImage, LOSSLESS)
until(lambda: robot.is_heard(TOPIC), what="no bridge listens")
for second, image in enumerate(sorted(Path(sys.argv[1]).iterdir()), 1):
    robot.compressed(second * SECOND_NS, image.read_bytes(), TOPIC)
    time.sleep(0.1)
