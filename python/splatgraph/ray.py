"""Draws and measures the views of scenes on many devices, with Ray: `python -m splatgraph.ray render scene.ply -c cameras.json -o out/`.

Each device gets an actor, which loads a scene once and draws batches of its views with the command's own code (`_native.Job`). Results are
files in a folder that all nodes share. A view with complete results is skipped, so any run can be interrupted and resumed.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import json
import logging
import os
import pathlib
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from . import _native

try:
    import ray
except ImportError:
    raise (SystemExit if __name__ == "__main__" else ImportError)("splatgraph.ray needs Ray: pip install ray") from None

#: Attempts per view, and consecutive failures to open a scene or to start a worker, before giving up.
TRIES = 3
#: Batches assigned to a worker: one is drawn, the next one waits there.
AHEAD = 2
#: Maximum number of views in a batch, unless `--batch` sets the number.
LARGEST = 64
#: Seconds between lines of progress if standard error is not a terminal.
EVERY = 10.0


class Worker:
    """The actor that draws views on the device assigned by Ray."""

    def __init__(self, folder: str) -> None:
        # Paths are relative to the driver's folder.
        os.chdir(folder)
        self._device = _device(ray.get_gpu_ids())
        self._arguments: list[str] = []
        self._job: _native.Job | None = None

    def hello(self) -> str:
        """Returns the process and its node, once the worker has started."""
        return f"pid {os.getpid()} on {ray.util.get_node_ip_address()}"

    def run(self, arguments: list[str], views: list[int]) -> tuple[list[int], list[int], list[tuple[int, str]]]:
        """Draws views of a command: see `_native.Job.run`. The scene stays loaded for the next call with the same arguments."""
        if self._job is None or self._arguments != arguments:
            if self._job is not None:
                self._job.close()
            self._job = _native.Job([*arguments, *self._device])
            self._arguments = arguments
        return self._job.run(views)


def _device(ids: list[Any]) -> list[str]:
    """Returns the option that names a worker's device; empty if Ray assigned no GPU."""
    if not ids:
        return []
    command = [sys.executable, "-m", "splatgraph", "devices", "--json"]
    found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    # Vulkan ignores CUDA_VISIBLE_DEVICES. Assumes that Ray and Vulkan list the GPUs of a machine in the same order.
    gpus = [one for one in found if one["kind"] in ("discrete", "integrated", "virtual") and not one["unfit"]]
    index = int(ids[0])
    if index >= len(gpus):
        raise RuntimeError(f"expected GPU {index} among Vulkan's devices, found {len(gpus)} GPUs")
    return ["--device", str(gpus[index]["index"])]


@dataclasses.dataclass
class Scene:
    """A scene, its views, and the batches that no worker has yet."""

    name: str
    arguments: list[str]
    folder: str
    views: list[str]
    #: Views in batches; the leftmost batch is next.
    todo: collections.deque[list[int]]
    tries: collections.Counter[int] = dataclasses.field(default_factory=collections.Counter)
    #: Reasons for the failed attempts to open the scene since the last success.
    closed: list[str] = dataclasses.field(default_factory=list)


@dataclasses.dataclass
class Running:
    """A batch assigned to a worker."""

    scene: Scene
    views: list[int]
    worker: Any


