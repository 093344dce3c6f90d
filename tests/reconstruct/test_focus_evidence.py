"""Why a pixel has its height, asked of a small field."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.focus_evidence import focus_curve, rivals_of

MakeStack = Callable[..., FieldStack]
Z_UM = np.arange(20.0, 104.0, 4.0)


@pytest.fixture(scope="module")
def half_blank(make_stack: MakeStack, plane_um: NDArray) -> FieldStack:
    """A plane whose right part has no texture."""
    contrast = np.where(np.arange(128)[None, :] < 80, 1.0, 0.0) * np.ones((96, 1))
    return make_stack(plane_um, Z_UM, contrast=contrast)


def test_a_measured_pixel_shows_the_peak_that_gave_its_height(half_blank: FieldStack) -> None:
    height = reconstruct(half_blank)
    x_um, y_um = float(height.x_um[30]), float(height.y_um[40])
    found = focus_curve(half_blank, x_um, y_um, height.provenance.recipe)
    assert (found.row, found.col) == (40, 30)
    assert found.height_um == pytest.approx(float(height.z_raw_um[40, 30]), abs=1e-6)
    assert height.u_um is not None
    jitter_um = height.provenance.frame_health.u_jitter_um  # only the whole field shows it
    apart_from_jitter = float(np.sqrt(height.u_um[40, 30] ** 2 - jitter_um**2))
    assert found.u_um == pytest.approx(apart_from_jitter, rel=0.2)
    assert found.origin == "measured"
    assert all(v.passed for v in found.verdicts)
    assert abs(Z_UM[int(np.argmax(found.focus))] - found.peak_z_um) <= 2.0
    assert len(found.z_um) == len(found.focus) == len(found.grey) == len(Z_UM)
    assert max(found.focus) == 1.0


def test_a_blank_pixel_names_the_gate_that_it_failed(half_blank: FieldStack) -> None:
    height = reconstruct(half_blank)
    found = focus_curve(half_blank, float(height.x_um[112]), float(height.y_um[40]))
    assert found.height_um is None
    assert found.origin == "no texture"
    texture = next(v for v in found.verdicts if v.gate == "texture")
    assert not texture.passed
    assert texture.score is not None
    assert texture.limit is not None
    assert texture.score <= texture.limit


def test_every_frame_of_the_pixel_is_there(half_blank: FieldStack) -> None:
    height = reconstruct(half_blank)
    found = focus_curve(half_blank, float(height.x_um[30]), float(height.y_um[40]))
    np.testing.assert_array_equal(found.grey, half_blank.images[:, 40, 30])


def test_it_is_plain_data(half_blank: FieldStack) -> None:
    found = focus_curve(half_blank, 0.0, 0.0)
    assert msgspec.json.decode(msgspec.json.encode(found))["focus_measure"] == found.focus_measure


def test_a_place_outside_says_where_the_field_is(half_blank: FieldStack) -> None:
    with pytest.raises(ComputeError, match=r"\(500.0, 0.0\) um lies outside of field 1"):
        focus_curve(half_blank, 500.0, 0.0)


def test_rivals_are_maxima_far_enough_from_the_peak_highest_first() -> None:
    focus = np.array([0.1, 0.4, 0.2, 0.9, 1.0, 0.3, 0.2, 0.6, 0.1])
    rivals = rivals_of(np.arange(9.0), focus, peak=4, gap=3)
    assert [(r.z_um, r.share) for r in rivals] == [(7.0, 0.6), (1.0, 0.4)]
