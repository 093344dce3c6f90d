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
from wafer_viewer.reconstruct.blending.mosaic_layout import MARGIN_PX, PixelLattice, layout, planned_lattice
from wafer_viewer.reconstruct.blending.stitched_mosaic import StitchedMosaic, mosaic_provenance, moved_to
from wafer_viewer.reconstruct.pose_graph.lateral_poses import PreviousSolution
from wafer_viewer.reconstruct.registration.grid_steps import GridSteps, find_steps, mean_steps
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.result import Result
from wafer_viewer.store.mosaic.zarr_mosaic import ZarrMosaic
from wafer_viewer.store.mosaic.zarr_shards import MosaicHeader

OPEN_SURFACES = 600
"""Maximum number of memory-mapped surfaces; a growing mosaic needs all of them at each update.

Each takes a file descriptor, of which a process has 1024 on most systems.
"""
SAME_PIXEL_FRACTION = 1e-6
STEP_ERROR_PX = 4
"""Largest error of the estimated step of a grid in pixels, by which the margin of its mosaic grows with each field."""
NOTED_OVERLAP = 0.005
"""Difference from the assumed overlap (fraction of a field) from which it is noted."""
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
    """Surfaces of a result: its fields, the marks of their content, and a sentence for each unreadable one.

    steps: of the grid, estimated from the images, where its overlap was only assumed; None leaves the fields in place.
    """

    data: Dataset
    stored: Result
    recipe: Recipe
    readable: tuple[Field, ...]
    marks: NDArray[np.int64]
    faults: tuple[str, ...]
    steps: GridSteps | None = None

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
        inputs = cls(data, stored, recipe, tuple(readable), marks, tuple(faults))
        poses = inputs._stitched()[0] if inputs.assumed else None
        return inputs if poses is None else replace(inputs, steps=_steps_of(data, poses))

    @classmethod
    def drawn(cls, dataset: Path, result: str, recipe: Recipe, poses: Poses) -> StitchingInputs:
        """Return the surfaces of solved poses."""
        data = Dataset.open(dataset)
        fields = {f.number: f for f in data.fields}
        listed = tuple(fields[number] for number in poses.numbers.tolist())
        return cls(data, data.result(result), recipe, listed, poses.marks, (), _steps_of(data, poses))

    def with_estimated_steps(self, previous: PreviousSolution, final: bool) -> StitchingInputs:
        """Return the inputs with the steps of the grid as the images show them, if its overlap was only assumed.

        Those of the previous solution stay where nothing has changed, during a scan, and within their error.
        """
        known = self.steps
        is_known = known is not None and not final
        if not self.assumed or (previous.poses is not None and (is_known or previous.unchanged.all())):
            return self
        cells = [(field.row, field.col) for field in self.readable]
        found = find_steps(cells, self.surfaces.__getitem__)
        if found is None or (known is not None and found.is_near(known, 2 * STEP_ERROR_PX)):
            return self
        return replace(self, steps=found)

    @property
    def assumed(self) -> bool:
        """True if the positions of the fields come from an assumed overlap, and are to be estimated."""
        return self.data.scan.assumed_overlap is not None and self.recipe.stitching.poses == "registered"

    @cached_property
    def fields(self) -> tuple[Field, ...]:
        """Fields with a surface, at their nominal positions."""
        return tuple(_placed(field, self.steps, self.data.scan.pixel_um) for field in self.readable)

    def overlap_notes(self, poses: Poses) -> tuple[str, ...]:
        """Return a sentence on the overlap of the fields, where it was assumed and the images say otherwise or nothing.

        Overlaps that fit at one place only confirm what was assumed.
        """
        assumed = self.data.scan.assumed_overlap
        if assumed is None or not self.assumed or np.count_nonzero(~poses.left_out) < 2:
            return ()
        confirmed = poses.shifts.believed & ~poses.shifts.repeats
        if self.steps is None and 2 * np.count_nonzero(confirmed) <= confirmed.size:
            return (
                f"The images do not tell by how much the fields overlap, and the {assumed:.1%} of the import may be "
                "wrong: import them with the right --overlap-fraction if you know it.",
            )
        plan, pixel_um = self.data.scan.plan, self.data.scan.pixel_um
        at_px = np.column_stack((-poses.y_um, poses.x_um))[~poses.left_out] / pixel_um
        cells = [(f.row, f.col) for f, out in zip(self.readable, poses.left_out.tolist(), strict=True) if not out]
        (down, _), (_, right) = mean_steps(cells, at_px).tolist()
        found = {"along rows": 1 - right / plan.cols, "along columns": 1 - down / plan.rows}
        found = {how: overlap for how, overlap in found.items() if math.isfinite(overlap)}
        if all(abs(overlap - assumed) < NOTED_OVERLAP for overlap in found.values()):
            return ()
        return (
            f"The images overlap by {' and '.join(f'{overlap:.1%} {how}' for how, overlap in found.items())}, not by "
            f"the {assumed:.1%} of the import: the fields were placed by the images.",
        )

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
        """Outlines of the fields at their nominal positions."""
        return [FieldOutline.of(self.data, f) for f in self.fields]

    @cached_property
    def lattice(self) -> PixelLattice:
        """Pixel lattice of all planned fields, with a margin for moves; it does not depend on which fields exist."""
        pixel_um = self.data.scan.pixel_um
        outlines = [FieldOutline.of(self.data, _placed(f, self.steps, pixel_um)) for f in self.data.fields]
        stays = len(outlines) == 1 or self.recipe.stitching.poses == "stage"
        longest = 0 if self.steps is None else max(max(f.row, f.col) for f in self.data.fields)
        return planned_lattice(outlines, 0 if stays else MARGIN_PX + longest * STEP_ERROR_PX)

    def previous_solution(self) -> PreviousSolution:
        """Return the previous solution for these surfaces; empty if it was made with other settings or interrupted."""
        poses, header = self._stitched()
        if header is not None:
            placement = header.x0_um, header.y0_um, header.pixel_um, (header.rows, header.cols)
            wanted = self.lattice.x0_um, self.lattice.y0_um, self.lattice.pixel_um, self.lattice.shape
            moved = poses is not None and _steps_of(self.data, poses) != self.steps
            if placement != wanted or moved or header.provenance.recipe.stitching != self.recipe.stitching:
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
        """Height maps at their nominal positions, each opened on access."""
        return Surfaces(self.stored, self.readable, self.steps)

    def mosaic(self, poses: Poses, provenance: Provenance) -> StitchedMosaic:
        """Return the mosaic to be drawn."""
        return StitchedMosaic(self.surfaces, layout(self.outlines, poses, self.lattice), provenance)

    def provenance(self, poses: Poses) -> Provenance:
        """Return the provenance of the mosaic: the common values of its fields, and all notes."""
        opened = (_opened(self.stored, f, self.stored.field_stamp(f), verify=False) for f in self.readable)
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
    """Height maps of fields, each opened on access; steps: of the grid to whose places they are moved."""

    def __init__(self, stored: Result, fields: Sequence[Field], steps: GridSteps | None = None) -> None:
        self._stored, self._fields, self._steps = stored, fields, steps

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
        surface = _opened(self._stored, field, self._stored.field_stamp(field))
        if self._steps is None:
            return surface
        return moved_to([surface], [_placed(field, self._steps, surface.pixel_um)])[0]


