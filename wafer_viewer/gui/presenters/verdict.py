"""HTML of a verdict: word, reason, next action, all features. Pure functions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import viser
from markupsafe import Markup, escape

from wafer_viewer.draw.charts.die_map import die_map_svg
from wafer_viewer.draw.number_format import number
from wafer_viewer.draw.quantities import display_unit, value_texts, with_unit_sign
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.job import FeatureVerdict, WaferVerdict, Word
from wafer_viewer.model.measurement.feature import Feature
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.model.spec import settings_of

LOOKS: dict[Word, tuple[str, Any, html.Tone]] = {
    "pass": ("PASS", viser.Icon.CIRCLE_CHECK, "good"),
    "fail": ("FAIL", viser.Icon.CIRCLE_X, "fault"),
    "inconclusive": ("INCONCLUSIVE", viser.Icon.HELP_CIRCLE, "attention"),
    "no verdict": ("NO VERDICT", viser.Icon.CIRCLE_DASHED, "busy"),
}
"""Word, icon and tone of each verdict; each alone is unambiguous."""


def rule_title(feature: Feature) -> str:
    """Return the decision rule of a feature in words."""
    return settings_of(Feature)["decision_rule"].setting.titles[feature.decision_rule]


def card(verdict: WaferVerdict) -> Markup:
    """Return the verdict in the largest type of the page, with wafer, job and next action."""
    word, sign, tone = LOOKS[verdict.word]
    simulated = Markup('<em class="wv-sim">SIMULATED</em>') if verdict.simulated else Markup()
    trial = "" if verdict.released else "a trial: the job is not released"
    wafer = " · ".join(part for part in (verdict.wafer_id, verdict.lot, verdict.job, trial) if part)
    size = Markup(' class="long"') if len(word) > 6 else Markup()
    return Markup(
        '<div class="wv-verdict {tone}" role="status" aria-label="Verdict">'
        "<div{size}>{icon}<b>{word}</b></div>"
        "<p>{wafer}{simulated}</p><p><strong>{next}</strong></p></div>"
    ).format(
        tone=tone,
        size=size,
        icon=html.icon(sign, 46),
        word=word,
        wafer=wafer,
        simulated=simulated,
        next=html.typeset(verdict.next),
    )


def features(verdict: WaferVerdict) -> Markup:
    """Return the table of features: value ± U, limits, verdict; with the reason if it does not pass."""
    if not verdict.items:
        return Markup()
    rules = dict.fromkeys(rule_title(item.feature) for item in verdict.items)
    rows = [*_on_dies(verdict), *(_row(item) for item in verdict.items if not (item.die and item.word == "pass"))]
    return html.head("Features", f"U covers 95 % · {', '.join(rules)}") + html.table(
        ["", "Value ± U", "Limits", ""], rows, " nn "
    )


def dies(verdict: WaferVerdict) -> Markup:
    """Return the wafer map of dies coloured by verdict, with counts; empty without dies."""
    if not verdict.dies:
        return Markup()
    counts = ", ".join(f"{n} {word}" for word, n in verdict.die_counts.items())
    return html.head("Dies", counts) + Markup('<div class="wv-map">{}</div>').format(die_map_svg(verdict.dies))


def feature_summary(item: FeatureVerdict) -> Markup:
    """Return value ± U and limits of a feature for a list."""
    return Markup("{}<small>{}</small>").format(value_and_its_u(item), limits(item.feature))


def state(word: Word) -> Markup:
    """Return a verdict with its icon, in its colour."""
    name, sign, tone = LOOKS[word]
    return Markup('<b style="color:var(--{})">{} {}</b>').format(tone, html.icon(sign, 14), name)


def limits(feature: Feature) -> str:
    """Format the limits of a feature, with their unit."""
    low, high = feature.lower_limit, feature.upper_limit
    if low is not None and high is not None:
        text = f"{_plain(low)} … {_plain(high)}"
    else:
        text = f"≤ {_plain(high)}" if high is not None else f"≥ {_plain(low)}"
    return with_unit_sign(text, display_unit(Quantity(value=0.0, unit=feature.unit)).unit)


def value_and_its_u(item: FeatureVerdict) -> Markup:
    """Return the measured value ± U of a feature, as HTML."""
    if item.measured is None:
        return escape("not measured")
    value, u, _ = value_texts(item.measured)
    return (
        Markup("<b>{}</b> ± {}").format(value, u)
        if item.measured.expanded is not None
        else Markup("{}<small>no U</small>").format(value)
    )


def waiting(judging: bool) -> Markup:
    """Return the placeholder until there is a verdict."""
    doing = "The features are being measured." if judging else "The verdict follows when the surface is whole."
    return html.empty(doing)


def _on_dies(verdict: WaferVerdict) -> Iterator[Markup]:
    """Yield a row per feature repeated over dies, with its number of passing dies; other dies have their own rows."""
    words: dict[str, list[Word]] = {}
    for item in verdict.items:
        if item.die:
            words.setdefault(item.feature.name, []).append(item.word)
    first = {item.feature.name: item.feature for item in verdict.items if item.die}
    for name, of_dies in words.items():
        dies = "1 die passes" if len(of_dies) == 1 else f"{len(of_dies)} dies pass"
        good = f"{of_dies.count('pass')} of {dies}"
        yield html.row([name, good, limits(first[name]), ""], " nn ")


def _row(item: FeatureVerdict) -> Markup:
    feature, (word, sign, tone) = item.feature, LOOKS[item.word]
    why = Markup() if item.word == "pass" else Markup("<small>{}</small>").format(html.typeset(item.why))
    shown = Markup(
        '<span style="color:var(--{tone})" title="{word}" role="img" aria-label="{word}">{icon}</span>'
    ).format(tone=tone, word=word, icon=html.icon(sign, 17))
    return html.row([item.name + why, value_and_its_u(item), limits(feature), shown], " nn ")


def _plain(value: float | None) -> str:
    value = value or 0.0
    return number(value, max(0, len(f"{value:g}".partition(".")[2])))
