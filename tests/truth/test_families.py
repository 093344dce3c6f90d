"""Families of scenes by seed: the same bits again, samples within the sweep, and a truth that the pictures show."""

from __future__ import annotations

import subprocess
import sys
from functools import cache

import numpy as np
import pytest

from tests.bench.bench_families import judge
from tests.bench.recipes import plain
from tests.support.paths import ROOT
from tests.truth.families import FAMILIES, FamilyScene, family_scene

SEED = 4
"""Layers of `trenches` and rays of `bumps`; others have one renderer."""


@cache
def drawn(family: str) -> FamilyScene:
    return family_scene(family, SEED)


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("family", FAMILIES)
def test_a_seed_gives_the_same_bits_again(family):
    again = family_scene(family, SEED)
    assert np.array_equal(drawn(family).stack.images, again.stack.images)
    assert np.array_equal(drawn(family).truth_um, again.truth_um)


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("family", FAMILIES)
def test_the_sweep_covers_the_sample(family):
    scene = drawn(family)
    low_um, high_um = scene.stack.z_um[[0, -1]]
    assert low_um < scene.truth_um.min() < scene.truth_um.max() < high_um


@pytest.mark.slow
@pytest.mark.parametrize("family", ["print", "textbook", "bumps", "metal", "boards"])
def test_pictures_are_sharpest_at_the_true_height(family):
    scene = drawn(family)
    off_um = plain("tenengrad", scene.stack).z_um - scene.truth_um
    assert abs(np.median(off_um)) < scene.step_um
    assert np.mean(np.abs(off_um) < max(2 * scene.step_um, scene.right_um)) > 0.6


@pytest.mark.slow
def test_a_wrong_truth_makes_all_heights_false():
    scene = drawn("bumps")
    wrong = FamilyScene(
        "", scene.stack, scene.truth_um + np.float32(5 * scene.depth_of_field_um), scene.sharp_grey, 0.0
    )
    right, false = judge("bumps", SEED, scene), judge("bumps", SEED, wrong)
    assert right.false_of_kept < 0.01 < 0.9 < right.right / right.known
    assert false.false_of_kept > 0.99


@pytest.mark.campaign
def test_the_command_prints_a_row_for_each_family():
    command = ("tests/bench/bench_families.py", "--quick", "--families", "boards", "bumps", "--from", str(SEED))
    told = subprocess.run([sys.executable, *command], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert [line.split()[:2] for line in told.splitlines()[-3:]] == [["boards", "1"], ["bumps", "1"], ["all", "2"]]
