"""Wrappers of viser widgets: layout in rows, sending of changes only, and callbacks guarded against errors."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Literal, Protocol, TypeVar, get_type_hints

import viser
from markupsafe import Markup, escape
from viser import _assignable_props_api as api

from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import Debouncer, ErrorSink, guarded
from wafer_viewer.gui.widgets.style import by_id
from wafer_viewer.model.roles import Action, role_for
from wafer_viewer.session.state.snapshot import Snapshot

# -------------------------------------------------------------------------------------------------------------- command


Group = Literal["Go to", "Look", "Plan", "Acquire", "Surface", "Measure", "Gauge check", "Review", "Report", "Page"]
Obstacle = Callable[[Snapshot, View], str | None]
"""Returns the reason why a command is unavailable, phrased to follow "Not now:"; None if available (see
page/preconditions.py)."""
_SPOKEN = {
    "escape": "Esc",
    "pageup": "Page Up",
    "pagedown": "Page Down",
    "home": "Home",
    "enter": "Enter",
    "backspace": "Backspace",
}
_MODIFIERS = {"cmd/ctrl": "Ctrl", "shift": "Shift", "alt": "Alt"}


@dataclass(frozen=True, slots=True)
class Command:
    """A command with its key, its title in the palette and its group.

    listed: True if the list of keys contains it.
    why_not: returns the reason for its unavailability, shown when it is chosen nevertheless.
    here: returns whether the command exists in the current state; otherwise palette and keys ignore it.
    """

    name: str
    key: Any
    act: Callable[[], Any]
    icon: Any = None
    modifier: Any = None
    group: Group = "Page"
    listed: bool = True
    why_not: Obstacle | None = None
    here: Callable[[Snapshot, View], bool] | None = None

    @property
    def spoken_key(self) -> str:
        """Key with its modifiers, ``Ctrl + Shift + Z``; empty without a key."""
        return spoken(self.key, self.modifier) if self.key else ""


def spoken(key: str, modifier: str | None = None) -> str:
    """Return a key with its modifiers as display text."""
    held = [_MODIFIERS[part] for part in modifier.split("+")] if modifier else []
    return " + ".join([*held, _SPOKEN.get(key, key.upper())])


def with_precondition(why_not: Obstacle, *commands: Command) -> list[Command]:
    """Return the commands with a common precondition; existing ones take precedence."""
    return [replace(command, why_not=command.why_not or why_not) for command in commands]


def looking(look: Callable[[str], None]) -> list[Command]:
    """Return the commands for the camera presets."""
    ways = (
        ("Top", "T", "top"),
        ("Front", "F", "front"),
        ("Three-quarter view", "I", "iso"),
        ("Show all", "home", "all"),
    )
    return [Command(name, key, lambda w=mode: look(w), viser.Icon.EYE, group="Look") for name, key, mode in ways]


# ------------------------------------------------------------------------------------------------------------- controls


T = TypeVar("T")
Gui = viser.GuiApi
QUIET_S = 0.7
"""Time after user input during which a slightly older value of the session does not overwrite the widget."""

TIGHT_ROW = 3
"""Number of buttons in a row from which their labels get compact spacing."""


def add_html(gui: Gui, content: Markup | Literal[""], order: float | None = None) -> viser.GuiHtmlHandle:
    """Add an element of HTML to the page; text that is not Markup is escaped."""
    return gui.add_html(_sent(content), order=order)


def _sent(content: Markup | Literal[""]) -> str:
    return str(escape(content))


class HtmlBlock:
    """A block of HTML on the page. Text that is not Markup is shown as text."""

    def __init__(
        self, gui: Gui, content: Markup | Literal[""] = "", padded: bool = True, order: float | None = None
    ) -> None:
        self._padded = padded
        self._content = content
        self._handle = add_html(gui, self._framed(content), order)

    def show(self, content: Markup | Literal[""]) -> None:
        """Set the content if it has changed."""
        if content != self._content:
            self._content = content
            self._handle.content = _sent(self._framed(content))

    def _framed(self, content: Markup | Literal[""]) -> Markup | Literal[""]:
        return Markup('<div class="wv">{}</div>').format(content) if self._padded and content else content


class Drawn(ErrorSink, Protocol):
    """A page that is being drawn."""

    @property
    def as_of_s(self) -> float:
        """Time of the drawn state, by the monotonic clock."""
        ...

    def on_entered(self, edits: Debouncer) -> None:
        """Register what waits for a pause in typing; it is forgotten with its input."""
        ...

    def entered(self) -> None:
        """Take what is typed."""
        ...

    def settle(self, title: str) -> None:
        """Remove the notes of this page with a title."""
        ...


class BoundInput(Generic[T]):
    """A form widget: `show` sets the session's value, `on_change` receives user input.

    Values older than the last user input are not shown, however long their drawing took.
    """

    def __init__(self, handle: Any, on_change: Callable[[Any], None], page: Drawn, failed: str) -> None:
        self.handle = handle
        self.edited = False
        """True if there was user input that `show` has not replaced since."""
        self._page = page
        self._touched_at = -QUIET_S
        self._last: T = handle.value
        """Last value shown or received; viser updates its handle before it calls back."""
        self._on_change = guarded(page, failed)(on_change)
        handle.on_update(self._update)

    @property
    def value(self) -> T:
        """Value of the widget."""
        return self.handle.value

    def show(self, value: T) -> None:
        """Show a value, unless the user is moving the widget or has changed it since the value was read."""
        if time.monotonic() - self._touched_at <= QUIET_S or self._page.as_of_s <= self._touched_at:
            return
        if not _equal(self._last, self.handle.value):  # put in, and not heard of yet
            return
        self.edited = False
        if not _equal(value, self.handle.value):
            self._last = self.handle.value = value

    def enable(self, enabled: bool) -> None:
        """Enable or disable user input."""
        set_prop(self.handle, "disabled", not enabled)

    def _update(self, event: Any) -> None:
        self._last = self.handle.value
        if event.client is not None:
            self._touched_at, self.edited = time.monotonic(), True
            self._on_change(event)
            self._touched_at = time.monotonic()  # what was read meanwhile may be of before or after


def set_prop(handle: Any, name: str, value: Any) -> None:
    """Set a property of a viser handle if it has changed."""
    if name == "disabled" and handle._impl.uuid in _barred:
        _barred[handle._impl.uuid] = value
    elif getattr(handle, name) != value:
        setattr(handle, name, value)


_barred: dict[str, bool] = {}
"""Locked widgets, with the disabled state that their part of the page requests."""


def bar(handle: Any) -> None:
    """Disable a widget until `unbar`, whatever its part of the page requests."""
    if handle._impl.uuid not in _barred:
        own = handle.disabled
        set_prop(handle, "disabled", True)
        _barred[handle._impl.uuid] = own


def unbar(handle: Any) -> None:
    """Restore the disabled state that the widget's part of the page requests."""
    if handle._impl.uuid in _barred:
        own = _barred.pop(handle._impl.uuid)
        if not handle._impl.removed:
            set_prop(handle, "disabled", own)


