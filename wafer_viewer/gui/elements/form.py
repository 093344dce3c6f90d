"""Inputs for the fields of a spec, made of their labels, types and limits, and dialogs of them."""

from __future__ import annotations

import time
import typing
from collections.abc import Callable
from typing import Any

from wafer_viewer.gui.elements import elements as el
from wafer_viewer.gui.elements.mount import Mount
from wafer_viewer.gui.elements.step import C, Here
from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.model.spec import Spec, settings_of, value_at


def form(spec: Spec, put: Callable[[str, Any], Any], *paths: str, **state: Any) -> list[el.Input]:
    """Return the inputs for fields of a spec by their paths with dots; `put` gets the path and the value.

    state: other fields of the inputs, such as `disabled`.
    """
    return [spec_input(type(spec), path, value_at(spec, path), _putting(put, path), **state) for path in paths]


def spec_input(kind: type[Spec], path: str, value: Any, put: Callable[[Any], Any], **state: Any) -> el.Input:
    """Return the input for a field of a spec: a choice, text, checkbox, slider or number by its type."""
    field = settings_of(kind)[path]
    setting, limit = field.setting, field.limit
    if titles := setting.titles:
        values = {title: key for key, title in titles.items()}
        choose: Callable[[str], Any] = lambda title: put(values[title])  # noqa: E731 - as `put`
        return el.Dropdown(setting.title, titles[value], choose, field.hint, options=tuple(values), **state)
    parts: tuple[str, Any, Callable[[Any], Any], str] = (setting.title, value, put, field.hint)
    if field.kind is str:
        return el.Text(*parts, **state)
    if field.kind is bool:
        return el.Checkbox(*parts, **state)
    least = limit.low if limit is not None else None
    if typing.get_origin(field.kind) is tuple:
        return el.NumberPair(*parts, step=setting.step, decimals=setting.decimals, least=least, **state)
    if field.kind is float and limit is not None and limit.low is not None and limit.high is not None:
        return el.Slider(*parts, least=limit.low, most=limit.high, step=setting.step, **state)
    if field.kind in (int, float):
        return el.Number(*parts, step=setting.step, decimals=setting.decimals, least=least, **state)
    return el.NumberOrEmpty(*parts, over=least, **state)


def form_dialog(
    page: Page,
    title: str,
    below: str,
    own: C,
    answer: tuple[str, Any, Callable[[C], Any]],
    failed: str,
    fields: Callable[[Here[C]], el.Elements] | None = None,
) -> Here[C]:
    """Open a dialog of inputs and return its arguments.

    Parameters
    ----------
    page : Page
        Page that the dialog lies on.
    title, below : str
        Heading and the sentence below it.
    own : Spec or dataclass
        Initial value of what the dialog holds.
    answer : tuple
        Label, icon and callback of the confirming button; the callback gets what the dialog holds.
    failed : str
        Title of a failure.
    fields : callable, optional
        Inputs for what the dialog holds; without it those of all labelled fields of a spec.
    """
    dialog = Dialog(page, title, below)
    label, icon, act = answer
    with dialog.modal:
        mount = Mount(page.gui, _JustDrawn(page), failed)
    here = Here(page, own, lambda: mount.show((fields or _all_fields)(here)))
    here.redraw()
    dialog.answers(label, icon, lambda: act(here.own), failed)
    return here


def _all_fields(here: Here[Any]) -> el.Elements:
    return form(here.own, here.put, *settings_of(type(here.own)))


class _JustDrawn:
    """A page whose shown state is never older than an input: a dialog draws itself."""

    def __init__(self, page: Page) -> None:
        self.tell, self.say, self.settle = page.tell, page.say, page.settle
        self.on_entered, self.entered = page.on_entered, page.entered

    @property
    def as_of_s(self) -> float:
        return time.monotonic()


def _putting(put: Callable[[str, Any], Any], path: str) -> Callable[[Any], Any]:
    return lambda value: put(path, value)
