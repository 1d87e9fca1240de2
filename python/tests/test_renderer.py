"""`Scene`, `Camera`, `Renderer` and plans."""

import copy
import inspect
import itertools
import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
import pytest
import splatgraph
from conftest import ROOT, intrinsics, random_splats
from splatgraph import Camera, Renderer, Scene


def test_a_scene_has_the_arrays_that_it_was_made_of(tmp_path):
    means, quats, scales, opacities, sh = random_splats(1, 50, 2)
    scene = Scene.from_arrays(means, 3 * quats, scales, opacities, sh)
    assert len(scene) == 50 and scene.sh_degree == 2 and scene.dropped == 0
    np.testing.assert_array_equal(scene.means, means)
    np.testing.assert_array_equal(scene.sh, sh)
    np.testing.assert_allclose(scene.quats, quats / np.linalg.norm(quats, axis=1, keepdims=True), atol=1e-6)
    scene.save(tmp_path / "scene.ply")
    again = Scene.load(tmp_path / "scene.ply")
    np.testing.assert_allclose(again.scales, scales, rtol=1e-6)
    np.testing.assert_allclose(again.opacities, opacities, atol=1e-6)
    means[3, 1] = np.nan
    assert Scene.from_arrays(means, quats, scales, opacities, sh).dropped == 1


def test_properties_of_ones_own_come_from_arrays_and_files_and_stay_with_their_splats(tmp_path):
    means, *others = random_splats(1, 50, 2)
    means[3, 1] = np.nan
    label = np.arange(50)
    scene = Scene.from_arrays(means, *others, properties={"label": label})
    np.testing.assert_array_equal(scene.properties["label"], np.delete(label, 3))
    scene.save(tmp_path / "scene.ply")
    assert Scene.load(tmp_path / "scene.ply").properties == {}
    again = Scene.load(tmp_path / "scene.ply", properties=["label"])
    np.testing.assert_array_equal(again.properties["label"], np.delete(label, 3))
    with pytest.raises(splatgraph.SceneError, match="expected a property `labels`, found none; did you mean `label`"):
        Scene.load(tmp_path / "scene.ply", properties=["labels"])
    with pytest.raises(ValueError, match=r"label: expected the shape \[50\]"):
        Scene.from_arrays(means, *others, properties={"label": label[:-1]})


def test_mistakes_in_arrays_and_files_are_told_by_name(tmp_path):
    means, quats, scales, opacities, sh = random_splats(1, 50, 2)
    with pytest.raises(ValueError, match="sh: expected 1, 4, 9 or 16 bases"):
        Scene.from_arrays(means, quats, scales, opacities, sh[:, :5])
    with pytest.raises(ValueError, match=r"scales: expected the shape \[50, 3\], found \[49, 3\]"):
        Scene.from_arrays(means, quats, scales[:-1], opacities, sh)
    with pytest.raises(ValueError, match=r"opacities: expected values of 0 to 1, found \d+, the first .*if they are logits: their sigmoid"):
        Scene.from_arrays(means, quats, scales, 4 * opacities - 2, sh)
    with pytest.raises(ValueError, match=r"scales: expected no negative values, found \d+, the first .*if they are logarithms: numpy.exp"):
        Scene.from_arrays(means, quats, np.log(scales), opacities, sh)
    with pytest.raises(splatgraph.SceneError, match="nowhere.ply"):
        Scene.load(tmp_path / "nowhere.ply")
    scene = Scene.from_arrays(means, quats, scales, opacities, sh)
    with pytest.raises(ValueError, match=r"path: expected a file name that ends in \.ply"):
        scene.save(tmp_path / "scene.obj")
    with pytest.raises(ValueError, match=r"path: expected a file name that ends in \.glb.*name it .*scene\.glb"):
        scene.save(tmp_path / "scene.gltf")
    assert not list(tmp_path.iterdir())


