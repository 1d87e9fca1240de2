"""Draws a scene with a graph."""

from __future__ import annotations

import atexit
import collections
import dataclasses
import weakref
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from . import _native
from ._native import Camera, Plan, Scene

Setting = bool | int | float | str


@dataclasses.dataclass(frozen=True)
class Param:
    """A parameter that a graph declares, with its value in the current plan."""

    name: str
    value: Setting
    #: The value if it is not set.
    default: Setting
    #: The value that costs no accuracy, if the graph names one.
    exact: Setting | None
    #: "bool", "int", "float" or "str".
    kind: str
    #: Minimum and maximum.
    range: tuple[float, float] | None
    #: Step of a slider.
    step: float | None
    #: The allowed names.
    choices: tuple[str, ...] | None
    #: True if a change needs no new plan.
    live: bool
    #: True if the value is raised when a frame needs more.
    grows: bool
    #: A short name.
    label: str
    #: A sentence; may be empty.
    help: str


class Params(Mapping[str, Param]):
    """The parameters of a renderer's graph, by name, also as attributes: `params.digit_bits.range`. Set them with `Renderer.set`."""

    def __init__(self, params: Iterable[Param]) -> None:
        self._params = {param.name: param for param in params}

    def __getitem__(self, name: str) -> Param:
        return self._params[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._params)

    def __len__(self) -> int:
        return len(self._params)

    def __getattr__(self, name: str) -> Param:
        try:
            return self.__dict__["_params"][name]
        except KeyError:
            raise AttributeError(f"no parameter {name!r}; available: {', '.join(self.__dict__.get('_params', ()))}") from None

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._params]

    def __repr__(self) -> str:
        return f"Params({', '.join(f'{param.name}={param.value!r}' for param in self.values())})"


def texts(params: Mapping[str, Setting] | None) -> list[tuple[str, str]]:
    """Returns settings as text, as for the command line's `--set`."""
    return [(name, _text(value)) for name, value in (params or {}).items()]


def _text(value: Setting) -> str:
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, (float, np.floating)):
        return repr(float(value))
    return str(value)


#: Renderers with a running thread, which must end before the interpreter does.
_open: weakref.WeakSet[Renderer] = weakref.WeakSet()


class Renderer:
    """Draws a scene with a graph, on its own device.

    Calls from several threads are served in order, one at a time. The GIL is released while a call waits, and Ctrl-C ends a call.

    Args:
        scene: the scene.
        pipeline: name of a built-in graph (`splatgraph source` lists them), or a path.
        params: values of the graph's parameters.
        size: width and height of all pictures, in pixels; without it, cameras have their own.
        background: colour behind the splats, display-encoded, 0 to 1.
        backend: "vulkan" or "metal"; by default, the system's.
        device: a part of the device's name, or its index in `splatgraph devices`.
        validation: check every call of the graphics API, for tests.

    Raises:
        GraphError: the graph cannot be read, or a parameter is invalid. `render` and `plan` report other errors in it.
        DeviceError: no suitable device was found.
    """

    def __init__(
        self,
        scene: Scene,
        pipeline: str = "auto",
        params: Mapping[str, Setting] | None = None,
        size: tuple[int, int] | None = None,
        *,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        backend: str | None = None,
        device: str | int | None = None,
        validation: bool = False,
    ) -> None:
        self.scene = scene
        self.size = size
        self.background = background
        self._pipeline = pipeline
        self._set = dict(params or {})
        name = None if device is None else str(device)
        self._engine = _native.Engine(scene, pipeline, texts(self._set), backend=backend, device=name, validation=validation)
        _open.add(self)

    def render(self, camera: Camera) -> np.ndarray:
        """Draws a picture: display-encoded colours, float32 [height, width, 3], row 0 at the top, not clamped."""
        return self._submit(camera).result()[0]

    def render_many(self, cameras: Iterable[Camera], ahead: int = 4) -> Iterator[np.ndarray]:
        """Draws a picture of each camera, in order, as `render` does.

        Up to `ahead` further pictures are requested in advance, so the device draws while Python works.
        """
        return (picture for picture, _ in self._results(cameras, ahead))

    def _results(self, cameras: Iterable[Camera], ahead: int = 4) -> Iterator[tuple[np.ndarray, dict[str, np.ndarray]]]:
        """Draws a picture of each camera, with the requested outputs."""
        pending: collections.deque[_native.Pending] = collections.deque()
        for camera in cameras:
            pending.append(self._submit(camera))
            if len(pending) > ahead:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()

    def _submit(self, camera: Camera) -> _native.Pending:
        if self.size is not None and self.size != (camera.width, camera.height):
            camera = camera.resized(*self.size)
        return self._engine.submit(camera, self.background)

    @property
    def pipeline(self) -> str:
        """The graph's name or path."""
        return self._pipeline

    @property
    def params(self) -> Params:
        """The graph's parameters with their values and ranges."""
        found = self._engine.params(self._size())
        return Params(Param(**{**one, "range": _tuple(one["range"]), "choices": _tuple(one["choices"])}) for one in found)

    def set(self, **params: Setting) -> None:
        """Sets parameters of the graph, for example `set(digit_bits=4)`; the others stay unchanged.

        Raises:
            GraphError: a name or a value is invalid. Nothing is changed then.
        """
        changed = {**self._set, **params}
        self._engine.set_graph(self._pipeline, texts(changed), self._size())
        self._set = changed

    def use(self, pipeline: str, params: Mapping[str, Setting] | None = None) -> None:
        """Draws with another graph from now on.

        Raises:
            GraphError: the graph cannot be read, or a parameter is invalid. Nothing is changed then.
        """
        if (pipeline, dict(params or {})) == (self._pipeline, self._set):
            return
        self._engine.set_graph(pipeline, texts(params), self._size())
        self._pipeline, self._set = pipeline, dict(params or {})

    def show(self, scene: Scene) -> None:
        """Draws another scene from now on."""
        self._engine.set_scene(scene)
        self.scene = scene

    @property
    def plan(self) -> Plan:
        """The plan for the device, the scene and `size` (960 x 540 without one)."""
        return self._engine.plan(self._size())

    @property
    def stats(self) -> dict[str, Any] | None:
        """Times in milliseconds, counts and memory in bytes of the last returned picture, as in `splatgraph render --json`."""
        return self._engine.stats

    @property
    def device(self) -> dict[str, Any]:
        """The device's name, driver, kind and index."""
        return self._engine.device

    def close(self) -> None:
        """Ends the renderer's thread and closes its device; later calls fail."""
        self._engine.close()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _size(self) -> tuple[int, int]:
        return self.size or (960, 540)


def _tuple(values: list[Any] | None) -> tuple[Any, ...] | None:
    return None if values is None else tuple(values)


@atexit.register
def _close_all() -> None:
    # A thread that draws while the process ends would use an unloaded driver.
    for renderer in list(_open):
        renderer.close()
