"""gsplat's `rasterization`, drawn by splatgraph.

gsplat's rules differ in two numbers from the published rasteriser's, which the graphs follow by default: the near plane is an argument,
and a fragment's alpha is capped at 0.999. The alpha cap is a parameter of the graphs. The near plane is not: the world is scaled so that
`near_plane` is at the graphs' own near plane; the picture is the same at any scale. Other camera models are the graphs' projections, with
gsplat's order: by z, not by the distance from the camera.
"""

from __future__ import annotations

import contextlib
import math
import operator
import sys
import threading
from collections.abc import Iterator
from typing import Any, Literal

import numpy as np

from ._arrays import array
from ._native import Camera, Scene
from ._renderer import Renderer, pair_of_sides

#: The graphs' near plane, in world units.
NEAR = 0.2
#: The graphs' largest scale, in world units.
LARGEST = 1e18
#: Spacing of the possible origins of a world with float64 means, in world units.
STEP = 1024.0
#: The constant spherical harmonic.
SH_0 = 0.28209479177387814
#: gsplat's rules, and 32-bit floats throughout.
PARAMS = {"record": "f32", "sh_storage": "f32", "stop_after": "splat", "alpha_cap": 0.999}

#: The graphs' projection for each of gsplat's camera models.
PROJECTIONS = {"pinhole": "pinhole", "ortho": "orthographic", "fisheye": "fisheye"}

RenderMode = Literal["RGB", "D", "ED", "RGB+D", "RGB+ED"]
_MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED")

#: One renderer for each requested device, with the lock that a call holds while it draws.
_renderers: dict[str | None, tuple[Renderer, threading.Lock]] = {}
_renderers_lock = threading.Lock()


class Meta(dict[str, Any]):
    """The entries of gsplat's `meta` that splatgraph provides."""

    def __missing__(self, key: str) -> Any:
        raise KeyError(f"{key}: intermediate results stay on the device; available: {', '.join(self)}")


