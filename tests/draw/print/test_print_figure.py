"""The picture to be printed: its size, its scale, its colours, and the word that must not be missing."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from wafer_viewer.draw.colormaps import table
from wafer_viewer.draw.print_figures import (
    BAR_HIGH,
    DARK,
    FOOT_SHARE,
    LEAST_HIGH,
    LIGHT,
    MARGIN_SHARE,
    Caption,
    ColourKey,
    png,
    print_picture,
)

WIDTH, HEIGHT = 1500, 900
KEY = ColourKey("Height", "µm", -10.0, 30.0, "batlow")


def a_picture(simulated: bool = False, key: ColourKey | None = None, um_per_pixel: float = 0.5):
    scene = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
    scene[::899, 700:720, 3] = 255  # something at either edge, so that no row is cut off
    scene[::899, 700:720, :3] = 255
    return print_picture(scene, um_per_pixel, Caption("coupon-07", ("z drawn × 3",), simulated), key)


def test_the_scene_keeps_its_pixels_and_lies_on_white_paper():
    scene = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
    scene[100:200, 300:400] = (10, 120, 200, 255)
    scene[[0, -1], 0] = (255, 255, 255, 255)
    picture = print_picture(scene, 1.0, Caption("a", (), False), None)
    assert picture.shape == (HEIGHT + round(FOOT_SHARE * WIDTH), WIDTH, 3)
    assert (picture[100:200, 300:400] == (10, 120, 200)).all()
    assert (picture[:HEIGHT][scene[..., 3] == 0] == 255).all()


def test_empty_rows_are_cut_off_but_for_a_margin_and_room_for_the_bar():
    tall = np.zeros((3 * WIDTH, WIDTH, 4), np.uint8)
    tall[1000:2000, 300:400] = 255
    tall[1400:1450, 300:400] = (10, 120, 200, 255)
    picture = print_picture(tall, 1.0, Caption("a", (), False), KEY)
    foot = round(FOOT_SHARE * WIDTH)
    assert picture.shape[0] == 1000 + 2 * round(MARGIN_SHARE * WIDTH) + foot
    assert (picture == (10, 120, 200)).all(axis=2).sum() == 50 * 100
    flat = np.zeros((3 * WIDTH, WIDTH, 4), np.uint8)
    flat[700, 300:400] = 255
    assert print_picture(flat, 1.0, Caption("a", (), False), KEY).shape[0] == round(LEAST_HIGH * WIDTH) + foot


@pytest.mark.parametrize("um_per_pixel", [0.031, 0.5, 17.0])
def test_the_scale_bar_is_as_long_as_it_says(um_per_pixel: float):
    foot = a_picture(um_per_pixel=um_per_pixel)[HEIGHT:]
    longest = max(_runs((foot == LIGHT.ink).all(axis=2)))
    length_um = longest * um_per_pixel
    nearest = min((m * 10.0**p for m in (1, 2, 5) for p in range(-2, 5)), key=lambda um: abs(um - length_um))
    assert length_um == pytest.approx(nearest, abs=6 * um_per_pixel)


def test_simulated_stands_on_it_only_where_it_is_true():
    plates = [(a_picture(simulated) == LIGHT.plate).all(axis=2).sum() for simulated in (False, True)]
    assert plates[0] == 0
    assert plates[1] > 500


def test_the_bar_runs_from_the_low_colour_at_its_foot_to_the_high_one():
    plain, keyed = a_picture(), a_picture(key=KEY)
    lowest, highest = (tuple(table("batlow")[k]) for k in (6, 249))
    rows = [np.flatnonzero((keyed == colour).all(axis=2).any(axis=1)) for colour in (highest, lowest)]
    assert 0 < rows[0].min() < rows[1].max() < BAR_HIGH * WIDTH + 120
    assert (plain[HEIGHT:] == keyed[HEIGHT:]).all()


def test_what_was_drawn_for_a_dark_page_lies_on_dark_paper():
    scene = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
    picture = print_picture(scene, 1.0, Caption("a", (), True), KEY, DARK)
    assert tuple(picture[5, 5]) == DARK.paper
    assert not (picture == LIGHT.paper).all(axis=2).any()


def test_the_file_says_its_resolution():
    opened = Image.open(io.BytesIO(png(a_picture())))
    assert opened.size == (WIDTH, HEIGHT + round(FOOT_SHARE * WIDTH))
    assert round(opened.info["dpi"][0]) == 300


def _runs(mask: np.ndarray) -> list[int]:
    """Lengths of the longest run in every row."""
    lengths = []
    for row in mask:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(int), [0]])))
        lengths.append(int(max(edges[1::2] - edges[::2], default=0)))
    return lengths
