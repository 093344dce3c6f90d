"""Windows of a mosaic made again while others look at it, and what damage does."""

from __future__ import annotations

import dataclasses
import shutil
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import zarr

from tests.support.datasets.samples import Source, assert_same_surface
from tests.support.direct_pyramid import assert_level, with_gaps
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Origin, Provenance
from wafer_viewer.store.mosaic.zarr_mosaic import Patch, ZarrMosaic, patches, rewrite_header, write_mosaic, write_patch

pytestmark = pytest.mark.usefixtures("small_shards")


def write_windows(path, source, windows):
    """Make windows again, as a stitching job does with many hands."""
    for patch in patches(source.shape, windows):
        write_patch(path, source, patch)
    rewrite_header(path, source)


def needs(patch: Patch, other: Patch) -> bool:
    """Whether another patch has to be there first."""
    return (
        other.level == patch.level - 1
        and 2 * patch.top < other.bottom
        and other.top < 2 * patch.bottom
        and 2 * patch.left < other.right
        and other.left < 2 * patch.right
    )


WINDOWS = [
    [(slice(70, 71), slice(10, 12))],
    [(slice(0, 150), slice(0, 201))],
    [(slice(149, 150), slice(200, 201)), (slice(0, 3), slice(60, 70))],
    [(slice(120, 140), slice(100, 190)), (slice(5, 9), slice(5, 9)), (slice(60, 68), slice(60, 68))],
]


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("windows", WINDOWS)
def test_windows_made_again_are_as_if_all_had_been_made_again(stored, tmp_path, surface, windows):
    copy = ZarrMosaic.open(shutil.copytree(stored.path, tmp_path / "m.zarr"))
    changed = changed_within(surface, windows)
    write_windows(copy.path, changed, windows)
    anew = write_mosaic(tmp_path / "n.zarr", changed)
    for level in range(stored.levels):
        assert_same_surface(copy.window(level=level), anew.window(level=level))
        for ours, theirs in zip(copy.span(None, level), anew.span(None, level), strict=True):
            np.testing.assert_array_equal(ours, theirs)
    for name in ("counts", "lowest_um", "highest_um", "heights_um", "overlaps_um"):
        np.testing.assert_array_equal(getattr(copy.facts(), name), getattr(anew.facts(), name), err_msg=name)


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("windows", WINDOWS)
def test_levels_are_means_of_measured_pixels_after_windows_were_made_again(tmp_path, surface, windows):
    gappy, other = with_gaps(surface, 1), with_gaps(surface, 2)
    stored = write_mosaic(tmp_path / "m.zarr", gappy)
    layers = {name: layer.copy() for name, layer in layers_of(gappy).items()}
    for part in windows:
        for name, layer in layers_of(other).items():
            layers[name][part] = layer[part]
    changed = dataclasses.replace(gappy, **layers)
    write_windows(stored.path, changed, windows)
    for level in range(1, stored.levels):
        rows, cols = (slice(0, n) for n in stored.header.shape_of(level))
        assert_level(stored.layers(level, rows, cols), changed, level)


def layers_of(surface):
    names = [item.name for item in dataclasses.fields(surface)]
    return {name: layer for name in names if isinstance(layer := getattr(surface, name), np.ndarray)}


def changed_within(surface, windows):
    z, origin = surface.z_um.copy(), surface.origin.copy()
    for part in windows:
        z[part] += 7.0
        origin[part] = np.where(np.isnan(z[part]), Origin.CLIPPED, Origin.MEASURED)
    return dataclasses.replace(surface, z_um=z, origin=origin)


