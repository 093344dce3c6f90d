"""The focus curve as a drawing, and a part of a frame as a picture."""

from __future__ import annotations

import base64
import io
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from wafer_viewer.draw.charts.profile_plot import focus_plot_html
from wafer_viewer.draw.surface.pictures import greys, patch, patch_url
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.focus_curve import FocusCurve, Rival

CURVE = FocusCurve(
    field=1,
    row=0,
    col=0,
    x_um=0.0,
    y_um=0.0,
    focus_measure="tenengrad",
    window=9,
    z_um=(0.0, 4.0, 8.0, 12.0, 16.0),
    focus=(0.2, 0.5, 1.0, 0.4, 0.3),
    grey=(1, 2, 3, 4, 5),
    peak_z_um=7.5,
    height_um=7.5,
    origin="measured",
    confidence=0.8,
    rivals=(),
    verdicts=(),
)


def test_every_frame_is_a_point_and_the_peak_has_its_height():
    drawn = focus_plot_html(CURVE, 200)
    line = re.search(r'd="M([^"HV]*)" stroke="var\(--accent\)" stroke-width="1.8"', drawn)
    assert line is not None
    assert [float(p.split()[0]) for p in line[1].split("L")] == [0, 250, 500, 750, 1000]
    assert "peak +7.50\u202fµm<" in drawn
    assert "stroke-dasharray" not in drawn


def test_a_peak_that_gave_no_height_is_said_not_to_be_believed():
    drawn = focus_plot_html(replace(CURVE, height_um=None, origin="ambiguous peak"), 200)
    assert "peak +7.50\u202fµm, not believed" in drawn
    assert "stroke-dasharray" in drawn


def test_rivals_that_have_no_room_for_a_figure_are_marked_without():
    near = (Rival(z_um=16.0, share=0.5), Rival(z_um=15.0, share=0.4), Rival(z_um=0.0, share=0.3))
    drawn = focus_plot_html(replace(CURVE, rivals=near), 200)
    assert drawn.count('stroke="var(--attention)"') == 3
    assert "rival 50\u202f%" in drawn
    assert "rival 40" not in drawn
    assert "rival 30\u202f%" in drawn
    assert "rival" not in focus_plot_html(replace(CURVE, rivals=(Rival(z_um=16.0, share=0.01),)), 200)


def seen(url: str) -> np.ndarray:
    head, _, data = url.partition(",")
    assert head == "data:image/png;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))


@given(st.integers(0, 39), st.integers(0, 59))
def test_the_pixel_is_in_the_middle_of_its_patch_and_nothing_is_made_up_beyond_the_frame(row: int, col: int):
    image = np.arange(40 * 60, dtype=np.uint16).reshape(40, 60)
    part = seen(patch_url(image, row, col, 16, (0.0, 2550.0)))
    assert part.shape == (16, 16, 2)
    assert part[8, 8].tolist() == [image[row, col] // 10, 255]
    assert np.count_nonzero(part[..., 1]) == patch(image, row, col, 16).size


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_blank_patch_stays_blank(dtype: type):
    blank = np.full((20, 20), 100, dtype)
    low, high = greys(blank)
    assert high - low == pytest.approx(np.iinfo(dtype).max / 8)
    assert low < 100 < high