def controlled(handle: Any, action: Action | None = None) -> Any:
    """Declare that a widget needs control: it moves the rig, or changes the plan, the dataset or the results.

    action: what it does, if that needs a role. viser's button groups cannot be disabled: the session refuses their
    commands.
    """
    handle.needs_control, handle.needs_role = True, role_for(action)
    return handle


def with_decimals(handle: Any, decimals: int) -> Any:
    """Let a number field take so many decimals; by itself it takes those of its step and of its first value."""
    handle.precision = decimals
    return handle


def button(gui: Gui, label: str, icon: Any, on_click: Callable[[Any], None], disabled: bool = False) -> Any:
    """Add a button with its callback."""
    handle = gui.add_button(label, icon=icon, disabled=disabled)
    handle.on_click(on_click)
    return handle


def command_button(
    gui: Gui,
    label: str,
    icon: Any,
    on_click: Callable[[Any], None],
    disabled: bool = False,
    action: Action | None = None,
) -> Any:
    """Add a button that needs control; action: what it does, if that needs a role."""
    return controlled(button(gui, label, icon, on_click, disabled), action)


def in_a_row(gui: Gui, buttons: Sequence[Any], height_px: int = 32, filled: Any = None) -> None:
    """Arrange the latest buttons in a row of equal widths, all outlined except `filled`."""
    add_html(gui, row_style(buttons, height_px, filled))


