"""Table of the page's commands with their keys, their sheet, and the command palette.

A command that is not possible notifies why when it is chosen, by key or in the palette.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, get_args

import viser
from markupsafe import Markup

from wafer_viewer.draw.colormaps import COLOUR_MAPS
from wafer_viewer.gui.dialogs.dialog import Dialog
from wafer_viewer.gui.dialogs.import_dialog import import_dialog
from wafer_viewer.gui.dialogs.open_and_export import (
    audit_dialog,
    export_dialog,
    export_fields_dialog,
    load_plan_dialog,
    open_dialog,
)
from wafer_viewer.gui.dialogs.stop import stop
from wafer_viewer.gui.elements.elements import Html
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import (
    cannot_go_to,
    no_corner,
    no_dataset,
    no_fields_to_show,
    no_frames,
    no_line,
    no_other_line,
    no_result,
    no_room_for_lines,
    no_surface,
    not_on_defect,
    nothing_to_redo,
    nothing_to_undo,
    surface_not_drawable,
    surface_not_shown,
)
from wafer_viewer.gui.page.work_steps import TITLES
from wafer_viewer.gui.security.access_guard import DOCUMENTATION
from wafer_viewer.gui.shell.header import switch_theme
from wafer_viewer.gui.state.view_state import Step, View
from wafer_viewer.gui.steps.acquire import RETAKE, pause_or_resume, retake, why_not_retaken
from wafer_viewer.gui.steps.measure import MeasureState, keep_result, use_tool, why_not_keep
from wafer_viewer.gui.steps.plan import save, start, why_not_start
from wafer_viewer.gui.steps.plan_form import PlanState
from wafer_viewer.gui.steps.profiles import LineCommands
from wafer_viewer.gui.steps.results import delete_result, rename_result
from wafer_viewer.gui.steps.review.judging import Review
from wafer_viewer.gui.steps.surface.focus_evidence import Explained, toggle_explanation
from wafer_viewer.gui.steps.surface.surface_step import COLOUR_BY, FULL_BLEND, FULL_SHADE, LOOKS
from wafer_viewer.gui.tools.tool_palette import icon_of
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.controls import Command, Group, add_html, with_precondition
from wafer_viewer.gui.widgets.html import typeset
from wafer_viewer.model.glossary import Subject, terms_of
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.session.files.documentation import FIRST_PAGE, site_folder
from wafer_viewer.session.state.snapshot import Snapshot

ICON = viser.Icon
STEP_KEYS: dict[Step, str] = {
    "plan": "P",
    "acquire": "A",
    "surface": "S",
    "measure": "M",
    "gauge": "G",
    "review": "R",
    "report": "O",
}
"""Keys of the steps, each with shift."""
EXAGGERATION_STEP, MOST_EXAGGERATED = 1.0, 20.0


@dataclass(frozen=True, slots=True)
class Parts:
    """Panels whose commands have keys."""

    plan: Here[PlanState]
    measure: Here[MeasureState]
    why: Here[Explained]
    review: Review


def commands_of(page: Page, parts: Parts) -> list[Command]:
    """Return every command of the page with its key."""
    return [
        *_going(page),
        *_planning(page, parts),
        *_acquiring(page),
        *_looking_at_surface(page, parts),
        *_measuring(page, parts),
        *_of_the_page(page, parts),
    ]


def _going(page: Page) -> list[Command]:
    def go(step: Step) -> None:
        page.change(step=step, why=None)

    return [
        Command(TITLES[step], key, lambda s=step: go(s), ICON.ARROW_RIGHT, "shift", "Go to", why_not=cannot_go_to(step))
        for step, key in STEP_KEYS.items()
    ]


def _planning(page: Page, parts: Parts) -> list[Command]:
    session = page.session
    ask = _asking(page)

    def scan_or_pause() -> None:
        if session.snapshot.scanning:
            pause_or_resume(page)
        else:
            start(parts.plan)

    def why_not(snapshot: Snapshot, _: View) -> str | None:
        return None if snapshot.scanning else why_not_start(parts.plan, snapshot)

    close = ask("The dataset was not closed", session.close_dataset)
    return [
        Command("Scan, pause, continue", "G", scan_or_pause, ICON.PLAYER_PLAY, group="Plan", why_not=why_not),
        Command(
            "Cover the sample",
            "C",
            ask("The grid was not changed", session.cover_sample),
            ICON.ARROWS_MAXIMIZE,
            "shift",
            "Plan",
        ),
        Command(
            "Move the grid to the stage",
            None,
            ask("The grid was not changed", session.centre_on_stage),
            ICON.CROSSHAIR,
            group="Plan",
        ),
        Command(
            "Save plan…",
            "S",
            partial(save, page),
            ICON.DEVICE_FLOPPY,
            "cmd/ctrl",
            "Plan",
        ),
        Command("Load plan…", None, lambda: load_plan_dialog(page), ICON.FOLDER_OPEN, group="Plan"),
        Command("Open a dataset…", "O", lambda: open_dialog(page), ICON.FOLDER_OPEN, "cmd/ctrl", "Plan"),
        Command("Import images…", "I", lambda: import_dialog(page), ICON.PHOTO_PLUS, "shift", "Plan"),
        Command("Close the dataset", None, close, ICON.X, group="Plan", why_not=no_dataset),
    ]


def _acquiring(page: Page) -> list[Command]:
    go_on = _asking(page)("The scan was not continued", page.session.continue_scan)

    def check() -> None:
        page.ask("The frames were not checked", page.session.check_frames(), told)

    def told(damaged: tuple[Any, ...]) -> None:
        if damaged:
            page.change(step="acquire")
        else:
            page.say("No frame is damaged", "Every frame is as it was taken.")

    def retaken(snapshot: Snapshot, _: View) -> str | None:
        return why_not_retaken(snapshot)

    return [
        Command("Stop all motion", "escape", lambda: stop(page), ICON.PLAYER_STOP, "shift", "Acquire"),
        Command("Continue an unfinished scan", None, go_on, ICON.PLAYER_PLAY, group="Acquire", why_not=no_dataset),
        Command("Check the frames", None, check, ICON.SHIELD_CHECK, group="Acquire", why_not=no_frames),
        Command(RETAKE, None, partial(retake, page), ICON.REFRESH, group="Acquire", why_not=retaken),
    ]


def _looking_at_surface(page: Page, parts: Parts) -> list[Command]:
    def toggle(name: str, full: Any) -> Callable[[], None]:
        return lambda: page.change(**{name: type(full)(0) if getattr(page.view, name) else full})

    def exaggerate(by: float) -> None:
        page.change(exaggeration=min(max(1.0, page.view.exaggeration + by), MOST_EXAGGERATED))

    def set_to(**choices: Any) -> Callable[[], None]:
        return lambda: page.change(**choices)

    def export() -> None:
        export_dialog(page)

    def export_fields() -> None:
        export_fields_dialog(page)

    return with_precondition(
        surface_not_drawable,
        Command("Hillshade", "H", toggle("hillshade", FULL_SHADE), ICON.SUN, group="Surface"),
        Command("All-in-focus", "U", toggle("all_in_focus", FULL_BLEND), ICON.FOCUS_2, group="Surface"),
        *with_precondition(
            no_fields_to_show,
            Command("Fields and overlaps", "O", toggle("fields", True), ICON.GRID_DOTS, group="Surface"),
        ),
        *with_precondition(
            surface_not_shown,
            Command(
                "Why this height?",
                "C",
                partial(toggle_explanation, parts.why),
                ICON.ZOOM_QUESTION,
                group="Surface",
                here=lambda _, view: view.step != "plan",
            ),
        ),
        Command("Higher z", "pageup", lambda: exaggerate(EXAGGERATION_STEP), ICON.ARROWS_VERTICAL, "shift", "Surface"),
        Command(
            "Lower z", "pagedown", lambda: exaggerate(-EXAGGERATION_STEP), ICON.ARROWS_VERTICAL, "shift", "Surface"
        ),
        Command("Colours from 0.5 to 99.5 %", "J", set_to(range_um=None), ICON.CHART_HISTOGRAM, group="Surface"),
        Command("Export the surface…", "E", export, ICON.DOWNLOAD, "shift", "Surface", why_not=no_surface),
        Command("Export the fields…", None, export_fields, ICON.DOWNLOAD, group="Surface", why_not=no_surface),
        *(
            Command(f"Draw as {name.lower()}", None, set_to(look=look), ICON.CUBE, group="Surface")
            for look, name in LOOKS
        ),
        *(
            Command(
                f"Colour by {name.lower()}", None, set_to(colour_by=by, range_um=None), ICON.PALETTE, group="Surface"
            )
            for name, by in COLOUR_BY.items()
        ),
        *(
            Command(f"Colours {name}", None, set_to(colours=key), ICON.PALETTE, group="Surface")
            for key, name in COLOUR_MAPS.items()
        ),
    )


def _measuring(page: Page, parts: Parts) -> list[Command]:
    tools = [
        Command(
            tool.title,
            tool.key,
            lambda t=tool.name: use_tool(page, t),
            icon_of(tool),
            tool.modifier,
            "Measure",
            here=not_on_defect if tool.modifier == "shift" else None,
        )
        for tool in TOOLS.values()
        if tool.key
    ]
    lines = LineCommands(page)
    keep = Command("Keep the result", "enter", lambda: keep_result(parts.measure), ICON.CHECK, "cmd/ctrl", "Measure")
    return [
        *with_precondition(
            no_surface,
            *tools,
            Command("Horizontal cut", "H", lambda: lines.cut("row"), ICON.ARROWS_HORIZONTAL, "shift", "Measure"),
            Command("Vertical cut", "V", lambda: lines.cut("column"), ICON.ARROWS_VERTICAL, "shift", "Measure"),
        ),
        *with_precondition(
            no_room_for_lines, Command("Add a profile line", "L", lines.add, ICON.PLUS, "shift", "Measure")
        ),
        *with_precondition(
            no_line,
            Command("Add a corner to the profile line", None, lines.add_corner, ICON.VECTOR_SPLINE, group="Measure"),
        ),
        *with_precondition(
            no_corner,
            Command("Remove a corner of the profile line", None, lines.remove_corner, ICON.LINE, group="Measure"),
        ),
        *with_precondition(
            no_other_line,
            Command("Remove the profile line", None, lines.remove, ICON.TRASH, group="Measure"),
            Command(
                "Next profile line",
                "N",
                lines.next,
                ICON.ARROW_RIGHT,
                "shift",
                "Measure",
                here=not_on_defect,
            ),
        ),
        *with_precondition(partial(why_not_keep, parts.measure), keep),
        *with_precondition(
            no_result,
            Command("Rename the result…", None, lambda: rename_result(page), ICON.PENCIL, group="Measure"),
            Command("Delete the result", "delete", lambda: delete_result(page), ICON.TRASH, group="Measure"),
        ),
    ]


def _of_the_page(page: Page, parts: Parts) -> list[Command]:
    session = page.session

    def undo() -> None:
        of_step = {"plan": session.undo, "acquire": session.undo, "measure": session.undo_findings}
        if (command := of_step.get(page.view.step)) is not None:
            page.ask("Nothing was undone", command())
        else:
            parts.review.take_back("undo")

    def redo() -> None:
        of_step = {"plan": session.redo, "acquire": session.redo, "measure": session.redo_findings}
        if (command := of_step.get(page.view.step)) is not None:
            page.ask("Nothing was redone", command())
        else:
            parts.review.take_back("redo")

    def leave() -> None:
        """Close the innermost open item: tour, explanation, sheet, filter, selection, brush or tool."""
        if page.view.tour is not None:
            page.change(tour=None)
        elif page.view.explains:
            page.change(why=None)
        elif page.view.sheet_over in ("gallery", "stack"):
            page.change(sheet="beside", marked=())
        elif page.view.lists_some:
            page.change(defects=page.view.defects.widened)
        elif page.view.selecting:
            page.change(selecting=False)
        elif page.view.step == "surface" and page.view.brush_um is not None:
            page.change(brush_um=None)
        elif page.view.step == "surface" and page.view.selection is not None:
            page.change(selection=None, counted="all")
        elif page.view.tool == "none" and page.view.selected is None:
            page.change(brush_um=None)
        else:
            page.change(tool="none", selected=None)

    def in_use(_: Snapshot, view: View) -> bool:
        """Handle Escape only if a tool, selection, filter or sheet is open."""
        selects = view.step == "surface" and (view.selecting or view.selection is not None)
        narrowed = (
            view.lists_some
            or view.tour is not None
            or view.sheet_over in ("gallery", "stack")
            or view.brush is not None
        )
        return selects or view.explains or narrowed or view.tool != "none" or view.selected is not None

    return [
        Command("Leave the tool", "escape", leave, ICON.X, group="Page", here=in_use),
        *with_precondition(nothing_to_undo, Command("Undo", "Z", undo, ICON.ARROW_BACK_UP, "cmd/ctrl", "Page")),
        *with_precondition(
            nothing_to_redo, Command("Redo", "Z", redo, ICON.ARROW_FORWARD_UP, "cmd/ctrl+shift", "Page")
        ),
        Command("Light or dark page", "D", partial(switch_theme, page), ICON.MOON, "shift", "Page"),
    ]


def _asking(page: Page) -> Callable[..., Callable[[], None]]:
    """Return a factory of key actions that run a session command and report its failure under a given title."""

    def ask(
        name: str, verb: Callable[[], Future[Any]], then: Callable[[Any], None] | None = None
    ) -> Callable[[], None]:
        return lambda: page.ask(name, verb(), then)

    return ask


FIXED_KEYS: dict[Group, tuple[tuple[str, str], ...]] = {
    "Page": (
        ("Every command by name", "Ctrl + K"),
        ("This list", "F1 or ?"),
        ("Next, previous field or button", "Tab, Shift + Tab"),
        ("To the main button of the step", "."),
        ("Leave a text field", "Enter or Esc"),
    ),
    "Plan": (
        ("Live: X and Y of the stage, in the ringed pad", "8 2 4 6"),
        ("Live: Z up, Z down", "9 3"),
        ("Live: go to focus", "5"),
        ("Live: smaller, larger steps", "7 1"),
        ("Live: ten times as far", "Shift"),
        ("Live: leave the pad", "Esc"),
    ),
    "Look": (("Saved view 1 … 9", "Shift + 1 … 9"), ("Move the camera", "W A S D Q E"), ("Turn it", "arrows")),
}
"""Keys without a command in the table, and keys that stand for several commands."""


def shortcut_table(commands: Sequence[Command]) -> Markup:
    """Return all keys by group as HTML."""
    groups = [(group, _rows(group, commands)) for group in get_args(Group)]
    drawn = Markup("").join(_group(group, rows) for group, rows in groups if rows)
    return Markup('<div class="wv-sheet" role="region" aria-label="Keys" tabindex="0"><div>{}</div></div>').format(
        drawn
    )


def documentation_link() -> Markup:
    """Return the link to the documentation on the page's own server, or how to get it."""
    if site_folder() is None:
        how = '<p class="wv-docs">The documentation is not built: <code>{}</code> in a checkout.</p>'
        return Markup(how).format("wafer-viewer docs --build")
    link = Markup('<a class="wv-docs" href="{}{}" target="_blank" rel="noopener">Open the documentation</a>')
    return link.format(DOCUMENTATION, FIRST_PAGE)


def add_shortcut_dialog(page: Page, commands: Sequence[Command]) -> Command:
    """Return the command that shows the sheet, which a key of the browser (keyboard.js) asks for, too."""

    def show() -> None:
        below = "Every command is also in the command palette: Ctrl + K."
        Dialog(page, "Keys", below, None, contents=lambda _: [Html(shortcut_table(commands) + documentation_link())])

    page.on_pick("keys", lambda _: show())
    add_html(page.gui, Markup('<div hidden><span class="wv-keys-sheet" {}></span></div>').format(html.pick("keys")))
    return Command("Keys", None, show, group="Page")


BUTTONS: dict[str, str] = {
    "Horizontal cut": "Horizontal cut",
    "Vertical cut": "Vertical cut",
    "Add line": "Add a profile line",
    "Start scan": "Scan, pause, continue",
    "Pause": "Scan, pause, continue",
    "Continue": "Scan, pause, continue",
    "Stop": "Stop all motion",
    "Stop scan": "Stop all motion",
    "Cover the sample": "Cover the sample",
    "Save plan…": "Save plan…",
    "Open…": "Open a dataset…",
    "Import…": "Import images…",
    "Export…": "Export the surface…",
    "0.5 – 99.5 %": "Colours from 0.5 to 99.5 %",
    "Delete": "Delete the result",
    "Keep result": "Keep the result",
    "Undo": "Undo",
    "Redo": "Redo",
    "Next": "Next under review",
    "Accept": "Accept",
    "Reject": "Reject",
    "Real defect": "Accept",
    "Not a defect": "Reject",
}
"""Labels of buttons, and the commands whose keys do the same."""


