"""The virtual rig's own wafer: is the gel drop found, the scratch, every particle of 8 px and more, and what else?

All of it is 6 x 6 mm: fields of 1080 x 1440 pixels, 60 frames each, with the rig's optics and sensor and the default
recipe, laid side by side where they belong (no stage errors). Fields are kept, so that a run that was stopped goes on.
The true places come from the scene's own functions (tests/truth/virtual_wafer.py).
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.bench.harness import HOME, met, show
from tests.truth.virtual_wafer import PIXEL_UM, ROOM_UM, Known, chipped_share, ground, known, own_to_the_die
from wafer_viewer.measure.defects.inspection import inspect
from wafer_viewer.measure.dies.die_lattice import find_dies
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Provenance, pixel_window
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.rigs.virtual.camera import Sensor
from wafer_viewer.rigs.virtual.optics.optics import FieldPicture, Optics
from wafer_viewer.rigs.virtual.scenes.catalogue import SCENES
from wafer_viewer.store.formats.npz_file import read_npz, write_npz
from wafer_viewer.store.mosaic.zarr_mosaic import ZarrMosaic, write_mosaic

LEAST_PX, MOST_FALSE = 8, 2
ON_DIES = "die", "die's edge", "trench"
CROP_PX = 16
_LAYERS = ("z_um", "z_raw_um", "confidence", "all_in_focus", "origin")


@dataclass(frozen=True)
class Part:
    """A part of the wafer, made of fields: its upper left corner in stage um, fields, and how they are taken."""

    name: str
    x_um: float
    y_um: float
    rows: int
    cols: int
    field_px: tuple[int, int] = (1048, 1408)
    step_um: float = 1.0
    frames: int = 60

    @property
    def folder(self) -> Path:
        """Where its fields are kept."""
        return HOME / f"paper-{self.name}"

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of pixels."""
        return self.rows * self.field_px[0], self.cols * self.field_px[1]

    @property
    def corners_um(self) -> tuple[float, float, float, float]:
        """x low, y low, x high, y high on the stage."""
        rows, cols = self.shape
        return self.x_um, self.y_um - rows * PIXEL_UM, self.x_um + cols * PIXEL_UM, self.y_um

    @property
    def area_mm2(self) -> float:
        """Of all pixels."""
        return self.shape[0] * self.shape[1] * (PIXEL_UM / 1000) ** 2


WHOLE = Part("whole", -3010.0, 3010.0, 13, 10, (992, 1289))
QUICK = Part("quick", -14.0, 814.0, 2, 3, (886, 1140), 2.0, 30)
"""Three by two dies: those with the gel drop and the scratch."""


