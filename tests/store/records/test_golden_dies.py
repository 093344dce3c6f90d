"""Golden dies are kept by version, never written over, and refused where they do not belong."""

from __future__ import annotations

import errno
from dataclasses import replace as with_changes
from pathlib import Path

import numpy as np
import pytest

from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.inspection.golden_die import GoldenDie, GoldenHeader
from wafer_viewer.model.spec import replace
from wafer_viewer.store.records.golden_dies import every_golden, golden_named, list_golden, open_golden, save_golden


@pytest.fixture
def golden() -> GoldenDie:
    header = GoldenHeader(product="LX-7", pixel_um=0.5, width_um=30.0, height_um=20.0, dies=12, simulated=True)
    layer = np.arange(2400, dtype=np.float32).reshape(40, 60)
    layer[3, 4] = np.nan
    return GoldenDie(header, layer, layer / 100, layer + 1, layer / 50)


def test_what_is_read_is_what_was_kept(golden: GoldenDie, tmp_path: Path):
    path = save_golden(golden, tmp_path / "std")
    stored = open_golden(path)
    assert path.name == "std.1.golden.npz"
    assert (stored.header.name, stored.header.version) == ("std", 1)
    assert stored.header.made_at
    reported = {"name": "", "version": 0, "made_at": "", "software_version": ""}
    assert replace(stored.header, **reported) == golden.header
    for name, layer in golden.layers.items():
        np.testing.assert_array_equal(stored.layers[name], layer)


def test_a_version_is_never_written_over(golden: GoldenDie, tmp_path: Path):
    first = save_golden(golden, tmp_path / "std")
    before = first.read_bytes()
    second = save_golden(with_changes(golden, z_um=golden.z_um + 1), tmp_path / "std")
    assert (first.read_bytes(), second.name) == (before, "std.2.golden.npz")
    assert golden_named(tmp_path, "std", "LX-7").header.version == 2
    assert golden_named(tmp_path, "std.1").header.version == 1
    assert [header.version for header in list_golden(tmp_path)] == [2]
    assert [header.version for header in every_golden(tmp_path)] == [2, 1]
    assert not list(tmp_path.glob(".*"))


def test_one_of_another_product_is_refused(golden: GoldenDie, tmp_path: Path):
    save_golden(golden, tmp_path / "std")
    with pytest.raises(DatasetError, match="'std' is of product 'LX-7', not of 'LX-8'"):
        golden_named(tmp_path, "std", "LX-8")
    with pytest.raises(DatasetError, match="not of 'LX-8': choose another name"):
        save_golden(with_changes(golden, header=replace(golden.header, product="LX-8")), tmp_path / "std")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"product": "LX-8"}, "is of product 'LX-7' and this wafer is of 'LX-8'"),
        ({"pixel_um": 0.25}, "has pixels of 0.5 um and this surface of 0.25 um"),
        ({"width_um": 36.0}, "has dies of 30 x 20 um and this wafer of 36 x 20 um"),
    ],
)
def test_one_that_does_not_fit_is_refused_in_a_sentence(golden: GoldenDie, change: dict[str, float], says: str):
    wafer = {"product": "LX-7", "pixel_um": 0.5, "width_um": 30.0, "height_um": 20.0}
    golden.require_fit(**wafer)
    with pytest.raises(MeasureError, match=says):
        golden.require_fit(**(wafer | change))


def test_a_file_that_is_none_is_refused(golden: GoldenDie, tmp_path: Path):
    path = save_golden(golden, tmp_path / "std")
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(DatasetError, match="cannot be read as a golden die"):
        open_golden(path)
    with pytest.raises(DatasetError, match="does not exist"):
        open_golden(tmp_path / "gone.golden.npz")
    np.savez(tmp_path / "other.golden.npz", z_um=np.zeros((2, 2)))
    with pytest.raises(DatasetError, match="is not a golden die"):
        open_golden(tmp_path / "other.golden.npz")
    with pytest.raises(DatasetError, match="There is no golden die 'best'"):
        golden_named(tmp_path, "best")


def test_layers_of_different_sizes_are_no_golden_die(golden: GoldenDie):
    with pytest.raises(MeasureError, match="must be of one size"):
        with_changes(golden, picture=golden.picture[1:])


def test_a_full_disk_is_reported_and_nothing_is_left_there(golden: GoldenDie, tmp_path: Path, monkeypatch):
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(DatasetError, match="cannot be written: the disk is full"):
        save_golden(golden, tmp_path / "std")
    assert list(tmp_path.iterdir()) == []
