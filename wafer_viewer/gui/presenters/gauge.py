"""HTML of the Gauge check panel: verdict, result, repeats, certificate, conditions. Pure functions."""

from __future__ import annotations

from datetime import date, datetime

import viser

from wafer_viewer.draw.number_format import THIN, digits_of_u, number, value_and_u, with_unit
from wafer_viewer.gui.presenters.verdict import LOOKS
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.gauge.gauge_check import Certificate, GaugeCheck, GaugeRepeat
from wafer_viewer.model.measurement.step import StepHeight
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.region import Region

SOON_DAYS = 30
"""A certificate that expires within this many days gets a warning."""
_MICRO = f"{THIN}µm"


def day_and_time(at: str, day_too: bool = True) -> str:
    """Format an ISO 8601 time as ``21 Nov 09:37``; return other text unchanged."""
    try:
        when = datetime.fromisoformat(at)
    except ValueError:
        return at
    return f"{when.day} {when:%b} {when:%H:%M}" if day_too else f"{when:%H:%M}"


def day(of: date) -> str:
    """Format a date as ``14 Mar 2027``."""
    return f"{of.day} {of:%b} {of.year}"


def verdict_card(check: GaugeCheck) -> str:
    """Return the verdict in large type, then error, limit and En, then the reason."""
    word, sign, tone = LOOKS[check.verdict]
    simulated = '<em class="wv-sim">SIMULATED</em>' if check.simulated else ""
    size = ' class="long"' if len(word) > 6 else ""
    told = html.safe(html.with_micro_sign(check.why)).replace(" µm", _MICRO)
    why = f'<p class="wv-gauge-why">{told}</p>'
    return (
        f'<div class="wv-verdict wv-gauge {tone}" role="status" aria-label="Verdict">'
        f"<div{size}>{html.icon(sign, 46)}<b>{word}</b>{simulated}</div><p>{_in_short(check)}</p>{why}</div>"
    )


def result(check: GaugeCheck) -> str:
    """Return certified step, measured step and error, each with its U, all with the same number of decimals."""
    warm = check.terms.temperature_c
    certified = f"Certificate at {number(warm, 1)}{THIN}°C" if warm is not None else "Certificate"
    measured = f"Measured, mean of {check.n}" if check.n > 1 else "Measured"
    digits = _digits(check.height, check.reference, check.deviation)
    rows = [
        _line(certified, check.reference, digits),
        _line(measured, check.height, digits),
        _line("Error", check.deviation, digits, signed=True, look="strong"),
    ]
    en = f'<div class="wv-lab">{html.safe(html.with_micro_sign(check.en_why))}</div>' if check.en_why else ""
    return html.head("Result", "k = 2") + html.table(["", "Step, µm", "U, µm"], rows, " nn") + en


def repeats(taken: tuple[GaugeRepeat, ...], check: GaugeCheck | None, may_drop: bool) -> str:
    """Return the table of repeats with n, s and range; a click on a cross removes one."""
    if not taken:
        return ""
    rows = [_repeat(k, repeat, may_drop) for k, repeat in enumerate(taken)]
    spread = ""
    if check is not None and check.s_um is not None and check.range_um is not None:
        spread = f" · s {number(check.s_um, 3)} · range {number(check.range_um, 3)}{_MICRO}"
    return html.head("Repeats", f"n {len(taken)}{spread}") + html.table(["Scan", "Taken", "Step, µm", ""], rows, " nn")


def certificate(paper: Certificate | None, today: date) -> str:
    """Return the certificate: blocks, step with U, laboratory, expiry date."""
    if paper is None:
        return html.head("Certificate") + html.empty(
            "No certificate is loaded.", "Load its file, or type it in: step, U, serial numbers, valid until."
        )
    step = paper.step
    digits = digits_of_u(step.expanded_um or 0.1)
    pairs = [
        ("Blocks", " / ".join(paper.serials)),
        ("Step", f"{number(step.value_um, max(3, digits))} ± {number(step.expanded_um, max(3, digits))}{_MICRO}"),
        ("Nominal", with_unit(paper.step_nominal_um, 1)),
        ("Laboratory", paper.laboratory),
        ("Number", paper.number),
    ]
    note = f'<div class="wv-lab" style="margin-top:4px">{html.safe(paper.note)}</div>' if paper.note else ""
    until = "expired" if paper.expires < today else "valid until"
    head = html.head("Certificate", f"{until} {day(paper.expires)}")
    return head + html.pairs(pairs) + note + _runs_out(paper, today)


