"""`rasterization` against gsplat's definition (definition.py), and its arguments."""

import importlib.util
import re
import sys
import types

import numpy as np
import pytest
import splatgraph
from conftest import captured, intrinsics, psnr, random_splats
from definition import fisheye, ortho, picture, pinhole
from splatgraph import rasterization

#: Minimum PSNR against the definition, in dB.
LEAST = 75.0

#: The definition of each camera model.
MODELS = {"pinhole": pinhole, "ortho": ortho, "fisheye": fisheye}


def looking(eye, angle):
    """Returns the view of a camera at `eye`, turned about y by `angle`."""
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = rotation, -rotation @ np.asarray(eye, float)
    return view


def agreement(arguments, viewmats, Ks, width, height, **options):
    """Returns PSNRs of colours, alphas, D and ED against the definition, the minimum over all cameras."""
    drawn, alphas, _ = rasterization(*arguments, viewmats, Ks, width, height, render_mode="RGB+D", **options)
    expected, _, _ = rasterization(*arguments, viewmats, Ks, width, height, render_mode="ED", **options)
    near, far = options.get("near_plane", 0.01), options.get("far_plane", 1e10)
    antialiased = options.get("rasterize_mode") == "antialiased"
    found = []
    for c in range(len(viewmats)):
        colors, alpha, depth = picture(
            *arguments,
            viewmats[c],
            Ks[c],
            width,
            height,
            near,
            far,
            options.get("eps2d", 0.3),
            options.get("sh_degree"),
            antialiased,
            MODELS[options.get("camera_model", "pinhole")],
        )
        found.append(
            [
                psnr(drawn[c, ..., :-1], colors),
                psnr(alphas[c, ..., 0], alpha),
                psnr(drawn[c, ..., -1], depth),
                psnr(expected[c, ..., 0], depth / np.maximum(alpha, 1e-10)),
            ]
        )
        assert alpha.max() > 0.5, "the picture is not empty"
    return np.min(found, axis=0)


@pytest.mark.parametrize("seed, degree", [(0, None), (1, 3), (2, 1)])
def test_colours_alphas_and_depths_of_random_splats_agree_with_the_definition(seed, degree):
    arguments = random_splats(seed, degree=degree)
    viewmats = np.stack([np.eye(4), looking((0.5, -0.2, -1), 0.3)])
    # The second camera's principal point is aside, beyond the upper edge.
    Ks = np.stack([intrinsics(96, 64, 70), intrinsics(60, -20, 120)])
    found = agreement(arguments, viewmats, Ks, 96, 64, sh_degree=degree)
    print(f"random scene {seed}: colours, alphas, D, ED {np.round(found, 1)} dB")
    assert (found >= LEAST).all(), found


@pytest.mark.parametrize("model, focals", [("ortho", (20, 35)), ("fisheye", (30, 55))])
@pytest.mark.parametrize("seed, degree", [(9, None), (10, 3)])
def test_orthographic_and_fisheye_pictures_of_random_splats_agree_with_the_definition(model, focals, seed, degree):
    arguments = random_splats(seed, degree=degree)
    # The fisheye with the shorter focal length spans 183 degrees. The second camera's pixels are not square.
    viewmats = np.stack([np.eye(4), looking((0.5, -0.2, -1), 0.3)])
    Ks = np.stack([intrinsics(96, 64, focals[0]), intrinsics(130, 90, focals[1])])
    Ks[1, 1, 1] *= 1.25
    found = agreement(arguments, viewmats, Ks, 96, 64, sh_degree=degree, camera_model=model)
    print(f"random scene {seed}, {model}: colours, alphas, D, ED {np.round(found, 1)} dB")
    assert (found >= LEAST).all(), found


