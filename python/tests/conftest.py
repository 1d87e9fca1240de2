"""Shared helpers: captured scenes, random scenes, and PSNR."""

import os
import pathlib
import sys

import numpy as np
import pytest
import splatgraph

ROOT = pathlib.Path(__file__).parents[2]


def psnr(a, b, peak=None):
    """Returns the peak signal-to-noise ratio in dB. By default, the peak is 1, or the maximum of `abs(b)` if that is larger."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    peak = max(1.0, np.abs(b).max()) if peak is None else peak
    error = np.mean((a - b) ** 2)
    return np.inf if error == 0 else 10 * np.log10(peak**2 / error)


def captured(name):
    """Returns the path of a captured scene, or skips the test."""
    folder = os.environ.get("SPLATGRAPH_DATA")
    if folder is None:
        pytest.skip("SPLATGRAPH_DATA is not set")
    return pathlib.Path(folder) / "scenes" / name


def random_splats(seed, count=400, degree=None):
    """Returns means, quats, scales, opacities and colours (or harmonics) of Gaussians in front of a camera at the origin."""
    rng = np.random.default_rng(seed)
    means = rng.uniform((-2, -1.5, 0.1), (2, 1.5, 8), (count, 3)).astype(np.float32)
    quats = rng.normal(size=(count, 4)).astype(np.float32)
    scales = np.exp(rng.uniform(np.log(0.005), np.log(0.5), (count, 3))).astype(np.float32)
    opacities = rng.uniform(0, 1, count).astype(np.float32)
    if degree is None:
        return means, quats, scales, opacities, rng.uniform(0, 1, (count, 3)).astype(np.float32)
    return means, quats, scales, opacities, rng.normal(0, 0.4, (count, (degree + 1) ** 2, 3)).astype(np.float32)


def intrinsics(width, height, focal):
    """Returns K of a camera with the principal point in the middle."""
    return np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], np.float32)


def pytest_terminal_summary(terminalreporter):
    """Reports skipped tests in the form of the workspace's Rust tests."""
    for report in terminalreporter.stats.get("skipped", []):
        print(f"NOT RUN: {report.nodeid}: {report.longrepr[2]}", file=sys.stderr)


@pytest.fixture
def scene():
    """A small random scene with harmonics of degree 1."""
    return splatgraph.Scene.from_arrays(*random_splats(7, 300, 1))


@pytest.fixture
def camera():
    """A camera at the origin."""
    return splatgraph.Camera(np.eye(4), intrinsics(64, 48, 60), 64, 48, "origin")
