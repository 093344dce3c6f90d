"""HTML of a check against gauge blocks: verdict, repeats, certificate, budget. Pure functions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import date, datetime

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import THIN, digits_of_u, number, plural, value_and_u, with_unit
from wafer_viewer.gui.presenters.verdict import LOOKS
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.gauge import (
    Capability,
    Certificate,
    GaugeCheck,
    GaugeLine,
    GaugeRepeat,
    Role,
    ScaleCorrection,
)
from wafer_viewer.model.measurement.measurements import StepHeight
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.region import Region

SOON_DAYS = 30
"""A certificate that expires within this many days gets a warning."""
_MICRO = f"{THIN}µm"


def day_and_time(moment: str, day_too: bool = True) -> str:
    """Format an ISO 8601 time as ``21 Nov 09:37``; return other text unchanged."""
    try:
        when = datetime.fromisoformat(moment)
    except ValueError:
        return moment
    return f"{when.day} {when:%b} {when:%H:%M}" if day_too else f"{when:%H:%M}"


def day(when: date) -> str:
    """Format a date as ``14 Mar 2027``."""
    return f"{when.day} {when:%b} {when.year}"


def verdict_card(check: GaugeCheck) -> Markup:
    """Return the verdict in large type, then error, limit and En, then the reason."""
    word, sign, tone = LOOKS[check.verdict]
    simulated = Markup('<em class="wv-sim">SIMULATED</em>') if check.simulated else Markup()
    size = Markup(' class="long"') if len(word) > 6 else Markup()
    reason = html.typeset(check.why).replace(" µm", _MICRO)
    why = Markup('<p class="wv-gauge-why">{}</p>').format(reason)
    return Markup(
        '<div class="wv-verdict wv-gauge {tone}" role="status" aria-label="Verdict">'
        "<div{size}>{icon}<b>{word}</b>{simulated}</div><p>{in_short}</p>{why}</div>"
    ).format(
        tone=tone,
        size=size,
        icon=html.icon(sign, 46),
        word=word,
        simulated=simulated,
        in_short=_in_short(check),
        why=why,
    )


def result(check: GaugeCheck) -> Markup:
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
    en = Markup('<div class="wv-lab">{}</div>').format(html.typeset(check.en_why)) if check.en_why else Markup()
    return html.head("Result", "U covers 95 %") + html.table(["", "Step, µm", "U, µm"], rows, " nn") + en


def repeats(taken: tuple[GaugeRepeat, ...], check: GaugeCheck | None, may_drop: bool) -> Markup:
    """Return the table of repeats with n, s and range; a click on a cross removes one."""
    if not taken:
        return Markup()
    rows = [_repeat(k, repeat, may_drop) for k, repeat in enumerate(taken)]
    spread = ""
    if check is not None and check.s_um is not None and check.range_um is not None:
        spread = f" · s {number(check.s_um, 3)} · range {number(check.range_um, 3)}{_MICRO}"
    return html.head("Repeats", f"n {len(taken)}{spread}") + html.table(["Scan", "Taken", "Step, µm", ""], rows, " nn")


def certificate(paper: Certificate | None, today: date) -> Markup:
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
    note = Markup('<div class="wv-lab" style="margin-top:4px">{}</div>').format(paper.note) if paper.note else Markup()
    until = "expired" if paper.expires < today else "valid until"
    head = html.head("Certificate", f"{until} {day(paper.expires)}")
    return head + html.pairs(pairs) + note + _runs_out(paper, today)


def conditions(step: StepHeight | None, check: GaugeCheck | None, upper: Region | None, lower: Region | None) -> Markup:
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
    return html.head("Conditions") + html.pairs(pairs) if pairs else Markup()


def stored_check(check: GaugeCheck) -> Markup:
    """Return a stored check as a result: verdict, result, repeats, certificate."""
    word, _, tone = LOOKS[check.verdict]
    signed = f"signed by {check.signed_by}, {day_and_time(check.at)}" if check.signed_by else "not signed"
    head = Markup('<div><b style="color:var(--{})">{}</b> · {}</div>').format(tone, word, signed)
    paper = check.certificate
    blocks = [("Blocks", " / ".join(paper.serials)), ("Certificate", f"{paper.number}, {paper.laboratory}")]
    return head + result(check) + repeats(check.repeats, check, may_drop=False) + html.pairs(blocks)


def rejected_scan_note(sentence: str, has_others: bool) -> Markup:
    """Return a note why the open scan cannot count; other repeats remain valid."""
    sign = html.icon(viser.Icon.HAND_STOP, 18)
    if has_others:
        return html.note("attention", "This scan cannot be a repeat", sentence, sign=sign)
    return html.note("fault", "No check", sentence, sign=sign)


def scene_step_label(label: str, length: Length) -> Markup:
    """Return the step in large type for the scene."""
    value, u = value_and_u(length.value_um, length.expanded_um, 3)
    uncertainty = f" ± {u}{_MICRO}" if length.expanded_um is not None else _MICRO
    word = Markup() if length.expanded_um is not None else Markup('<div class="wv-lab">{}</div>').format(_no_u(length))
    return Markup(
        '<div class="wv-glass wv-gauge-glass"><div class="wv-lab">{label}</div>'
        "<b>{value}</b><span>{uncertainty}</span>{word}</div>"
    ).format(label=label, value=value, uncertainty=uncertainty, word=word)


def _in_short(check: GaugeCheck) -> Markup:
    value, _ = value_and_u(check.deviation.value_um, check.deviation.expanded_um, 3, signed=True)
    parts = [Markup("Error <strong>{}{}</strong>").format(value, _MICRO)]
    if check.terms.limit_um is not None:
        parts.append(Markup("limit ± {}{}").format(number(check.terms.limit_um, 2), _MICRO))
    if check.en is not None:
        parts.append(Markup("<i>E</i><sub>n</sub> <strong>{}</strong>").format(number(check.en, 2)))
    return Markup(" · ").join(parts)


def _line(name: str, length: Length, digits: int, signed: bool = False, look: str = "") -> Markup:
    u = (
        number(length.expanded_um, digits)
        if length.expanded_um is not None
        else Markup("<small>{}</small>").format(_no_u(length))
    )
    return html.row([name, number(length.value_um, digits, signed=signed), u], " nn", look=look)


def _digits(*lengths: Length) -> int:
    """Return the decimals that show the smallest U to two significant digits, at most 3 (1 nm)."""
    digits = [digits_of_u(length.expanded_um) for length in lengths if length.expanded_um]
    return min(3, max(digits, default=3))


def _no_u(length: Length) -> str:
    return "uncalibrated" if length.status == "uncalibrated" else "U not evaluated"


def _repeat(k: int, repeat: GaugeRepeat, may_drop: bool) -> Markup:
    name = repeat.dataset.removesuffix(".wafer")
    pick = html.command_pick("gauge-drop", k)
    away = Markup('<span class="wv-act" title="Remove" aria-label="Take repeat {} off" {}>').format(k + 1, pick)
    cross = Markup("{}{}</span>").format(away, html.icon(viser.Icon.X, 14)) if may_drop else Markup()
    cut = Markup('<span class="wv-cut wv-short" title="{}">{}</span>').format(name, name)
    value, _ = value_and_u(repeat.height.value_um, repeat.height.expanded_um, 3)
    return html.row([cut, day_and_time(repeat.taken), value, cross], " nn")


def _runs_out(paper: Certificate, today: date) -> Markup:
    days_left = (paper.expires - today).days
    if days_left < 0 or days_left > SOON_DAYS:
        return Markup()
    return html.note("attention", f"It expires in {plural(days_left, 'day')}", "Have the blocks recertified.")


def _size(face: Region) -> str:
    x0, y0, x1, y1 = face.bounds_um
    return f"{number(x1 - x0, 0)} × {number(y1 - y0, 0)}"


_PARTS: dict[Role, str] = {
    "scale": "Of the measured step alone",
    "measurement": "Of the measured step and of the error",
    "reference": "Of the certified step",
}
"""Headings of the budget's parts, in display order."""
_DIGITS = 4


