"""The colours of the classes of defects, as people see them on a light and on a dark page."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from skimage.color import deltaE_ciede2000

from tests.draw.test_colormaps import seen_by
from wafer_viewer.draw.charts.axes import SHAPES
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES

COLOURS = {kind: [int(look.colour[k : k + 2], 16) for k in (1, 3, 5)] for kind, look in DEFECT_CLASSES.items()}


@pytest.mark.parametrize("eyes", ["all colours", "red-blind", "green-blind"])
def test_no_two_classes_look_alike(eyes):
    shown = dict(zip(COLOURS, seen_by(eyes, list(COLOURS.values())), strict=True))
    apart = {pair: float(deltaE_ciede2000(shown[pair[0]], shown[pair[1]])) for pair in combinations(shown, 2)}
    assert min(apart.values()) >= 10, min(apart, key=lambda pair: apart[pair])


@pytest.mark.parametrize("page", [(255, 255, 255), (0x16, 0x1B, 0x21)])
def test_every_class_stands_out_from_the_page(page):
    assert min(contrast(colour, page) for colour in COLOURS.values()) >= 3


def test_every_class_has_a_shape_of_its_own():
    shapes = [look.shape for look in DEFECT_CLASSES.values()]
    assert len(set(shapes)) == len(DEFECT_CLASSES)
    assert set(shapes) <= set(SHAPES)


def contrast(colour, page):
    """As WCAG 2 defines it."""
    low, high = sorted(luminance(c) for c in (colour, page))
    return (high + 0.05) / (low + 0.05)


def luminance(colour):
    srgb = np.asarray(colour, float) / 255
    return float(np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722])
