"""Places of the live view at the left, and the objective over the sample from the side."""

from __future__ import annotations

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import number, with_unit
from wafer_viewer.gui.elements.elements import Button, Buttons, Elements, Html
from wafer_viewer.gui.elements.step import Here, Picks
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.session.acquisition.live_controller import KnownTop, known_top
from wafer_viewer.session.state.instrument_state import LivePlace
from wafer_viewer.session.state.snapshot import Snapshot

NOT_KEPT = "The place was not kept"
ICON = viser.Icon
_TOP_PX, _LOWEST_PX, _SAMPLE_PX = 44.0, 96.0, 118.0
"""Lower end of the objective at the safe z, at the lowest z, and top of the sample in the drawing."""


def live_places(here: Here[None]) -> Elements | None:
    """Return the places and the drawing at the left while Plan shows the camera."""
    snapshot, page, limits = here.snapshot, here.page, here.snapshot.rig.limits
    if not here.view.at_bench:
        return None
    side = side_view(limits, snapshot.rig.z_um, known_top(snapshot)) if limits is not None else None
    off = snapshot.rig.state not in ("ready", "moving")
    return [
        Html(html.head("Places", "click to go") + places_table(snapshot)),
        Buttons([Button("Keep this place", page.session.live.keep_place, ICON.MAP_PIN, disabled=off, commands=True)]),
        Html(html.head("Objective and sample", "not to scale") + side if side is not None else ""),
    ]


def _go_to(here: Here[None], key: str) -> None:
    """Drive to a place by its number in the list."""
    place = all_places(here.page.session.snapshot)[int(key)]
    goal = here.page.session.live.drive(x_um=place.x_um, y_um=place.y_um, z_um=place.z_um)
    here.page.ask("The stage did not move", goal)


PLACE_PICKS: Picks[None] = {
    "live-place": _go_to,
    "live-forget": lambda here, name: here.page.ask(NOT_KEPT, here.page.session.live.forget_place(name)),
}
"""What clicks on the places do."""


def all_places(snapshot: Snapshot) -> list[LivePlace]:
    """Return the marked corners, then the kept places."""
    return [*(corner for corner in snapshot.live.corners if corner is not None), *snapshot.live.places]


def places_table(snapshot: Snapshot) -> Markup:
    """Return the places with their positions in mm; a click drives there."""
    places = all_places(snapshot)
    if not places:
        return html.empty("Corners and kept places", "will be listed here.")
    kept = {place.name for place in snapshot.live.places}
    rows = [
        html.row(
            [
                place.name,
                *(number(um / 1000, 3, signed=True) for um in (place.x_um, place.y_um, place.z_um)),
                _forget(place.name) if place.name in kept else "",
            ],
            " nnn",
            html.command_pick("live-place", k),
        )
        for k, place in enumerate(places)
    ]
    return Markup('<div class="wv-places">{}</div>').format(
        html.table(["Name", "X, mm", "Y, mm", "Z, mm", ""], rows, " nnn", (None, 54, 54, 54, 20))
    )


def _forget(name: str) -> Markup:
    return Markup(
        '<span class="wv-action" title="Remove {name}" aria-label="Remove {name}" {pick}>{icon}</span>'
    ).format(name=name, pick=html.command_pick("live-forget", name), icon=html.icon(ICON.X, 13))


def side_view(limits: RigLimits, z_um: float, top: KnownTop | None) -> Markup:
    """Return the objective over the sample from the side: clearance, lowest z and safe z, with their figures."""
    objective = limits.objective
    lowest_um = top.stop_um if top is not None else limits.z.low_um
    safe_um = min(objective.safe_z_um, limits.z.high_um)
    share = (z_um - lowest_um) / max(safe_um - lowest_um, 1.0)
    front = _LOWEST_PX - min(max(share, -0.05), 1.05) * (_LOWEST_PX - _TOP_PX)
    clear = objective.working_distance_um + z_um - top.um if top is not None else None
    drawing = Markup(
        '<svg class="wv-side" viewBox="0 0 268 142" role="img" aria-label="Objective from the side">'
        '<path class="safe" d="M6 {safe}H262"/><text x="6" y="{safe_text}">safe z {safe_z}, moves pass above</text>'
        '<g transform="translate(0 {front:.1f})"><path class="glass" d="M112 -34h44v18l-10 14h-24l-10 -14z"/>'
        '<text x="134" y="-20" text-anchor="middle" class="mag">{mag} ×</text></g>'
        '<path class="beam" d="M124 {front:.1f}L134 {sample}L144 {front:.1f}z"/>'
        '<path class="stop" d="M20 {lowest}H104M164 {lowest}H216"/>'
        '<text x="20" y="{stop_text}" class="bad">z stops here</text>'
        '<path class="sample" d="M14 {sample}h60v-4h40v4h40v-6h50v6h50v8H14z"/>'
        '<path class="clear" d="M226 {front:.1f}V{sample}M222 {front:.1f}h8M222 {sample}h8"/>'
        '<text x="220" y="{clear_text:.1f}" text-anchor="end" class="good">{clear}</text></svg>'
    ).format(
        safe=_TOP_PX - 36,
        safe_text=_TOP_PX - 24,
        safe_z=f"{number(safe_um / 1000, 3, signed=True)} mm",
        front=front,
        mag=number(objective.magnification, 0),
        sample=_SAMPLE_PX,
        lowest=_LOWEST_PX + 6,
        stop_text=_LOWEST_PX + 2,
        clear_text=min((front + _SAMPLE_PX) / 2 + 4, _LOWEST_PX - 8),
        clear=_mm(clear) if clear is not None else "",
    )
    known = [("Highest known z", with_unit(top.um, 1, signed=True)), ("known from", top.source)] if top else []
    rows = [
        *known,
        ("Clearance above it", _mm(clear) if clear is not None else "not known"),
        ("z stops automatically at", _mm(objective.clearance_um) if top else with_unit(lowest_um, 0, signed=True)),
    ]
    return drawing + html.pairs(rows)


def _mm(um: float) -> str:
    return with_unit(um / 1000, 2, "mm")
