"""Left panel: map of the sample with its clicks, and below it the lists of the step.

A second drawing on top shows the camera's view and the results, because it changes with every camera move.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

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
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.defects.defect_dialogs import other_marks
from wafer_viewer.gui.defects.defect_section import DefectSection
from wafer_viewer.gui.defects.die_views import DefectMap
from wafer_viewer.gui.elements.step import StepPanel
from wafer_viewer.gui.page.dialogs import Dialog, dataset_table, hold_dialog, open_dataset
from wafer_viewer.gui.page.import_dialog import import_dialog, take_drops
from wafer_viewer.gui.page.import_export_dialogs import open_dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import job_list
from wafer_viewer.gui.presenters.results import ReviewItem
from wafer_viewer.gui.presenters.review import review_items, review_list
from wafer_viewer.gui.scenes.thumbnails import Thumbnails
from wafer_viewer.gui.shell.saved_views import views_html
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.gauge.gauge_check import CHECK_PICKS, NOT_TICKED, check_list
from wafer_viewer.gui.steps.gauge.instrument import NOT_READ, calibration_list
from wafer_viewer.gui.steps.live.places import NOT_KEPT, PLACE_PICKS, live_places
from wafer_viewer.gui.steps.results import NOT_CHANGED, result_list
from wafer_viewer.gui.steps.surface.comparison import COMPARISON_PICKS, ComparisonForm, comparison_list
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.controls import Gui, HtmlBlock, command_button, in_a_row, set_prop
from wafer_viewer.gui.widgets.style import LEFT_PX
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.session.core.dataset_library import REMOVED
from wafer_viewer.session.rendering.render_request import Brushed
from wafer_viewer.session.state.snapshot import RigStatus, Snapshot

if TYPE_CHECKING:
    from wafer_viewer.gui.scenes.scene_view import SceneView


MOST_MARKS = 400
"""Maximum number of marked review items; more marks would hide each other."""
MANY_DATASETS = 8
"""Datasets from which the list can be searched."""
Drawn = tuple[tuple[Field, ...], dict[int, str], tuple[float, float] | None]


class FieldMap:
    """Map with legend, redrawn only when its content has changed."""

    def __init__(self, gui: Gui) -> None:
        HtmlBlock(gui, html.head("Map", first=True))
        self._marks = HtmlBlock(gui)
        self._map = HtmlBlock(gui)
        self._camera_view: Callable[[], Outline | None] = lambda: None
        self._brushed: Callable[[], Brushed | None] = lambda: None
        self._drawn: tuple[object, ...] | None = None
        self._frame: MapViewport | None = None

    def on_camera_view(self, view_um: Callable[[], Outline | None]) -> None:
        """Set the function that returns the ground area in the camera's view."""
        self._camera_view = view_um

    def on_brushed(self, brushed: Callable[[], Brushed | None]) -> None:
        """Set the function that returns the brushed points."""
        self._brushed = brushed

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring map and marks up to date."""
        key = _redraw_key(snapshot, view)
        if self._drawn is None or any(a is not b and a != b for a, b in zip(key, self._drawn, strict=True)):
            self._drawn = key
            self._draw(snapshot, view)
        if self._frame is not None and view.at_bench and snapshot.rig.limits is not None:
            drawing = map_marks_svg(self._frame, _in_view(snapshot.rig, snapshot.rig.limits), [], _live_areas(snapshot))
            self._marks.show(Markup('<div class="wv-over-map">{}</div>').format(drawing))
            return
        if self._frame is None or not view.on_surface:
            self._marks.show("")
            return
        areas = _areas(view, self._brushed())
        drawing = map_marks_svg(self._frame, self._camera_view() or (), _marks(snapshot, view), areas)
        self._marks.show(drawing and Markup('<div class="wv-over-map">{}</div>').format(drawing))

    def _draw(self, snapshot: Snapshot, view: View) -> None:
        fields, states, size_um = drawn(snapshot, view)
        of_data = snapshot.dataset is not None and view.step != "plan"
        overview = snapshot.dataset_overview if of_data else snapshot.overview
        outline = overview.outline_um if overview else extent_um(snapshot) if of_data and not fields else ()
        if size_um is None or not (fields or outline):
            self._frame = None
            self._map.show(_nothing(snapshot, view))
            return
        self._frame = map_frame(fields, *size_um, outline)
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
        below = (
            _legend(states) + _hint(snapshot, view) if fields else html.empty("A surface from a file:", "no fields.")
        )
        self._map.show(drawing + below)


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
            "Click a field to show only that one, again for all."
            if view.show > 0
            else "Click a field to show only that one."
        )
        text += " Elsewhere to fly there. The amber frame is in view."
    elif snapshot.scanning:
        return Markup()
    else:
        text = "Click a field to move the stage there." if snapshot.rig.can_start else ""
    return Markup('<div class="wv-lab" style="margin-top:4px">{}</div>').format(text) if text else Markup()


class LeftPanel:
    """Map, then jobs, saved views, and the lists of the step, such as datasets, defects or results."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self.panel = panel = page.gui.add_panel()
        with panel.add_tab("Sample"):
            self._where = page.gui.add_folder(None)
            with self._where:
                self.map = FieldMap(page.gui)
            self.dies = DefectMap(page)
            self._places = StepPanel(page, live_places, None, NOT_KEPT, PLACE_PICKS)
            self._works = HtmlBlock(page.gui)
            self._views = HtmlBlock(page.gui)
            self.defects = DefectSection(page)
            self._review = HtmlBlock(page.gui)
            self._gauge = StepPanel(page, check_list, None, NOT_TICKED, CHECK_PICKS)
            self._calibrations = StepPanel(page, calibration_list, None, NOT_READ)
            failed = "The comparison was not changed"
            self.compare = StepPanel(page, comparison_list, ComparisonForm(), failed, COMPARISON_PICKS)
            self._build_datasets()
            self._results = StepPanel(page, result_list, Thumbnails(page), NOT_CHANGED)
        panel.dock_left()
        panel.set_width(LEFT_PX)
        page.on_pick("open", lambda path: open_dataset(page, Path(path)))
        page.on_pick("cancel", page.session.cancel)
        page.on_pick("hold", lambda _: hold_dialog(page, end=False))
        page.on_pick("hold-end", lambda _: hold_dialog(page, end=True))

    @property
    def with_commands(self) -> tuple[DefectSection, DefectMap]:
        """Sections that have commands of their own."""
        return self.defects, self.dies

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the panel up to date."""
        checking = view.step == "gauge"  # its points and earlier checks need the room, as do defects
        dies = self.dies.show(snapshot, view)
        set_prop(self._where, "visible", not checking and not dies)
        if not dies:
            self.map.show(snapshot, view)
        self._works.show(job_list(snapshot, view))
        reviewing = view.step == "review" and snapshot.surface is not None  # the form or the list needs the room
        self._views.show("" if checking or reviewing or dies else views_html(snapshot, view))
        self.defects.show(snapshot, view)
        self._review.show(review_list(snapshot, view))
        self._gauge.show(snapshot, view)
        self._calibrations.show(snapshot, view)
        self.compare.show(snapshot, view)
        self._places.show(snapshot, view)
        set_prop(self._datasets, "visible", view.step in ("plan", "surface") and not view.at_bench)
        self._show_datasets()
        self._results.show(snapshot, view)

    def _build_datasets(self) -> None:
        page = self._page
        self._datasets = page.gui.add_folder(None, visible=False)
        with self._datasets:
            self._datasets_head = HtmlBlock(page.gui)
            self._find = page.gui.add_text(
                "Find", "", hint="Words of the name, lot, wafer, product, verdict or date, such as lot42 fail 2026-03"
            )
            self._find.on_update(guarded(page, "The search failed")(lambda _: self._show_datasets()))
            self._list = HtmlBlock(page.gui)
            self._frames = HtmlBlock(page.gui)
            opener = command_button(page.gui, "Open…", viser.Icon.FOLDER_OPEN, lambda _: open_dialog(page))
            take_drops(page)
            importer = command_button(page.gui, "Import…", viser.Icon.PHOTO_PLUS, lambda _: import_dialog(page))
            in_a_row(page.gui, [opener, importer])

    def _show_datasets(self) -> None:
        """Show the datasets that match what is searched for."""
        snapshot = self._page.session.snapshot
        self._datasets_head.show(html.head("Datasets", _shortened(snapshot.data_folder)))
        set_prop(self._find, "visible", len(snapshot.datasets) >= MANY_DATASETS or bool(self._find.value))
        self._list.show(_dataset_rows(snapshot, self._find.value))
        self._frames.show(frames_card(snapshot))


def _dataset_rows(snapshot: Snapshot, words: str) -> Markup:
    if not snapshot.datasets:
        return html.empty("No datasets in", f"{_shortened(snapshot.data_folder)} yet.") + Markup(
            '<div style="height:8px"></div>'
        )
    found = tuple(entry for entry in snapshot.datasets if entry.matches(words))
    if not found:
        return html.empty(f"None of {len(snapshot.datasets)} datasets has all of “{words}”.")
    opened = snapshot.dataset.path if snapshot.dataset else None
    return dataset_table(found, opened, "open") + Markup('<div style="height:6px"></div>')


def frames_card(snapshot: Snapshot) -> Markup:
    """Return how long the frames of the open dataset are kept, with the link that holds them or ends the hold."""
    data = snapshot.dataset
    entry = next((one for one in snapshot.datasets if data is not None and one.path == data.path), None)
    if data is None or entry is None or not data.fields or not data.finished:
        return Markup()
    told, link = entry.frames or "frames kept for ever", Markup()
    if data.held:
        told = f"held by {data.held}"
        link = Markup('<span class="wv-link" {}>End hold…</span>').format(
            html.command_pick("hold-end", action="Hold ended")
        )
    elif entry.frames != REMOVED and data.read_only is None:
        link = Markup('<span class="wv-link" {}>Hold…</span>').format(html.command_pick("hold"))
    return Markup('<div class="wv-lab" style="padding:0 6px 8px"><b>{}</b>: {} {}</div>').format(
        data.path.stem, told, link
    )


def _shortened(folder: Path) -> str:
    """Return a path with the home folder abbreviated to ~."""
    return f"~/{folder.relative_to(Path.home())}" if folder.is_relative_to(Path.home()) else str(folder)


WIDE_UM = 300.0
"""Side of the area shown around a place if the camera's view of the ground is unbounded."""