def rasterization(
    means: Any,
    quats: Any,
    scales: Any,
    opacities: Any,
    colors: Any,
    viewmats: Any,
    Ks: Any,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    packed: bool = True,
    tile_size: int = 16,
    backgrounds: Any = None,
    render_mode: RenderMode = "RGB",
    sparse_grad: bool = False,
    absgrad: bool = False,
    rasterize_mode: Literal["classic", "antialiased"] = "classic",
    channel_chunk: int = 32,
    distributed: bool = False,
    camera_model: Literal["pinhole", "ortho", "fisheye"] = "pinhole",
    segmented: bool = False,
    covars: Any = None,
    with_ut: bool = False,
    with_eval3d: bool = False,
    radial_coeffs: Any = None,
    tangential_coeffs: Any = None,
    thin_prism_coeffs: Any = None,
    ftheta_coeffs: Any = None,
    rolling_shutter: Any = None,
    viewmats_rs: Any = None,
    *,
    device: str | int | None = None,
) -> tuple[Any, Any, Meta]:
    """Draws Gaussians with gsplat 1.5.3's names, shapes and conventions. There are no gradients.

    Arrays are numpy's, or have `__dlpack__` and are in CPU memory, such as torch's; `...` stands for any batch dimensions. To draw one
    scene from many cameras, pass them in one call, or use `Renderer`, which keeps the scene on the device.

    Args:
        means: centres in world units, [..., N, 3]. In float64, they keep their precision far from 0.
        quats: rotations w, x, y, z, of any length but 0, [..., N, 4].
        scales: standard deviations along the axes in world units, [..., N, 3].
        opacities: opacities at the centres, 0 to 1, [..., N].
        colors: colours of D channels, [..., N, D] or for each camera [..., C, N, D]; with `sh_degree`, spherical harmonics,
            [..., N, K, 3] or [..., C, N, K, 3].
        viewmats: world to camera, with x to the right, y down and z forward, [..., C, 4, 4].
        Ks: intrinsics in pixels, [..., C, 3, 3]; the middle of the first pixel is at 0.5.
            Focal lengths are pixels per world unit for "ortho", and pixels per radian for "fisheye".
        width: width of the pictures, in pixels.
        height: height of the pictures, in pixels.
        near_plane: minimum depth of a drawn centre, in world units, above 0.
        far_plane: maximum depth of a drawn centre, in world units.
        radius_clip: only 0 is supported.
        eps2d: added to the variances in the picture, in square pixels: 0.3 or 0.
        sh_degree: degree of the harmonics to evaluate, 0 to 3; (sh_degree + 1)^2 <= K.
        backgrounds: colours behind the Gaussians, [..., C, D]. Depths have none.
        render_mode: "RGB" for colours, "D" for depths (the sum of the Gaussians' depths, weighted by their share of the pixel), "ED" for
            depths divided by alpha, or "RGB+D" or "RGB+ED" for both, depth last. Depths are along z, in world units.
        rasterize_mode: "antialiased" compensates for the opacity that `eps2d` adds.
        camera_model: "pinhole"; "ortho", which draws (x, y, z) at (fx x + cx, fy y + cy); or "fisheye", equidistant, without distortion.
        covars: covariances in square world units instead of `quats` and `scales`, [..., N, 3, 3].
        device: a part of the device's name, or its index in `splatgraph devices`.
        tile_size: side of the tiles that the dict of sizes and counts is for, in pixels, at least 1; it does not affect pictures.
        packed, channel_chunk, segmented: ignored, because they do not affect pictures.
        sparse_grad, absgrad, distributed, with_ut, with_eval3d, radial_coeffs, tangential_coeffs, thin_prism_coeffs,
            ftheta_coeffs, rolling_shutter, viewmats_rs: not supported except for the defaults.

    Returns:
        Colours [..., C, height, width, X] and alphas [..., C, height, width, 1], float32, in the array library of `means`, and a
        dict with sizes and counts. X is D, 1 or D + 1 by `render_mode`.

    Raises:
        NotImplementedError: the named argument has an unsupported value.
        ValueError: the named argument has a wrong shape or range.
        TypeError: the named argument is not an array of numbers, or not an integer.
        DeviceError: no suitable device was found, or the device failed.
    """
    _refuse_unsupported(
        {
            "sparse_grad": sparse_grad,
            "absgrad": absgrad,
            "distributed": distributed,
            "with_ut": with_ut,
            "with_eval3d": with_eval3d,
            "radial_coeffs": radial_coeffs,
            "tangential_coeffs": tangential_coeffs,
            "thin_prism_coeffs": thin_prism_coeffs,
            "ftheta_coeffs": ftheta_coeffs,
            "viewmats_rs": viewmats_rs,
            # In gsplat's enum, GLOBAL is the shutter that does not roll.
            "rolling_shutter": None if getattr(rolling_shutter, "name", None) == "GLOBAL" else rolling_shutter,
        }
    )
    if camera_model not in PROJECTIONS:
        raise NotImplementedError(f"camera_model: expected one of {', '.join(PROJECTIONS)}, found {camera_model!r}")
    if radius_clip != 0.0:
        raise NotImplementedError(f"radius_clip: expected 0, found {radius_clip}")
    if eps2d not in (0.0, 0.3):
        raise NotImplementedError(f"eps2d: expected 0.3 or 0, found {eps2d}")
    if render_mode not in _MODES:
        raise ValueError(f"render_mode: expected one of {', '.join(_MODES)}, found {render_mode!r}")
    if rasterize_mode not in ("classic", "antialiased"):
        raise ValueError(f"rasterize_mode: expected 'classic' or 'antialiased', found {rasterize_mode!r}")
    if tile_size < 1:
        raise ValueError(f"tile_size: expected a number above 0, found {tile_size}")
    if sh_degree is not None:
        try:
            sh_degree = operator.index(sh_degree)
        except TypeError:
            raise TypeError(f"sh_degree: expected an integer or None, found {sh_degree!r}") from None
    width, height = pair_of_sides((width, height), "width, height")
    if not 0.0 < near_plane < far_plane:
        raise ValueError(f"near_plane: expected a number above 0 and below far_plane = {far_plane}, found {near_plane}")

    library = means
    means = array(means, "means", dtype=None)
    if means.ndim < 2 or means.shape[-1] != 3:
        raise ValueError(f"means: expected the shape [..., N, 3], found {list(means.shape)}")
    if means.dtype not in (np.float16, np.float32):
        means = means.astype(np.float64)
    batch, count = means.shape[:-2], means.shape[-2]
    if covars is None:
        quats = array(quats, "quats", (*batch, count, 4))
        scales = array(scales, "scales", (*batch, count, 3))
    else:
        quats, scales = _axes(array(covars, "covars", (*batch, count, 3, 3), np.float64))
    opacities = array(opacities, "opacities", (*batch, count))
    viewmats = array(viewmats, "viewmats", (*batch, None, 4, 4), np.float64)
    cameras = viewmats.shape[-3]
    if cameras == 0:
        raise ValueError(f"viewmats: expected at least one camera, found the shape {list(viewmats.shape)}")
    Ks = array(Ks, "Ks", (*batch, cameras, 3, 3), np.float64)
    colors = array(colors, "colors")
    channels, of_camera = _check_colors(colors, sh_degree, batch, cameras, count)
    if backgrounds is not None:
        backgrounds = array(backgrounds, "backgrounds", (*batch, cameras, channels))

    shape = (math.prod(batch), cameras, height, width)

    def flat(values: np.ndarray) -> np.ndarray:
        return values.reshape((shape[0], *values.shape[len(batch) :]))

    means, quats, scales, opacities, viewmats, Ks, colors = map(flat, (means, quats, scales, opacities, viewmats, Ks, colors))
    has_colors, has_depth = render_mode.startswith("RGB"), render_mode != "RGB"
    drawn = np.zeros((*shape, channels if has_colors else 0), np.float32)
    alphas = np.zeros((*shape, 1), np.float32)
    depths = np.zeros((*shape, 1), np.float32)
    low_pass = "none" if eps2d == 0.0 else "compensated" if rasterize_mode == "antialiased" else "dilated"
    # The picture is the same in a world of any scale.
    scale = np.float32(NEAR / near_plane)
    largest = float(np.max(np.abs(scales), initial=0.0, where=np.isfinite(scales)))
    if largest * float(scale) > LARGEST:
        smallest = NEAR * largest / LARGEST
        raise ValueError(f"near_plane: expected at least {smallest:.1e} for scales of up to {largest:.1e}, found {near_plane}")
    projection = PROJECTIONS[camera_model]
    params = {**PARAMS, "low_pass": low_pass, "projection": projection}
    outputs = ["alpha", "depth"] if has_depth else ["alpha"]
    with _renderer(device, params) as renderer:
        for b in range(shape[0]):
            # Doubles far from 0 would be rounded. The picture is the same in a world that is moved with its cameras.
            origin = _origin(means[b])
            places = (means[b] - origin).astype(np.float32)
            moved = viewmats[b].copy()
            moved[:, :3, 3] += moved[:, :3, :3] @ origin
            views = [_camera(moved[c], Ks[b, c], (width, height), projection, float(scale), c) for c in range(cameras)]
            z = places.astype(np.float64) @ moved[:, 2, :3].T + moved[:, 2, 3]
            too_far = z > far_plane
            # Cameras share a scene unless they have their own colours, or the far plane hides splats.
            step = 1 if of_camera or too_far.any() else cameras
            for first in range(0, cameras, step):
                group = slice(first, first + step)
                shown = np.where(too_far[:, group].any(axis=1), np.float32(0.0), opacities[b])
                splats = (places * scale, quats[b], scales[b] * scale, shown)
                for channel, sh, least in _harmonics(colors[b, first] if of_camera else colors[b], sh_degree, has_colors):
                    scene = Scene.from_arrays(*splats, sh, _checked=False)
                    if len(scene) == 0:
                        # The graphs need a splat. Without one, only the background is left.
                        continue
                    renderer.show(scene)
                    for c, (picture, found) in enumerate(renderer.render_many(views[group], outputs=outputs), first):
                        alphas[b, c, ..., 0] = found["alpha"]
                        if has_depth:
                            depths[b, c, ..., 0] = found["depth"] / scale
                        mine = drawn[b, c, ..., channel : channel + 3]
                        mine += picture[..., : mine.shape[-1]] + least[: mine.shape[-1]] * alphas[b, c]
    if backgrounds is not None:
        drawn += (1.0 - alphas) * flat(backgrounds)[:, :, None, None, : drawn.shape[-1]]
    if render_mode.endswith("ED"):
        depths /= np.maximum(alphas, np.float32(1e-10))
    if has_depth:
        drawn = np.concatenate([drawn, depths], axis=-1)
    meta = Meta(
        width=width,
        height=height,
        n_batches=shape[0],
        n_cameras=cameras,
        tile_size=tile_size,
        tile_width=math.ceil(width / tile_size),
        tile_height=math.ceil(height / tile_size),
    )
    drawn, alphas = (values.reshape((*batch, *values.shape[1:])) for values in (drawn, alphas))
    return _like(library, drawn), _like(library, alphas), meta