def row_style(buttons: Sequence[Any], height_px: int, filled: Any = None) -> Markup:
    """Return the styles that arrange adjacent buttons in a row of equal widths, all outlined except `filled`."""
    gap_px = 6
    width = f"calc((100% - 2*var(--mantine-spacing-xs) - {gap_px * (len(buttons) - 1)}px)/{len(buttons)})"
    rules = "".join(
        f"div:has(>{by_id(b._impl.uuid)}){{display:inline-block;vertical-align:top;width:{width};margin-right:0!important;"
        f"margin-left:{'var(--mantine-spacing-xs)' if k == 0 else f'{gap_px}px'}!important}}"
        + (_high(b, height_px) if b is filled else _outlined(b, height_px))
        + (_tight(b) if len(buttons) >= TIGHT_ROW else "")
        for k, b in enumerate(buttons)
    )
    return html.style_sheet(rules)


def outlined(gui: Gui, handle: Any, height_px: int = 36) -> None:
    """Draw a button with an outline, as a secondary action."""
    add_html(gui, outlined_style(handle, height_px))


def outlined_style(handle: Any, height_px: int = 36) -> Markup:
    """Return the styles of a button with an outline."""
    return html.style_sheet(_outlined(handle, height_px))


def leading(gui: Gui, handle: Any, height_px: int = 44, sticky: bool = True) -> None:
    """Draw a button filled, as the primary action; `sticky`: always visible at the foot of the panel."""
    add_html(gui, leading_style(handle, height_px, sticky))


def leading_style(handle: Any, height_px: int = 44, sticky: bool = True) -> Markup:
    """Return the styles of a filled button."""
    selector = by_id(handle._impl.uuid)
    rules = (
        f"{selector}{{height:{height_px}px!important}}{selector} .mantine-Button-label{{font-size:15.5px!important}}"
    )
    if sticky:
        foot = "position:sticky;bottom:0;z-index:3;background:var(--panel);padding:6px 0 8px!important"
        rules += f"div:has(>{selector}){{{foot}}}div:has(>{selector})::before{{content:'';pointer-events:none;{_FADE}}}"
        rules += f".mantine-ScrollArea-viewport:has({selector}){{scroll-padding-bottom:{height_px + _FOOT_PX}px}}"
    return html.style_sheet(rules)


_FOOT_PX = 74
"""Height of the foot of a panel beside its button: padding, two lines above it, and the fade."""
_FADE = "position:absolute;inset:auto 0 100%;height:14px;background:linear-gradient(transparent,var(--panel))"
"""Rows fade out above the foot that covers them."""
_LEAD_PX = 58
"""Height of the leading button with its margins."""


def at_foot_style(handle: Any) -> Markup:
    """Return the styles that keep a button visible above the leading button while the panel scrolls."""
    row = f"div:has(>{by_id(handle._impl.uuid)})"
    sticks = f"position:sticky;bottom:{_LEAD_PX}px;z-index:4;padding-top:6px;background:var(--panel)"
    fade = f"{row}::before{{content:'';pointer-events:none;{_FADE}}}"
    return html.style_sheet(f"{row}{{{sticks};box-shadow:6px 0 0 var(--panel)}}{fade}")


def duo(gui: Gui) -> None:
    """Arrange the next two widgets in a row."""
    add_html(gui, Markup('<div class="wv-duo"></div>'))


