"""HTML of the preflight checks. Pure: checks in, HTML out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import viser

from wafer_viewer.gui.widgets import html
from wafer_viewer.session.planning.preflight import PreflightCheck, State

SIGNS: dict[State, tuple[Any, str]] = {
    "ok": (viser.Icon.CIRCLE_CHECK, "ok"),
    "attention": (viser.Icon.ALERT_TRIANGLE, "attention"),
    "stop": (viser.Icon.HAND_STOP, "stop"),
}


def section(checks: Sequence[PreflightCheck], name: str = "Before the start") -> str:
    """Return all checks under a head with the number of open ones; empty without checks."""
    if not checks:
        return ""
    open_lines = sum(check.state != "ok" for check in checks)
    beside = "all fine" if not open_lines else f"{open_lines} of {len(checks)} to look at"
    return html.head(name, beside) + lines(checks)


def lines(checks: Sequence[PreflightCheck]) -> str:
    """Return the checks without a head."""
    return f'<div class="wv-checks" role="list" aria-label="Preflight">{"".join(map(_line, checks))}</div>'


def _line(check: PreflightCheck) -> str:
    sign, word = SIGNS[check.state]
    mend = f" <b>{html.safe(html.with_micro_sign(check.mend))}</b>" if check.mend else ""
    told = f'<span role="img" aria-label="{word}">{html.icon(sign, 17)}</span>'
    text = f"<span>{html.safe(html.with_micro_sign(check.found))}{mend}</span>"
    return f'<div class="{check.state}" role="listitem">{told}<em>{check.what}</em>{text}</div>'
