"""Left panel: map of the sample with its clicks, and below it the lists of the step.

A second drawing on top shows the camera's view and the results, because it changes with every camera move.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.wafer_map import (
    FIELD_INKS,
    MOST_SINGLE,
    FieldStyle,
    MapMark,
    MapViewport,
    MarkedArea,
    Outline,
    field_map_svg,
    map_frame,
    map_marks_svg,
)
from wafer_viewer.draw.colormaps import BRUSH
from wafer_viewer.draw.number_format import format_time, number
from wafer_viewer.gui.dialogs.dialog import REASON, Confirm, ask, ask_text
from wafer_viewer.gui.dialogs.import_dialog import import_dialog, take_drops
from wafer_viewer.gui.dialogs.open_and_export import open_dataset, open_dialog
from wafer_viewer.gui.elements.elements import Button, Buttons, Elements, Html, Text
from wafer_viewer.gui.elements.step import Here, Picks, StepPanel
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import job_list
from wafer_viewer.gui.presenters.review import ReviewItem, review_items
from wafer_viewer.gui.scenes.thumbnails import Thumbnails
from wafer_viewer.gui.shell.saved_views import views_html
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.gauge.gauge_check import CHECK_PICKS, NOT_TICKED, check_list
from wafer_viewer.gui.steps.gauge.instrument import NOT_READ, calibration_list
from wafer_viewer.gui.steps.live.places import NOT_KEPT, PLACE_PICKS, live_places
from wafer_viewer.gui.steps.results import NOT_CHANGED, result_list
from wafer_viewer.gui.steps.review.defect_list import DEFECT_PICKS, DefectsState, defect_list, review_list
from wafer_viewer.gui.steps.review.dialogs import other_marks
from wafer_viewer.gui.steps.review.die_map import MAP_PICKS, die_map, has_die_map
from wafer_viewer.gui.steps.review.judging import NOT_JUDGED, Review
from wafer_viewer.gui.steps.surface.comparison import COMPARISON_PICKS, ComparisonForm, comparison_list
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.style import LEFT_PX
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.session.core.dataset_library import REMOVED
from wafer_viewer.session.rendering.render_request import Brushed
from wafer_viewer.session.state.snapshot import DatasetEntry, RigStatus, Snapshot

HOLD_S = 30.0
"""Longest time to sign the record of a large dataset, s."""
MOST_MARKS = 400
"""Maximum number of marked review items; more marks would hide each other."""
MANY_DATASETS = 8
"""Datasets from which the list can be searched."""
WIDE_UM = 300.0
"""Side of the area shown around a place if the camera's view of the ground is unbounded."""
FIND_HINT = "Words of the name, lot, wafer, product, verdict or date, such as lot42 fail 2026-03"
NOT_MOVED, NOT_LISTED = "The stage did not move", "The list is not complete"
ICON = viser.Icon
Drawn = tuple[tuple[Field, ...], dict[int, str], tuple[float, float] | None]


@dataclass(frozen=True, slots=True)
class MapState:
    """Callbacks of the map to the scene, and its latest drawing.

    camera_view: returns the ground area in the camera's view; fly_to: flies over an area. key: values that the drawing
    depends on; viewport: that of the drawing, None without one.
    """

    camera_view: Callable[[], Outline | None] = lambda: None
    fly_to: Callable[[tuple[float, float, float, float]], Any] = lambda area: None
    key: tuple[object, ...] = ()
    viewport: MapViewport | None = None
    drawing: Markup = field(default_factory=Markup)


