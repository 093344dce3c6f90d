"""Facts reported by the browser, such as system and panel widths, through a hidden text field.

viser never reports a layout: a script observes the widths, and they are restored after a reload.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import msgspec
from markupsafe import Markup

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import PanelLayout, View
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.controls import add_html
from wafer_viewer.gui.widgets.style import LEFT_PX, RIGHT_PX
from wafer_viewer.model.errors import WaferViewerError, detail, parser_errors_as
from wafer_viewer.session.state.snapshot import Snapshot

EDGE_PX = 4
"""Difference in width between a dock region and the panel in it."""
LEAST_PX, MOST_PX = 200, 720
"""Valid panel widths; others belong to a panel that is folded or being folded."""
LEAST_SCENE_PX = 440
PHONE_PX = 700
"""Width of the window below which the page shows the scan alone, to be watched."""
_SYSTEMS = {"Linux": "Linux", "Win": "Windows", "Mac": "macOS", "Android": "Android", "iPhone": "iOS", "iPad": "iPadOS"}
_SOFTWARE = ("swiftshader", "llvmpipe", "softpipe", "software", "basic render")
"""Substrings of renderer names that mean software rendering."""


class BrowserInfo(msgspec.Struct, frozen=True):
    """Report of a browser: for each side panel its width in CSS pixels, and whether it is folded.

    renderer: WebGL renderer, empty if the browser does not report it; still: the user prefers reduced motion; dark: the
    user prefers dark colours.
    window: width of the page in CSS pixels, 0 until it is reported; scene: size of the scene, likewise.
    at_ms: when the browser wrote the report, since the page was loaded.
    """

    system: str = ""
    left: tuple[int, bool] | None = None
    right: tuple[int, bool] | None = None
    renderer: str = ""
    still: bool = False
    dark: bool = False
    window: int = 0
    scene: tuple[int, int] = (0, 0)
    at_ms: float = 0.0


def read_info(text: str) -> BrowserInfo:
    """Return a report from its text. Raises WaferViewerError for any other text."""
    with parser_errors_as(lambda fault: WaferViewerError(f"The browser sent no report of itself{detail(fault)}.")):
        return msgspec.json.decode(text, type=BrowserInfo)


class BrowserEvents:
    """Handler of the reports of a page's browser: stores the layout, and names the browser after its system.

    `left` is the left side panel; it and the main panel get their stored widths when the page is first drawn.

    viser runs callbacks on several threads: a report that is overtaken by a later one is dropped. Were it not, the
    panel would follow a size that the window no longer has, and no further report would correct it.
    """

    def __init__(self, page: Page) -> None:
        self._page = page
        self._system: str | None = None
        self._restored = False
        self._cramped = False
        self._unfolding = False
        """The left panel was told to unfold, and the browser has not reported it so yet."""
        self._one_at_a_time = threading.Lock()
        self._latest_ms = -math.inf
        self.left: Any = None
        self._can_fly = False
        self._let_fly: Callable[[bool], None] = lambda able: None
        add_html(page.gui, Markup('<div class="wv-tells"></div>'))
        failed = "The layout was not saved"
        page.gui.add_text("tells", "").on_update(guarded(page, failed)(lambda event: self._hear(event.target.value)))

    def on_motion(self, callback: Callable[[bool], None]) -> None:
        """Call `callback` with whether camera animation is enabled, now and after each report."""
        self._let_fly = callback
        callback(self._can_fly)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Restore the panel layout of this browser, once, and name the browser after its system."""
        if not self._restored:
            self._restored = True
            restore(self._page.browser.layout, self.left, self._page.gui.main_panel)
        name = snapshot.control.name_of(self._page.browser.key)
        if self._system is not None and name and "·" not in name and not self._page.browser.name:
            self._page.session.control.rename(self._page.browser.key, f"{name} · {self._system}")
            self._system = None

    def _hear(self, text: str) -> None:
        info = read_info(text)
        with self._one_at_a_time:
            if info.at_ms < self._latest_ms:
                return
            self._latest_ms = info.at_ms
            self._take(info)
        self._page.redraw()

    def _take(self, info: BrowserInfo) -> None:
        page = self._page
        self._system = system_name(info.system)
        self._can_fly = may_fly(info)
        self._let_fly(self._can_fly)
        page.viewport.set_size(*info.scene)
        page.draws_slowly = draws_slowly(info)
        page.watches_scan = 0 < info.window < PHONE_PX
        if info.dark != page.view.dark and not page.view.theme_chosen:
            page.change(dark=info.dark)
        layout = layout_of(info, page.browser.layout)
        if info.left is not None and not info.left[1]:
            self._unfolding = False
        if self._cramped or self._unfolding:  # folded for want of room, not by a person
            layout = replace(layout, left_folded=page.browser.layout.left_folded)
        if self._restored and layout != page.browser.layout:
            page.remember(replace(page.browser, layout=layout))
        if self._restored:
            self._make_room(info, layout)

    def _make_room(self, info: BrowserInfo, layout: PanelLayout) -> None:
        """Fold the left panel if the scene gets too narrow, and unfold it when there is room again."""
        if (cramped := is_cramped(info, layout)) == self._cramped:
            return
        self._cramped = cramped
        if cramped:
            self.left.minimize()
        elif not layout.left_folded:
            self.left.expand()
            self._unfolding = True


def restore(layout: PanelLayout, left: Any, right: Any) -> None:
    """Restore the panel layout of a browser; `left` and `right` are viser's panels."""
    left.set_width(layout.left_px or LEFT_PX)
    right.set_width(layout.right_px or RIGHT_PX)
    if layout.left_folded:
        left.minimize()
    if layout.right_folded:
        right.minimize()


def layout_of(info: BrowserInfo, before: PanelLayout) -> PanelLayout:
    """Return the layout after a report; a folded panel keeps its width."""
    left_px, left_folded = _side(info.left, before.left_px, before.left_folded)
    right_px, right_folded = _side(info.right, before.right_px, before.right_folded)
    return PanelLayout(left_px, right_px, left_folded, right_folded)


def is_cramped(info: BrowserInfo, layout: PanelLayout) -> bool:
    """Return whether the window leaves too little width for the scene between both panels."""
    panels = (layout.left_px or LEFT_PX) + (layout.right_px or RIGHT_PX)
    return 0 < info.window < panels + LEAST_SCENE_PX


def may_fly(info: BrowserInfo) -> bool:
    """Return whether the camera may be animated: hardware rendering, and no preference for reduced motion."""
    return not info.still and not draws_slowly(info)


def draws_slowly(info: BrowserInfo) -> bool:
    """Return whether the browser draws without a graphics card."""
    renderer = info.renderer.lower()
    return any(name in renderer for name in _SOFTWARE)


def system_name(platform: str) -> str:
    """Return the common name of the system for a browser's `navigator.platform`."""
    return next((name for sign, name in _SYSTEMS.items() if platform.startswith(sign)), platform or "unknown")


def _side(panel: tuple[int, bool] | None, before_px: int | None, before_folded: bool) -> tuple[int | None, bool]:
    if panel is None:
        return before_px, before_folded
    width_px, folded = panel
    return (width_px - EDGE_PX if not folded and LEAST_PX <= width_px <= MOST_PX else before_px), folded
