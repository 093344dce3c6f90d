"""Inputs of a stitching job: the readable surfaces of a result, their positions, and the areas to draw.

Nothing stays open: workers get the names and open what they need.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import overload

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.model.surface.height_map import HeightMap, Provenance
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.blending.mosaic_layout import PixelLattice, layout, planned_lattice
from wafer_viewer.reconstruct.blending.stitched_mosaic import StitchedMosaic, mosaic_provenance
from wafer_viewer.reconstruct.pose_graph.lateral_poses import PreviousSolution
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.result import Result
from wafer_viewer.store.mosaic.zarr_mosaic import ZarrMosaic
from wafer_viewer.store.mosaic.zarr_shards import MosaicHeader

OPEN_SURFACES = 600
"""Maximum number of memory-mapped surfaces; a growing mosaic needs all of them at each update.

Each takes a file descriptor, of which a process has 1024 on most systems.
"""
SAME_PIXEL_FRACTION = 1e-6
Window = tuple[slice, slice]


@dataclass(frozen=True, slots=True)
class FieldOutline:
    """Outline of a field at its stage position, with or without a surface."""

    pixel_um: float
    x0_um: float
    y0_um: float
    shape: tuple[int, int]

    @property
    def corner_um(self) -> float:
        """Distance in um from the centre to a corner."""
        return math.hypot(*self.shape) / 2 * self.pixel_um

    @classmethod
    def of(cls, data: Dataset, field: Field) -> FieldOutline:
        """Return the outline of a field of a dataset."""
        plan, pixel_um = data.scan.plan, data.scan.pixel_um
        x0_um, y0_um = field.x_um - (plan.cols - 1) / 2 * pixel_um, field.y_um + (plan.rows - 1) / 2 * pixel_um
        return cls(pixel_um, x0_um, y0_um, (plan.rows, plan.cols))


@dataclass(frozen=True)
class StitchingInputs:
    """Surfaces of a result: its fields, the marks of their content, and a sentence for each unreadable one."""

    data: Dataset
    stored: Result
    recipe: Recipe
    fields: tuple[Field, ...]
    marks: NDArray[np.int64]
    faults: tuple[str, ...]

    @classmethod
    def open(cls, dataset: Path, result: str, recipe: Recipe) -> StitchingInputs:
        """Return all existing surfaces. Raises DatasetError when there is none."""
        data = Dataset.open(dataset)
        stored = data.result(result)
        readable, faults = _readable(data, stored)
        if not readable:
            raise DatasetError(
                " ".join(faults) or f"Result {result!r} has no surfaces to stitch: reconstruct it first."
            )
        marks = np.array([stored.field_mark(f) for f in readable], np.int64)
        return cls(data, stored, recipe, tuple(readable), marks, tuple(faults))

    @classmethod
    def drawn(cls, dataset: Path, result: str, recipe: Recipe, poses: Poses) -> StitchingInputs:
        """Return the surfaces of solved poses."""
        data = Dataset.open(dataset)
        fields = {f.number: f for f in data.fields}
        listed = tuple(fields[number] for number in poses.numbers.tolist())
        return cls(data, data.result(result), recipe, listed, poses.marks, ())

    @property
    def name(self) -> tuple[Path, str]:
        """Path of the dataset and name of the result, for a worker that opens them itself."""
        return self.data.path, self.stored.name

    @property
    def numbers(self) -> list[int]:
        """Numbers of the fields."""
        return [f.number for f in self.fields]

    @cached_property
    def outlines(self) -> list[FieldOutline]:
        """Outlines of the fields at their stage positions."""
        return [FieldOutline.of(self.data, f) for f in self.fields]

    @cached_property
    def lattice(self) -> PixelLattice:
        """Pixel lattice of all planned fields, with a margin for moves; it does not depend on which fields exist."""
        outlines = [FieldOutline.of(self.data, f) for f in self.data.fields]
        stays = len(outlines) == 1 or self.recipe.stitching.poses == "stage"
        return planned_lattice(outlines, 0) if stays else planned_lattice(outlines)

    def previous_solution(self) -> PreviousSolution:
        """Return the previous solution for these surfaces; empty if it was made with other settings or interrupted."""
        poses, header = self._stitched()
        if header is not None:
            placement = header.x0_um, header.y0_um, header.pixel_um, (header.rows, header.cols)
            wanted = self.lattice.x0_um, self.lattice.y0_um, self.lattice.pixel_um, self.lattice.shape
            if placement != wanted or header.provenance.recipe.stitching != self.recipe.stitching:
                poses = None
        return PreviousSolution.of(poses, np.array(self.numbers, np.int32), self.marks)

    def _stitched(self) -> tuple[Poses | None, MosaicHeader | None]:
        """Return poses and header of a complete mosaic on disk; None for both if it is missing or damaged."""
        if not self.stored.has_mosaic or self.stored.broken_off:
            return None, None
        try:
            poses, header = self.stored.poses(), ZarrMosaic.open(self.stored.mosaic_path).header
        except DatasetError:
            return None, None
        return (None, None) if poses is None else (poses, header)

    @property
    def surfaces(self) -> Surfaces:
        """Height maps, each opened on access."""
        return Surfaces(self.stored, self.fields)

    def mosaic(self, poses: Poses, provenance: Provenance) -> StitchedMosaic:
        """Return the mosaic to be drawn."""
        return StitchedMosaic(self.surfaces, layout(self.outlines, poses, self.lattice), provenance)

    def provenance(self, poses: Poses) -> Provenance:
        """Return the provenance of the mosaic: the common values of its fields, and all notes."""
        opened = (_opened(self.stored, f, self.stored.field_stamp(f), verify=False) for f in self.fields)
        joint = mosaic_provenance([surface.provenance for surface in opened], self.recipe)
        return replace(joint, notes=(*joint.notes, *poses.notes, *self.faults))

    def windows(self, previous: PreviousSolution, poses: Poses, moved: NDArray[np.bool_]) -> list[Window]:
        """Return the windows of the mosaic to draw again: the earlier and the present positions of moved fields."""
        now = layout(self.outlines, poses, self.lattice)
        windows = [now.window_of(n) for n in np.flatnonzero(moved).tolist()]
        if (before := previous.poses) is not None:
            fields = {f.number: f for f in self.data.fields}
            then = layout(
                [FieldOutline.of(self.data, fields[n]) for n in before.numbers.tolist()], before, self.lattice
            )
            windows += [then.window_of(row) for row in previous.stale(moved).tolist()]
        return [window for window in windows if window is not None]


class Surfaces(Sequence[HeightMap]):
    """Height maps of fields, each opened on access."""

    def __init__(self, stored: Result, fields: Sequence[Field]) -> None:
        self._stored, self._fields = stored, fields

    def __len__(self) -> int:
        return len(self._fields)

    @overload
    def __getitem__(self, n: int) -> HeightMap: ...
    @overload
    def __getitem__(self, n: slice) -> list[HeightMap]: ...
    def __getitem__(self, n: int | slice) -> HeightMap | list[HeightMap]:
        if isinstance(n, slice):
            return [self[i] for i in range(len(self))[n]]
        field = self._fields[n]
        return _opened(self._stored, field, self._stored.field_stamp(field))


def surfaces_of(dataset: Path, result: str, numbers: Iterable[int]) -> Surfaces:
    """Return the height maps of some fields, in their present state."""
    data = Dataset.open(dataset)
    stored = data.result(result)
    return Surfaces(stored, [data.field(number) for number in numbers])


@lru_cache(maxsize=OPEN_SURFACES)
def _opened(stored: Result, field: Field, stamp: int, verify: bool = True) -> HeightMap:
    """Return a surface from the cache; its stamp is part of the key, so that a recomputed one is read again."""
    return stored.surface(field, verify=verify)


def _readable(data: Dataset, stored: Result) -> tuple[list[Field], list[str]]:
    """Return the fields with a readable surface, and a sentence for each unreadable one.

    The heights are not read here; their checksums are verified on access.
    """
    readable, faults = list[Field](), list[str]()
    done = stored.surfaces_done(data.fields)
    for field in (f for f in data.fields if f.number in done):
        try:
            _require_own(_opened(stored, field, stored.field_stamp(field), verify=False), FieldOutline.of(data, field))
        except DatasetError as fault:
            faults.append(f"Field {field.number} is left out: {fault}")
        else:
            readable.append(field)
    return readable, faults


def _require_own(surface: HeightMap, outline: FieldOutline) -> None:
    """Raise DatasetError for a surface of another dataset: of another size, pixel or position than the field."""
    if surface.shape != outline.shape or abs(surface.pixel_um / outline.pixel_um - 1) > SAME_PIXEL_FRACTION:
        rows, cols = surface.shape
        raise DatasetError(
            f"its surface has {cols} x {rows} pixels of {surface.pixel_um:g} um, its frames {outline.shape[1]} x "
            f"{outline.shape[0]} of {outline.pixel_um:g}: it is of another dataset; reconstruct the field again."
        )
    away_um = math.hypot(surface.x0_um - outline.x0_um, surface.y0_um - outline.y0_um)
    if away_um > outline.pixel_um:
        raise DatasetError(
            f"its surface lies {away_um:.0f} um from where the plan has the field: it is of another dataset; "
            "reconstruct the field again."
        )
