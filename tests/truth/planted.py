"""What is planted on a patterned wafer: which defects, how large, where; thrown with dice of the run's seed."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray

PIXEL_UM = 0.46729
PITCH_PX, STREET_PX, DEPTH_UM = (300, 240), 24, 3.0
DIE_UM = tuple((pitch - STREET_PX) * PIXEL_UM for pitch in PITCH_PX)
PITCH_UM = tuple(pitch * PIXEL_UM for pitch in PITCH_PX)
Kind = Literal["particle", "pit", "scratch", "residue", "edge chip", "missing die", "tilted die"]
GEOMETRIC: tuple[Kind, ...] = ("particle", "pit", "scratch", "residue", "edge chip")
DIAMETERS_PX, HEIGHTS_SIGMA = (6, 10, 20, 40), (3, 6)
RESIDUE_SCALE, SCRATCH_SCALE = 2, 4
"""A residue is wide and a scratch is long: so many times the diameter of the others, which stands in the tables."""
TILT = 0.04
_CLEAR_PX = 8


@dataclass(frozen=True, slots=True)
class Planted:
    """One defect: its middle in stage um, the die (col, row), and its size.

    diameter_px: what the tables go by; length_um, width_um: of its outline; height_um: signed, to its extreme.
    """

    kind: Kind
    x_um: float
    y_um: float
    die: tuple[int, int]
    diameter_px: int = 0
    height_sigma: int = 0
    length_um: float = 0.0
    width_um: float = 0.0
    height_um: float = 0.0
    angle_rad: float = 0.0

    def holds(self, x_um: float, y_um: float, room_um: float) -> bool:
        """Whether a place lies within the outline or `room_um` around it."""
        dx, dy = x_um - self.x_um, y_um - self.y_um
        cos, sin = np.cos(self.angle_rad), np.sin(self.angle_rad)
        along, across = abs(dx * cos + dy * sin), abs(dy * cos - dx * sin)
        return bool(along <= self.length_um / 2 + room_um and across <= self.width_um / 2 + room_um)


@dataclass(frozen=True, slots=True)
class Plan:
    """A wafer of whole dies and what goes wrong on it.

    misplaced_px: deviation of each die along x and y; bow_um: how far its corners lie below its middle; seen: whether
    defects look different from what they lie on, or only stand out in height; defective: share of the dies with one.
    """

    cols: int = 9
    rows: int = 8
    seed: int = 1
    misplaced_px: float = 0.5
    bow_um: float = 10.0
    seen: bool = True
    defective: float = 0.7
    odd_dies: bool = True
    margin_px: int = 60

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of pixels: the dies, and a margin with parts of their neighbours."""
        return self.rows * PITCH_PX[1] + 2 * self.margin_px, self.cols * PITCH_PX[0] + 2 * self.margin_px

    @property
    def size_um(self) -> tuple[float, float]:
        """Width and height of the whole dies with their streets; their lower left corner is stage (0, 0)."""
        return self.cols * PITCH_UM[0], self.rows * PITCH_UM[1]


def die_errors(plan: Plan) -> NDArray[np.float64]:
    """[col + 1, row + 1, (dx_um, dy_um, there, tilt)] of every die, the cut ones around the whole ones too."""
    rng = np.random.default_rng((plan.seed, 1))
    errors = np.zeros((plan.cols + 2, plan.rows + 2, 4))
    errors[..., :2] = plan.misplaced_px * PIXEL_UM * rng.standard_normal(errors[..., :2].shape)
    errors[..., 2] = 1
    for odd in _odd_dies(plan):
        col, row = odd.die
        errors[col + 1, row + 1, 2:] = (0, 0) if odd.kind == "missing die" else (1, TILT)
    return errors


def planted(plan: Plan, sigma_um: float) -> tuple[Planted, ...]:
    """Everything that is wrong: at most one defect a die; heights are multiples of sigma_um."""
    rng = np.random.default_rng((plan.seed, 2))
    odd = _odd_dies(plan)
    free = [die for die in product(range(plan.cols), range(plan.rows)) if die not in {o.die for o in odd}]
    dies = [free[n] for n in rng.permutation(len(free))[: round(plan.defective * len(free))]]
    wanted = list(product(GEOMETRIC, HEIGHTS_SIGMA, DIAMETERS_PX))
    first = int(rng.integers(len(wanted)))
    order = rng.permutation(len(wanted))
    chosen = [wanted[order[(first + n) % len(wanted)]] for n in range(len(dies))]
    return (*odd, *(_plant(*what, die, sigma_um, rng) for what, die in zip(chosen, dies, strict=True)))


def _odd_dies(plan: Plan) -> tuple[Planted, ...]:
    """One die that is missing and one that is tilted, not at the border of the wafer."""
    if not plan.odd_dies:
        return ()
    rng = np.random.default_rng((plan.seed, 3))
    inner = list(product(range(1, plan.cols - 1), range(1, plan.rows - 1)))
    inner = inner if len(inner) > 1 else list(product(range(plan.cols), range(plan.rows)))
    places = [inner[n] for n in rng.permutation(len(inner))[:2]]
    heights = -DEPTH_UM, TILT * DIE_UM[0] / 2
    kinds: tuple[Kind, Kind] = ("missing die", "tilted die")
    return tuple(
        Planted(kind, *_middle(die), die, length_um=DIE_UM[0], width_um=DIE_UM[1], height_um=height)
        for kind, die, height in zip(kinds, places, heights, strict=True)
    )


def _middle(die: tuple[int, int]) -> tuple[float, float]:
    return (die[0] + 0.5) * PITCH_UM[0], (die[1] + 0.5) * PITCH_UM[1]


def _plant(
    kind: Kind, sigmas: int, diameter_px: int, die: tuple[int, int], sigma_um: float, rng: np.random.Generator
) -> Planted:
    size_um, width_um, angle = diameter_px * PIXEL_UM, diameter_px * PIXEL_UM, 0.0
    height_um = sigmas * sigma_um * (-1 if kind in ("pit", "scratch") else 1)
    if kind == "edge chip":
        return Planted(kind, *_at_edge(die, rng), die, diameter_px, sigmas, size_um, width_um, -DEPTH_UM)
    if kind == "residue":
        size_um = width_um = RESIDUE_SCALE * size_um
    if kind == "scratch":
        size_um, width_um = SCRATCH_SCALE * size_um, float(rng.uniform(3, 5)) * PIXEL_UM
        angle = float(rng.uniform(0, np.pi))
    along, up = (abs(np.cos(angle)), abs(np.sin(angle))) if kind == "scratch" else (1.0, 1.0)
    x_um, y_um = (
        middle + float(rng.uniform(-1, 1)) * max(0.0, (die_um - share * size_um) / 2 - _CLEAR_PX * PIXEL_UM)
        for middle, die_um, share in zip(_middle(die), DIE_UM, (along, up), strict=True)
    )
    return Planted(kind, x_um, y_um, die, diameter_px, sigmas, size_um, width_um, height_um, angle)


def _at_edge(die: tuple[int, int], rng: np.random.Generator) -> tuple[float, float]:
    """A place on one of the four sides of a die, away from its corners."""
    side, along, upright = rng.choice([-0.5, 0.5]), rng.uniform(-0.35, 0.35), rng.random() < 0.5
    off = (side, along) if upright else (along, side)
    x_um, y_um = (m + float(share) * width for m, share, width in zip(_middle(die), off, DIE_UM, strict=True))
    return x_um, y_um
