"""Conversion between the form of an inspection and its recipe and limits. Pure."""

from __future__ import annotations

import math
from typing import Annotated, Any

from markupsafe import Markup

from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.number_field import PLACE, Pair, pair_of, pair_text
from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.inspection.defect import (
    Against,
    DefectLimits,
    DefectRecipe,
    Evidence,
    Inspection,
    headline,
    verdict_of,
)
from wafer_viewer.model.inspection.die_grid import DieGrid, ProductDies
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Fraction, Setting, Spec, replace
from wafer_viewer.session.inspection.inspection_job import Dies

LIMITS = {
    "max_per_die": "defects per die",
    "max_per_mm2": "defects per mm2",
    "max_tilt_mrad": "mrad of tilt",
    "max_offset_um": "um of offset",
    "max_bow_um": "um of bow",
}
"""Limits of the form, and their units in words."""


def text_of(limits: DefectLimits) -> dict[str, str]:
    """Return the texts of the inputs by name; empty for no limit."""
    each = {name: getattr(limits, name) for name in LIMITS}
    return {name: "" if limit is None else f"{limit:g}" for name, limit in each.items()}


def limits_of(form: DefectForm) -> DefectLimits:
    """Parse the limits. Raises MeasureError for text that is not a number, negative numbers, or fractions per die."""
    most = {name: _typed(getattr(form, name), unit) for name, unit in LIMITS.items()}
    per_die = most.pop("max_per_die")
    if per_die is not None and per_die != int(per_die):
        raise MeasureError(f"At most {per_die:g} defects per die: give a whole number, 0 or more.")
    return DefectLimits(max_per_die=None if per_die is None else int(per_die), **most)


def verdict(inspection: Inspection) -> Markup:
    """Return the first line of the result and the verdict with its reasons, as HTML."""
    limits = inspection.recipe.limits
    outcome = verdict_of(inspection, limits)
    first, *why = (line.replace("mm2", "mm²") for line in (headline(inspection), *outcome.why))
    reasons = " ".join((first, *why))
    match outcome.word:
        case "pass" if limits.are_set:
            note = html.note("good", "Within the limits", f"{first} {_allowed(limits)} allowed.")
        case "pass":
            return html.remark(first)
        case "fail":
            note = html.note("fault", "Not within the limits", reasons)
        case _:
            note = html.note(
                "fault" if limits.are_set else "attention", "No verdict: parts were not inspected", reasons
            )
    return Markup('<div class="wv-blind">{}</div>').format(note)


def _allowed(limits: DefectLimits) -> str:
    each = ((getattr(limits, name), unit) for name, unit in LIMITS.items())
    parts = [f"{number(limit, 3)} {unit}" for limit, unit in each if limit is not None]
    return " and ".join(parts).replace("mm2", "mm²").replace("um", "µm")


def _typed(text: str, unit: str) -> float | None:
    if not text.strip():
        return None
    try:
        most = float(text)
    except ValueError as fault:
        raise MeasureError(f"{text!r} is not a number of {unit}: type one, or leave it empty for no limit.") from fault
    if not 0 <= most < float("inf"):
        raise MeasureError(f"At most {text} {unit}: it must be at least 0, or empty for no limit.")
    return most


DIE, GOLDEN, FORM = "Die to die", "Die to golden die", "With the fitted form"
AGAINST = (DIE, GOLDEN, FORM)
OF_JOB, FOUND, GIVEN = "The job's, or found", "Found", "Given"
DIES = (OF_JOB, FOUND, GIVEN)
_EVIDENCE = Setting(
    "Look at",
    "Where to look for defects",
    titles={"both": "Height and picture", "height": "Height", "picture": "Picture"},
)


def _choice(title: str, about: str, choices: tuple[str, ...]) -> Setting:
    return Setting(title, about, titles=dict(zip(choices, choices, strict=True)))


class DefectForm(Spec, frozen=True, kw_only=True):
    """Inputs of the inspection form; golden: name of the chosen golden die, '' for none."""

    error = MeasureError
    sensitivity: Annotated[
        Fraction, Setting("Sensitivity", "0 finds only clear defects, 1 also doubtful ones", step=0.05)
    ] = DefectRecipe().sensitivity
    compare: Annotated[str, _choice("Compare", "A surface with one die has no others to compare with", AGAINST)] = DIE
    evidence: Annotated[Evidence, _EVIDENCE] = "both"
    golden: str = ""
    dies: Annotated[str, _choice("Dies", "From the job where it names dies, else found, or entered here", DIES)] = (
        OF_JOB
    )
    pitch_um: Annotated[str, Setting("Pitch, µm", "From die to die, x × y")] = ""
    corner_um: Annotated[str, Setting("Corner, µm", "Lower left one of die 0,0, stage x, y; empty: found")] = ""
    size_um: Annotated[str, Setting("Die, µm", "Width × height; empty: found, or as the pitch")] = ""
    angle_deg: Annotated[float, Setting("Angle, °", "Anticlockwise", decimals=4, step=0.01)] = 0.0
    product: Annotated[str, Setting("Product", "A golden die of another product is refused")] = ""
    scales_px: Annotated[str, Setting("Filters, px", "Filter widths; 0: unfiltered, at most 40")] = ""
    excluded: tuple[Region, ...] = ()
    max_per_die: Annotated[str, Setting("Max. per die", "Defects allowed on a die; empty: no limit")] = ""
    max_per_mm2: Annotated[str, Setting("Max. per mm²", "Defects allowed in 1 mm²; empty: no limit")] = ""
    max_tilt_mrad: Annotated[str, Setting("Max. tilt, mrad", "Of a die; empty: no limit")] = ""
    max_offset_um: Annotated[str, Setting("Max. offset, µm", "Of a die, up or down; empty: no limit")] = ""
    max_bow_um: Annotated[str, Setting("Max. bow, µm", "Of a die; empty: no limit")] = ""


