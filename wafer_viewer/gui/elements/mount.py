"""Reconciler: brings the widgets of one panel to the elements that its step returns."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import viser
from markupsafe import Markup

from wafer_viewer.gui.elements import elements as el
from wafer_viewer.gui.widgets.callbacks import Debouncer, guarded
from wafer_viewer.gui.widgets.controls import (
    BoundInput,
    Drawn,
    HtmlBlock,
    ToggleGroup,
    add_html,
    at_foot_style,
    controlled,
    leading_style,
    outlined_style,
    row_style,
    set_prop,
    with_decimals,
)
from wafer_viewer.gui.widgets.number_field import number_of, text_of

Path = tuple[Hashable, ...]
"""Keys or places from the panel down to an element, and the kind of the element."""


class Widget(Protocol):
    """Counterpart of an element on the page."""

    def show(self, element: Any) -> None:
        """Bring it to the element."""
        ...

    def hide(self) -> None:
        """Take it off the page, ready to return."""
        ...


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
            set_prop(self._folder, "visible", elements is not None)
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
                    self._folds[path] = widget.folder
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


class HtmlWidget:
    """Widget of `Html`."""

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed) -> None:
        self._block = HtmlBlock(gui, placed.element.content, placed.element.padded, placed.order)

    def show(self, element: el.Html) -> None:
        """Set the content."""
        self._block.show(element.content)

    def hide(self) -> None:
        """Empty the block."""
        self._block.show("")


class ProgressWidget:
    """Widget of `Progress`."""

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed) -> None:
        self._handle = gui.add_progress_bar(0.0, order=placed.order)

    def show(self, element: el.Progress) -> None:
        """Set the fraction that is done."""
        set_prop(self._handle, "value", round(100 * element.fraction, 1))
        set_prop(self._handle, "visible", True)

    def hide(self) -> None:
        """Hide the bar."""
        set_prop(self._handle, "visible", False)


class PictureWidget:
    """Widget of `Picture`."""

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed) -> None:
        blank, quality = np.zeros((3, 4, 3), np.uint8), placed.element.jpeg_quality
        self._handle = gui.add_image(blank, format="jpeg", jpeg_quality=quality, visible=False, order=placed.order)
        self._source: Any = None
        self._drawn_s = -math.inf

    def show(self, element: el.Picture) -> None:
        """Draw another source."""
        now_s = time.monotonic()
        if element.source is not self._source and now_s - self._drawn_s > element.every_s:
            self._source, self._drawn_s = element.source, now_s
            self._handle.image = element.draw(element.source)
        set_prop(self._handle, "visible", True)

    def hide(self) -> None:
        """Hide the picture."""
        set_prop(self._handle, "visible", False)


class FoldWidget:
    """Widget of `Fold`."""

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed) -> None:
        fold: el.Fold = placed.element
        self.folder = gui.add_folder(fold.title, order=placed.order, expand_by_default=fold.unfolded)

    def show(self, element: el.Fold) -> None:
        """Show the folder."""
        set_prop(self.folder, "visible", True)

    def hide(self) -> None:
        """Hide the folder with its contents."""
        set_prop(self.folder, "visible", False)


class ButtonWidget:
    """Widget of `Button`; the row it is in has its style."""

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed, *, in_row: bool = False) -> None:
        self._element: el.Button = placed.element
        element, order = self._element, placed.order
        self.handle = handle = gui.add_button(element.label, icon=element.icon, disabled=element.disabled, order=order)
        handle.on_click(guarded(page, placed.failed)(self._act))
        self._page = page
        if element.commands:
            controlled(handle, element.action)
        if element.style == "outlined":
            add_html(gui, outlined_style(handle, element.height_px or 36), order)
        elif element.style != "plain" and not in_row:
            add_html(gui, leading_style(handle, element.height_px or 44, element.style == "leading"), order)

    def show(self, element: el.Button) -> None:
        """Set label and state, and the callback of the next press."""
        self._element = element
        set_prop(self.handle, "label", element.label)
        set_prop(self.handle, "icon", element.icon)
        set_prop(self.handle, "disabled", element.disabled)
        set_prop(self.handle, "visible", True)

    def _act(self, _: Any) -> Any:
        self._page.entered()
        return self._element.act()

    def hide(self) -> None:
        """Hide the button."""
        set_prop(self.handle, "visible", False)


class ButtonsWidget:
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
"""Mark that tells the script of keys which button Escape or Enter presses."""


class UploadWidget:
    """Widget of `Upload`."""

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed) -> None:
        self._element = element = placed.element
        self._handle = controlled(
            gui.add_upload_button(element.label, icon=element.icon, mime_type=element.mime_type, order=placed.order)
        )
        self._handle.on_upload(guarded(page, placed.failed)(lambda event: self._element.put(event.target.value)))
        add_html(gui, outlined_style(self._handle, 30), placed.order)

    def show(self, element: el.Upload) -> None:
        """Set the callback of the next file."""
        self._element = element
        set_prop(self._handle, "visible", True)

    def hide(self) -> None:
        """Hide the button."""
        set_prop(self._handle, "visible", False)


class ToggleWidget:
    """Widget of `Toggle`."""

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed) -> None:
        self._element = element = placed.element
        put = guarded(page, placed.failed)(lambda key: self._element.put(key))
        self._group = ToggleGroup(gui, element.label, element.options, put, order=placed.order, hint=element.hint)

    def show(self, element: el.Toggle) -> None:
        """Highlight the option that is set."""
        self._element = element
        self._group.show(element.value)
        set_prop(self._group.handle, "visible", True)

    def hide(self) -> None:
        """Hide the buttons."""
        set_prop(self._group.handle, "visible", False)


class InputWidget:
    """Widget of any other input.

    What a person types stands until the session has it, and a value that came back earlier never replaces it.
    """

    def __init__(self, gui: viser.GuiApi, page: Drawn, placed: _Placed) -> None:
        self._element = element = placed.element
        handle = _ADD[type(element)](gui, element, placed.order)
        if element.commands:
            controlled(handle, element.action)
        self._page, self._failed = page, placed.failed
        self._edits: Debouncer | None = None
        heard = self._put
        if element.pause_s is not None:
            self._edits = Debouncer(self._put, guarded(page, placed.failed), element.pause_s)
            page.on_entered(self._edits)
            heard = self._edits.made
        self._input: BoundInput[Any] = BoundInput(handle, lambda _: heard(), page, placed.failed)

    def show(self, element: el.Input) -> None:
        """Set value and state, and the callback of the next change."""
        self._element = element
        for name, value in _props(element).items():
            set_prop(self._input.handle, name, value)
        if self._edits is None or not self._edits.under_way:
            self._input.show(_shown(element))
        self._input.enable(not element.disabled)
        set_prop(self._input.handle, "visible", True)

    def hide(self) -> None:
        """Hide the input."""
        set_prop(self._input.handle, "visible", False)

    def _put(self) -> Any:
        element, value = self._element, self._input.value
        self._page.settle(self._failed)
        if isinstance(element, el.NumberOrEmpty):
            limits = {"over": element.over, "least": element.least, "most": element.most}
            value = number_of(value, element.label, integer=element.integer, **limits)
        return element.put(value)


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
    return with_decimals(handle, element.decimals)


def _pair(gui: viser.GuiApi, element: el.NumberPair, order: float) -> Any:
    least = None if element.least is None else (element.least, element.least)
    handle = gui.add_vector2(element.label, element.value, min=least, step=element.step, hint=element.hint, order=order)
    return handle if element.decimals is None else with_decimals(handle, element.decimals)


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
