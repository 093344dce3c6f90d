"""HTML of a surface: its name, recipe, stitching, comparisons, and the evidence of one pixel. Pure functions."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import NOTHING, THIN, digits_of_u, number, share, value_and_u, with_unit
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.surface.comparison import (
    FOUND_BY,
    Change,
    Comparison,
    ComparisonFace,
    Registration,
    SurfaceName,
    comparison_of,
)
from wafer_viewer.model.surface.field_poses import DOUBT_TITLES, Poses, RejectionReason
from wafer_viewer.model.surface.focus_curve import FocusCurve, Verdict
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.recipe import READY_RECIPES, Recipe
from wafer_viewer.session.state.snapshot import StitchingInfo

FACES: dict[ComparisonFace, tuple[str, str]] = {
    ComparisonFace.DIFFERENCE: ("Difference", "Second − first"),
    ComparisonFace.FIRST: ("First", "First surface"),
    ComparisonFace.SECOND: ("Second", "Second surface"),
    ComparisonFace.BESIDE: ("Both", "Both surfaces"),
}
"""Faces of a comparison: label of the choice, and name of what is shown."""
FACE_CHOICES = tuple((face, label) for face, (label, _) in FACES.items())
OUTDATED = "One of the surfaces has changed or was deleted: compare again."
SIDE_BY_SIDE = "The second stands to the right of the first, in the same colours and range."
LITTLE_OVERLAP = 0.5
"""Overlap fraction below which the page warns that little is compared."""
_UM3_PER_PL = 1e3
_LARGE_PL = 1e3


def pair_label(first: SurfaceName, second: SurfaceName) -> str:
    """Return the label of a pair of surfaces in the list."""
    if (first.path, first.result, first.field) == (second.path, second.result, second.field):
        return "Measured and filtered"
    return f"Result {second.result}" if first.path == second.path else second.words


def comparison_name(comparison: Comparison) -> str:
    """Return the name of a comparison in the list."""
    return pair_label(comparison.first, comparison.second)


def surfaces_sentence(comparison: Comparison) -> str:
    """Return a sentence that names the first and the second surface."""
    return f"First: {comparison.first.words}. Second: {comparison.second.words}."


def change_figures(change: Change) -> Markup:
    """Return the main figures: changed area in % and Sq of the difference in µm."""
    return html.columns(
        [
            html.figure("Changed", number(100 * change.changed_fraction, 1), "%", 26),
            html.figure("Sq of difference", number(change.sq_um, 2), "µm", 26),
        ]
    )


def change_numbers(change: Change) -> Markup:
    """Return the table of difference statistics."""
    rows = [
        ("Mean", with_unit(change.mean_um, 3, signed=True)),
        ("Lowest", with_unit(change.lowest_um, 2, signed=True)),
        ("Highest", with_unit(change.highest_um, 2, signed=True)),
        ("Counts as changed", f"beyond ±{with_unit(change.limit_um, 2)}"),
        ("Volume gained", volume(change.gained_um3)),
        ("Volume lost", volume(change.lost_um3)),
        ("Places compared", number(change.n_points, 0)),
    ]
    return html.head("Second − first") + html.pairs(rows)


def volume(um3: float) -> str:
    """Format a volume in pl, from 1000 pl on in nl."""
    pl = um3 / _UM3_PER_PL
    return with_unit(pl / _LARGE_PL, 2, "nl") if pl >= _LARGE_PL else with_unit(pl, 2, "pl")


def alignment(registration: Registration) -> Markup:
    """Return the table of registration parameters of the second surface, each with its U."""
    rows = [("Found", FOUND_BY[registration.by])] if registration.by == "same" else []
    if registration.by in ("images", "heights"):
        rows += [
            ("Shift x", _with_u(registration.x_um, registration.u_xy_um, "µm")),
            ("Shift y", _with_u(registration.y_um, registration.u_xy_um, "µm")),
            ("Turn", _with_u(registration.turn_mrad, registration.u_turn_mrad, "mrad")),
        ]
    if registration.levelled:
        rows += [
            ("Height", _with_u(registration.z_um, registration.u_z_um, "µm")),
            ("Tilt along x", _with_u(registration.tilt_x_mrad, registration.u_tilt_mrad, "mrad")),
            ("Tilt along y", _with_u(registration.tilt_y_mrad, registration.u_tilt_mrad, "mrad")),
            ("Residual, rms", with_unit(registration.residual_um, digits_of_u(registration.residual_um))),
        ]
    rows.append(("Share of the first compared", share(registration.overlap_fraction)))
    how = (
        Markup()
        if registration.by == "same"
        else Markup('<div class="wv-lab">Found {}; k = 2.</div>').format(FOUND_BY[registration.by])
    )
    return html.head("Alignment") + how + html.pairs(rows)


def warnings(comparison: Comparison, outdated: bool) -> Markup:
    """Return warnings: outdated surface, small overlap, missing or different calibration."""
    warnings = [OUTDATED] if outdated else []
    if comparison.registration.overlap_fraction < LITTLE_OVERLAP:
        warnings.append(
            f"Only {share(comparison.registration.overlap_fraction)} of the first surface lies on the second."
        )
    if not comparison.calibrated:
        warnings.append("Lengths are uncalibrated, or the calibrations differ.")
    return Markup("").join(
        Markup('<div class="wv-lab" style="margin:4px 0">{}</div>').format(text) for text in warnings
    )


def _with_u(value: float, expanded: float | None, unit: str) -> str:
    shown, u = value_and_u(value, expanded, signed=True)
    return f"{shown} {unit}" if expanded is None else f"{shown} ± {u} {unit}"


PARTS = {"all": "", "view": ", in view", "selection": ", selection"}


def surface_name(view: View) -> str:
    """Return the name of the surface part that statistics cover, such as ``Field 5, in view``."""
    compared = comparison_of(view.show)
    surface = (
        FACES[compared[1]][1] if compared is not None else f"Field {view.show}" if view.show else "Stitched surface"
    )
    return surface + PARTS[view.counted]


READY = {"Default": "default", "The paper's method": "paper"}
OWN = "Custom"
"""Name of a recipe that matches no preset."""
DRIFT = {"Correct": "correct", "Leave": "none"}
FOCUS = {measure.title: name for name, measure in focus_measures().items()}
WINDOW = {"From the data": "auto", **{f"{n} px": n for n in range(3, 27, 2)}}
PEAK = {"Centred": "centred", "Blur law": "blur_law", "Tent": "tent", "Gaussian": "gaussian", "Highest frame": "argmax"}
SECOND_WINDOW = {"Must agree": True, "Not tested": False}
EDGES = {"Measure the rims": "rims", "Only what agrees": "band", "Not tested": "none"}
SMOOTHING = {
    "Sigma filter": "sigma_filter",
    "Switching median": "switching_median",
    "Levy, guided": "guided",
    "Levy, literal": "literal",
    "None": "none",
}
OUTLIERS = {"Lattice": "lattice", "Cloud": "cloud", "None": "none"}
FILL = {"Small gaps": "small_gaps", "All gaps": "all", "None": "none"}
BELIEVES_ALL = "Every peak is accepted: neither the second window nor walls are tested."
_FLIES = ("literal", "guided")


def option_name(names: Mapping[str, Any], value: object) -> str:
    """Return the display name of an option."""
    return next(name for name, key in names.items() if key == value)


def ready_name(recipe: Recipe) -> str:
    """Return the display name of a recipe: its preset, else ``Custom``."""
    return next((name for name, key in READY.items() if READY_RECIPES[key] == recipe), OWN)


def accepts_all_peaks(recipe: Recipe) -> bool:
    """Return whether every peak is accepted, so that neither second window nor edges are tested."""
    return recipe.min_confidence == 0


def summary(recipe: Recipe) -> str:
    """Describe a recipe in one line."""
    return (
        f"{option_name(FOCUS, recipe.focus_measure)} · window {_px(recipe.window)} · {option_name(PEAK, recipe.peak)}"
    )


def chosen_by_data(requested: Recipe, settled: Recipe) -> list[tuple[str, str]]:
    """Return name and value of each setting that is auto in `requested` and fixed in `settled`, in order of use."""
    return [(name, text(settled)) for name, get, text in _AUTOMATIC if get(requested) == "auto" != get(settled)]


def notes(sentences: Iterable[str], sign: Any = viser.Icon.INFO_CIRCLE, tone: str = "") -> Markup:
    """Return the notes; those that differ only in numbers are folded into one. `tone`: '' or 'attention'."""
    kinds: dict[str, list[str]] = {}
    for sentence in sentences:
        kinds.setdefault(re.sub(r"\d[\d.]*", "0", sentence), []).append(sentence)
    lines = Markup("").join(_kind(group, sign) for group in kinds.values())
    return lines and Markup('<div class="wv-notes {}">{}</div>').format(tone, lines)


def _kind(group: list[str], sign: Any) -> Markup:
    first, *others = (_sentence(text) for text in group)
    if others:
        more = Markup("").join(Markup("<p>{}</p>").format(other) for other in others)
        first = Markup("<details><summary>{} <u>{} more like it</u></summary>{}</details>").format(
            first, len(others), more
        )
    return Markup("<div>{}<div>{}</div></div>").format(html.icon(sign, 15), first)


def _sentence(text: str) -> str:
    """Format a note: micro signs, multiplication signs, a full stop."""
    return re.sub(r"(?<![.\w])x(?=\d)", "× ", html.with_micro_sign(text)).rstrip(".") + "."


def _px(window: int | str) -> str:
    return "from the data" if isinstance(window, str) else with_unit(window, 0, "px")


def _figures(value: float | str) -> str:
    """Format a number to two significant digits."""
    return number(float(value), digits_of_u(float(value)))


def _flight(recipe: Recipe) -> str:
    scale = _figures(recipe.levy.alpha)
    return f"{scale} µm" if recipe.levy.mode == "literal" else f"{scale} × distance to the guide"


_AUTOMATIC: tuple[tuple[str, Callable[[Recipe], Any], Callable[[Recipe], str]], ...] = (
    ("Camera noise, gain", lambda r: r.noise.gain_counts, lambda r: f"{_figures(r.noise.gain_counts)} counts"),
    ("Camera noise, floor", lambda r: r.noise.floor_counts2, lambda r: f"{_figures(r.noise.floor_counts2)} counts²"),
    ("Window", lambda r: r.window, lambda r: _px(r.window)),
    ("Width of a focus curve", lambda r: r.focus_width_um, lambda r: with_unit(float(r.focus_width_um), 1)),
    ("Confidence from", lambda r: r.min_confidence, lambda r: number(float(r.min_confidence), 2)),
    (
        "Smoothing takes for noise",
        lambda r: None if r.levy.mode == "none" else r.levy.n_sigma,
        lambda r: f"up to {number(float(r.levy.n_sigma), 1)} σ",
    ),
    ("Scale of the Lévy flights", lambda r: r.levy.alpha if r.levy.mode in _FLIES else None, _flight),
    (
        "Rounds of smoothing",
        lambda r: None if r.levy.mode == "none" else r.levy.iterations,
        lambda r: number(float(r.levy.iterations), 0),
    ),
    (
        "Outlier threshold",
        lambda r: None if r.outliers.mode == "none" else r.outliers.floor_um,
        lambda r: f"over {with_unit(float(r.outliers.floor_um), 2)}",
    ),
)
"""Settings that may be auto: display name, getter (None if unused), formatter of the value."""


BY_STAGE = "Fields are placed by the stage alone: their overlaps were not compared."
SHOWN, LISTED = 6, 60
"""Number of rejected overlaps listed at first, and in total when unfolded."""
NAMED = 8
"""Largest number of fields named in a sentence."""
_PRACTICALLY = 0.999
_SURE = ((_PRACTICALLY, "practically sure"), (0.98, "sure"), (0.8, "likely"), (0.0, "open"))
"""Words for the probability of a chosen period, from which on; fields are placed by it from 98 % on."""
Rows = list[tuple[str, str]]


def stitching_numbers(info: StitchingInfo) -> Markup:
    """Return the main figures of the stitching: accepted overlaps, residual steps, uncertainties."""
    rows: Rows = [("Overlaps accepted", f"{number(info.n_believed, 0)} of {number(info.n_overlaps, 0)}")]
    if info.n_periodic:
        rows.append(("– of a repeating pattern", number(info.n_periodic, 0)))
    if info.period_probability is not None:
        rows.append(("– least sure of these", _percent(info.period_probability)))
    rows += [(f"– {words}", number(n, 0)) for words, n in info.doubts if n]
    if info.step_median_um is not None:
        rows.append(("Step left at a seam, median", _length(info.step_median_um)))
    if info.step_p95_um is not None:
        rows.append(("– 95 % are under", _length(info.step_p95_um)))
    rows += [
        ("Position of a field, U (k = 2)", _plus_minus(info.position_u_um)),
        ("Height of a field, U (k = 2)", _plus_minus(info.height_u_um)),
    ]
    return html.pairs(rows)


def how_sure(probability: float) -> str:
    """Return a probability in words and as a number: ``practically sure, over 99.9 %`` or ``likely, 92 %``."""
    words = next(words for least, words in _SURE if probability >= least)
    return f"{words}, {_percent(probability)}"


def _percent(probability: float) -> str:
    if probability > _PRACTICALLY:
        return f"over {100 * _PRACTICALLY:g}{THIN}%"
    return f"{100 * probability:.3g}{THIN}%"


def details(info: StitchingInfo) -> Markup:
    """Return the estimated stage errors, and the form components known only from the stage."""
    rows: Rows = [
        ("Field offset from the stage, rms", _length(info.moved_rms_um)),
        ("– largest", _length(info.moved_max_um)),
        ("Error of the stage, x and y", _length(info.stage_error_um)),
        ("– along z", _length(info.z_error_um)),
    ]
    table = Markup('<div class="wv-chosen">{}</div>').format(html.pairs(rows))
    form = [(name[:1].upper() + name[1:], _plus_minus(u)) for name, u in info.form]
    if form:
        head = Markup('<div class="wv-lab">Known only from the stage, U (k = 2) at the edge</div>')
        table += Markup('<div class="wv-chosen">{}{}</div>').format(head, html.pairs(form))
    return table


def cautions(info: StitchingInfo) -> Markup:
    """Return the warnings; an excluded field that a note already names is not listed again."""
    noted = " ".join(info.notes)
    unsaid = tuple(n for n in info.left_out if f"ield {n} " not in noted)
    sentences = [_left_out(unsaid)] if unsaid else []
    if info.n_groups > 1 and not info.n_by_stage:
        sentences.append(
            f"The fields fall into {info.n_groups} islands: no overlap joins them, so between islands "
            "positions and heights are the stage's."
        )
    return notes((*sentences, *info.notes), viser.Icon.ALERT_TRIANGLE, "attention")


def by_stage(info: StitchingInfo, n_fields: int) -> tuple[str, str]:
    """Return status text and notes on fields placed by the stage alone; both empty if there are none."""
    if not info.n_by_stage:
        return "", ""
    reasons = "; ".join(note for note in info.notes if "the stage" in note)
    if not info.n_believed:
        return "Stitched by the stage alone", reasons
    return f"{number(info.n_by_stage, 0)} of {number(n_fields, 0)} fields by the stage alone", reasons


def rejected_overlaps(poses: Poses, pixel_um: float) -> Markup:
    """Return the table of rejected overlaps, largest residual first, blank ones last; empty if there are none."""
    rows = _doubted_rows(poses, pixel_um)
    if not rows:
        return Markup()
    content = _table(("Fields", "Rejected because", "Offset, µm", "px"), rows[:SHOWN])
    if len(rows) > SHOWN:
        beyond = len(rows) - LISTED
        tail = (
            Markup('<div class="wv-lab">and {} with smaller offsets</div>').format(number(beyond, 0))
            if beyond > 0
            else Markup()
        )
        more = Markup("<summary><u>{} more</u></summary>").format(number(len(rows) - SHOWN, 0))
        content += Markup('<details class="wv-more">{}{}{}</details>').format(
            more, _table((), rows[SHOWN:LISTED]), tail
        )
    return Markup('<div class="wv-chosen">{}</div>').format(content)


def _table(heads: tuple[str, ...], rows: list[Markup]) -> Markup:
    """Return a table with the column widths shared by both tables."""
    return html.table(heads, rows, "  nn", widths_px=(74, None, 60, 46))


def _doubted_rows(poses: Poses, pixel_um: float) -> list[Markup]:
    shifts = poses.shifts
    off_um = np.hypot(shifts.residual_x_um, shifts.residual_y_um)
    rows = np.flatnonzero(~shifts.believed)
    blank = shifts.doubt[rows] == RejectionReason.BLANK
    order = np.lexsort((-np.nan_to_num(off_um[rows], nan=-1.0, posinf=-1.0), blank))
    return [_doubted_row(poses, row, float(off_um[row]), pixel_um) for row in rows[order].tolist()]


def _doubted_row(poses: Poses, row: int, off_um: float, pixel_um: float) -> Markup:
    shifts = poses.shifts
    first, second = (int(poses.numbers[k]) for k in (shifts.first[row], shifts.second[row]))
    doubt = RejectionReason(int(shifts.doubt[row]))
    off = None if doubt is RejectionReason.BLANK else off_um
    figures = [number(off, 2), number(None if off is None else off / pixel_um, 1)]
    why = DOUBT_TITLES[doubt]
    sure = float(poses.overlap_period_probability[row])
    if doubt is RejectionReason.AMBIGUOUS and np.isfinite(sure):
        why = f"{why}; the likeliest is {how_sure(sure)}"
    return html.row([f"{first}{THIN}–{THIN}{second}", why, *figures], "  nn")


def _left_out(fields: tuple[int, ...]) -> str:
    if len(fields) == 1:
        return f"Field {fields[0]} is left out: it matches none of its neighbours. Check its frames, or scan it again."
    named, more = [str(n) for n in fields[:NAMED]], len(fields) - NAMED
    names = f"{', '.join(named)} and {more} more" if more > 0 else f"{', '.join(named[:-1])} and {named[-1]}"
    return f"Fields {names} are left out: they match none of their neighbours. Check their frames, or scan them again."


def _length(value_um: float) -> str:
    """Format a length to two significant digits, as uncertainties are."""
    return with_unit(value_um, digits_of_u(value_um))


def _plus_minus(u_um: float) -> str:
    return f"±{THIN}{_length(u_um)}"


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


def close_action(word: str = "Close") -> Markup:
    """Return the Close action for the head of a panel."""
    label = Markup('class="wv-action" title="Close · Esc" aria-label="Close" {}').format(html.pick("why-close"))
    return Markup("<span {}>{}{}</span>").format(label, html.icon(viser.Icon.X), word)


def format_position(at_um: tuple[float, float] | None) -> str:
    """Format a stage position in µm; empty for None."""
    return "" if at_um is None else f"x {number(at_um[0], 1)}, y {with_unit(at_um[1], 1)}"


def pixel_position_text(curve: FocusCurve) -> str:
    """Format stage position, field, row and column of the pixel."""
    return f"{format_position((curve.x_um, curve.y_um))} · field {curve.field}, row {curve.row}, column {curve.col}"


def answer(curve: FocusCurve) -> Markup:
    """Return the card with the height, or with the reason why there is none."""
    if curve.height_um is None:
        peak = f"no height; the peak is at {with_unit(curve.peak_z_um, 2, signed=True)}"
        return _card("Not measured", _capital(curve.origin), "", peak, "color:var(--attention)", 24)
    trust = f"{curve.origin}, confidence {number(curve.confidence, 2)}"
    if curve.u_um is not None:
        trust = f"± {with_unit(2 * curve.u_um, 2)} (k = 2, without the z scale); {trust}"
    return _card("Measured height", number(curve.height_um, 2, signed=True), "µm", trust, "", 40)


def verdicts(curve: FocusCurve) -> Markup:
    """Return the table of gates: question, result, score and limit."""
    ratios = any(v.unit == "powers of two" for v in curve.verdicts)
    heads = ("", "Question", "Score", "Limit")
    legend = "×: the peak over the rest of the curve" if ratios else ""
    return html.head("What the gates found", legend) + html.table(heads, map(_row, curve.verdicts), "  nn")


def rivals(curve: FocusCurve) -> Markup:
    """Return the table of the other maxima of the focus curve; empty if there are none."""
    if not curve.rivals:
        return Markup()
    rows = [
        (with_unit(rival.z_um, 2, signed=True), f"{share(rival.share, 0 if rival.share >= 0.1 else 1)} of the peak")
        for rival in curve.rivals
    ]
    return html.head("Rivals of the peak") + html.pairs(rows)


def focus_measurement_text(curve: FocusCurve) -> str:
    """Describe the focus measurement: measure, window, number of frames; an unknown measure by its name."""
    entry = focus_measures().get(curve.focus_measure)
    measure = entry.title if entry else _capital(curve.focus_measure.replace("_", " "))
    simulated = "SIMULATED · " if curve.simulated else ""
    return f"{simulated}{measure}, window {curve.window} × {curve.window} px, {len(curve.z_um)} frames"


def _row(verdict: Verdict) -> Markup:
    icon, tone, word = _sign(verdict)
    before, figure = FIGURES.get(verdict.unit, ("", lambda value: number(value, 2)))
    unit = f"in {verdict.unit}" if verdict.unit and verdict.unit not in FIGURES else ""
    note = "" if verdict.note.rstrip(".").casefold().endswith(GATE_IS_OFF) else verdict.note
    detail = " · ".join(text for text in (word, unit, html.with_micro_sign(note)) if text)
    sign = Markup('<span style="color:var(--{})" aria-hidden="true">{}</span>').format(tone, html.icon(icon, 17))
    question = Markup('{}<small style="color:var(--{})">{}</small>').format(verdict.question, tone, detail)
    score = NOTHING if verdict.score is None else figure(verdict.score)
    limit = NOTHING if verdict.limit is None else figure(verdict.limit)
    bound = Markup('<span class="dim">{}</span> {}').format(before, limit) if before and limit != NOTHING else limit
    return html.row((sign, question, score, bound), "  nn")


def _sign(verdict: Verdict) -> tuple[object, str, str]:
    """Return icon, tone and word of a verdict, so that colour is never the only cue."""
    if verdict.limit is None and verdict.passed:
        return viser.Icon.MINUS, "ink3", GATE_IS_OFF
    if verdict.passed:
        return viser.Icon.CHECK, "good", "passed"
    return viser.Icon.X, "fault", "not passed"


def _card(label: str, value: str, unit: str, below: str, style: str, size_px: int) -> Markup:
    unit_html = Markup('<span class="wv-unit"> {}</span>').format(unit) if unit else Markup()
    return Markup(
        '<div class="wv-answer"><div class="wv-lab">{label}</div>'
        '<div class="wv-big" style="font-size:{size_px}px;white-space:normal;{style}">{value}{unit_html}</div>'
        '<div style="color:var(--ink2)">{below}</div></div>'
    ).format(label=label, size_px=size_px, style=style, value=value, unit_html=unit_html, below=below)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