class LeftPanel:
    """Map, then jobs, saved views, and the lists of the step, such as datasets, defects or results."""

    def __init__(self, page: Page, review: Review) -> None:
        self.panel = panel = page.gui.add_panel()
        with panel.add_tab("Sample"):
            self.map = StepPanel(page, field_map, MapState(), NOT_MOVED, FIELD_PICKS)
            dies = StepPanel(page, die_map, (review, lambda: self.map.here.own.camera_view()), NOT_JUDGED, MAP_PICKS)
            places = StepPanel(page, live_places, None, NOT_KEPT, PLACE_PICKS)
            works = StepPanel(page, works_and_views, None, NOT_LISTED)
            defects = DefectsState(review=review, thumbnails=Thumbnails(page), fly=review.fly)
            self.defects = StepPanel(page, defect_list, defects, "The form was not changed", DEFECT_PICKS)
            features = StepPanel(page, reviewed, None, NOT_LISTED)
            gauge = StepPanel(page, check_list, None, NOT_TICKED, CHECK_PICKS)
            calibrations = StepPanel(page, calibration_list, None, NOT_READ)
            failed = "The comparison was not changed"
            self.compare = StepPanel(page, comparison_list, ComparisonForm(), failed, COMPARISON_PICKS)
            datasets = StepPanel(page, dataset_list, "", "The search failed", DATASET_PICKS)
            take_drops(page)
            results = StepPanel(page, result_list, Thumbnails(page), NOT_CHANGED)
        panel.dock_left()
        panel.set_width(LEFT_PX)
        self._parts = (self.map, dies, places, works, self.defects, features, gauge, calibrations, self.compare)
        self._parts = *self._parts, datasets, results

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the panel up to date."""
        for part in self._parts:
            part.show(snapshot, view)


def field_map(here: Here[MapState]) -> Elements | None:
    """Return map and legend, drawn anew only if their content has changed, and the marks over them.

    Gauge checks and dies need the room.
    """
    snapshot, view = here.snapshot, here.view
    if view.step == "gauge" or has_die_map(snapshot, view):
        return None
    key = _redraw_key(snapshot, view)
    if len(key) != len(here.own.key) or any(a is not b and a != b for a, b in zip(key, here.own.key, strict=True)):
        viewport, drawing = _drawing(snapshot, view)
        here.own = replace(here.own, key=key, viewport=viewport, drawing=drawing)
    marks = _over_map(here, here.own.viewport) if here.own.viewport is not None else ""
    over = Markup('<div class="wv-over-map">{}</div>').format(marks) if marks else ""
    return [Html(html.head("Map", first=True)), Html(over), Html(here.own.drawing)]


def _over_map(here: Here[MapState], viewport: MapViewport) -> Markup | str:
    snapshot, view, rig = here.snapshot, here.view, here.snapshot.rig
    if view.at_bench and rig.limits is not None:
        return map_marks_svg(viewport, _in_view(rig, rig.limits), [], _live_areas(snapshot))
    if not view.on_surface:
        return ""
    statistics = here.page.statistics
    areas = _areas(view, statistics.brushed if statistics is not None else None)
    return map_marks_svg(viewport, here.own.camera_view() or (), _marks(snapshot, view), areas)


def _drawing(snapshot: Snapshot, view: View) -> tuple[MapViewport | None, Markup]:
    fields, states, size_um = drawn(snapshot, view)
    of_data = snapshot.dataset is not None and view.step != "plan"
    overview = snapshot.dataset_overview if of_data else snapshot.overview
    outline = overview.outline_um if overview else extent_um(snapshot) if of_data and not fields else ()
    if size_um is None or not (fields or outline):
        return None, _nothing(snapshot, view)
    drawing = field_map_svg(
        fields,
        *size_um,
        states,
        outline_um=outline,
        dies_um=overview.dies_um if overview else (),
        selected=view.show if view.on_surface and view.show > 0 else None,
        pick="field",
        pick_place="" if snapshot.scanning else "place",
    )
    below = _legend(states) + _hint(snapshot, view) if fields else html.empty("A surface from a file:", "no fields.")
    return map_frame(fields, *size_um, outline), drawing + below


def _in_view(rig: RigStatus, limits: RigLimits) -> Outline:
    """Return the corners of the camera's field at the stage position."""
    x0, x1 = rig.x_um - limits.field_width_um / 2, rig.x_um + limits.field_width_um / 2
    y0, y1 = rig.y_um - limits.field_height_um / 2, rig.y_um + limits.field_height_um / 2
    return (x0, y0), (x1, y0), (x1, y1), (x0, y1)


def _live_areas(snapshot: Snapshot) -> list[MarkedArea]:
    """Return the area between the two marked corners."""
    if snapshot.live.area_um is None:
        return []
    (xa, ya), (xb, yb) = snapshot.live.area_um
    box = min(xa, xb), min(ya, yb), max(xa, xb), max(ya, yb)
    return [MarkedArea(box, "var(--accent)", "area to scan", dashed=True)]


def _nothing(snapshot: Snapshot, view: View) -> Markup:
    if snapshot.dataset is not None and view.step != "plan":
        return html.empty("A surface from a file:", "it has no fields.")
    return html.empty("The sample and its fields", "will be drawn here.")


