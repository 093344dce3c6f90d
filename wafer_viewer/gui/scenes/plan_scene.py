"""Scene of the plan: the sample on the stage, as the overview camera sees it, with the field grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import viser
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from wafer_viewer.draw.colormaps import Rgb, rgb, table
from wafer_viewer.draw.number_format import with_unit
from wafer_viewer.draw.surface import mesh, texture_baking
from wafer_viewer.draw.surface.mesh import painted
from wafer_viewer.gui.scene.camera_presets import Clear
from wafer_viewer.gui.scene.primitives import (
    Box,
    Group,
    add_glb,
    add_image_plane,
    cased,
    closed,
    dashed,
    image_plane,
    lines,
    polyline_segments,
    rectangle,
    word,
)
from wafer_viewer.gui.scene.reconciler import Handle, SceneItem
from wafer_viewer.gui.scene.scene_contents import SceneContents, colours, corners_of
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.acquisition.devices import Overview
from wafer_viewer.model.acquisition.plan import CoarseLook, Field, FieldFocus, FollowFocus, ScanPlan
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.job import Job
from wafer_viewer.session.state.snapshot import Draft, Snapshot

# ------------------------------------------------------------------------------------------------------- field outlines


_WHITE = (255, 255, 255)
_DARK_PLATE = (21, 32, 43)
_MOST_NUMBERS = 150
"""Beyond this count field numbers are shown only on the map in the panel."""
_OVERLAP_PX = 1000
_AT_ZERO = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=0.0)


def field_box(field: Field, width_um: float, height_um: float) -> Box:
    """Return the frame of a field in mm."""
    x, y, w, h = field.x_um * 1e-3, field.y_um * 1e-3, width_um / 2e3, height_um / 2e3
    return x - w, y - h, x + w, y + h


def fields_box(fields: Sequence[Field], width_um: float, height_um: float) -> Box:
    """Return the bounding box of all frames."""
    boxes = np.array([field_box(f, width_um, height_um) for f in fields])
    low, high = boxes.min(axis=0), boxes.max(axis=0)
    return float(low[0]), float(low[1]), float(high[2]), float(high[3])


def planned_items(
    fields: tuple[Field, ...], width_um: float, height_um: float, plan: ScanPlan | None, dark: bool
) -> list[SceneItem]:
    """Return the items of the planned grid."""
    key, frames = (fields, width_um, height_um, dark), partial(field_box, width_um=width_um, height_um=height_um)
    boxes = [frames(f) for f in fields]
    items = [
        SceneItem("grid/overlap", key, partial(_overlap, boxes=boxes, dark=dark)),
        SceneItem("grid/lines", key, partial(_frames, boxes=boxes, dark=dark)),
        SceneItem("grid/size", key, partial(_size, box=fields_box(fields, width_um, height_um))),
    ]
    if len(fields) <= _MOST_NUMBERS:
        items.append(SceneItem("grid/numbers", key, partial(_numbers, fields=fields, boxes=boxes, dark=dark)))
    points = stage_path(plan) if plan is not None else []
    if len(points) > 1:
        items.append(SceneItem("grid/way", (tuple(points), dark), partial(_path, points=points, unit=_unit(boxes))))
    return items


def _unit(boxes: list[Box]) -> float:
    """Return the reference length of the drawings: the shorter side of a field."""
    return min(boxes[0][2] - boxes[0][0], boxes[0][3] - boxes[0][1])


def _frames(scene: viser.SceneApi, name: str, _: bytes, *, boxes: list[Box], dark: bool) -> Group:
    segments = np.concatenate([rectangle(box, 0.006 * _unit(boxes)) for box in boxes])
    casing = _WHITE if not dark else (13, 18, 23)
    return cased(scene, name, segments, colours(dark).accent, 2.4, 0.004 * _unit(boxes), casing)


def _numbers(
    scene: viser.SceneApi, name: str, _: bytes, *, fields: tuple[Field, ...], boxes: list[Box], dark: bool
) -> Group:
    accent, ink, unit = colours(dark).accent, _WHITE if not dark else (11, 15, 19), _unit(boxes)
    inset = 0.13 * unit
    return Group(
        *(
            word(
                scene, f"{name}/{field.number}", str(field.number),
                (box[0] + inset, box[3] - inset, 0.02 * unit), 0.24 * unit, ink, accent, (0.0, 1.0),
            )
            for field, box in zip(fields, boxes, strict=True)
        )
    )  # fmt: skip


def _overlap(scene: viser.SceneApi, name: str, _: bytes, *, boxes: list[Box], dark: bool) -> Handle:
    """Draw one image over all fields: lightly tinted where covered once, darker where fields overlap."""
    x0, y0 = min(b[0] for b in boxes), min(b[1] for b in boxes)
    x1, y1 = max(b[2] for b in boxes), max(b[3] for b in boxes)
    scale = _OVERLAP_PX / max(x1 - x0, y1 - y0)
    count = np.zeros((max(2, round((y1 - y0) * scale)), max(2, round((x1 - x0) * scale))), np.uint8)
    for box in boxes:
        rows = slice(round((y1 - box[3]) * scale), round((y1 - box[1]) * scale))
        cols = slice(round((box[0] - x0) * scale), round((box[2] - x0) * scale))
        count[rows, cols] = np.minimum(count[rows, cols] + 1, 2)
    alpha = np.array([0, 34, 118], np.uint8)[count]
    picture = np.dstack([np.full((*count.shape, 3), colours(dark).accent, np.uint8), alpha])
    return add_image_plane(scene, name, picture, (x0, y0, x1, y1), 0.003 * _unit(boxes))


def _size(scene: viser.SceneApi, name: str, _: bytes, *, box: Box) -> Group:
    """Draw the grid's width below it and its height to the left."""
    side = max(box[2] - box[0], box[3] - box[1])
    high, gap, z = 0.042 * side, 0.02 * side, 0.004 * side
    width_um, height_um = (box[2] - box[0]) * 1e3, (box[3] - box[1]) * 1e3
    at_foot, at_left = ((box[0] + box[2]) / 2, box[1] - gap, z), (box[0] - gap, (box[1] + box[3]) / 2, z)
    return Group(
        word(scene, f"{name}/w", with_unit(width_um, 0), at_foot, high, _WHITE, _DARK_PLATE, (0.5, 1.0)),
        word(scene, f"{name}/h", with_unit(height_um, 0), at_left, high, _WHITE, _DARK_PLATE, (1.0, 0.5)),
    )


