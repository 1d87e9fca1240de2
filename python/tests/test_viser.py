"""`splatgraph.viser`: a client that sends its camera gets the picture of it."""

import asyncio
import io
import signal
import subprocess
import sys
import types
import urllib.request

import numpy as np
import pytest
import splatgraph
from conftest import psnr

viser = pytest.importorskip("viser", reason="viser cannot be installed")
import msgspec
import PIL.Image
import websockets
import zstandard
from splatgraph.viser import Viewer, camera, picture_8_bits, render_fn


def test_a_render_function_draws_viewers_cameras(scene):
    renderer = splatgraph.Renderer(scene)
    view = splatgraph.Camera.look_at((0, 0, -2), (0, 0, 4), fov=60, size=(64, 64))
    state = types.SimpleNamespace(c2w=np.linalg.inv(view.viewmat), fov=np.radians(60.0))
    draw = render_fn(renderer)
    drawn = draw(state, (64, 64))
    assert drawn.dtype == np.uint8 and np.array_equal(drawn, picture_8_bits(renderer.render(view)))
    assert np.array_equal(draw(state, types.SimpleNamespace(viewer_width=64, viewer_height=64)), drawn)
    np.testing.assert_allclose(camera(state.c2w, state.fov, (64, 64)).viewmat, view.viewmat, atol=1e-12)


async def shown(viewer, view, width, height, fov, pictures):
    """Connects like a browser, sends a camera, and returns the first `pictures` pictures."""
    address = viewer.url.replace("http", "ws")
    pose = np.linalg.inv(view.viewmat)
    message = {
        "type": "ViewerCameraMessage",
        "wxyz": viser.transforms.SO3.from_matrix(pose[:3, :3]).wxyz.tolist(), "position": pose[:3, 3].tolist(), "fov": float(fov),
        "near": 0.01, "far": 1000.0, "image_height": height, "image_width": width, "look_at": [0.0, 0.0, 4.0], "up_direction": [0.0, -1.0, 0.0],
    }  # fmt: skip
    found = []
    async with websockets.connect(address, subprotocols=[f"viser-v{viser.__version__}"], max_size=None) as socket:
        await socket.send(msgspec.msgpack.encode(message))
        while len(found) < pictures:
            data = await asyncio.wait_for(socket.recv(), 30)
            # Two lengths, then the messages.
            size = int.from_bytes(data[8:16], "little")
            messages = msgspec.msgpack.decode(zstandard.decompress(data[16 : 16 + size]))["messages"]
            files = [one["rgb_data"] for one in messages if one["type"] == "BackgroundImageMessage" and one["rgb_data"]]
            found += [np.asarray(PIL.Image.open(io.BytesIO(file))) for file in files]
            if files:
                await socket.send(msgspec.msgpack.encode(message))
    return found


def test_a_client_gets_the_picture_of_its_camera(scene):
    with Viewer(scene, "splat", port=8190) as viewer:
        assert b"<!doctype html>" in urllib.request.urlopen(viewer.url).read()[:200].lower()
        assert viewer.url in viewer._repr_html_()
        view = splatgraph.Camera.look_at((0, 0, -2), (0, 0, 4), fov=60, size=(80, 80))
        found = asyncio.run(shown(viewer, view, 80, 80, np.radians(60.0), 6))
        expected = picture_8_bits(viewer.renderer.render(view.resized(40, 40)))
        # JPEG is lossy.
        best = max(psnr(picture / 255, expected / 255) for picture in found if picture.shape == expected.shape)
        assert best > 24 and expected.std() > 20, (best, [picture.shape for picture in found])
        controls = {handle.label for handle in viewer.server.gui._gui_input_handle_from_uuid.values()}
        assert len(controls) > 5, controls


def test_the_command_serves_until_ctrl_c_and_tells_of_mistakes(scene, tmp_path):
    scene.save(tmp_path / "scene.ply")
    command = [sys.executable, "-m", "splatgraph.viser"]
    process = subprocess.Popen([*command, "scene.ply", "--port", "8290"], cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    line = process.stdout.readline()
    assert "300 splats at http://127.0.0.1:" in line, line
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 0
    failed = subprocess.run([*command, "nowhere.ply"], cwd=tmp_path, capture_output=True, text=True)
    assert failed.returncode == 1 and failed.stderr.startswith("error: ") and "nowhere.ply" in failed.stderr
    for option, value, told in (("--port", "80999", "port: expected 0 to 65535, found 80999"), ("--host", "no.such.invalid", "host: ")):
        failed = subprocess.run([*command, "scene.ply", option, value], cwd=tmp_path, capture_output=True, text=True, timeout=60)
        assert failed.returncode == 1 and failed.stderr.startswith(f"error: {told}"), failed.stderr