_SHARED = ("sensitivity", "evidence", "golden", "product", "excluded")
"""Settings that form and recipe have alike."""
_LATTICE = ("pitch_um", "corner_um", "size_um", "angle_deg")


def form_of(recipe: DefectRecipe, inspection: Inspection | None, before: DefectForm = DefectForm()) -> DefectForm:
    """Return the form of a recipe and of an inspection's die grid; the source of dies is kept from `before`."""
    by_form = inspection is not None and inspection.grid is None
    grid = inspection.grid if inspection is not None else None
    return DefectForm(
        compare=GOLDEN if recipe.golden else FORM if by_form else DIE,
        dies=before.dies,
        scales_px=", ".join(f"{scale:g}" for scale in recipe.scales_px),
        **text_of(recipe.limits),
        **{name: getattr(recipe, name) for name in _SHARED},
        **({name: getattr(before, name) for name in _LATTICE} if grid is None else _shown(grid)),
    )


def recipe_of(form: DefectForm, old: DefectRecipe) -> DefectRecipe:
    """Return the recipe of a form; settings of the old recipe that the form does not show are kept.

    Raises MeasureError with a message for the user if the form is invalid.
    """
    if form.compare == GOLDEN and not form.golden:
        raise MeasureError(
            f"No golden die is chosen: choose one where the list has any, or compare {FORM[0].lower()}{FORM[1:]}."
        )
    shared = {name: getattr(form, name) for name in _SHARED} | {"product": form.product.strip()}
    golden = form.golden if form.compare == GOLDEN else ""
    limits = limits_of(form)
    return replace(old, **{**shared, "golden": golden}, scales_px=_scales(form.scales_px), limits=limits)


def against_of(form: DefectForm) -> Against:
    """Return the reference of the comparison: other dies or the fitted form."""
    return "form" if form.compare == FORM else "dies"


def dies_of(form: DefectForm) -> Dies:
    """Return the source of dies: None (the job's), "found", a given grid, or without a corner a size to search by.

    Without a size, given dies fill the pitch. Raises MeasureError if the pitch is missing, or if dies are larger.
    """
    if form.dies != GIVEN or form.compare == FORM:
        return "found" if form.dies == FOUND else None
    pitch, corner = _pair(form.pitch_um, "Pitch, µm", over=0), _pair(form.corner_um, "Corner, µm")
    if pitch is None:
        raise MeasureError("The pitch of the dies is not given: type it, such as 300 × 200, or have the dies found.")
    pitch_x, pitch_y = pitch
    size = _pair(form.size_um, "Die, µm", over=0)
    width, height = size or pitch
    if width > pitch_x or height > pitch_y:
        raise MeasureError(
            f"The dies are {width:g} x {height:g} um and their pitch {pitch_x:g} x {pitch_y:g} um: "
            "a die is at most as large as the pitch."
        )
    if corner is None:
        known = {"width_um": width, "height_um": height} if size is not None else {}
        return ProductDies(pitch_x_um=pitch_x, pitch_y_um=pitch_y, **known)
    return DieGrid(
        pitch_x_um=pitch_x,
        pitch_y_um=pitch_y,
        width_um=width,
        height_um=height,
        x0_um=corner[0],
        y0_um=corner[1],
        angle_rad=math.radians(form.angle_deg),
    )


def _shown(grid: DieGrid) -> dict[str, Any]:
    """Return the inputs of a die grid, rounded to nanometres."""
    return {
        "pitch_um": pair_text((round(grid.pitch_x_um, 3), round(grid.pitch_y_um, 3))),
        "corner_um": pair_text((round(grid.x0_um, 3), round(grid.y0_um, 3)), PLACE),
        "size_um": pair_text((round(grid.width_um, 3), round(grid.height_um, 3))),
        "angle_deg": round(math.degrees(grid.angle_rad), 5),
    }


def _pair(text: str, name: str, over: float | None = None) -> Pair | None:
    try:
        return pair_of(text, name, over=over)
    except WaferViewerError as fault:
        raise MeasureError(str(fault)) from fault


def _scales(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.replace(";", ",").split(",") if part.strip())
    except ValueError as fault:
        raise MeasureError(f"The scales {text!r} are not numbers: write them as 0, 1.5, 4, 10.") from fault


TINY_PER_MM2 = 1e-3


def per_mm2(count: float | None) -> str:
    """Format an expected density per mm²; a sentence for None."""
    if count is None:
        return "not known before an inspection"
    return f"under {number(TINY_PER_MM2, 3)} per mm²" if count < TINY_PER_MM2 else f"{number(count, 3)} per mm²"
