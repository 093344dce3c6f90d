"""A session that stands still, with a stitched surface to be seen: a few fields or many, and how they were placed."""

from __future__ import annotations

import dataclasses

import numpy as np

from tests.browser.sessions.surface_session import SurfaceSession
from tests.support.made_up_poses import made_up_poses, stitching_of
from tests.support.page_stand_in import COLS, PIXEL_UM, ROWS, grid, height_map, job_and_plan, snapshot_of
from wafer_viewer.model.surface.field_poses import Poses, RejectionReason
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.session.core.dataset_library import with_change

WIDTH_UM, HEIGHT_UM = COLS * PIXEL_UM, ROWS * PIXEL_UM
PITCH_UM, STREET_UM = 148.0, 26.0
FEW_DOUBTS = {(5, 8): RejectionReason.AMBIGUOUS, (6, 9): RejectionReason.BLANK}
MANY_DOUBTS = {
    (20, 21): RejectionReason.AMBIGUOUS, (44, 60): RejectionReason.DISAGREES,
    (101, 102): RejectionReason.UNLIKE, (120, 136): RejectionReason.BLANK,
    (121, 137): RejectionReason.BLANK, (121, 122): RejectionReason.BLANK, (170, 186): RejectionReason.END_OF_SEARCH,
}  # fmt: skip


class StitchedSession(SurfaceSession):
    """`rows` x `cols` fields, seen in pixels `coarse` times as large as theirs; by itself, that is one for a few."""

    def __init__(self, rows: int = 3, cols: int = 3, coarse: int = 0) -> None:
        job, plan = job_and_plan(grid(rows, cols))
        many = rows * cols > 30
        if many:
            doubts = {pair: doubt for pair, doubt in MANY_DOUBTS.items() if max(pair) <= rows * cols}
            poses = made_up_poses(plan.fields, WIDTH_UM, HEIGHT_UM, doubts, left_out=(77,), n_groups=2)
            notes = ("10 of 208 fields are held by the stage alone along y.",)
        else:
            poses, notes = made_up_poses(plan.fields, WIDTH_UM, HEIGHT_UM, FEW_DOUBTS), ()
        whole = a_wafer(poses, (coarse or (4 if many else 1)) * PIXEL_UM)
        snapshot = snapshot_of(whole, plan, job)
        if snapshot.surface is None:
            raise ValueError("The surface of this session is not there.")
        surface = dataclasses.replace(snapshot.surface, stitching=stitching_of(poses, notes))
        super().__init__(dataclasses.replace(snapshot, surface=surface), {0: whole})
        self._poses = poses

    def poses(self) -> Poses | None:
        return self._poses


class GrowingSession(StitchedSession):
    """The same while its scan goes on: `grow` adds the next fields, of which at first there are none."""

    def __init__(self, rows: int, cols: int, coarse: int = 0) -> None:
        super().__init__(rows, cols, coarse)
        self._whole, self._there = self.shelf.surfaces[0], 0
        self._first = self.snapshot.surface
        self.change(surface=None, rig=dataclasses.replace(self.snapshot.rig, state="scanning"))

    def grow(self, fields: int, told: bool = True) -> None:
        """Add fields; `told`: the page hears where the surface changed."""
        old, self._there = self._there, min(self._there + fields, len(self._poses.numbers))
        boxes = [self._box(k) for k in range(old, self._there)]
        self.shelf.surfaces[0] = self._up_to(self._there)
        before, info = self.snapshot.surface, self._first
        if info is None or not boxes:
            return
        now = dataclasses.replace(info, stamp=before.stamp + 1 if before else 1, n_fields=self._there)
        low, high = np.min(boxes, axis=0), np.max(boxes, axis=0)
        now = with_change(now, before, (low[0], low[1], high[2], high[3])) if told else now
        self.change(surface=now)

    def finish(self) -> None:
        """The scan is done."""
        self.change(rig=dataclasses.replace(self.snapshot.rig, state="ready"))

    def _box(self, k: int) -> tuple[float, float, float, float]:
        x, y = float(self._poses.x_um[k]), float(self._poses.y_um[k])
        return x - WIDTH_UM / 2, y - HEIGHT_UM / 2, x + WIDTH_UM / 2, y + HEIGHT_UM / 2

    def _up_to(self, n: int) -> HeightMap:
        whole, there = self._whole, np.zeros(self._whole.shape, bool)
        for k in range(n):
            x0, y0, x1, y1 = self._box(k)
            there |= ((whole.x_um >= x0) & (whole.x_um <= x1)) & ((whole.y_um >= y0) & (whole.y_um <= y1))[:, None]
        z = np.where(there, whole.z_um, np.nan)
        return dataclasses.replace(height_map(z, whole.pixel_um, whole.x0_um, whole.y0_um), overlap_um=whole.overlap_um)


def a_wafer(poses: Poses, pixel_um: float) -> HeightMap:
    """Dies between streets, with bumps and a warp; where fields meet, a little of each seam's misfit is left."""
    x0, x1 = poses.stage_x_um.min() - WIDTH_UM / 2, poses.stage_x_um.max() + WIDTH_UM / 2
    y0, y1 = poses.stage_y_um.min() - HEIGHT_UM / 2, poses.stage_y_um.max() + HEIGHT_UM / 2
    x, y = np.arange(x0, x1, pixel_um)[None, :], np.arange(y1, y0, -pixel_um)[:, None]
    in_die = ((x % PITCH_UM) > STREET_UM) & ((y % PITCH_UM) > STREET_UM)
    bump = np.cos(x * (2 * np.pi / 24)) * np.cos(y * (2 * np.pi / 24))
    z = np.where(in_die, 9.0 + 3.0 * np.clip(bump - 0.4, 0, None), 0.0)
    z = z + 3.0 * ((x - x0) / (x1 - x0)) ** 2 + np.random.default_rng(2).normal(0, 0.12, z.shape)
    there, twice, misfit = (np.zeros(z.shape, kind) for kind in (bool, np.uint8, np.float32))
    rng = np.random.default_rng(3)
    for k in np.flatnonzero(~poses.left_out):
        rows = (np.abs(y[:, 0] - poses.y_um[k]) <= HEIGHT_UM / 2).nonzero()[0]
        cols = (np.abs(x[0] - poses.x_um[k]) <= WIDTH_UM / 2).nonzero()[0]
        part = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
        there[part] = True
        twice[part] += 1
        misfit[part] = np.maximum(misfit[part], abs(rng.normal(0.1, 0.12)))
    z[~there] = np.nan
    noise = np.abs(rng.normal(0, 0.12, z.shape)) + misfit + 0.7 * ~in_die * rng.random(z.shape)
    made = height_map(z, pixel_um, float(x0), float(y1))
    overlap = np.where((twice > 1) & there, noise, np.nan).astype(np.float32)
    return dataclasses.replace(made, overlap_um=overlap)
