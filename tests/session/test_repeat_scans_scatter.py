"""Two scans of the same plan on the virtual rig scatter by the noise of its camera, about the same heights."""

from __future__ import annotations

import numpy as np
import pytest

import wafer_viewer as wv
from tests.support.plans import die_beside_its_trench
from wafer_viewer.cli.app import main

pytestmark = pytest.mark.slow

PLAN = die_beside_its_trench(12, z_start_um=0.0)


@pytest.mark.campaign
def test_repeats_scatter_without_a_seed_and_are_identical_with_one(tmp_path):
    (tmp_path / "plan.toml").write_text(PLAN)
    (tmp_path / "rig.toml").write_text("seed = 3\n")
    stacks = {}
    for name, rig in (("a", ()), ("b", ()), ("c", ("--rig", "rig.toml")), ("d", ("--rig", "rig.toml"))):
        out, words = tmp_path / f"{name}.wafer", [str(tmp_path / word) if "." in word else word for word in rig]
        assert main(["scan", str(tmp_path / "plan.toml"), "-o", str(out), *words]) == 0
        stacks[name] = wv.Dataset.open(out).stack(1)
    np.testing.assert_array_equal(stacks["c"].images, stacks["d"].images)
    one, other = stacks["a"].images.astype(np.float32), stacks["b"].images.astype(np.float32)
    assert np.mean(one != other) > 0.4
    assert abs(float((one - other).mean())) < 0.05, "the same scene"
    heights = [wv.reconstruct(stacks[name]) for name in "ab"]
    both = heights[0].measured & heights[1].measured
    difference_um = (heights[0].z_raw_um - heights[1].z_raw_um)[both]
    repeatability_um = float(np.median(np.abs(difference_um))) / 0.6745 / np.sqrt(2)
    assert 0.005 < repeatability_um < 1.0
    assert abs(float(np.median(difference_um))) < 0.05
