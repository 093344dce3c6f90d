"""Elements of a step of work: frozen descriptions of what a panel shows.

A step returns them anew for each state; the reconciler in `mount.py` keeps one widget for each and sends what differs.
Callbacks may return a session command, whose failure is reported under the title of the element.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from wafer_viewer.model.roles import Action

ButtonStyle = Literal["plain", "outlined", "filled", "leading"]
"""As in a row of its own; a secondary action; the primary action; that always visible at the foot of the panel."""


PAUSE_S = 0.8
"""Rest in typing after which a number is taken, unless Enter or Tab comes first: half a number is none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Element:
    """Base of all elements.

    key: identity among its siblings, if its place does not tell it: an element whose key or place stays keeps its
    widget, with focus and cursor. Stacks that take turns at one place share its order: what is hidden may lie between
    what is shown, so that neither may have elements side by side.
    """

    key: object = None


@dataclass(frozen=True, slots=True)
class Html(Element):
    """A block of HTML with the margins of the panel, if it is padded; text that is not Markup is shown as text."""

    content: Markup | Literal[""] = ""
    padded: bool = True


@dataclass(frozen=True, slots=True)
class Button(Element):
    """A button.

    commands: True if it needs control, because it moves the rig or changes the plan, the dataset or the results;
    action: what it does, if that needs a role. failed: title of a failure; without one that of its stack or step.
    height_px: unless it is plain.
    """

    label: str
    act: Callable[[], Any]
    icon: Any = None
    style: ButtonStyle = "plain"
    disabled: bool = False
    commands: bool = False
    action: Action | None = None
    failed: str = ""
    height_px: int | None = None


@dataclass(frozen=True, slots=True)
class Buttons(Element):
    """Buttons of equal widths side by side, outlined but for a leading one.

    at_foot: always visible above the leading button of the panel. answers: of a dialog, where Escape presses the first
    and Enter the second.
    """

    buttons: Sequence[Button]
    height_px: int = 32
    at_foot: bool = False
    answers: bool = False


@dataclass(frozen=True, slots=True)
class Upload(Element):
    """A button that sends a file from the browser's computer; `put` gets it. Needs control."""

    label: str
    put: Callable[[Any], Any]
    icon: Any = None
    mime_type: str = "*/*"
    failed: str = ""


@dataclass(frozen=True, slots=True)
class Input(Element):
    """Input of a person: `value` is that of the session or the view; `put` gets another one.

    hint: tooltip, with what an empty field means. commands, action: as of a button. pause_s: rest in typing before
    `put`; None calls it at once.
    """

    label: str
    value: Any
    put: Callable[[Any], Any]
    hint: str
    disabled: bool = False
    commands: bool = False
    action: Action | None = None
    failed: str = ""
    pause_s: float | None = None


@dataclass(frozen=True, slots=True)
class Checkbox(Input):
    """On or off."""


@dataclass(frozen=True, slots=True)
class Dropdown(Input):
    """One of `options` from a list."""

    options: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Toggle(Input):
    """One of a few `options`, pairs of key and title, side by side."""

    options: Sequence[tuple[Any, str]] = ()


@dataclass(frozen=True, slots=True)
class Text(Input):
    """A line of text."""


@dataclass(frozen=True, slots=True)
class Number(Input):
    """A number that is never empty."""

    step: float = 1.0
    decimals: int = 0
    least: float | None = None


@dataclass(frozen=True, slots=True)
class NumberPair(Input):
    """Two numbers."""

    step: float = 0.1
    decimals: int | None = None
    least: float | None = None
    pause_s: float | None = PAUSE_S


@dataclass(frozen=True, slots=True)
class Slider(Input):
    """A number between `least` and `most`, or a pair of them with a thumb each and no numbers below."""

    least: float = 0.0
    most: float = 1.0
    step: float = 0.05


@dataclass(frozen=True, slots=True)
class NumberOrEmpty(Input):
    """A number within limits, or None while the field is empty."""

    over: float | None = None
    least: float | None = None
    most: float | None = None
    integer: bool = False
    pause_s: float | None = PAUSE_S


@dataclass(frozen=True, slots=True)
class Progress(Element):
    """A progress bar."""

    fraction: float = 0.0


@dataclass(frozen=True, slots=True)
class Picture(Element):
    """A picture drawn of `source`, anew when that is another object, at most once in `every_s`."""

    source: Any
    draw: Callable[[Any], NDArray[np.uint8]]
    every_s: float = 0.0
    jpeg_quality: int = 80


@dataclass(frozen=True, slots=True)
class Stack(Element):
    """Elements one below the other; `side_by_side` arranges the two of them in a row.

    failed: title of a failure of those that have none of their own.
    """

    elements: Sequence[Element | None]
    side_by_side: bool = False
    failed: str = ""


@dataclass(frozen=True, slots=True)
class Fold(Element):
    """Elements under a title that a person unfolds; they are folded at first, unless `unfolded`."""

    title: str
    elements: Sequence[Element | None]
    unfolded: bool = False


Elements = Sequence[Element | None]
"""Elements from top to bottom; None keeps the place of one that is not shown now."""
