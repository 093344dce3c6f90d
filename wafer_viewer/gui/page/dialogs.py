"""Modal dialogs, their confirmations, and the tooltips of inputs and buttons.

One table by label, for inputs that are no fields of a spec. viser shows hints of inputs only: a script sets the titles
of buttons.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.controls import (
    Command,
    Gui,
    HtmlBlock,
    add_html,
    button,
    command_button,
    in_a_row,
    set_prop,
)
from wafer_viewer.model.acquisition.plan import FocusSweep
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.spec import settings_of
from wafer_viewer.model.surface_format import Reading
from wafer_viewer.session.state.snapshot import DatasetEntry

# ------------------------------------------------------------------------------------------------------------- tooltips


FIELDS: dict[str, str] = {
    "Name": "Name in lists, exports and reports",
    "Password": "Of a person who is listed, not that of the page",
    "Product": "Product on the wafer",
    "Exposure, µs": "Of the live picture and of the search for the focus",
    # Gauge check
    "Blocks": "Serial numbers of the blocks, / between them",
    "U (k = 2), µm": "Expanded uncertainty of the certified step",
    "Laboratory": "Who certifies it",
    "Number": "Of the certificate",
    "Issued": "The day, as 2026-03-14",
    "Valid until": "The last day, as 2027-03-14",
    "Signed by": "Who signs the check; recorded in the log and in reports",
    "Done by": "Who changes the z scale; recorded in the log",
    "Reason": "Reason, recorded in the log",
    "Tolerance": "Upper limit less lower, in the unit of the values; empty: that of the job, if any",
    "Method": "How the study is evaluated, both by AIAG",
    # Dialogs
    "Path": "On the machine that runs the viewer; Tab completes it",
    "File name": "A folder before it leads there",
    "z step, µm": f"Between two images of the stack, µm; {settings_of(FocusSweep)['z_step_um'].limit}",
    "Pixel, µm": "Size of a pixel on the sample, µm; over 0",
    "Pattern": "How files are named, r{row}_c{col}_k{k}.tif; empty for one stack",
    "Only": "Files to take, by a pattern of their names such as img_*.png; empty: all",
    "Lines": "Meaning of the lines of a text file: points by x, y, z, or the rows of a matrix of heights",
    "Numbered": "In which order the running numbers of the fields go through the grid",
    "Begins": "The corner of the grid where the first field lies",
    "Format": "The ending of the file follows",
    "One pixel in": "Density: every n-th row and column is written; 1 for all",
    "z unit": "Unit of the heights of a surface file, such as um; of points the unit of x and y, too",
    "Depths": "The file holds depths, positive downward: they are inverted",
    "Your name": "Shown to the other browsers",
}
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
STEP_TITLES = "Plan", "Acquire", "Surface", "Measure", "Gauge check", "Review", "Report"


def add_hints(gui: Gui) -> None:
    """Set the hint of each existing input that has none."""
    for handle in dict(gui._gui_input_handle_from_uuid).values():
        given: Any = getattr(handle, "hint", "")
        text = FIELDS.get(getattr(handle, "label", "") or "")
        if given is None and text is not None:
            set_prop(handle, "hint", text)


def add_titles(page: Page, commands: Sequence[Command]) -> None:
    """Add the keys of commands to the titles of their buttons."""
    titles = json.dumps(titles_of(commands), ensure_ascii=False)
    add_html(page.gui, Markup('<div hidden data-titles="{}"></div>').format(titles))


def titles_of(commands: Sequence[Command]) -> dict[str, str]:
    """Return the title of each button: its key."""
    keys = {command.name: command.spoken_key for command in commands if command.key}
    named = {**BUTTONS, **{step: step for step in STEP_TITLES}}
    return {label: f"Key {keys[name]}" for label, name in named.items() if name in keys}


# -------------------------------------------------------------------------------------------------------------- dialogs


HOLD_S = 30.0
"""Longest time to sign the record of a large dataset, s."""


class KeepOpen(Exception):
    """Raised by a dialog's action to keep the dialog open: it showed a folder, or opened another dialog first."""


class Dialog:
    """Modal dialog with one button that acts and one that cancels."""

    def __init__(self, page: Page, title: str, below: str, on_close: Callable[[], None] = lambda: None) -> None:
        self.page = page
        self.modal = page.gui.add_modal(title)
        self._on_close = on_close
        self.press: Callable[[], None] = lambda: None
        """Run the action of the confirming button."""
        if below:
            with self.modal:
                HtmlBlock(page.gui, Markup('<div class="wv-sub">{}</div>').format(below))

    def answers(
        self,
        name: str,
        icon: Any,
        act: Callable[[], None],
        failed: str,
        away: str = "Cancel",
        *,
        needs_control: bool = True,
    ) -> Any:
        """Add the two buttons at the foot and return the one that acts.

        If `act` raises, the dialog stays open and shows the error. needs_control: False for an action that only reads,
        exports or asks for control.
        """
        with self.modal:
            problem = HtmlBlock(self.page.gui)
            leave = button(self.page.gui, away, None, lambda _: self.close())
            self.press = guarded(self.page, failed)(lambda: self._do(act, problem))
            add = command_button if needs_control else button
            do = add(self.page.gui, name, icon, lambda _: self.press())
            in_a_row(self.page.gui, [leave, do], 38, filled=do)
            HtmlBlock(self.page.gui, _on_key("wv-away", leave) + _on_key("wv-do", do), padded=False)
        add_hints(self.page.gui)
        return do

    def close_button(self, name: str) -> None:
        """Add the single close button of an information dialog."""
        with self.modal:
            away = button(self.page.gui, name, None, lambda _: self.close())
            in_a_row(self.page.gui, [away], 36)
            HtmlBlock(self.page.gui, _on_key("wv-away", away), padded=False)

    def close(self) -> None:
        """Close the dialog."""
        if not self.modal.closed:
            self.modal.close()
            self._on_close()

    def _do(self, act: Callable[[], None], problem: HtmlBlock) -> None:
        self.page.entered()
        try:
            act()
        except KeepOpen:
            problem.show("")
            return
        except WaferViewerError as fault:
            problem.show(Markup('<div class="wv-note fault">{}</div>').format(html.with_micro_sign(str(fault))))
            return
        self.close()


