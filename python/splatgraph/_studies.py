"""Measures what settings save and cost, and searches for the best within a budget."""

from __future__ import annotations

import atexit
import dataclasses
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from . import _native
from ._native import Camera, Scene
from ._renderer import Setting, graph_name, texts

#: Called with the task, the number of steps done, the total, and the name of the next step. An exception ends the study.
Progress = Callable[[str, int, int, str], object]


@dataclasses.dataclass(frozen=True)
class Share:
    """A share of the exact settings' time; over several views, the mean of their shares."""

    #: Median over the frames of a frame's time divided by the time of the exact settings' frame right before it.
    median: float
    #: 99 % confidence interval of the median, widened to the noise floor; None with fewer than 8 frames in all rounds, or without a
    #: noise floor.
    range: tuple[float, float] | None


@dataclasses.dataclass(frozen=True)
class Line:
    """A setting of a ledger, over all views."""

    #: "exact", "defaults", "key_bits = 16", "preset key16", "graph mine.ron".
    setting: str
    #: Mean time of a frame on the device, in milliseconds; None without timestamps.
    gpu_ms: float | None
    #: Largest spread of a view's time, in milliseconds; None without timestamps, or with one round.
    spread_ms: float | None
    #: Share of the exact settings' time; None without timestamps.
    share: Share | None
    #: PSNR of the mean squared error of all views, in dB; infinite for equal pictures.
    psnr_db: float
    #: PSNR over the pixels that a splat covers, in dB; infinite for equal pictures, or without such pixels.
    covered_psnr_db: float
    #: Lowest SSIM of a view; None for pictures below 11 x 11 pixels.
    ssim: float | None
    #: Mean of NVIDIA's FLIP, 0 for equal pictures.
    flip: float
    #: Largest difference of a channel.
    worst: float
    #: Mean share of pixels that are off by more than 1/255, 0 to 1.
    off: float
    #: Pairs of visible splats in the wrong order, in all views; None if it is unknown for a view, as without an order.
    inversions: int | None
    #: Share of the host's frame time during which the device draws, 0 to 1, the lowest of the views; None without timestamps.
    busy: float | None
    #: Device memory in bytes, the largest of the views.
    gpu_bytes: int
    #: Each phase: a name, the mean of the views' milliseconds, and the largest spread of a view, None with one round.
    phases: tuple[tuple[str, float, float | None], ...]
    #: Names of the settings with the same plan, which are not measured.
    same_plan: tuple[str, ...]
    #: "best" is on the Pareto front, "beaten" is not; "likely" and "unlikely" are too noisy to tell; "hidden": it reads the previous frame.
    mark: Literal["best", "likely", "unlikely", "beaten", "hidden"]


@dataclasses.dataclass(frozen=True)
class Ledger:
    """What each setting of a graph saves and costs. `str(ledger)` is the command line's table."""

    #: One for each setting that is not in `failed`.
    lines: tuple[Line, ...]
    #: Names of settings that cannot be drawn, or are not measured in every view, with the reason.
    failed: dict[str, str]
    #: Every setting in every view: dicts as in the command line's ledger.json. An infinite PSNR is "inf", as JSON has no infinity.
    rows: tuple[dict[str, Any], ...]
    #: The device and its driver.
    device: str
    #: Notes on what is too noisy to tell, or not measured.
    notes: tuple[str, ...]
    #: All lines as CSV, with all digits.
    csv: str = dataclasses.field(repr=False)
    #: A page with plots, for any browser.
    html: str = dataclasses.field(repr=False)
    _table: str = dataclasses.field(repr=False)

    def __str__(self) -> str:
        return self._table

    def __iter__(self) -> Iterator[Line]:
        return iter(self.lines)

    def __len__(self) -> int:
        return len(self.lines)

    def __getitem__(self, setting: str) -> Line:
        """Returns the line of a setting."""
        for line in self.lines:
            if line.setting == setting:
                return line
        raise KeyError(f"{setting}; available: {', '.join(line.setting for line in self.lines)}")


