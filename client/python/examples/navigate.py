"""Leads a robot to a place: `python navigate.py MAP LABEL`. The module `robot` is yours.

The server's address, token and certificates come from WAYPOST_SERVER and such, as for the command line.
"""

import sys
import time

from robot import Robot  # Yours: odometry(), image() and drive(forward_m_s, turn_rad_s).

import waypost
from waypost.v1.geometry_pb2 import Camera, FieldOfView

robot, (_, map_id, label) = Robot(), sys.argv
camera = Camera(field_of_view=FieldOfView(horizontal_rad=1.2))
with waypost.connect() as client, client.navigate(map_id, camera, goal=label) as navigation:
    cycle = 0
    try:
        while navigation.guidance is None or navigation.guidance.status != waypost.NavigationStatus.ARRIVED:
            now_ns, odometry = time.monotonic_ns(), robot.odometry()
            navigation.report(now_ns, odometry)
            if cycle % 10 == 0:  # Twice a second.
                navigation.see(waypost.Frame(cycle + 1, now_ns, robot.image(), odometry=odometry))
            robot.drive(*navigation.command())  # A stop, as soon as commands lapse.
            while event := navigation.next_event(timeout_s=0.0):
                print(event)
            cycle += 1
            time.sleep(0.05)
    finally:
        robot.drive(0.0, 0.0)
print("arrived:", navigation.guidance)
