"""A surface read between its pixels: exact on them, nothing invented at gaps, nothing beyond its border."""

from __future__ import annotations

import numpy as np

from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.numerics.grids.resampling import ResampledLayers, resample_affine


def a_slope(shape=(6, 8)) -> ResampledLayers:
    rows, cols = np.indices(shape, np.float32)
    z = 2 * rows + 3 * cols
    return ResampledLayers(z, z + 1, 1 - 0.01 * cols, (10 * cols).astype(np.uint8), np.zeros(shape, np.uint8))


def placed(source: ResampledLayers, down: float, right: float) -> ResampledLayers:
    out = ResampledLayers(*(np.full_like(layer, 7) for layer in source))
    resample_affine(source, np.array([[down, 1.0, 0.0], [right, 0.0, 1.0]]), out)
    return out


def test_on_pixels_every_layer_is_copied():
    source = a_slope()
    for present, here in zip(placed(source, 0.0, 0.0), source, strict=True):
        assert np.array_equal(present, here)
    assert np.array_equal(placed(source, 1.0, -2.0).z[:5, 2:], source.z[1:, :6])


def test_between_pixels_a_slope_continues_and_the_less_sure_pixel_counts():
    out = placed(a_slope(), 0.25, 0.5)
    rows, cols = np.indices((5, 7), np.float32)
    assert np.allclose(out.z[:5, :7], 2 * (rows + 0.25) + 3 * (cols + 0.5))
    assert np.allclose(out.raw[:5, :7] - out.z[:5, :7], 1)
    assert np.allclose(out.confidence[:5, :7], 1 - 0.01 * (cols + 1))
    assert np.array_equal(out.grey[:5, :7], np.round(10 * cols + 5))


def test_beyond_the_border_nothing_is_covered():
    out = placed(a_slope(), 0.5, -0.5)
    assert np.isnan(out.z[-1]).all()
    assert np.isnan(out.z[:, 0]).all()
    assert (out.origin[:, 0] == Origin.NOT_COVERED).all()
    assert np.isfinite(out.z[:5, 1:]).all()


def test_a_gap_counts_where_it_has_a_share_and_gives_its_reason():
    source = a_slope()
    source.z[2, 3] = np.nan
    source.origin[2, 3] = Origin.OUTLIER
    assert np.isnan(placed(source, 0.0, 0.0).z).sum() == 1
    out = placed(source, 0.5, 0.0)
    assert np.flatnonzero(np.isnan(out.z[:5]).any(axis=1)).tolist() == [1, 2]
    assert set(out.origin[:5][np.isnan(out.z[:5])]) == {Origin.OUTLIER}


def test_what_is_turned_by_a_quarter_is_read_so():
    source = a_slope((5, 5))
    out = ResampledLayers(*(np.zeros_like(layer) for layer in source))
    resample_affine(source, np.array([[0.0, 0.0, 1.0], [4.0, -1.0, 0.0]]), out)
    assert np.array_equal(out.z, source.z.T[::-1])