def _refuse_unsupported(arguments: dict[str, Any]) -> None:
    for name, value in arguments.items():
        shape = getattr(value, "shape", None)
        if name.endswith("_coeffs") and shape is not None and not bool((value != 0).any()):
            # A lens without distortion.
            continue
        if value is not None and value is not False:
            found = repr(value) if shape is None else f"an array of shape {tuple(shape)}"
            raise NotImplementedError(f"{name}: not supported, found {found}")


def _origin(means: np.ndarray) -> np.ndarray:
    """Returns the origin of a world with float64 means, near their median, like `Scene.offset`; 0 for other types, or if none is finite."""
    finite = np.isfinite(means).all(axis=1)
    if means.dtype != np.float64 or not finite.any():
        return np.zeros(3, means.dtype)
    middle: np.ndarray = np.median(means[finite], axis=0)
    return np.round(middle / STEP) * STEP + 0.0


def _axes(covars: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Decomposes covariances into rotations (w, x, y, z) and standard deviations."""
    variances, axes = np.linalg.eigh(covars)
    # Makes the axes right-handed: the sign of an axis does not change the covariance.
    axes[..., 0] *= np.sign(np.linalg.det(axes))[..., None]
    # The quaternion is the eigenvector of the largest eigenvalue of this matrix (Bar-Itzhack 2000).
    m = np.moveaxis(axes, (-2, -1), (0, 1))
    k = np.empty((*axes.shape[:-2], 4, 4))
    k[..., 0, 0] = m[0, 0] + m[1, 1] + m[2, 2]
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        k[..., 0, a + 1] = k[..., a + 1, 0] = m[c, b] - m[b, c]
        k[..., a + 1, a + 1] = m[a, a] - m[b, b] - m[c, c]
        k[..., b + 1, c + 1] = k[..., c + 1, b + 1] = m[b, c] + m[c, b]
    quats = np.linalg.eigh(k)[1][..., -1]
    return quats.astype(np.float32), np.sqrt(np.maximum(variances, 0.0)).astype(np.float32)


def _check_colors(colors: np.ndarray, sh_degree: int | None, batch: tuple[int, ...], cameras: int, count: int) -> tuple[int, bool]:
    """Returns the number of channels of colours, and whether each camera has its own."""
    tail = 1 if sh_degree is None else 2
    of_camera = colors.ndim == len(batch) + 2 + tail
    leading = (*batch, cameras, count) if of_camera else (*batch, count)
    if colors.ndim != len(leading) + tail or colors.shape[: len(leading)] != leading or (tail == 2 and colors.shape[-1] != 3):
        wanted = "[..., (C,) N, D]" if sh_degree is None else "[..., (C,) N, K, 3]"
        raise ValueError(f"colors: expected the shape {wanted} with C = {cameras} and N = {count}, found {list(colors.shape)}")
    if sh_degree is None:
        return colors.shape[-1], of_camera
    if not 0 <= sh_degree <= 3:
        raise NotImplementedError(f"sh_degree: expected 0 to 3, found {sh_degree}")
    if (sh_degree + 1) ** 2 > colors.shape[-2]:
        raise ValueError(f"colors: expected K of at least {(sh_degree + 1) ** 2} for sh_degree = {sh_degree}, found {colors.shape[-2]}")
    return 3, of_camera


def _camera(view: np.ndarray, K: np.ndarray, size: tuple[int, int], projection: str, scale: float, index: int) -> Camera:
    """Returns the camera in the world scaled by `scale`. `index` is for messages."""
    view, K = view.copy(), K.copy()
    view[:3, 3] *= scale
    if projection == "orthographic":
        # Pixels per world unit.
        K[0, 0] /= scale
        K[1, 1] /= scale
    try:
        return Camera(view, K, *size, projection=projection)
    except (ValueError, NotImplementedError) as error:
        raise type(error)(f"viewmats, Ks: camera {index}: {error}") from None


def _harmonics(colors: np.ndarray, sh_degree: int | None, is_shown: bool) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Lists the harmonics of colours, three channels at a time: first channel, harmonics, and the value subtracted from each channel."""
    if is_shown and sh_degree is not None:
        yield 0, colors[:, : (sh_degree + 1) ** 2], np.zeros(3, np.float32)
        return
    channels = colors.shape[-1] if is_shown else 0
    # One picture is drawn even without channels, for its alphas and depths.
    for first in range(0, max(channels, 1), 3):
        three = np.zeros((len(colors), 3), np.float32)
        three[:, : channels - first] = colors[:, first : first + 3] if is_shown else 0.0
        # Colours of splats are clamped at 0, so negative ones are shifted.
        least = three.min(axis=0, initial=0.0, where=np.isfinite(three))
        yield first, ((three - least - 0.5) / SH_0)[:, None], least


@contextlib.contextmanager
def _renderer(device: str | int | None, params: dict[str, Any]) -> Iterator[Renderer]:
    """Yields the device's renderer, locked for this call. It stays open for the next call."""
    name = None if device is None else str(device)
    with _renderers_lock:
        if name not in _renderers:
            nothing = np.zeros((0, 1), np.float32)
            scene = Scene.from_arrays(*(nothing.repeat(k, axis=1) for k in (3, 4, 3)), nothing[:, 0], nothing.repeat(3, axis=1)[:, None])
            _renderers[name] = Renderer(scene, device=device), threading.Lock()
        renderer, lock = _renderers[name]
    with lock:
        renderer.use("auto", params)
        yield renderer


def _like(given: Any, values: np.ndarray) -> Any:
    """Converts to an array of `given`'s library, such as torch; returns numpy's if the library has no `from_dlpack`."""
    library = sys.modules.get(type(given).__module__.partition(".")[0])
    convert = None if isinstance(given, np.ndarray) else getattr(library, "from_dlpack", None)
    return values if convert is None else convert(values)