def test_an_orthographic_focal_length_is_pixels_per_world_unit_whatever_the_near_plane_is():
    splat = np.array([[0.5, -0.25, 3.0]]), np.array([[1.0, 0, 0, 0]]), np.full((1, 3), 0.02), np.ones(1), np.ones((1, 3))
    for near in (0.01, 1.0):
        drawn, _, _ = rasterization(*splat, np.eye(4)[None], intrinsics(64, 48, 20)[None], 64, 48, near_plane=near, camera_model="ortho")
        row, column = np.unravel_index(drawn[0, ..., 0].argmax(), (48, 64))
        # At (20 * 0.5 + 32, 20 * -0.25 + 24) = (42, 19), between four pixels.
        assert column in (41, 42) and row in (18, 19), (near, row, column)


@pytest.mark.parametrize("name, crop", [("biker", (96, 64)), ("playbot-31k", (120, 90))])
def test_captured_scenes_agree_with_the_definition(name, crop):
    scene = splatgraph.Scene.load(captured(f"{name}.ply"))
    camera = splatgraph.Camera.load(captured(f"{name}.cameras.json"))[0]
    width, height = crop
    # The middle of the picture at a sixth of its size.
    K = intrinsics(width, height, camera.K[0, 0] / 6)
    arguments = (scene.means, scene.quats, scene.scales, scene.opacities, scene.sh)
    found = agreement(arguments, camera.viewmat[None], K[None], width, height, sh_degree=scene.sh_degree)
    print(f"{name}: colours, alphas, D, ED {np.round(found, 1)} dB")
    assert (found >= LEAST).all(), found


@pytest.mark.parametrize("model", ["ortho", "fisheye"])
@pytest.mark.parametrize("name, crop", [("biker", (96, 64)), ("playbot-31k", (120, 90))])
def test_orthographic_and_fisheye_pictures_of_captured_scenes_agree_with_the_definition(name, crop, model):
    scene = splatgraph.Scene.load(captured(f"{name}.ply"))
    camera = splatgraph.Camera.load(captured(f"{name}.cameras.json"))[0]
    width, height = crop
    focal = camera.K[0, 0] / 6
    if model == "ortho":
        # At the median depth of the splats, objects have their size in the pinhole picture.
        focal /= np.median((scene.means @ camera.viewmat[2, :3]) + camera.viewmat[2, 3])
    arguments = (scene.means, scene.quats, scene.scales, scene.opacities, scene.sh)
    K = intrinsics(width, height, focal)
    found = agreement(arguments, camera.viewmat[None], K[None], width, height, sh_degree=scene.sh_degree, camera_model=model)
    print(f"{name}, {model}: colours, alphas, D, ED {np.round(found, 1)} dB")
    assert (found >= LEAST).all(), found


@pytest.mark.parametrize(
    "options",
    [
        {"near_plane": 2.0},
        {"far_plane": 4.0},
        {"rasterize_mode": "antialiased"},
        {"eps2d": 0.0},
        {"near_plane": 2.0, "camera_model": "fisheye"},
        {"far_plane": 4.0, "camera_model": "ortho"},
    ],
    ids=lambda options: "-".join(options),
)
def test_planes_and_low_passes_agree_with_the_definition(options):
    arguments = random_splats(3)
    found = agreement(arguments, np.eye(4)[None], intrinsics(96, 64, 70)[None], 96, 64, **options)
    assert (found >= LEAST).all(), found


def test_covariances_stand_for_rotations_and_scales():
    means, quats, scales, opacities, colors = random_splats(4)
    from definition import rotations

    axes = rotations(quats.astype(np.float64)) * scales[:, None, :]
    view, K = np.eye(4)[None], intrinsics(64, 48, 50)[None]
    by_axes = rasterization(means, quats, scales, opacities, colors, view, K, 64, 48)[0]
    by_covars = rasterization(means, None, None, opacities, colors, view, K, 64, 48, covars=axes @ axes.transpose(0, 2, 1))[0]
    assert psnr(by_covars, by_axes) > LEAST


def test_channels_may_be_many_and_negative():
    means, quats, scales, opacities, _ = random_splats(5)
    colors = np.random.default_rng(0).normal(size=(len(means), 5)).astype(np.float32)
    view, K = np.eye(4), intrinsics(64, 48, 50)
    drawn, _, _ = rasterization(means, quats, scales, opacities, colors, view[None], K[None], 64, 48)
    expected, _, _ = picture(means, quats, scales, opacities, colors, view, K, 64, 48)
    assert drawn.shape == (1, 48, 64, 5) and expected.min() < 0
    assert psnr(drawn[0], expected) > LEAST


