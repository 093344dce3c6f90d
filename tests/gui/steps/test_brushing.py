"""Drags on the histogram, cursors on a line in the scene, rectangles on the screen: the pure parts."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.gui.scene.camera_presets import CameraPose, pixel_ray
from wafer_viewer.gui.state.view_state import View, changed, read, write
from wafer_viewer.gui.steps.surface.heights import around, brushed_rows, histogram_area, parse_drag
from wafer_viewer.gui.steps.surface.points import amount, counted
from wafer_viewer.gui.tools.profile_lines import nearest_share
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.clipping import Clip
from wafer_viewer.session.rendering.render_request import Brushed, Statistics

ENDS, ALL = (0.0, 10.0), (-5.0, 30.0)


def test_a_drag_means_heights_and_its_ends_all_that_lies_beyond():
    drag = parse_drag("brush:0.2:0.5", ENDS, ALL)
    assert (drag.act, drag.from_um, drag.to_um, drag.is_click) == ("brush", 2.0, 5.0, False)
    assert parse_drag("high:0.9:1", ENDS, ALL).to_um == 30.0
    assert parse_drag("brush:0.4:0", ENDS, ALL).to_um == -5.0
    assert parse_drag("brush:0.4:0.401", ENDS, ALL).is_click


def test_only_a_point_cloud_has_grips():
    assert "<b data-grip" not in histogram_area(ENDS, None, None, clips=False)
    drawn = histogram_area(ENDS, (2.0, 4.0), (1.0, 9.0), clips=True)
    assert 'data-grip="low" style="left:10.000%"' in drawn
    assert "left:20.000%;width:20.000%" in drawn


def test_ranges_of_heights_hold_for_the_surface_they_were_chosen_on():
    view = View(brush_um=(1.0, 2.0), clip=Clip(heights_um=(0.0, 3.0), least_confidence=0.4))
    other = changed(view, show=3)
    assert other.brush_um is None
    assert other.clip == Clip(least_confidence=0.4)
    assert changed(view, dark=True).brush_um == (1.0, 2.0)


def test_a_browser_remembers_clip_and_selection():
    view = View(clip=Clip(heights_um=(0.0, 3.0), box_um=(0.0, 1.0, 2.0, 3.0)), selection=(1.0, 2.0, 3.0, 4.0))
    stored = read(write(view, "x.wafer"))
    assert stored.chosen["clip"] == view.clip
    assert stored.chosen["selection"] == view.selection


def test_the_profiles_line_cuts_points_alone():
    line = Region.line(0.0, 0.0, 10.0, 0.0, 2.0)
    view = View(step="measure", tool="profile", look="points", lines=(line,), before="hide")
    assert view.clipped.slab is not None
    assert view.clipped.slab.line == line
    assert changed(view, look="surface").clipped == Clip()
    assert changed(view, before="show").clipped.slab is None


def test_what_is_brushed_reads_with_units():
    rows = dict(brushed_rows(Brushed(1234, 0.051, 12.345, 0.5, 2, ((0.0, 10.0, 4.0, 12.0),))))
    assert rows["Points"] == "1\u202f234 · 5.1\u202f%"
    assert rows["Mean, spread (1 σ)"] == "+12.35\u202f· 0.50\u202fµm".replace("\u202f·", " ·")
    assert rows["Largest of 2 places"] == "x 2, y 11\u202fµm"
    assert dict(brushed_rows(Brushed(0, 0.0, None, None, 0))) == {"Points": "0 · 0.0\u202f%"}
    assert around((0.0, 0.0, 10.0, 20.0)).bounds_um == (-5.0, -10.0, 15.0, 30.0)


def test_where_the_points_are_that_are_not_drawn():
    told_of = Statistics(
        rows=2000,
        cols=1650,
        pixel_um=1.0,
        n_heights=3_300_000,
        n_points=2_600_000,
        measured_fraction=1.0,
        filled_fraction=0.0,
        unmeasured=(),
        lowest_um=0.0,
        highest_um=1.0,
        mean_um=0.5,
        spread_um=0.1,
        left_out={"box": 0, "height": 600_000, "confidence": 100_000, "slab": 0},
    )
    words = counted(told_of, 1_200_000, View(clip=Clip(least_confidence=0.4)))
    assert words.startswith("<b>1.2 M of 3.3 M points</b>")
    assert "600 k clipped · 100 k under 0.40 · 1.4 M when nearer or in view" in words
    assert [amount(n) for n in (845, 1234, 12_345, 999_600)] == ["845", "1.2 k", "12 k", "1.0 M"]


def test_the_place_of_a_line_nearest_to_another():
    line = Region.line(0.0, 0.0, 10.0, 0.0)
    assert nearest_share(line, (2.5, 3.0)) == (0.25, 3.0)
    assert nearest_share(line, (14.0, 3.0)) == (1.0, 5.0)


def test_the_middle_of_the_picture_is_looked_at_and_its_right_lies_right():
    pose = CameraPose(np.array([0.0, -10.0, 0.0]), np.zeros(3))
    assert pixel_ray(pose, 0.5, 2.0, 0.5, 0.5) == pytest.approx([0.0, 1.0, 0.0])
    right_top = pixel_ray(pose, 0.5, 2.0, 1.0, 0.0)
    assert right_top[0] == pytest.approx(2 * np.tan(0.25))
    assert right_top[2] == pytest.approx(np.tan(0.25))