class Run:
    """A run of a command on a cluster."""

    def __init__(self, scenes: list[Scene], start: Callable[[], Any], capacity: Callable[[], int], batch: int) -> None:
        self.scenes = scenes
        self.start, self.capacity, self.batch = start, capacity, batch
        self.all = sum(len(scene.views) for scene in scenes)
        self.done = self.kept = 0
        #: Failed views: scene, view, reason.
        self.failed: list[tuple[str, str, str]] = []
        #: Workers by the references that become ready once they have started.
        self.starting: dict[Any, Any] = {}
        #: The batches of each started worker, by their references.
        self.workers: dict[Any, dict[Any, Running]] = {}
        self.names: dict[Any, str] = {}
        self.bad_starts: list[str] = []
        self.begun = time.monotonic()
        self._told = 0.0

    def drive(self) -> None:
        """Draws all views."""
        for scene in self.scenes:
            views = [view for batch in scene.todo for view in batch]
            scene.todo = collections.deque(views[i : i + self.batch] for i in range(0, len(views), self.batch))
        while self.all > self.done + self.kept + len(self.failed):
            self._top_up()
            self._assign()
            batches = [reference for own in self.workers.values() for reference in own]
            references = [*self.starting, *batches]
            ready, _ = ray.wait(references, timeout=1.0) if references else ([], [])
            for reference in ready:
                if reference in self.starting:
                    self._started(reference)
                else:
                    self._finished(reference)
            if not references:
                time.sleep(0.2)
            self._tell()
        self._tell(last=True)

    def _top_up(self) -> None:
        """Starts workers if the cluster has room and there are batches for them."""
        waiting = sum(len(scene.todo) for scene in self.scenes)
        busy = sum(bool(own) for own in self.workers.values())
        wanted = min(self.capacity(), busy + waiting)
        for _ in range(wanted - len(self.workers) - len(self.starting)):
            worker = self.start()
            self.starting[worker.hello.remote()] = worker

    def _started(self, reference: Any) -> None:
        worker = self.starting.pop(reference)
        try:
            self.names[worker] = ray.get(reference)
        except ray.exceptions.RayError as error:
            self.bad_starts.append(_reason(error))
            if len(self.bad_starts) >= TRIES and not self.workers:
                raise SystemExit(f"error: no worker starts: {self.bad_starts[-1]}") from None
            return
        self.bad_starts.clear()
        self.workers[worker] = {}
        _say(f"worker {len(self.names)} ({self.names[worker]}) has started")

    def _assign(self) -> None:
        """Assigns batches to workers: of each worker's current scene first, then of the scene with the most batches left."""
        for depth in range(1, AHEAD + 1):
            for worker, own in self.workers.items():
                left = [scene for scene in self.scenes if scene.todo]
                if not left:
                    return
                if len(own) >= depth:
                    continue
                last = next(reversed(own.values())).scene if own else None
                scene = last if last in left else max(left, key=lambda scene: len(scene.todo))
                views = scene.todo.popleft()
                own[worker.run.remote(scene.arguments, views)] = Running(scene, views, worker)

    def _finished(self, reference: Any) -> None:
        worker = next((worker for worker, own in self.workers.items() if reference in own), None)
        if worker is None:
            # Its worker is gone, and the batch was reassigned.
            return
        running = self.workers[worker][reference]
        scene = running.scene
        try:
            done, kept, failed = ray.get(reference)
        except ray.exceptions.RayTaskError as error:
            # The scene cannot be opened, or the device is gone.
            scene.closed.append(_reason(error))
            self._bury(worker, None)
            ray.kill(worker)
            if len(scene.closed) >= TRIES:
                self._give_up(scene, scene.closed[-1])
            return
        except ray.exceptions.RayError as error:
            self._bury(worker, f"the worker died: {_reason(error)}")
            return
        del self.workers[worker][reference]
        scene.closed.clear()
        self.done += len(done)
        self.kept += len(kept)
        for view, reason in failed:
            self._retry(scene, view, reason)

    def _bury(self, worker: Any, reason: str | None) -> None:
        """Removes a worker and reassigns its batches. `reason` is why it died; None if its task failed, as if the scene cannot be opened.

        If it died in a batch of one view, this counts as an attempt of the view.
        """
        own = self.workers.pop(worker)
        begun = next(iter(own))
        lost = sum(len(running.views) for running in own.values())
        if reason is not None:
            _say(f"a worker ({self.names[worker]}) died: {lost} views are reassigned")
        for other, running in own.items():
            if reason is not None and other == begun and len(running.views) == 1:
                self._retry(running.scene, running.views[0], reason)
            elif reason is not None and other == begun:
                # Batches of one view isolate a view that kills workers. Views that were written are not drawn again.
                running.scene.todo.extendleft([view] for view in reversed(running.views))
            else:
                running.scene.todo.appendleft(running.views)

    def _retry(self, scene: Scene, view: int, reason: str) -> None:
        scene.tries[view] += 1
        if scene.tries[view] < TRIES:
            scene.todo.append([view])
        else:
            self.failed.append((scene.name, scene.views[view], reason))

    def _give_up(self, scene: Scene, reason: str) -> None:
        """Fails the remaining views of a scene that cannot be opened."""
        for batch in scene.todo:
            self.failed.extend((scene.name, scene.views[view], reason) for view in batch)
        scene.todo.clear()

    def _tell(self, last: bool = False) -> None:
        now = time.monotonic()
        terminal = sys.stderr.isatty()
        if not last and now - self._told < (0.5 if terminal else EVERY):
            return
        self._told = now
        rate = self.done / max(now - self.begun, 1e-9)
        left = self.all - self.done - self.kept - len(self.failed)
        text = f"{self.done + self.kept} of {self.all} views"
        if self.kept:
            text += f" ({self.kept} already there)"
        text += f", {rate:.1f} per second"
        if left and self.done:
            text += f", {_duration(left / rate)} left"
        text += f", {len(self.workers)} workers"
        if terminal:
            print(f"\r\x1b[K{text}", end="\n" if last else "", file=sys.stderr, flush=True)
        else:
            _say(text)


def _say(text: str) -> None:
    line = "\r\x1b[K" if sys.stderr.isatty() else ""
    print(f"{line}splatgraph.ray: {text}", file=sys.stderr, flush=True)


def _duration(seconds: float) -> str:
    hours, rest = divmod(round(seconds), 3600)
    return f"{hours} h {rest // 60} min" if hours else f"{rest // 60} min {rest % 60} s" if rest >= 60 else f"{rest} s"


