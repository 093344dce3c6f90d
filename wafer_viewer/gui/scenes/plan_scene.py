"""Scene of the plan: the sample on the stage with the field grid."""

from __future__ import annotations

from wafer_viewer.gui.scene.camera.camera_presets import Clear
from wafer_viewer.gui.scene.primitives import Box
from wafer_viewer.gui.scene.scene_contents import SceneContents, corners_of
from wafer_viewer.gui.scenes.field_outlines import fields_box, planned_items
from wafer_viewer.gui.scenes.sample_scene import reach_box, sample_box, sample_items
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.job.job import Job
from wafer_viewer.session.state.snapshot import Snapshot

_WHOLE_OVER = 0.3
"""Size ratio of grid to sample from which the view frames both; below it only the grid."""
_AROUND = 0.28


def plan_contents(snapshot: Snapshot, view: View) -> SceneContents:
    """Return the sample, or the empty stage, with the grid."""
    job, plan = snapshot.draft.job, snapshot.draft.plan
    items = sample_items(snapshot, view.dark)
    size = _field_size(snapshot)
    if job is not None and size is not None:
        items += planned_items(job.all_fields(), *size, plan, view.dark)
    box = _in_sight(snapshot, size)
    return SceneContents(
        items=tuple(items),
        corners_mm=corners_of(box, 0.0, 0.0),
        place=("plan", snapshot.overview is None, job is None),
        preset="top" if sample_box(snapshot) is not None or job is not None else "iso",
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
    if sample is not None and share >= _WHOLE_OVER:
        return min(grid[0], sample[0]), min(grid[1], sample[1]), max(grid[2], sample[2]), max(grid[3], sample[3])
    pad = _AROUND * max(grid[2] - grid[0], grid[3] - grid[1])
    return grid[0] - pad, grid[1] - pad, grid[2] + pad, grid[3] + pad


def _grid_box(job: Job | None, size: tuple[float, float] | None) -> Box | None:
    return fields_box(job.all_fields(), *size) if job is not None and size is not None else None


def _middle(box: Box) -> Box:
    """Return the central three quarters of a box."""
    dx, dy = (box[2] - box[0]) / 8, (box[3] - box[1]) / 8
    return box[0] + dx, box[1] + dy, box[2] - dx, box[3] - dy
