"""Pieces of the page that viser has no widget for: heads, tables, notes, figures in large type.

Everything here returns HTML text. What comes from people or files goes through `safe` and nothing else.
"""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterable, Sequence
from typing import Any, Literal

from wafer_viewer.gui.widgets.icons import svg

Tone = Literal["good", "attention", "fault", "busy"]
PICKS_HELD_MS = 2000
"""So long a pick is reported again with those that follow it."""


def safe(text: object) -> str:
    """Text made harmless inside an element or an attribute."""
    return html.escape(str(text), quote=True)


def micro(text: str) -> str:
    """A sentence of the program as the page writes it: its errors say um and us, so that any terminal can show them."""
    return re.sub(r"\bu([ms])\b", r"µ\1", text)


def icon(name: Any, size_px: int = 16) -> str:
    """An icon of viser's set, in the colour of the text around it."""
    return f'<span class="wv-i" style="width:{size_px}px;height:{size_px}px">{svg(name)}</span>'


def pick_script(what: str, latest_only: bool = False) -> str:
    """The handler that reports the element with ``data-k`` through the page's hidden text field.

    viser sends only the last of several changes within 50 ms: the field holds all picks of the last two seconds, each
    with its number, so that none is lost. latest_only: of a slider, a new value replaces those before it.
    """
    stale = f"||p[1]==='{what}'" if latest_only else ""
    return (
        "event.stopPropagation();const t=performance.now();window.wvPicks=(window.wvPicks||[])"
        f".filter(p=>!(t-p[3]>{PICKS_HELD_MS}{stale}));"
        "window.wvPickNumber=(window.wvPickNumber||0)+1;"
        f"window.wvPicks.push([window.wvPickNumber,'{what}',this.dataset.k,t]);"
        "const i=document.querySelector('div:has(>.wv-picks)+div input');"
        "Object.getOwnPropertyDescriptor(HTMLInputElement.prototype,'value').set"
        ".call(i,JSON.stringify(window.wvPicks));"
        "i.dispatchEvent(new Event('input',{bubbles:true}))"
    )


def read_picks(text: str, after: int) -> list[tuple[int, str, str]]:
    """Return number, subject and key of the picks that `pick_script` reported after number `after`, oldest first."""
    return [(number, what, key) for number, what, key, _ in json.loads(text) if number > after]


def pick(what: str, key: object = "") -> str:
    """Attributes that make an element a button which picks `key` of `what`; `what` is a word of the program's own."""
    return (
        f'data-pick="{what}" data-k="{safe(key)}" role="button" tabindex="0" onclick="{safe(pick_script(what))}" '
        "onkeydown=\"if(event.key==='Enter'||event.key===' '){event.preventDefault();this.click()}\""
    )


def title(text: str, below: str = "", beside: str = "") -> str:
    """The title of a panel, a sentence below it, small actions beside it. `beside` is HTML."""
    sub = f'<div class="wv-sub">{safe(below)}</div>' if below else ""
    return f'<div class="wv-title"><span>{safe(text)}</span><span class="wv-actions">{beside}</span></div>{sub}'


def head(text: str, beside: str = "", first: bool = False) -> str:
    """The head of a section with a line above it, and a small remark at its right end."""
    return f'<div class="wv-h{" first" if first else ""}">{safe(text)}<span>{safe(beside)}</span></div>'


def empty(*lines: str) -> str:
    """What stands where there is nothing yet: what will be there, or what to do."""
    return f'<div class="wv-empty">{"<br>".join(safe(line) for line in lines)}</div>'


def pairs(rows: Iterable[tuple[str, str]]) -> str:
    """Names on the left, values on the right."""
    cells = "".join(f"<div>{safe(name)}</div><div>{safe(value)}</div>" for name, value in rows)
    return f'<div class="wv-kv">{cells}</div>'


def table(heads: Sequence[str], rows: Iterable[str], right: str = "") -> str:
    """A table of rows made by `row`; `right` has an 'n' for every column that holds numbers."""
    top = "".join(f'<th class="{"n" if right[i : i + 1] == "n" else ""}">{safe(h)}</th>' for i, h in enumerate(heads))
    return f'<table class="wv-t">{f"<tr>{top}</tr>" if heads else ""}{"".join(rows)}</table>'


def row(cells: Sequence[str], right: str = "", attributes: str = "", look: str = "") -> str:
    """One row; cells are HTML. `look`: 'sel' the chosen one, 'off' one that cannot be chosen, 'strong' a sum."""
    go = "go " if attributes else ""
    body = "".join(f'<td class="{"n" if right[i : i + 1] == "n" else ""}">{c}</td>' for i, c in enumerate(cells))
    return f'<tr class="{go}{look}" {attributes}>{body}</tr>'


def figure(label: str, value: str, unit: str = "", size_px: int = 30, tone: Tone | None = None) -> str:
    """A number to be read from a distance, under its label."""
    colour = f"color:var(--{tone})" if tone else ""
    unit_html = f'<span class="wv-unit"> {safe(unit)}</span>' if unit else ""
    return (
        f'<div><div class="wv-lab">{safe(label)}</div>'
        f'<div class="wv-big" style="font-size:{size_px}px;{colour}">{safe(value)}{unit_html}</div></div>'
    )


def columns(items: Sequence[str], widths: str = "") -> str:
    """Pieces side by side."""
    widths = widths or f"repeat({len(items)},1fr)"
    return f'<div class="wv-cols" style="grid-template-columns:{widths}">{"".join(items)}</div>'


def note(tone: Tone, name: str, text: str, foot: str = "", sign: str = "") -> str:
    """A standing note: what happened, the fact, the way out. `foot` and `sign` are HTML."""
    lines = f"<b>{safe(name)}</b>" + (f"<p>{safe(micro(text))}</p>" if text else "")
    end = f'<p class="wv-foot">{foot}</p>' if foot else ""
    return f'<div class="wv-note {tone}" role="status">{sign}<div>{lines}{end}</div></div>'


def swatch(fill: str, edge: str, dashed: bool = False) -> str:
    """The little square of a legend."""
    line = "dashed" if dashed else "solid"
    return f'<i class="wv-sw" style="background:{fill};border:1.5px {line} {edge}"></i>'


def legend(items: Iterable[tuple[str, str]]) -> str:
    """Swatches with their words."""
    return f'<div class="wv-legend">{"".join(f"<span>{sign} {safe(word)}</span>" for sign, word in items)}</div>'


def chip(text: str, colour: str = "") -> str:
    """The sign of a result, white on its colour; without one in the colours of text."""
    if not colour:
        return f'<span class="wv-chip ink">{safe(text)}</span>'
    ground = f"color-mix(in srgb,{colour} 84%,#000)"  # white keeps 4.5 : 1 on every colour of lines and classes
    return f'<span class="wv-chip" style="background:{ground}">{safe(text)}</span>'


def bar(fraction: float | None) -> str:
    """A thin bar of progress; None: at work, nobody knows how far."""
    if fraction is None:
        return '<div class="wv-bar"><div class="wv-going"></div></div>'
    return f'<div class="wv-bar"><div style="width:{100 * min(max(fraction, 0.0), 1.0):.0f}%"></div></div>'