def _reason(error: BaseException) -> str:
    cause = getattr(error, "cause", None) or error
    return str(cause).strip().splitlines()[0] if str(cause).strip() else type(cause).__name__


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m splatgraph.ray",
        description="Draw or measure the views of scenes on all devices of a Ray cluster; without a cluster, on this machine's.",
        epilog="Other options are the command's own, after the scenes, such as --size, --set or --format: see `splatgraph COMMAND --help`.",
        allow_abbrev=False,
    )
    parser.add_argument("command", choices=["render", "trade", "sweep", "evaluate"], help="the command")
    parser.add_argument("scenes", nargs="+", metavar="SCENE", help="scene files; each is drawn separately")
    parser.add_argument(
        "-c", "--cameras", nargs="+", required=True, metavar="CAMERAS", help="cameras of all scenes, or one file or folder for each"
    )
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="DIR",
        help="folder of the results, shared by all nodes; several scenes get a subfolder each",
    )
    parser.add_argument("--address", help="address of a cluster, or `auto`; by default, Ray is started on this machine")
    parser.add_argument("--cpus", type=int, default=4, metavar="N", help="CPUs per worker if the cluster has no GPUs [default: 4]")
    parser.add_argument(
        "--batch", type=int, metavar="N", help=f"views per batch [default: a quarter of a worker's share, at most {LARGEST}]"
    )
    return parser


def _folders(scenes: list[str], output: str) -> list[str]:
    """Returns a folder for each scene: the output for one; for several, a subfolder with as much of the path as distinguishes them."""
    if len(scenes) == 1:
        return [output]
    paths = [pathlib.Path(os.path.abspath(scene)) for scene in scenes]
    names: list[pathlib.Path] = [pathlib.Path(path.stem) for path in paths]
    if len(set(names)) < len(names):
        root = os.path.commonpath([path.parent for path in paths])
        names = [path.relative_to(root).with_suffix("") for path in paths]
    if len(set(names)) < len(names):
        raise SystemExit("error: expected scenes with different paths, found two of one name")
    return [str(pathlib.Path(output) / name) for name in names]


def _scenes(options: argparse.Namespace, more: list[str]) -> Iterator[Scene]:
    """Makes the work of each scene. A command-line error ends the program."""
    cameras = options.cameras * len(options.scenes) if len(options.cameras) == 1 else options.cameras
    if len(cameras) != len(options.scenes):
        raise SystemExit(f"error: expected cameras of all scenes, or for each of {len(options.scenes)} scenes, found {len(cameras)}")
    for scene, own, folder in zip(options.scenes, cameras, _folders(options.scenes, options.output)):
        arguments = [options.command, scene, "-c", own, "-o", folder, *more]
        try:
            views = _native.Job(arguments).views
        except ValueError as error:
            raise SystemExit(f"error: {scene}: {str(error).removeprefix('error: ').strip()}") from None
        yield Scene(scene, arguments, folder, views, collections.deque([list(range(len(views)))]))


def main(arguments: list[str] | None = None) -> int:
    """Runs a command line. Returns the exit code: 1 if a view failed or is missing, or 130 after Ctrl-C."""
    options, more = _parser().parse_known_args(arguments)
    if options.cpus < 1 or (options.batch is not None and options.batch < 1):
        raise SystemExit("error: --cpus, --batch: expected numbers above 0")
    scenes = list(_scenes(options, more))
    # Workers' output is not forwarded: this process reports their progress.
    ray.init(
        address=options.address, log_to_driver=False, logging_level=logging.ERROR, include_dashboard=False if not options.address else None
    )
    try:
        run = _run(scenes, options)
        try:
            run.drive()
        except KeyboardInterrupt:
            _say("interrupted; the same command resumes here")
            return 130
        for name, view, reason in run.failed:
            _say(f"{name}: {view} failed {TRIES} times: {reason}")
    finally:
        ray.shutdown()
    code = 0
    for scene in scenes:
        code = max(code, _native.run(["splatgraph", "merge", scene.folder]) if os.path.isdir(scene.folder) else 1)
    return 1 if run.failed else code


def _run(scenes: list[Scene], options: argparse.Namespace) -> Run:
    """Chooses the workers: one per GPU of the cluster, or per group of CPUs if it has no GPU."""
    has_gpus = ray.cluster_resources().get("GPU", 0) >= 1
    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    cpus = min(options.cpus, int(max(node.get("CPU", 1) for node in nodes)))
    # Each CPU worker is limited to its share; otherwise each would use all CPUs.
    threads = {name: str(cpus) for name in ("RAYON_NUM_THREADS", "LP_NUM_THREADS")}
    resources = {"num_gpus": 1, "num_cpus": 1} if has_gpus else {"num_cpus": cpus, "runtime_env": {"env_vars": threads}}
    actor = ray.remote(Worker).options(max_restarts=0, max_task_retries=0, scheduling_strategy="SPREAD", **resources)

    def capacity() -> int:
        alive = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        return sum(int(node.get("GPU", 0)) if has_gpus else int(node.get("CPU", 0)) // cpus for node in alive)

    all_views = sum(len(scene.views) for scene in scenes)
    batch = options.batch or max(1, min(LARGEST, all_views // (4 * max(capacity(), 1))))
    return Run(scenes, lambda: actor.remote(os.getcwd()), capacity, batch)


if __name__ == "__main__":
    sys.exit(main())
