"""HTML elements without a viser widget: headings, tables, notes, large figures, icons.

Every function returns Markup, and every argument may be text or Markup: what is not Markup is escaped where it enters
an element. So markup is written only as a literal, and a value from a user or a file never becomes part of it.
"""

from __future__ import annotations

import functools
import json
import re
import threading
import zipfile
from collections.abc import Iterable, Sequence
from typing import Any, Literal

import viser._gui_api
import viser._gui_handles
import viser._icons
from markupsafe import Markup

from wafer_viewer.draw.number_format import MINUS
from wafer_viewer.model.errors import WaferViewerError, detail, parser_errors_as
from wafer_viewer.model.roles import Action, role_for

_reading = threading.Lock()


@functools.cache
def svg(name: str) -> str:
    """Return the text of an icon's ``<svg>`` element, which comes with viser."""
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


def style_sheet(rules: str) -> Markup:
    """Return a style element with CSS of the program; text from elsewhere has no place in `rules`."""
    return Markup("<style>{}</style>").format(Markup(rules))


def typeset(text: str) -> str:
    """Return a message with µm, µs and true minus signs; messages use ASCII so that any terminal can show them."""
    return re.sub(r"(?<![^\s(,])-(?=[\d.])", MINUS, re.sub(r"\bu([ms])\b", r"µ\1", text))


@functools.cache
def icon(name: Any, size_px: int = 16) -> Markup:
    """Return an icon of viser's set, in the colour of the surrounding text."""
    return Markup('<span class="wv-i" style="width:{}px;height:{}px">{}</span>').format(
        size_px, size_px, Markup(svg(name))
    )


def read_picks(text: str, after: int) -> list[tuple[int, str, str]]:
    """Return number, subject and key of the picks that the browser reported after number `after`, oldest first.

    Raises WaferViewerError for any other text.
    """
    with parser_errors_as(lambda fault: WaferViewerError(f"The browser reported no picks{detail(fault)}.")):
        return [(number, what, key) for number, what, key, _ in json.loads(text) if number > after]


def pick(what: str, key: object = "") -> Markup:
    """Return attributes that make an element a button which picks `key` of `what`, a fixed word of the program."""
    return Markup('data-pick="{}" data-k="{}" role="button" tabindex="0"').format(what, key)


NEEDS_CONTROL = "data-needs-control"
"""Attribute of elements that move the rig, or change the plan, the dataset or the results."""


NEEDS_ENGINEER = "data-needs-engineer"
"""Attribute of elements that only an engineer may use, and class of the mark before such a group of buttons."""


def command_pick(what: str, key: object = "", action: Action | None = None) -> Markup:
    """Return the attributes of `pick` for an element that needs control; action: what it does, if that needs a role."""
    return pick(what, key) + f" {NEEDS_CONTROL}" + (f" {NEEDS_ENGINEER}" if role_for(action) == "engineer" else "")


def title(text: str, below: str = "", detail: str = "") -> Markup:
    """Return the title of a panel, with a subtitle and small actions."""
    sub = Markup('<div class="wv-sub">{}</div>').format(below) if below else Markup()
    return Markup('<div class="wv-title"><span>{}</span><span class="wv-actions">{}</span></div>{}').format(
        text, detail, sub
    )


def head(text: str, detail: str = "", first: bool = False) -> Markup:
    """Return the heading of a section with a line above it, and a small remark at its right end."""
    return Markup('<div class="wv-h{}">{}<span>{}</span></div>').format(" first" if first else "", text, detail)


def link(text: str, what: str, key: object = "", title: str = "") -> Markup:
    """Return a link that picks `key` of `what`; title: its tooltip."""
    named = Markup(' title="{}"').format(title) if title else Markup()
    return Markup('<span class="wv-link"{} {}>{}</span>').format(named, pick(what, key), text)


def command_link(text: str, what: str, key: object = "", action: Action | None = None, title: str = "") -> Markup:
    """Return a link that picks `key` of `what`, and needs control; title: tooltip of a link without text."""
    named = Markup(' title="{}"').format(title) if title else Markup()
    return Markup('<span class="wv-link"{} {}>{}</span>').format(named, command_pick(what, key, action), text)


def segments(what: str, options: Iterable[tuple[str, str]], chosen: str, label: str = "", look: str = "") -> Markup:
    """Return a choice of one of a few `options`, pairs of key and title, that picks a key of `what`."""
    buttons = Markup("").join(
        Markup('<span class="{}" aria-pressed="{}" {}>{}</span>').format(
            "on" if key == chosen else "", str(key == chosen).lower(), pick(what, key), title
        )
        for key, title in options
    )
    return Markup('<div class="{}" role="group" aria-label="{}">{}</div>').format(look or "wv-segments", label, buttons)


def title_action(text: str, attributes: Markup, title: str = "", possible: bool = True) -> Markup:
    """Return a small action at the right end of a title; attributes: those of a pick."""
    named = Markup(' title="{}"').format(title) if title else Markup()
    state = attributes if possible else Markup('aria-disabled="true"')
    return Markup('<span class="wv-action{}"{} {}>{}</span>').format("" if possible else " off", named, state, text)


