"""Nobody waits for a compiler in front of a field: what a field needs was compiled while warming up."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import dataclasses, sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.reconstruct.field_pipeline import reconstruct, warm_up
from wafer_viewer.reconstruct.focus_evidence import focus_curve

def kernels():
    modules = [m for name, m in sys.modules.items() if name.startswith("wafer_viewer.")]
    return {(k.py_func.__qualname__, str(s)) for m in modules for k in vars(m).values() if isinstance(k, Dispatcher)
            for s in k.overloads}

warm_up()
warm = kernels()
n, rows, cols = 30, 150, 260
noise = np.random.default_rng(1)
sharp = np.exp(-(np.arange(n) - 15.0) ** 2 / 8)[:, None, None]
light = np.where(np.arange(cols) < 130, 40.0, 150.0)
images = light + sharp * noise.normal(0, 20, (rows, cols)) + noise.normal(0, 1, (n, rows, cols))
images[:, 40:90, 200:250] = 150.0
np.save(sys.argv[1], images.clip(0, 255).astype(np.uint8))
mapped = np.load(sys.argv[1], mmap_mode="r")
field = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=0.0)
stack = FieldStack(field, mapped, np.arange(float(n)), np.ones(n, bool), 0.5)
surface = reconstruct(stack, threads=2)
focus_curve(stack, stack.x0_um + 20, stack.y0_um - 20, surface.provenance.recipe)
every_second = dataclasses.replace(stack, images=mapped[::2], z_um=stack.z_um[::2], present=stack.present[::2])
reconstruct(every_second, threads=1)
print(*sorted(name for name, _ in kernels() - warm))
"""


@pytest.mark.slow
def test_a_field_needs_no_kernel_that_was_not_warmed_up(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT, str(tmp_path / "field.npy")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []
