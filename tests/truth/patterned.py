"""A patterned wafer as a scene of the virtual optics: dies that are alike, and what was planted on them.

The pattern is every die's, the grain belongs to the place: no two dies show the same speckle. What is judged by it
knows nothing of scenes or optics.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from tests.truth.planted import DEPTH_UM, DIE_UM, PITCH_UM, PIXEL_UM, STREET_PX, Plan, Planted, die_errors
from wafer_viewer.rigs.virtual.scenes.catalogue import Scene, rectangle
from wafer_viewer.rigs.virtual.scenes.drawing import Points, SceneSheets, bar, bars, blend, grain, inside
from wafer_viewer.rigs.virtual.scenes.drawing import rectangle as box

GAIN, CONTRAST, CORNER_UM, ELSEWHERE_UM = 1.2, 0.12, 4.0, 20_000.0
PARTICLE, PIT, SCRATCH, RESIDUE, CHIP = np.arange(5)
CODES = {"particle": PARTICLE, "pit": PIT, "scratch": SCRATCH, "residue": RESIDUE, "edge chip": CHIP}
FINE, COARSE, RAGGED = np.arange(1, 4)
PITCH_X, PITCH_Y, STREET = PITCH_UM[0], PITCH_UM[1], STREET_PX * PIXEL_UM
WIDTH, HEIGHT = DIE_UM


def scene_of(plan: Plan, what: Sequence[Planted]) -> Scene:
    """The wafer of a plan, with everything planted."""
    errors = die_errors(plan)
    width_um, height_um = plan.size_um
    radius2 = (width_um / 2) ** 2 + (height_um / 2) ** 2
    form = np.array([width_um / 2, height_um / 2, plan.bow_um / radius2, plan.seed * ELSEWHERE_UM, float(plan.seen)])
    listed = np.array([_row(one) for one in what if one.kind in CODES]).reshape(-1, 7)

    def fill(x_um: Points, y_um: Points, footprint_um: float, out: SceneSheets) -> None:
        room = listed[:, 4] + 2
        near = (listed[:, 1] > x_um.min() - room) & (listed[:, 1] < x_um.max() + room)
        near &= (listed[:, 2] > y_um.min() - room) & (listed[:, 2] < y_um.max() + room)
        _fill(x_um, y_um, footprint_um, form, errors, listed[near], *out)

    return Scene(
        name="patterned",
        title="A patterned wafer with planted defects",
        fill=fill,
        gain=GAIN,
        width_um=width_um,
        height_um=height_um,
        z_min_um=-plan.bow_um * 1.5 - 3,
        z_max_um=DEPTH_UM + 5,
        outline_um=rectangle(width_um, height_um),
        tour_center_um=(width_um / 2, height_um / 2),
        tour_z_start_um=-plan.bow_um * 1.2 - 8,
        tour_z_step_um=1.0,
        tour_frames=round(plan.bow_um * 1.2 + DEPTH_UM + 18),
    )


def _row(one: Planted) -> tuple[float, ...]:
    return (
        float(CODES[one.kind]), one.x_um, one.y_um, one.angle_rad, one.length_um / 2, one.width_um / 2, one.height_um,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _fill(x_um, y_um, footprint, form, errors, defects, height_a, radiance_a, height_b, radiance_b, cover):
    for r in range(x_um.shape[0]):
        for c in range(x_um.shape[1]):
            seen = _at(x_um[r, c], y_um[r, c], footprint, form, errors, defects)
            height_a[r, c], radiance_a[r, c], height_b[r, c], radiance_b[r, c], cover[r, c] = seen


@njit(cache=True, nogil=True)
def _at(x, y, footprint, form, errors, defects):
    """(height A, radiance A, height B, radiance B, cover of A): die tops over the street's floor."""
    col, row = math.floor(x / PITCH_X), math.floor(y / PITCH_Y)
    i, j = min(max(col + 1, 0), errors.shape[0] - 1), min(max(row + 1, 0), errors.shape[1] - 1)
    off_x, off_y, present, tilt = errors[i, j]
    u, v = x - col * PITCH_X - STREET / 2 - off_x, y - row * PITCH_Y - STREET / 2 - off_y
    dx, dy = x - form[0], y - form[1]
    base = -form[2] * (dx * dx + dy * dy)
    gx, gy = x + form[3], y + 0.37 * form[3]
    fine, coarse = grain(gx / 1.5, gy / 1.5, FINE), grain(gx / 3.1, gy / 3.1, COARSE)
    speckle = 0.8 * fine + 0.6 * coarse
    street = 0.40 * (1 + CONTRAST * speckle) * (1 - 0.6 * box(u, v, -8.0, -3.0, 30.0, 50.0, footprint))
    inset = _inset(u, v) - 0.2 * grain(gx / 2.6, gy / 2.6, RAGGED) if present > 0 else -1e3
    radiance, rise = _pattern(u, v, footprint)
    contrast = CONTRAST
    for n in range(len(defects)):
        kind, cx, cy, angle, half_length, half_width, height = defects[n]
        p, q = x - cx, y - cy
        if max(abs(p), abs(q)) > half_length + 2:
            continue
        along, across = p * math.cos(angle) + q * math.sin(angle), q * math.cos(angle) - p * math.sin(angle)
        ragged = 1 + 0.06 * grain(gx / 2.0, gy / 2.0, RAGGED)
        out = math.hypot(along / half_length, across / half_width) * ragged
        if kind == CHIP:
            inset = min(inset, (out - 1) * half_length)
        elif kind == SCRATCH:
            share, up, grey, calm = _scratch(along, across, half_length, half_width * ragged, footprint)
            radiance, rise = blend(radiance, radiance * grey, share * form[4]), rise + height * up
        else:
            share, up, grey, calm = _spot(kind, out, half_length, radiance, footprint)
            radiance, rise = blend(radiance, grey, share * form[4]), rise + height * up
            contrast *= 1 - calm * form[4]
    top = base + DEPTH_UM + rise + 0.03 * coarse + tilt * (u - WIDTH / 2)
    return top, radiance * (1 + contrast * speckle), base + 0.03 * coarse, street, inside(inset, footprint)


