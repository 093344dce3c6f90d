"""The answer to "Why this height?": focus curve, gates and competing peaks of one pixel, and the frames below it."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace

import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.profile_plot import focus_plot_html
from wafer_viewer.draw.number_format import NOTHING, number, share, with_unit
from wafer_viewer.draw.surface.pictures import greys, patch, patch_url
from wafer_viewer.gui.elements.elements import Elements, Html
from wafer_viewer.gui.elements.step import Here, Picks
from wafer_viewer.gui.scene.heightfield import Place
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.style import PROFILE_PX
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.surface.focus_curve import FocusCurve, Verdict
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.session.state.snapshot import Snapshot

CURVE, GREYS, FRAME = "focus curve", "greys of a pixel's frames", "frame round a pixel"
TITLE = "Why this height?"
FAILED, FRAME_FAILED = "The frames were not read", "The frame was not read"
READING = "Reading the frames …"
PATCH_PX = 96
"""Side of the displayed part of a frame, in frame pixels."""
PICTURE_PX = 176
HEAD_PX = 50


@dataclass(frozen=True, slots=True)
class Explained:
    """clicked: last clicked place, with its surface. surface: that of the pixel that is explained."""

    clicked: tuple[Place, Hashable] | None = None
    surface: Hashable = None


def evidence_step(here: Here[Explained]) -> Elements | None:
    """Return the height of the pixel with its gates and competing peaks; another surface ends the explanation."""
    page, view, where_um = here.page, here.view, here.view.why
    if not view.explains or where_um is None:
        here.ask(CURVE, None, None, FAILED)
        here.own = replace(here.own, surface=None)
        return None
    surface = surface_of(here.snapshot, view)
    if here.own.surface not in (None, surface):
        page.change(why=None)
        return None
    here.own = replace(here.own, surface=surface)

    def read() -> FocusCurve:
        return page.session.focus_curve(*where_um, max(0, view.show)).result()

    answer = here.ask(CURVE, (where_um, _stamp(here.snapshot, view)), read, FAILED, about=surface)
    curve = answer.value
    where = pixel_position_text(curve) if curve else format_position(where_um)
    content = answer_card(curve) + verdicts(curve) + rivals(curve) if curve else Markup()
    return [
        Html(html.title(TITLE, where, close_action())),
        Html(page.notes(here.snapshot)),
        Html(Markup('<div class="wv-pale">{}</div>').format(content) if curve and answer.computing else content),
    ]


def explain_click(here: Here[Explained], x_um: float, y_um: float) -> None:
    """Remember a click on the surface; explain that place at once if the panel is open."""
    page = here.page
    here.own = replace(here.own, clicked=((x_um, y_um), surface_of(page.session.snapshot, page.view)))
    if page.view.explains:
        page.change(why=(x_um, y_um))


def toggle_explanation(here: Here[Explained]) -> None:
    """Explain the place that was clicked last, or end the explanation."""
    page, clicked = here.page, here.own.clicked
    if page.view.explains:
        page.change(why=None)
    elif clicked is not None and clicked[1] == surface_of(page.session.snapshot, page.view):
        page.change(why=clicked[0])
    elif page.view.on_surface:
        page.say(TITLE, "Click a place on the surface first.")


def surface_of(snapshot: Snapshot, view: View) -> Hashable:
    """Return the key of the displayed surface: dataset path and field."""
    return (snapshot.dataset.path if snapshot.dataset else None, view.show)


def _stamp(snapshot: Snapshot, view: View) -> int | None:
    if view.show:
        return snapshot.dataset.stamps.get(view.show) if snapshot.dataset else None
    return snapshot.surface.stamp if snapshot.surface else None


EVIDENCE_PICKS: Picks[Explained] = {
    "why": lambda here, _: toggle_explanation(here),
    "why-close": lambda here, _: here.page.change(why=None),
}


@dataclass(frozen=True, slots=True)
class ChosenFrame:
    """Frame of a curve that a person slid to."""

    curve: FocusCurve | None = None
    z_um: float = 0.0


def evidence_dock(here: Here[ChosenFrame]) -> Elements:
    """Return the focus curve with a line that leads through its frames, and the picture of the chosen frame."""
    answer = here.ask.known(CURVE)
    curve: FocusCurve | None = answer.value
    reading = curve is not None and answer.computing
    head = Html(_head(curve, reading))
    mark = Html(Markup('<div class="wv-why"></div>'), padded=False)
    if curve is None:
        problem = "" if answer.computing else answer.problem or f"{FAILED}."
        return [head, mark, Html(html.note("attention", FAILED, problem) if problem else html.empty(READING)), Html()]
    sharpest = max(range(len(curve.focus)), key=lambda k: curve.focus[k])
    z_um = here.own.z_um if here.own.curve is curve else curve.z_um[sharpest]
    plot = focus_plot_html(curve, PROFILE_PX - HEAD_PX, _slider(curve, sharpest))
    return [
        head,
        mark,
        Html(Markup('<div class="{}">{}</div>').format(" wv-pale" if reading else "", plot)),
        Html(_frame(here, curve, sharpest, z_um)),
    ]


def _choose_frame(here: Here[ChosenFrame], z_um: str) -> None:
    here.keep(curve=here.ask.known(CURVE).value, z_um=float(z_um))


FRAME_PICKS: Picks[ChosenFrame] = {"why-frame": _choose_frame}


def _frame(here: Here[ChosenFrame], curve: FocusCurve, sharpest: int, z_um: float) -> Markup:
    """Return the picture of the frame nearest to z, in the greys of the sharpest one; empty before there is one."""
    session = here.page.session
    k = min(range(len(curve.z_um)), key=lambda k: abs(curve.z_um[k] - z_um))

    def around(k: int) -> Image:
        return patch(session.frame_near(curve.field, curve.z_um[k]), curve.row, curve.col, PATCH_PX)

    between = here.ask(GREYS, None, lambda: greys(around(sharpest)), FRAME_FAILED, about=curve).value
    if between is None:
        return Markup()

    def read() -> Markup:
        frame = session.frame_near(curve.field, curve.z_um[k])
        return _picture(curve, k, patch_url(frame, curve.row, curve.col, PATCH_PX, between))

    return here.ask(FRAME, k, read, FRAME_FAILED, about=curve).value or Markup()


def _head(curve: FocusCurve | None, reading: bool) -> Markup:
    about = READING if reading and curve is not None else focus_measurement_text(curve) if curve is not None else ""
    hint = "Drag through the curve to see its frames" if curve is not None else ""
    return Markup(
        '<div class="wv-dock"><b>Focus curve</b><span class="dim">{}</span>'
        '<span class="wv-end"><span class="wv-hint">{}</span></span>{}</div>'
    ).format(about, hint, close_action(""))


def _slider(curve: FocusCurve, sharpest: int) -> Markup:
    """Return the frame selector as HTML: a slider over z that covers the plot, so that it can be dragged anywhere."""
    low, high = curve.z_um[0], curve.z_um[-1]
    step = (high - low) / (len(curve.z_um) - 1) * (1 - 1e-9)  # or the last frame would lie beyond the last step
    return Markup(
        '<input type="range" class="wv-scrub" aria-label="Frame at z, µm" min="{low!r}" max="{high!r}" '
        'step="{step!r}" value="{value!r}" data-slide="why-frame">'
    ).format(low=low, high=high, step=step, value=curve.z_um[sharpest])


def _cross_hair(window_px: int) -> Markup:
    """Return a cross hair around the pixel and the outline of its focus window, as SVG."""
    half, low, high = PATCH_PX / 2, PATCH_PX / 2 + 0.5 - window_px / 2, PATCH_PX / 2 + 0.5 + window_px / 2
    middle, gap, end = half + 0.5, 12, PATCH_PX
    lines = f"M0 {middle}H{low - gap}M{high + gap} {middle}H{end}M{middle} 0V{low - gap}M{middle} {high + gap}V{end}"
    d = f"{lines}M{low} {low}H{high}V{high}H{low}Z"
    strokes = (("rgba(0,0,0,.65)", 3.4), ("#fff", 1.5))
    paths = Markup("").join(
        Markup('<path d="{}" stroke="{}" stroke-width="{}"/>').format(d, colour, width) for colour, width in strokes
    )
    return Markup('<svg viewBox="0 0 {} {}">{}</svg>').format(PATCH_PX, PATCH_PX, paths)


def _picture(curve: FocusCurve, k: int, url: str) -> Markup:
    """Return the picture of the pixel's surroundings in a frame, with the frame's number and z, as HTML."""
    z = with_unit(curve.z_um[k], 2, signed=True)
    return Markup(
        '<figure class="wv-patch" style="width:{picture_px}px">'
        '<div style="height:{picture_px}px"><img src="{url}" alt="Frame {alt} round the pixel">'
        "{cross_hair}</div>"
        "<figcaption><b>z {z}</b><span>frame {alt} of {z_um}</span></figcaption></figure>"
    ).format(picture_px=PICTURE_PX, url=url, alt=k + 1, cross_hair=_cross_hair(curve.window), z=z, z_um=len(curve.z_um))


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


def answer_card(curve: FocusCurve) -> Markup:
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
    detail = " · ".join(text for text in (word, unit, html.typeset(note)) if text)
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