@pytest.mark.parametrize("missing", ["splats", "means", "quats"])
def test_without_a_splat_that_can_be_drawn_the_background_is_left(missing):
    means, quats, scales, opacities, colors = random_splats(3, 0 if missing == "splats" else 4)
    if missing == "means":
        means[:] = np.nan
    if missing == "quats":
        quats[:] = 0
    K, backgrounds = intrinsics(16, 12, 10), np.array([[0.25, 0.5, 0.75]], np.float32)
    arguments = (means, quats, scales, opacities, colors, np.eye(4)[None], K[None], 16, 12)
    drawn, alphas, _ = rasterization(*arguments, backgrounds=backgrounds, render_mode="RGB+ED")
    assert drawn.shape == (1, 12, 16, 4) and (drawn == [0.25, 0.5, 0.75, 0]).all() and not alphas.any()


def test_a_colour_that_is_no_number_costs_one_splat():
    means, quats, scales, opacities, colors = random_splats(5)
    colors[5, 0] = np.nan
    others = [np.delete(array, 5, axis=0) for array in (means, quats, scales, opacities, colors)]
    K = intrinsics(32, 24, 25)
    pictures = [rasterization(*arrays, np.eye(4)[None], K[None], 32, 24)[0] for arrays in ((means, quats, scales, opacities, colors), others)]
    assert np.array_equal(*pictures) and pictures[0].any()


def test_shapes_are_gsplats_with_batches_and_cameras_and_colours_of_each():
    one, other = random_splats(6), random_splats(7)
    batched = [np.stack([a, b]) for a, b in zip(one, other)]
    views = np.broadcast_to(np.eye(4), (2, 3, 4, 4))
    Ks = np.broadcast_to(intrinsics(40, 30, 40), (2, 3, 3, 3))
    backgrounds = np.random.default_rng(0).uniform(size=(2, 3, 3))
    drawn, alphas, meta = rasterization(*batched, views, Ks, 40, 30, backgrounds=backgrounds, render_mode="RGB+ED")
    assert drawn.shape == (2, 3, 30, 40, 4) and alphas.shape == (2, 3, 30, 40, 1)
    assert drawn.dtype == alphas.dtype == np.float32
    assert (meta["width"], meta["height"], meta["n_cameras"], meta["n_batches"]) == (40, 30, 3, 2)
    alone, alpha, _ = rasterization(*other, views[1], Ks[1], 40, 30)
    expected = alone[2] + (1 - alpha[2]) * backgrounds[1, 2]
    assert psnr(drawn[1, 2, ..., :3], expected) > 100
    with pytest.raises(KeyError, match="means2d: intermediate results stay on the device"):
        meta["means2d"]
    # Colours of each camera.
    of_camera = np.stack([other[4], 1 - other[4]])
    drawn, _, _ = rasterization(*other[:4], of_camera, views[1, :2], Ks[1, :2], 40, 30)
    assert psnr(drawn[0], alone[0]) > 100 and psnr(drawn[1], drawn[0]) < 40


def test_arrays_of_other_libraries_are_taken_without_a_copy_and_given_back(monkeypatch):
    class Foreign:
        """An array of another library, with DLPack's protocol."""

        def __init__(self, values):
            self.values = values

        def __dlpack__(self, **options):
            return self.values.__dlpack__(**options)

        def __dlpack_device__(self):
            return self.values.__dlpack_device__()

    class OfGpu(Foreign):
        def __dlpack_device__(self):
            return (2, 0)

    from splatgraph._arrays import array

    values = np.arange(6, dtype=np.float32).reshape(2, 3)
    assert np.shares_memory(array(Foreign(values), "means"), values)
    with pytest.raises(ValueError, match=r"means: expected an array in the CPU's memory.*means\.cpu\(\)"):
        array(OfGpu(values), "means")

    # Like torch's tensors, they belong to a module that has `from_dlpack`.
    monkeypatch.setattr(Foreign, "__module__", "foreign.arrays")
    monkeypatch.setitem(sys.modules, "foreign", types.SimpleNamespace(from_dlpack=Foreign))
    drawn, alphas, _ = rasterization(**{**VALID, "means": Foreign(VALID["means"])})
    assert type(drawn) is type(alphas) is Foreign and drawn.values.shape == (1, 8, 8, 3)


