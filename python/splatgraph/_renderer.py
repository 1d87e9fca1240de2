"""Draws a scene with a graph."""

from __future__ import annotations

import atexit
import collections
import dataclasses
import math
import operator
import os
import threading
import weakref
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, overload

import numpy as np

from . import _native
from ._native import Camera, Plan, Scene

Value = bool | int | float | str
#: The types of values that a parameter may be set to.
Setting = Value | np.generic


@dataclasses.dataclass(frozen=True)
class Param:
    """A parameter that a graph declares, with its value in the current plan."""

    name: str
    value: Value
    #: The value if neither a preset nor the caller sets the parameter.
    default: Value
    #: The value that costs no accuracy, if the graph names one.
    exact: Value | None
    #: "bool", "int", "float" or "str".
    kind: str
    #: Minimum and maximum; None if the parameter is not a number.
    range: tuple[float, float] | None
    #: Step of a slider for a float; None for other kinds.
    step: float | None
    #: The allowed values; None if the parameter is not a choice of names.
    choices: tuple[str, ...] | None
    #: True if a change needs no new plan.
    live: bool
    #: True if the parameter is a capacity that grows when a frame overflows it.
    grows: bool
    #: Short name for user interfaces.
    label: str
    #: Explanation; may be empty.
    help: str


class Params(Mapping[str, Param]):
    """The parameters of a renderer's graph, by name, also as attributes: `params.digit_bits.range`. Set them with `Renderer.set`."""

    _params: dict[str, Param]

    def __init__(self, params: Iterable[Param]) -> None:
        self.__dict__["_params"] = {param.name: param for param in params}

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

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{name}: cannot be assigned; call Renderer.set({name}={value!r})")

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


def graph_name(pipeline: str | os.PathLike[str]) -> str:
    """Returns the name or path of a graph as text."""
    found = os.fspath(pipeline) if isinstance(pipeline, (str, os.PathLike)) else None
    if not isinstance(found, str):
        raise TypeError(f"pipeline: expected the name of a graph, or a path, found {pipeline!r}")
    return found


def pair_of_sides(size: Any, name: str) -> tuple[int, int]:
    """Returns a width and a height as integers. `name` is the argument's name, for errors."""
    try:
        width, height = map(operator.index, size)
    except (TypeError, ValueError):
        raise TypeError(f"{name}: expected a width and a height in pixels, found {size!r}") from None
    if width < 1 or height < 1:
        raise ValueError(f"{name}: expected numbers above 0, found {width} and {height}")
    return width, height


#: How to change attributes that cannot be assigned.
_CHANGES = {"scene": "show(scene)", "pipeline": "use(pipeline)", "params": "set(name=value)"}

#: All renderers: their threads must end before the interpreter does.
_open: weakref.WeakSet[Renderer] = weakref.WeakSet()


