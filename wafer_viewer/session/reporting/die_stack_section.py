"""Die stack of a report: all dies overlaid in one drawing, and a sentence for each repeating defect position."""

from __future__ import annotations

import base64
from collections.abc import Iterator

from wafer_viewer.draw.charts.defect_symbols import KINDS
from wafer_viewer.draw.charts.die_stack import die_stack_svg
from wafer_viewer.draw.number_format import number
from wafer_viewer.model.inspection.defect import Inspection
from wafer_viewer.model.report import Figure
from wafer_viewer.session.reporting.report_data import Material

MOST_PLACES = 10
"""Maximum number of listed positions; the report gives the number of further ones."""
WIDTH_PX = 420


def stacked(material: Material, found: Inspection) -> Iterator[Figure]:
    """Yield the figure with the defects of all dies overlaid; none without dies or without defects on them."""
    from wafer_viewer.measure.defects.repeaters import repeated_places

    if found.grid is None or not any(defect.die for defect in found.found):
        return
    places = repeated_places(found)
    ringed = " Rings: places that repeat." if places else ""
    caption = f"All dies overlaid, their defects by class.{ringed}"
    yield Figure("", caption, svg=die_stack_svg(found, places, _ground(material, found), width_px=WIDTH_PX))


def repeated(found: Inspection) -> Iterator[str]:
    """Yield the positions at which several dies have a defect."""
    from wafer_viewer.measure.defects.repeaters import repeated_places

    places = repeated_places(found)
    if places:
        yield "Defects that repeat at the same place of several dies are systematic, of the mask or the process."
    for k, place in enumerate(places[:MOST_PLACES], 1):
        x, y = number(place.in_die.x_um, 1), number(place.in_die.y_um, 1)
        kind = KINDS[place.kind].title.lower()
        yield f"Place {k}, x {x}, y {y} µm of the die: {kind} {place.words}."
    if len(places) > MOST_PLACES:
        yield f"{len(places) - MOST_PLACES} more places repeat."


def _ground(material: Material, found: Inspection) -> str:
    """Return the picture of the typical die as a data URL; empty if there is none."""
    from wafer_viewer.session.inspection.reference_views import like_die
    from wafer_viewer.session.rendering.render_comparisons import picture_of_die

    if material.info is None or not material.result.has_mosaic:
        return ""
    seen = picture_of_die(material.result.mosaic(), material.dataset.path.parent, like_die(found))
    return f"data:image/jpeg;base64,{base64.b64encode(seen.picture).decode()}" if seen.picture else ""
