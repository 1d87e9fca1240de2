"""Compares and encodes pictures."""

from __future__ import annotations

import dataclasses
from typing import Any

from . import _native


@dataclasses.dataclass(frozen=True)
class Comparison:
    """The difference between two pictures."""

    #: Peak signal-to-noise ratio in dB of values clamped to 0..1; infinite for an error of 0.
    psnr: float
    #: Structural similarity, 1 for equal pictures; None for pictures below 11 x 11 pixels.
    ssim: float | None
    #: The largest difference of a channel, not clamped, and the pixel (column, row) that has it.
    worst: float
    worst_pixel: tuple[int, int]
    #: True if every channel of every pixel is equal.
    identical: bool


def compare(a: Any, b: Any) -> Comparison:
    """Measures the difference between two pictures of the same size.

    Args:
        a: display-encoded colours, [height, width, 3]: floats (0 is black, 1 is white), uint8 or uint16.
        b: like `a`.

    Raises:
        TypeError: `a` or `b` is not a picture of these types.
        ValueError: the pictures differ in size, or a value is not finite.
    """
    found = _native.compare(a, b)
    worst = found["worst"]
    return Comparison(float(found["psnr_db"]), found["ssim"], worst["difference"], (worst["x"], worst["y"]), found["identical"])


def png(picture: Any) -> bytes:
    """Returns the bytes of a PNG file, 8 bits per channel, for a file or `IPython.display.Image`.

    Args:
        picture: display-encoded colours, [height, width, 3]: floats (0 is black, 1 is white), uint8 or uint16.
    """
    return _native.png(picture)