class Renderer:
    """Draws a scene with a graph, on its own device.

    Calls from several threads are served in order, one at a time. The GIL is released while a call waits, and Ctrl-C ends a call.

    Args:
        scene: the scene.
        pipeline: name of a built-in graph (`splatgraph source` lists them), or a path.
        params: values of the graph's parameters.
        size: width and height of all pictures, in pixels; without it, cameras have their own. Can be assigned later.
        background: colour behind the splats, display-encoded, 0 to 1. Can be assigned later.
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
        pipeline: str | os.PathLike[str] = "auto",
        params: Mapping[str, Setting] | None = None,
        size: tuple[int, int] | None = None,
        *,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        backend: str | None = None,
        device: str | int | None = None,
        validation: bool = False,
    ) -> None:
        self.size = size
        self.background = background
        self._scene = scene
        self._pipeline = graph_name(pipeline)
        self._set = dict(params or {})
        #: Held while the scene, the graph or its parameters change, so that concurrent changes are all kept.
        # Reentrant, because a signal handler may set parameters while this thread waits for the engine.
        self._changing = threading.RLock()
        name = None if device is None else str(device)
        self._engine = _native.Engine(scene, self._pipeline, texts(self._set), backend=backend, device=name, validation=validation)
        _open.add(self)

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _CHANGES:
            raise AttributeError(f"{name}: cannot be assigned; call {_CHANGES[name]}")
        if type(self) is Renderer and not name.startswith("_") and name not in ("size", "background") and not hasattr(Renderer, name):
            raise AttributeError(f"{name}: a Renderer has no such attribute; for a parameter of the graph, call set({name}={value!r})")
        if name == "size" and value is not None:
            value = pair_of_sides(value, "size")
        if name == "background":
            value = _color(value)
        super().__setattr__(name, value)

    @overload
    def render(self, camera: Camera) -> np.ndarray: ...
    @overload
    def render(self, camera: Camera, outputs: str | Sequence[str]) -> tuple[np.ndarray, dict[str, np.ndarray]]: ...
    def render(self, camera: Camera, outputs: str | Sequence[str] | None = None) -> Any:
        """Draws a picture: display-encoded colours, float32 [height, width, 3], row 0 at the top, not clamped.

        With `outputs`, returns the picture and a dict of the graph's other outputs: arrays [height, width], or [height, width, 3] for
        "normal". The built-in graphs have "alpha", "depth" and "expected_depth"; those that draw in tiles, as `auto` does on most devices,
        also have "median_depth", "normal", and, as uint32, "contributors" and "index". docs/splatting.md defines them. Pictures with other
        outputs than the last one need a new plan.

        State, such as histories, and `camera.frame` continue from call to call; a new Renderer starts anew.

        Raises:
            GraphError: the graph or a shader has errors, or the graph lacks an output.
            SceneError: the scene has no splats.
            DeviceError: the device failed.
            Error: the camera's projection is not the graph's, or the renderer is closed.
        """
        drawn = self._submit(camera, _names(outputs)).result()
        return drawn[0] if outputs is None else drawn

    @overload
    def render_many(self, cameras: Iterable[Camera], ahead: int = 4) -> Iterator[np.ndarray]: ...
    @overload
    def render_many(
        self, cameras: Iterable[Camera], ahead: int = 4, *, outputs: str | Sequence[str]
    ) -> Iterator[tuple[np.ndarray, dict[str, np.ndarray]]]: ...
    def render_many(self, cameras: Iterable[Camera], ahead: int = 4, *, outputs: str | Sequence[str] | None = None) -> Iterator[Any]:
        """Draws a picture of each camera, in order, as `render` does.

        Up to `ahead` further pictures are requested in advance, so the device draws while Python works. If `cameras` raises an exception,
        the pictures of the cameras before it come first, and then the exception.
        """
        names = _names(outputs)
        pending: collections.deque[_native.Pending] = collections.deque()
        failure = None
        source = iter(cameras)
        while True:
            try:
                pending.append(self._submit(next(source), names))
            except StopIteration:
                break
            except Exception as error:
                failure = error
                break
            if len(pending) > ahead:
                drawn = pending.popleft().result()
                yield drawn[0] if outputs is None else drawn
        while pending:
            drawn = pending.popleft().result()
            yield drawn[0] if outputs is None else drawn
        if failure is not None:
            raise failure

    def _submit(self, camera: Camera, outputs: list[str]) -> _native.Pending:
        size = self.size
        if size is not None and size != (camera.width, camera.height):
            camera = camera.resized(*size)
        return self._engine.submit(camera, self.background, outputs)

    @property
    def scene(self) -> Scene:
        """The scene; `show` changes it."""
        return self._scene

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
        with self._changing:
            former, self._set = self._set, {**self._set, **params}
            try:
                self._engine.set_graph(self._pipeline, texts(self._set), self._size())
            except BaseException:
                self._set = former
                raise

    def use(self, pipeline: str | os.PathLike[str], params: Mapping[str, Setting] | None = None) -> None:
        """Draws with another graph from now on; `params` replace all earlier parameters.

        Raises:
            GraphError: the graph cannot be read, or a parameter is invalid. Nothing is changed then.
        """
        name, wanted = graph_name(pipeline), dict(params or {})
        with self._changing:
            if (name, wanted) == (self._pipeline, self._set):
                return
            self._engine.set_graph(name, texts(wanted), self._size())
            self._pipeline, self._set = name, wanted

    def show(self, scene: Scene) -> None:
        """Draws another scene from now on.

        A scene with another number of splats compiles most shaders again. For scenes that follow each other, pad the arrays to one number
        with splats of opacity 0, which change no pixel.
        """
        with self._changing:
            self._engine.set_scene(scene)
            self._scene = scene

    @property
    def plan(self) -> Plan:
        """The plan for the device, the scene, `size` (960 x 540 without one), and the outputs of the last picture that this graph drew."""
        return self._engine.plan(self._size())

    @property
    def stats(self) -> dict[str, Any] | None:
        """Times (in ms), counts and memory (in bytes) of the last returned picture, as in `splatgraph render --json`; None before it."""
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


def _names(outputs: str | Iterable[str] | None) -> list[str]:
    return [outputs] if isinstance(outputs, str) else list(outputs or ())


def _color(color: Any) -> tuple[float, float, float]:
    try:
        red, green, blue = found = tuple(map(float, color))
    except (TypeError, ValueError):
        raise TypeError(f"background: expected three numbers, red, green and blue, found {color!r}") from None
    if not all(map(math.isfinite, found)):
        raise ValueError(f"background: expected finite numbers, found {color!r}")
    # Other values above 1 may mark the background, but three whole numbers up to 255 are probably 8-bit values.
    if max(found) >= 2 and all(value.is_integer() and 0 <= value <= 255 for value in found):
        raise ValueError(f"background: expected values from 0 to 1 (255 is 1), found {color!r}")
    return red, green, blue


def _tuple(values: list[Any] | None) -> tuple[Any, ...] | None:
    return None if values is None else tuple(values)


@atexit.register
def _close_all() -> None:
    # A thread that draws while the process ends would use an unloaded driver.
    for renderer in list(_open):
        renderer.close()
