"""Preflight checks as lines with a sign each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.gui.widgets import html
from wafer_viewer.session.planning.preflight import PreflightCheck, State

SIGNS: dict[State, tuple[Any, str]] = {
    "ok": (viser.Icon.CIRCLE_CHECK, "ok"),
    "attention": (viser.Icon.ALERT_TRIANGLE, "attention"),
    "stop": (viser.Icon.HAND_STOP, "stop"),
}


def section(checks: Sequence[PreflightCheck], name: str = "Before the start") -> Markup:
    """Return all checks under a head with the number of open ones; empty without checks."""
    if not checks:
        return Markup()
    n = sum(check.state != "ok" for check in checks)
    status = f"{n} of {len(checks)} need{'s' if n == 1 else ''} attention" if n else "all fine"
    return html.head(name, status) + lines(checks)


def lines(checks: Sequence[PreflightCheck]) -> Markup:
    """Return the checks without a head."""
    return Markup('<div class="wv-checks" role="list" aria-label="Preflight">{}</div>').format(
        Markup("").join(map(_line, checks))
    )


def _line(check: PreflightCheck) -> Markup:
    sign, word = SIGNS[check.state]
    mend = Markup(" <b>{}</b>").format(html.typeset(check.mend)) if check.mend else Markup()
    return Markup(
        '<div class="{}" role="listitem"><span role="img" aria-label="{}">{}</span><em>{}</em><span>{}{}</span></div>'
    ).format(check.state, word, html.icon(sign, 17), check.what, html.typeset(check.found), mend)