def stage_path(plan: ScanPlan) -> list[tuple[float, float]]:
    """Return the stage path, x and y in um: the fields of each leg's first and last shot, each segment once."""
    places = {f.number: (f.x_um, f.y_um) for f in plan.fields}
    points: list[tuple[float, float]] = []
    gone: set[frozenset[tuple[float, float]]] = set()
    for leg in plan.legs:
        for place in (places[leg.shots[0].field], places[leg.shots[-1].field]):
            stretch = frozenset((points[-1], place)) if points else frozenset((place,))
            if len(stretch) == 1 and points:
                continue
            if stretch in gone:
                return points
            gone.add(stretch)
            points.append(place)
    return points


def _path(scene: viser.SceneApi, name: str, _: bytes, *, points: list[tuple[float, float]], unit: float) -> Group:
    vertices = np.array([(x * 1e-3, y * 1e-3, 0.016 * unit) for x, y in points], np.float32)
    dashes = dashed(polyline_segments(vertices), 0.13 * unit, 0.5)
    start = scene.add_icosphere(
        f"{name}/start",
        0.055 * unit,
        (213, 94, 0),
        position=tuple(vertices[0]),
        cast_shadow=False,
        receive_shadow=False,
    )
    return Group(cased(scene, f"{name}/line", dashes, (200, 80, 0), 2.2, 0.004 * unit, _WHITE), start)


# ---------------------------------------------------------------- while scanning