@dataclasses.dataclass(frozen=True)
class Tried:
    """A setting that a search measured."""

    name: str
    #: The graph, and its parameters that are not the defaults: `Renderer(scene, tried.pipeline, tried.params)` draws it.
    pipeline: str
    params: dict[str, str]
    #: PSNR of each view against the exact renderer, in dB; infinite for equal pictures.
    psnr_db: tuple[float, ...]
    #: Mean time of a frame on the device, in milliseconds; None without timestamps.
    gpu_ms: float | None
    #: Share of the exact settings' time; None without timestamps.
    share: Share | None


@dataclasses.dataclass(frozen=True)
class Advice:
    """What a scene needs, and the best setting within a budget. `str(advice)` describes the scene."""

    #: The best setting within the budget; None without a budget, or if no setting is within it with certainty.
    best: Tried | None
    #: All measured settings.
    tried: tuple[Tried, ...]
    #: Settings that may be better: too noisy to tell.
    hidden: tuple[Tried, ...]
    #: Names of settings with a saving within the noise; they were not combined.
    unsure: tuple[str, ...]
    #: Settings that were not measured, each with the reason, such as a plan that equals another's.
    notes: tuple[str, ...]
    #: For each mapping of depth to keys, the number of bits that keeps overlapping splats in order; None if 32 are too few.
    key_bits: dict[str, int | None]
    #: How much each band of harmonics adds to a colour of 0 to 1, root mean square: band 0 first, up to the scene's degree.
    band_rms: tuple[float, ...]
    #: Statistics of the scene, as in the command line's `advise --json`.
    report: dict[str, Any]
    _text: str = dataclasses.field(repr=False)

    def __str__(self) -> str:
        return self._text


def trade(
    scene: Scene,
    cameras: Camera | Iterable[Camera],
    pipeline: str | os.PathLike[str] = "auto",
    params: Mapping[str, Setting] | None = None,
    *,
    graphs: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    only: str | Sequence[str] = (),
    truths: Sequence[Any] | None = None,
    rounds: int = 32,
    frames: int | None = None,
    file: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    backend: str | None = None,
    device: str | int | None = None,
) -> Ledger:
    """Measures what each setting of a graph saves, and what it costs in accuracy, like the command `trade`.

    Each parameter is changed alone, from its exact value; the graph's defaults and all presets are also measured. Frames are
    interleaved with frames of the exact settings, and pictures are compared with the exact renderer's.

    Args:
        scene: the scene.
        cameras: one view, or several, in the size of the pictures.
        pipeline: the graph whose parameters are changed.
        params: values that parameters have in every setting.
        graphs: other graphs to measure with their defaults, besides the built-in ones: a file or a name, or several.
        only: a prefix of the names of the settings to measure, such as "key_bits", or several; the exact settings and `graphs` are always
            measured.
        truths: true pictures, one for each camera, display-encoded, as for `compare`; by default, the exact renderer's.
        rounds: maximum number of rounds of frames; with fewer than 8 frames in all rounds, all differences in time count as noise.
        frames: frames per round; by default 1 to 3, from the frame time.
        file: path of a ledger.json, which grows with each row and from which an interrupted study resumes. The result has all of its
            rows. A file that is not a ledger is refused, and so is one whose rows were measured with another scene, graph, truth or effort,
            or with other cameras. A ledger of another device or program is kept under another name, and all settings are measured again.
        progress: called with (task, done, of, step), for example `print`.
        backend: "vulkan" or "metal".
        device: a part of the device's name, or its index in `splatgraph devices`.

    Raises:
        ValueError: `only` matches no setting, `file` is not a ledger of these inputs, or an argument has a wrong shape or range.
        GraphError: the graph has errors.
        DeviceError: no suitable device was found, or the device failed.
    """
    found = _native.trade(
        scene,
        _cameras(cameras),
        graph_name(pipeline),
        texts(params),
        [graph_name(graph) for graph in ([graphs] if isinstance(graphs, (str, os.PathLike)) else graphs)],
        [only] if isinstance(only, str) else list(only),
        None if truths is None else list(truths),
        file,
        _effort(backend, device, rounds, frames),
        progress,
    )
    lines = tuple(
        Line(
            **{
                **line,
                "share": _share(line["share"]),
                "psnr_db": float(line["psnr_db"]),
                "covered_psnr_db": float(line["covered_psnr_db"]),
                "phases": tuple(map(tuple, line["phases"])),
                "same_plan": tuple(line["same_plan"]),
            }
        )
        for line in found["lines"]
    )
    notes = (*found["messages"], *found["notes"])
    return Ledger(lines, dict(found["failed"]), tuple(found["rows"]), found["device"], notes, found["csv"], found["html"], found["table"])


