"""The step Surface as a function: display, range, histogram, point cloud, pictures, recipe, comparisons, evidence."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.browser.sessions import fake_session as fake
from tests.browser.sessions.compared_session import AFTER, FIRST, comparisons
from tests.browser.sessions.seen_session import a_focus_curve
from tests.gui.steps.test_steps import Page, flat
from tests.gui.tools.test_clip_box import ON_SHOW
from tests.support.patience import until
from wafer_viewer.gui.elements.elements import Button, Html, Input
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.surface.comparison import (
    COMPARISON_PICKS,
    NOTHING_TO_COMPARE,
    ComparisonForm,
    blink,
    comparison_list,
)
from wafer_viewer.gui.steps.surface.focus_evidence import (
    CURVE,
    EVIDENCE_PICKS,
    FRAME_PICKS,
    ChosenFrame,
    Explained,
    evidence_dock,
    evidence_step,
    explain_click,
    toggle_explanation,
)
from wafer_viewer.gui.steps.surface.reconstruction import OWN
from wafer_viewer.gui.steps.surface.surface_step import SURFACE_PICKS, SurfaceState, surface_step
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.surface.clipping import Clip
from wafer_viewer.model.surface.comparison import ComparisonFace, show_of
from wafer_viewer.session.rendering.render_request import Brushed, ColourScale, Statistics

SCALE = ColourScale("height", 0.1, 9.9, 0.1, 9.9, 0.2, 9.8, ())
COUNTED = Statistics(
    rows=101,
    cols=201,
    pixel_um=1.0,
    n_heights=20_301,
    n_points=20_301,
    measured_fraction=1.0,
    filled_fraction=0.0,
    unmeasured=(),
    lowest_um=0.0,
    highest_um=10.0,
    mean_um=5.0,
    spread_um=2.0,
    ends_um=(0.0, 10.0),
    counts=(3, 1, 4, 1),
    span_um=(-5.0, 30.0),
)


class SurfacePage(Page):
    """A page with a surface on show."""

    def __init__(self, view: View) -> None:
        super().__init__(view)
        self.on_show, self.scale, self.statistics, self.drawn_points = ON_SHOW, SCALE, COUNTED, 4000
        self.unavailable: tuple[str, ...] = ("overlap",)
        self.said: list[str] = []

    def coloured_by(self, view: View) -> str:
        return view.colour_by

    def say(self, title: str, text: str, tone: Any = "good") -> None:
        self.said.append(text)


def surface(view: View, in_view: Any = None) -> Here[SurfaceState]:
    page: Any = SurfacePage(view)
    poses, statistics = SimpleNamespace(at=lambda _: None), SimpleNamespace(view_box_um=lambda: None, problem="")
    return Here(page, SurfaceState(poses, in_view, statistics))  # pyright: ignore[reportArgumentType]


def shown(here: Here[Any], step: Callable[[Here[Any]], Any] = surface_step) -> dict[str, Any]:
    """Inputs and buttons by label, as the page draws them next."""
    here.view, here.snapshot = here.page.view, here.page.session.snapshot
    return {e.label: e for e in flat(step(here)) if isinstance(e, Input | Button)}


def html_of(here: Here[Any], step: Callable[[Here[Any]], Any]) -> list[Html]:
    here.view = here.page.view
    return [e for e in flat(step(here)) if isinstance(e, Html)]


PICKS: dict[str, Any] = {**SURFACE_PICKS, **COMPARISON_PICKS, **EVIDENCE_PICKS, **FRAME_PICKS}


def pick(here: Here[Any], subject: str, key: str = "") -> None:
    PICKS[subject](here, key)


def test_the_colour_range_is_a_slider_with_two_typed_ends():
    here = surface(View(step="surface"))
    widgets = shown(here)
    assert not {"By hand", "Brush, µm"} & widgets.keys()
    assert widgets["From, to"].value == (0.1, 9.9)
    assert widgets["Range"].value == pytest.approx((0.1, 9.9), abs=widgets["Range"].step / 2)
    assert widgets["Range"].least <= -5.0
    assert widgets["Range"].most >= 30.0
    widgets["From, to"].put((2.0, 8.0))
    assert here.page.view.range_um == (2.0, 8.0)
    shown(here)["From, to"].put((8.0, 2.0))
    assert here.page.view.range_um == (2.0, 8.0)
    shown(here)["Whole range"].act()
    assert here.page.view.range_um == (-5.0, 30.0)
    shown(here)["0.5 – 99.5 %"].act()
    assert here.page.view.range_um is None


def test_what_is_in_view_sets_the_range_when_it_is_known():
    here = surface(View(step="surface"), in_view=lambda then: then((3.0, 4.0)))
    shown(here)["What is in view"].act()
    assert here.page.view.range_um == (3.0, 4.0)


def test_pictures_without_a_scale_have_no_range():
    widgets = shown(surface(View(step="surface", colour_by="grey")))
    assert widgets["Range"].disabled
    assert widgets["Colours"].disabled
    assert "Overlap difference" not in widgets["Colour by"].options


@pytest.mark.parametrize(
    ("label", "put", "field", "now"),
    [
        ("Height, ×", 5.0, "exaggeration", 5.0),
        ("Hillshade, %", 40.0, "hillshade", 0.4),
        ("All-in-focus, %", 25.0, "all_in_focus", 0.25),
        ("Show", "Field 4", "show", 4),
        ("Look", "plan", "look", "plan"),
        ("Colour by", "Slope", "colour_by", "slope"),
        ("Colours", "Cividis", "colours", "cividis"),
        ("Statistics for", "view", "counted", "view"),
        ("Fields and overlaps", True, "fields", True),
    ],
)
def test_an_input_changes_the_view_and_shows_it(label: str, put: Any, field: str, now: Any):
    here = surface(View(step="surface"))
    shown(here)[label].put(put)
    assert getattr(here.page.view, field) == now
    assert shown(here)[label].value == put


def test_the_statistics_of_a_selection_wait_for_one():
    here = surface(View(step="surface"))
    shown(here)["Statistics for"].put("selection")
    assert here.page.view.selecting
    assert "Measure the selection" not in shown(here)
    here.page.change(selection=(0.0, 1.0, 10.004, 11.0))
    shown(here)["Measure the selection"].act()
    assert here.page.view.tool == "flatness"
    assert here.page.view.places[0].bounds_um == (0.0, 1.0, 10.0, 11.0)


def test_heights_are_brushed_by_a_drag_or_typed():
    here = surface(View(step="surface"))
    pick(here, "histogram", "brush:0.2:0.5")
    assert here.page.view.brush_um == (2.0, 5.0)
    shown(here)["Brushed, µm"].put((3.0, 4.0))
    assert here.page.view.brush_um == (3.0, 4.0)
    pick(here, "unbrush")
    assert "Brushed, µm" not in shown(here)
    pick(here, "brush")
    assert shown(here)["Brushed, µm"].value == COUNTED.span_um


def test_brushed_heights_are_kept_as_points_or_measured():
    here = surface(View(step="surface", brush_um=(2.0, 5.0)))
    assert "Show only these" not in shown(here)  # not counted yet
    here.page.statistics = replace_statistics(brushed=Brushed(12, 0.1, 3.0, 0.5, 1, ((0.0, 0.0, 10.0, 20.0),)))
    keep = shown(here)["Show only these"]
    shown(here)["Measure the place"].act()
    assert (here.page.view.tool, here.page.view.places[0].bounds_um) == ("volume", (-5.0, -10.0, 15.0, 30.0))
    keep.act()
    assert (here.page.view.look, here.page.view.clip.heights_um) == ("points", (2.0, 5.0))


def replace_statistics(**changes: Any) -> Statistics:
    return Statistics(**{name: getattr(COUNTED, name) for name in COUNTED.__struct_fields__} | changes)


def test_points_alone_have_a_clip_box():
    here = surface(View(step="surface"))
    assert "X, µm" not in shown(here)
    here.page.change(look="points")
    widgets = shown(here)
    assert "Hillshade, %" not in widgets
    assert (widgets["X, µm"].value, widgets["Z, µm"].value) == ((0.0, 200.0), (-5.0, 30.0))
    assert widgets["Reset"].disabled
    widgets["Y, µm"].put((10.0, 60.0))
    shown(here)["Z, µm"].put((1.0, 2.0))
    shown(here)["Minimum confidence"].put(0.4)
    assert here.page.view.clip == Clip(box_um=(0.0, 10.0, 200.0, 60.0), heights_um=(1.0, 2.0), least_confidence=0.4)
    with pytest.raises(MeasureError, match="X ends at 3 um, before it begins at 7 um: swap them"):
        shown(here)["X, µm"].put((7.0, 3.0))
    shown(here)["Reset"].act()
    assert here.page.view.clip == Clip(least_confidence=0.4)
    assert shown(here)["To selection"].disabled
    shown(here)["To view"].act()
    assert here.page.view.clip.box_um == (0.0, 0.0, 200.0, 100.0)


def test_grips_of_the_histogram_clip_points():
    here = surface(View(step="surface", look="points"))
    pick(here, "histogram", "high:1:0.6")
    assert here.page.view.clip.heights_um == (-5.0, 6.0)


def test_the_pictures_have_a_slider_over_z_or_over_frames():
    here = surface(View(step="surface"))
    plan = here.snapshot.dataset.plan  # pyright: ignore[reportOptionalMemberAccess]
    shown(here)["One z"].put(True)
    slider = shown(here)["z, µm"]
    assert slider.least <= slider.value <= slider.most
    assert slider.step == plan.sweep.z_step_um
    here.page.change(show=2, slice_z_um=None)
    shown(here)["One frame"].put(True)
    assert shown(here)["Frame"].most == plan.sweep.frames_of(plan.field(2))
    shown(here)["Frame"].put(3)
    assert here.page.view.frame_k == 2
    shown(here)["One frame"].put(False)
    assert "Frame" not in shown(here)


def test_an_edited_recipe_holds_for_its_dataset():
    here = surface(View(step="surface"))
    assert "Preset" not in shown(here)
    pick(here, "recipe", "form")
    shown(here)["Smoothing"].put("None")
    shown(here)["Window"].put("9\u202fpx")
    assert (shown(here)["Smoothing"].value, shown(here)["Preset"].value) == ("None", OWN)
    shown(here)["Preset"].put("Default")
    assert shown(here)["Window"].value == "From the data"
    shown(here)["Window"].put("9\u202fpx")
    data = here.snapshot.dataset
    assert data is not None
    here.page.session.snapshot = replace(here.snapshot, dataset=replace(data, path=Path("other.wafer")))
    assert shown(here)["Window"].value == "From the data"


def test_it_is_not_reconstructed_while_the_dataset_cannot_be_changed():
    here = surface(View(step="surface"))
    pick(here, "recipe", "form")
    assert not shown(here)["Reconstruct again"].disabled
    data = here.snapshot.dataset
    assert data is not None
    here.page.session.snapshot = replace(here.snapshot, dataset=replace(data, read_only="It is held."))
    assert shown(here)["Reconstruct again"].disabled


def comparing(**of: Any) -> Here[ComparisonForm]:
    page: Any = SurfacePage(View(step="surface"))
    page.session.snapshot = replace(fake.measured(), comparisons=comparisons())
    page.session.comparing = SimpleNamespace(choices=lambda _: of.get("choices", ()), begin=of.get("begin"))
    return Here(page, ComparisonForm())


def test_without_another_surface_there_is_nothing_to_compare():
    here = comparing()
    assert "Compare with" not in shown(here, comparison_list)
    pick(here, "compare-new")
    assert shown(here, comparison_list)["Compare with"].value == NOTHING_TO_COMPARE
    assert shown(here, comparison_list)["Compare"].disabled


def test_the_chosen_pair_is_compared_as_the_form_says():
    begun: list[Any] = []

    def begin(*of: Any) -> Future[int]:
        begun.append(of)
        return Future()

    here = comparing(choices=((FIRST, AFTER),), begin=begin)
    pick(here, "compare-new")
    until(lambda: AFTER.words in shown(here, comparison_list)["Compare with"].options)
    shown(here, comparison_list)["Align"].put("By the stage")
    shown(here, comparison_list)["Keep height and tilt"].put(True)
    shown(here, comparison_list)["Compare"].act()
    assert begun == [(FIRST, AFTER, "stage", True)]
    assert "Compare with" not in shown(here, comparison_list)


def test_a_comparison_on_show_has_its_faces():
    here = comparing()
    number = here.page.session.snapshot.comparisons[0].number
    pick(here, "compare-look", str(number))
    assert shown(here, comparison_list)["Look at"].value is ComparisonFace.DIFFERENCE
    shown(here, comparison_list)["Look at"].put(ComparisonFace.SECOND)
    blink(here.page)
    assert here.page.view.show == show_of(number, ComparisonFace.FIRST)
    shown(here, comparison_list)["Close comparison"].act()
    assert here.page.view.show == 0


def test_a_comparison_that_is_gone_is_left():
    here = comparing()
    here.page.change(show=show_of(99, ComparisonFace.DIFFERENCE))
    shown(here, comparison_list)
    assert here.page.view.show == 0


def explaining(answer: Future[Any]) -> Here[Explained]:
    page: Any = SurfacePage(View(step="surface"))
    page.session.focus_curve = lambda *_: answer
    page.session.frame_near = lambda field, z_um: np.full((3000, 3000), 7, np.uint8)
    return Here(page, Explained())


def test_a_pixel_is_explained_after_a_click():
    answer = Future[Any]()
    here = explaining(answer)
    toggle_explanation(here)
    assert here.page.said == ["Click a place on the surface first."]  # pyright: ignore[reportAttributeAccessIssue]
    explain_click(here, 1.0, 2.0)
    assert not here.page.view.explains
    toggle_explanation(here)
    assert here.page.view.why == (1.0, 2.0)
    shown(here, evidence_step)
    dock: Any = Here(here.page, ChosenFrame())
    assert any("Reading the frames" in e.content for e in html_of(dock, evidence_dock))
    curve = a_focus_curve(-12.4, 37.0, True)
    answer.set_result(curve)
    until(lambda: here.ask.known(CURVE).value)
    assert any("Measured height" in e.content for e in html_of(here, evidence_step))
    until(lambda: any("wv-patch" in e.content for e in html_of(dock, evidence_dock)))
    pick(dock, "why-frame", str(curve.z_um[0]))
    until(lambda: any(f"frame 1 of {len(curve.z_um)}" in e.content for e in html_of(dock, evidence_dock)))
    pick(here, "why-close")
    assert not here.page.view.explains


def test_what_cannot_be_read_is_told_where_the_curve_would_stand():
    answer = Future[Any]()
    answer.set_exception(DatasetError("r0000c0000.tif is missing."))
    here = explaining(answer)
    here.page.change(why=(1.0, 2.0))
    dock: Any = Here(here.page, ChosenFrame())

    def told() -> bool:
        shown(here, evidence_step)
        return any("is missing" in e.content for e in html_of(dock, evidence_dock))

    until(told)


def test_another_surface_ends_the_explanation():
    here = explaining(Future())
    here.page.change(why=(1.0, 2.0))
    shown(here, evidence_step)
    here.page.change(show=3)
    shown(here, evidence_step)
    assert here.page.view.why is None
