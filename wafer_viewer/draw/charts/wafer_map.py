"""Map of the left panel as SVG: outline, dies, fields coloured by state, and frequently changing marks.

Colours are the page's custom properties (``--ink``, ``--accent``, ...), so one drawing serves light and dark.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from wafer_viewer.draw.charts.axes import symbol
from wafer_viewer.model.acquisition.plan import Field

Outline = Sequence[tuple[float, float]]
Box = tuple[float, float, float, float]
"""(x low, y low, x high, y high) in um."""


@dataclass(frozen=True, slots=True)
class FieldStyle:
    """Drawing style of a field state: edge colour, fill opacity, title, dashes, weight, sign next to the number."""

    edge: str
    fill_opacity: float
    title: str
    dashed: bool = False
    heavy: bool = False
    sign: str = ""


FIELD_INKS: dict[str, FieldStyle] = {
    "planned": FieldStyle("accent", 0.10, "planned"),
    "to come": FieldStyle("ink3", 0.0, "pending", dashed=True),
    "being taken": FieldStyle("accent", 0.0, "scanning", heavy=True),
    "taken": FieldStyle("accent", 0.08, "scanned"),
    "in reconstruction": FieldStyle("accent", 0.14, "reconstructing"),
    "measured": FieldStyle("accent", 0.30, "measured"),
    "to repeat": FieldStyle("warn", 0.25, "to repeat", sign="!"),
    "failed": FieldStyle("bad", 0.22, "failed", sign="×"),
}
"""Styles by state name. A state has a sign if colour alone would identify it."""

_MARGIN_PX = 4
_ZOOM_UNDER = 0.45
"""Share of the sample below which the fields are enlarged, with the sample as an inset."""
_INSET_PX = 54
WIDTH_PX, MOST_HEIGHT_PX = 276, 236
MOST_SINGLE = 400
"""Greatest number of fields drawn as separate elements with number and name."""
_LEAST_FOR_NUMBER_PX = 13


@dataclass(frozen=True, slots=True)
class MapViewport:
    """Transform from stage um to image px: x to the right, y upwards."""

    box: Box
    width_px: float
    height_px: float
    left_px: float = 0.0
    top_px: float = 0.0

    @property
    def scale(self) -> float:
        """Pixels per um."""
        x0, y0, x1, y1 = self.box
        return min((self.width_px - 2 * _MARGIN_PX) / (x1 - x0), (self.height_px - 2 * _MARGIN_PX) / (y1 - y0))

    def x(self, x_um: float) -> float:
        """Return the image x of a stage x."""
        x0, _, x1, _ = self.box
        return self.left_px + self.width_px / 2 + (x_um - (x0 + x1) / 2) * self.scale

    def y(self, y_um: float) -> float:
        """Return the image y of a stage y."""
        _, y0, _, y1 = self.box
        return self.top_px + self.height_px / 2 - (y_um - (y0 + y1) / 2) * self.scale

    def um_at(self, x_px: float, y_px: float) -> tuple[float, float]:
        """Return the stage position of an image position."""
        x0, y0, x1, y1 = self.box
        x_um = (x0 + x1) / 2 + (x_px - self.left_px - self.width_px / 2) / self.scale
        return x_um, (y0 + y1) / 2 - (y_px - self.top_px - self.height_px / 2) / self.scale

    @property
    def place_attributes(self) -> Markup:
        """Attributes of a drawing whose clicks are picks of a stage position (events.js)."""
        x_um, y_um = self.um_at(0.0, 0.0)
        return Markup('data-where="map" data-frame="{:.3f},{:.3f},{:.9g}"').format(x_um, y_um, self.scale)


def map_frame(
    fields: Sequence[Field],
    field_width_um: float,
    field_height_um: float,
    outline_um: Outline = (),
    *,
    width_px: int = WIDTH_PX,
    most_height_px: int = MOST_HEIGHT_PX,
) -> MapViewport | None:
    """Return the viewport of the map of these fields; None if there is nothing to draw."""
    of_fields = _bounds(_corners(fields, field_width_um, field_height_um))
    extent = _bounds([*outline_um, *_corners(fields, field_width_um, field_height_um)])
    if extent is None:
        return None
    return _fitted(_padded(of_fields, 0.16) if _zoomed(of_fields, extent) else extent, width_px, most_height_px)


def field_map_svg(
    fields: Sequence[Field],
    field_width_um: float,
    field_height_um: float,
    states: Mapping[int, str] | None = None,
    *,
    outline_um: Outline = (),
    dies_um: Sequence[Outline] = (),
    selected: int | None = None,
    pick: str = "",
    pick_place: str = "",
    width_px: int = WIDTH_PX,
    most_height_px: int = MOST_HEIGHT_PX,
) -> Markup:
    """Return the map. `states` by field number are keys of `FIELD_INKS`; the default state is planned.

    Each field is a focusable group with ``data-k`` (its number), which a click picks as `pick`. Above `MOST_SINGLE`
    fields, those of one state are one shape. A click outside the fields picks the position, stage um, as `pick_place`.
    """
    frame = map_frame(
        fields, field_width_um, field_height_um, outline_um, width_px=width_px, most_height_px=most_height_px
    )
    if frame is None:
        return Markup()
    extent = _bounds([*outline_um, *_corners(fields, field_width_um, field_height_um)])
    of_fields = _bounds(_corners(fields, field_width_um, field_height_um))
    inks = [(f, FIELD_INKS[(states or {}).get(f.number, "planned")]) for f in fields]
    draw = _merged_shapes if len(fields) > MOST_SINGLE else _singly
    parts = [
        _sample(frame, outline_um, dies_um),
        draw(frame, inks, (field_width_um, field_height_um), selected, pick),
    ]
    if extent and of_fields and _zoomed(of_fields, extent):
        parts.append(_inset(frame, extent, of_fields, outline_um))
    size = Markup('width="{:.0f}" height="{:.0f}"').format(frame.width_px, frame.height_px)
    place = Markup(' data-pick="{}" {}').format(pick_place, frame.place_attributes) if pick_place else Markup()
    head = Markup('<svg {} class="wv-map" role="img" aria-label="Map of the sample" style="display:block"{}>').format(
        size, place
    )
    return Markup("{}{}</svg>").format(head, Markup("").join(parts))


def _singly(
    frame: MapViewport,
    inks: Sequence[tuple[Field, FieldStyle]],
    size_um: tuple[float, float],
    selected: int | None,
    pick: str,
) -> Markup:
    """Return every field with its number, the selected one on top."""
    order = sorted(inks, key=lambda pair: (pair[0].number == selected, pair[0].number))
    return Markup("").join(_field(frame, f, *size_um, ink, f.number == selected, pick) for f, ink in order)


def _merged_shapes(
    frame: MapViewport,
    inks: Sequence[tuple[Field, FieldStyle]],
    size_um: tuple[float, float],
    selected: int | None,
    pick: str,
) -> Markup:
    """Return one shape per state for large numbers of fields, with the selected field on top."""
    w, h = (max(0.8, side * frame.scale - 0.3) for side in size_um)
    shapes: dict[FieldStyle, list[str]] = {}
    for field, ink in inks:
        x, y = frame.x(field.x_um - size_um[0] / 2), frame.y(field.y_um + size_um[1] / 2)
        shapes.setdefault(ink, []).append(f"M{x:.1f} {y:.1f}h{w:.1f}v{h:.1f}h-{w:.1f}z")
    drawn = Markup("").join(
        Markup(
            '<path d="{shape}" fill="var(--{edge})" fill-opacity="{fill_opacity:g}" '
            'stroke="var(--{edge})" stroke-width=".4"><title>{title}</title></path>'
        ).format(shape=Markup("").join(shape), edge=ink.edge, fill_opacity=max(ink.fill_opacity, 0.12), title=ink.title)
        for ink, shape in shapes.items()
    )
    chosen = [(field, ink) for field, ink in inks if field.number == selected]
    return drawn + _singly(frame, chosen, size_um, selected, pick)


def _sample(frame: MapViewport, outline_um: Outline, dies_um: Sequence[Outline]) -> Markup:
    """Return the sample outline and those dies that are large enough to be visible."""
    if len(outline_um) < 3:
        return Markup()
    edge = _points(frame, outline_um)
    out = Markup('<polygon points="{}" fill="var(--fill)" stroke="var(--ink3)" stroke-width="1.3"/>').format(edge)
    shown = [die for die in dies_um if _is_visible(frame, die)]
    dies = Markup("").join(Markup('<polygon points="{}"/>').format(_points(frame, die)) for die in shown)
    return out + Markup('<g fill="none" stroke="var(--line)" stroke-width="1.2">{}</g>').format(dies)


def _field(
    frame: MapViewport, field: Field, width_um: float, height_um: float, ink: FieldStyle, selected: bool, pick: str
) -> Markup:
    x, y = frame.x(field.x_um - width_um / 2) + 0.5, frame.y(field.y_um + height_um / 2) + 0.5
    w, h = max(1.0, width_um * frame.scale - 1), max(1.0, height_um * frame.scale - 1)
    picked = Markup(' data-pick="{}" style="cursor:pointer"').format(pick) if pick else Markup()
    name = f"Field {field.number}, {ink.title}"
    return Markup(
        '<g data-k="{number}" tabindex="0" role="button" aria-label="{name}"{picked}>'
        "<title>{name}</title>{box}"
        "{number2}</g>"
    ).format(
        number=field.number,
        name=name,
        picked=picked,
        box=_box(x, y, w, h, ink, selected),
        number2=_number(field.number, ink, x + w / 2, y + h / 2, min(w, h)),
    )


def _box(x: float, y: float, w: float, h: float, ink: FieldStyle, selected: bool) -> Markup:
    dashes = Markup(' stroke-dasharray="3 3"') if ink.dashed else Markup()
    weight = 2.6 if ink.heavy or selected else 1.2
    edge = "ink" if selected else ink.edge
    place = Markup('x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}"').format(x=x, y=y, w=w, h=h)
    return Markup(
        '<rect {place} fill="var(--{edge})" fill-opacity="{fill_opacity:g}" '
        'stroke="var(--{edge2})" stroke-width="{weight}"{dashes}/>'
    ).format(place=place, edge=ink.edge, fill_opacity=ink.fill_opacity, edge2=edge, weight=weight, dashes=dashes)


def _number(number: int, ink: FieldStyle, x: float, y: float, room_px: float) -> Markup:
    if room_px < _LEAST_FOR_NUMBER_PX:
        return Markup()
    size = min(13.0, room_px * 0.62)
    colour = ink.edge if ink.edge in ("warn", "bad", "ink3") else "ink"
    text = f"{number} {ink.sign}".strip()
    weight = 700 if ink.heavy or ink.sign else 550
    return Markup(
        '<text x="{x:.1f}" y="{y:.1f}" text-anchor="middle" font-size="{size:.1f}" '
        'font-weight="{weight}" fill="var(--{colour})">{text}</text>'
    ).format(x=x, y=y + 0.36 * size, size=size, weight=weight, colour=colour, text=text)


def _inset(frame: MapViewport, extent: Box, of_fields: Box, outline_um: Outline) -> Markup:
    """Return an overview of the sample in the lower right corner, with the area of the fields."""
    left, top = frame.width_px - _INSET_PX, frame.height_px - _INSET_PX
    small = MapViewport(extent, _INSET_PX, _INSET_PX, left, top)
    x, y = small.x(of_fields[0]), small.y(of_fields[3])
    w, h = (max(3.0, (of_fields[k + 2] - of_fields[k]) * small.scale) for k in (0, 1))
    return Markup(
        '<rect x="{left:.0f}" y="{top:.0f}" width="{inset_px}" height="{inset_px}" rx="4" fill="var(--panel)" '
        'fill-opacity=".9" stroke="var(--line)"/>'
        '<polygon points="{points}" fill="var(--fill)" stroke="var(--ink3)"/>'
        '<rect x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}" fill="var(--accent)"/>'
    ).format(left=left, top=top, inset_px=_INSET_PX, points=_points(small, outline_um), x=x, y=y, w=w, h=h)


def _corners(fields: Sequence[Field], width_um: float, height_um: float) -> list[tuple[float, float]]:
    half = ((-width_um / 2, -height_um / 2), (width_um / 2, height_um / 2))
    return [(f.x_um + dx, f.y_um + dy) for f in fields for dx, dy in half]


def _bounds(points: Sequence[tuple[float, float]]) -> Box | None:
    if not points:
        return None
    xs, ys = [p[0] for p in points], [p[1] for p in points]
    return min(xs), min(ys), max(xs), max(ys)


def _zoomed(of_fields: Box | None, extent: Box) -> bool:
    """Return whether the fields are enlarged, with the sample as an inset."""
    return of_fields is not None and _share(of_fields, extent) < _ZOOM_UNDER


def _share(part: Box, total: Box) -> float:
    """Return the larger of the fractions of width and height."""
    return max((part[k + 2] - part[k]) / max(total[k + 2] - total[k], 1e-9) for k in (0, 1))


def _padded(box: Box | None, share: float) -> Box:
    box = box or (0.0, 0.0, 1.0, 1.0)
    pad = share * max(box[2] - box[0], box[3] - box[1])
    return box[0] - pad, box[1] - pad, box[2] + pad, box[3] + pad


def _fitted(box: Box, width_px: int, most_height_px: int) -> MapViewport:
    """Return a viewport as wide as the panel, with the height of its contents."""
    aspect = (box[3] - box[1]) / max(box[2] - box[0], 1e-9)
    return MapViewport(
        box, width_px, min(most_height_px, max(60.0, (width_px - 2 * _MARGIN_PX) * aspect + 2 * _MARGIN_PX))
    )


def _is_visible(frame: MapViewport, die: Outline) -> bool:
    box = _bounds(die)
    if box is None or (box[2] - box[0]) * frame.scale < 3:
        return False
    inside_x = frame.x(box[2]) > 0 and frame.x(box[0]) < frame.width_px
    return inside_x and frame.y(box[1]) > 0 and frame.y(box[3]) < frame.height_px


def _points(frame: MapViewport, corners: Outline) -> str:
    return " ".join(f"{frame.x(x):.1f},{frame.y(y):.1f}" for x, y in corners)


_LEAST_VIEW_PX = 5.0
"""Size of a view in px below which it is drawn as a cross."""

_LEAST_AREA_PX = 3.0


@dataclass(frozen=True, slots=True)
class MapMark:
    """Mark on the map, stage um, with the colour and shape of its symbol and its name.

    `attributes` are HTML attributes that make it clickable.
    """

    x_um: float
    y_um: float
    colour: str
    name: str
    chosen: bool = False
    attributes: str = ""
    shape: str = "disc"


@dataclass(frozen=True, slots=True)
class MarkedArea:
    """Rectangle on the map, x low, y low, x high, y high in stage um, with a colour; if dashed, it is not filled."""

    box_um: tuple[float, float, float, float]
    colour: str
    name: str
    dashed: bool = False


def map_marks_svg(
    frame: MapViewport, view_um: Outline, marks: Sequence[MapMark], areas: Sequence[MarkedArea] = ()
) -> Markup:
    """Return the overlay in the size of the map; `view_um`: corners of the area in the camera view."""
    shapes = [*(_area(frame, area) for area in areas), *_camera_view(frame, view_um)]
    shapes += [*(_mark(frame, mark) for mark in sorted(marks, key=lambda mark: mark.chosen))]
    w, h = f"{frame.width_px:.0f}", f"{frame.height_px:.0f}"
    size = Markup('width="{w}" height="{h}" viewBox="0 0 {w} {h}"').format(w=w, h=h)
    return (
        Markup('<svg {} class="wv-map-marks" style="display:block">{}</svg>').format(size, Markup("").join(shapes))
        if shapes
        else Markup()
    )


def _area(frame: MapViewport, area: MarkedArea) -> Markup:
    x0, y0, x1, y1 = area.box_um
    left, top = frame.x(x0), frame.y(y1)
    width, height = (max(_LEAST_AREA_PX, v) for v in (frame.x(x1) - left, frame.y(y0) - top))
    look = Markup('fill="none" stroke="{}" stroke-width="1.8" stroke-dasharray="5 3"').format(area.colour)
    look = look if area.dashed else Markup('fill="{}" fill-opacity=".75"').format(area.colour)
    place = Markup('x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" height="{height:.1f}"').format(
        left=left, top=top, width=width, height=height
    )
    return Markup("<rect {} {}><title>{}</title></rect>").format(place, look, area.name)


def _camera_view(frame: MapViewport, corners_um: Outline) -> list[str]:
    if len(corners_um) < 3:
        return []
    points = [(frame.x(x), frame.y(y)) for x, y in corners_um]
    xs, ys = [x for x, _ in points], [y for _, y in points]
    style = Markup('fill="none" stroke="var(--attention)" stroke-width="1.6" stroke-linejoin="round"')
    if max(max(xs) - min(xs), max(ys) - min(ys)) < _LEAST_VIEW_PX:
        x, y = sum(xs) / len(xs), sum(ys) / len(ys)
        return [
            Markup('<path d="M{x:.1f} {y:.1f}h14M{x2:.1f} {y2:.1f}v14" {style}/>').format(
                x=x - 7, y=y, x2=x, y2=y - 7, style=style
            )
        ]
    return [Markup('<polygon points="{}" {}/>').format(Markup(" ").join(f"{x:.1f},{y:.1f}" for x, y in points), style)]


def _mark(frame: MapViewport, mark: MapMark) -> Markup:
    x, y = frame.x(mark.x_um), frame.y(mark.y_um)
    ring = Markup('<circle cx="{:.1f}" cy="{:.1f}" r="7" fill="none" stroke="var(--ink)" stroke-width="1.6"/>').format(
        x, y
    )
    name = mark.name
    return Markup(
        '<g {attributes} aria-label="{name}"><title>{name}</title>{ring}'
        '<g stroke="#fff" stroke-width="1.2" paint-order="stroke">{symbol}</g></g>'
    ).format(
        attributes=mark.attributes,
        name=name,
        ring=ring if mark.chosen else "",
        symbol=symbol(mark.shape, mark.colour, x, y, 3.6),
    )
