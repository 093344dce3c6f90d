"""Nobody waits for a compiler in front of a mosaic: what it needs was compiled while warming up."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.support.paths import ROOT

SCRIPT = """
import sys

import numpy as np
from numba.core.dispatcher import Dispatcher
from scipy.ndimage import gaussian_filter

from wafer_viewer.model.surface.height_map import HeightMap, Provenance
from wafer_viewer.reconstruct.stitching import stitch
from wafer_viewer.session.surface.worker_tasks import warm_up_stitching


def kernels():
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("wafer_viewer.")]
    return {(k.py_func.__qualname__, str(s)) for m in modules for k in vars(m).values() if isinstance(k, Dispatcher)
            for s in k.overloads}


def field(row, col):
    down, right = 100 * row + (row + col) % 3, 100 * col + (2 * row + col) % 3
    part = slice(down, down + 128), slice(right, right + 128)
    z, grey = tilt[part].astype(np.float32), picture[part]
    nothing = np.zeros(z.shape, np.uint8)
    return HeightMap(z, z, np.ones_like(z), grey, nothing, 1.0, 100.0 * col, -100.0 * row, Provenance(z_step_um=1.0))


warm_up_stitching()
warm = kernels()
noise = np.random.default_rng(3)
picture = (128 + 200 * gaussian_filter(noise.normal(0, 1, (360, 360)), 1.5)).clip(0, 255).astype(np.uint8)
tilt = np.add.outer(np.arange(360.0), 0.5 * np.arange(360.0)) / 50 + noise.normal(0, 0.1, (360, 360))
stitch([field(row, col) for row in range(3) for col in range(3)]).window()
print(*sorted(name for name, _ in kernels() - warm))
"""


@pytest.mark.slow
def test_fields_off_their_places_need_no_kernel_that_was_not_warmed_up() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []
