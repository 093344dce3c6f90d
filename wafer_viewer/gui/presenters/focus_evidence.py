"""HTML of a pixel's focus evidence: height, verdict of every gate, rival maxima. Pure functions."""

from __future__ import annotations

from collections.abc import Callable

import viser

from wafer_viewer.draw.number_format import NOTHING, number, share, with_unit
from wafer_viewer.gui.presenters.recipe import FOCUS
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.surface.focus_curve import FocusCurve, Verdict

MEASURES = {key: name for name, key in FOCUS.items()}
"""Display names of focus measures; others are shown by their own name with spaces."""
GATE_IS_OFF = "gate is off"


def _times(powers: float) -> str:
    """Format a ratio of the focus measure, given as a power of two: ``× 3.1``."""
    factor = 2.0 ** min(powers, 60.0)
    return f"× {number(factor, 2 if factor < 10 else 1 if factor < 100 else 0)}"


FIGURES: dict[str, tuple[str, Callable[[float], str]]] = {
    "powers of two": ("over", _times),
    "um": ("up to", lambda um: with_unit(um, 2)),
    "share of the window": ("up to", share),
    "1 at an end": ("", lambda _: NOTHING),
}
"""By the unit of a gate: word before its limit, and format of score and limit. Other units appear below the name."""


def close_action(word: str = "Close") -> str:
    """Return the Close action for the head of a panel."""
    told = f'class="wv-action" title="Close · Esc" aria-label="Close" {html.pick("why-close")}'
    return f"<span {told}>{html.icon(viser.Icon.X)}{word}</span>"


def format_position(at_um: tuple[float, float] | None) -> str:
    """Format a stage position in µm; empty for None."""
    return "" if at_um is None else f"x {number(at_um[0], 1)}, y {with_unit(at_um[1], 1)}"


def pixel_position_text(curve: FocusCurve) -> str:
    """Format stage position, field, row and column of the pixel."""
    return f"{format_position((curve.x_um, curve.y_um))} · field {curve.field}, row {curve.row}, column {curve.col}"


def answer(curve: FocusCurve) -> str:
    """Return the card with the height, or with the reason why there is none."""
    if curve.height_um is None:
        peak = f"no height; the peak is at {with_unit(curve.peak_z_um, 2, signed=True)}"
        return _card("Not measured", html.safe(_capital(curve.origin)), "", peak, "color:var(--attention)", 24)
    trust = f"{html.safe(curve.origin)}, confidence {number(curve.confidence, 2)}"
    return _card("Measured height", number(curve.height_um, 2, signed=True), "µm", trust, "", 40)


def verdicts(curve: FocusCurve) -> str:
    """Return the table of gates: question, result, score and limit."""
    ratios = any(v.unit == "powers of two" for v in curve.verdicts)
    heads = ("", "Question", "Score", "Limit")
    beside = "×: the peak over the rest of the curve" if ratios else ""
    return html.head("What the gates found", beside) + html.table(heads, map(_row, curve.verdicts), "  nn")


def rivals(curve: FocusCurve) -> str:
    """Return the table of the other maxima of the focus curve; empty if there are none."""
    if not curve.rivals:
        return ""
    rows = [
        (with_unit(rival.z_um, 2, signed=True), f"{share(rival.share, 0 if rival.share >= 0.1 else 1)} of the peak")
        for rival in curve.rivals
    ]
    return html.head("Rivals of the peak") + html.pairs(rows)


def focus_measurement_text(curve: FocusCurve) -> str:
    """Describe the focus measurement: measure, window, number of frames."""
    measure = MEASURES.get(curve.focus_measure, _capital(curve.focus_measure.replace("_", " ")))
    simulated = "SIMULATED · " if curve.simulated else ""
    return f"{simulated}{measure}, window {curve.window} × {curve.window} px, {len(curve.z_um)} frames"


def _row(verdict: Verdict) -> str:
    icon, tone, word = _sign(verdict)
    before, figure = FIGURES.get(verdict.unit, ("", lambda value: number(value, 2)))
    unit = f"in {verdict.unit}" if verdict.unit and verdict.unit not in FIGURES else ""
    note = "" if verdict.note.rstrip(".").casefold().endswith(GATE_IS_OFF) else verdict.note
    said = " · ".join(text for text in (word, unit, html.with_micro_sign(note)) if text)
    sign = f'<span style="color:var(--{tone})" aria-hidden="true">{html.icon(icon, 17)}</span>'
    question = f'{html.safe(verdict.question)}<small style="color:var(--{tone})">{html.safe(said)}</small>'
    score = NOTHING if verdict.score is None else figure(verdict.score)
    limit = NOTHING if verdict.limit is None else figure(verdict.limit)
    bound = f'<span class="dim">{before}</span> {limit}' if before and limit != NOTHING else limit
    return html.row((sign, question, score, bound), "  nn")


def _sign(verdict: Verdict) -> tuple[object, str, str]:
    """Return icon, tone and word of a verdict, so that colour is never the only cue."""
    if verdict.limit is None and verdict.passed:
        return viser.Icon.MINUS, "ink3", GATE_IS_OFF
    if verdict.passed:
        return viser.Icon.CHECK, "good", "passed"
    return viser.Icon.X, "fault", "not passed"


def _card(label: str, value: str, unit: str, below: str, style: str, size_px: int) -> str:
    unit_html = f'<span class="wv-unit"> {unit}</span>' if unit else ""
    return (
        f'<div class="wv-answer"><div class="wv-lab">{label}</div>'
        f'<div class="wv-big" style="font-size:{size_px}px;white-space:normal;{style}">{value}{unit_html}</div>'
        f'<div style="color:var(--ink2)">{below}</div></div>'
    )


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
