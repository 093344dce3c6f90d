"""What the page says of a pixel's height: the answer in large type, every gate's verdict, the rivals. Pure."""

from __future__ import annotations

import viser

from wafer_viewer.draw.numbers import NOTHING, number, share, with_unit
from wafer_viewer.gui import html
from wafer_viewer.model.evidence import FocusCurve, Verdict

MEASURES = {"tenengrad": "Tenengrad", "sml": "SML", "glv": "GLV"}
"""Focus measures as they are written; others by their own name with spaces."""


def closing(word: str = "Close") -> str:
    """The way back, for the head of a panel."""
    told = f'class="wv-action" title="Close · Esc" aria-label="Close" {html.pick("why-close")}'
    return f"<span {told}>{html.icon(viser.Icon.X)}{word}</span>"


def place(at_um: tuple[float, float] | None) -> str:
    """A place on the stage, as text."""
    return "" if at_um is None else f"x {number(at_um[0], 1)}, y {with_unit(at_um[1], 1)}"


def where(curve: FocusCurve) -> str:
    """The pixel's place, as text."""
    return f"{place((curve.x_um, curve.y_um))} · field {curve.field}, row {curve.row}, column {curve.col}"


def answer(curve: FocusCurve) -> str:
    """The card with the height, or the reason why there is none."""
    if curve.height_um is None:
        peak = f"no height; the peak is at {with_unit(curve.peak_z_um, 2, signed=True)}"
        return _card("Not measured", html.safe(_capital(curve.origin)), "", peak, "color:var(--attention)", 24)
    trust = f"{html.safe(curve.origin)}, confidence {number(curve.confidence, 2)}"
    return _card("Height, before smoothing", number(curve.height_um, 2, signed=True), "µm", trust, "", 40)


def verdicts(curve: FocusCurve) -> str:
    """Every gate in a row: its question, whether it was passed, score and limit."""
    units = {v.unit for v in curve.verdicts if v.unit}
    common = next(iter(units)) if len(units) == 1 else ""
    rows = [_row(v, "" if common else v.unit) for v in curve.verdicts]
    heads = ("", "Question", "Score", "Limit")
    return html.head("What the gates found", common and f"in {common}") + html.table(heads, rows, "  nn")


def rivals(curve: FocusCurve) -> str:
    """The other maxima of the focus curve."""
    if not curve.rivals:
        return ""
    rows = [
        (with_unit(rival.z_um, 2, signed=True), f"{share(rival.share, 0 if rival.share >= 0.1 else 1)} of the peak")
        for rival in curve.rivals
    ]
    return html.head("Rivals of the peak") + html.pairs(rows)


def source(curve: FocusCurve) -> str:
    """How the focus was measured, as text."""
    measure = MEASURES.get(curve.focus_measure, _capital(curve.focus_measure.replace("_", " ")))
    simulated = "SIMULATED · " if curve.simulated else ""
    return f"{simulated}{measure}, window {curve.window} × {curve.window} px, {len(curve.z_um)} frames"


def _row(verdict: Verdict, unit: str) -> str:
    icon, tone, word = _sign(verdict)
    said = " · ".join(text for text in (word, unit and f"in {unit}", verdict.note) if text)
    sign = f'<span style="color:var(--{tone})" aria-hidden="true">{html.icon(icon, 17)}</span>'
    question = f'{html.safe(verdict.question)}<small style="color:var(--{tone})">{html.safe(said)}</small>'
    return html.row((sign, question, _figure(verdict.score), _figure(verdict.limit)), "  nn")


def _sign(verdict: Verdict) -> tuple[object, str, str]:
    """Icon, tone and word: never colour alone."""
    if verdict.limit is None and verdict.passed:
        return viser.Icon.MINUS, "ink3", "gate is off"
    if verdict.passed:
        return viser.Icon.CHECK, "good", "passed"
    return viser.Icon.X, "fault", "not passed"


def _figure(value: float | None) -> str:
    return NOTHING if value is None else number(value, 2)


def _card(label: str, value: str, unit: str, below: str, style: str, size_px: int) -> str:
    unit_html = f'<span class="wv-unit"> {unit}</span>' if unit else ""
    return (
        f'<div class="wv-answer"><div class="wv-lab">{label}</div>'
        f'<div class="wv-big" style="font-size:{size_px}px;white-space:normal;{style}">{value}{unit_html}</div>'
        f'<div style="color:var(--ink2)">{below}</div></div>'
    )


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