SIGNED_S = 20.0
"""Longest time to record a signature, which is awaited so that the dialog can show its error."""


def sign_dialog(
    dialog: Dialog,
    content: Markup,
    verb: tuple[str, Any],
    act: Callable[[str, str], Future[Any]],
    failed: str,
    *,
    label: str = "Signed by",
    name: str = "",
    asks_why: bool = True,
) -> None:
    """Complete a dialog that asks who signs, and why; `act` gets both. verb: label and icon of the button."""
    gui = dialog.page.gui
    with dialog.modal:
        HtmlBlock(gui, content)
        signature = gui.add_text(label, dialog.page.browser.name or name)
        reason = gui.add_text("Reason", "") if asks_why else None

    def sign() -> None:
        if not signature.value.strip():
            raise WaferViewerError("The signature is missing: type your name.")
        act(signature.value.strip(), reason.value.strip() if reason is not None else "").result(SIGNED_S)

    dialog.answers(*verb, sign, failed)


def _on_key(marker: str, handle: Any) -> Markup:
    """Return a hidden marker that tells the key script which button Escape or Enter presses."""
    return Markup('<span hidden class="{}" data-button="{}"></span>').format(marker, handle._impl.uuid)


def open_dataset(page: Page, path: Path) -> None:
    """Open a dataset and show its surface; show Acquire if its scan is unfinished."""

    def look(_: Any) -> None:
        data = page.session.snapshot.dataset
        unfinished = data is not None and not data.finished
        page.change(step="acquire" if unfinished else "surface", show=0, range_um=None, selected=None, frame_k=None)

    page.ask("The dataset was not opened", page.session.open_dataset(path), look)


def open_surface(page: Page, path: Path, says: Reading, name: str | None) -> None:
    """Import a surface file as a dataset and show it. says: settings that the file lacks."""
    done = page.session.exchange.import_surface(path, says, name)
    look = dict[str, Any](step="surface", show=0, range_um=None, selected=None, frame_k=None)
    page.ask("The surface was not opened", done, lambda _: page.change(**look))


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


def format_time(taken: str, now: datetime) -> str:
    """Format an ISO 8601 time: today 08:41, yesterday 17:02, 12 Nov, 3 Feb 2025; return other text unchanged."""
    try:
        moment = datetime.fromisoformat(taken).astimezone(now.tzinfo)
    except ValueError:
        return taken
    if moment.date() == now.date():
        return f"today {moment:%H:%M}"
    if moment.date() == (now - timedelta(days=1)).date():
        return f"yesterday {moment:%H:%M}"
    return f"{moment.day} {moment:%b}" + (f" {moment.year}" if moment.year != now.year else "")


def hold_dialog(page: Page, *, end: bool) -> None:
    """Ask for the reason of a hold of the open dataset, or of its end."""
    title = "End the hold" if end else "Hold the frames"
    below = (
        "The frames may be removed again once they are old enough."
        if end
        else "They are not removed, however old they are, until somebody ends the hold."
    )
    failed = "The hold was not ended" if end else "The frames are not held"
    dialog = Dialog(page, title, below)
    with dialog.modal:
        why = page.gui.add_text("Reason", "")

    def change() -> None:
        verb = page.session.end_hold if end else page.session.hold_frames
        verb(why.value).result(HOLD_S)

    dialog.answers(title, viser.Icon.LOCK_OPEN if end else viser.Icon.LOCK, change, failed)


def confirm_overwrite(page: Page, path: Path, write: Callable[[], None]) -> None:
    """Write a file; ask for confirmation before an existing file is replaced."""
    if not path.exists():
        write()
        return
    below = f"It is in {path.parent} already; its contents will be lost; this cannot be undone."
    dialog = Dialog(page, f"Replace {path.name}?", below)
    dialog.answers(f"Replace {path.name}", viser.Icon.REPLACE, write, "Nothing was replaced", needs_control=False)


def reconstruct_dialog(page: Page, again: Callable[[], None]) -> None:
    """Reconstruct the surface; ask for confirmation before an existing one is replaced."""
    snapshot = page.session.snapshot
    if snapshot.surface is None or snapshot.dataset is None:
        again()
        return
    name = snapshot.dataset.path.stem
    below = (
        "Its heights are reconstructed with the chosen recipe. Frames and results are kept; the present heights are "
        "replaced."
    )
    dialog = Dialog(page, f"Replace the surface of {name}?", below)
    dialog.answers(f"Replace the surface of {name}", viser.Icon.REFRESH, again, "The surface was not changed")


def rename_dialog(page: Page, number: int, old: str) -> None:
    """Open the dialog that renames a result."""
    dialog = Dialog(page, "Rename the result", "The name appears in the list, in exports and in reports.")
    with dialog.modal:
        name = page.gui.add_text("Name", old)
    dialog.answers(
        "Rename",
        viser.Icon.PENCIL,
        lambda: page.ask("The name was not changed", page.session.rename(number, name.value.strip())),
        "The name was not changed",
    )
