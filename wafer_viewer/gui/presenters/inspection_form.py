"""Conversion between the form of an inspection and its recipe and limits. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from markupsafe import Markup

from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.number_field import PLACE, Pair, pair_of, pair_text
from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.inspection.defect import DefectLimits, DefectRecipe, Evidence, Inspection, verdict_of
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace as changed
from wafer_viewer.session.inspection.inspection_job import Against, Dies


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


def verdict(inspection: Inspection) -> Markup:
    """Return the verdict by the defect limits with its reasons, as HTML; empty without limits."""
    limits = inspection.recipe.limits
    if not limits.are_set:
        return Markup()
    outcome = verdict_of(inspection, limits)
    reasons = " ".join(outcome.why).replace("mm2", "mm²")
    match outcome.word:
        case "pass":
            note = html.note("good", "Within the limits", f"{outcome.counted} counted, {_allowed(limits)} allowed.")
        case "fail":
            note = html.note("fault", "Not within the limits", reasons)
        case _:
            note = html.note("fault", "No verdict: not all was inspected", reasons)
    return Markup('<div class="wv-blind">{}</div>').format(note)


def _allowed(limits: DefectLimits) -> str:
    per_die, per_mm2 = limits.max_per_die, limits.max_per_mm2
    parts = [] if per_die is None else [f"{per_die} per die"]
    return " and ".join(parts + ([] if per_mm2 is None else [f"{number(per_mm2, 3)} per mm²"]))


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


DIE, GOLDEN, FORM = "Die to die", "Die to golden die", "With the fitted form"
AGAINST = (DIE, GOLDEN, FORM)
EVIDENCE: dict[str, Evidence] = {"Height and picture": "both", "Height": "height", "Picture": "picture"}
OF_JOB, FOUND, GIVEN = "The job's, or found", "Found", "Given"
DIES = (OF_JOB, FOUND, GIVEN)


@dataclass(frozen=True, slots=True)
class DefectForm:
    """Inputs of the inspection form; golden: name of the chosen golden die, '' for none."""

    sensitivity: float = DefectRecipe().sensitivity
    compare: str = DIE
    evidence: str = "Height and picture"
    golden: str = ""
    dies: str = OF_JOB
    pitch_um: str = ""
    corner_um: str = ""
    size_um: str = ""
    angle_deg: float = 0.0
    product: str = ""
    scales_px: str = ""
    excluded: tuple[Region, ...] = ()
    max_per_die: str = ""
    max_per_mm2: str = ""


def form_of(recipe: DefectRecipe, inspection: Inspection | None, before: DefectForm = DefectForm()) -> DefectForm:
    """Return the form of a recipe and of an inspection's die grid; the source of dies is kept from `before`."""
    by_form = inspection is not None and inspection.grid is None
    compare = GOLDEN if recipe.golden else FORM if by_form else DIE
    grid = inspection.grid if inspection is not None else None
    per_die, per_mm2 = text_of(recipe.limits)
    made = DefectForm(
        sensitivity=recipe.sensitivity,
        compare=compare,
        evidence=next(name for name, evidence in EVIDENCE.items() if evidence == recipe.evidence),
        golden=recipe.golden,
        dies=before.dies,
        product=recipe.product,
        scales_px=", ".join(f"{scale:g}" for scale in recipe.scales_px),
        excluded=recipe.excluded,
        max_per_die=per_die,
        max_per_mm2=per_mm2,
    )
    lattice = before if grid is None else replace(made, **_shown(grid))
    places = {name: getattr(lattice, name) for name in ("pitch_um", "corner_um", "size_um", "angle_deg")}
    return replace(made, **places)


def recipe_of(form: DefectForm, old: DefectRecipe) -> DefectRecipe:
    """Return the recipe of a form; settings of the old recipe that the form does not show are kept.

    Raises MeasureError with a message for the user if the form is invalid.
    """
    if form.compare == GOLDEN and not form.golden:
        raise MeasureError(
            f"No golden die is chosen: choose one where the list has any, or compare {FORM[0].lower()}{FORM[1:]}."
        )
    return changed(
        old,
        sensitivity=form.sensitivity,
        evidence=EVIDENCE[form.evidence],
        product=form.product.strip(),
        golden=form.golden if form.compare == GOLDEN else "",
        scales_px=_scales(form.scales_px),
        excluded=form.excluded,
        limits=limits_of(form.max_per_die, form.max_per_mm2),
    )


def against_of(form: DefectForm) -> Against:
    """Return the reference of the comparison: other dies or the fitted form."""
    return "form" if form.compare == FORM else "dies"


def dies_of(form: DefectForm) -> Dies:
    """Return the source of dies: None (the job's), "found", or a given grid; without a size, dies fill the pitch.

    Raises MeasureError if the pitch or the corner is missing, or if dies are larger than their pitch.
    """
    if form.dies != GIVEN or form.compare == FORM:
        return "found" if form.dies == FOUND else None
    pitch, corner = _pair(form.pitch_um, "Pitch, µm", over=0), _pair(form.corner_um, "Corner, µm")
    if pitch is None:
        raise MeasureError("The pitch of the dies is not given: type it, such as 300 × 200, or have the dies found.")
    if corner is None:
        raise MeasureError("The corner of the dies is not given: type stage x, y of the lower left one of die 0,0.")
    pitch_x, pitch_y = pitch
    width, height = _pair(form.size_um, "Die, µm", over=0) or pitch
    if width > pitch_x or height > pitch_y:
        raise MeasureError(
            f"The dies are {width:g} x {height:g} um and their pitch {pitch_x:g} x {pitch_y:g} um: "
            "a die is at most as large as the pitch."
        )
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
