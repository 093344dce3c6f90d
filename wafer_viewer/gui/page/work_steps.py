"""Steps of work: titles, whether each is possible, and whether it is done."""

from __future__ import annotations

from typing import get_args

from wafer_viewer.gui.state.view_state import Step
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.job import keys_under_review
from wafer_viewer.session.state.snapshot import Snapshot

STEPS: tuple[Step, ...] = get_args(Step)
TITLES: dict[Step, str] = {
    "plan": "Plan",
    "acquire": "Acquire",
    "surface": "Surface",
    "measure": "Measure",
    "gauge": "Gauge check",
    "review": "Review",
    "report": "Report",
}


def possible(step: Step, snapshot: Snapshot) -> bool:
    """Return whether a step is available."""
    data = snapshot.dataset
    match step:
        case "plan" | "gauge":
            return True
        case "acquire":
            lacks = data is not None and (not data.finished or bool(data.damaged))
            return snapshot.scanning or snapshot.scan is not None or lacks
        case "surface":
            return data is not None and (data.finished or bool(data.stamps))
        case "measure" | "review" | "report":
            return snapshot.surface is not None


def why_not(step: Step, snapshot: Snapshot) -> str | None:
    """Return why a step is not available yet, or None if it is."""
    if possible(step, snapshot):
        return None
    data = snapshot.dataset
    if step == "acquire":
        return "no scan runs, and the open dataset lacks no frame." if data is not None else "no scan runs."
    if data is None:
        return "no dataset is open."
    has_heights = bool(data.stamps)
    return "no field has heights." if step == "surface" or not has_heights else "the fields are not stitched."


def done(step: Step, snapshot: Snapshot) -> bool:
    """Return whether a step is done and has a tick."""
    data = snapshot.dataset
    return (
        data is not None
        and {
            "plan": True,
            "acquire": data.finished and not data.damaged and not snapshot.scanning,
            "surface": bool(_under_review(snapshot)),
            "measure": bool(snapshot.notebook.book.judgements),
            "gauge": any(isinstance(finding, GaugeCheck) for finding in snapshot.findings),
            "review": all_judged(snapshot),
            "report": False,
        }[step]
    )


def all_judged(snapshot: Snapshot) -> bool:
    """Return whether all results, verdict features and defects are accepted or rejected; False without any."""
    keys, defects = _under_review(snapshot), snapshot.inspection.defects
    noted = snapshot.notebook.book.judged(keys) == len(keys)
    return bool(keys or defects) and noted and all(defect.judgement != "open" for defect in defects)


def _under_review(snapshot: Snapshot) -> tuple[str, ...]:
    return keys_under_review(snapshot.operating.verdict, snapshot.findings)
