"""Converts arrays of numpy, torch and other libraries to numpy's."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np


def array(value: Any, name: str, shape: Sequence[int | None] | None = None, dtype: Any = np.float32) -> np.ndarray:
    """Returns `value` as a C-contiguous array of `dtype` (None: its own), without a copy if it already is one.

    `value` is an array of numpy, anything with `__dlpack__` in the CPU's memory, or anything that `numpy.asarray` accepts. `name` is the
    argument's name, for errors. `None` in `shape` matches any length.

    Raises:
        TypeError: `value` is not an array of numbers.
        ValueError: it has another shape, is not in the CPU's memory, or requires gradients.
    """
    return np.ascontiguousarray(_found(value, name, shape), dtype=dtype)


def picture(value: Any, name: str, shape: Sequence[int | None]) -> np.ndarray:
    """Returns a picture as `array` does, in float32. Values of uint8 and uint16 are divided by their maximum, which is white.

    Other integers raise a TypeError, because it is unknown which value is white. Floats that are 8-bit values raise a ValueError, and floats
    of which most (not counting zeros) are above white cause a UserWarning.
    """
    found = _found(value, name, shape)
    if found.dtype.kind not in "iu":
        found = np.ascontiguousarray(found, dtype=np.float32)
        largest = found.max(initial=0.0, where=np.isfinite(found))
        if largest >= 2 and (found == np.rint(found)).all():
            raise ValueError(f"{name}: expected floats from 0 to 1, found whole numbers up to {largest:g}: divide 8-bit values by 255")
        if 2 * np.count_nonzero(found > 1) > np.count_nonzero(found):
            warnings.warn(f"{name}: most values are above 1, which is white; the largest is {largest:g}", stacklevel=2)
        return found
    if found.dtype not in (np.uint8, np.uint16):
        raise TypeError(f"{name}: expected a picture of floats from 0 to 1, of uint8 or of uint16, found {found.dtype}")
    return np.ascontiguousarray(found, dtype=np.float32) / np.float32(np.iinfo(found.dtype).max)


def _found(value: Any, name: str, shape: Sequence[int | None] | None) -> np.ndarray:
    if getattr(value, "requires_grad", False):
        # The gradient would silently be lost.
        raise ValueError(f"{name}: expected an array without gradients, found one that requires them; pass {name}.detach()")
    if not isinstance(value, np.ndarray) and hasattr(value, "__dlpack_device__"):
        kind = int(value.__dlpack_device__()[0])
        # DLPack's device types: 1 is kDLCPU, 3 is kDLCUDAHost, memory that CUDA has pinned.
        if kind not in (1, 3):
            raise ValueError(
                f"{name}: expected an array in the CPU's memory, found one of {getattr(value, 'device', kind)}; pass {name}.cpu()"
            )
        value = np.from_dlpack(value)
    try:
        found = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name}: expected an array, found {type(value).__name__} ({error})") from None
    if found.dtype.kind not in "fiub":
        raise TypeError(f"{name}: expected an array of numbers, found {found.dtype}")
    if shape is not None:
        fits = len(found.shape) == len(shape) and all(want in (None, is_) for want, is_ in zip(shape, found.shape))
        if not fits:
            wanted = ", ".join("any" if length is None else str(length) for length in shape)
            raise ValueError(f"{name}: expected the shape [{wanted}], found {list(found.shape)}")
    return found
