"""Reconciler: brings the widgets of one panel to the elements that its step returns."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

import numpy as np
import viser
from markupsafe import Markup, escape

from wafer_viewer.gui.elements import elements as el
from wafer_viewer.gui.widgets.callbacks import Debouncer, ErrorSink, guarded
from wafer_viewer.gui.widgets.controls import add_html, set_props
from wafer_viewer.gui.widgets.number_field import number_of, text_of
from wafer_viewer.gui.widgets.style import at_foot_style, chosen_style, leading_style, outlined_style, row_style

Path = tuple[Hashable, ...]
"""Keys or places from the panel down to an element, and the kind of the element."""


class Drawn(ErrorSink, Protocol):
    """A page, or a dialog on it, that is being drawn."""

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

    def locks(self, element: el.Button | el.Input | el.Upload) -> bool:
        """Return whether an observer or an operator may not use an element now."""
        ...


class Widget:
    """Counterpart of an element on the page: `show` brings it to the element, `hide` takes it off, ready to return."""

    handle: Any

    def show(self, element: Any) -> None:
        """Bring it to the element."""
        set_props(self.handle, visible=True)

    def hide(self) -> None:
        """Take it off the page."""
        set_props(self.handle, visible=False)


class Mount:
    """The widgets of a panel.

    An element that stands at the same place, or has the same key, gets the widget that it had; that of an element
    which is missing is hidden until it returns. Only what differs is sent. They lie in a folder of their own, or in a
    `container` such as a dialog, whose owner shows and hides it.
    """

    def __init__(self, gui: viser.GuiApi, page: Drawn, failed: str, container: Any = None) -> None:
        self._gui, self._page, self._failed = gui, page, failed
        self._folder = container or gui.add_folder(None, visible=False)
        self._hides = container is None
        self._drawing = threading.Lock()
        self._widgets: dict[Path, Widget] = {}
        self._folds: dict[Path, Any] = {}

    def show(self, elements: el.Elements | None) -> None:
        """Show the elements, on any thread; None hides the panel and leaves its widgets as they are."""
        with self._drawing:
            self._show(elements)

    def _show(self, elements: el.Elements | None) -> None:
        if self._hides:
            set_props(self._folder, visible=elements is not None)
        if elements is None:
            return
        present = {placed.path: placed for placed in _placed(el.Stack(elements, failed=self._failed))}
        for path in self._widgets.keys() - present.keys():
            self._widgets[path].hide()
        for path, placed in present.items():
            if path not in self._widgets:
                with self._folds.get(placed.fold, self._folder):
                    self._widgets[path] = widget = WIDGETS[type(placed.element)](self._gui, self._page, placed)
                if isinstance(widget, FoldWidget):
                    self._folds[path] = widget.handle
            self._widgets[path].show(placed.element)


_FINER = 1e-3
"""Distance of two elements of a group in the order of the panel, relative to that of two groups."""
_DUO = el.Html(Markup('<div class="wv-duo"></div>'), padded=False)


@dataclass(frozen=True, slots=True)
class _Placed:
    """An element with its path, its place in the order of the panel, the title of a failure, and the fold it is in."""

    path: Path
    element: Any
    order: float
    failed: str
    fold: Path = ()


def _placed(
    stack: el.Stack, above: Path = (), first: float = 0.0, apart: float = 1.0, fold: Path = ()
) -> Iterator[_Placed]:
    """Yield the elements of a stack and of all stacks and folds in it."""
    elements = (_DUO, *stack.elements) if stack.side_by_side else stack.elements
    for place, element in enumerate(elements, 1):
        if element is None:
            continue
        path, order = (*above, place if element.key is None else (element.key,)), first + place * apart
        failed = getattr(element, "failed", "") or stack.failed
        if isinstance(element, el.Stack):
            yield from _placed(replace(element, failed=failed), path, order, apart * _FINER, fold)
            continue
        placed = _Placed((*path, type(element)), element, order, failed, fold)
        yield placed
        if isinstance(element, el.Fold):
            yield from _placed(el.Stack(element.elements, failed=failed), path, fold=placed.path)


class HtmlWidget(Widget):
    """Widget of `Html`; text that is not Markup is shown as text."""

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed) -> None:
        self.handle = add_html(gui, _framed(placed.element), placed.order)

    def show(self, element: el.Html) -> None:
        """Set the content."""
        set_props(self.handle, content=str(escape(_framed(element))))

    def hide(self) -> None:
        """Empty the block."""
        set_props(self.handle, content="")


def _framed(element: el.Html) -> Markup | Literal[""]:
    content = element.content
    return Markup('<div class="wv">{}</div>').format(content) if element.padded and content else content


class ProgressWidget(Widget):
    """Widget of `Progress`."""

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed) -> None:
        self.handle = gui.add_progress_bar(0.0, order=placed.order)

    def show(self, element: el.Progress) -> None:
        """Set the fraction that is done."""
        set_props(self.handle, value=round(100 * element.fraction, 1), visible=True)


class PictureWidget(Widget):
    """Widget of `Picture`."""

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed) -> None:
        blank, quality = np.zeros((3, 4, 3), np.uint8), placed.element.jpeg_quality
        self.handle = gui.add_image(blank, format="jpeg", jpeg_quality=quality, visible=False, order=placed.order)
        self._source: Any = None
        self._drawn_s = -math.inf

    def show(self, element: el.Picture) -> None:
        """Draw another source."""
        now_s = time.monotonic()
        if element.source is not self._source and now_s - self._drawn_s > element.every_s:
            self._source, self._drawn_s = element.source, now_s
            self.handle.image = element.draw(element.source)
        super().show(element)


class FoldWidget(Widget):
    """Widget of `Fold`."""

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed) -> None:
        fold: el.Fold = placed.element
        self.handle = gui.add_folder(fold.title, order=placed.order, expand_by_default=fold.unfolded)


class ButtonWidget(Widget):
    """Widget of `Button`; the row it is in has its style."""

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed, *, in_row: bool = False) -> None:
        self._page, self._element = page, placed.element
        element, order = self._element, placed.order
        self.handle = handle = gui.add_button(element.label, icon=element.icon, disabled=element.disabled, order=order)
        handle.on_click(guarded(page, placed.failed)(self._act))
        if element.style == "outlined":
            add_html(gui, outlined_style(handle, element.height_px or 36), order)
        elif element.style != "plain" and not in_row:
            leads = element.style == "leading"
            mark = _KEY.format("wv-main", handle._impl.uuid) if leads else Markup()
            add_html(gui, leading_style(handle, element.height_px or 44, leads) + mark, order)

    def show(self, element: el.Button) -> None:
        """Set label and state, and the callback of the next press."""
        self._element = element
        disabled = element.disabled or self._page.locks(element)
        set_props(self.handle, label=element.label, icon=element.icon, disabled=disabled, visible=True)

    def _act(self, _: Any) -> Any:
        self._page.entered()
        return self._element.act()


class ButtonsWidget(Widget):
    """Widget of `Buttons`."""

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed) -> None:
        row: el.Buttons = placed.element
        self._buttons = [
            ButtonWidget(gui, page, replace(placed, element=button, failed=button.failed or placed.failed), in_row=True)
            for button in row.buttons
        ]
        handles = [button.handle for button in self._buttons]
        foot = Markup().join(map(at_foot_style, handles)) if row.at_foot else Markup()
        marks = zip(("wv-away", "wv-do") if row.answers else (), handles, strict=False)
        keys = Markup().join(_KEY.format(mark, handle._impl.uuid) for mark, handle in marks)
        filled = next((h for h, one in zip(handles, row.buttons, strict=True) if one.style == "leading"), None)
        keys += _KEY.format("wv-main", filled._impl.uuid) if filled is not None else Markup()
        add_html(gui, row_style(handles, row.height_px, filled) + foot + keys, placed.order)

    def show(self, element: el.Buttons) -> None:
        """Bring each button up to date."""
        for button, of in zip(self._buttons, element.buttons, strict=True):
            button.show(of)

    def hide(self) -> None:
        """Hide all buttons."""
        for button in self._buttons:
            button.hide()


_KEY = Markup('<span hidden class="{}" data-button="{}"></span>')
"""Mark that tells the script of keys which button Escape or Enter presses, or which is the main one of the step."""


class UploadWidget(Widget):
    """Widget of `Upload`."""

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed) -> None:
        self._page, self._element = page, placed.element
        label, icon, mime_type = self._element.label, self._element.icon, self._element.mime_type
        self.handle = gui.add_upload_button(label, icon=icon, mime_type=mime_type, order=placed.order)
        self.handle.on_upload(guarded(page, placed.failed)(lambda event: self._element.put(event.target.value)))
        add_html(gui, outlined_style(self.handle, 30), placed.order)

    def show(self, element: el.Upload) -> None:
        """Set the callback of the next file."""
        self._element = element
        set_props(self.handle, disabled=self._page.locks(element), visible=True)


class ToggleWidget(Widget):
    """Widget of `Toggle`: a button group that highlights the selected option."""

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed) -> None:
        self._element: el.Toggle = placed.element
        element, order = self._element, placed.order
        self._mark = f"wv-choice-{id(self)}"
        self._style = add_html(gui, self._styled(element), order)
        titles = [title for _, title in element.options]
        self.handle = gui.add_button_group(element.label, titles, hint=element.hint, order=order)
        self.handle.on_click(guarded(page, placed.failed)(self._act))

    def show(self, element: el.Toggle) -> None:
        """Highlight the option that is set."""
        self._element = element
        set_props(self._style, content=str(self._styled(element)))
        super().show(element)

    def _act(self, event: Any) -> Any:
        return self._element.put(next(key for key, title in self._element.options if title == event.target.value))

    def _styled(self, element: el.Toggle) -> Markup:
        keys = [key for key, _ in element.options]
        chosen = keys.index(element.value) if element.value in keys else -1
        return Markup('<div class="{}"></div>{}').format(self._mark, chosen_style(self._mark, chosen))


QUIET_S = 0.7
"""Time after user input during which a slightly older value of the session does not overwrite the widget."""


class InputWidget(Widget):
    """Widget of any other input.

    What a person types stands until the session has it: values older than that are not shown, however long their
    drawing took, and a value that came back earlier never replaces it.
    """

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed) -> None:
        self._page, self._element, self._failed = page, placed.element, placed.failed
        self.handle = handle = _ADD[type(self._element)](gui, self._element, placed.order)
        self._touched_at = -QUIET_S
        self._last = handle.value
        """Last value shown or received; viser updates its handle before it calls back."""
        self._edits: Debouncer | None = None
        self._heard = guarded(page, placed.failed)(self._put)
        if self._element.pause_s is not None:
            self._edits = Debouncer(self._put, guarded(page, placed.failed), self._element.pause_s)
            page.on_entered(self._edits)
            self._heard = self._edits.made
        handle.on_update(self._update)

    def show(self, element: el.Input) -> None:
        """Set value and state, and the callback of the next change."""
        self._element = element
        set_props(self.handle, **_props(element))
        if self._edits is None or not self._edits.under_way:
            self._show_value(_shown(element))
        set_props(self.handle, disabled=element.disabled or self._page.locks(element), visible=True)

    def _show_value(self, value: Any) -> None:
        """Show a value, unless the user is moving the widget or has changed it since the value was read."""
        if time.monotonic() - self._touched_at <= QUIET_S or self._page.as_of_s <= self._touched_at:
            return
        if not _equal(self._last, self.handle.value):  # put in, and not heard of yet
            return
        if not _equal(value, self.handle.value):
            self._last = self.handle.value = value

    def _update(self, event: Any) -> None:
        self._last = self.handle.value
        if event.client is not None:
            self._touched_at = time.monotonic()
            self._heard()
            self._touched_at = time.monotonic()  # what was read meanwhile may be of before or after

    def _put(self) -> Any:
        element, value = self._element, self.handle.value
        self._page.settle(self._failed)
        if isinstance(element, el.NumberOrEmpty):
            limits = {"over": element.over, "least": element.least, "most": element.most}
            value = number_of(value, element.label, integer=element.integer, **limits)
        return element.put(value)


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


def _shown(element: el.Input) -> Any:
    """Return the value of an element as its widget has it; that of a slider lies between its ends."""
    if isinstance(element, el.Slider):
        low, high = element.least, element.most
        return element.value if isinstance(element.value, tuple) else min(max(element.value, low), high)
    return text_of(element.value) if isinstance(element, el.NumberOrEmpty) else element.value


def _props(element: el.Input) -> dict[str, Any]:
    """Return the properties of a widget that may differ from state to state."""
    match element:
        case el.Dropdown():
            return {"options": tuple(element.options)}
        case el.Slider():
            ends = {"min": element.least, "max": element.most, "step": element.step}
            return ends | {"precision": len(f"{element.step:.6f}".rstrip("0").partition(".")[2])}
        case el.NumberPair(decimals=int()):
            return {"step": element.step, "precision": element.decimals}
        case _:
            return {}


def _slider(gui: viser.GuiApi, element: el.Slider, order: float) -> Any:
    e, ends = element, (element.least, element.most, element.step)
    if isinstance(e.value, tuple):
        value: Any = e.value
        return gui.add_multi_slider(e.label, *ends, value, marks=(), hint=e.hint, order=order)
    return gui.add_slider(e.label, *ends, _shown(e), hint=e.hint, order=order)


def _number(gui: viser.GuiApi, element: Any, order: float) -> Any:
    handle = gui.add_number(
        element.label, element.value, min=element.least, step=element.step, hint=element.hint, order=order
    )
    handle.precision = element.decimals  # by itself it takes those of its step and of its first value
    return handle


def _pair(gui: viser.GuiApi, element: el.NumberPair, order: float) -> Any:
    least = None if element.least is None else (element.least, element.least)
    handle = gui.add_vector2(element.label, element.value, min=least, step=element.step, hint=element.hint, order=order)
    if element.decimals is not None:
        handle.precision = element.decimals
    return handle


def _dropdown(gui: viser.GuiApi, element: el.Dropdown, order: float) -> Any:
    options = tuple(element.options)
    return gui.add_dropdown(element.label, options, initial_value=element.value, hint=element.hint, order=order)


_ADD: dict[type[el.Input], Callable[[viser.GuiApi, Any, float], Any]] = {
    el.Checkbox: lambda gui, e, order: gui.add_checkbox(e.label, e.value, hint=e.hint, order=order),
    el.Dropdown: _dropdown,
    el.Text: lambda gui, e, order: gui.add_text(e.label, e.value, hint=e.hint, order=order),
    el.NumberOrEmpty: lambda gui, e, order: gui.add_text(e.label, _shown(e), hint=e.hint, order=order),
    el.Number: _number,
    el.NumberPair: _pair,
    el.Slider: _slider,
}
WIDGETS: dict[type[el.Element], Callable[[viser.GuiApi, Drawn, _Placed], Widget]] = {
    el.Html: HtmlWidget,
    el.Progress: ProgressWidget,
    el.Picture: PictureWidget,
    el.Fold: FoldWidget,
    el.Button: ButtonWidget,
    el.Buttons: ButtonsWidget,
    el.Upload: UploadWidget,
    el.Toggle: ToggleWidget,
    **dict.fromkeys(_ADD, InputWidget),
}
"""Widget of each kind of element."""