def test_means_of_doubles_far_from_0_keep_their_precision_by_an_offset(tmp_path):
    means, *others = random_splats(1, 50, 2)
    far = means.astype(np.float64) + [1e7, 0, 0]
    scene = Scene.from_arrays(far, *others)
    assert scene.offset == [10_000_384.0, 0, 0] and len(scene) == 50
    np.testing.assert_allclose(scene.means + np.array(scene.offset), far, atol=1e-4)
    scene.save(tmp_path / "far.ply")
    assert Scene.load(tmp_path / "far.ply").offset == scene.offset
    assert Scene.from_arrays(means.astype(np.float64), *others).offset == [0, 0, 0]
    np.testing.assert_array_equal(Scene.from_arrays(means.tolist(), *others).means, means)
    with pytest.warns(UserWarning, match="means: positions are in steps of 1.0e0"):
        rounded = Scene.from_arrays(far.astype(np.float32), *others)
    rounded.save(tmp_path / "rounded.ply")
    with pytest.warns(UserWarning, match="rounded.ply: positions are in steps of"):
        Scene.load(tmp_path / "rounded.ply")


def test_arrays_of_a_scene_make_a_scene_with_its_tags_and_its_offset(tmp_path):
    means, *others = random_splats(1, 50, 2)
    Scene.from_arrays(means + np.array([1e7, 0, 0]), *others).save(tmp_path / "far.ply")
    ply = (tmp_path / "far.ply").read_bytes()
    (tmp_path / "far.ply").write_bytes(ply.replace(b"end_header", b"comment vertical axis: z\nend_header", 1))
    scene = Scene.load(tmp_path / "far.ply")
    kept = scene.opacities > 0.5
    arrays = [array[kept] for array in (scene.means, scene.quats, scene.scales, scene.opacities, scene.sh)]
    assert Scene.from_arrays(*arrays).tags == {} and scene.tags == {"up": "0,0,1"}
    pruned = Scene.from_arrays(*arrays, like=scene)
    assert (pruned.tags, pruned.offset, len(pruned)) == (scene.tags, scene.offset, kept.sum())
    np.testing.assert_array_equal(pruned.means, scene.means[kept])
    moved = Scene.from_arrays(arrays[0] + np.array([1e7, 0, 0]), *arrays[1:], like=scene)
    np.testing.assert_allclose(moved.means + np.array(moved.offset) - scene.offset - [1e7, 0, 0], arrays[0], atol=1e-4)
    pruned.save(tmp_path / "pruned.ply")
    again = Scene.load(tmp_path / "pruned.ply")
    assert (again.tags, again.offset) == (scene.tags, scene.offset)


