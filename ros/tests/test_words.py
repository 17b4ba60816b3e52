"""Words that are made on the robot: images stay there, and the map decides as it would of images."""

from __future__ import annotations

from pathlib import Path

import pytest
import ros_types as ros
import waypost
from conftest import COMPRESSED, Diagnostics, Stage, drive, met
from robot import LOSSLESS, until
from test_bad_input import refused

FLAGS = (
    "--image-topic",
    COMPRESSED,
    "--sensor-qos",
    "reliable",
    "--camera-info-topic",
    "none",
    "--most-hz",
    "0",
)
FRAMES = 30


def driven(stage: Stage, map_id: str, *flags: str) -> list[tuple[int, int, float]]:
    """What a map says of a drive: each frame's place, its words, and the probability of somewhere new."""
    robot = stage.robots[0] if stage.robots else stage.robot()
    told = Diagnostics(robot)
    bridge = stage.bridge("--map", map_id, "--session", "drive", *FLAGS, *flags)
    robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
    robot.advertise("odom", ros.Odometry, LOSSLESS)
    met(robot, COMPRESSED, "odom")
    drive(robot, range(1, FRAMES + 1))
    until(lambda: told.count("server", "frames answered") == FRAMES, what=f"{told()} {bridge.said()}")
    assert bridge.end() == 0
    until(lambda: not robot.is_heard("odom"))
    answers = [record.answer for record in stage.client.frames(f"maps/{map_id}/sessions/drive")]
    return [(answer.place_number, answer.words, answer.new_place_posterior) for answer in answers]


def test_words_of_the_robot_are_decided_as_its_images_are(stage: Stage) -> None:
    stage.client.create_map("images", "shipped")
    of_images = driven(stage, "images")
    of_words = driven(stage, "hall", "--words")
    assert of_words == of_images
    # The server has thumbnails of the one, and nothing that one could look at of the other.
    name = "sessions/drive/frames/1"
    assert stage.client.frame_image(f"maps/images/{name}")
    with pytest.raises(waypost.NotFound):
        stage.client.frame_image(f"maps/hall/{name}")
    assert "words are made on the robot" in stage.bridges[-1].said()


def test_histograms_are_taken_as_well(stage: Stage) -> None:
    counts = driven(stage, "hall", "--words=histogram")
    assert len(counts) == FRAMES
    assert min(words for _, words, _ in counts) > 0


def test_words_do_not_go_with_driving(tmp_path: Path) -> None:
    code, told = refused(tmp_path, "--map", "hall", "--localize", "--drive", "--words")
    assert code == 2
    assert "--words keeps images on the robot, and --drive sends them" in told
