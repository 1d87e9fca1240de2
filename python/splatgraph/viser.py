"""Shows a scene in browsers, drawn on this machine: `python -m splatgraph.viser scene.ply`, or a `Viewer` in a notebook.

A browser sends its camera and receives pictures: small ones while the camera moves, and one in full size when it stops. `render_fn` makes
the render function for viewers with viser's interface, such as nerfview's.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import socket
import sys
import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from . import _native
from ._native import Camera, GraphError, Scene
from ._renderer import Param, Renderer, Setting

try:
    import viser
    from viser import transforms
except ImportError:
    raise (SystemExit if __name__ == "__main__" else ImportError)("splatgraph.viser needs viser: pip install viser") from None

#: Seconds without a new camera before a picture in full size is drawn.
REST = 0.15


def camera(c2w: np.ndarray, fov: float, size: tuple[int, int]) -> Camera:
    """Converts viser's camera parameters to a camera.

    Args:
        c2w: camera to world with x to the right, y down and z forward, [4, 4].
        fov: vertical field of view, in radians.
        size: width and height of the picture, in pixels.
    """
    width, height = size
    focal = 0.5 * height / np.tan(0.5 * fov)
    K = np.array([[focal, 0.0, 0.5 * width], [0.0, focal, 0.5 * height], [0.0, 0.0, 1.0]])
    return Camera(np.linalg.inv(c2w), K, width, height)


def picture_8_bits(picture: np.ndarray) -> np.ndarray:
    """Rounds display-encoded colours to 8 bits, uint8 [height, width, 3]."""
    return (np.clip(picture, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def render_fn(renderer: Renderer) -> Callable[[Any, Any], np.ndarray]:
    """Returns the function `(camera_state, size) -> uint8 [height, width, 3]` that draws with a renderer.

    `camera_state` has `c2w` [4, 4] and `fov` in radians. `size` is a width and a height in pixels, or an object with `viewer_width` and
    `viewer_height`, as in nerfview.
    """

    def draw(camera_state: Any, size: Any) -> np.ndarray:
        if hasattr(size, "viewer_width"):
            size = (size.viewer_width, size.viewer_height)
        wanted = camera(np.asarray(camera_state.c2w, np.float64), float(camera_state.fov), (int(size[0]), int(size[1])))
        return picture_8_bits(renderer.render(wanted))

    return draw


class Viewer:
    """A server that draws a scene for browsers. The panel has the graph's parameters.

    Args:
        scene: the scene.
        pipeline: name of a built-in graph, or a path.
        params: values of the graph's parameters.
        host: address to listen on; by default, only programs on this machine can connect.
        port: port to listen on; if it is in use, the next free one.
        largest: maximum width and height of pictures, in pixels.
        device: a part of the device's name, or its index in `splatgraph devices`.

    Raises:
        ValueError: `host` is no address of this machine, or `port` is none of 0 to 65535.
        GraphError: the graph has errors.
        DeviceError: no suitable device was found.
    """

    def __init__(
        self,
        scene: Scene,
        pipeline: str | os.PathLike[str] = "auto",
        params: Mapping[str, Setting] | None = None,
        *,
        host: str = "127.0.0.1",
        port: int = 8080,
        largest: int = 2048,
        device: str | int | None = None,
    ) -> None:
        _check_address(host, port)
        self.renderer = Renderer(scene, pipeline, params, device=device)
        # viser prints a banner.
        with contextlib.redirect_stdout(io.StringIO()):
            self.server = viser.ViserServer(host, port, verbose=False)
        self._largest = largest
        self._closed = threading.Event()
        self._start = Camera.framing(scene)
        # The viewer's up direction is the framing camera's.
        self.server.scene.set_up_direction(tuple(-self._start.viewmat[1, :3]))
        self._views: dict[int, _View] = {}
        with self.server.gui.add_folder("Parameters"):
            for param in self.renderer.params.values():
                self._control(param)
        self.server.on_client_connect(self._connect)
        self.server.on_client_disconnect(self._disconnect)

    @property
    def url(self) -> str:
        """The page's address."""
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    def close(self) -> None:
        """Ends the server and closes the device."""
        self._closed.set()
        for view in list(self._views.values()):
            view.end()
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()
        self.renderer.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.url}" style="width:100%;height:600px;border:0"></iframe>'

    def redraw(self) -> None:
        """Draws all browsers' pictures again."""
        for view in list(self._views.values()):
            view.ask()

    def _connect(self, client: Any) -> None:
        c2w = np.linalg.inv(self._start.viewmat)
        client.camera.wxyz = transforms.SO3.from_matrix(c2w[:3, :3]).wxyz
        client.camera.position = c2w[:3, 3]
        self._views[client.client_id] = _View(client, render_fn(self.renderer), self._largest)

    def _disconnect(self, client: Any) -> None:
        view = self._views.pop(client.client_id, None)
        if view is not None:
            view.end()

    def _control(self, param: Param) -> None:
        gui, label, hint = self.server.gui, param.label or param.name, param.help or None
        control: Any
        if param.kind == "bool":
            control = gui.add_checkbox(label, initial_value=bool(param.value), hint=hint)
        elif param.choices is not None:
            control = gui.add_dropdown(label, param.choices, initial_value=str(param.value), hint=hint)
        elif param.range is not None and isinstance(param.value, (int, float)):
            low, high = param.range
            step = 1 if param.kind == "int" else param.step or (high - low) / 1000
            # Not a slider, which allows only multiples of its step.
            control = gui.add_number(label, initial_value=param.value, min=low, max=high, step=step, hint=hint)
        else:
            return

        @control.on_update
        def changed(event: Any) -> None:
            try:
                self.renderer.set(**{param.name: control.value})
            except GraphError as error:
                if event.client is not None:
                    event.client.add_notification(label, str(error), color="red")
            self.redraw()