@njit(cache=True, nogil=True)
def _scratch(along, across, half_length, half_width, footprint):
    """(share, height, radiance as a share of what it lies on, calm): a round groove that ends in points."""
    narrow = half_width * math.sqrt(max(0.0, 1 - (along / half_length) ** 4))
    share = inside(narrow - abs(across), footprint) if narrow > 0 else 0.0
    up = max(0.0, 1 - (across / narrow) ** 2) if narrow > 0 else 0.0
    return share, up, 0.45, 0.0


@njit(cache=True, nogil=True)
def _spot(kind, out, radius, under, footprint):
    """(share, height, radiance, calm) at `out` radii from the middle of a particle, a pit or a residue."""
    share = inside((1 - out) * radius, footprint)
    if kind == PARTICLE:
        return share, math.sqrt(max(0.0, 1 - out * out)), 0.35 * under + 0.25 * math.exp(-6 * out * out), 0.0
    if kind == PIT:
        return share, max(0.0, 1 - out * out), under * (0.75 - 0.35 * min(1.0, out)), 0.0
    up = 0.5 * (1 + math.cos(math.pi * min(1.0, out)))
    return up, up, 1.25 * under, 0.6 * up


@njit(cache=True, nogil=True)
def _inset(u, v):
    """Distance inside a die's rounded outline; negative outside."""
    x, y = abs(u - WIDTH / 2) - WIDTH / 2 + CORNER_UM, abs(v - HEIGHT / 2) - HEIGHT / 2 + CORNER_UM
    return CORNER_UM - math.hypot(max(x, 0.0), max(y, 0.0)) - min(max(x, y), 0.0)


@njit(cache=True, nogil=True)
def _pattern(u, v, footprint):
    """(radiance, rise in um): a row of pads, a field of lines, a plate, and what lies between."""
    radiance, rise = 0.16, 0.0
    pad = bars(u - 6.0, 14.0, 0.6, footprint) * bar(v, 6.0, 15.0, footprint) * bar(u, 6.0, WIDTH - 8.0, footprint)
    radiance, rise = blend(radiance, 0.28, pad), rise + 0.6 * pad
    lines = bars(u, 5.0, 0.5, footprint) * box(u, v, 62.0, WIDTH - 10.0, 26.0, HEIGHT - 10.0, footprint)
    radiance, rise = blend(radiance, 0.24, lines), rise + 0.25 * lines
    plate = box(u, v, 12.0, 50.0, 50.0, HEIGHT - 14.0, footprint)
    return blend(radiance, 0.28, plate), rise + 0.5 * plate