def budget(check: GaugeCheck) -> Markup:
    """Return the contributions grouped by role, and the three expanded uncertainties; empty without a budget."""
    if not check.budget:
        return Markup()
    rows = [row for role in _PARTS for row in _part(role, [line for line in check.budget if line.of == role])]
    sums = (("U measured", check.height), ("U certificate", check.reference), ("U error", check.deviation))
    rows += [
        html.row([name, number(length.expanded_um, _DIGITS - 1)], " n", look="strong")
        for name, length in sums
        if length.expanded_um is not None
    ]
    return html.head("Uncertainty", "µm · lines k = 1, U covers 95 %") + html.table([], rows, " n")


def not_evaluated(check: GaugeCheck) -> Markup:
    """Return the list of contributions that U does not contain; empty if there are none."""
    if not check.not_evaluated:
        return Markup()
    items = Markup("").join(Markup("<li>{}</li>").format(html.typeset(item)) for item in check.not_evaluated)
    return html.head("Not evaluated") + Markup('<ul class="wv-left-out">{}</ul>').format(items)


def capability(result: Capability | None) -> Markup:
    """Return Cg and Cgk, or the reason why there are none."""
    if result is None:
        return Markup()
    pairs = [("Repeats", number(result.n, 0)), ("Tolerance of the product", with_unit(result.tolerance_um, 2))]
    if result.cg is not None and result.cgk is not None:
        word = "" if result.capable is None else " · capable" if result.capable else " · not capable"
        pairs.append(("Cg · Cgk", f"{number(result.cg, 2)} · {number(result.cgk, 2)}{word}"))
    words = " ".join(part for part in (result.why, result.variant) if part)
    below = html.remark(html.typeset(words))
    return html.head("Capability", "both 1.33 or more, over 25 scans") + html.pairs(pairs) + below


def correction(offered: ScaleCorrection | None) -> Markup:
    """Return the suggested z scale factor with advice; empty without a suggestion."""
    if offered is None:
        return Markup()
    by = with_unit(offered.changes_um, 3, signed=True)
    pairs = [("Certified over measured", number(offered.factor, 6)), ("The checked step would change by", by)]
    advice = html.remark(offered.advice, "margin:4px 0 6px")
    return html.head("z scale", "nothing changes automatically") + html.pairs(pairs) + advice


def _part(role: Role, lines: Sequence[GaugeLine]) -> list[Markup]:
    if not lines:
        return []
    together = math.sqrt(sum(line.u_um**2 for line in lines))
    head = html.row(
        [Markup("<b>{}</b>").format(_PARTS[role]), Markup("<b>{}</b>").format(number(together, _DIGITS))], " n"
    )
    return [head, *(html.row([_name(line.name), number(line.u_um, _DIGITS)], " n") for line in lines)]


def _name(name: str) -> Markup:
    titled = name if name.startswith("z ") else name[:1].upper() + name[1:]
    return Markup('<span class="wv-under">{}</span>').format(html.typeset(titled))
