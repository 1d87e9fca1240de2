"""The extension module: see the package's classes and functions, which wrap it."""

import os
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

#: Three coordinates.
_Vector: TypeAlias = Sequence[float] | NDArray[Any]

__version__: str

class Error(RuntimeError):
    """Base class of splatgraph's errors."""

class SceneError(Error):
    """A scene or camera file cannot be read or written, or a scene has no splats."""

class DeviceError(Error):
    """No suitable device was found, or the device failed."""

class GraphError(Error):
    """A graph or its shaders have errors."""

    #: Path of the file with the first error, as it was given; "params" or "pipeline" if it is in that argument.
    file: str
    #: Line of the first error, from 1.
    line: int
    #: Column of the first error, from 1, in characters.
    column: int
    #: All errors, rendered with the source text.
    text: str
    #: The errors, each with file, line, column, end_line, end_column, severity, message, label, help.
    errors: list[dict[str, Any]]

@final
class Scene:
    """A 3D Gaussian Splatting scene: splats with activated opacities and scales. Scenes are immutable; renderers share them."""

    @staticmethod
    def load(path: str | os.PathLike[str], *, properties: Sequence[str] = ()) -> Scene: ...
    @staticmethod
    def from_arrays(means: Any, quats: Any, scales: Any, opacities: Any, sh: Any, *, properties: Mapping[str, Any] | None = None, like: Scene | None = None, _checked: bool = ...) -> Scene: ...
    def save(self, path: str | os.PathLike[str]) -> None: ...
    @property
    def means(self) -> NDArray[np.float32]: ...
    @property
    def quats(self) -> NDArray[np.float32]: ...
    @property
    def scales(self) -> NDArray[np.float32]: ...
    @property
    def opacities(self) -> NDArray[np.float32]: ...
    @property
    def sh(self) -> NDArray[np.float32]: ...
    @property
    def properties(self) -> dict[str, NDArray[np.float32]]: ...
    @property
    def sh_degree(self) -> int: ...
    @property
    def offset(self) -> list[float]: ...
    @property
    def tags(self) -> dict[str, str]: ...
    @property
    def bounds(self) -> tuple[list[float], list[float]]: ...
    @property
    def dropped(self) -> int: ...
    def __len__(self) -> int: ...

@final
class Camera:
    """A camera with x to the right, y down and z forward."""

    def __new__(cls, viewmat: Any, K: Any, width: int, height: int, name: str = "", projection: str = "pinhole") -> Camera: ...
    @staticmethod
    def look_at(
        eye: _Vector,
        target: _Vector,
        fov: float = 60.0,
        size: tuple[int, int] = (960, 540),
        up: _Vector = (0.0, -1.0, 0.0),
        name: str = "",
    ) -> Camera: ...
    @staticmethod
    def framing(scene: Scene, size: tuple[int, int] = (960, 540)) -> Camera: ...
    @staticmethod
    def load(path: str | os.PathLike[str], ignore_distortion: bool = False) -> list[Camera]: ...
    @staticmethod
    def save(cameras: Sequence[Camera], path: str | os.PathLike[str]) -> None: ...
    @staticmethod
    def path(scene: Scene, keys: Sequence[Camera], count: int, closed: bool = False) -> list[Camera]: ...
    def resized(self, width: int, height: int) -> Camera: ...
    @property
    def viewmat(self) -> NDArray[np.float64]: ...
    @property
    def K(self) -> NDArray[np.float64]: ...
    @property
    def position(self) -> list[float]: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def projection(self) -> str: ...
    @property
    def name(self) -> str: ...

@final
class Plan:
    """The plan of a graph: passes in order, their dependencies, memory and barriers."""

    @property
    def name(self) -> str: ...
    @property
    def passes(self) -> list[str]: ...
    def to_json(self) -> str: ...
    def html(self) -> str: ...
    def dot(self) -> str: ...
    def _repr_html_(self) -> str: ...

@final
class Pending:
    """A requested picture."""

    def result(self) -> tuple[NDArray[np.float32], dict[str, NDArray[Any]]]: ...

@final
class Engine:
    """A device that draws a scene with a graph. Any thread may use it."""

    def __new__(
        cls,
        scene: Scene,
        pipeline: str,
        params: list[tuple[str, str]],
        *,
        backend: str | None = ...,
        device: str | None = ...,
        validation: bool = ...,
    ) -> Engine: ...
    def submit(self, camera: Camera, background: tuple[float, float, float] = ..., outputs: list[str] = ...) -> Pending: ...
    def set_graph(self, pipeline: str, params: list[tuple[str, str]], size: tuple[int, int]) -> None: ...
    def set_scene(self, scene: Scene) -> None: ...
    def params(self, size: tuple[int, int] = ...) -> list[dict[str, Any]]: ...
    def plan(self, size: tuple[int, int] = ...) -> Plan: ...
    @property
    def stats(self) -> dict[str, Any] | None: ...
    @property
    def device(self) -> dict[str, Any]: ...
    def close(self) -> None: ...

@final
class Job:
    """The views of a command line, for the workers of a cluster."""

    def __new__(cls, arguments: list[str]) -> Job: ...
    @property
    def views(self) -> list[str]: ...
    def run(self, views: list[int]) -> tuple[list[int], list[int], list[tuple[int, str]]]: ...
    def close(self) -> None: ...

def plan(
    pipeline: str,
    params: list[tuple[str, str]],
    scene: Scene | None = ...,
    size: tuple[int, int] = ...,
    subgroup_size: int = ...,
) -> Plan: ...
def trade(
    scene: Scene,
    cameras: list[Camera],
    pipeline: str,
    params: list[tuple[str, str]],
    graphs: list[str],
    only: list[str],
    truths: list[Any] | None,
    file: str | os.PathLike[str] | None,
    effort: dict[str, Any],
    progress: Any = ...,
) -> dict[str, Any]: ...
def advise(
    scene: Scene,
    cameras: list[Camera],
    pipeline: str,
    params: list[tuple[str, str]],
    budget: tuple[float | None, float | None],
    errors: int,
    effort: dict[str, Any],
    progress: Any = ...,
) -> dict[str, Any]: ...
def compare(a: Any, b: Any) -> dict[str, Any]: ...
def png(picture: Any) -> bytes: ...
def run(arguments: list[str]) -> int: ...
def _join_studies() -> None: ...
def _set_process(python: str, module: str) -> None: ...
