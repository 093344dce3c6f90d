"""Given dies laid over those that a surface shows: moved onto them, told how far off, left alone or refused."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np
import pytest

from tests.support.patterned_surface import Wafer
from tests.support.patterned_surface import made as freshly_made
from wafer_viewer.measure.dies.given_lattice_fit import fitted_dies
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.spec import replace

made = cache(freshly_made)
TRUE = Wafer().grid


@pytest.mark.slow
def test_dies_given_a_little_off_are_moved_onto_those_seen():
    given = replace(TRUE, x0_um=TRUE.x0_um + 5, y0_um=TRUE.y0_um - 7, pitch_x_um=TRUE.pitch_x_um + 0.4)
    fitted = fitted_dies(made(), replace(given, angle_rad=2e-3))
    assert fitted.grid.pitch_x_um == pytest.approx(TRUE.pitch_x_um, rel=5e-5)
    assert fitted.grid.angle_rad == pytest.approx(0, abs=5e-5)
    for at in ((0, 0), (4, 6)):
        assert fitted.grid.corner(*at) == pytest.approx(TRUE.corner(*at), abs=0.5)
    assert fitted.off is not None
    assert (fitted.off.origin_x_um, fitted.off.origin_y_um) == pytest.approx((-5, 7), abs=0.5)
    assert fitted.off.turn_mrad == pytest.approx(-2, abs=0.05)
    assert fitted.off.pitch_x_ppm == pytest.approx((201.3 / 201.7 - 1) * 1e6, abs=50)
    assert "off where they were given" in fitted.grid.notes[-1]


@pytest.mark.slow
def test_names_and_size_stay_as_they_were_given():
    given = replace(TRUE, x0_um=TRUE.x0_um + 3, first_col=2, first_row=1, cols=3, rows=2, left_out=("3,1",))
    grid = fitted_dies(made(), given).grid
    assert grid.places == given.places
    assert (grid.width_um, grid.height_um, grid.by) == (given.width_um, given.height_um, "given")
    assert grid.u_pitch_um > 0


@pytest.mark.slow
def test_without_a_street_of_that_width_the_corner_is_as_given():
    given = replace(TRUE, width_um=TRUE.pitch_x_um, height_um=TRUE.pitch_y_um, x0_um=TRUE.x0_um + 40)
    fitted = fitted_dies(made(), given)
    assert fitted.off is not None
    assert fitted.off.farthest_um < 2
    assert "No street as wide as given is seen along x and y" in fitted.grid.notes[0]


@pytest.mark.slow
def test_a_lattice_next_to_the_dies_is_refused():
    with pytest.raises(MeasureError, match=r"lie \d+ um off those that the surface shows") as message:
        fitted_dies(made(), replace(TRUE, x0_um=TRUE.x0_um + 70))
    assert str(message.value).count(". ") == 0


def test_where_nothing_is_seen_they_stay_as_given_and_it_is_reported():
    surface = made()
    noise = np.random.default_rng(5).standard_normal(surface.shape).astype(np.float32)
    blank = np.full(surface.shape, 80, np.uint8)
    fitted = fitted_dies(dataclasses.replace(surface, z_um=noise, z_raw_um=noise, all_in_focus=blank), TRUE)
    assert fitted.off is None
    assert replace(fitted.grid, notes=()) == TRUE
    assert "used as given" in fitted.grid.notes[0]


@pytest.mark.slow
def test_a_turned_wafer_keeps_its_turn():
    wafer = Wafer(angle_deg=-3)
    fitted = fitted_dies(made(wafer), replace(wafer.grid, x0_um=wafer.x0_um - 4))
    assert math.degrees(fitted.grid.angle_rad) == pytest.approx(-3, abs=0.002)
    assert fitted.off is not None
    assert fitted.off.origin_x_um == pytest.approx(4, abs=0.5)