def conditions(step: StepHeight | None, check: GaugeCheck | None, upper: Region | None, lower: Region | None) -> str:
    """Return the conditions of the measurement: faces, points, tilt, source of the z scale."""
    pairs: list[tuple[str, str]] = []
    if upper is not None and lower is not None:
        pairs.append(("Faces, upper · lower", f"{_size(upper)} · {_size(lower)}{_MICRO}"))
    if step is not None:
        if step.at_joint is not None:
            pairs.append(("Step at the joint", with_unit(step.at_joint.value_um, 3)))
        pairs.append(("Relative tilt of the blocks", with_unit(step.relative_tilt_mrad, 2, "mrad")))
        pairs.append(("Points, upper · lower", f"{number(step.upper_points, 0)} · {number(step.lower_points, 0)}"))
        pairs.append(("Sq, upper · lower", f"{number(step.upper_sq_um, 2)} · {number(step.lower_sq_um, 2)}{_MICRO}"))
    if check is not None and check.repeats[-1].calibration is not None:
        made = check.repeats[-1].calibration
        pairs.append(("z scale from", f"{made.against}, {day(date.fromisoformat(made.made))}"))
    return html.head("Conditions") + html.pairs(pairs) if pairs else ""


def stored_check(check: GaugeCheck) -> str:
    """Return a stored check as a result: verdict, result, repeats, certificate."""
    word, _, tone = LOOKS[check.verdict]
    signed = f"signed by {check.signed_by}, {day_and_time(check.at)}" if check.signed_by else "not signed"
    head = f'<div><b style="color:var(--{tone})">{word}</b> · {html.safe(signed)}</div>'
    paper = check.certificate
    blocks = [("Blocks", " / ".join(paper.serials)), ("Certificate", f"{paper.number}, {paper.laboratory}")]
    return head + result(check) + repeats(check.repeats, check, may_drop=False) + html.pairs(blocks)


def rejected_scan_note(sentence: str, has_others: bool) -> str:
    """Return a note why the open scan cannot count; other repeats remain valid."""
    sign = html.icon(viser.Icon.HAND_STOP, 18)
    if has_others:
        return html.note("attention", "This scan cannot be a repeat", sentence, sign=sign)
    return html.note("fault", "No check", sentence, sign=sign)


def scene_step_label(label: str, length: Length) -> str:
    """Return the step in large type for the scene."""
    value, u = value_and_u(length.value_um, length.expanded_um, 3)
    beside = f" ± {u}{_MICRO}" if length.expanded_um is not None else _MICRO
    word = "" if length.expanded_um is not None else f'<div class="wv-lab">{html.safe(_no_u(length))}</div>'
    return (
        f'<div class="wv-glass wv-gauge-glass"><div class="wv-lab">{html.safe(label)}</div>'
        f"<b>{value}</b><span>{beside}</span>{word}</div>"
    )


def _in_short(check: GaugeCheck) -> str:
    value, _ = value_and_u(check.deviation.value_um, check.deviation.expanded_um, 3, signed=True)
    parts = [f"Error <strong>{value}{_MICRO}</strong>"]
    if check.terms.limit_um is not None:
        parts.append(f"limit ± {number(check.terms.limit_um, 2)}{_MICRO}")
    if check.en is not None:
        parts.append(f"<i>E</i><sub>n</sub> <strong>{number(check.en, 2)}</strong>")
    return " · ".join(parts)


def _line(name: str, length: Length, digits: int, signed: bool = False, look: str = "") -> str:
    u = number(length.expanded_um, digits) if length.expanded_um is not None else f"<small>{_no_u(length)}</small>"
    return html.row([html.safe(name), number(length.value_um, digits, signed=signed), u], " nn", look=look)


def _digits(*lengths: Length) -> int:
    """Return the decimals that show the smallest U to two significant digits, at most 3 (1 nm)."""
    told = [digits_of_u(length.expanded_um) for length in lengths if length.expanded_um]
    return min(3, max(told, default=3))


def _no_u(length: Length) -> str:
    return "uncalibrated" if length.status == "uncalibrated" else "U not evaluated"


def _repeat(k: int, repeat: GaugeRepeat, may_drop: bool) -> str:
    name = repeat.dataset.removesuffix(".wafer")
    away = f'<span class="wv-act" title="Remove" aria-label="Take repeat {k + 1} off" {html.pick("gauge-drop", k)}>'
    cross = f"{away}{html.icon(viser.Icon.X, 14)}</span>" if may_drop else ""
    cut = f'<span class="wv-cut wv-short" title="{html.safe(name)}">{html.safe(name)}</span>'
    value, _ = value_and_u(repeat.height.value_um, repeat.height.expanded_um, 3)
    return html.row([cut, html.safe(day_and_time(repeat.taken)), value, cross], " nn")


def _runs_out(paper: Certificate, today: date) -> str:
    left = (paper.expires - today).days
    if left < 0 or left > SOON_DAYS:
        return ""
    return html.note("attention", f"It expires in {left} day{'' if left == 1 else 's'}", "Have the blocks recertified.")


def _size(face: Region) -> str:
    x0, y0, x1, y1 = face.bounds_um
    return f"{number(x1 - x0, 0)} × {number(y1 - y0, 0)}"
