"""A small surface as a mosaic of many small shards."""

from __future__ import annotations

import pytest

from tests.support.datasets.samples import Source, make_surface
from wafer_viewer.store.mosaic import zarr_shards
from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic


@pytest.fixture(scope="module")
def small_shards():
    """Shards of 64 pixels, so that a small surface has many of them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zarr_shards, "SHARD", 64)
        patch.setattr(zarr_shards, "CHUNK", 16)
        patch.setattr(zarr_shards, "COARSEST_PX", 40)
        yield


@pytest.fixture(scope="module")
def surface():
    return make_surface(rows=150, cols=201, pixel_um=0.5, x0_um=-30.0, y0_um=80.0, simulated=True)


@pytest.fixture(scope="module")
def source(surface):
    return Source(surface)


@pytest.fixture(scope="module")
def stored(tmp_path_factory, source, small_shards):
    return write_mosaic(tmp_path_factory.mktemp("mosaic") / "m.zarr", source)
