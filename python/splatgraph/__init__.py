"""Draws 3D Gaussian Splatting scenes with render graphs, on Vulkan or Metal.

    import splatgraph

    scene = splatgraph.Scene.load("scene.ply")
    renderer = splatgraph.Renderer(scene)
    picture = renderer.render(splatgraph.Camera.framing(scene))

`rasterization` is gsplat's function. docs/python.md documents the whole package.
"""

import sys as _sys

from . import _native
from ._native import (
    Camera,
    DeviceError,
    Error,
    GraphError,
    Plan,
    Scene,
    SceneError,
    __version__,
)
from ._pictures import Comparison, compare, png
from ._plan import plan
from ._rasterization import rasterization
from ._renderer import Param, Params, Renderer
from ._studies import Advice, Ledger, Line, Share, Tried, advise, trade

# Shaders are compiled in a second process, so that a crash of the compiler cannot end this one.
if _sys.executable:
    _native._set_process(_sys.executable, _native.__file__)

__all__ = [
    "Advice",
    "Camera",
    "Comparison",
    "DeviceError",
    "Error",
    "GraphError",
    "Ledger",
    "Line",
    "Param",
    "Params",
    "Plan",
    "Renderer",
    "Scene",
    "SceneError",
    "Share",
    "Tried",
    "__version__",
    "advise",
    "compare",
    "plan",
    "png",
    "rasterization",
    "trade",
]
