"""The map of the left panel: the fields of the plan or of the open dataset, by how far they have come."""

from __future__ import annotations

from wafer_viewer.draw.wafer_map import FIELD_INKS, Ink, field_map_svg
from wafer_viewer.gui import html
from wafer_viewer.gui.view import View
from wafer_viewer.model.plan import Field
from wafer_viewer.session.state import Snapshot


def field_map(snapshot: Snapshot, view: View) -> str:
    """The drawing with its legend; before there is anything, what will be there."""
    fields, states, size_um = _fields(snapshot, view)
    overview = snapshot.overview
    outline = overview.outline_um if overview else ()
    if not fields or size_um is None:
        return html.empty("The sample and its fields", "will be drawn here.")
    drawing = field_map_svg(
        fields,
        *size_um,
        states,
        outline_um=outline,
        dies_um=overview.dies_um if overview else (),
        selected=view.show if view.on_surface and view.show > 0 else None,
        onclick=html.pick_script("field"),
    )
    return drawing + _legend(states) + _hint(snapshot, view)


def _fields(snapshot: Snapshot, view: View) -> tuple[tuple[Field, ...], dict[int, str], tuple[float, float] | None]:
    """Fields, the words of their states, and (width, height) of one in um."""
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


def _legend(states: dict[int, str]) -> str:
    shown = [word for word in FIELD_INKS if word in states.values()] or ["planned"]
    return html.legend((_swatch(FIELD_INKS[word]), FIELD_INKS[word].title) for word in shown)


def _swatch(ink: Ink) -> str:
    fill = f"color-mix(in srgb,var(--{ink.edge}) {100 * ink.fill_opacity:.0f}%,transparent)"
    return html.swatch(fill, f"var(--{ink.edge})", ink.dashed)


def _hint(snapshot: Snapshot, view: View) -> str:
    if view.on_surface:
        text = "Click a field to see it alone, again for all." if view.show else "Click a field to see it alone."
    elif snapshot.scanning:
        return ""
    else:
        text = "Click a field to move the stage there." if snapshot.rig.state == "ready" else ""
    return f'<div class="wv-lab" style="margin-top:4px">{text}</div>' if text else ""