def drawn(snapshot: Snapshot, view: View) -> Drawn:
    """Return the fields on the map, their states by number, and (width, height) of a field in um."""
    data, draft = snapshot.dataset, snapshot.draft
    if data is not None and view.step != "plan":
        plan = data.plan
        size_um = (plan.cols * plan.pixel_um, plan.rows * plan.pixel_um)
        return data.fields, {number: state.value for number, state in data.states.items()}, size_um
    if draft.job is None:
        return (), {}, None
    grid, limits = draft.job.grid, snapshot.rig.limits
    if grid is not None:
        size_um = (grid.field_width_um, grid.field_height_um)
    else:
        size_um = (limits.field_width_um, limits.field_height_um) if limits else None
    return draft.job.all_fields(), {}, size_um


def field_at(snapshot: Snapshot, view: View, x_um: float, y_um: float) -> Field | None:
    """Return the field that contains a place, the one with the nearest centre of several; None if there is none."""
    fields, _, size_um = drawn(snapshot, view)
    if size_um is None:
        return None
    half_x, half_y = size_um[0] / 2, size_um[1] / 2
    holding = [f for f in fields if abs(f.x_um - x_um) <= half_x and abs(f.y_um - y_um) <= half_y]
    return min(holding, key=lambda f: (f.x_um - x_um) ** 2 + (f.y_um - y_um) ** 2, default=None)


def extent_um(snapshot: Snapshot) -> Outline:
    """Return the corners of the stitched surface in stage um; empty if there is none."""
    info = snapshot.surface
    if info is None:
        return ()
    x0, y1 = info.x0_um - info.pixel_um / 2, info.y0_um + info.pixel_um / 2
    x1, y0 = x0 + info.cols * info.pixel_um, y1 - info.rows * info.pixel_um
    return (x0, y0), (x1, y0), (x1, y1), (x0, y1)


def _redraw_key(snapshot: Snapshot, view: View) -> tuple[object, ...]:
    """Return the values that the map depends on; large ones are compared by identity first."""
    data = snapshot.dataset if view.step != "plan" else None
    job, limits = snapshot.draft.job, snapshot.rig.limits
    of_data = (data.fields, data.states, data.plan) if data is not None else (job, limits, None)
    extent = extent_um(snapshot) if data is not None and not data.fields else ()
    return (
        *of_data,
        snapshot.overview,
        extent,
        view.on_surface,
        view.show,
        snapshot.scanning,
        snapshot.rig.can_start,
    )


def _areas(view: View, brushed: Brushed | None) -> list[MarkedArea]:
    """Return the marked areas: places of brushed heights, and the selection in the step Surface."""
    areas = [MarkedArea(box, BRUSH, "brushed heights") for box in brushed.places] if brushed and view.brush else []
    if view.selection is not None and view.step == "surface":
        areas.append(MarkedArea(view.selection, "var(--accent)", "selection", dashed=True))
    return areas


def _marks(snapshot: Snapshot, view: View) -> list[MapMark]:
    """Return the marks of the results in Measure, and of the review items in Review."""
    if view.step == "review":
        listed = review_items(snapshot, view.review_filter, view.defects)
        placed = [item for item in listed if item.box_um is not None]
        few = [*placed[:MOST_MARKS], *(item for item in placed[MOST_MARKS:] if item.key == view.review)]
        return [*other_marks(snapshot.defect_files.other), *(_judged(item, item.key == view.review) for item in few)]
    if view.step != "measure":
        return []
    results = [item for item in review_items(snapshot) if item.number is not None]
    return [_marked(r, r.colour, r.number == view.selected, html.pick("finding", r.number or 0)) for r in results]


def _judged(item: ReviewItem, chosen: bool) -> MapMark:
    colours = {"open": "var(--ink3)", "accepted": "var(--good)", "rejected": "var(--fault)"}
    verdict = item.judgement.verdict
    if item.defect is not None:
        return replace(
            _marked(item, item.colour, chosen, html.pick("review", item.key), f", {verdict}"), shape=item.shape
        )
    return _marked(item, colours[verdict], chosen, html.pick("review", item.key), f", {verdict}")


def _marked(item: ReviewItem, colour: str, chosen: bool, attributes: str, state: str = "") -> MapMark:
    x0, y0, x1, y1 = item.box_um or (0.0, 0.0, 0.0, 0.0)
    return MapMark((x0 + x1) / 2, (y0 + y1) / 2, colour, f"{item.sign} · {item.title}{state}", chosen, attributes)


def _legend(states: dict[int, str]) -> Markup:
    present = set(states.values())
    shown = [word for word in FIELD_INKS if word in present] or ["planned"]
    return html.legend((_swatch(FIELD_INKS[word]), FIELD_INKS[word].title) for word in shown)