def advise(
    scene: Scene,
    cameras: Camera | Iterable[Camera],
    pipeline: str | os.PathLike[str] = "auto",
    params: Mapping[str, Setting] | None = None,
    *,
    psnr: float | None = None,
    ms: float | None = None,
    errors: int = 0,
    rounds: int = 32,
    frames: int | None = None,
    progress: Progress | None = None,
    backend: str | None = None,
    device: str | int | None = None,
) -> Advice:
    """Finds what a scene needs, and the best setting within a budget, like the command `advise`.

    With `psnr`, finds the fastest setting that reaches it in every view; with `ms` alone, the most accurate one within the time. Without
    either, the scene is described and no device is used.

    Args:
        scene: the scene.
        cameras: one view, or several, in the size of the pictures.
        pipeline: the graph whose parameters are changed; presets are tried unchanged.
        params: values that parameters have in every setting.
        psnr: lowest allowed PSNR of any view against the exact renderer, in dB.
        ms: highest allowed mean time of a frame on the device, in milliseconds.
        errors: pairs of overlapping splats that a depth key may leave in the wrong order in a view.
        rounds, frames, progress, backend, device: see `trade`.

    Raises:
        ValueError: an argument has a wrong shape or range.
        GraphError: the graph has errors.
        DeviceError: no suitable device was found, or the device failed.
    """
    for name, limit in (("psnr", psnr), ("ms", ms)):
        if limit is not None and not 0.0 < limit < math.inf:
            raise ValueError(f"{name}: expected a number above 0, found {limit}")
    found = _native.advise(
        scene,
        _cameras(cameras),
        graph_name(pipeline),
        texts(params),
        (psnr, ms),
        errors,
        _effort(backend, device, rounds, frames),
        progress,
    )
    best = found.get("best")
    return Advice(
        None if best is None else _tried(best),
        tuple(map(_tried, found.get("tried", ()))),
        tuple(map(_tried, found.get("hidden", ()))),
        tuple(found.get("unsure", ())),
        tuple(found["notes"]),
        {need["map"]: need["bits"] for need in found["keys"]},
        tuple(band["rms"] for band in found["bands"]),
        found["report"],
        found["text"],
    )


def _cameras(cameras: Camera | Iterable[Camera]) -> list[Camera]:
    return [cameras] if isinstance(cameras, Camera) else list(cameras)


def _effort(backend: str | None, device: str | int | None, rounds: int, frames: int | None) -> dict[str, Any]:
    for name, count in (("rounds", rounds), ("frames", frames)):
        if not (isinstance(count, (int, np.integer)) and 0 < count < 2**32) and (name, count) != ("frames", None):
            raise ValueError(f"{name}: expected an integer above 0, found {count!r}")
    return {"backend": backend, "device": None if device is None else str(device), "rounds": rounds, "frames": frames}


def _share(found: dict[str, Any] | None) -> Share | None:
    return None if found is None else Share(found["median"], None if found["range"] is None else tuple(found["range"]))


def _tried(found: dict[str, Any]) -> Tried:
    setting = found["setting"]
    psnr = tuple(map(float, found["psnr_db"]))
    return Tried(setting["name"], setting["pipeline"], dict(setting["set"]), psnr, found["gpu_ms"], _share(found["share"]))


# An interrupted study finishes its step, and needs the driver for it.
atexit.register(_native._join_studies)
