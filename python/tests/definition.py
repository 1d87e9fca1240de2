"""gsplat's definition of a picture in numpy and float64. It shares no code with splatgraph.

Gaussians are projected, and blended near to far in the pixels where their alpha is at least 1/255.
"""

import numpy as np

#: Real spherical harmonics up to degree 3, as functions of a unit vector, in the order of 3DGS files.
BASES = [
    lambda x, y, z: 0.28209479177387814 + 0 * x,
    lambda x, y, z: -0.4886025119029199 * y,
    lambda x, y, z: 0.4886025119029199 * z,
    lambda x, y, z: -0.4886025119029199 * x,
    lambda x, y, z: 1.0925484305920792 * x * y,
    lambda x, y, z: -1.0925484305920792 * y * z,
    lambda x, y, z: 0.31539156525252005 * (2 * z * z - x * x - y * y),
    lambda x, y, z: -1.0925484305920792 * x * z,
    lambda x, y, z: 0.5462742152960396 * (x * x - y * y),
    lambda x, y, z: -0.5900435899266435 * y * (3 * x * x - y * y),
    lambda x, y, z: 2.890611442640554 * x * y * z,
    lambda x, y, z: -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
    lambda x, y, z: 0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
    lambda x, y, z: -0.4570457994644658 * x * (4 * z * z - x * x - y * y),
    lambda x, y, z: 1.445305721320277 * z * (x * x - y * y),
    lambda x, y, z: -0.5900435899266435 * x * (x * x - 3 * y * y),
]


def rotations(quats):
    """Returns the matrices of quaternions w, x, y, z."""
    w, x, y, z = (quats / np.linalg.norm(quats, axis=1, keepdims=True)).T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        1,
    )


def shaded(sh, degree, directions):
    """Returns the colours of harmonics [N, K, 3], seen along unit vectors [N, 3]."""
    values = np.stack([base(*directions.T) for base in BASES[: (degree + 1) ** 2]], -1)
    return np.maximum(np.einsum("nk,nkc->nc", values, sh[:, : (degree + 1) ** 2]) + 0.5, 0.0)


def pinhole(x, y, z, fx, fy, cx, cy, width, height):
    """Returns positions relative to the principal point [N, 2], in pixels, and their Jacobians [N, 2, 3]."""
    # The Jacobian is evaluated at slopes clamped to the picture and a margin.
    margin = 0.3 * 0.5 * np.array([width / fx, height / fy])
    sx = np.clip(x / z, -cx / fx - margin[0], (width - cx) / fx + margin[0])
    sy = np.clip(y / z, -cy / fy - margin[1], (height - cy) / fy + margin[1])
    zero = np.zeros_like(z)
    jacobian = np.stack([np.stack([fx / z, zero, -fx * sx / z], -1), np.stack([zero, fy / z, -fy * sy / z], -1)], 1)
    return np.stack([fx * x / z, fy * y / z], -1), jacobian


def ortho(x, y, z, fx, fy, *_):
    """Returns positions relative to the principal point [N, 2], in pixels, and their Jacobians [N, 2, 3]."""
    jacobian = np.broadcast_to([[fx, 0.0, 0.0], [0.0, fy, 0.0]], (len(z), 2, 3))
    return np.stack([fx * x, fy * y], -1), jacobian


def fisheye(x, y, z, fx, fy, *_):
    """Returns positions and Jacobians like `pinhole`. Equidistant: the distance is the angle from the axis, times f."""
    rho, square = np.hypot(x, y), x * x + y * y + z * z
    theta = np.arctan2(rho, z)
    # The position is f * ratio * (x, y); the ratio is a function of rho and z.
    ratio = theta / rho
    by_rho, by_z = (z / square - ratio) / rho, -1 / square
    of_x = x[:, None] * np.stack([by_rho * x / rho, by_rho * y / rho, by_z], -1)
    of_y = y[:, None] * np.stack([by_rho * x / rho, by_rho * y / rho, by_z], -1)
    of_x[:, 0] += ratio
    of_y[:, 1] += ratio
    return np.stack([fx * ratio * x, fy * ratio * y], -1), np.stack([fx * of_x, fy * of_y], 1)


def picture(
    means,
    quats,
    scales,
    opacities,
    colors,
    viewmat,
    K,
    width,
    height,
    near=0.01,
    far=1e10,
    eps2d=0.3,
    sh_degree=None,
    antialiased=False,
    projection=pinhole,
):
    """Returns colours [height, width, D], alphas [height, width] and sums of depths [height, width] of one camera."""
    means, quats, scales, opacities, colors, view, K = (
        np.asarray(values, np.float64) for values in (means, quats, scales, opacities, colors, viewmat, K)
    )
    (fx, _, cx), (_, fy, cy), _ = K
    rotation, centre = view[:3, :3], -view[:3, :3].T @ view[:3, 3]
    # Sorted by depths in float32, like the implementations.
    local = means @ rotation.T + view[:3, 3]
    depth = local[:, 2]
    kept = np.flatnonzero((depth >= near) & (depth <= far))
    kept = kept[np.argsort(depth[kept].astype(np.float32), kind="stable")]

    if sh_degree is not None:
        directions = means - centre
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        colors = shaded(colors, sh_degree, directions)
    x, y, z = local[kept].T
    places, jacobian = projection(x, y, z, fx, fy, cx, cy, width, height)
    axes = rotations(quats[kept]) * scales[kept, None, :]
    projected = jacobian @ rotation @ axes
    covariance = projected @ projected.transpose(0, 2, 1)
    sharp = np.linalg.det(covariance)
    covariance += eps2d * np.eye(2)
    determinant = np.linalg.det(covariance)
    alpha_of = opacities[kept]
    if antialiased:
        alpha_of = alpha_of * np.sqrt(np.maximum(sharp / determinant, 0.0))
    inverse = np.linalg.inv(covariance)
    px, py = (places + [cx, cy]).T

    channels = np.concatenate([colors[kept], z[:, None]], -1)
    sums = np.zeros((height, width, channels.shape[1]))
    light = np.ones((height, width))
    done = np.zeros((height, width), bool)
    for i in range(len(kept)):
        if alpha_of[i] < 1 / 255:
            continue
        reach = np.sqrt(2 * np.log(255 * alpha_of[i]) * np.diagonal(covariance[i])) + 1
        left, top = (max(int(np.floor(c - r)), 0) for c, r in zip((px[i], py[i]), reach))
        right, bottom = (min(int(np.ceil(c + r)), n) for c, r, n in zip((px[i], py[i]), reach, (width, height)))
        if left >= right or top >= bottom:
            continue
        box = np.s_[top:bottom, left:right]
        # Pixels are sampled at their centres.
        dx = np.arange(left, right) + 0.5 - px[i]
        dy = (np.arange(top, bottom) + 0.5 - py[i])[:, None]
        power = 0.5 * (inverse[i, 0, 0] * dx * dx + inverse[i, 1, 1] * dy * dy) + inverse[i, 0, 1] * dx * dy
        alpha = np.minimum(0.999, alpha_of[i] * np.exp(-power))
        alpha[(alpha < 1 / 255) | done[box]] = 0.0
        after = light[box] * (1 - alpha)
        # A pixel is finished before the Gaussian that would lower its transmittance to 1e-4 or less.
        ends = (after <= 1e-4) & (alpha > 0)
        done[box] |= ends
        share = np.where(ends, 0.0, light[box] * alpha)
        sums[box] += share[..., None] * channels[i]
        light[box] -= share
    return sums[..., :-1], 1 - light, sums[..., -1]