def _swatch(ink: FieldStyle) -> Markup:
    fill = f"color-mix(in srgb,var(--{ink.edge}) {100 * ink.fill_opacity:.0f}%,transparent)"
    return html.swatch(fill, f"var(--{ink.edge})", ink.dashed)


def _hint(snapshot: Snapshot, view: View) -> Markup:
    if view.on_surface:
        text = (
            "Click a field to show only that one; click again for all."
            if view.show > 0
            else "Click a field to show only that one."
        )
        text += " Click elsewhere to move the view. The amber frame is in view."
    elif snapshot.scanning:
        return Markup()
    else:
        text = "Click a field to move the stage there." if snapshot.rig.can_start else ""
    return Markup('<div class="wv-lab" style="margin-top:4px">{}</div>').format(text) if text else Markup()


def go_to_field(here: Here[MapState], chosen: int) -> None:
    """Move the stage to a field in Plan and Acquire; on a surface show the field, or all on a second click.

    Nothing moves for data that this rig did not take, because its fields have no stage position here.
    """
    page = here.page
    if page.view.on_surface:
        page.change(show=0 if page.view.show == chosen else chosen, frame_k=None, slice_z_um=None)
        return
    snapshot = page.session.snapshot
    if _is_elsewhere(snapshot, page.view):
        return
    field = next((f for f in drawn(snapshot, page.view)[0] if f.number == chosen), None)
    if field is not None and not snapshot.scanning:
        page.ask(NOT_MOVED, page.session.move_to(x_um=field.x_um, y_um=field.y_um))


def go_to_place(here: Here[MapState], x_um: float, y_um: float) -> None:
    """Fly to a place of the surface; elsewhere ask whether the stage moves there."""
    page, snapshot = here.page, here.page.session.snapshot
    many = len(drawn(snapshot, page.view)[0]) > MOST_SINGLE  # which have no element of their own to be clicked
    field = field_at(snapshot, page.view, x_um, y_um) if many else None
    if field is not None:
        go_to_field(here, field.number)
    elif page.view.on_surface:
        _fly(here.own, x_um, y_um)
    elif snapshot.rig.can_start and not _is_elsewhere(snapshot, page.view):
        _ask_to_move(page, x_um, y_um)


FIELD_PICKS: Picks[MapState] = {
    "field": lambda here, key: go_to_field(here, int(key)),
    "place": lambda here, key: go_to_place(here, *(float(um) for um in key.split(","))),
}
"""Callbacks of clicks on the map; fields are given by number, places in stage um."""


def _is_elsewhere(snapshot: Snapshot, view: View) -> bool:
    """Return whether the map shows data that this rig did not take."""
    return view.step == "acquire" and snapshot.dataset is not None and not snapshot.is_of_this_rig


def _fly(scene: MapState, x_um: float, y_um: float) -> None:
    """Fly to a place and keep the size of the view."""
    corners = scene.camera_view()
    xs, ys = ([corner[k] for corner in corners] for k in (0, 1)) if corners else ((0.0, WIDE_UM), (0.0, WIDE_UM))
    half_x, half_y = (max(xs) - min(xs)) / 2, (max(ys) - min(ys)) / 2
    scene.fly_to((x_um - half_x, y_um - half_y, x_um + half_x, y_um + half_y))


def _ask_to_move(page: Page, x_um: float, y_um: float) -> None:
    place = f"X {number(x_um / 1000, 4, signed=True)}, Y {number(y_um / 1000, 4, signed=True)} mm"
    below = f"To {place}. Z does not change: check that nothing is in the way."
    answer = Confirm("Move there", ICON.CROSSHAIR, lambda _: page.session.move_to(x_um=x_um, y_um=y_um), NOT_MOVED)
    ask(page, "Move the stage?", below, answer)


def works_and_views(here: Here[None]) -> Elements:
    """Return the running jobs, and the saved views unless the room is needed."""
    snapshot, view = here.snapshot, here.view
    reviewing = view.step == "review" and snapshot.surface is not None
    crowded = view.step == "gauge" or reviewing or has_die_map(snapshot, view)
    return [Html(job_list(snapshot, view)), Html("" if crowded else views_html(snapshot, view))]


def reviewed(here: Here[None]) -> Elements:
    """Return the list of what is under review."""
    return [Html(review_list(here.snapshot, here.view))]


