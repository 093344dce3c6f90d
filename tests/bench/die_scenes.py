"""Patterned wafers thrown with dice whose lattice is known, and surfaces on which there is none: see bench_dies.py."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tests.support.patterned_surface import Wafer, made, pattern
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Origin

Dice = np.random.Generator
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Thrown:
    """A surface and the wafer it was made of, None where there is no lattice; every: dies to a period, (x, y)."""

    surface: HeightMap
    wafer: Wafer | None
    every: tuple[int, int] = (1, 1)


def any_wafer(dice: Dice, angle_deg: float | None = None) -> Wafer:
    """Seven by eight dies or so, of any pitch, size, place and turn up to 0.3 degrees; bow of 10 um, 2 % unmeasured."""
    pitch = float(dice.uniform(150, 230)), float(dice.uniform(120, 190))
    street = dice.uniform(14, 34, 2)
    return Wafer(
        pitch_x_um=pitch[0],
        pitch_y_um=pitch[1],
        width_um=pitch[0] - float(street[0]),
        height_um=pitch[1] - float(street[1]),
        x0_um=float(dice.uniform(0, pitch[0])),
        y0_um=float(dice.uniform(0, pitch[1])),
        angle_deg=float(dice.uniform(-0.3, 0.3)) if angle_deg is None else angle_deg,
        die_over_street_um=float(dice.choice([-3.0, 3.0])),
        street_grey=float(dice.uniform(140, 200)),
        die_grey=float(dice.uniform(60, 110)),
        seed=int(dice.integers(1 << 30)),
    )


def plain(dice: Dice) -> Thrown:
    wafer = any_wafer(dice)
    return Thrown(made(wafer), wafer)


def turned(dice: Dice) -> Thrown:
    wafer = any_wafer(dice, float(dice.choice([-3, 3]) + dice.uniform(-0.5, 0.5)))
    return Thrown(made(wafer), wafer)


def missing_field(dice: Dice) -> Thrown:
    wafer = any_wafer(dice)
    x, y = dice.uniform(0, 900), dice.uniform(0, 750)
    return Thrown(made(wafer, gap=Region.rectangle(x, y, x + 480, y + 400)), wafer)


def missing_dies(dice: Dice) -> Thrown:
    wafer = any_wafer(dice)
    places = [(int(dice.integers(6)), int(dice.integers(7))) for _ in range(8)]
    return Thrown(made(wafer, no_die=tuple(places)), wafer)


def round_wafer(dice: Dice) -> Thrown:
    """Dies cut at the rim of a round wafer; beyond it lies the chuck, deep and dark, a half of it unmeasured."""
    wafer = any_wafer(dice)
    surface = made(wafer)
    x, y = np.meshgrid(surface.x_um - surface.x_um.mean(), surface.y_um - surface.y_um.mean())
    off = np.hypot(x, y) > 620
    z = np.where(off, np.where(dice.random(off.shape) < 0.5, np.nan, -80.0), surface.z_um)
    grey = np.where(off, dice.normal(12, 3, off.shape).clip(0, 255), surface.all_in_focus)
    return Thrown(_with(surface, z, grey), wafer)


def holes(dice: Dice) -> Thrown:
    """A tenth unmeasured, mostly in patches, and twice the noise."""
    from scipy.ndimage import gaussian_filter

    wafer = replace(any_wafer(dice), noise_um=0.6, noise_grey=12.0)
    surface = made(wafer)
    patches = gaussian_filter(dice.standard_normal(surface.shape), 4)
    return Thrown(_with(surface, np.where(patches > np.quantile(patches, 0.92), np.nan, surface.z_um)), wafer)


def busy_streets(dice: Dice) -> Thrown:
    """Test structures in the streets, with a period of their own that is no part of the pitch."""
    wafer = any_wafer(dice)
    surface = made(wafer)
    _, _, u, v, street = _in_dies(surface, wafer)
    period = wafer.pitch_x_um * dice.uniform(0.21, 0.29), wafer.pitch_y_um * dice.uniform(0.21, 0.29)
    on = street & (((u % period[0]) < period[0] / 2) ^ ((v % period[1]) < period[1] / 2))
    return Thrown(_with(surface, surface.z_um + 1.5 * on, surface.all_in_focus + 40.0 * on), wafer)


def _parts(n_x: int, n_y: int, line: float) -> Callable[[Dice], Thrown]:
    """Dies of n_x by n_y blocks that are alike; line: of the street's depth, what parts them."""

    def thrown(dice: Dice) -> Thrown:
        wafer = any_wafer(dice)

        def printed(u: Floats, v: Floats) -> Floats:
            near = np.minimum((u * n_x) % 1, (v * n_y) % 1) < 0.06
            one = (u < 1 / n_x) & (v < 1 / n_y) & ((u * n_x % 1) > 0.7) & ((v * n_y % 1) > 0.6)
            return np.where(near, -line, pattern(u * n_x % 1, v * n_y % 1)) + 0.5 * one

        return Thrown(made(wafer, printed=printed), wafer)

    return thrown


