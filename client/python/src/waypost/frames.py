"""What a robot sends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any, Union

import numpy as np
import numpy.typing as npt

from waypost.photos import fitting_file, fitting_pixels
from waypost.png import png
from waypost.poses import Pose2, Pose3, odometry
from waypost.v1 import recognition_pb2, session_pb2

#: Longer images are refused without being sent.
MAX_IMAGE_BYTES = 4 << 20

Words = npt.NDArray[np.uint32]
Image = Union[bytes, npt.NDArray[np.uint8]]


@dataclass(frozen=True, eq=False)
class WordHistogram:
    """How often words were seen in an image: all decisions but those of geometry can be made from it."""

    #: Each word once, in any order.
    words: Words
    #: How often each was seen, from 1 to 65,535; left out, each was seen once.
    counts: Words | None = None

    def __post_init__(self) -> None:
        """Takes any sequence of whole numbers.

        Raises:
            ValueError: If they are not whole numbers from 0 up, or the lengths differ.
        """
        _set(self, "words", _whole_numbers("words", self.words))
        if self.counts is not None:
            _set(self, "counts", _whole_numbers("counts", self.counts))
            _same_length("counts", self.counts, self.words)


@dataclass(frozen=True, eq=False)
class WordList:
    """The features of an image; position i of each array is feature i.

    Points are in pixels of the image that the camera took: x to the right and y down, (0, 0) the centre of
    the top left pixel.
    """

    words: Words
    x_px: npt.NDArray[np.float32]
    y_px: npt.NDArray[np.float32]
    #: Width and height of the image that the points are in.
    image_size_px: tuple[int, int]
    #: Diameter of the neighbourhood described, if known.
    size_px: npt.NDArray[np.float32] | None = None
    #: Orientation, from x to the right towards y down, if known.
    angle_rad: npt.NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        """Takes any sequences of numbers.

        Raises:
            ValueError: If the words are not whole numbers from 0 up, or the lengths differ.
        """
        _set(self, "words", _whole_numbers("words", self.words))
        for name in ("x_px", "y_px", "size_px", "angle_rad"):
            values = getattr(self, name)
            if values is not None:
                values = _one_row(name, np.asarray(values, dtype=np.float32))
                _same_length(name, values, self.words)
                _set(self, name, values)


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame: an image, or its words."""

    #: Rises within the session; gaps are allowed. At or below the last committed number it asks for the
    #: stored answer.
    sequence: int
    #: When the image was taken, by the robot's own steady clock: above 0, and rising.
    stamp_ns: int
    #: A JPEG or PNG as bytes, or pixels as uint8, height x width (grey) or height x width x 3 (RGB), which
    #: are sent as PNG. One of more than 16 million pixels is sent smaller, files if Pillow is installed.
    image: Image | None = None
    #: In place of the image; the session has to be opened with `words_hash`.
    words: WordHistogram | WordList | None = None
    #: Where the wheels say the robot is, in the session's odom frame: a pose, (x, y, heading) in metres and
    #: radians, or a 4 x 4 matrix from base_link to odom.
    odometry: Pose2 | Pose3 | npt.ArrayLike | None = None
    #: 6 x 6, of (x, y, z, rotation about x, y, z), in m^2 and rad^2.
    odometry_covariance: npt.ArrayLike | None = None
    #: What the robot calls the frame, as by the name of its file: at most 200 bytes, without control
    #: characters. Told back wherever the frame is named.
    note: str = ""

    def __post_init__(self) -> None:
        """Checks what can be checked without a server.

        Raises:
            ValueError: If there is not one of image and words, or if a number or an array cannot be sent.
        """
        if (self.image is None) == (self.words is None):
            raise ValueError(f"frame {self.sequence}: give either an image or words")
        for name, number in (("sequence", self.sequence), ("stamp_ns", self.stamp_ns)):
            if not isinstance(number, Integral):
                raise ValueError(
                    f"frame {self.sequence}: {name} is {number!r}, and has to be a whole number"
                    + (": of nanoseconds, as time.time_ns() gives" if name == "stamp_ns" else "")
                )
        if not 0 <= self.sequence < 1 << 63 or not 0 <= self.stamp_ns < 1 << 63:
            raise ValueError(f"frame {self.sequence}: sequence and stamp_ns must be from 0 to 2^63 - 1")
        if self.odometry is None and self.odometry_covariance is not None:
            raise ValueError(f"frame {self.sequence}: a covariance needs odometry")

    def to_proto(self) -> session_pb2.Frame:
        """The frame as the contract has it.

        Raises:
            ValueError: If image or odometry have a shape or type that cannot be sent.
        """
        frame = session_pb2.Frame(sequence=self.sequence, stamp_ns=self.stamp_ns, note=self.note)
        put_content(frame, self.image if self.words is None else self.words)
        if self.odometry is not None:
            frame.odometry.CopyFrom(odometry(self.odometry, self.odometry_covariance))
        return frame


def put_content(
    message: session_pb2.Frame | recognition_pb2.QueryRequest,
    content: Image | WordHistogram | WordList | None,
) -> None:
    """Sets the `content` of a frame or a query."""
    if isinstance(content, WordHistogram):
        message.histogram.SetInParent()
        message.histogram.words.extend(content.words.tolist())
        if content.counts is not None:
            message.histogram.counts.extend(content.counts.tolist())
    elif isinstance(content, WordList):
        words = message.words
        words.words.extend(content.words.tolist())
        words.image_width_px, words.image_height_px = content.image_size_px
        words.x_px.extend(content.x_px.tolist())
        words.y_px.extend(content.y_px.tolist())
        if content.size_px is not None:
            words.size_px.extend(content.size_px.tolist())
        if content.angle_rad is not None:
            words.angle_rad.extend(content.angle_rad.tolist())
    elif isinstance(content, np.ndarray):
        message.image = png(fitting_pixels(content))
    elif isinstance(content, (bytes, bytearray, memoryview)):
        message.image = fitting_file(bytes(content), MAX_IMAGE_BYTES)
    elif content is not None:
        raise ValueError(
            f"an image is a JPEG or PNG as bytes, or pixels as a numpy array, not {type(content).__name__}; "
            "read a file with Path(name).read_bytes()"
        )


def _whole_numbers(name: str, values: Words | Sequence[int]) -> Words:
    array = _one_row(name, np.asarray(values))
    if array.size == 0:
        return array.astype(np.uint32)
    if array.dtype.kind not in "iu":
        raise ValueError(f"{name} must be whole numbers, not {array.dtype}")
    if array.min() < 0 or array.max() > np.iinfo(np.uint32).max:
        raise ValueError(f"{name} must be from 0 to 2^32 - 1")
    return array.astype(np.uint32)


def _one_row(name: str, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    if array.ndim != 1:
        raise ValueError(f"{name} must have one dimension, not the shape {array.shape}")
    return array


def _same_length(name: str, values: npt.NDArray[Any], words: Words) -> None:
    if len(values) != len(words):
        raise ValueError(f"{name} has {len(values)} values for {len(words)} words; give as many")


def _set(instance: object, name: str, value: object) -> None:
    """Sets a field of a frozen dataclass while it is made."""
    object.__setattr__(instance, name, value)