def add_titles(page: Page, commands: Sequence[Command]) -> None:
    """Add the keys of commands to the titles of their buttons."""
    titles = json.dumps(titles_of(commands), ensure_ascii=False)
    add_html(page.gui, Markup('<div hidden data-titles="{}"></div>').format(titles))


def titles_of(commands: Sequence[Command]) -> dict[str, str]:
    """Return the title of each button: its key."""
    keys = {command.name: command.spoken_key for command in commands if command.key}
    named = {**BUTTONS, **{step: step for step in TITLES.values()}}
    return {label: f"Key {keys[name]}" for label, name in named.items() if name in keys}


def glossary_html() -> Markup:
    """Return the glossary by subject as HTML."""

    def subject_html(subject: Subject) -> Markup:
        rows = Markup("").join(
            Markup("<dt>{}</dt><dd>{} <small>{}</small></dd>").format(term.word, term.meaning, term.source)
            for term in terms_of(subject)
        )
        return Markup("<section><b>{}</b><dl>{}</dl></section>").format(subject, rows)

    return Markup('<div class="wv-sheet wv-glossary"><div>{}</div></div>').format(
        Markup("").join(map(subject_html, get_args(Subject)))
    )


def glossary_command(page: Page) -> Command:
    """Return the command that shows the glossary."""

    def show() -> None:
        below = "The words of this page, of the command line and of reports."
        Dialog(page, "Glossary", below, None, contents=lambda _: [Html(glossary_html() + documentation_link())])

    return Command("Glossary", None, show, group="Page")