def flat_items(
    fields: list[Field], taken: set[int], width_um: float, height_um: float, z: float, dark: bool
) -> list[SceneItem]:
    """Return fields without a surface, flat with their numbers; dashed until their frames are taken.

    Very many are two items of lines: fields that are taken, and the others.
    """
    if len(fields) > _MOST_NUMBERS:
        parts = {"taken": [f for f in fields if f.number in taken]}
        parts["rest"] = [f for f in fields if f.number not in taken]
        return [
            SceneItem(
                f"flat/{name}", (tuple(f.number for f in part), width_um, height_um, z, dark),
                partial(_flat_many, fields=part, size_um=(width_um, height_um), taken=name == "taken", z=z, dark=dark),
            )
            for name, part in parts.items() if part
        ]  # fmt: skip
    return [
        SceneItem(
            f"flat/{f.number}", (f, f.number in taken, width_um, height_um, z, dark),
            partial(_flat, field=f, box=field_box(f, width_um, height_um), taken=f.number in taken, z=z, dark=dark),
        )
        for f in fields
    ]  # fmt: skip


def _flat(
    scene: viser.SceneApi, name: str, _: bytes, *, field: Field, box: Box, taken: bool, z: float, dark: bool
) -> Group:
    unit, ink = _unit([box]), colours(dark).accent if taken else colours(dark).ink
    inset = 0.02 * unit
    inner = (box[0] + inset, box[1] + inset, box[2] - inset, box[3] - inset)
    centre = ((box[0] + box[2]) / 2, (box[1] + box[3]) / 2, z + 0.012 * unit)
    edge = rectangle(inner, z + 0.01 * unit)
    return Group(
        lines(scene, f"{name}/frame", edge if taken else dashed(edge, 0.08 * unit), ink, 1.8),
        word(scene, f"{name}/number", str(field.number), centre, 0.3 * unit, ink),
    )


def _flat_many(
    scene: viser.SceneApi,
    name: str,
    _: bytes,
    *,
    fields: list[Field],
    size_um: tuple[float, float],
    taken: bool,
    z: float,
    dark: bool,
) -> Handle:
    middles = np.array([(f.x_um, f.y_um) for f in fields]) * 1e-3
    unit = min(size_um) * 1e-3
    one = rectangle(field_box(_AT_ZERO, *size_um), z + 0.01 * unit)
    edges = one[None] + np.pad(middles, ((0, 0), (0, 1)))[:, None, None].astype(np.float32)
    ink = colours(dark).accent if taken else colours(dark).ink
    return lines(scene, name, edges.reshape(-1, 2, 3), ink, 1.8)


def box_edges(box: Box, low: float, high: float) -> NDArray[np.float32]:
    """Return the twelve edges of an upright box, [12, 2, 3]."""
    x0, y0, x1, y1 = box
    posts = np.array([[(x, y, low), (x, y, high)] for x in (x0, x1) for y in (y0, y1)], np.float32)
    return np.concatenate([rectangle(box, low), rectangle(box, high), posts])


# ----------------------------------------------------------------------------------------------------------- plan scene


_PICTURE_SIDE_PX = 1400
_STAGE_MM = 6.0
"""Largest drawn extent of an empty stage."""
_DIMMED = 0.5


def sample_box(snapshot: Snapshot) -> Box | None:
    """Return the bounding box of the sample's outline, or its size centred on the stage; None if neither is known."""
    if snapshot.overview is not None and snapshot.overview.outline_um:
        xs, ys = zip(*snapshot.overview.outline_um, strict=True)
        return min(xs) * 1e-3, min(ys) * 1e-3, max(xs) * 1e-3, max(ys) * 1e-3
    job = snapshot.draft.job
    if job is None or (size_um := job.sample.size_um) is None:
        return None
    half_x, half_y = size_um[0] / 2e3, size_um[1] / 2e3
    return -half_x, -half_y, half_x, half_y