class ToggleGroup:
    """A button group that highlights the selected option."""

    def __init__(
        self,
        gui: Gui,
        label: str,
        options: Sequence[tuple[Any, str]],
        on_change: Callable[[Any], None],
        action: Action | None = None,
        order: float | None = None,
        hint: str | None = None,
    ) -> None:
        self._keys = [key for key, _ in options]
        self._titles = [name for _, name in options]
        self._on_change = on_change
        self._mark = f"wv-choice-{id(self)}"
        self._look = f"{self._mark} {html.FOR_ENGINEERS}" if role_for(action) == "engineer" else self._mark
        self._cell = HtmlBlock(gui, self._style(0), padded=False, order=order)
        self.handle = gui.add_button_group(label, self._titles, hint=hint, order=order)
        self.handle.on_click(self._click)

    def show(self, key: Any) -> None:
        """Highlight the selected option; none if `key` is no option."""
        self._cell.show(self._style(self._keys.index(key) if key in self._keys else -1))

    def _click(self, event: Any) -> None:
        self._on_change(self._keys[self._titles.index(event.target.value)])

    def _style(self, chosen: int) -> Markup:
        group = f"div:has(>.{self._mark})+div button"
        rest = "height:28px!important;border-color:var(--line)!important;color:var(--ink)!important"
        this = "background:var(--accent)!important;color:var(--panel)!important;border-color:var(--accent)!important"
        rules = f"{group}{{{rest}}}{group}:nth-child({chosen + 1}){{{this}}}"
        return Markup('<div class="{}"></div>{}').format(self._look, html.style_sheet(rules))


@contextlib.contextmanager
def always_mounted(gui: Gui) -> Generator[None]:
    """Context for content that stays on the page while panels are folded, because viser removes folded content.

    Of the changes within one panel in 50 ms, viser sends only the last: what must not replace another goes into a panel
    of its own.
    """
    panel = gui.add_panel()
    with panel.add_tab("·"):
        add_html(gui, Markup('<div class="wv-ov wv-frame"></div>'))
        yield
    panel.float(x=0, y=0, width=1, height=1)


def _tight(handle: Any) -> str:
    """Return compact styles for an icon and a label in a third of the left panel."""
    selector = by_id(handle._impl.uuid)
    label, sign = (
        f"{selector} .mantine-Button-label{{font-size:12.5px}}",
        f"{selector} .mantine-Button-section{{margin-inline-end:4px}}",
    )
    return f"{selector}{{padding:0 2px!important}}{label}{sign}"


def _high(handle: Any, height_px: int) -> str:
    return f"{by_id(handle._impl.uuid)}{{height:{height_px}px!important;padding:0 6px!important}}"


def _outlined(handle: Any, height_px: int) -> str:
    selector = by_id(handle._impl.uuid)
    return (
        f"{selector}{{height:{height_px}px!important;background:transparent!important;color:var(--ink)!important;"
        f"border:1px solid var(--line)!important;padding:0 6px!important}}"
        f"{selector}:hover{{background:var(--fill)!important}}{selector}[data-disabled]{{color:var(--ink3)!important}}"
    )


def _equal(a: Any, b: Any) -> bool:
    """Return whether two values of a widget are equal: numbers within rounding errors, texts but for outer spaces.

    The session strips texts; shown again, they would take the space from under a hand that pauses between two words.
    """
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(_equal(p, q) for p, q in zip(a, b, strict=True))
    if isinstance(a, int | float) and isinstance(b, int | float):
        return abs(a - b) <= 1e-9 * max(1.0, abs(a), abs(b))
    if isinstance(a, str) and isinstance(b, str):
        return a.strip() == b.strip()
    return a == b


@functools.cache
def prop_types(props: type) -> dict[str, Any]:
    """Return the type of each property by name."""
    return get_type_hints(props)


def cache_prop_types() -> None:
    """Make viser use the cached types: half of the server's work to build a page. Pinned to viser 1.1."""
    hints = property(lambda handle: prop_types(type(handle._impl.props)))
    api.AssignablePropsBase._prop_hints = hints  # pyright: ignore[reportAttributeAccessIssue]
