"""What a growing surface tells of where it changed."""

from __future__ import annotations

import dataclasses

from hypothesis import given
from hypothesis import strategies as st

from wafer_viewer.session.core.dataset_library import KEPT, stamp_of, with_change
from wafer_viewer.session.state.snapshot import Box, SurfaceInfo

SIDE_UM = 1000.0


def surface(stamp: int, rows: int = 1000) -> SurfaceInfo:
    return SurfaceInfo(
        result="default", stamp=stamp, rows=rows, cols=1000, pixel_um=1.0, x0_um=0.0, y0_um=SIDE_UM, levels=3,
        n_fields=4, highest_um=1.0, lowest_um=0.0, measured_fraction=1.0, filled_fraction=0.0, unmeasured=(),
        overlap_rms_um=None, low_um=0.0, high_um=1.0,
    )  # fmt: skip


@st.composite
def boxes(draw: st.DrawFn) -> Box:
    x0, y0 = draw(st.floats(0, SIDE_UM - 1)), draw(st.floats(0, SIDE_UM - 1))
    return x0, y0, draw(st.floats(x0, SIDE_UM)), draw(st.floats(y0, SIDE_UM))


def touches(a: Box, b: Box) -> bool:
    return a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]


@given(st.lists(boxes(), max_size=KEPT + 20), boxes())
def test_a_part_has_the_stamp_of_the_last_change_that_touched_it_or_a_later_one(changes: list[Box], part: Box):
    info = surface(7)
    last = 7
    for k, box in enumerate(changes):
        info = with_change(surface(8 + k), info, box)
        last = 8 + k if touches(box, part) else last
    assert last <= stamp_of(info, part) <= info.stamp
    if len(changes) < KEPT:
        assert stamp_of(info, part) == last
    assert len(info.changed) <= KEPT


def test_on_another_lattice_or_without_an_earlier_surface_everything_is_new():
    box = (10.0, 10.0, 20.0, 20.0)
    grown = with_change(surface(2), surface(1), box)
    assert stamp_of(grown, (500.0, 500.0, 600.0, 600.0)) == 1
    for complete in (with_change(surface(3, rows=1200), grown, box), with_change(surface(3), None, box)):
        assert complete.changed == ()
        assert stamp_of(complete, (500.0, 500.0, 600.0, 600.0)) == 3


def test_a_surface_that_is_read_back_with_a_new_stamp_does_not_pass_for_an_old_one():
    grown = with_change(surface(2), surface(1), (10.0, 10.0, 20.0, 20.0))
    again = dataclasses.replace(grown, stamp=40)
    assert stamp_of(with_change(again, None, (0.0, 0.0, 1.0, 1.0)), (500.0, 500.0, 600.0, 600.0)) == 40