def reach_box(limits: RigLimits | None) -> Box:
    """Return the drawn part of the stage: the travel of its axes, or a default size."""
    if limits is None:
        return -_STAGE_MM / 2, -_STAGE_MM / 2.4, _STAGE_MM / 2, _STAGE_MM / 2.4
    return limits.x.low_um * 1e-3, limits.y.low_um * 1e-3, limits.x.high_um * 1e-3, limits.y.high_um * 1e-3


def sample_items(snapshot: Snapshot, dark: bool, z: float = 0.0, *, dimmed: bool = False) -> list[SceneItem]:
    """Return the overview image with outline and shadow, or the grid of the stage."""
    box, overview = sample_box(snapshot), snapshot.overview
    if box is None:
        limits = snapshot.rig.limits
        return [SceneItem("stage", (limits, dark, z), partial(_stage_grid, box=reach_box(limits), dark=dark, z=z))]
    outline = overview.outline_um if overview is not None and overview.outline_um else _corners_um(box)
    items = [
        SceneItem("sample/shadow", (outline, dark, z), add_glb, bake=partial(_shadow, outline, box, dark, z)),
        SceneItem("sample/outline", (outline, dark, z), partial(_outline, outline=outline, dark=dark, z=z)),
    ]
    if overview is not None and overview.image is not None:
        picture = partial(_picture, overview, dark, z, dimmed)
        items.append(SceneItem("sample/picture", (overview, dark, z, dimmed), add_glb, bake=picture))
    return items


def _corners_um(box: Box) -> tuple[tuple[float, float], ...]:
    x0, y0, x1, y1 = (v * 1e3 for v in box)
    return (x0, y0), (x1, y0), (x1, y1), (x0, y1)


def _outline(
    scene: viser.SceneApi, name: str, _: bytes, *, outline: tuple[tuple[float, float], ...], dark: bool, z: float
) -> Handle:
    corners = [(x * 1e-3, y * 1e-3) for x, y in outline]
    return lines(scene, name, closed(corners, z + 1e-3), colours(dark).soft_ink, 1.6)


def _shadow(outline: tuple[tuple[float, float], ...], box: Box, dark: bool, z: float) -> bytes:
    palette, pad = colours(dark), 0.14 * max(box[2] - box[0], box[3] - box[1])
    width, height = box[2] - box[0] + 2 * pad, box[3] - box[1] + 2 * pad
    down = [(x * 1e-3 - box[0] + pad, box[3] + pad - y * 1e-3) for x, y in outline]
    picture = texture_baking.shadow(
        down, width, height, pad / 3,
        darkness=palette.shadow_strength * 0.9, shade=palette.shadow, long_side_px=640,
    )  # fmt: skip
    return image_plane(picture, (box[0] - pad, box[1] - pad, box[2] + pad, box[3] + pad), z - 0.01)


def _picture(overview: Overview, dark: bool, z: float, dimmed: bool) -> bytes:
    """Return the overview image cut out along the sample's outline, blended with the ground colour if dimmed."""
    image = _smaller(overview.image)
    picture = _tinted(image, colours(dark).ground, _DIMMED if dimmed else 0.0, dark)
    rows, cols = (overview.image.shape if overview.image is not None else (1, 1))[:2]
    edge_x, edge_y = overview.x0_um - overview.pixel_um / 2, overview.y0_um + overview.pixel_um / 2
    width, height = cols * overview.pixel_um, rows * overview.pixel_um
    box = (edge_x * 1e-3, (edge_y - height) * 1e-3, (edge_x + width) * 1e-3, edge_y * 1e-3)
    if overview.outline_um:
        picture = _cut_out(picture, [((x - edge_x) / width, (edge_y - y) / height) for x, y in overview.outline_um])
    return image_plane(picture, box, z, blend=False)