def few(dice: Dice) -> Thrown:
    """Two by two whole dies and a bit."""
    wafer = any_wafer(dice)
    wafer = replace(wafer, pitch_x_um=3.0 * wafer.pitch_x_um, pitch_y_um=3.2 * wafer.pitch_y_um)
    size = {"width_um": wafer.pitch_x_um - 30, "height_um": wafer.pitch_y_um - 26, "x0_um": 60.0, "y0_um": 50.0}
    return Thrown(made(replace(wafer, **size)), replace(wafer, **size))


def one_die(dice: Dice) -> Thrown:
    size = {"pitch_x_um": 1900.0, "width_um": 1150.0, "pitch_y_um": 1700.0, "height_um": 900.0}
    return Thrown(made(replace(any_wafer(dice), **size, x0_um=120.0, y0_um=150.0)), None)


def one_row(dice: Dice) -> Thrown:
    size = {"pitch_y_um": 1700.0, "height_um": 900.0, "y0_um": 150.0}
    return Thrown(made(replace(any_wafer(dice), **size)), None)


def turned_too_far(dice: Dice) -> Thrown:
    return Thrown(made(any_wafer(dice, float(dice.choice([-1, 1]) * dice.uniform(7, 12)))), None)


def two_kinds(dice: Dice) -> Thrown:
    """Every other die of a row is another: what repeats is two dies."""
    wafer = any_wafer(dice)
    surface = made(wafer)
    col, _, u, v, street = _in_dies(surface, wafer)
    on = ~street & (col % 2 == 1) & ((u * 7 / wafer.width_um % 1 < 0.5) ^ (v * 5 / wafer.height_um % 1 < 0.4))
    return Thrown(_with(surface, surface.z_um + 3.0 * on, surface.all_in_focus + 60.0 * on), wafer, (2, 1))


def no_pattern(dice: Dice) -> Thrown:
    """Blobs of any size, nothing that repeats."""
    from scipy.ndimage import gaussian_filter

    surface = made(replace(any_wafer(dice), pitch_x_um=4000.0, pitch_y_um=4000.0))
    blobs = sum(gaussian_filter(dice.standard_normal(surface.shape), s) * s for s in (2, 6, 15))
    return Thrown(_with(surface, blobs, 100 + 30 * blobs), None)


def _in_dies(surface: HeightMap, wafer: Wafer) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats, Floats, NDArray]:
    """(col, row, u_um, v_um, street) of every pixel."""
    col, row, u, v = wafer.grid.to_die(*np.meshgrid(surface.x_um, surface.y_um))
    return col, row, u, v, (u < 0) | (u > wafer.width_um) | (v < 0) | (v > wafer.height_um)


def _with(surface: HeightMap, z_um: NDArray, grey: NDArray | None = None) -> HeightMap:
    z = z_um.astype(np.float32)
    origin = np.where(np.isfinite(z) | (surface.origin != Origin.MEASURED), surface.origin, Origin.NO_TEXTURE)
    picture = surface.all_in_focus if grey is None else grey.clip(0, 255).astype(np.uint8)
    known = {"z_um": z, "z_raw_um": z, "all_in_focus": picture, "origin": origin.astype(np.uint8)}
    return dataclasses.replace(surface, **known)


LATTICES: dict[str, Callable[[Dice], Thrown]] = {
    "plain, turned by up to 0.3 degrees": plain,
    "turned by 3 degrees": turned,
    "a field is missing": missing_field,
    "eight dies are missing": missing_dies,
    "round wafer, dies cut at its rim": round_wafer,
    "10 % unmeasured in patches, twice the noise": holes,
    "test structures in the streets": busy_streets,
    "die of two blocks, lines between them": _parts(2, 1, 0.5),
    "die of 2 x 2 blocks, no lines": _parts(2, 2, 0.0),
    "die of three blocks, lines like streets": _parts(1, 3, 1.0),
    "two by two dies": few,
    "every other die is another": two_kinds,
}
NO_LATTICES: dict[str, Callable[[Dice], Thrown]] = {
    "one die only": one_die,
    "one row of dies": one_row,
    "turned by 7 to 12 degrees": turned_too_far,
    "nothing repeats": no_pattern,
}
