"""Photographs that are larger than a server takes."""

from __future__ import annotations

import io
import math
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

#: Pixels that a server takes at most.
_MOST_PIXELS = 16_000_000
#: Files of more pixels are longer than that.
_MAYBE_LARGE_BYTES = 200_000
#: Of what is encoded anew: features lose nothing that counts.
_QUALITY = 92
#: What is left of each side when an image is still too long.
_STEP = 0.8


def image_files(folder: str | os.PathLike[str]) -> list[Path]:
    """The JPEG and PNG files of a folder in the order in which people count: `frame2` before `frame10`.

    That is the order in which `waypost stream` sends a folder.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as drive:
    ...     for name in ("frame10.jpg", "frame2.jpg", "notes.txt"):
    ...         _ = Path(drive, name).write_bytes(b"")
    ...     [file.name for file in image_files(drive)]
    ['frame2.jpg', 'frame10.jpg']

    Raises:
        OSError: If the folder cannot be read.
    """
    paths = (path for path in Path(folder).iterdir() if path.suffix.lower() in (".jpg", ".jpeg", ".png"))
    named = sorted((os.fsencode(path.name), path) for path in paths if path.is_file())
    return [path for name, path in sorted(named, key=lambda one: _counted(one[0]))]


def _counted(name: bytes) -> list[tuple[int, int]]:
    # Numbers by their value, all else byte by byte.
    parts = re.findall(rb"\d+|\D", name, re.DOTALL)
    return [(ord("0"), int(part)) if part.isdigit() else (part[0], 0) for part in parts]


def fitting_pixels(pixels: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The pixels, or means of squares of them where there are more than a server takes."""
    if pixels.ndim not in (2, 3):
        return pixels
    height, width = pixels.shape[:2]
    step = math.ceil(math.sqrt(height * width / _MOST_PIXELS)) if height * width else 1
    if step <= 1 or pixels.dtype != np.uint8:
        return pixels
    height, width = height // step, width // step
    squares = pixels[: height * step, : width * step].reshape(height, step, width, step, *pixels.shape[2:])
    return np.asarray(np.rint(squares.mean(axis=(1, 3))), dtype=np.uint8)


def fitting_file(image: bytes, most_bytes: int) -> bytes:
    """The JPEG or PNG as it is, or upright and smaller where a server would refuse its size.

    That takes Pillow; where it is not installed, or cannot read the image, the server says what is wrong.
    """
    if len(image) <= _MAYBE_LARGE_BYTES:
        return image
    try:
        from PIL import Image, ImageOps
    except ImportError:
        return image
    try:
        photo = Image.open(io.BytesIO(image))
        if photo.width * photo.height <= _MOST_PIXELS and len(image) <= most_bytes:
            return image
        upright = ImageOps.exif_transpose(photo).convert("RGB")
    except (OSError, ValueError, Image.DecompressionBombError):
        return image
    scale = min(1.0, math.sqrt(_MOST_PIXELS / (upright.width * upright.height)))
    while True:
        size = (max(1, int(upright.width * scale)), max(1, int(upright.height * scale)))
        encoded = io.BytesIO()
        upright.resize(size).save(encoded, "JPEG", quality=_QUALITY)
        if encoded.tell() <= most_bytes:
            return encoded.getvalue()
        scale *= _STEP