@pytest.mark.slow
def test_pixels_outside_a_window_are_neither_read_nor_written(stored, tmp_path, surface):
    path = shutil.copytree(stored.path, tmp_path / "m.zarr")
    before = {file: file.stat().st_mtime_ns for file in path.rglob("*") if file.is_file()}
    watched = Source(surface)
    write_windows(path, watched, [(slice(5, 10), slice(5, 10))])
    touched = {
        str(f.relative_to(path / "z_um"))
        for f, t in before.items()
        if f.stat().st_mtime_ns != t and f.relative_to(path).parts[0] == "z_um"
    }
    assert touched == {"0/c/0/0", "1/c/0/0", "2/c/0/0", "3/c/0/0"}
    assert watched.largest == 32 * 32


def test_patches_know_what_they_need(surface):
    work = patches(surface.shape)
    assert all(not needs(p, q) for p in work for q in work if q.level >= p.level)
    above = next(p for p in work if p.level == 2)
    assert [q.level for q in work if needs(above, q)] == [1] * 4
    assert [p.level for p in patches(surface.shape, [])] == []


def test_a_window_on_another_lattice_is_refused(stored, tmp_path, surface):
    path = shutil.copytree(stored.path, tmp_path / "m.zarr")
    with pytest.raises(DatasetError, match="another lattice"):
        rewrite_header(path, dataclasses.replace(surface, x0_um=0.0))
    noted = dataclasses.replace(surface, provenance=Provenance(notes=("again",)))
    rewrite_header(path, noted)
    assert ZarrMosaic.open(path).provenance.notes == ("again",)
    assert zarr.open_group(path, mode="r")["z_um/0"].shape == surface.shape


# ---------------------------------------------------------------------------------------------- damage


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("harm", ["index", "chunk", "short", "empty"])
def test_a_damaged_shard_is_named(stored, tmp_path, surface, harm):
    path = shutil.copytree(stored.path, tmp_path / "m.zarr")
    shard = path / "z_um/0/c/1/2"
    content = bytearray(shard.read_bytes())
    content[-20 if harm == "index" else 40] ^= 255
    shard.write_bytes({"short": content[:-7], "empty": b""}.get(harm, content))
    with pytest.raises(DatasetError, match="z_um/0/c/1/2 is damaged: stitch the fields again"):
        ZarrMosaic.open(path).window()
    neighbour = Region.rectangle(surface.x0_um, surface.y0_um, surface.x0_um + 9, surface.y0_um - 9)
    assert_same_surface(ZarrMosaic.open(path).window(neighbour), surface.window(neighbour))
    write_windows(path, surface, [(slice(0, 150), slice(0, 201))])
    assert_same_surface(ZarrMosaic.open(path).window(), surface)


def test_damaged_facts_are_named(stored, tmp_path):
    path = shutil.copytree(stored.path, tmp_path / "m.zarr")
    next((path / "facts").glob("c/*/*/0")).write_bytes(b"12")
    with pytest.raises(DatasetError, match=r"facts/c/.* is damaged"):
        ZarrMosaic.open(path).facts()
    shutil.rmtree(path / "facts" / "c")
    with pytest.raises(DatasetError, match="facts is missing or empty"):
        ZarrMosaic.open(path).facts()


@pytest.mark.campaign
def test_readers_never_see_half_a_shard(stored, tmp_path, surface):
    """One writes two states in turn; whatever is read of a shard is one of them as a whole."""
    path = shutil.copytree(stored.path, tmp_path / "m.zarr")
    states = [dataclasses.replace(surface, z_um=np.full_like(surface.z_um, n)) for n in (1, 2)]
    window = [(slice(0, 64), slice(0, 64))]
    write_windows(path, states[0], window)
    done = threading.Event()

    def read():
        observed = set()
        reader = ZarrMosaic.open(path)
        while not done.is_set():
            z = reader.read("z_um", 0, slice(0, 64), slice(0, 64))
            assert (z == z[0, 0]).all()
            observed.add(float(z[0, 0]))
        return observed

    with ThreadPoolExecutor(2) as pool:
        readers = [pool.submit(read) for _ in range(2)]
        for n in range(6):
            write_windows(path, states[n % 2], window)
        done.set()
        assert all(reader.result() <= {1.0, 2.0} for reader in readers)
