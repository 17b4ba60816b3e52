"""Photographs that are too large, and odometry in other units."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import IMAGES, frame
from PIL import Image

import waypost
from waypost.doubts import OdometryDoubts, OdometryWarning
from waypost.goals import goal_message


def large_photo() -> bytes:
    photo = Image.open(IMAGES[0]).convert("RGB").resize((5600, 3150))
    exif = Image.Exif()
    exif[0x0112] = 6  # To be turned by a quarter.
    encoded = io.BytesIO()
    photo.save(encoded, "JPEG", quality=80, exif=exif)
    return encoded.getvalue()


def test_a_photo_of_17_megapixels_is_shrunk_and_upright(client: waypost.Client, hall: str) -> None:
    message = frame(1, image=large_photo()).to_proto()
    sent = Image.open(io.BytesIO(message.image))
    assert sent.width * sent.height <= 16_000_000
    assert sent.height > sent.width
    with client.session(hall, "photo") as session:
        [answer] = session.stream([frame(1, image=large_photo())])
    assert isinstance(answer, waypost.Answer)


def test_pixels_are_shrunk_by_their_mean() -> None:
    pixels = np.zeros((4000, 6000, 3), np.uint8)
    pixels[::2] = 100
    sent = np.asarray(Image.open(io.BytesIO(frame(1, image=pixels).to_proto().image)))
    assert sent.shape == (2000, 3000, 3)
    assert (sent == 50).all()


def test_the_photo_of_a_goal_is_shrunk() -> None:
    sent = Image.open(io.BytesIO(goal_message(large_photo()).image))
    assert sent.width * sent.height <= 16_000_000
    assert sent.height > sent.width


def test_files_are_in_the_order_that_people_count_in(tmp_path: Path) -> None:
    wanted = ["a-3.png", "a2.jpg", "a02b.JPG", "a10.jpeg", "b1.jpg"]
    for name in [*wanted, "a1.txt", "z.webp"]:
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "a3.jpg").mkdir()
    assert [file.name for file in waypost.image_files(tmp_path)] == wanted


def test_what_a_server_takes_is_sent_as_it_is() -> None:
    small = IMAGES[0].read_bytes()
    assert frame(1, image=small).to_proto().image == small


def frames(step_m: float, step_rad: float, second_ns: int = 1_000_000_000) -> Iterator[waypost.Frame]:
    for number in range(1, 31):
        pose = (step_m * number, 0.0, step_rad * number)
        image = IMAGES[number % len(IMAGES)].read_bytes()
        yield waypost.Frame(sequence=number, stamp_ns=number * second_ns, image=image, odometry=pose)


@pytest.mark.parametrize(
    ("metres", "radians", "second_ns", "said"),
    [
        (0.5, 0.1, 1_000_000_000, None),
        (0.5, 20.0, 1_000_000_000, "in degrees"),
        (0.5, 90.0, 1_000_000_000, "whole multiples of 15, as 90 is"),
        (50.0, 0.1, 1_000_000_000, "centimetres"),
        (0.5, 0.0, 1, "stamps not in nanoseconds"),
    ],
)
def test_other_units_are_doubted(metres: float, radians: float, second_ns: int, said: str | None) -> None:
    doubts = OdometryDoubts()
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        for given in frames(metres, radians, second_ns):
            doubts.look(given)
    assert [
        str(warning.message) for warning in heard if said is None or said not in str(warning.message)
    ] == []
    assert len(heard) == (0 if said is None else 1)


def test_a_session_warns_of_degrees(client: waypost.Client, hall: str) -> None:
    with client.session(hall, "degrees") as session, pytest.warns(OdometryWarning, match="in degrees"):
        answered = list(session.stream(frames(0.1, 20.0)))
    assert len(answered) == 30
