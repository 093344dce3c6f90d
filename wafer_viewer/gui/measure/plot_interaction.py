"""Pointer and key interaction on the profile plot: drag to zoom, click or slide to move cursors.

viser reports no clicks on its plots, so these elements cover the curves and report through the page's hidden field.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from wafer_viewer.gui.widgets import html

ZOOM, CURSOR = "plot", "cursor"
"""Events: start and end of a drag as shares of the plot's width; a cursor and its distance."""
WHOLE = "whole"
_ALONG = "(event.clientX-this.getBoundingClientRect().left)/this.clientWidth"
_DOWN = f"if(event.button===0){{this.setPointerCapture(event.pointerId);window.plotFrom={_ALONG}}}"
"""The drag is stored in the window, so that it continues on a plot that is redrawn meanwhile."""
_MOVE = (
    "if(!(event.buttons&1)){window.plotFrom=undefined;this.firstElementChild.style.display='none'}"
    f"if(window.plotFrom!==undefined){{const a=window.plotFrom,b={_ALONG},s=this.firstElementChild.style;"
    "s.display='block';s.left=100*Math.max(0,Math.min(a,b))+'%';s.right=100*Math.max(0,1-Math.max(a,b))+'%'}"
)
_UP = (
    f"if(window.plotFrom!==undefined){{this.dataset.k=window.plotFrom+':'+{_ALONG};window.plotFrom=undefined;"
    f"this.firstElementChild.style.display='none';{html.pick_script(ZOOM)}}}"
)
_WHOLE = f"this.dataset.k='{WHOLE}';{html.pick_script(ZOOM)}"
_KEYS = "if(event.key.startsWith('Arrow'))event.stopPropagation()"
"""Stops the arrow keys from moving the camera as well."""


def zoom_area() -> str:
    """Return the element over the curves as HTML: a drag zooms, a click moves the nearer cursor."""
    heard = {"pointerdown": _DOWN, "pointermove": _MOVE, "pointerup": _UP, "dblclick": _WHOLE}
    handlers = " ".join(f'on{event}="{html.safe(script)}"' for event, script in heard.items())
    return f'<div class="wv-zoom" {handlers}><div></div></div>'


def cursor_sliders(at_um: Sequence[float], ends_um: tuple[float, float], step_um: float) -> str:
    """Return a slider over the plot for each cursor within its ends, as HTML; only the thumbs take the pointer."""
    tell = "this.dataset.k=this.name+':'+this.value+':'+(this.dataset.by||'key')+':{end}';"
    tell += html.pick_script(CURSOR, latest_only=True)
    moved, released = (html.safe(tell.replace("{end}", end)) for end in ("", "end"))
    released += ";delete this.dataset.by"
    return "".join(
        f'<input type="range" class="wv-slide" name="{k}" aria-label="Cursor {k + 1}, µm" '
        f'min="{ends_um[0]!r}" max="{ends_um[1]!r}" step="{step_um * (1 - 1e-9)!r}" value="{at!r}" '
        f'oninput="{moved}" onchange="{released}" onpointerdown="this.dataset.by=\'hand\'" onkeydown="{_KEYS}">'
        for k, at in enumerate(at_um)
        if ends_um[0] <= at <= ends_um[1]
    )


def parse_drag(key: str) -> tuple[float, float]:
    """Return the two shares that `zoom_area` reported, clamped to the plot."""
    first, last = (min(max(float(share), 0.0), 1.0) for share in key.split(":"))
    return first, last


@dataclass(frozen=True, slots=True)
class CursorMove:
    """Slider event: number of the cursor, its distance along the line in um, moved by key, released."""

    number: int
    at_um: float
    by_key: bool
    released: bool


def parse_cursor_event(key: str) -> CursorMove:
    """Parse the event of a cursor slider."""
    number, at_um, by, end = key.split(":")
    return CursorMove(int(number), float(at_um), by == "key", end == "end")


def focus_slider_html(number: int) -> str:
    """Return HTML that focuses the slider of a cursor again, after it was recreated during keyboard use."""
    script = f"document.querySelector('.wv-slide[name=&quot;{number}&quot;]')?.focus()"
    return f'<img src="data:," alt="" hidden onerror="{script}">'
