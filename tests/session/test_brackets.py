"""A scan with two exposures at each z, on the virtual rig: the die is dark where the trench is not yet clipped."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

import wafer_viewer as wv
from tests.support.plans import die_beside_its_trench
from wafer_viewer.cli.app import main
from wafer_viewer.rigs.virtual.scenes.catalogue import scene

pytestmark = pytest.mark.slow

PLAN = die_beside_its_trench(20, exposures_us="[60.0, 240.0]")


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    folder = tmp_path_factory.mktemp("brackets")
    (folder / "plan.toml").write_text(PLAN)
    (folder / "rig.toml").write_text("seed = 0\n")
    words = [folder / "plan.toml", "--rig", folder / "rig.toml", "-o", folder / "scan.wafer"]
    assert main(["scan", *map(str, words)]) == 0
    return folder / "scan.wafer"


@pytest.mark.campaign
def test_both_exposures_together_measure_more_than_either(scan):
    data = wv.Dataset.open(scan)
    fused = wv.reconstruct(data.stack(1))
    alone = [wv.reconstruct(data.stack(1, exposure)) for exposure in (0, 1)]
    assert fused.measured.mean() > 1.02 * max(one.measured.mean() for one in alone)
    ratio = re.fullmatch("2 exposures were fused, the longer ones x(.*) as bright .*", fused.provenance.notes[0])[1]
    assert float(ratio) == pytest.approx(4.0, rel=0.02)
    assert fused.all_in_focus.dtype == np.uint16


@pytest.mark.campaign
def test_exposures_taken_in_turn_give_dark_and_bright_areas_the_same_heights(scan):
    """They lie half a step apart in z, 1.5 um: without regard to it the areas would differ by .6 um."""
    data = wv.Dataset.open(scan)
    stack = data.stack(1)
    assert data.scan.plan.strategy == "z_alternating"
    np.testing.assert_allclose(stack.exposure_z_um[1] - stack.exposure_z_um[0], 1.5, atol=0.01)
    heights = wv.reconstruct(stack)
    regardless = wv.reconstruct(dataclasses.replace(stack, exposure_z_um=()))
    rows, cols = heights.z_raw_um.shape
    x_um, y_um = heights.x0_um + np.arange(cols) * heights.pixel_um, heights.y0_um - np.arange(rows) * heights.pixel_um
    truth_um = scene("wafer").truth(*np.meshgrid(x_um, y_um))
    brightest = stack.brackets[0].images.max(0)

    def difference_um(found):
        off_um = found.z_raw_um - truth_um
        return float(np.nanmedian(off_um[brightest == 255]) - np.nanmedian(off_um[brightest < 200]))

    assert abs(difference_um(heights)) < 0.3
    assert difference_um(regardless) > difference_um(heights) + 0.5


@pytest.mark.campaign
def test_the_command_line_fuses_them_too(scan, tmp_path):
    assert main(["reconstruct", str(scan), "-o", str(tmp_path / "a.npz")]) == 0
    stored = wv.Dataset.open(scan).result("default")
    surface = stored.surface(wv.Dataset.open(scan).field(1))
    assert "2 exposures were fused" in surface.provenance.notes[0]
    assert surface.all_in_focus.dtype == np.uint16
