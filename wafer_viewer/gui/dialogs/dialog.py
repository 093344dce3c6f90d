"""Modal dialogs: elements that follow from what a dialog holds, with a button that acts and one that cancels."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.gui.elements.elements import Button, Buttons, Elements, Html, Text
from wafer_viewer.gui.elements.form import form
from wafer_viewer.gui.elements.mount import Mount
from wafer_viewer.gui.elements.step import C, Here
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.spec import Spec, settings_of
from wafer_viewer.session.state.snapshot import Fault, Snapshot

WAIT_S = 20.0
"""Longest time to await a session command whose error a dialog shows."""
REASON = "Reason, recorded in the log"


class KeepOpen(Exception):
    """Raised by a dialog's action to keep the dialog open: it showed a folder, or opened another dialog first."""


@dataclass(frozen=True, slots=True)
class Confirm:
    """Confirming button of a dialog.

    act: gets the dialog; the dialog stays open and shows an error that it raises, and closes otherwise. A session
    command that it returns is followed, and its failure reported under the title `failed`.
    commands: False for an action that only reads, exports or asks for control. away: label of the other button.
    """

    label: str
    icon: Any
    act: Callable[[Any], Any]
    failed: str
    commands: bool = True
    away: str = "Cancel"


def fields_of(dialog: Dialog[Any]) -> Elements:
    """Return the inputs for all labelled fields of the spec that a dialog holds; nothing if it holds none."""
    own = dialog.own
    return form(own, dialog.put, *settings_of(type(own))) if isinstance(own, Spec) else ()


class Dialog(Here[C]):
    """Modal dialog, drawn with its page until it closes.

    Parameters
    ----------
    page : Page
        Page that the dialog lies on.
    title, below : str
        Heading and the sentence below it.
    answer : Confirm or None
        Confirming button; without it the dialog informs, and has one button that closes it.
    own : Spec or dataclass
        Initial value of what the dialog holds.
    contents : callable
        Returns the elements for what the dialog holds.
    picks : mapping
        Callbacks of clicks by subject; they get the dialog and the key.
    """

    def __init__(
        self,
        page: Page,
        title: str,
        below: str,
        answer: Confirm | None,
        own: C = None,
        contents: Callable[[Any], Elements] = fields_of,
        picks: dict[str, Callable[[Any, str], Any]] | MappingProxyType[str, Any] = MappingProxyType({}),
    ) -> None:
        super().__init__(page, own)
        self.modal = page.gui.add_modal(title)
        self._below, self._answer, self._contents = below, answer, contents
        self._problem = ""
        self._mount = Mount(page.gui, self, answer.failed if answer else title, self.modal)
        self.say, self.on_entered, self.entered, self.locks = page.say, page.on_entered, page.entered, page.locks
        self._drawing = threading.RLock()
        for name, act in picks.items():
            page.on_pick(name, partial(act, self))
        self.show(page.session.snapshot, page.view)
        if not self.modal.closed:
            page.opened = (*page.opened, self)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Show the dialog as it is now."""
        with self._drawing:
            if self.modal.closed:
                return
            self.snapshot, self.view = snapshot, view
            below = Markup('<div class="wv-sub">{}</div>').format(self._below) if self._below else Markup()
            fault = Markup('<div class="wv-note fault">{}</div>').format(html.typeset(self._problem))
            leave = Button(self._answer.away if self._answer else "Close", self.close)
            if self._answer is None:
                foot = Buttons([leave], 36, answers=True)
            else:
                foot = Buttons([leave, self.button(self._answer)], 38, answers=True)
            contents = self._contents(self)
            if not self.modal.closed:
                self._mount.show([Html(below), *contents, Html(fault if self._problem else ""), foot])

    def button(self, answer: Confirm) -> Button:
        """Return the confirming button as it is now."""
        return Button(answer.label, self._act, answer.icon, "leading", commands=answer.commands, failed=answer.failed)

    def press(self) -> None:
        """Run the action of the confirming button."""
        if self._answer is not None:
            guarded(self, self._answer.failed)(self._act)()

    def close(self) -> None:
        """Close the dialog."""
        with self._drawing:
            if self.modal.closed:
                return
            self.modal.close()
        self.page.opened = tuple(dialog for dialog in self.page.opened if dialog is not self)

    @property
    def as_of_s(self) -> float:
        """Time of the drawn state, by the monotonic clock."""
        return self.page.as_of_s

    def tell(self, fault: Fault) -> None:
        """Show an error in the dialog, or on the page once it is closed."""
        if self.modal.closed:
            self.page.tell(fault)
        else:
            self._problem = fault.text
            self.redraw()

    def settle(self, title: str) -> None:
        """Take the error away, because what failed is tried again."""
        self._problem = ""

    def _act(self) -> Any:
        self.entered()
        outcome, self._problem = None, ""
        try:
            outcome = self._answer.act(self) if self._answer is not None else None
        except KeepOpen:
            self.redraw()
        except WaferViewerError as fault:
            self._problem = str(fault)
            self.redraw()
        else:
            self.close()
        return outcome


def ask(page: Page, title: str, below: str, answer: Confirm) -> None:
    """Ask before something is done."""
    Dialog(page, title, below, answer, None)


def ask_text(page: Page, title: str, below: str, field: tuple[str, str, str], answer: Confirm) -> None:
    """Ask for a line of text, which the dialog holds. field: label, first value and tooltip."""
    label, value, hint = field
    Dialog(page, title, below, answer, value, lambda here: [Text(label, here.own, here.hold, hint)])


def ask_name(page: Page, title: str, below: str, old: str, rename: Callable[[str], Any]) -> None:
    """Ask for another name of something."""
    answer = Confirm("Rename", viser.Icon.PENCIL, lambda here: rename(here.own), "The name was not changed")
    ask_text(page, title, below, ("Name", old, "Name in lists, exports and reports"), answer)


@dataclass(frozen=True, slots=True)
class Signature:
    """Signer and reason as they are typed."""

    name: str
    reason: str = ""


def sign_dialog(
    page: Page,
    title: str,
    below: str,
    content: Markup,
    verb: tuple[str, Any],
    act: Callable[[str, str], Future[Any]],
    failed: str,
    *,
    signer: tuple[str, str],
    name: str = "",
    asks_why: bool = True,
) -> None:
    """Open a dialog that asks who signs, and why; `act` gets both.

    verb: label and icon of the button. signer: label and tooltip of the name.
    """

    def contents(here: Dialog[Signature]) -> Elements:
        name_input = Text(signer[0], here.own.name, partial(here.put, "name"), signer[1])
        reason = Text("Reason", here.own.reason, partial(here.put, "reason"), REASON)
        return [Html(content), name_input, reason if asks_why else None]

    def sign(here: Dialog[Signature]) -> None:
        if not here.own.name.strip():
            raise WaferViewerError("The signature is missing: type your name.")
        act(here.own.name.strip(), here.own.reason.strip()).result(WAIT_S)

    Dialog(page, title, below, Confirm(*verb, sign, failed), Signature(page.browser.name or name), contents)


def confirm_overwrite(page: Page, path: Path, write: Callable[[], Any]) -> None:
    """Write a file; ask for confirmation before an existing file is replaced."""
    if not path.exists():
        write()
        return
    below = f"It is in {path.parent} already; its contents will be lost; this cannot be undone."
    title = f"Replace {path.name}"
    ask(page, f"{title}?", below, Confirm(title, viser.Icon.REPLACE, lambda _: write(), "Nothing was replaced", False))
