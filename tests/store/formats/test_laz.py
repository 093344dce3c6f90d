"""LAZ as its own library reads it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.datasets.samples import make_surface
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.formats.conversion import export, losses


def test_laspy_reads_the_points_their_grey_and_what_they_are(tmp_path):
    laspy = pytest.importorskip("laspy", reason="pip install 'wafer-viewer[points]'")
    pytest.importorskip("lazrs", reason="pip install 'wafer-viewer[points]'")
    surface = make_surface()
    with laspy.open(export(surface, tmp_path / "a.laz")) as file:
        cloud = file.read()
    known = np.isfinite(surface.z_um)
    rows, cols = np.nonzero(known)
    assert len(cloud.points) == known.sum()
    np.testing.assert_allclose(np.asarray(cloud.x), surface.x_um[cols], atol=6e-4)
    np.testing.assert_allclose(np.asarray(cloud.y), surface.y_um[rows], atol=6e-4)
    np.testing.assert_allclose(np.asarray(cloud.z), surface.z_um[known], atol=6e-6)
    np.testing.assert_array_equal(np.asarray(cloud.intensity) >> 8, surface.all_in_focus[known])
    assert b"heights in um, stage coordinates" in cloud.header.vlrs[0].record_data_bytes()
    assert "confidence" in losses(surface, tmp_path / "a.laz")[0].lower()


def test_without_the_library_the_error_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "laspy", None)
    with pytest.raises(DatasetError, match=r"pip install 'wafer-viewer\[points\]'"):
        export(make_surface(), tmp_path / "a.laz")
    assert not list(tmp_path.iterdir())