def remark(text: str, style: str = "") -> Markup:
    """Return a line of small grey text; an empty text has none. style: its margins, in CSS."""
    words = text if isinstance(text, Markup) else typeset(text)
    look = Markup(' style="{}"').format(style) if style else Markup()
    return Markup('<div class="wv-lab"{}>{}</div>').format(look, words) if text else Markup()


def why_not(reason: str | None, look: str = "") -> Markup:
    """Return the line that says why the button below it is not possible now; empty without a reason."""
    line = Markup('<div class="wv-why{}">Not yet: {}</div>')
    return line.format(look, typeset(reason)) if reason else Markup()


def empty(*lines: str) -> Markup:
    """Return the placeholder of an empty section: a description of its future content, or an instruction."""
    return Markup('<div class="wv-empty">{}</div>').format(Markup("<br>").join(lines))


def pairs(rows: Iterable[tuple[str, str]]) -> Markup:
    """Return rows of names on the left and values on the right."""
    cells = Markup("").join(Markup("<div>{}</div><div>{}</div>").format(name, value) for name, value in rows)
    return Markup('<div class="wv-kv">{}</div>').format(cells)


def table(
    heads: Sequence[str], rows: Iterable[Markup], right: str = "", widths_px: Sequence[int | None] = ()
) -> Markup:
    """Return a table of rows made by `row`; `right` has an 'n' for each numeric column."""
    widths = Markup("").join(Markup('<col style="width:{}px">').format(w) if w else Markup("<col>") for w in widths_px)
    top = Markup("").join(
        Markup('<th class="{}">{}</th>').format("n" if right[i : i + 1] == "n" else "", h) for i, h in enumerate(heads)
    )
    return Markup('<table class="wv-t">{}{}{}</table>').format(
        Markup("<colgroup>{}</colgroup>").format(widths) if widths else "",
        Markup("<tr>{}</tr>").format(top) if heads else "",
        Markup("").join(rows),
    )


def row(cells: Sequence[str], right: str = "", attributes: Markup | Literal[""] = "", look: str = "") -> Markup:
    """Return one row; `look`: 'sel' selected, 'off' not selectable, 'strong' a sum."""
    go = "go " if attributes else ""
    body = Markup("").join(
        Markup('<td class="{}">{}</td>').format("n" if right[i : i + 1] == "n" else "", c) for i, c in enumerate(cells)
    )
    return Markup('<tr class="{go}{look}" {attributes}>{body}</tr>').format(
        go=go, look=look, attributes=attributes, body=body
    )


def figure(label: str, value: str, unit: str = "", size_px: int = 30, tone: Tone | None = None) -> Markup:
    """Return a number in large type under its label."""
    colour = f"color:var(--{tone})" if tone else ""
    unit_html = Markup('<span class="wv-unit"> {}</span>').format(unit) if unit else Markup()
    return Markup(
        '<div><div class="wv-lab">{label}</div>'
        '<div class="wv-big" style="font-size:{size_px}px;{colour}">{value}{unit_html}</div></div>'
    ).format(label=label, size_px=size_px, colour=colour, value=value, unit_html=unit_html)


def columns(items: Sequence[Markup], widths: str = "") -> Markup:
    """Return elements side by side."""
    widths = widths or f"repeat({len(items)},1fr)"
    return Markup('<div class="wv-cols" style="grid-template-columns:{}">{}</div>').format(
        widths, Markup("").join(items)
    )


def note(tone: Tone, name: str, text: str, foot: str = "", sign: str = "") -> Markup:
    """Return a permanent note: event, facts, remedy. `foot` and `sign` are HTML."""
    lines = Markup("<b>{}</b>").format(name) + (Markup("<p>{}</p>").format(typeset(text)) if text else Markup())
    end = Markup('<p class="wv-foot">{}</p>').format(foot) if foot else Markup()
    return Markup('<div class="wv-note {tone}" role="status">{sign}<div>{lines}{end}</div></div>').format(
        tone=tone, sign=sign, lines=lines, end=end
    )


def swatch(fill: str, edge: str, dashed: bool = False) -> Markup:
    """Return the small square of a legend."""
    line = "dashed" if dashed else "solid"
    return Markup('<i class="wv-sw" style="background:{};border:1.5px {} {}"></i>').format(fill, line, edge)


def legend(items: Iterable[tuple[str, str]]) -> Markup:
    """Return swatches with their labels."""
    return Markup('<div class="wv-legend">{}</div>').format(
        Markup("").join(Markup("<span>{} {}</span>").format(sign, word) for sign, word in items)
    )


def chip(text: str, colour: str = "") -> Markup:
    """Return the label of a result, white on its colour; in text colours if there is none."""
    if not colour:
        return Markup('<span class="wv-chip ink">{}</span>').format(text)
    ground = f"color-mix(in srgb,{colour} 84%,#000)"  # white keeps 4.5 : 1 on every colour of lines and classes
    return Markup('<span class="wv-chip" style="background:{}">{}</span>').format(ground, text)


def bar(fraction: float | None) -> Markup:
    """Return a thin progress bar; None: running with unknown progress."""
    if fraction is None:
        return Markup('<div class="wv-bar"><div class="wv-going"></div></div>')
    return Markup('<div class="wv-bar"><div style="width:{:.0f}%"></div></div>').format(
        100 * min(max(fraction, 0.0), 1.0)
    )
