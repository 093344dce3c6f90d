"""A step of work: a function of what is known, and the part of the page that it fills."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Generic, TypeVar

from wafer_viewer.gui.elements.elements import Elements
from wafer_viewer.gui.elements.mount import Mount
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets.ask import Ask
from wafer_viewer.session.state.snapshot import Snapshot

C = TypeVar("C")


class Here(Generic[C]):
    """Arguments of a step: the session's snapshot, the view of this browser, and what it holds itself.

    page: commands of the session and changes of the view. ask: what takes its time. own: a frozen dataclass of what
    nobody else needs, such as a name that is typed; a callback finds the newest.
    """

    def __init__(self, page: Page, own: C) -> None:
        self.page = page
        self.ask: Ask = page.answers
        self.own = own
        self.snapshot, self.view = page.session.snapshot, page.view

    def keep(self, **changes: Any) -> None:
        """Change what the step holds, and draw again."""
        self.own = replace(self.own, **changes)  # pyright: ignore[reportArgumentType]
        self.page.redraw()


class StepPanel(Generic[C]):
    """The part of the page that shows a step; `failed`: title of a failure of what has none of its own."""

    def __init__(self, page: Page, step: Callable[[Here[C]], Elements | None], own: C, failed: str) -> None:
        self.here = Here(page, own)
        self._step = step
        self._mount = Mount(page.gui, page, failed)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Show the step as it is now."""
        self.here.snapshot, self.here.view = snapshot, view
        self._mount.show(self._step(self.here))
