"""Field map of the left panel: fields of the plan or of the open dataset, coloured by state.

A second drawing on top shows the camera's view and the results, because it changes with every camera move.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from wafer_viewer.draw.charts.map_marks import MapMark, MarkedArea, map_marks_svg
from wafer_viewer.draw.charts.wafer_map import FIELD_INKS, FieldStyle, MapViewport, Outline, field_map_svg, map_frame
from wafer_viewer.draw.colormaps import BRUSH
from wafer_viewer.gui.defects.klarf_overlay import other_marks
from wafer_viewer.gui.presenters.review.review_item import ReviewItem
from wafer_viewer.gui.presenters.review.review_items import review_items
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import Gui, HtmlBlock
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.session.rendering.render_request import Brushed
from wafer_viewer.session.state.snapshot import Snapshot

MOST_MARKS = 400
"""Maximum number of marked review items; more marks would hide each other."""
Drawn = tuple[tuple[Field, ...], dict[int, str], tuple[float, float] | None]


class FieldMap:
    """Map with legend, redrawn only when its content has changed."""

    def __init__(self, gui: Gui) -> None:
        HtmlBlock(gui, html.head("Map", first=True))
        self._marks = HtmlBlock(gui)
        self._map = HtmlBlock(gui)
        self._seen: Callable[[], Outline | None] = lambda: None
        self._brushed: Callable[[], Brushed | None] = lambda: None
        self._of: tuple[object, ...] | None = None
        self._frame: MapViewport | None = None

    def on_seen(self, seen_um: Callable[[], Outline | None]) -> None:
        """Set the function that returns the ground area in the camera's view."""
        self._seen = seen_um

    def on_brushed(self, brushed: Callable[[], Brushed | None]) -> None:
        """Set the function that returns the brushed points."""
        self._brushed = brushed

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring map and marks up to date."""
        of = _redraw_key(snapshot, view)
        if self._of is None or any(a is not b and a != b for a, b in zip(of, self._of, strict=True)):
            self._of = of
            self._draw(snapshot, view)
        if self._frame is None or not view.on_surface:
            self._marks.show("")
            return
        areas = _areas(view, self._brushed())
        drawing = map_marks_svg(self._frame, self._seen() or (), _marks(snapshot, view), areas)
        self._marks.show(drawing and f'<div class="wv-over-map">{drawing}</div>')

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
            onclick=html.pick_script("field"),
            onplace="" if snapshot.scanning else html.pick_script("place"),
        )
        below = (
            _legend(states) + _hint(snapshot, view) if fields else html.empty("A surface from a file:", "no fields.")
        )
        self._map.show(drawing + below)


def _nothing(snapshot: Snapshot, view: View) -> str:
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
        snapshot.rig.state == "ready",
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
        return [*other_marks(snapshot.shelf.other), *(_judged(item, item.key == view.review) for item in few)]
    if view.step != "measure":
        return []
    results = [item for item in review_items(snapshot) if item.number is not None]
    return [_at(r, r.colour, r.number == view.selected, html.pick("finding", r.number or 0)) for r in results]


def _judged(item: ReviewItem, chosen: bool) -> MapMark:
    colours = {"open": "var(--ink3)", "accepted": "var(--good)", "rejected": "var(--fault)"}
    verdict = item.judgement.verdict
    if item.defect is not None:
        return replace(_at(item, item.colour, chosen, html.pick("review", item.key), f", {verdict}"), shape=item.shape)
    return _at(item, colours[verdict], chosen, html.pick("review", item.key), f", {verdict}")


def _at(item: ReviewItem, colour: str, chosen: bool, attributes: str, told: str = "") -> MapMark:
    x0, y0, x1, y1 = item.box_um or (0.0, 0.0, 0.0, 0.0)
    return MapMark((x0 + x1) / 2, (y0 + y1) / 2, colour, f"{item.sign} · {item.title}{told}", chosen, attributes)


def _legend(states: dict[int, str]) -> str:
    present = set(states.values())
    shown = [word for word in FIELD_INKS if word in present] or ["planned"]
    return html.legend((_swatch(FIELD_INKS[word]), FIELD_INKS[word].title) for word in shown)


def _swatch(ink: FieldStyle) -> str:
    fill = f"color-mix(in srgb,var(--{ink.edge}) {100 * ink.fill_opacity:.0f}%,transparent)"
    return html.swatch(fill, f"var(--{ink.edge})", ink.dashed)


def _hint(snapshot: Snapshot, view: View) -> str:
    if view.on_surface:
        text = (
            "Click a field to show only that one, again for all."
            if view.show > 0
            else "Click a field to show only that one."
        )
        text += " Elsewhere to fly there. The amber frame is in view."
    elif snapshot.scanning:
        return ""
    else:
        text = "Click a field to move the stage there." if snapshot.rig.state == "ready" else ""
    return f'<div class="wv-lab" style="margin-top:4px">{text}</div>' if text else ""
