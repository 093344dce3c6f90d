"""HTML of defects: classes with colour and shape, inspected and uninspected areas."""

from __future__ import annotations

from collections import Counter

from wafer_viewer.draw.charts.defect_symbols import KINDS
from wafer_viewer.draw.charts.symbols import symbol_svg
from wafer_viewer.draw.number_format import number, with_unit
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.inspection.defect import Defect, DefectClass, Inspection
from wafer_viewer.session.state.inspection_state import InspectionState

TINY_PER_MM2 = 1e-3


REFERENCES = {
    "dies": "compared with the median of the dies",
    "golden": "compared with the golden die",
    "form": "compared with the fitted form",
}
JUDGED = {"open": "open", "real": "real defect", "nuisance": "not a defect"}


def sign_of(kind: DefectClass, side_px: int = 14) -> str:
    """Return the symbol of a class, with its colour and shape."""
    return symbol_svg(KINDS[kind].shape, KINDS[kind].colour, side_px)


def size_text(defect: Defect) -> str:
    """Format the length of a defect; a dash if its size is not resolved."""
    return with_unit(defect.major.value_um, 0 if defect.major.value_um >= 100 else 1) if defect.size_resolved else "—"


def below(defect: Defect) -> str:
    """Describe die, position and proposed class of a defect."""
    where = f"Die {defect.die}" if defect.die else "Outside of the dies"
    place = f"x {number(defect.center.x_um, 1)}, y {with_unit(defect.center.y_um, 1)}"
    own = defect.judged_kind is None
    by = f"proposed with {number(defect.confidence, 2)}" if own else f"proposed: {KINDS[defect.kind].title.lower()}"
    return f"{where} · {place} · {by}"


def said(defect: Defect) -> str:
    """Describe score and reasons of detection and classification."""
    repeats = ("on every die: compare with a golden die",) if defect.repeats else ()
    small = () if defect.size_resolved else ("detected, size not resolved",)
    score = f"{number(defect.score, 1)} times the local noise"
    return " · ".join((score, *small, *repeats, *defect.reasons))


def per_mm2(count: float | None) -> str:
    """Format an expected density per mm²; a sentence for None."""
    if count is None:
        return "not known before an inspection"
    return f"under {number(TINY_PER_MM2, 3)} per mm²" if count < TINY_PER_MM2 else f"{number(count, 3)} per mm²"


def summary(state: InspectionState) -> str:
    """Return warnings on the inspection, as HTML: failure, outdated surface, uninspected areas."""
    inspection = state.inspection
    problem = html.note("attention", "Inspection failed", state.problem) if state.problem else ""
    if inspection is None:
        return problem
    stale = (
        html.note(
            "attention",
            "The surface has been reconstructed since",
            "Inspect again: places and heights may have changed.",
        )
        if state.stale
        else ""
    )
    return problem + stale + unknown(inspection)


def facts(inspection: Inspection) -> str:
    """Return area, density, reference, threshold, expected false detections and notes of an inspection, as HTML."""
    return "".join(f'<div class="wv-sub">{html.safe(html.with_micro_sign(line))}</div>' for line in _facts(inspection))


def unknown(inspection: Inspection) -> str:
    """Return a warning on dies and areas not inspected; empty if everything was inspected."""
    blind = [die for die in inspection.dies if die.state not in ("whole", "missing")]
    told = [f"{n} {'die' if n == 1 else 'dies'} {state}" for state, n in Counter(d.state for d in blind).items()]
    if inspection.unmeasured_mm2 > 0:
        told.append(f"{number(inspection.unmeasured_mm2, 2)} mm² unmeasured")
    if not told:
        return ""
    said = f"{', '.join(told)}: these parts were not inspected."
    return f'<div class="wv-blind">{html.note("attention", "Not all of it was inspected", said)}</div>'


def nothing_found(inspection: Inspection) -> str:
    """Return the placeholder of an empty defect list."""
    if inspection.inspected_mm2 <= 0:
        return html.empty("Nothing could be inspected:", "this does not mean that the wafer is clean.")
    clean = sum(die.word == "clean" for die in inspection.dies)
    dies = "the one die" if clean == 1 else f"the {clean} dies"
    where = f"on {dies} inspected whole." if clean else f"on {number(inspection.inspected_mm2, 2)} mm²."
    return html.empty("No defect was found", where)


def judged(inspection: Inspection) -> str:
    """Return the number of judged defects; empty without defects."""
    n = sum(defect.judgement != "open" for defect in inspection.defects)
    return f"{n} of {len(inspection.defects)} judged" if inspection.defects else ""


def classes(defect: Defect) -> str:
    """Return the class buttons with their keys, the current class marked."""
    now = defect.seen_as
    tiles = (
        f'<span class="{"on" if kind == now else ""}" aria-pressed="{str(kind == now).lower()}" '
        f"{html.pick('defect-class', kind)}><kbd>{look.key}</kbd>{sign_of(kind)} {look.title}</span>"
        for kind, look in KINDS.items()
    )
    return html.head("Class", "keys 1 – 9") + f'<div class="wv-classes">{"".join(tiles)}</div>'


def _facts(inspection: Inspection) -> list[str]:
    found, area = len(inspection.found), inspection.inspected_mm2
    density = f", {number(found / area, 2)} per mm²" if area > 0 else ""
    words = {True: "SIMULATED · ", False: ""}[inspection.simulated]
    return [
        f"{words}{found} on {number(area, 2)} mm²{density} · {REFERENCES[inspection.reference]}",
        f"Over {number(inspection.threshold_sigma, 1)} times the noise; expected to be false by noise alone: "
        f"{per_mm2(inspection.expected_false_per_mm2)}",
        *inspection.notes,
    ]