def _smaller(image: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
    """Return the image reduced to the largest size that the scene can use."""
    if image is None:
        return np.zeros((2, 2), np.uint8)
    share = _PICTURE_SIDE_PX / max(image.shape)
    if share >= 1:
        return image
    size = (max(1, round(image.shape[1] * share)), max(1, round(image.shape[0] * share)))
    return np.asarray(Image.fromarray(image).resize(size, Image.Resampling.BOX))


def _tinted(image: NDArray[np.uint8], ground_colour: Rgb, towards: float, dark: bool) -> NDArray[np.uint8]:
    """Return a bluish grey image in a range with good contrast to lines."""
    grey = np.arange(256, dtype=float)[:, None] / 255
    shown = (grey**0.75 * (140 if dark else 186) + (18 if dark else 56)) * np.array([0.97, 1.0, 1.03])
    mixed = shown * (1 - towards) + np.array(ground_colour, float) * towards
    return np.clip(mixed, 0, 255).astype(np.uint8)[image]


def _cut_out(picture: NDArray[np.uint8], outline: list[tuple[float, float]]) -> NDArray[np.uint8]:
    """Return the image transparent outside of the outline, which is given in fractions of width and height."""
    mask = Image.new("L", (picture.shape[1], picture.shape[0]), 0)
    ImageDraw.Draw(mask).polygon([(x * picture.shape[1], y * picture.shape[0]) for x, y in outline], fill=255)
    return np.dstack([picture, np.asarray(mask)])


def _stage_grid(scene: viser.SceneApi, name: str, _: bytes, *, box: Box, dark: bool, z: float) -> Group:
    """Draw a grid over the stage and a dashed line around the travel of its axes."""
    x0, y0, x1, y1 = box
    pitch = 10 ** math.floor(math.log10(max(x1 - x0, y1 - y0))) / 4
    pad = 0.35 * max(x1 - x0, y1 - y0)
    xs = np.arange(math.floor((x0 - pad) / pitch), math.ceil((x1 + pad) / pitch) + 1) * pitch
    ys = np.arange(math.floor((y0 - pad) / pitch), math.ceil((y1 + pad) / pitch) + 1) * pitch
    pieces = [[(x, ys[0], z), (x, ys[-1], z)] for x in xs] + [[(xs[0], y, z), (xs[-1], y, z)] for y in ys]
    edge = dashed(rectangle(box, z + 1e-3), max(x1 - x0, y1 - y0) / 60)
    return Group(
        lines(scene, f"{name}/grid", np.array(pieces, np.float32), colours(dark).stage_line, 1.0),
        lines(scene, f"{name}/reach", edge, colours(dark).soft_ink, 2.0),
    )


WINDOW_COLOUR = "#D9480F"
"""Colour of the windows of a row, on map, scene and plot."""
PALE_OVER_DEPTHS = 0.5
"""Uncertainty in depths of field over which a focus is drawn pale."""


@dataclass(frozen=True, slots=True)
class FollowedPlan:
    """Plan after its coarse look: the focus of each field, and the row of fields that is shown from the side.

    whole_um: ends of the whole sweep.
    """

    plan: ScanPlan
    look: CoarseLook
    follow: FollowFocus
    focus: tuple[FieldFocus, ...]
    row: int
    whole_um: tuple[float, float]

    @property
    def in_row(self) -> list[tuple[Field, FieldFocus]]:
        """Fields of the row with their focus, by rising x."""
        pairs = [pair for pair in zip(self.plan.fields, self.focus, strict=True) if pair[0].row == self.row]
        return sorted(pairs, key=lambda pair: pair[0].x_um)

    @property
    def blank(self) -> frozenset[int]:
        """Numbers of the fields that were looked at and have no focus."""
        return frozenset(place.field for place in self.look.places if not place.found)

    @property
    def looked_at(self) -> frozenset[int]:
        """Numbers of the fields that were looked at."""
        return frozenset(place.field for place in self.look.places)

    def frame_um(self) -> tuple[float, float]:
        """Return width and height of a field."""
        return self.plan.cols * self.plan.pixel_um, self.plan.rows * self.plan.pixel_um

    def window_um(self, field: Field) -> tuple[float, float]:
        """Return the ends of the window of a field."""
        return field.z_start_um, self.plan.sweep.top_um(field)

    def colours(self) -> list[Rgb]:
        """Return the colour of the focus of each field."""
        middles = np.array([one.middle_um for one in self.focus])
        low, span = middles.min(), max(float(np.ptp(middles)), 1e-6)
        colours = table("mako")
        chosen = colours[np.clip((middles - low) / span * (len(colours) - 1), 0, len(colours) - 1).astype(int)]
        return [(int(r), int(g), int(b)) for r, g, b in chosen]

    def opacities(self) -> list[float]:
        """Return the opacity of each field, pale where its uncertainty is large."""
        u_um = np.array([one.u_um for one in self.focus])
        limit_um = PALE_OVER_DEPTHS * (self.plan.depth_of_field_um or self.plan.sweep.z_step_um)
        return np.clip(limit_um / np.maximum(u_um, 1e-6), 0.25, 1.0).tolist()


def followed(draft: Draft, row: int | None) -> FollowedPlan | None:
    """Return the plan after its coarse look; None without a look, or where another strategy is chosen.

    row: the chosen row of fields; None, or one that the plan lacks, for the middle one.
    """
    job, plan = draft.job, draft.plan
    if job is None or plan is None or job.follow_focus is None or plan.coarse_look is None or not draft.focus:
        return None
    rows = sorted({field.row for field in plan.fields})
    shown = row if row in rows else rows[len(rows) // 2]
    starts_um = [field.z_start_um for field in job.all_fields()]
    whole_um = min(starts_um), max(starts_um) + plan.sweep.range_um
    return FollowedPlan(plan, plan.coarse_look, job.follow_focus, draft.focus, shown, whole_um)


_FULL_OVER = 0.3
"""Size ratio of grid to sample from which the view frames both; below it only the grid."""
_AROUND = 0.28


def plan_contents(snapshot: Snapshot, view: View) -> SceneContents:
    """Return the sample, or the empty stage, with the grid."""
    job, plan = snapshot.draft.job, snapshot.draft.plan
    items = sample_items(snapshot, view.dark)
    size = _field_size(snapshot)
    if job is not None and size is not None:
        items += planned_items(job.all_fields(), *size, plan, view.dark)
    box, top_mm = _in_sight(snapshot, size), 0.0
    if (shown := followed(snapshot.draft, view.focus_row)) is not None:
        items += focus_items(shown, view.dark)
        box, top_mm = fields_box(shown.plan.fields, *shown.frame_um()), highest_mm(shown)
    return SceneContents(
        items=tuple(items),
        corners_mm=corners_of(box, 0.0, top_mm),
        place=("plan", snapshot.overview is None, job is None, shown is not None),
        preset="iso" if shown is not None else "top" if sample_box(snapshot) is not None or job is not None else "iso",
        clear=Clear(right=40),
    )


def _field_size(snapshot: Snapshot) -> tuple[float, float] | None:
    """Return width and height of a field in um: those of the grid, else those of the camera frame."""
    job, plan = snapshot.draft.job, snapshot.draft.plan
    if job is None:
        return None
    if job.grid is not None:
        return job.grid.field_width_um, job.grid.field_height_um
    return (plan.cols * plan.pixel_um, plan.rows * plan.pixel_um) if plan is not None else None


def _in_sight(snapshot: Snapshot, size: tuple[float, float] | None) -> Box:
    sample = sample_box(snapshot)
    grid = _grid_box(snapshot.draft.job, size)
    if grid is None:
        return sample or _middle(reach_box(snapshot.rig.limits))
    share = (
        1.0
        if sample is None
        else max(grid[k + 2] - grid[k] for k in (0, 1)) / max(sample[k + 2] - sample[k] for k in (0, 1))
    )
    if sample is not None and share >= _FULL_OVER:
        return min(grid[0], sample[0]), min(grid[1], sample[1]), max(grid[2], sample[2]), max(grid[3], sample[3])
    pad = _AROUND * max(grid[2] - grid[0], grid[3] - grid[1])
    return grid[0] - pad, grid[1] - pad, grid[2] + pad, grid[3] + pad


def _grid_box(job: Job | None, size: tuple[float, float] | None) -> Box | None:
    return fields_box(job.all_fields(), *size) if job is not None and size is not None else None


def _middle(box: Box) -> Box:
    """Return the central three quarters of a box."""
    dx, dy = (box[2] - box[0]) / 8, (box[3] - box[1]) / 8
    return box[0] + dx, box[1] + dy, box[2] - dx, box[3] - dy


_HEIGHT_SHARE = 0.3
"""Height of the highest drawn focus over the sample, as a share of the longer side of the fields."""
_CELL_PX = 4
_INK, _NO_FOCUS_PLATE = (154, 74, 0), (255, 243, 214)


def focus_items(shown: FollowedPlan, dark: bool) -> list[SceneItem]:
    """Return the predicted surface, the windows of the row, and signs over the places without a focus."""
    key = (shown, dark)
    return [
        SceneItem("focus/surface", key, partial(_surface, shown=shown, dark=dark)),
        SceneItem("focus/windows", key, partial(_windows, shown=shown)),
        *(
            SceneItem(f"focus/blank/{number}", key, partial(_no_focus, shown=shown, number=number))
            for number in sorted(shown.blank)
        ),
    ]


def highest_mm(shown: FollowedPlan) -> float:
    """Return the height of the highest drawn window over the sample."""
    box = fields_box(shown.plan.fields, *shown.frame_um())
    return _HEIGHT_SHARE * max(box[2] - box[0], box[3] - box[1])


def _heights(shown: FollowedPlan) -> tuple[float, float]:
    """Return the z that lies on the sample, um, and the mm of the scene for each um."""
    ends_um = [shown.window_um(field) for field in shown.plan.fields]
    low_um, high_um = min(low for low, _ in ends_um), max(high for _, high in ends_um)
    return low_um, highest_mm(shown) / max(high_um - low_um, 1e-6)


def _surface(scene: viser.SceneApi, name: str, _: bytes, *, shown: FollowedPlan, dark: bool) -> Handle:
    """Draw a plate over each field at the middle of its focus; colours of uncertain ones tend to that of the ground."""
    low_um, mm_per_um = _heights(shown)
    boxes = np.array([field_box(field, *shown.frame_um()) for field in shown.plan.fields])
    z_mm = np.array([(one.middle_um - low_um) * mm_per_um for one in shown.focus])
    ground, opacity = np.array(colours(dark).ground, float), np.array(shown.opacities())[:, None]
    tones = np.array(shown.colours(), float) * opacity + ground * (1 - opacity)
    n = len(boxes)
    picture = np.repeat(np.repeat(np.rint(tones).astype(np.uint8)[None], _CELL_PX, axis=0), _CELL_PX, axis=1)
    u = (np.arange(n) + 0.5) / n
    uv = np.stack([u, np.full(n, 0.5), u, np.full(n, 0.5)], axis=1).astype(np.float32)
    data = painted(mesh.plates(boxes, z_mm, uv), picture)
    return scene.add_glb(name, data, cast_shadow=False, receive_shadow=False)


def _windows(scene: viser.SceneApi, name: str, _: bytes, *, shown: FollowedPlan) -> Handle:
    low_um, mm_per_um = _heights(shown)
    edges = []
    for field, _focus in shown.in_row:
        low, high = ((z_um - low_um) * mm_per_um for z_um in shown.window_um(field))
        edges.append(box_edges(field_box(field, *shown.frame_um()), low, high))
    return lines(scene, name, np.concatenate(edges), rgb(WINDOW_COLOUR), 2.0)


def _no_focus(scene: viser.SceneApi, name: str, _: bytes, *, shown: FollowedPlan, number: int) -> Handle:
    box = field_box(shown.plan.field(number), *shown.frame_um())
    high = 0.5 * (box[3] - box[1])
    at = ((box[0] + box[2]) / 2, (box[1] + box[3]) / 2, 1.02 * highest_mm(shown))
    return word(scene, name, "!", at, high, _INK, _NO_FOCUS_PLATE, (0.5, 0.5))
