"""Plug-ins: measuring tools, surface formats and focus measures that other packages bring.

A package names them as entry points in its ``pyproject.toml``; every process of the program loads the same ones::

    [project.entry-points."wafer_viewer.measuring_tools"]
    dome = "my_package.dome:TOOL"
"""

from __future__ import annotations

import warnings
from importlib.metadata import entry_points
from typing import Literal, TypeVar

T = TypeVar("T")
PluginGroup = Literal["measuring_tools", "surface_formats", "focus_measures"]


class PluginWarning(UserWarning):
    """A plug-in that cannot be used, with the reason and the package that brings it."""


def plugins(group: PluginGroup, kind: type[T]) -> list[T]:
    """Return the descriptors of other packages; one that cannot be loaded is left out with a `PluginWarning`."""
    found: list[T] = []
    for point in sorted(entry_points(group=f"wafer_viewer.{group}"), key=lambda point: point.name):
        package = point.dist.name if point.dist is not None else point.value
        try:
            loaded = point.load()
        except Exception as fault:  # noqa: BLE001 (foreign code may raise anything)
            _warn(f"{point.value} of {package} cannot be loaded ({fault}): update or remove that package.")
            continue
        if isinstance(loaded, kind):
            found.append(loaded)
        else:
            _warn(f"{point.value} of {package} is no {kind.__name__}: its entry point must name one.")
    return found


def _warn(sentence: str) -> None:
    warnings.warn(sentence, PluginWarning, stacklevel=3)
