"""Defect limits: conversion from and to text inputs, and HTML of the verdict."""

from __future__ import annotations

from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import Inspection
from wafer_viewer.model.inspection.defect_limits import DefectLimits
from wafer_viewer.model.inspection.defect_verdict import verdict_of


def text_of(limits: DefectLimits) -> tuple[str, str]:
    """Return the texts of the inputs per die and per mm²; empty for no limit."""
    per_die, per_mm2 = limits.max_per_die, limits.max_per_mm2
    return "" if per_die is None else f"{per_die}", "" if per_mm2 is None else f"{per_mm2:g}"


def limits_of(per_die: str, per_mm2: str) -> DefectLimits:
    """Parse the limits. Raises MeasureError for text that is not a number, negative numbers, or fractions per die."""
    most = _typed(per_die, "per die")
    if most is not None and most != int(most):
        raise MeasureError(f"At most {most:g} defects per die: give a whole number, 0 or more.")
    return DefectLimits(max_per_die=None if most is None else int(most), max_per_mm2=_typed(per_mm2, "per mm2"))


def verdict(inspection: Inspection) -> str:
    """Return the verdict by the defect limits with its reasons, as HTML; empty without limits."""
    limits = inspection.recipe.limits
    if not limits.are_set:
        return ""
    said = verdict_of(inspection, limits)
    if said.within:
        note = html.note("good", "Within the limits", f"{said.counted} counted, {_allowed(limits)} allowed.")
    else:
        note = html.note("fault", "Not within the limits", " ".join(said.why).replace("mm2", "mm²"))
    return f'<div class="wv-blind">{note}</div>'


def _allowed(limits: DefectLimits) -> str:
    per_die, per_mm2 = limits.max_per_die, limits.max_per_mm2
    told = [] if per_die is None else [f"{per_die} per die"]
    return " and ".join(told + ([] if per_mm2 is None else [f"{number(per_mm2, 3)} per mm²"]))


def _typed(text: str, where: str) -> float | None:
    if not text.strip():
        return None
    try:
        most = float(text)
    except ValueError as fault:
        raise MeasureError(
            f"{text!r} is not a number of defects {where}: type one, or leave it empty for no limit."
        ) from fault
    if not 0 <= most < float("inf"):
        raise MeasureError(f"At most {text} defects {where}: it must be at least 0, or empty for no limit.")
    return most