def test_a_file_that_lacks_what_a_scene_has_is_warned_of(scene, camera, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene.save(tmp_path / "scene.ply")
        scene.save(tmp_path / "scene.compressed.ply")
    with pytest.warns(UserWarning, match="scene.glb: lost: the order by depth") as found:
        scene.save(tmp_path / "scene.glb")
    assert len(found) == 1 and found[0].filename == __file__
    assert len(Scene.load(tmp_path / "scene.glb")) == len(scene)


def test_cameras_are_pickled_and_copies_are_the_same_object(scene):
    view = np.eye(4)
    view[:3, 3] = (0.1, -0.2, 1e6 / 3)
    for camera in (
        Camera(view, intrinsics(61, 49, 60), 64, 48, "name", projection="fisheye"),
        Camera.look_at((0.1, 0.2, -3), (0, 0.3, 4), fov=51.7, size=(np.int64(63), 47)),
    ):
        again = pickle.loads(pickle.dumps(camera))
        assert repr(again) == repr(camera) and (again.name, again.projection) == (camera.name, camera.projection)
        np.testing.assert_array_equal(again.viewmat, camera.viewmat)
        np.testing.assert_array_equal(again.K, camera.K)
        assert copy.copy(camera) is camera and copy.deepcopy(camera) is camera
    plan = splatgraph.plan("splat", scene=scene)
    assert copy.deepcopy([scene, plan]) == [scene, plan]


def test_a_scene_whose_splats_are_all_dropped_is_named_as_the_cause(camera, tmp_path):
    means, *others = random_splats(1, 50, 2)
    empty = Scene.from_arrays(means * np.nan, *others)
    assert (len(empty), empty.dropped) == (0, 50)
    with pytest.raises(splatgraph.SceneError, match=r"expected at least one splat to write, found none \(50 dropped\)"):
        empty.save(tmp_path / "empty.ply")
    cause = r"expected a scene with splats, found one without \(50 dropped\)"
    with Renderer(empty) as renderer, pytest.raises(splatgraph.SceneError, match=cause):
        renderer.render(camera)
    with pytest.raises(splatgraph.SceneError, match=cause):
        splatgraph.trade(empty, [camera], rounds=1)
    with pytest.raises(splatgraph.SceneError, match=cause):
        splatgraph.advise(empty, [camera], psnr=40, rounds=1)


def test_a_camera_gives_back_its_matrices():
    angle = 0.4
    view = np.eye(4)
    view[:3, :3] = [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
    view[:3, 3] = (1, 2, 3)
    camera = Camera(view, intrinsics(64, 48, 60), 64, 48)
    np.testing.assert_allclose(camera.viewmat, view, atol=1e-12)
    np.testing.assert_allclose(camera.K, intrinsics(64, 48, 60))
    np.testing.assert_allclose(view @ [*camera.position, 1], [0, 0, 0, 1], atol=1e-12)
    with pytest.raises(ValueError, match="not orthonormal"):
        Camera(np.diag([2, 2, 2, 1]) @ view, intrinsics(64, 48, 60), 64, 48)
    with pytest.raises(ValueError, match="expected a width and a height in pixels, from 1 to 4294967295, found 0"):
        Camera(view, intrinsics(64, 48, 60), 0, 48)
    for size in ((-1, 5), (0, 0), (64, 2**40)):
        with pytest.raises(ValueError, match="expected a width and a height in pixels, from 1 to 4294967295"):
            camera.resized(*size)
        with pytest.raises(ValueError, match="expected a width and a height in pixels"):
            Camera.framing(Scene.from_arrays(*random_splats(1, 50, 0)), size=size)
    assert "size=(960, 540), up=(0.0, -1.0, 0.0)" in str(inspect.signature(Camera.look_at))
    for fov in (-5, 180, float("nan")):
        with pytest.raises(ValueError, match="fov: expected an angle above 0 and below 180 degrees"):
            Camera.look_at((0, 0, -3), (0, 0, 0), fov=fov)
    aside = np.array([[60, 0, 12.25], [0, 50, 40], [0, 0, 1]])
    np.testing.assert_array_equal(Camera(view, aside, 64, 48).K, aside)
    np.testing.assert_array_equal(Camera(view, aside, 64, 48).resized(128, 96).K, aside * [[2], [2], [1]])
    with pytest.raises(ValueError, match="expected the principal point within a pixel of the middle of a panorama, found cx = 12.25"):
        Camera(view, aside, 64, 48, projection="equirectangular")


def test_a_camera_has_a_projection_and_needs_a_renderer_with_the_same(scene):
    camera = Camera(np.eye(4), intrinsics(64, 48, 30), 64, 48, projection="fisheye")
    assert camera.projection == "fisheye" and camera.resized(32, 24).projection == "fisheye"
    with Renderer(scene, "fisheye") as renderer:
        picture = renderer.render(camera)
        # A pinhole camera is converted, and keeps its focal length at the picture's centre.
        np.testing.assert_array_equal(picture, renderer.render(Camera(np.eye(4), intrinsics(64, 48, 30), 64, 48)))
        assert picture.max() > 0.1
    with Renderer(scene) as renderer, pytest.raises(splatgraph.Error, match=r'pinhole cameras: use Renderer\(scene, "fisheye"\)'):
        renderer.render(camera)
    with pytest.raises(ValueError, match='projection: expected one of pinhole, orthographic, fisheye, equirectangular, found "ortho"'):
        Camera(np.eye(4), intrinsics(64, 48, 30), 64, 48, projection="ortho")


def test_a_picture_is_the_command_lines(scene, camera, tmp_path):
    drawn = Renderer(scene).render(camera)
    assert drawn.shape == (48, 64, 3) and drawn.dtype == np.float32 and drawn.std() > 0.05
    scene.save(tmp_path / "scene.ply")
    entry = {
        "id": 0, "img_name": "origin", "width": 64, "height": 48, "position": list(camera.position),
        "rotation": camera.viewmat[:3, :3].T.tolist(), "fx": camera.K[0, 0], "fy": camera.K[1, 1],
    }  # fmt: skip
    (tmp_path / "cameras.json").write_text(json.dumps([entry]))
    command = [sys.executable, "-m", "splatgraph", "render", tmp_path / "scene.ply", "-c", tmp_path / "cameras.json"]
    subprocess.run([*command, "-o", tmp_path / "out.npy"], check=True, stdout=subprocess.DEVNULL)
    # The file's opacities and scales are rounded once more.
    assert splatgraph.compare(drawn, np.load(tmp_path / "out.npy").astype(np.float32)).psnr > 90


def test_many_pictures_come_in_order_and_equal_single_ones(scene):
    cameras = [Camera.look_at((0.1 * i, 0, -2), (0, 0, 4), size=(40 + 8 * (i % 2), 32)) for i in range(7)]
    with Renderer(scene, validation=True) as renderer:
        single = [renderer.render(camera) for camera in cameras]
        many = list(renderer.render_many(iter(cameras)))
        assert all(np.array_equal(a, b) for a, b in itertools.zip_longest(single, many))
        # Pictures of the cameras before an exception come first.
        broken = renderer.render_many(camera if camera else 1 / 0 for camera in [*cameras[:3], None])
        assert all(np.array_equal(next(broken), picture) for picture in single[:3])
        with pytest.raises(ZeroDivisionError):
            next(broken)
        # An iterator that is dropped early does not affect later pictures.
        next(renderer.render_many(cameras))
        assert np.array_equal(renderer.render(cameras[2]), single[2])
        assert renderer.stats["width"] == 40 and renderer.stats["counts"]["visible"] > 0


def test_the_size_and_the_background_are_the_renderers(scene, camera):
    renderer = Renderer(scene, size=(32, 24), background=(0.0, 0.0, 1.0))
    drawn = renderer.render(camera)
    assert drawn.shape == (24, 32, 3)
    assert drawn[..., 2].mean() > Renderer(scene, size=(32, 24)).render(camera)[..., 2].mean()
    for color, why in (((255, 255, 255), "255 is 1"), ((0, float("nan"), 0), "finite")):
        with pytest.raises(ValueError, match=why):
            renderer.background = color
    renderer.background = (-1, 1000, 0)


def test_other_outputs_come_with_the_picture(scene, camera):
    with Renderer(scene, validation=True) as renderer:
        picture = renderer.render(camera)
        drawn, found = renderer.render(camera, outputs=["normal", "depth", "index"])
        np.testing.assert_allclose(drawn, picture, atol=1e-5)
        assert {name: (values.shape, values.dtype) for name, values in found.items()} == {
            "depth": ((48, 64), np.float32), "normal": ((48, 64, 3), np.float32), "index": ((48, 64), np.uint32),
        }  # fmt: skip
        assert found["depth"].max() > 1 and found["index"].min() < len(scene)
        # Requests with other outputs, also from other threads, do not affect each other.
        plain, both = renderer.render_many([camera] * 3), renderer.render_many([camera] * 3, outputs=iter(["depth"]))
        for one, (two, others) in zip(plain, both, strict=True):
            np.testing.assert_array_equal(one, picture)
            assert list(others) == ["depth"] and np.array_equal(others["depth"], found["depth"])
        with pytest.raises(splatgraph.GraphError, match="no output `light`"):
            renderer.render(camera, outputs=["light"])
        np.testing.assert_array_equal(renderer.render(camera), picture)
        # `splat` has no normals.
        renderer.render(camera, outputs="normal")
        renderer.use("splat")
        assert renderer.plan.name == "splat"


def test_what_changes_a_renderer_only_by_a_call_cannot_be_assigned(scene):
    renderer = Renderer(scene, size=[np.int64(32), 24])
    assert renderer.size == (32, 24) and renderer.scene is scene
    with pytest.raises(AttributeError, match=r"scene: cannot be assigned; call show\(scene\)"):
        renderer.scene = scene
    with pytest.raises(AttributeError, match=r"pipeline: cannot be assigned; call use\(pipeline\)"):
        renderer.pipeline = "splat"
    with pytest.raises(AttributeError, match=r"budget: cannot be assigned; call Renderer.set\(budget=0.1\)"):
        renderer.params.budget = 0.1
    with pytest.raises(AttributeError, match=r"a Renderer has no such attribute; for a parameter of the graph, call set\(budget=0.1\)"):
        renderer.budget = 0.1
    for size in ("64x48", 64, (1, 2, 3)):
        with pytest.raises(TypeError, match="size: expected a width and a height in pixels, found"):
            renderer.size = size
    with pytest.raises(ValueError, match="size: expected numbers above 0, found 0 and 4"):
        renderer.size = (0, 4)
    for background in ("white", (0, 1), 0.5):
        with pytest.raises(TypeError, match="background: expected three numbers, red, green and blue, found"):
            Renderer(scene, background=background)


def test_concurrent_changes_of_parameters_are_all_kept(scene):
    changes = {"digit_bits": 4, "budget": 0.5, "cutoff": 0.5, "key_bits": 16, "sh_degree": 0}
    with Renderer(scene, "splat") as renderer:
        changes = {name: value for name, value in changes.items() if name in renderer.params}
        for _ in range(5):
            renderer.use("splat")
            threads = [threading.Thread(target=renderer.set, kwargs={name: renderer.params[name].default}) for name in changes]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            assert set(renderer._set) == set(changes)


def test_parameters_have_ranges_and_are_set_by_name(scene, camera):
    renderer = Renderer(scene, "splat", {"digit_bits": 8}, size=(64, 48))
    before = renderer.render(camera)
    digit_bits = renderer.params.digit_bits
    assert (digit_bits.value, digit_bits.range, digit_bits.kind) == (8, (1, 11), "int")
    assert "cutoff" in dir(renderer.params) and renderer.params["budget"].live
    passes = len(renderer.plan.passes)
    renderer.set(digit_bits=4)
    assert renderer.params.digit_bits.value == 4 and len(renderer.plan.passes) > passes
    assert np.array_equal(renderer.render(camera), before), "the order is the same"
    with pytest.raises(splatgraph.GraphError, match="digit_bits"):
        renderer.set(digit_bits=40)
    assert renderer.params.digit_bits.value == 4, "a refused value changes nothing"
    renderer.set(budget=0.1)
    assert not np.array_equal(renderer.render(camera), before)
    with pytest.raises(AttributeError, match="no parameter 'digits'"):
        renderer.params.digits


def test_a_graphs_error_has_its_place_and_is_drawn(scene, camera, tmp_path):
    graph = tmp_path / "broken.ron"
    graph.write_text(
        'Graph(\n  version: 1,\n  summary: "Broken",\n  resources: { "final": Image(format: "rgba8", size: (8, 8)) },\n'
        '  passes: [],\n  output: "nothing",\n)\n'
    )
    with pytest.raises(splatgraph.GraphError) as caught:
        splatgraph.plan(graph)
    error = caught.value
    assert (error.file, error.line, error.column) == (str(graph), 6, 12)
    assert error.errors[0]["line"] == 6 and error.errors[0]["message"] in error.text
    assert '6 |   output: "nothing",' in error.text and str(error) == error.text
    renderer = Renderer(scene, graph)
    with pytest.raises(splatgraph.GraphError, match="no resource `nothing`"):
        renderer.render(camera)
    for argument, pipeline, params in (("params", "splat", {"digit_bits": 40}), ("pipeline", "nowhere", {})):
        with pytest.raises(splatgraph.GraphError, match=f"--> {argument}:1:") as caught:
            splatgraph.plan(pipeline, params)
        assert caught.value.file == caught.value.errors[0]["file"] == argument
    with pytest.raises(TypeError, match="pipeline: expected the name of a graph, or a path, found 7"):
        renderer.use(7)


def test_a_shader_that_breaks_the_compiler_does_not_end_the_process(tmp_path):
    # The nested expression overflows glslang's stack.
    (tmp_path / "deep.comp").write_text(
        "#version 460\nlayout(local_size_x = 1) in;\n"
        "layout(rgba8) uniform writeonly image2D picture;\nvoid main() { int a = "
        + "(" * 200_000 + "1" + ")" * 200_000 + "; imageStore(picture, ivec2(a), vec4(1)); }\n"
    )  # fmt: skip
    (tmp_path / "deep.ron").write_text(
        'Graph(version: 1, resources: { "final": Image(format: "rgba8", size: ("viewport.width", "viewport.height")) }, passes: [\n'
        'Dispatch(name: "draw", shader: "deep.comp", size: Threads("1"), bind: { "picture": "final" })], output: "final")\n'
    )
    with pytest.raises(splatgraph.GraphError):
        splatgraph.plan(str(tmp_path / "deep.ron"))


def test_plans_need_no_device_and_have_json_and_pages(scene):
    plan = splatgraph.plan("splat", {"digit_bits": 4}, scene, size=(320, 200))
    dump = json.loads(plan.to_json())
    assert dump["graph"] == plan.name == "splat" and [p["name"] for p in dump["passes"]] == plan.passes
    assert plan.html().startswith("<!doctype html>") and "digraph" in plan.dot() and plan.passes[0] in str(plan)
    assert any("barriers" in line for line in str(plan).splitlines())


def test_threads_share_a_renderer(scene):
    cameras = [Camera.look_at((0.2 * i, 0, -2), (0, 0, 4), size=(40, 32)) for i in range(6)]
    renderer = Renderer(scene)
    expected = [renderer.render(camera) for camera in cameras]
    found = [None] * len(cameras)

    def draw(index):
        found[index] = [renderer.render(cameras[index]) for _ in range(3)]

    threads = [threading.Thread(target=draw, args=(index,)) for index in range(len(cameras))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for index, pictures in enumerate(found):
        assert all(np.array_equal(picture, expected[index]) for picture in pictures)


def test_python_runs_while_a_picture_is_drawn(scene):
    renderer = Renderer(scene)
    camera = Camera.look_at((0, 0, -2), (0, 0, 4), size=(1600, 1200))
    renderer.render(camera)
    turns, done = 0, threading.Event()

    def draw():
        for _ in range(4):
            renderer.render(camera)
        done.set()

    threading.Thread(target=draw).start()
    while not done.wait(0.001):
        turns += 1
    assert turns > 10


def test_a_closed_renderer_refuses(scene, camera):
    renderer = Renderer(scene)
    renderer.close()
    renderer.close()
    with pytest.raises(splatgraph.Error, match="the renderer is closed"):
        renderer.render(camera)


def test_no_such_device_and_backend_are_told(scene):
    with pytest.raises(splatgraph.DeviceError, match="no-such-card"):
        Renderer(scene, device="no-such-card")
    with pytest.raises(ValueError, match="backend: expected"):
        Renderer(scene, backend="direct3d")


FORKED = """
import os, splatgraph, sys
sys.path.insert(0, {tests!r})
from conftest import random_splats
renderer = splatgraph.Renderer(splatgraph.Scene.from_arrays(*random_splats(7, 300, 1)))
camera = splatgraph.Camera.look_at((0, 0, -2), (0, 0, 4), size=(16, 16))
picture = renderer.render(camera)
calls = [
    lambda: renderer.render(camera),
    lambda: splatgraph.Renderer(renderer.scene),
    lambda: splatgraph.Scene.from_arrays(*random_splats(7, 300, 1)),
    lambda: splatgraph.Scene.load("scene.ply"),
    lambda: splatgraph.compare(picture, picture),
    lambda: splatgraph.Camera.framing(renderer.scene),
]
child = os.fork()
if child == 0:
    for call in calls:
        try:
            call()
        except splatgraph.Error as error:
            print(error, flush=True)
    sys.exit()
os.waitpid(child, 0)
renderer.render(camera)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_a_forked_process_is_told_that_it_has_neither_device_nor_threads():
    program = FORKED.format(tests=str(ROOT / "python/tests"))
    process = subprocess.run([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, timeout=60, check=True)
    lines = process.stdout.splitlines()
    assert len(lines) == 6
    for line in lines:
        assert line.startswith("expected a call in process") and line.endswith("start workers with `spawn` or `forkserver`")


def test_a_camera_that_looks_at_its_own_position_is_refused():
    with pytest.raises(ValueError, match="target: expected a point other than eye"):
        Camera.look_at((0, 0, 4), (0, 0, 4))


ENDLESS = """
import splatgraph, sys
sys.path.insert(0, {tests!r})
from conftest import random_splats
renderer = splatgraph.Renderer(splatgraph.Scene.from_arrays(*random_splats(7, 300, 1)))
camera = splatgraph.Camera.look_at((0, 0, -2), (0, 0, 4), size=(2048, 2048))
print("drawing", flush=True)
try:
    for _ in renderer.render_many(camera for _ in range(100000)):
        pass
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_ctrl_c_ends_a_long_batch():
    program = ENDLESS.format(tests=str(ROOT / "python/tests"))
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "drawing\n"
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=30)
    assert (output, process.returncode) == ("interrupted\n", 0)


def test_a_picture_becomes_the_file_that_the_command_line_writes(scene, camera, tmp_path):
    picture = Renderer(scene).render(camera)
    file = splatgraph.png(picture)
    assert file.startswith(b"\x89PNG") and int.from_bytes(file[16:20], "big") == 64
    (tmp_path / "a.png").write_bytes(file)
    np.save(tmp_path / "b.npy", picture)
    command = [sys.executable, "-m", "splatgraph", "compare", "a.png", "b.npy", "--min-psnr", "50"]
    subprocess.run(command, cwd=tmp_path, check=True, stdout=subprocess.DEVNULL)
    with pytest.raises(ValueError, match="picture: expected the shape"):
        splatgraph.png(picture[0])


def test_pictures_of_integers_are_floats_of_which_the_maximum_is_white(scene, camera):
    picture = np.clip(Renderer(scene).render(camera), 0, 1)
    for kind, limit in ((np.uint8, 50), (np.uint16, 90)):
        most = np.iinfo(kind).max
        rounded = np.round(picture * most).astype(kind)
        assert splatgraph.compare(rounded, picture).psnr > limit
        assert splatgraph.compare(rounded, rounded / np.float32(most)).identical
        assert splatgraph.png(rounded) == splatgraph.png(rounded / np.float32(most))
    with pytest.raises(TypeError, match="b: expected a picture of floats from 0 to 1, of uint8 or of uint16, found int64"):
        splatgraph.compare(picture, (picture * 255).astype(np.int64))
    with pytest.raises(ValueError, match="divide 8-bit values by 255"):
        splatgraph.compare(picture, np.rint(picture * 255))
    with pytest.warns(UserWarning, match="most values are above 1"):
        splatgraph.compare(picture, picture * 255)


def test_equal_pictures_are_identical_and_others_measured():
    a = np.random.default_rng(0).uniform(size=(16, 20, 3)).astype(np.float32)
    same = splatgraph.compare(a, a)
    assert same.identical and same.psnr == float("inf") and abs(same.ssim - 1) < 1e-9
    b = a.copy()
    b[3, 5, 1] += 0.5
    other = splatgraph.compare(a, b)
    assert other.worst_pixel == (5, 3) and abs(other.worst - 0.5) < 1e-6 and not other.identical
    with pytest.raises(ValueError, match="expected pictures of the same size"):
        splatgraph.compare(a, a[:8])


def test_a_path_passes_its_keys_and_is_saved_with_its_poses(tmp_path, scene):
    keys = [Camera.look_at((x, 0, -4), (x, 0, 0), size=(32, 18), name="key") for x in (0.0, 8.0)]
    path = Camera.path(scene, keys, 9)
    np.testing.assert_allclose([camera.position for camera in path], [[x, 0, -4] for x in range(9)], atol=1e-9)
    assert [camera.name for camera in path[:2]] == ["00000", "00001"]
    assert len(Camera.path(scene, keys, 9, closed=True)) == 9 and Camera.path(scene, [], 9) == []
    Camera.save(path, tmp_path / "path.json")
    for camera, read in zip(path, Camera.load(tmp_path / "path.json"), strict=True):
        np.testing.assert_array_equal(camera.viewmat, read.viewmat)
        np.testing.assert_array_equal(camera.K, read.K)


def test_a_lens_with_distortion_is_read_on_demand(tmp_path):
    frame = {"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}
    text = json.dumps({"w": 8, "h": 6, "fl_x": 9, "k1": 0.1, "frames": [frame]})
    (tmp_path / "transforms.json").write_text(text)
    with pytest.raises(splatgraph.SceneError, match="ignore_distortion=True"):
        Camera.load(tmp_path)
    assert Camera.load(tmp_path, ignore_distortion=True)[0].K[0, 0] == 9
