"""OME-TIFF with pyramids: heights and picture at every level, their place, and the way back."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile

from tests.support.surfaces import height_map
from wafer_viewer.cli.app import main
from wafer_viewer.store.formats.conversion import export, read_surface

PIXEL_UM = 0.5


@pytest.fixture
def surface():
    rng = np.random.default_rng(3)
    z_um = rng.normal(0, 5, (1101, 700)).astype(np.float32)
    z_um[100:140, 200:300] = np.nan
    return height_map(z_um, pixel_um=PIXEL_UM, x0_um=1000.0, y0_um=-500.0)


def test_levels_are_means_of_the_measured_pixels_below(surface, tmp_path):
    path = export(surface, tmp_path / "a.ome.tif")
    with tifffile.TiffFile(path) as file:
        assert file.is_ome
        assert [series.name for series in file.series] == ["z_um", "all_in_focus"]
        z_um, picture = file.series
        assert [level.shape for level in z_um.levels] == [(1101, 700), (551, 350), (276, 175)]
        np.testing.assert_array_equal(z_um.levels[0].asarray(), surface.z_um)
        np.testing.assert_array_equal(picture.asarray(), surface.all_in_focus)
        half = z_um.levels[1].asarray()
        whole = surface.z_um[:1100].reshape(550, 2, 350, 2)
        np.testing.assert_allclose(half[:50], whole[:50].mean((1, 3)), atol=1e-5)
        np.testing.assert_allclose(half[550], surface.z_um[1100].reshape(350, 2).mean(1), atol=1e-5)
        assert np.isnan(half[50:70, 100:150]).all()
        assert np.isfinite(half).mean() == pytest.approx(1 - 20 * 50 / half.size)


def test_it_is_read_back_with_its_place(surface, tmp_path):
    back = read_surface(export(surface, tmp_path / "a.ome.tif"))
    np.testing.assert_array_equal(back.z_um, surface.z_um)
    assert (back.pixel_um, back.x0_um, back.y0_um) == (PIXEL_UM, 1000.0, -500.0)
    assert back.provenance.simulated == surface.provenance.simulated
    assert not any("first page" in note for note in back.provenance.notes)


def test_convert_writes_it(surface, tmp_path):
    export(surface, tmp_path / "a.npz")
    assert main(["convert", str(tmp_path / "a.npz"), str(tmp_path / "b.ome.tif"), "--every", "3"]) == 0
    with tifffile.TiffFile(tmp_path / "b.ome.tif") as file:
        assert file.series[0].shape == (367, 234)
        assert 'PhysicalSizeX="1.5"' in (file.ome_metadata or "")
    assert not [path for path in tmp_path.iterdir() if path.name not in ("a.npz", "b.ome.tif")]