class _View:
    """Draws the pictures of one browser on its own thread, always for the latest camera."""

    def __init__(self, client: Any, draw: Callable[[Any, Any], np.ndarray], largest: int) -> None:
        self._client, self._draw, self._largest = client, draw, largest
        self._asked, self._ended = threading.Event(), False
        client.camera.on_update(lambda _: self.ask())
        self.ask()
        threading.Thread(target=self._serve, name="splatgraph.viser", daemon=True).start()

    def ask(self) -> None:
        self._asked.set()

    def end(self) -> None:
        self._ended = True
        self._asked.set()

    def _serve(self) -> None:
        while not self._ended:
            moves = self._asked.wait(REST)
            self._asked.clear()
            while moves and not self._ended:
                self._show(0.5, 70)
                moves = self._asked.wait(REST)
                self._asked.clear()
                if not moves:
                    self._show(1.0, 95)

    def _show(self, share: float, quality: int) -> None:
        """Draws the current camera at a share of the browser's size, and sends it as JPEG. Notifies the browser of an error."""
        own = self._client.camera
        width, height = own.image_width, own.image_height
        scale = share * min(1.0, self._largest / max(width, height, 1))
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        c2w = np.eye(4)
        c2w[:3, :3], c2w[:3, 3] = transforms.SO3(own.wxyz).as_matrix(), own.position
        try:
            picture = self._draw(_State(c2w, own.fov), size)
        except (_native.Error, ValueError) as error:
            if not self._ended:
                self._client.add_notification("No picture", str(error), color="red")
            return
        self._client.scene.set_background_image(picture, format="jpeg", jpeg_quality=quality)


class _State:
    """A camera state as in nerfview."""

    def __init__(self, c2w: np.ndarray, fov: float) -> None:
        self.c2w, self.fov = c2w, fov


def _check_address(host: str, port: int) -> None:
    """Fails if no server can listen there: viser waits forever for one that cannot start."""
    if not 0 <= port < 1 << 16:
        raise ValueError(f"port: expected 0 to 65535, found {port}")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host or None, 0, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(address)
    except OSError as error:
        raise ValueError(f"host: expected an address of this machine, found {host!r} ({error})") from None


def main(arguments: list[str] | None = None) -> int:
    """Runs a command line, until Ctrl-C. Returns the exit code: 1 if the scene or the viewer cannot be opened."""
    parser = argparse.ArgumentParser(prog="python -m splatgraph.viser", description="Show a scene in browsers, drawn on this machine.")
    parser.add_argument("scene", metavar="SCENE", help="a scene file")
    parser.add_argument("-p", "--pipeline", default="auto", metavar="NAME", help="the graph: the name of a built-in one, or a path")
    parser.add_argument("-s", "--set", action="append", default=[], metavar="NAME=VALUE", help="set a parameter; may be repeated")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on; 0.0.0.0 accepts other machines [default: 127.0.0.1]")
    parser.add_argument("--port", type=int, default=8080, help="port to listen on, or the next free one [default: 8080]")
    parser.add_argument("--device", help="a part of the device's name, or its index in `splatgraph devices`")
    options = parser.parse_args(arguments)
    params = dict(setting.partition("=")[::2] for setting in options.set)
    try:
        scene = Scene.load(options.scene)
        viewer = Viewer(scene, options.pipeline, params, host=options.host, port=options.port, device=options.device)
    except (_native.Error, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    try:
        with viewer:
            print(f"{options.scene}: {len(scene)} splats at {viewer.url}; Ctrl-C ends", flush=True)
            threading.Event().wait()
    except KeyboardInterrupt:
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
