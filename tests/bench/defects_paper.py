"""The virtual rig's own wafer: is the gel drop found, the scratch, every particle of 8 px and more, and what else?

All of it is 6 x 6 mm: fields of 1080 x 1440 pixels, 60 frames each, with the rig's optics and sensor and the default
recipe, laid side by side where they belong (no stage errors). Fields are kept, so that a run that was stopped goes on.
The true places come from the scene's own functions.
"""

from __future__ import annotations

import dataclasses
import math
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.bench.tables import met, show
from wafer_viewer.measure.defects import inspect
from wafer_viewer.measure.die_grid import find_dies
from wafer_viewer.model.defects import Defect, Inspection
from wafer_viewer.model.plan import Field
from wafer_viewer.model.recipe import Recipe
from wafer_viewer.model.region import Region
from wafer_viewer.model.stack import FieldStack
from wafer_viewer.model.surface import HeightMap, Provenance, pixel_window
from wafer_viewer.reconstruct.field import reconstruct
from wafer_viewer.rigs.virtual.noise import chance
from wafer_viewer.rigs.virtual.optics import FieldPicture, Optics
from wafer_viewer.rigs.virtual.scene import SCENES
from wafer_viewer.rigs.virtual.scenes import wafer
from wafer_viewer.rigs.virtual.sensor import Sensor
from wafer_viewer.store.mosaic import ZarrMosaic, write_mosaic
from wafer_viewer.store.npz import read_npz, write_npz

PIXEL_UM, LEAST_PX, MOST_FALSE = 0.46729, 8, 2
ROOM_UM = 3.0
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
        return Path(tempfile.gettempdir()) / "wafer-viewer-bench" / f"paper-{self.name}"

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of pixels."""
        return self.rows * self.field_px[0], self.cols * self.field_px[1]

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


@dataclass(frozen=True)
class Known:
    """Something that is on the wafer: where, how far it reaches, what it lies on."""

    kind: str
    x_um: float
    y_um: float
    radius_um: float
    on: str


def known(part: Part) -> list[Known]:
    """Gel drop, pieces of the scratch and particles in a part."""
    gel_x = wafer.GEL_COLUMN * wafer.PITCH_X_UM + wafer.TRENCH_UM / 2 + wafer.GEL_U_UM
    gel_y = wafer.GEL_ROW * wafer.PITCH_Y_UM + wafer.TRENCH_UM / 2 + wafer.GEL_V_UM
    everything = [Known("gel", gel_x, gel_y, wafer.GEL_RADIUS_UM, "die"), *scratch(), *particles()]
    right = part.x_um + part.shape[1] * PIXEL_UM
    low = part.y_um - part.shape[0] * PIXEL_UM
    inside = (one for one in everything if part.x_um < one.x_um < right and low < one.y_um < part.y_um)
    return list(inside)


def particles() -> Iterator[Known]:
    """Every grain of dust that the scene's dice have put on the wafer or beside it."""
    most = math.ceil(wafer.RADIUS_UM * 1.1 / wafer.PARTICLE_CELL_UM)
    for i in range(-most, most):
        for j in range(-most, most):
            if chance(i, j, wafer.PARTICLE) < wafer.PARTICLE_SHARE:
                x_um = (i + 0.1 + 0.8 * chance(i, j, wafer.PARTICLE_X)) * wafer.PARTICLE_CELL_UM
                y_um = (j + 0.1 + 0.8 * chance(i, j, wafer.PARTICLE_Y)) * wafer.PARTICLE_CELL_UM
                radius_um = 1.6 + 4.6 * chance(i, j, wafer.PARTICLE_SIZE) ** 2
                yield Known("particle", x_um, y_um, radius_um, ground(x_um, y_um))


def scratch() -> Iterator[Known]:
    """The scratch where it touches a die, a piece every 4 um."""
    for x_um in np.arange(wafer.SCRATCH_LEFT_UM, wafer.SCRATCH_RIGHT_UM, 4.0):
        along = x_um - wafer.SCRATCH_LEFT_UM
        y_um = 214.0 + 0.31 * along + 13.0 * math.sin(x_um / 190.0)
        groove, _ = wafer.scratch(float(x_um), y_um, PIXEL_UM)
        if groove > 0.5 and ground(float(x_um), y_um) == "die":
            yield Known("scratch", float(x_um), y_um, 4.0, "die")


def ground(x_um: float, y_um: float) -> str:
    """What lies at a place: a die, its edge (within 8 um), a trench, or the tape beyond the wafer."""
    column, row = math.floor(x_um / wafer.PITCH_X_UM), math.floor(y_um / wafer.PITCH_Y_UM)
    if math.hypot(x_um, y_um) > wafer.RADIUS_UM or y_um < wafer.FLAT_UM:
        return "tape"
    if not wafer.is_whole_die(column, row):
        return "no die"
    half = wafer.TRENCH_UM / 2
    inset = wafer.die_inset(x_um - column * wafer.PITCH_X_UM - half, y_um - row * wafer.PITCH_Y_UM - half)
    return "die" if inset > 8 else "die's edge" if inset > -8 else "trench"


def show_paper(quick: bool) -> None:
    """The goals, and where what is missed and false lies."""
    part = QUICK if quick else WHOLE
    surface = scanned(part)
    told(part, inspect(surface, find_dies(surface)))


def told(part: Part, found: Inspection) -> None:
    """What an inspection of a part made of what is known to be there."""
    there = known(part)
    caught = [one for one in there if any(_touch(one, defect) for defect in found.found)]
    false = [defect for defect in found.found if not any(_touch(one, defect) for one in there)]
    large = [one for one in there if one.kind == "particle" and 2 * one.radius_um >= LEAST_PX * PIXEL_UM]
    rows = [(f"particles of {LEAST_PX} px and more, {on}", *_count(caught, [p for p in large if p.on == on])) for on in
            ("die", "die's edge", "trench", "no die", "tape")]  # fmt: skip
    small = [one for one in there if one.kind == "particle" and one not in large]
    rows += [
        ("smaller particles", *_count(caught, small)),
        ("gel drop", *_count(caught, [one for one in there if one.kind == "gel"])),
        ("scratch, pieces of 4 um", *_count(caught, [one for one in there if one.kind == "scratch"])),
    ]
    show(f"The virtual rig's wafer, {part.area_mm2:.1f} mm2", ("", "found", "of"), rows)
    where = Counter(ground(defect.center.x_um, defect.center.y_um) for defect in false)
    classes = Counter(defect.kind for defect in false)
    print(
        f"  inspected {found.inspected_mm2:.1f} mm2, against {found.reference}; {len(found.found)} defects, "
        f"{len(false)} false (goal {MOST_FALSE} on 36 mm2 {met(len(false), MOST_FALSE)}): {dict(where)}, "
        f"{dict(classes)}\n  every particle of {LEAST_PX} px: {met(sum(p in caught for p in large), len(large), True)}",
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


__all__ = ["QUICK", "WHOLE", "known", "scanned", "show_paper", "told"]