class MapClicks:
    """Click handler of the field map; fields are given by number, places in stage um."""

    def __init__(self, page: Page, scene: SceneView) -> None:
        self._page, self._scene = page, scene
        page.on_pick("field", lambda key: self._go_to_field(int(key)))
        page.on_pick("place", lambda key: self._go_to_place(*(float(um) for um in key.split(","))))

    def _go_to_field(self, chosen: int) -> None:
        """Move the stage to a field in Plan and Acquire; on a surface show the field, or all on a second click.

        Nothing moves for data that this rig did not take, because its fields have no stage position here.
        """
        page = self._page
        if page.view.on_surface:
            page.change(show=0 if page.view.show == chosen else chosen, frame_k=None, slice_z_um=None)
            return
        snapshot = page.session.snapshot
        if self._is_elsewhere:
            return
        field = next((f for f in drawn(snapshot, page.view)[0] if f.number == chosen), None)
        if field is not None and not snapshot.scanning:
            page.ask("The stage did not move", page.session.move_to(x_um=field.x_um, y_um=field.y_um))

    def _go_to_place(self, x_um: float, y_um: float) -> None:
        page, snapshot = self._page, self._page.session.snapshot
        many = len(drawn(snapshot, page.view)[0]) > MOST_SINGLE  # which have no element of their own to be clicked
        field = field_at(snapshot, page.view, x_um, y_um) if many else None
        if field is not None:
            self._go_to_field(field.number)
        elif page.view.on_surface:
            self._fly(x_um, y_um)
        elif snapshot.rig.can_start and not self._is_elsewhere:
            self._ask_to_move(x_um, y_um)

    @property
    def _is_elsewhere(self) -> bool:
        """True if the map shows data that this rig did not take."""
        snapshot, view = self._page.session.snapshot, self._page.view
        return view.step == "acquire" and snapshot.dataset is not None and not snapshot.is_of_this_rig

    def _fly(self, x_um: float, y_um: float) -> None:
        """Fly to a place and keep the size of the view."""
        corners = self._scene.visible_um()
        xs, ys = ([corner[k] for corner in corners] for k in (0, 1)) if corners else ((0.0, WIDE_UM), (0.0, WIDE_UM))
        half_x, half_y = (max(xs) - min(xs)) / 2, (max(ys) - min(ys)) / 2
        self._scene.fly_to((x_um - half_x, y_um - half_y, x_um + half_x, y_um + half_y))

    def _ask_to_move(self, x_um: float, y_um: float) -> None:
        place = f"X {number(x_um / 1000, 4, signed=True)}, Y {number(y_um / 1000, 4, signed=True)} mm"
        page = self._page
        dialog = Dialog(page, "Move the stage?", f"To {place}. Z does not change: check that nothing is in the way.")
        dialog.answers(
            "Move there",
            viser.Icon.CROSSHAIR,
            lambda: page.ask("The stage did not move", page.session.move_to(x_um=x_um, y_um=y_um)),
            "The stage did not move",
        )