@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="torch is not installed")
def test_tensors_of_torch_are_taken_without_a_copy_and_given_back():
    import torch
    from splatgraph._arrays import array

    given = {name: torch.as_tensor(value, dtype=torch.float32) for name, value in VALID.items() if name not in ("width", "height")}
    taken = array(given["means"], "means")
    assert taken.__array_interface__["data"][0] == given["means"].data_ptr()
    drawn, alphas, _ = rasterization(**{**VALID, **given})
    assert type(drawn) is type(alphas) is torch.Tensor and drawn.dtype == torch.float32
    expected, _, _ = rasterization(**VALID)
    assert type(expected) is np.ndarray and np.array_equal(drawn.numpy(), expected)
    drawn.mul_(2.0)
    strided = torch.stack([given["scales"]] * 2, dim=-1)[..., 0]
    assert not strided.is_contiguous() and torch.equal(rasterization(**{**VALID, **given, "scales": strided})[0] * 2, drawn)
    half = rasterization(**{**VALID, **given, "opacities": given["opacities"].to(torch.float16)})[0]
    assert psnr(half * 2, drawn) > 40
    given["means"].requires_grad_()
    with pytest.raises(ValueError, match=r"means: expected an array without gradients.*pass means\.detach\(\)"):
        rasterization(**{**VALID, **given})
    scene = splatgraph.Scene.from_arrays(
        *(given[name].detach() for name in ("means", "quats", "scales", "opacities")), given["colors"][:, None]
    )
    assert np.array_equal(scene.means, given["means"].detach().numpy())


VALID = dict(zip(("means", "quats", "scales", "opacities", "colors"), random_splats(8, 10)))
VALID |= {"viewmats": np.eye(4)[None], "Ks": intrinsics(8, 8, 8)[None], "width": 8, "height": 8}