def dataset_table(entries: tuple[DatasetEntry, ...], opened: Path | None, what: str) -> Markup:
    """Return the table of datasets in the data folder; a click on one picks `what`."""
    if not entries:
        return html.empty("No datasets here yet.")

    def line(entry: DatasetEntry) -> Markup:
        signs = [word for word, yes in (("unfinished", entry.unfinished), ("simulated", entry.simulated)) if yes]
        marks = (
            Markup('<small style="color:var(--attention)">{}</small>').format(Markup(" · ").join(signs))
            if signs
            else Markup()
        )
        frames = Markup("<small>{}</small>").format(entry.frames) if entry.frames else Markup()
        name = Markup('<span class="wv-cut" title="{}">{}</span>{}{}').format(
            entry.path, entry.path.stem, marks, frames
        )
        look = "sel" if entry.path == opened else ""
        return html.row(
            [name, format_time(entry.taken, datetime.now().astimezone())],
            " n",
            html.command_pick(what, entry.path),
            look,
        )

    return html.table(["Name", "Taken"], [line(entry) for entry in entries], " n")


def hold_dialog(page: Page, *, end: bool) -> None:
    """Ask for the reason of a hold of the open dataset, or of its end."""
    kept = "They are not removed, whatever their age, until the hold is ended."
    below = "The frames may be removed again once they are old enough." if end else kept
    title, icon = ("End the hold", ICON.LOCK_OPEN) if end else ("Hold the frames", ICON.LOCK)
    verb = page.session.end_hold if end else page.session.hold_frames
    failed = "The hold was not ended" if end else "The frames are not held"
    hold = Confirm(title, icon, lambda here: verb(here.own).result(HOLD_S), failed)
    ask_text(page, title, below, ("Reason", "", REASON), hold)


def dataset_list(here: Here[str]) -> Elements | None:
    """Return the datasets that match what is searched for, and the buttons that open and import."""
    snapshot, view, page, words = here.snapshot, here.view, here.page, here.own
    if view.step not in ("plan", "surface") or view.at_bench:
        return None

    def find(words: str) -> None:
        here.own = words
        here.redraw()

    many = len(snapshot.datasets) >= MANY_DATASETS or bool(words)
    opener = Button("Open…", partial(open_dialog, page), ICON.FOLDER_OPEN, commands=True)
    importer = Button("Import…", partial(import_dialog, page), ICON.PHOTO_PLUS, commands=True)
    return [
        Html(html.head("Datasets", _shortened(snapshot.data_folder))),
        Text("Find", words, find, FIND_HINT) if many else None,
        Html(_dataset_rows(snapshot, words)),
        Html(frames_card(snapshot)),
        Buttons([opener, importer]),
    ]


DATASET_PICKS: Picks[str] = {
    "open": lambda here, path: open_dataset(here.page, Path(path)),
    "cancel": lambda here, work: here.page.session.cancel(work),
    "hold": lambda here, _: hold_dialog(here.page, end=False),
    "hold-end": lambda here, _: hold_dialog(here.page, end=True),
}
"""Callbacks of clicks on datasets and jobs."""


def _dataset_rows(snapshot: Snapshot, words: str) -> Markup:
    if not snapshot.datasets:
        return html.empty("No datasets in", f"{_shortened(snapshot.data_folder)} yet.") + Markup(
            '<div style="height:8px"></div>'
        )
    found = tuple(entry for entry in snapshot.datasets if entry.matches(words))
    if not found:
        return html.empty(f"None of {len(snapshot.datasets)} datasets matches “{words}”.")
    opened = snapshot.dataset.path if snapshot.dataset else None
    return dataset_table(found, opened, "open") + Markup('<div style="height:6px"></div>')


def frames_card(snapshot: Snapshot) -> Markup:
    """Return how long the frames of the open dataset are kept, with the link that holds them or ends the hold."""
    data = snapshot.dataset
    entry = next((one for one in snapshot.datasets if data is not None and one.path == data.path), None)
    if data is None or entry is None or not data.fields or not data.finished:
        return Markup()
    told, link = entry.frames or "frames kept permanently", Markup()
    if data.held:
        told = f"held by {data.held}"
        link = html.command_link("End hold…", "hold-end", action="Hold ended")
    elif entry.frames != REMOVED and data.read_only is None:
        link = html.command_link("Hold…", "hold")
    return Markup('<div class="wv-lab" style="padding:0 6px 8px"><b>{}</b>: {} {}</div>').format(
        data.path.stem, told, link
    )


def _shortened(folder: Path) -> str:
    """Return a path with the home folder abbreviated to ~."""
    return f"~/{folder.relative_to(Path.home())}" if folder.is_relative_to(Path.home()) else str(folder)
