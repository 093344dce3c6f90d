"""Pointer interaction on the height histogram: a drag brushes a range, a click clears it, grips clip.

The element covers the bars and reports through the page's hidden field.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from wafer_viewer.draw.charts.histogram_html import HEIGHT_PX, place_of
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.surface.clipping import Span

HISTOGRAM = "histogram"
Act = Literal["brush", "low", "high"]
_ACTS: dict[str, Act] = {"brush": "brush", "low": "low", "high": "high"}
_GRIP_PX = 9
_CLICK, _AT_END = 0.008, 0.006
"""Shares of the histogram's width."""
_ALONG = "Math.max(0,Math.min(1,(event.clientX-this.getBoundingClientRect().left)/this.clientWidth))"
_DOWN = (
    f"if(event.button===0){{event.stopPropagation();this.setPointerCapture(event.pointerId);const x={_ALONG};"
    "const g=[...this.querySelectorAll('b')].map(e=>[Math.abs(parseFloat(e.style.left)/100-x),e.dataset.grip])"
    f".filter(e=>e[0]<{_GRIP_PX}/this.clientWidth).sort((a,b)=>a[0]-b[0]);"
    "window.wvBrush=[g.length?g[0][1]:'brush',x]}"
)
_MOVE = (
    "const h=window.wvBrush;if(!(event.buttons&1)){window.wvBrush=undefined}else if(h){"
    f"const x={_ALONG};if(h[0]==='brush'){{const s=this.firstElementChild.style;s.display='block';"
    "s.left=100*Math.min(h[1],x)+'%';s.width=100*Math.abs(h[1]-x)+'%'}"
    "else this.querySelector('b[data-grip='+h[0]+']').style.left=100*x+'%'}"
)
_UP = (
    f"const h=window.wvBrush;if(h){{window.wvBrush=undefined;this.dataset.k=h[0]+':'+h[1]+':'+{_ALONG};"
    f"{html.pick_script(HISTOGRAM)}}}"
)


def histogram_area(ends_um: Span, brush_um: Span | None, clip_um: Span | None, *, clips: bool) -> str:
    """Return the element over the bars as HTML.

    clips: add grips at the ends of `clip_um`, or of the histogram without one.
    """
    band = "display:none"
    if brush_um is not None:
        first, last = (place_of(z, ends_um) for z in brush_um)
        band = f"left:{100 * first:.3f}%;width:{100 * (last - first):.3f}%"
    grips = ""
    if clips:
        places = (0.0, 1.0) if clip_um is None else tuple(place_of(z, ends_um) for z in clip_um)
        grips = "".join(
            f'<b data-grip="{name}" style="left:{100 * at:.3f}%"></b>'
            for name, at in zip(("low", "high"), places, strict=True)
        )
    heard = {"pointerdown": _DOWN, "pointermove": _MOVE, "pointerup": _UP}
    handlers = " ".join(f'on{event}="{html.safe(script)}"' for event, script in heard.items())
    return (
        f'<div class="wv-over-hist"><div class="wv-brush" style="height:{HEIGHT_PX}px" '
        f'title="Drag to brush heights, click to clear" {handlers}><div style="{band}"></div>{grips}</div></div>'
    )


@dataclass(frozen=True, slots=True)
class Drag:
    """Drag on the histogram: the brush or grip, and the heights at its start and end.

    is_click: it did not move. Within `_AT_END` of an end of the histogram it includes all heights beyond.
    """

    act: Act
    from_um: float
    to_um: float
    is_click: bool


def parse_drag(key: str, ends_um: Span, span_um: Span) -> Drag:
    """Parse a drag event; `span_um` is the lowest and the highest of all heights."""
    act, first, last = key.split(":")
    from_um, to_um = (_height(float(share), ends_um, span_um) for share in (first, last))
    return Drag(_ACTS.get(act, "brush"), from_um, to_um, abs(float(first) - float(last)) < _CLICK)


def _height(share: float, ends_um: Span, span_um: Span) -> float:
    if share <= _AT_END:
        return min(span_um[0], ends_um[0])
    if share >= 1 - _AT_END:
        return max(span_um[1], ends_um[1])
    return ends_um[0] + share * (ends_um[1] - ends_um[0])
