"""Inputs for the fields of a spec, made of their labels, types and limits."""

from __future__ import annotations

import typing
from collections.abc import Callable
from typing import Any

from wafer_viewer.gui.elements import elements as el
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
    kinds = typing.get_args(field.kind) or (field.kind,)
    parts: tuple[str, Any, Callable[[Any], Any], str] = (setting.title, value, put, field.hint)
    if field.kind is str:
        return el.Text(*parts, **state)
    if str in kinds:
        return el.Text(setting.title, value or "", lambda text: put(text.strip() or None), field.hint, **state)
    if field.kind is bool:
        return el.Checkbox(*parts, **state)
    least = limit.low if limit is not None else None
    if typing.get_origin(field.kind) is tuple:
        return el.NumberPair(*parts, step=setting.step, decimals=setting.decimals, least=least, **state)
    if field.kind is float and limit is not None and limit.low is not None and limit.high is not None:
        return el.Slider(*parts, least=limit.low, most=limit.high, step=setting.step, **state)
    if field.kind in (int, float):
        return el.Number(*parts, step=setting.step, decimals=setting.decimals, least=least, **state)
    limits: dict[str, Any] = {"over": least} if limit is not None and limit.open_low else {}
    if float not in kinds:
        put_whole: Callable[[float | None], Any] = lambda n: put(n if n is None else round(n))  # noqa: E731 - as `put`
        parts = (setting.title, value, put_whole, field.hint)
    return el.NumberOrEmpty(*parts, **limits | state)


def _putting(put: Callable[[str, Any], Any], path: str) -> Callable[[Any], Any]:
    return lambda value: put(path, value)
