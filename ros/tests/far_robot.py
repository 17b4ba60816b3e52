"""A robot of another machine, which finds the bridge by multicast: far_robot.py DOMAIN.

It sends ten images with odometry, and prints how many the bridge says it received.
"""

from __future__ import annotations

import sys
import time

import robot
import ros_types as ros
from conftest import COMPRESSED, Diagnostics, drive, met

if __name__ == "__main__":
    robot.CONFIGURATION = "<CycloneDDS/>"
    far = robot.Robot(int(sys.argv[1]))
    told = Diagnostics(far)
    far.advertise(COMPRESSED, ros.CompressedImage, robot.LOSSLESS)
    far.advertise("odom", ros.Odometry, robot.LOSSLESS)
    met(far, COMPRESSED, "odom")
    drive(far, range(1, 11), pause_s=0.05)
    robot.until(lambda: told.count("images", "received") == 10 and told.count("odometry", "received") == 10)
    # Cyclone's own farewell may take a while.
    print(told.count("images", "received"), flush=True)
    time.sleep(0.1)
