"""A step of work: a function of what is known, and the part of the page that it fills."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, Generic, TypeVar

from markupsafe import Markup

from wafer_viewer.gui.elements.elements import Elements, Html
from wafer_viewer.gui.elements.mount import Mount
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import FIRST_WIDTH_PX, HEIGHTS_PX
from wafer_viewer.gui.state.view_state import Below, View
from wafer_viewer.gui.widgets.ask import Ask
from wafer_viewer.gui.widgets.controls import add_html, set_props
from wafer_viewer.gui.widgets.style import PROFILE_PX
from wafer_viewer.model.spec import replace, with_field
from wafer_viewer.session.state.snapshot import Snapshot

C = TypeVar("C")


class Here(Generic[C]):
    """Arguments of a step: the session's snapshot, the view of this browser, and what it holds itself.

    page: commands of the session and changes of the view. ask: what takes its time. own: a frozen dataclass of what
    nobody else needs, such as a name that is typed; a callback finds the newest.
    """

    def __init__(self, page: Page, own: C) -> None:
        self.page = page
        self.redraw = page.redraw
        self.ask: Ask = page.answers
        self.own = own
        self.snapshot, self.view = page.session.snapshot, page.view

    def keep(self, **changes: Any) -> None:
        """Change what the step holds, and draw again."""
        self.hold(replace(self.own, **changes))

    def hold(self, own: C) -> None:
        """Replace what the step holds, and draw again."""
        self.own = own
        self.redraw()

    def put(self, path: str, value: Any) -> None:
        """Change a field of what the step holds by its path, and draw again."""
        self.hold(with_field(self.own, path, value))


Picks = Mapping[str, Callable[[Here[C], str], Any]]
"""Callbacks of clicks on elements of `html.pick`, by subject; they get the key."""


class StepPanel(Generic[C]):
    """The part of the page that shows a step.

    failed: title of a failure of what has none of its own. picks: what a click on an element of `html.pick` does, by
    its name; it gets the key.
    """

    def __init__(
        self,
        page: Page,
        step: Callable[[Here[C]], Elements | None],
        own: C,
        failed: str,
        picks: Picks[C] = MappingProxyType({}),
    ) -> None:
        self.here = Here(page, own)
        self._step = step
        self._mount = Mount(page.gui, page, failed)
        for name, act in picks.items():
            page.on_pick(name, partial(act, self.here))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Show the step as it is now."""
        self.here.snapshot, self.here.view = snapshot, view
        self._mount.show(self._step(self.here))


class StepDock(StepPanel[C]):
    """The part of the panel below the scene that shows a step while the view shows its curve."""

    def __init__(
        self,
        page: Page,
        curve: Below,
        step: Callable[[Here[C]], Elements | None],
        own: C,
        failed: str,
        picks: Picks[C] = MappingProxyType({}),
    ) -> None:
        self._curve, self._width_px = curve, FIRST_WIDTH_PX
        self._panel = page.gui.add_panel(visible=False)
        self._drawing = threading.Lock()
        with self._panel.add_tab(curve.capitalize()):
            add_html(page.gui, Markup('<div class="wv-bottom"></div>'))
            super().__init__(page, step, own, failed, picks)
        self._panel.float(x=0, y=-1, width=FIRST_WIDTH_PX, height=HEIGHTS_PX.get(curve, PROFILE_PX))
        page.viewport.on_change(self._follow)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Show the step as it is now, if its curve is shown; on any thread."""
        with self._drawing:
            set_props(self._panel, visible=view.below == self._curve)
            if view.below == self._curve:
                super().show(snapshot, view)

    def _follow(self) -> None:
        """Match the width of the scene, which depends on the side panels."""
        width_px = self.here.page.viewport.width_px
        if width_px not in (0, self._width_px):
            self._width_px = width_px
            self._panel.set_width(width_px)


@dataclass(frozen=True, slots=True)
class Overlay:
    """Elements over the scene, in CSS pixels; negative x, y count from the right and the bottom edge of the scene.

    height_px: None for that of the elements.
    """

    elements: Elements
    x_px: int
    y_px: int
    width_px: int
    height_px: int | None

    @classmethod
    def of(
        cls,
        content: Markup,
        x_px: int,
        y_px: int,
        width_px: int,
        height_px: int,
        look: str = "",
        *,
        at_right: bool = False,
    ) -> Overlay | None:
        """Return HTML over the scene, at the right of its place if told so; None for empty content."""
        right = "display:flex;justify-content:flex-end" if at_right else ""
        framed = Markup('<div class="wv-ov {}" style="{}">{}</div>').format(look, right, content)
        return cls([Html(framed, padded=False)], x_px, y_px, width_px, height_px) if content else None


CLIPPED_PX = 18
"""Extra height of a floating panel, without which viser clips its content at the bottom."""


class StepOverlay(Generic[C]):
    """Part of the page that floats over the scene."""

    def __init__(
        self,
        page: Page,
        overlay: Callable[[Here[C]], Overlay | None],
        own: C = None,
        picks: Picks[C] = MappingProxyType({}),
        failed: str = "",
    ) -> None:
        self.here = Here(page, own)
        self._overlay = overlay
        self._panel = page.gui.add_panel(visible=False)
        self._mount = Mount(page.gui, page, failed, self._panel.add_tab("·"))
        self._place: object = None
        for name, act in picks.items():
            page.on_pick(name, partial(act, self.here))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Show the overlay as it is now."""
        self.here.snapshot, self.here.view = snapshot, view
        shown = self._overlay(self.here)
        if shown is not None:
            place = x, y, width, height = shown.x_px, shown.y_px, shown.width_px, shown.height_px
            if place != self._place:
                self._place = place
                self._panel.float(x=x, y=y, width=width, height=height and height + CLIPPED_PX)
        self._mount.show(shown.elements if shown is not None else ())
        set_props(self._panel, visible=shown is not None)
