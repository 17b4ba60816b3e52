"""A robot of another machine: far_robot.py DOMAIN [alone].

It looks for the bridge by multicast, or alone for nobody.

It sends ten images with odometry, and prints how many the bridge says it received.
"""

from __future__ import annotations

import sys
import time

import robot
import ros_types as ros
from conftest import COMPRESSED, Diagnostics, drive, met

#: Neither multicast nor peers: whoever wants this one has to know where it is.
ALONE = """<CycloneDDS><Domain>
  <General><AllowMulticast>false</AllowMulticast></General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex></Discovery>
</Domain></CycloneDDS>"""

if __name__ == "__main__":
    robot.CONFIGURATION = "<CycloneDDS/>" if sys.argv[2:] != ["alone"] else ALONE
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
