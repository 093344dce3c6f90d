from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measurements import ProfileCurve
from wafer_viewer.model.measurement.sections import (
    column_line,
    cursor_difference,
    nearest,
    numbered,
    parallel_line,
    perpendicular_line,
    row_line,
)
from wafer_viewer.model.region import Region


@dataclass(frozen=True)
class Lattice:
    """1000 rows of 2000 pixels of 0.5 um."""

    pixel_um: float = 0.5
    x0_um: float = -100.0
    y0_um: float = 300.0
    shape: tuple[int, int] = (1000, 2000)


LATTICE = Lattice()


def test_a_row_runs_through_its_pixel_centres_from_edge_to_edge():
    line = row_line(LATTICE, 40, width_um=2.0)
    assert line == Region.line(-100.0, 280.0, 899.5, 280.0, 2.0)
    assert column_line(LATTICE, 40) == Region.line(-80.0, 300.0, -80.0, -199.5)
    assert row_line(LATTICE, 0).points[0].y_um == LATTICE.y0_um


@pytest.mark.parametrize(("along", "count"), [("row", 1000), ("column", 2000)])
def test_there_are_so_many_rows_and_no_more(along, count):
    last = numbered(LATTICE, along, count - 1).points[0]
    assert nearest(LATTICE, along, last.x_um, last.y_um) == count - 1
    for number in (-1, count):
        with pytest.raises(MeasureError, match=f"no {along} {number}: the surface has the {along}s 0 to {count - 1}"):
            numbered(LATTICE, along, number)


def test_a_place_names_the_nearest_row_of_the_surface():
    assert nearest(LATTICE, "row", 0.0, 279.8) == 40
    assert nearest(LATTICE, "column", 1e6, 0.0) == 1999


def test_a_line_across_another_has_its_middle_and_length_and_stays_on_the_surface():
    line = Region.line(0, 100, 200, 200, 3.0)
    cross = perpendicular_line(line, LATTICE)
    (xa, ya), (xb, yb) = ((p.x_um, p.y_um) for p in cross.points)
    assert ((xa + xb) / 2, (ya + yb) / 2) == (100, 150)
    assert np.hypot(xb - xa, yb - ya) == pytest.approx(np.hypot(200, 100), abs=0.02)
    assert (xb - xa) * 200 + (yb - ya) * 100 == pytest.approx(0, abs=1e-6)
    assert cross.width_um == 3.0
    _, low, _, high = perpendicular_line(Region.line(-100, 50, 899.5, 50), LATTICE).bounds_um
    assert (low, high) == (-199.5, 299.5)


def test_a_line_beside_another_is_parallel_to_it_on_the_side_where_there_is_room():
    moved = parallel_line(Region.line(0, 100, 120, 100, 3.0), LATTICE)
    assert moved == Region.line(0, 120, 120, 120, 3.0)
    assert parallel_line(Region.line(0, 295, 120, 295), LATTICE) == Region.line(0, 275, 120, 275)
    lower, upper = parallel_line(Region.line(0, -199, 0, 299), LATTICE).points
    assert upper.x_um == lower.x_um < 0
    full = parallel_line(row_line(LATTICE, 500), dataclasses.replace(LATTICE, shape=(1001, 2000)))
    assert full.bounds_um[0] >= LATTICE.x0_um


def curve_of(z):
    along = np.arange(len(z)) * 2.0
    return ProfileCurve(along, np.array(z, float), along, 0 * along)


def test_cursors_read_the_gap_between_measured_points():
    read = cursor_difference(curve_of([1, 2, np.nan, np.nan, 7, 6]), (0.1, 0.75))
    assert (read.at_um, read.dx_um, read.dz_um) == ((0.0, 8.0), 8.0, 6.0)
    assert read.angle_deg == pytest.approx(np.degrees(np.arctan2(6, 8)))


def test_the_angle_is_the_surfaces_whichever_cursor_stands_left():
    present, back = (cursor_difference(curve_of([0, 1, 2, 3]), ends) for ends in ((0.0, 1.0), (1.0, 0.0)))
    assert back.dx_um == -present.dx_um
    assert back.dz_um == -present.dz_um
    assert back.angle_deg == pytest.approx(present.angle_deg)
    assert np.isnan(cursor_difference(curve_of([0, 1, 2, 3]), (0.5, 0.5)).angle_deg)


def test_no_cursor_stands_on_nothing():
    with pytest.raises(MeasureError, match="no measured point"):
        cursor_difference(curve_of([np.nan, np.nan]), (0, 1))
