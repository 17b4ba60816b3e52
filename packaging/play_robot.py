"""Plays a ROS 2 robot over DDS, for packaging/try: play_robot.py FOLDER publishes its images, each a second later by its stamps.

Needs ros/tests beside it, which has the messages. It ends once a bridge has heard all.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import ros_types as ros
from robot import LOSSLESS, SECOND_NS, Robot, until

TOPIC = "camera/image_raw/compressed"

robot = Robot(domain=0)
robot.advertise(TOPIC, ros.CompressedImage, LOSSLESS)
until(lambda: robot.is_heard(TOPIC), what="no bridge listens")
for second, image in enumerate(sorted(Path(sys.argv[1]).iterdir()), 1):
    robot.compressed(second * SECOND_NS, image.read_bytes(), TOPIC)
    time.sleep(0.1)
