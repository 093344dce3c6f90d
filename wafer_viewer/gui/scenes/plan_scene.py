"""Scene of the plan: the sample on the stage, as the overview camera sees it, with the field grid."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import viser
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from wafer_viewer.draw.colormaps import Rgb, rgb
from wafer_viewer.draw.surface import ground_plane, mesh
from wafer_viewer.draw.surface.mesh import painted
from wafer_viewer.gui.presenters.focus import WINDOW_COLOUR, FollowedPlan, followed
from wafer_viewer.gui.scene.camera_presets import Clear
from wafer_viewer.gui.scene.primitives import Box, Group, add_glb, closed, dashed, image_plane, lines, rectangle, word
from wafer_viewer.gui.scene.reconciler import Handle, SceneItem
from wafer_viewer.gui.scene.scene_contents import SceneContents, corners_of
from wafer_viewer.gui.scene.scene_theme import colours
from wafer_viewer.gui.scenes.field_outlines import box_edges, field_box, fields_box, planned_items
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.acquisition.devices import Overview
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.job import Job
from wafer_viewer.session.state.snapshot import Snapshot

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
    picture = ground_plane.shadow(
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
