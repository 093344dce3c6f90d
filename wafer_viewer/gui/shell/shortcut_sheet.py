"""Sheet of all keys, generated from the command table, and the keyboard script of the page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from typing import get_args

from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.command import Command, Group
from wafer_viewer.gui.widgets.controls import HtmlBlock
from wafer_viewer.gui.widgets.number_field import EMPTY
from wafer_viewer.gui.widgets.static_files import read_static
from wafer_viewer.model.glossary import Subject, terms_of

SCRIPTS = "accessible_names.js", "file_dialog.js", "keyboard.js"
"""Scripts in this order: the file dialog handles its keys before the keyboard script."""
FILE_PICKS = "file-mark", "file-open", "file-parent"
BESIDE_THE_TABLE: dict[Group, tuple[tuple[str, str], ...]] = {
    "Page": (
        ("Every command by name", "Ctrl + K"),
        ("This list", "F1 or ?"),
        ("Next, previous field or button", "Tab"),
        ("Leave a text field", "Enter or Esc"),
    ),
    "Look": (("Saved view 1 … 9", "Shift + 1 … 9"), ("Move the camera", "W A S D Q E"), ("Turn it", "arrows")),
}
"""Keys without a command in the table, and keys that stand for several commands."""


def sheet_html(commands: Sequence[Command]) -> str:
    """Return all keys by group as HTML."""
    groups = [(group, _rows(group, commands)) for group in get_args(Group)]
    drawn = "".join(_group(group, rows) for group, rows in groups if rows)
    return f'<div class="wv-sheet" role="region" aria-label="Keys" tabindex="0"><div>{drawn}</div></div>'


def add_keys_sheet(page: Page, commands: Sequence[Command]) -> Command:
    """Add the keyboard script to the page and return the command that shows the sheet."""

    def show() -> None:
        dialog = Dialog(page, "Keys", "Every command is also in the command palette: Ctrl + K.")
        with dialog.modal:
            HtmlBlock(page.gui, sheet_html(commands))
        dialog.way_out("Close")

    page.on_pick("keys", lambda _: show())
    page.gui.add_html(f'<img src="data:," alt="" hidden onerror="{html.safe(_script())}">')
    page.gui.add_html(f'<div hidden><span class="wv-keys-sheet" {html.pick("keys")}></span></div>')
    return Command("Keys", None, show, group="Page")


def glossary_html() -> str:
    """Return the glossary by subject as HTML."""

    def subject_html(subject: Subject) -> str:
        rows = "".join(
            f"<dt>{html.safe(term.word)}</dt><dd>{html.safe(term.meaning)} <small>{html.safe(term.source)}</small></dd>"
            for term in terms_of(subject)
        )
        return f"<section><b>{html.safe(subject)}</b><dl>{rows}</dl></section>"

    return f'<div class="wv-sheet wv-glossary"><div>{"".join(map(subject_html, get_args(Subject)))}</div></div>'


def glossary_command(page: Page) -> Command:
    """Return the command that shows the glossary."""

    def show() -> None:
        dialog = Dialog(page, "Glossary", "The words of this page, of the command line and of reports.")
        with dialog.modal:
            HtmlBlock(page.gui, glossary_html())
        dialog.way_out("Close")

    return Command("Glossary", None, show, group="Page")


def _rows(group: Group, commands: Sequence[Command]) -> list[tuple[str, str]]:
    named = [(c.name, c.spoken_key) for c in commands if c.group == group and c.key and c.listed]
    return [*named, *BESIDE_THE_TABLE.get(group, ())]


def _group(group: Group, rows: list[tuple[str, str]]) -> str:
    lines = "".join(f"<div>{html.safe(name)}<kbd>{html.safe(key)}</kbd></div>" for name, key in rows)
    return f"<section><b>{html.safe(group)}</b>{lines}</section>"


@cache
def _script() -> str:
    optional = f"window.wvOptional={json.dumps(EMPTY, ensure_ascii=False)};"
    picks = ",".join(f"'{what}':function(event){{{html.pick_script(what)}}}" for what in FILE_PICKS)
    return "\n".join((optional, f"window.wvReport={{{picks}}};", read_static(*SCRIPTS)))