@pytest.mark.parametrize(
    "changed, kind, message",
    [
        (
            {"camera_model": "ftheta"},
            NotImplementedError,
            "camera_model: expected one of pinhole, ortho, fisheye, found 'ftheta'",
        ),
        ({"camera_model": "conic"}, NotImplementedError, "camera_model: expected one of pinhole, ortho, fisheye, found 'conic'"),
        ({"radius_clip": 1.0}, NotImplementedError, "radius_clip: expected 0"),
        ({"eps2d": 0.1}, NotImplementedError, "eps2d: expected 0.3 or 0, found 0.1"),
        ({"absgrad": True}, NotImplementedError, "absgrad: not supported"),
        ({"viewmats_rs": np.eye(4)}, NotImplementedError, "viewmats_rs: not supported, found an array of shape (4, 4)"),
        ({"radial_coeffs": np.ones((1, 6))}, NotImplementedError, "radial_coeffs: not supported"),
        ({"sh_degree": 4}, ValueError, "colors: expected the shape [..., (C,) N, K, 3]"),
        ({"colors": np.zeros((10, 25, 3)), "sh_degree": 4}, NotImplementedError, "sh_degree: expected 0 to 3, found 4"),
        ({"colors": np.zeros((10, 4, 3)), "sh_degree": 2}, ValueError, "colors: expected K of at least 9"),
        ({"render_mode": "depth"}, ValueError, "render_mode: expected one of RGB, D, ED, RGB+D, RGB+ED, found 'depth'"),
        ({"rasterize_mode": "soft"}, ValueError, "rasterize_mode: expected 'classic' or 'antialiased'"),
        ({"near_plane": 0.0}, ValueError, "near_plane: expected a number above 0"),
        ({"means": np.zeros((10, 2))}, ValueError, "means: expected the shape [..., N, 3], found [10, 2]"),
        ({"quats": np.zeros((9, 4))}, ValueError, "quats: expected the shape [10, 4], found [9, 4]"),
        ({"Ks": np.eye(3)}, ValueError, "Ks: expected the shape [1, 3, 3], found [3, 3]"),
        ({"backgrounds": np.zeros((1, 4))}, ValueError, "backgrounds: expected the shape [1, 3], found [1, 4]"),
        ({"viewmats": 2 * np.eye(4)[None]}, ValueError, "viewmats, Ks: camera 0: "),
        ({"opacities": ["a"] * 10}, TypeError, "opacities: expected an array of numbers"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else None,
)
def test_what_is_not_supported_is_refused_by_name(changed, kind, message):
    with pytest.raises(kind, match=re.escape(message)):
        rasterization(**{**VALID, **changed})


@pytest.mark.parametrize(
    "changed, error, match",
    [
        ({"viewmats": np.zeros((0, 4, 4)), "Ks": np.zeros((0, 3, 3))}, ValueError, "viewmats: expected at least one camera"),
        ({"sh_degree": 1.0}, TypeError, r"sh_degree: expected an integer or None, found 1\.0"),
        ({"tile_size": 0}, ValueError, "tile_size: expected a number above 0, found 0"),
        ({"width": 0}, ValueError, "width, height: expected numbers above 0, found 0 and 48"),
        ({"height": -5}, ValueError, "width, height: expected numbers above 0, found 64 and -5"),
        ({"near_plane": 1e-20}, ValueError, r"near_plane: expected at least 9.\de-20 for scales of up to 4.\de-01, found 1e-20"),
    ],
)
def test_arguments_that_cannot_be_drawn_are_told_by_name(changed, error, match):
    means, quats, scales, opacities, sh = random_splats(1, 50, 1)
    arguments = {"viewmats": np.eye(4)[None], "Ks": intrinsics(64, 48, 60)[None], "width": 64, "height": 48, "sh_degree": 1, **changed}
    with pytest.raises(error, match=match):
        rasterization(means, quats, scales, opacities, sh, **arguments)


def test_doubles_far_from_0_are_drawn_as_the_same_splats_near_it():
    means, *others = random_splats(11)
    far = np.array([524288.0, 4587520.0, 1024.0])
    view = looking((0.5, -0.2, -1), 0.3)
    moved = view.copy()
    moved[:3, 3] -= view[:3, :3] @ far
    Ks = intrinsics(96, 64, 70)[None]
    near, alphas, _ = rasterization(means, *others, view[None], Ks, 96, 64, render_mode="RGB+D")
    given = moved[None].copy()
    found, found_alphas, _ = rasterization(means + far, *others, given, Ks, 96, 64, render_mode="RGB+D")
    assert psnr(found, near) > 90 and psnr(found_alphas, alphas) > 90, (psnr(found, near), psnr(found_alphas, alphas))
    np.testing.assert_array_equal(given, moved[None], "the caller's cameras are not changed")


def test_negative_scales_and_opacities_beyond_1_are_drawn_as_by_gsplat():
    means, quats, scales, opacities, colors = random_splats(12)
    camera = np.eye(4)[None], intrinsics(96, 64, 70)[None], 96, 64
    expected, _, _ = rasterization(means, quats, scales, opacities, colors, *camera)
    for signs in ([-1, -1, -1], [-1, 1, 1]):
        found, _, _ = rasterization(means, quats, scales * np.float32(signs), opacities, colors, *camera)
        np.testing.assert_array_equal(found, expected)
    beyond = means, quats, scales, opacities * 3 - 1, colors
    drawn, _, _ = rasterization(*beyond, *camera)
    defined, _, _ = picture(*beyond, np.eye(4), camera[1][0], 96, 64, 0.01, 1e10, 0.3, None, False, pinhole)
    assert psnr(drawn[0], defined) > LEAST, psnr(drawn[0], defined)
