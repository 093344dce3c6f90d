"""HTML elements without a viser widget: headings, tables, notes, large figures, icons.

All functions return HTML text. Text from users or files must be escaped by `safe`.
"""

from __future__ import annotations

import functools
import html
import json
import re
import threading
import zipfile
from collections.abc import Iterable, Sequence
from typing import Any, Literal

import viser._gui_api
import viser._gui_handles
import viser._icons

_reading = threading.Lock()


@functools.cache
def svg(name: str) -> str:
    """Return the text of an icon's ``<svg>`` element."""
    with _reading:
        return _archive().read(f"{name}.svg").decode()


@functools.cache
def _archive() -> zipfile.ZipFile:
    return zipfile.ZipFile(viser._icons.ICONS_DIR / "tabler-icons.zip")


def quicken() -> None:
    """Make viser's own widgets use the cached icons. Pinned to viser 1.1, whose internals it replaces."""
    for module in (viser._icons, viser._gui_api, viser._gui_handles):
        vars(module)["svg_from_icon"] = svg


Tone = Literal["good", "attention", "fault", "busy"]
PICKS_HELD_MS = 2000
"""Time for which a pick is reported again together with later ones."""


def safe(text: object) -> str:
    """Return text escaped for use in an element or an attribute."""
    return html.escape(str(text), quote=True)


def with_micro_sign(text: str) -> str:
    """Return a message with um and us as µm and µs; error messages use ASCII so that any terminal can show them."""
    return re.sub(r"\bu([ms])\b", r"µ\1", text)


def icon(name: Any, size_px: int = 16) -> str:
    """Return an icon of viser's set, in the colour of the surrounding text."""
    return f'<span class="wv-i" style="width:{size_px}px;height:{size_px}px">{svg(name)}</span>'


def pick_script(what: str, latest_only: bool = False) -> str:
    """Return the handler that reports the element with ``data-k`` through the page's hidden text field.

    viser sends only the last of several changes within 50 ms. The field therefore holds all picks of the last two
    seconds, each with its number, so that none is lost. latest_only: a new value replaces the previous ones, for
    sliders.
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
    """Return attributes that make an element a button which picks `key` of `what`, a fixed word of the program."""
    return (
        f'data-pick="{what}" data-k="{safe(key)}" role="button" tabindex="0" onclick="{safe(pick_script(what))}" '
        "onkeydown=\"if(event.key==='Enter'||event.key===' '){event.preventDefault();this.click()}\""
    )


NEEDS_CONTROL = "data-needs-control"
"""Attribute of elements that move the rig, or change the plan, the dataset or the results."""


def command_pick(what: str, key: object = "") -> str:
    """Return the attributes of `pick` for an element that needs control."""
    return f"{pick(what, key)} {NEEDS_CONTROL}"


def title(text: str, below: str = "", beside: str = "") -> str:
    """Return the title of a panel, with a subtitle and small actions. `beside` is HTML."""
    sub = f'<div class="wv-sub">{safe(below)}</div>' if below else ""
    return f'<div class="wv-title"><span>{safe(text)}</span><span class="wv-actions">{beside}</span></div>{sub}'


def head(text: str, beside: str = "", first: bool = False) -> str:
    """Return the heading of a section with a line above it, and a small remark at its right end."""
    return f'<div class="wv-h{" first" if first else ""}">{safe(text)}<span>{safe(beside)}</span></div>'


def empty(*lines: str) -> str:
    """Return the placeholder of an empty section: a description of its future content, or an instruction."""
    return f'<div class="wv-empty">{"<br>".join(safe(line) for line in lines)}</div>'


def pairs(rows: Iterable[tuple[str, str]]) -> str:
    """Return rows of names on the left and values on the right."""
    cells = "".join(f"<div>{safe(name)}</div><div>{safe(value)}</div>" for name, value in rows)
    return f'<div class="wv-kv">{cells}</div>'


def table(heads: Sequence[str], rows: Iterable[str], right: str = "") -> str:
    """Return a table of rows made by `row`; `right` has an 'n' for each numeric column."""
    top = "".join(f'<th class="{"n" if right[i : i + 1] == "n" else ""}">{safe(h)}</th>' for i, h in enumerate(heads))
    return f'<table class="wv-t">{f"<tr>{top}</tr>" if heads else ""}{"".join(rows)}</table>'


def row(cells: Sequence[str], right: str = "", attributes: str = "", look: str = "") -> str:
    """Return one row; cells are HTML. `look`: 'sel' selected, 'off' not selectable, 'strong' a sum."""
    go = "go " if attributes else ""
    body = "".join(f'<td class="{"n" if right[i : i + 1] == "n" else ""}">{c}</td>' for i, c in enumerate(cells))
    return f'<tr class="{go}{look}" {attributes}>{body}</tr>'


def figure(label: str, value: str, unit: str = "", size_px: int = 30, tone: Tone | None = None) -> str:
    """Return a number in large type under its label."""
    colour = f"color:var(--{tone})" if tone else ""
    unit_html = f'<span class="wv-unit"> {safe(unit)}</span>' if unit else ""
    return (
        f'<div><div class="wv-lab">{safe(label)}</div>'
        f'<div class="wv-big" style="font-size:{size_px}px;{colour}">{safe(value)}{unit_html}</div></div>'
    )


def columns(items: Sequence[str], widths: str = "") -> str:
    """Return elements side by side."""
    widths = widths or f"repeat({len(items)},1fr)"
    return f'<div class="wv-cols" style="grid-template-columns:{widths}">{"".join(items)}</div>'


def note(tone: Tone, name: str, text: str, foot: str = "", sign: str = "") -> str:
    """Return a permanent note: event, facts, remedy. `foot` and `sign` are HTML."""
    lines = f"<b>{safe(name)}</b>" + (f"<p>{safe(with_micro_sign(text))}</p>" if text else "")
    end = f'<p class="wv-foot">{foot}</p>' if foot else ""
    return f'<div class="wv-note {tone}" role="status">{sign}<div>{lines}{end}</div></div>'


def swatch(fill: str, edge: str, dashed: bool = False) -> str:
    """Return the small square of a legend."""
    line = "dashed" if dashed else "solid"
    return f'<i class="wv-sw" style="background:{fill};border:1.5px {line} {edge}"></i>'


def legend(items: Iterable[tuple[str, str]]) -> str:
    """Return swatches with their labels."""
    return f'<div class="wv-legend">{"".join(f"<span>{sign} {safe(word)}</span>" for sign, word in items)}</div>'


def chip(text: str, colour: str = "") -> str:
    """Return the label of a result, white on its colour; in text colours if there is none."""
    if not colour:
        return f'<span class="wv-chip ink">{safe(text)}</span>'
    ground = f"color-mix(in srgb,{colour} 84%,#000)"  # white keeps 4.5 : 1 on every colour of lines and classes
    return f'<span class="wv-chip" style="background:{ground}">{safe(text)}</span>'


def bar(fraction: float | None) -> str:
    """Return a thin progress bar; None: running with unknown progress."""
    if fraction is None:
        return '<div class="wv-bar"><div class="wv-going"></div></div>'
    return f'<div class="wv-bar"><div style="width:{100 * min(max(fraction, 0.0), 1.0):.0f}%"></div></div>'