def surfaces_of(dataset: Path, result: str, numbers: Iterable[int], steps: GridSteps | None = None) -> Surfaces:
    """Return the height maps of some fields, in their present state; steps: as in `StitchingInputs`."""
    data = Dataset.open(dataset)
    stored = data.result(result)
    return Surfaces(stored, [data.field(number) for number in numbers], steps)


@lru_cache(maxsize=OPEN_SURFACES)
def _opened(stored: Result, field: Field, stamp: int, verify: bool = True) -> HeightMap:
    """Return a surface from the cache; its stamp is part of the key, so that a recomputed one is read again."""
    return stored.surface(field, verify=verify)


def _placed(field: Field, steps: GridSteps | None, pixel_um: float) -> Field:
    """Return a field at its place in a grid with these steps."""
    if steps is None:
        return field
    down_px, right_px = steps.at_px((field.row, field.col))
    return replace(field, x_um=right_px * pixel_um, y_um=-down_px * pixel_um)


def _steps_of(data: Dataset, poses: Poses) -> GridSteps | None:
    """Return the steps of the grid by which the fields of poses were placed; None where they stayed in place."""
    if data.scan.assumed_overlap is None:
        return None
    fields = [data.field(number) for number in poses.numbers.tolist()]
    nominal_um = np.column_stack((poses.stage_y_um, poses.stage_x_um)) * (-1, 1)
    planned_um = np.array([(-field.y_um, field.x_um) for field in fields])
    if np.allclose(nominal_um, planned_um, rtol=0, atol=1e-6):
        return None
    cells, plan = [(field.row, field.col) for field in fields], data.scan.plan
    return GridSteps.between(cells, nominal_um / data.scan.pixel_um, (plan.rows, plan.cols))


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
