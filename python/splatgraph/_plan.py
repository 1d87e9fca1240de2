"""Builds plans without a device."""

from __future__ import annotations

import os
from collections.abc import Mapping

from . import _native
from ._native import Plan, Scene
from ._renderer import Setting, graph_name, pair_of_sides, texts


def plan(
    pipeline: str | os.PathLike[str] = "auto",
    params: Mapping[str, Setting] | None = None,
    scene: Scene | None = None,
    size: tuple[int, int] = (960, 540),
    subgroup_size: int = 32,
) -> Plan:
    """Builds the plan of a graph, for the least capable supported device; no device is opened.

    Args:
        pipeline: name of a built-in graph, or a path.
        params: values of the graph's parameters.
        scene: the scene to draw; without one, a million splats with harmonics of degree 3.
        size: width and height of the pictures, in pixels.
        subgroup_size: number of invocations in a subgroup: 32 on most GPUs; 4, 8 or 16 on CPUs; 64 or 128 on some GPUs.

    Raises:
        GraphError: the graph or a shader has errors.
        ValueError: `size` or `subgroup_size` is none of the possible values.
    """
    return _native.plan(graph_name(pipeline), texts(params), scene, pair_of_sides(size, "size"), subgroup_size)
