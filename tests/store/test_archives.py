"""Arrays of an archive that are mapped share one file descriptor: a mosaic keeps hundreds of surfaces open."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.archives import open_archive

ARRAYS = {
    "z_um": np.arange(12, dtype=np.float32).reshape(3, 4),
    "origin": np.arange(12, dtype=np.uint8).reshape(3, 4),
    "mark": np.array([2**40 + 1, -3]),
    "none": np.empty((0, 4), np.float32),
    "scale": np.float64(0.25),
}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "some.npz"
    np.savez(path, **ARRAYS)
    return path


def mapped(path: Path) -> dict[str, np.ndarray]:
    with open_archive(path, lambda fault: DatasetError(str(fault))) as archive:
        return {name: archive.mapped(name) for name in archive.names}


def test_mapped_arrays_are_those_that_were_stored_and_are_copied_on_write(file: Path) -> None:
    found = mapped(file)
    for name, values in ARRAYS.items():
        assert np.array_equal(found[name], values)
        assert (found[name].dtype, found[name].shape) == (values.dtype, values.shape)
    found["z_um"][0, 0] = 99
    assert mapped(file)["z_um"][0, 0] == 0


def descriptors() -> int:
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


@pytest.mark.skipif(sys.platform != "linux", reason="descriptors are counted in /proc")
def test_all_arrays_of_an_archive_take_one_descriptor(file: Path) -> None:
    before = descriptors()
    found = [mapped(file) for _ in range(5)]
    assert descriptors() <= before + len(found)
    del found
    assert descriptors() == before