def audit_command(page: Page) -> Command:
    """Return the command that shows the audit log."""
    return Command("Audit log", None, lambda: audit_dialog(page), ICON.LIST_DETAILS, group="Page")


def _rows(group: Group, commands: Sequence[Command]) -> list[tuple[str, str]]:
    named = [(c.name, c.spoken_key) for c in commands if c.group == group and c.key and c.listed]
    return [*named, *FIXED_KEYS.get(group, ())]


def _group(group: Group, rows: list[tuple[str, str]]) -> Markup:
    lines = Markup("").join(Markup("<div>{}<kbd>{}</kbd></div>").format(name, key) for name, key in rows)
    return Markup("<section><b>{}</b>{}</section>").format(group, lines)


Source = Callable[[Snapshot], Sequence[Command]]
Name = tuple[str, Any, Any]
"""Name, key and modifier of a command."""


class Palette:
    """Registration of the fixed commands and of `more`, which depend on the snapshot."""

    def __init__(self, page: Page, commands: Sequence[Command], more: Source) -> None:
        self._page, self._commands, self._more = page, commands, more
        self._registered: dict[Name, Any] = {}
        self._in_order = ThreadPoolExecutor(1, thread_name_prefix="keys of a review")
        page.on_close(lambda: self._in_order.shutdown(wait=False))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the browser's list up to date."""
        everything = (*self._commands, *self._more(snapshot))
        now = {_name(c): c for c in everything if c.here is None or c.here(snapshot, view)}
        for gone in self._registered.keys() - now.keys():
            self._registered.pop(gone).remove()
        for name, command in now.items():
            if name not in self._registered:
                self._registered[name] = self._add(command)

    def _add(self, command: Command) -> Any:
        handle = self._page.gui.add_command(
            command.name,
            description=command.group,
            hotkey=command.key,
            modifier=command.modifier,
            icon=command.icon,
        )
        heard = guarded(self._page, f"{command.name} failed")(lambda _: carry_out(self._page, command))
        if command.group == "Review":
            handle.on_trigger(partial(self._heard_in_order, heard))
        else:
            handle.on_trigger(heard)
        return handle

    async def _heard_in_order(self, heard: Callable[[Any], None], event: Any) -> None:
        """Carry out one after the other: viser's threads would mix up the keys of a fast hand."""
        self._in_order.submit(heard, event)


def carry_out(page: Page, command: Command) -> None:
    """Carry out a command, or notify why it is not possible."""
    why = command.why_not(page.session.snapshot, page.view) if command.why_not is not None else None
    if why is None:
        command.act()
    else:
        page.say(command.name.removesuffix("…"), f"Not now: {typeset(why)}", "attention")


def _name(command: Command) -> Name:
    return command.name, command.key, command.modifier
