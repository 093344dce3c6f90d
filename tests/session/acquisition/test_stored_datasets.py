"""Datasets of earlier commits are opened, continued with the file of their plan, checked and reconstructed."""

from __future__ import annotations

import tarfile
from pathlib import Path

import numpy as np
import pytest
import tifffile

import wafer_viewer as wv
from wafer_viewer.__main__ import main
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits
from wafer_viewer.session.acquisition.headless import scan_to
from wafer_viewer.session.planning.revision_trial import job_of_wafer
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.scan_record import frames_file
from wafer_viewer.store.io.format_version import SCHEMA, version_of

STORED = Path(__file__).parents[2] / "support" / "stored"
KEPT = {"a16ad82": 41, "64568740": 40}
"""Commits, and the frames that count: at the first one also those of a pass that did not end."""


@pytest.mark.parametrize("commit", KEPT)
def test_stored_dataset_is_continued_checked_and_reconstructed(commit, tmp_path, capsys):
    with tarfile.open(STORED / f"{commit}.tar.xz") as archive:
        archive.extractall(tmp_path, filter="data")
    plan, path, warned = tmp_path / "plan.toml", tmp_path / "unfinished.wafer", []
    begun = Dataset.open(path)
    before = images_of(begun, begun.kept())
    assert (len(before), begun.finished, begun.complete_fields()) == (KEPT[commit], False, {1, 2})

    rig = VirtualRig(limits=virtual_limits(96, 128), seed=0)
    try:
        ended = scan_to(path, job_of_wafer(plan, path, {}, ()), rig, lambda _: None, pytest.fail, warned.append)
    finally:
        rig.close()
    assert (ended.error, ended.stopped, ended.words) == (None, False, "60 of 60 frames kept")
    assert all("keeps the values of recipe that it was started with" in text for text in warned)
    data = Dataset.open(path)
    assert (data.finished, data.scan.schema_version) == (True, version_of(SCHEMA, compressed=False))
    after = images_of(data, before)
    assert all(np.array_equal(after[shot], image) for shot, image in before.items())
    assert main(["check", str(path)]) == 0, capsys.readouterr()

    for number in (1, 3):
        height = wv.reconstruct(data.stack(number), data.scan.job.recipe)
        assert np.isfinite(height.z_um).mean() > 0.8
        truth_um = rig.truth_for_tests(*pixel_places(height))
        assert np.nanmedian(np.abs(height.z_um - truth_um)) < 1.0


def images_of(data, shots):
    pages = {field: tifffile.imread(frames_file(data.path, data.field(field))) for field in {s.field for s in shots}}
    return {shot: pages[shot.field][shot.k] for shot in shots}


def pixel_places(height):
    rows, cols = height.z_um.shape
    x_um = height.x0_um + np.arange(cols) * height.pixel_um
    y_um = height.y0_um - np.arange(rows) * height.pixel_um
    return np.meshgrid(x_um, y_um)
