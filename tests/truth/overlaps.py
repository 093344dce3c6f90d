"""What the overlaps of many fields would measure, without their pictures: fields with errors of a stage, and edges."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.field_poses import (
    N_CANDIDATE,
    HeightOffsets,
    Numbers,
    RejectionReason,
    Shifts,
    no_candidates,
    unknown_bend,
    unknown_drift,
)

PIXEL_UM = 0.46729
FIELD_UM = (1440 * PIXEL_UM, 1080 * PIXEL_UM)
STAGE_PX, EDGE_PX, SEARCH_PX = 6.0, 0.05, 40.0
Z_UM, TILT, SEAM_UM = 1.0, 1e-4, 0.003
OVERLAP = 0.12


@dataclass(frozen=True)
class Fields:
    """Where the stage says fields are, [n], and which of them overlap, [e, 2]."""

    x_um: Numbers
    y_um: Numbers
    pairs: NDArray[np.int32]

    def without(self, gone: NDArray[np.bool_]) -> Fields:
        """The fields that are left, and the pairs of these."""
        to = np.cumsum(~gone) - 1
        stored = ~gone[self.pairs].any(axis=1)
        return Fields(self.x_um[~gone], self.y_um[~gone], to[self.pairs[stored]].astype(np.int32))


def grid(rows: int, cols: int) -> Fields:
    """Fields of the full size in rows and columns."""
    place = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
    neighbour = np.column_stack((place[:, :-1].ravel(), place[:, 1:].ravel()))
    below = np.column_stack((place[:-1].ravel(), place[1:].ravel()))
    pitch_x, pitch_y = (side * (1 - OVERLAP) for side in FIELD_UM)
    x, y = np.meshgrid(np.arange(cols) * pitch_x, -np.arange(rows) * pitch_y)
    return Fields(x.ravel(), y.ravel(), np.concatenate((neighbour, below)))


def wafer(n: int) -> Fields:
    """About n fields on a full circle."""
    radius_um = np.sqrt(n * np.prod(FIELD_UM) * (1 - OVERLAP) ** 2 / np.pi)
    rows, cols = (int(2 * radius_um / (side * (1 - OVERLAP))) + 1 for side in FIELD_UM[::-1])
    square = grid(rows, cols)
    return square.without(np.hypot(square.x_um - square.x_um.mean(), square.y_um - square.y_um.mean()) > radius_um)


def shifts_of(
    fields: Fields,
    random: np.random.Generator,
    *,
    wrong: float = 0.0,
    blank: float = 0.0,
    turn: float = 0.0,
    scale: float = 0.0,
    stretch: float = 0.0,
    skew: float = 0.0,
    backlash_px: float = 0.0,
    stage_px: float = STAGE_PX,
) -> tuple[Shifts, Numbers]:
    """What registration would say, and where the fields are in the camera's axes, [n, 2].

    wrong, blank: fractions of edges; turn (rad, anticlockwise) and scale (fraction) of the camera; stretch, skew: of
    the axes of the stage; backlash_px: of every second row.
    """
    stage = np.column_stack((fields.x_um, fields.y_um))
    true = stage + random.normal(size=stage.shape) * stage_px * PIXEL_UM
    true[:, 0] += backlash_px * PIXEL_UM * (np.unique(-stage[:, 1].round(), return_inverse=True)[1] % 2)
    arm = true - stage.mean(axis=0)
    true = true + scale * arm + turn * np.column_stack((arm[:, 1], -arm[:, 0]))
    true = true + stretch * arm * (1, -1) + skew * arm[:, ::-1]
    first, second = fields.pairs.T
    e = len(first)
    message = (true - stage)[second] - (true - stage)[first] + random.normal(size=(e, 2)) * EDGE_PX * PIXEL_UM
    shuffled = random.permutation(e)
    is_blank, is_wrong = np.split(shuffled[: round(blank * e) + round(wrong * e)], [round(blank * e)])
    message[is_wrong] += random.uniform(-SEARCH_PX, SEARCH_PX, (len(is_wrong), 2)) * PIXEL_UM
    u_um, doubt = np.full(e, EDGE_PX * PIXEL_UM), np.zeros(e, np.uint8)
    u_um[is_blank], doubt[is_blank] = np.inf, RejectionReason.BLANK
    nothing, flat = np.zeros(e), np.zeros(e, np.float32)
    by = np.zeros(e, np.uint8)
    told = (*message.T, u_um, u_um, flat + 0.9, by, doubt, flat, nothing, nothing, nothing)
    return Shifts(first, second, *told, no_candidates(e), unknown_drift(e), unknown_bend(e)), true


def repeating(shifts: Shifts, random: np.random.Generator, share: float, pitch_px: float) -> Shifts:
    """A share of the overlaps shows a pattern of some pitch: they fit at the 25 periods next to the stage."""
    few = np.stack(np.meshgrid(np.arange(-3, 4), np.arange(-3, 4)), axis=-1).reshape(-1, 2) * pitch_px * PIXEL_UM
    rows = np.flatnonzero((random.random(len(shifts.first)) < share) & np.isfinite(shifts.u_x_um))
    at = np.column_stack((shifts.x_um, shifts.y_um))[rows, None] + few
    order = np.argsort(np.hypot(at[..., 0], at[..., 1]), axis=1)[:, :25]
    table = np.full((len(shifts.first), 25, N_CANDIDATE), np.nan, np.float32)
    table[rows, :, :2] = np.take_along_axis(at, order[..., None], axis=1)
    table[rows, :, 2:5] = np.array([1, 0, 1]) / (EDGE_PX * PIXEL_UM) ** 2
    table[rows, :, 5] = 0
    x_um, y_um, doubt = shifts.x_um.copy(), shifts.y_um.copy(), shifts.doubt.copy()
    x_um[rows], y_um[rows], doubt[rows] = *table[rows, 0, :2].T, RejectionReason.AMBIGUOUS
    return replace(shifts, x_um=x_um, y_um=y_um, doubt=doubt, candidates=table)


def seams_of(
    fields: Fields,
    random: np.random.Generator,
    *,
    wrong: float = 0.0,
    sag_um: tuple[float, float, float] = (0.0, 0.0, 0.0),
    lean: tuple[float, float] = (0.0, 0.0),
) -> tuple[HeightOffsets, Numbers]:
    """What heights in the overlaps would say, and by how much those of each field are too high: [n, 3] z and tilts.

    wrong: fraction of seams; sag_um: of every field at its corner (x^2, x y, y^2); lean: tilts that all fields share.
    """
    first, second = fields.pairs.T
    poses = random.normal(size=(len(fields.x_um), 3)) * (Z_UM, TILT, TILT) + (0, *lean)
    middle_x, middle_y = (a[fields.pairs].mean(axis=1) for a in (fields.x_um, fields.y_um))
    neighbour = np.abs(fields.x_um[second] - fields.x_um[first]) > np.abs(fields.y_um[second] - fields.y_um[first])
    width = np.where(neighbour, OVERLAP, 1.0) * FIELD_UM[0]
    height = np.where(neighbour, 1.0, OVERLAP) * FIELD_UM[1]
    sigma = SEAM_UM * np.column_stack((np.ones_like(width), np.sqrt(12) / width, np.sqrt(12) / height))
    planes = [_plane(poses[k], middle_x - fields.x_um[k], middle_y - fields.y_um[k], sag_um) for k in (first, second)]
    message = planes[1] - planes[0] + random.normal(size=sigma.shape) * sigma
    is_wrong = random.permutation(len(first))[: round(wrong * len(first))]
    message[is_wrong] += random.normal(size=(len(is_wrong), 3)) * (3 * Z_UM, 100 * TILT, 100 * TILT)
    information = sigma[:, :, None] ** -2.0 * np.eye(3)
    flat, n_pixels = np.zeros(len(first), np.float32), np.full(len(first), 170_000, np.int32)
    return HeightOffsets(
        first, second, middle_x, middle_y, *message.T, information, n_pixels, flat, message[:, 0], 0 * width
    ), poses


def _plane(pose: Numbers, dx: Numbers, dy: Numbers, sag_um: tuple[float, float, float]) -> Numbers:
    """[e, 3] height and slopes of a field's error at (dx, dy) from its centre."""
    half_x, half_y = FIELD_UM[0] / 2, FIELD_UM[1] / 2
    xx, xy, yy = sag_um[0] / half_x**2, sag_um[1] / (half_x * half_y), sag_um[2] / half_y**2
    z, tilt_x, tilt_y = pose.T
    return np.column_stack(
        (
            z + tilt_x * dx + tilt_y * dy + xx * dx**2 + xy * dx * dy + yy * dy**2,
            tilt_x + 2 * xx * dx + xy * dy,
            tilt_y + 2 * yy * dy + xy * dx,
        )
    )
