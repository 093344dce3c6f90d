"""A scan with two exposures at each z, on the virtual rig: the die is dark where the trench is not yet clipped."""

from __future__ import annotations

import numpy as np
import pytest

import wafer_viewer as wv
from wafer_viewer.cli.app import main

pytestmark = pytest.mark.slow

PLAN = """
z_start_um = -6.0
exposures_us = [60.0, 240.0]
[grid]
rows = 1
cols = 1
field_width_um = 336.4488
field_height_um = 252.3366
x0_um = 800.0
y0_um = 560.0
[sweep]
z_step_um = 3.0
n_frames = 20
"""


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    folder = tmp_path_factory.mktemp("brackets")
    (folder / "plan.toml").write_text(PLAN)
    assert main(["scan", str(folder / "plan.toml"), "-o", str(folder / "scan.wafer")]) == 0
    return folder / "scan.wafer"


def test_both_exposures_together_measure_more_than_either(scan):
    data = wv.Dataset.open(scan)
    fused = wv.reconstruct(data.stack(1))
    alone = [wv.reconstruct(data.stack(1, exposure)) for exposure in (0, 1)]
    assert fused.measured.mean() > 1.02 * max(one.measured.mean() for one in alone)
    assert "2 exposures were fused, the longer ones x4" in fused.provenance.notes[0]
    assert fused.all_in_focus.dtype == np.uint16


def test_the_command_line_fuses_them_too(scan, tmp_path):
    assert main(["reconstruct", str(scan), "-o", str(tmp_path / "a.npz")]) == 0
    stored = wv.Dataset.open(scan).result("default")
    surface = stored.surface(wv.Dataset.open(scan).field(1))
    assert "2 exposures were fused" in surface.provenance.notes[0]
    assert surface.all_in_focus.dtype == np.uint16
