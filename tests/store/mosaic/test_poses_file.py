"""Poses are kept with everything the overlaps said."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.surface.field_poses import Form, HeightOffsets, Poses, Shifts
from wafer_viewer.store.mosaic.poses_file import read_poses, write_poses, write_poses_csv

NUMBERS = np.random.default_rng(1)


def _table(kind: type, n: int, **valid: object) -> dict[str, object]:
    fresh = {f.name: NUMBERS.normal(size=n) for f in dataclasses.fields(kind) if "Numbers" in str(f.type)}
    full = {f.name: NUMBERS.integers(0, 5, n) for f in dataclasses.fields(kind) if "NDArray" in str(f.type)}
    return fresh | full | valid


def some_poses() -> Poses:
    shifts = Shifts(**_table(Shifts, 4))
    seams = HeightOffsets(**_table(HeightOffsets, 4, information=NUMBERS.normal(size=(4, 3, 3))))
    form = Form(names=("height", "bow"), u_um=(0.5, 0.25), camera_turn=1e-3, u_camera_turn=1e-5)
    return Poses(**_table(Poses, 3, shifts=shifts, seams=seams, form=form, notes=("Field 3 stands alone.",)))


def test_poses_come_back_as_they_were(tmp_path: Path) -> None:
    poses = some_poses()
    write_poses(poses, tmp_path / "poses.npz")
    again = read_poses(tmp_path / "poses.npz")
    assert again.form == poses.form
    assert again.notes == poses.notes
    for table, stored in ((poses, again), (poses.shifts, again.shifts), (poses.seams, again.seams)):
        for item in dataclasses.fields(table):
            if isinstance(value := getattr(table, item.name), np.ndarray):
                np.testing.assert_array_equal(getattr(stored, item.name), value)


def test_poses_of_older_versions_have_a_square_stage(tmp_path: Path) -> None:
    file = tmp_path / "poses.npz"
    write_poses(some_poses(), file)
    with np.load(file) as stored:
        kept = {name: stored[name] for name in stored.files if not name.endswith(("_stretch", "_skew", ".bend"))}
    np.savez(file, **kept)
    assert np.isnan(read_poses(file).shifts.bend).all()
    form = read_poses(file).form
    assert (form.camera_turn, form.camera_stretch, form.u_camera_skew) == (1e-3, 0.0, float("inf"))


def test_poses_without_a_column_are_named_with_the_mend(tmp_path: Path) -> None:
    file = tmp_path / "poses.npz"
    write_poses(some_poses(), file)
    with np.load(file) as stored:
        kept = {name: stored[name] for name in stored.files if name != "shifts.drift"}
    np.savez(file, **kept)
    with pytest.raises(DatasetError, match=r"poses\.npz holds no poses that can be read: stitch the fields again"):
        read_poses(file)


def test_a_torn_file_is_named(tmp_path: Path) -> None:
    file = tmp_path / "poses.npz"
    write_poses(some_poses(), file)
    file.write_bytes(file.read_bytes()[:200])
    with pytest.raises(DatasetError, match=r"poses\.npz holds no poses"):
        read_poses(file)


def test_a_table_of_poses_has_a_line_for_each_field(tmp_path: Path) -> None:
    poses = some_poses()
    write_poses_csv(poses, tmp_path / "poses.csv")
    with (tmp_path / "poses.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert [int(line["field"]) for line in lines] == poses.numbers.tolist()
    np.testing.assert_allclose([float(line["x_um"]) for line in lines], poses.x_um, rtol=1e-4)
    assert [bool(int(line["left_out"])) for line in lines] == [bool(v) for v in poses.left_out]


def test_the_table_says_how_sure_each_period_is(tmp_path: Path) -> None:
    poses = dataclasses.replace(some_poses(), period_odds_nats=np.array([4.6, np.inf, 0.0]))
    write_poses_csv(poses, tmp_path / "poses.csv")
    with (tmp_path / "poses.csv").open(encoding="utf-8") as file:
        assert [line["period_probability"] for line in csv.DictReader(file)] == ["0.9900", "", "0.5000"]
