"""Flat fields: shading of every pixel from blocks, and a digest of the content."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.model.acquisition.calibration import FlatField
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.spec import replace

RISING = ((0.8, 1.0, 1.2), (0.8, 1.0, 1.2))
NONE = ((0.0,) * 3,) * 2
FLAT = FlatField(rows=20, cols=30, sensitivity=RISING, u_sensitivity=NONE, dark_counts=NONE, u_dark_counts=NONE)


def test_shading_is_linear_between_the_blocks_and_beyond_them():
    shading = FLAT.shading()
    across = 1 + 0.02 * (np.arange(30) - 14.5)
    assert shading.sensitivity == pytest.approx(np.tile(across, (20, 1)), abs=1e-6)
    assert not shading.dark_counts.any()
    part = shading.part(slice(3, 8), slice(10, 12))
    assert part.sensitivity == pytest.approx(np.tile(across[10:12], (5, 1)), abs=1e-6)


def test_a_single_block_is_the_same_everywhere():
    one = ((1.0,),)
    flat = FlatField(rows=4, cols=5, sensitivity=one, u_sensitivity=one, dark_counts=one, u_dark_counts=one)
    assert (flat.shading().sensitivity == 1).all()


def test_the_digest_changes_with_the_content():
    assert FLAT.digest == replace(FLAT).digest
    assert FLAT.digest != replace(FLAT, sensitivity=((0.8, 1.0, 1.2), (0.8, 1.0, 1.2001))).digest
    assert len(FLAT.digest) == 64


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"dark_counts": ((0.0,),)}, "as many rows and columns"), ({"sensitivity": NONE}, "over 0 everywhere")],
)
def test_maps_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(RigError, match=message):
        replace(FLAT, **changes)
