"""List of results on the left: select and fly to, rename, delete, undo and redo, CSV."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.gui.dialogs.dialog import ask_name
from wafer_viewer.gui.dialogs.open_and_export import save_dialog
from wafer_viewer.gui.elements.elements import Button, Buttons, Elements, Html
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.measurement import REGION_COLOUR, list_text, sign_colour, surface_name, symbol
from wafer_viewer.gui.presenters.results import Box, bounds_of
from wafer_viewer.gui.scenes.thumbnails import Thumbnails
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.tools import TOOL_OF_RESULT
from wafer_viewer.session.state.snapshot import Snapshot

ROUND_PLACES = 2.4
"""Size of the area shown around a result, relative to its regions."""
LEAST_SHOWN_PX = 120
"""Minimum size of the area shown, in pixels of the surface; closer views add no detail."""


def result_list(here: Here[Thumbnails]) -> Elements | None:
    """Return the saved results with thumbnail, value and uncertainty, and what can be done with them."""
    snapshot, view, page = here.snapshot, here.view, here.page
    if view.step != "measure":
        return None
    chosen = next((f for f in snapshot.findings if f.number == view.selected), None)

    def command(label: str, act: Callable[[], Any], icon: Any, possible: object, failed: str) -> Button:
        return Button(label, act, icon, disabled=not possible, commands=True, failed=failed)

    icon, session = viser.Icon, page.session
    of_one = [
        Button("CSV…", lambda: _export(page), icon.TABLE_EXPORT, failed="Export failed"),
        command("Rename", lambda: rename_result(page), icon.PENCIL, chosen, "The name was not changed"),
        command("Delete", lambda: delete_result(page), icon.TRASH, chosen, NOT_CHANGED),
    ]
    undo, redo = snapshot.findings_undo, snapshot.findings_redo
    of_all = [
        command("Undo", session.undo_findings, icon.ARROW_BACK_UP, undo, "Nothing was undone"),
        command("Redo", session.redo_findings, icon.ARROW_FORWARD_UP, redo, "Nothing was redone"),
    ]
    return [
        Html(html.head("Results", str(len(snapshot.findings) or "")) + _rows(here.own, snapshot, view)),
        Buttons(of_one, 30) if snapshot.findings else None,
        Buttons(of_all, 30) if snapshot.findings or undo or redo else None,
    ]


NOT_CHANGED = "The result was not changed"


def choose_result(page: Page, number: int, fly: Callable[[Box], object]) -> None:
    """Show a result on its surface with its tool and regions; a second click deselects it."""
    finding = next((f for f in page.session.snapshot.findings if f.number == number), None)
    if finding is None or page.view.selected == number:
        page.change(selected=None)
        return
    page.change(selected=number, **_as_measured(finding, page.view))
    info = page.session.snapshot.surface
    fly(_round(bounds_of(finding), LEAST_SHOWN_PX * info.pixel_um if info else 0.0))


def rename_result(page: Page) -> None:
    """Open the dialog that renames the selected result."""
    chosen = next((f for f in page.session.snapshot.findings if f.number == page.view.selected), None)
    if chosen is not None:
        ask_name(
            page,
            "Rename the result",
            "The name appears in the list, in exports and in reports.",
            chosen.name,
            lambda name: page.session.rename(chosen.number, name.strip()),
        )


def delete_result(page: Page) -> None:
    """Delete the selected result."""
    if page.view.step == "measure" and page.view.selected is not None:
        deleted = page.session.delete(page.view.selected)
        page.ask(NOT_CHANGED, deleted, lambda _: page.change(selected=None))


def _export(page: Page) -> None:
    if (data := page.session.snapshot.dataset) is not None:
        name = f"{data.path.stem}-results.csv"
        save_dialog(page, "Save the results", name, page.session.export_findings, "Results exported", "Export failed")


def _rows(thumbnails: Thumbnails, snapshot: Snapshot, view: View) -> Markup:
    if not snapshot.findings:
        return html.empty("What you keep is listed here.") + Markup('<div style="height:8px"></div>')
    rows = [_row(f, view, thumbnails.of(f, snapshot)) for f in snapshot.findings]
    return html.table(["", "Result", "U: 95 %"], rows, "  n") + Markup('<div style="height:6px"></div>')


def _row(finding: AnyResult, view: View, thumbnail: str) -> Markup:
    colour = sign_colour(finding)
    sign = html.chip(symbol(finding), "" if colour == REGION_COLOUR else colour)
    name = Markup('<span class="wv-cut wv-short" title="{}">{}</span>').format(finding.name, finding.name)
    elsewhere = " · ".join(_source_differences(finding, view))
    detail = Markup('<small class="wv-cut wv-short" title="{}">{}</small>').format(elsewhere, elsewhere)
    return html.row(
        [
            thumbnail,
            Markup('<div class="wv-result">{}<div>{}{}</div></div>').format(sign, name, detail if elsewhere else ""),
            list_text(finding),
        ],
        "  n",
        html.pick("finding", finding.number),
        "sel" if finding.number == view.selected else "",
    )


def _source_differences(finding: AnyResult, view: View) -> list[str]:
    """Return the surface and levelling of a result, each only if it differs from the displayed one."""
    notes = [surface_name(finding)] if finding.show != view.show else []
    return notes + ([f"zero: {finding.levelling.by}"] if finding.levelling != view.levelling else [])


def _as_measured(finding: AnyResult, view: View) -> dict[str, Any]:
    """Return the view changes that show a result as it was measured."""
    tool = TOOL_OF_RESULT.get(type(finding))
    changes: dict[str, Any] = {"why": None}
    if tool is not None:
        changes["tool"] = tool.name
        changes |= {"lines": finding.inputs, "line": 0} if tool.name == "profile" else {"places": finding.inputs}
    if (finding.show, finding.levelling) != (view.show, view.levelling):
        changes |= {"show": finding.show, "levelling": finding.levelling, "range_um": None}
        changes |= {"frame_k": None, "slice_z_um": None}
    return changes


def _round(bounds: Box, least_um: float) -> Box:
    """Return the box to show for regions within bounds."""
    x0, y0, x1, y1 = bounds
    half = max(ROUND_PLACES * max(x1 - x0, y1 - y0), least_um) / 2
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    return x - half, y - half, x + half, y + half
