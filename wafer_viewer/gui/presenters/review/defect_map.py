"""HTML of the die map: dies coloured by class or count, defect symbols, legend of die states."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from wafer_viewer.draw.charts.defect_map import DieFill, die_shapes, fills_by_count, kinds_of, look_svg
from wafer_viewer.draw.charts.defect_symbols import KINDS
from wafer_viewer.draw.charts.symbols import symbol
from wafer_viewer.draw.charts.wafer_map import MapViewport, Outline
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.presenters.review.defect_items import key_of
from wafer_viewer.gui.presenters.review.defects import JUDGED
from wafer_viewer.gui.state.defect_list_state import DefectListing, MapBy
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.inspection.defect import Defect, DefectClass, Inspection
from wafer_viewer.session.state.inspection_resources import OtherTool

BY: dict[MapBy, str] = {"class": "class", "count": "count"}
MOST_SIGNS = 400
"""With more defects no symbols are drawn, as they would overlap: dies have the colour of their commonest class."""
CLASS_OPACITY, JUDGED_OPACITY, OTHER_HALF_PX = 0.45, 0.35, 6


def map_head(listing: DefectListing) -> str:
    """Return the head with the switch between colouring by class and by count."""
    ways = "".join(
        f'<span class="{"on" if by == listing.map_by else ""}" aria-pressed="{str(by == listing.map_by).lower()}" '
        f"{html.pick('defect-map-by', by)}>{name}</span>"
        for by, name in BY.items()
    )
    switch = f'<span class="wv-by" aria-label="Coloured by">{ways}</span>'
    return f'<div class="wv-h first">Defects on the dies{switch}</div>'


def map_html(
    frame: MapViewport,
    inspection: Inspection,
    there: Sequence[Defect],
    listing: DefectListing,
    outline_um: Outline = (),
    over: str = "",
) -> str:
    """Return the map of dies with the defects `there`, and its legend; the SVG `over` is drawn on top."""
    many, by_class = len(there) > MOST_SIGNS, listing.map_by == "class"
    fills = fills_by_count(counts_of(there)) if not by_class else fills_by_class(there) if many else {}
    shapes = die_shapes(frame, inspection, fills, outline_um=outline_um, chosen=listing.die)
    signs = "".join(_sign(frame, defect) for defect in there) if by_class and not many else ""
    kinds = kinds_of(inspection.dies).items()
    legend = html.legend((look_svg(kind), f"{number(n, 0)} {kind}") for kind, n in kinds)
    said = "Each die has the colour of its commonest class." if by_class and many else ""
    below = f'<div class="wv-lab">{said}</div>' if said else ""
    return f'<div class="wv-dies-and">{_svg(frame, shapes + signs + over)}{legend}</div>{below}'


def fills_by_class(defects: Sequence[Defect]) -> dict[str, DieFill]:
    """Return the fill of each die by name: the colour of its commonest defect class."""
    on: dict[str, Counter[DefectClass]] = {}
    for defect in defects:
        on.setdefault(defect.die, Counter())[defect.seen_as] += 1
    return {die: DieFill(KINDS[max(kinds, key=kinds.__getitem__)].colour, CLASS_OPACITY) for die, kinds in on.items()}


def counts_of(defects: Sequence[Defect]) -> Counter[str]:
    """Count the defects on each die; unmeasured areas do not count."""
    return Counter(defect.die for defect in defects if defect.seen_as != "unmeasured")


def other_signs(frame: MapViewport, other: OtherTool) -> str:
    """Return squares at the defects of another tool; a symbol inside a square marks a match."""
    drawn: list[str] = []
    for defect, place in zip(other.klarf.defects, other.places, strict=True):
        (x0, y0, x1, y1), half = place.bounds_um, OTHER_HALF_PX
        x, y = frame.x((x0 + x1) / 2) - half, frame.y((y0 + y1) / 2) - half
        drawn.append(
            f'<rect x="{x:.1f}" y="{y:.1f}" width="{2 * half}" height="{2 * half}" fill="none" stroke="var(--ink2)">'
            f"<title>{html.safe(other.name)}: no. {defect.number}</title></rect>"
        )
    return f'<g class="wv-other">{"".join(drawn)}</g>'


def _sign(frame: MapViewport, defect: Defect) -> str:
    look, at = KINDS[defect.seen_as], (frame.x(defect.center.x_um), frame.y(defect.center.y_um))
    faint = "" if defect.judgement == "open" else f' opacity="{JUDGED_OPACITY}"'
    return (
        f'<g data-d="{key_of(defect)}" class="wv-go"{faint} stroke="var(--panel)" stroke-width="1.2" '
        f'paint-order="stroke"><title>D{defect.number} · {look.title}, {JUDGED[defect.judgement]}</title>'
        f"{symbol(look.shape, look.colour, *at, 3.6)}</g>"
    )


def _svg(frame: MapViewport, shapes: str) -> str:
    w, h = round(frame.width_px), round(frame.height_px)
    return (
        f'<div class="wv-dies"><svg class="wv-map wv-go" width="{w}" height="{h}" viewBox="0 0 {w} {h}" role="img" '
        f'aria-label="Dies of the sample with their defects" style="display:block" '
        f'onclick="{html.safe(_clicked(frame))}">{shapes}</svg></div>'
    )


def _clicked(frame: MapViewport) -> str:
    """Return the click script: a symbol picks its defect, elsewhere the stage position in µm, at any display scale."""
    x_um, y_um = frame.um_at(0.0, 0.0)
    return (
        "const g=event.target.closest('[data-d]');"
        f"if(g){{this.dataset.k=g.dataset.d;{html.pick_script('review')}}}else{{"
        "const p=new DOMPoint(event.clientX,event.clientY).matrixTransform(this.getScreenCTM().inverse());"
        f"this.dataset.k=({x_um:.3f}+p.x/{frame.scale:.9g}).toFixed(1)+','+({y_um:.3f}-p.y/{frame.scale:.9g}).toFixed(1);"
        f"{html.pick_script('defect-at')}}}"
    )