@dataclass(frozen=True)
class Laid:
    """Kept fields as one surface, read when it is asked for."""

    part: Part
    levels: int = 1
    pixel_um: float = PIXEL_UM
    provenance: Provenance = Provenance(simulated=True)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.part.shape

    @property
    def x0_um(self) -> float:
        """Stage x of pixel (0, 0)."""
        return self.part.x_um

    @property
    def y0_um(self) -> float:
        """Stage y of pixel (0, 0)."""
        return self.part.y_um

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """The part that holds a region."""
        whole = slice(0, self.shape[0]), slice(0, self.shape[1])
        rows, cols = whole if region is None else pixel_window(self, region, level)
        size = rows.stop - rows.start, cols.stop - cols.start
        kinds = (np.float32, np.float32, np.float32, np.uint8, np.uint8)
        layers = {name: np.empty(size, kind) for name, kind in zip(_LAYERS, kinds, strict=True)}
        high, wide = self.part.field_px
        for r in range(rows.start // high, (rows.stop - 1) // high + 1):
            for c in range(cols.start // wide, (cols.stop - 1) // wide + 1):
                one = read_npz(file_of(self.part, r, c))
                top, bottom = max(rows.start, r * high), min(rows.stop, (r + 1) * high)
                left, right = max(cols.start, c * wide), min(cols.stop, (c + 1) * wide)
                inner = slice(top - r * high, bottom - r * high), slice(left - c * wide, right - c * wide)
                into = slice(top - rows.start, bottom - rows.start), slice(left - cols.start, right - cols.start)
                for name, layer in layers.items():
                    layer[into] = getattr(one, name)[inner]
        x0_um, y0_um = self.x0_um + cols.start * PIXEL_UM, self.y0_um - rows.start * PIXEL_UM
        overlap = np.full(size, np.nan, np.float32)
        return HeightMap(
            **layers, pixel_um=PIXEL_UM, x0_um=x0_um, y0_um=y0_um, provenance=self.provenance, overlap_um=overlap
        )


def file_of(part: Part, row: int, col: int) -> Path:
    return part.folder / f"r{row:02d}c{col:02d}.npz"


def scanned(part: Part) -> ZarrMosaic:
    """The part's surface; only fields that are not kept yet are taken."""
    part.folder.mkdir(parents=True, exist_ok=True)
    mosaic = part.folder / "mosaic.zarr"
    if not mosaic.exists():
        for row in range(part.rows):
            for col in range(part.cols):
                if not file_of(part, row, col).exists():
                    write_npz(field(part, row, col), file_of(part, row, col))
        write_mosaic(mosaic, Laid(part))
    return ZarrMosaic.open(mosaic)


def field(part: Part, row: int, col: int) -> HeightMap:
    """One field, taken and reconstructed, without the border that its windows reach beyond."""
    scene, (high, wide) = SCENES["wafer"], part.field_px
    shape = high + 2 * CROP_PX, wide + 2 * CROP_PX
    x_um = part.x_um + (col * wide + (wide - 1) / 2) * PIXEL_UM
    y_um = part.y_um - (row * high + (high - 1) / 2) * PIXEL_UM
    z_um = scene.tour_z_start_um + part.step_um * np.arange(part.frames) + _lean_um(x_um, y_um)
    picture = FieldPicture(scene, Optics(), x_um, y_um, *shape, (float(z_um[0]) - 5, float(z_um[-1]) + 5))
    sensor, first = Sensor(*shape), 1000 * (row * part.cols + col)
    images = np.stack([sensor.expose(picture.radiance(z), scene.gain, first + k) for k, z in enumerate(z_um)])
    place = Field(number=1, row=0, col=0, x_um=x_um, y_um=y_um, z_start_um=float(z_um[0]))
    stack = FieldStack(place, images, z_um, np.ones(len(z_um), bool), PIXEL_UM, simulated=True)
    return _cropped(reconstruct(stack, Recipe(), threads=1))


def _lean_um(x_um: float, y_um: float) -> float:
    """The wafer leans and is bowed: the sweep follows, as a scan's plan does. It is read from the scene's ground."""
    return 1.2e-3 * x_um - 0.7e-3 * y_um - 0.3e-6 * (x_um**2 + y_um**2)


def _cropped(surface: HeightMap) -> HeightMap:
    inner = slice(CROP_PX, surface.shape[0] - CROP_PX), slice(CROP_PX, surface.shape[1] - CROP_PX)
    small = surface.crop(*inner)
    return dataclasses.replace(small, **{name: np.ascontiguousarray(getattr(small, name)) for name in _LAYERS})


def show_paper(quick: bool) -> None:
    """The goals, and where what is missed and false lies."""
    part = QUICK if quick else WHOLE
    surface = scanned(part)
    told(part, inspect(surface, find_dies(surface)))


def told(part: Part, found: Inspection) -> None:
    """What an inspection of a part made of what is known to be there."""
    there = known(*part.corners_um)
    caught = [one for one in there if any(_touch(one, defect) for defect in found.found)]
    others = [defect for defect in found.found if not any(_touch(one, defect) for one in there)]
    why = Counter(own_to_the_die(defect.center.x_um, defect.center.y_um) for defect in others)
    false = [defect for defect in others if not own_to_the_die(defect.center.x_um, defect.center.y_um)]
    large = [one for one in there if one.kind == "particle" and 2 * one.radius_um >= LEAST_PX * PIXEL_UM]
    rows = [
        (f"particles of {LEAST_PX} px and more, {on}", *_count(caught, [p for p in large if p.on == on]))
        for on in (*ON_DIES, "no die", "tape")
    ]
    on_dies = [one for one in large if one.on in ON_DIES]
    small = [one for one in there if one.kind == "particle" and one not in large and one.on in ON_DIES]
    rows += [
        ("smaller particles on dies and round them", *_count(caught, small)),
        ("gel drop", *_count(caught, [one for one in there if one.kind == "gel"])),
        ("scratch, pieces of 4 um", *_count(caught, [one for one in there if one.kind == "scratch"])),
    ]
    show(f"The virtual rig's wafer, {part.area_mm2:.1f} mm2", ("", "found", "of"), rows)
    where = Counter(ground(defect.center.x_um, defect.center.y_um) for defect in false)
    kinds = Counter(defect.kind for defect in false)
    differ = ", ".join(f"{n} at a {reason}" for reason, n in why.items() if reason)
    goal = f"goal {MOST_FALSE} on 36 mm2 {met(len(false), MOST_FALSE)}"
    near = f"{chipped_share(1, 1):.0%} of a die's outline lies within {ROOM_UM:.0f} um of a chip of a pixel or more"
    print(
        f"  inspected {found.inspected_mm2:.1f} mm2, against {found.reference}: {len(found.found)} defects\n"
        f"  {len(false)} false ({goal}): {dict(where)}, {dict(kinds)}\n"
        f"  where dies truly differ: {differ}; {near}\n"
        f"  particles of {LEAST_PX} px and more on dies and round them: {sum(p in caught for p in on_dies)} of "
        f"{len(on_dies)}, goal all {met(sum(p in caught for p in on_dies), len(on_dies), True)}; where no die stands "
        "nothing is compared",
        flush=True,
    )


def _count(caught: Sequence[Known], some: Sequence[Known]) -> tuple[int, int]:
    return sum(one in caught for one in some), len(some)


def _touch(one: Known, defect: Defect) -> bool:
    """Whether a defect's middle lies on it, or it reaches into the defect's outline."""
    reach_um = one.radius_um + ROOM_UM
    if math.hypot(defect.center.x_um - one.x_um, defect.center.y_um - one.y_um) <= reach_um:
        return True
    xa, ya, xb, yb = defect.outline.bounds_um
    if not (xa - reach_um <= one.x_um <= xb + reach_um and ya - reach_um <= one.y_um <= yb + reach_um):
        return False
    around = np.linspace(0, 2 * np.pi, 9)[:-1]
    x_um = one.x_um + reach_um * np.append(0, np.cos(around))
    y_um = one.y_um + reach_um * np.append(0, np.sin(around))
    return bool(defect.outline.contains(x_um, y_um).any())
