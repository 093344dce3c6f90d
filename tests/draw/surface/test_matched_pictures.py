"""Pictures that stand side by side mean the same by the same colour."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from wafer_viewer.draw.surface.pictures import UNMEASURED, Range, greys_of, heights_of, picture_of

FLAT = np.zeros((60, 80), np.float32)
NOTHING = np.full((60, 80), np.nan, np.float32)


def seen(jpeg: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(jpeg)).convert("RGB"), float)


def test_one_range_holds_all_and_cuts_off_nothing_of_the_defect():
    """A peak of ten pixels is far less than half a per cent of what is shown."""
    peaked = FLAT.copy()
    peaked[28:30, 38:43] = 9.0
    over = heights_of([peaked, FLAT - 1], peaked[28:30, 38:43], 0.5)
    assert over.low == pytest.approx(-1.0)
    assert over.high == pytest.approx(9.0)
    assert over.zero == pytest.approx(-1.0)
    assert heights_of([peaked, FLAT - 1], FLAT[:0], 0.5).high < 1


def test_the_same_height_has_the_same_colour_in_every_picture():
    step = np.where(np.arange(80) < 40, np.float32(0), np.float32(4)) + FLAT
    over = heights_of([step, FLAT], FLAT[:0], 0.5)
    here, like = (seen(picture_of(plane, 0.5, over)) for plane in (step, FLAT))
    assert np.abs(here[30, 10] - like[30, 10]).max() < 6
    assert np.abs(here[30, 70] - like[30, 70]).max() > 60


def test_what_is_alike_is_not_spread_until_noise_looks_like_a_pattern():
    over = heights_of([FLAT], FLAT, 0.5)
    assert over.high - over.low == pytest.approx(0.2)
    greys = greys_of([FLAT + 100, FLAT + 101])
    assert greys.high - greys.low == pytest.approx(24.0)


def test_what_is_not_measured_is_of_one_colour_and_nothing_is_no_picture():
    holed = FLAT.copy()
    holed[10:30, 10:30] = np.nan
    picture = seen(picture_of(holed, 0.5, Range(-1.0, 1.0)))
    assert np.abs(picture[20, 20] - UNMEASURED).max() < 6
    assert np.abs(picture[50, 60] - 127).max() < 6
    assert picture_of(NOTHING, 0.5, Range(0.0, 1.0)) == b""
    assert heights_of([NOTHING, NOTHING], NOTHING, 0.5).high == 1.0
