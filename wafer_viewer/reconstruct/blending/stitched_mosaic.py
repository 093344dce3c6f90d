"""Stitched mosaic of height maps with its pyramid, and the stitched image at one height.

Blending along X and then along Y equals one weight for each field, the product of its ramps; where a neighbour is
missing or unmeasured, the weights of the measured fields are normalised to one.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer._version import __version__
from wafer_viewer.model.acquisition.focus_stack import FieldStack, Image
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.errors import ComputeError, MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.model.surface.frame_health import FrameHealth
from wafer_viewer.model.surface.height_map import AsArray, HeightMap, Provenance, pixel_window
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.numerics.grids.pyramid_level import halve
from wafer_viewer.reconstruct.blending.mosaic_layout import MosaicLayout, layout
from wafer_viewer.reconstruct.blending.window_blend import BLENDS, blend_layers, lay_pictures
from wafer_viewer.reconstruct.preprocess.exposure_fusion import without_shading

LAYERS = ("z_um", "z_raw_um", "confidence", "all_in_focus", "origin")
OPTIONAL = ("overlap_um", "u_um")


def layers_of(height: HeightMap) -> dict[str, NDArray[Any]]:
    """Return the layers of a map by name, including those of `OPTIONAL` that it has."""
    layers = {name: getattr(height, name) for name in (*LAYERS, *OPTIONAL)}
    return {name: layer for name, layer in layers.items() if layer is not None}


def coarser_levels(height: HeightMap) -> Iterator[HeightMap]:
    """Yield the pyramid levels of a map from level 1 on: each pixel is the mean of the measured ones below it."""
    names, layers = layers_of(height), layers_of(height)
    for level in itertools.count(1):
        layers, shift = halve(layers), (2**level - 1) / 2
        yield dataclasses.replace(
            height,
            **{name: layers[name] for name in names},
            refused=None,
            pixel_um=height.pixel_um * 2**level,
            x0_um=height.x0_um + shift * height.pixel_um,
            y0_um=height.y0_um - shift * height.pixel_um,
        )


def joined(bands: Sequence[HeightMap]) -> HeightMap:
    """Concatenate vertically adjacent maps, at the position of the first."""
    if len(bands) == 1:
        return bands[0]
    layers = {name: np.concatenate([getattr(b, name) for b in bands]) for name in layers_of(bands[0])}
    return dataclasses.replace(bands[0], **layers)


_COARSEST_PX = 512
"""Largest longer side of the coarsest level, in pixels."""
_BAND_PX = 2**23
"""Approximate number of pixels of level 0 that are blended together."""


@dataclass(frozen=True, slots=True, eq=False)
class StitchedMosaic(AsArray):
    """A mosaic that is blended when a window of it is requested; level 1 and up are means of it."""

    heights: Sequence[HeightMap]
    layout: MosaicLayout
    provenance: Provenance

    @property
    def poses(self) -> Poses | None:
        """Poses of its fields; None if the positions of the maps are used."""
        return self.layout.poses

    @property
    def pixel_um(self) -> float:
        """Pixel size of level 0."""
        return self.layout.pixel_um

    @property
    def x0_um(self) -> float:
        """Stage x of the centre of pixel (0, 0) of level 0."""
        return self.layout.x0_um

    @property
    def y0_um(self) -> float:
        """Stage y of the centre of pixel (0, 0) of level 0."""
        return self.layout.y0_um

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of level 0."""
        return self.layout.shape

    @property
    def levels(self) -> int:
        """Number of levels until the longer side is at most 512 pixels."""
        return 1 + max(0, math.ceil(math.log2(max(self.shape) / _COARSEST_PX)))

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """Return the part of a level that holds a region, or the entire level without one.

        Raises MeasureError when the region is outside or the level does not exist.
        """
        if not 0 <= level < self.levels:
            raise MeasureError(f"The mosaic has the levels 0 to {self.levels - 1}, level {level} was asked for.")
        scale = 2**level
        rows, cols = (slice(0, -(-n // scale)) for n in self.shape)
        if region is not None:
            rows, cols = pixel_window(self, region, level)
        band = max(1, _BAND_PX // ((cols.stop - cols.start) * scale * scale))
        starts = range(rows.start, rows.stop, band)
        return joined([self._band(slice(r, min(r + band, rows.stop)), cols, level) for r in starts])

    def _band(self, rows: slice, cols: slice, level: int) -> HeightMap:
        scale = 2**level
        fine_rows, fine_cols = (
            slice(part.start * scale, min(part.stop * scale, n))
            for part, n in zip((rows, cols), self.shape, strict=True)
        )
        height = blend_window(self.heights, fine_rows, fine_cols, self.layout, self.provenance)
        return next(itertools.islice(itertools.chain([height], coarser_levels(height)), level, None))


def moved_to(heights: Sequence[HeightMap], fields: Sequence[Field]) -> list[HeightMap]:
    """Return the height maps centred on the positions of fields."""
    if len(heights) != len(fields):
        raise ComputeError(
            f"There are {len(heights)} height maps and {len(fields)} fields: give one field for each map."
        )
    return [
        dataclasses.replace(
            height,
            x0_um=field.x_um - (height.shape[1] - 1) / 2 * height.pixel_um,
            y0_um=field.y_um + (height.shape[0] - 1) / 2 * height.pixel_um,
        )
        for height, field in zip(heights, fields, strict=True)
    ]


def blend_window(
    heights: Sequence[HeightMap],
    rows: slice,
    cols: slice,
    lattice: MosaicLayout | None = None,
    provenance: Provenance | None = None,
) -> HeightMap:
    """Blend the pixels [rows, cols] of the mosaic of height maps; only maps that touch them are read.

    They are blended as the recipe of the provenance says. Memory use depends on the window only, not on the number of
    fields.
    """
    lattice = lattice or layout(heights)
    touching = lattice.touching(rows, cols)
    provenance = provenance or mosaic_provenance([heights[n].provenance for n in touching], Recipe())
    return HeightMap(
        **blend_layers(heights, lattice, rows, cols, BLENDS[provenance.recipe.stitching.blend]),
        pixel_um=lattice.pixel_um,
        x0_um=lattice.x0_um + cols.start * lattice.pixel_um,
        y0_um=lattice.y0_um - rows.start * lattice.pixel_um,
        provenance=provenance,
    )


def blend_pictures(pictures: Sequence[Image], lattice: MosaicLayout, rows: slice, cols: slice) -> Image:
    """Blend the pixels [rows, cols] of the mosaic of one image per field, feathered in the overlaps; 0 elsewhere."""
    return lay_pictures(pictures, lattice, rows, cols, BLENDS["ramp"])


def mosaic_provenance(parts: Sequence[Provenance], recipe: Recipe) -> Provenance:
    """Combine the provenance of fields: common properties; simulated if any field is."""
    if not parts:
        return Provenance(software_version=__version__)
    first = parts[0]
    joint = hashlib.sha256("".join(p.input_checksum for p in parts).encode()).hexdigest()
    return replace(
        first,
        recipe=replace(first.recipe, stitching=recipe.stitching),
        calibration=first.calibration if all(p.calibration == first.calibration for p in parts) else None,
        software_version=__version__,
        input_checksum=first.input_checksum if len(parts) == 1 else joint,
        even_step_um=first.even_step_um if len(parts) == 1 else 0.0,
        simulated=any(p.simulated for p in parts),
        frame_health=FrameHealth.worst(*(p.frame_health for p in parts)),
        notes=(*dict.fromkeys(note for p in parts for note in p.notes), *_mixture(parts)),
    )


def _mixture(parts: Sequence[Provenance]) -> Iterator[str]:
    """Yield a sentence for each property in which the fields differ, unlike those of one scan."""
    simulated = sum(p.simulated for p in parts)
    if 0 < simulated < len(parts):
        yield f"{simulated} of the {len(parts)} fields are simulated and the others are not: stitch fields of one scan."
    if any(p.calibration != parts[0].calibration for p in parts):
        yield "The fields were taken with different calibrations: stitch fields of one scan; lengths are uncalibrated."
    if len({p.z_step_um for p in parts}) > 1:
        steps_um = ", ".join(f"{step_um:g}" for step_um in sorted({p.z_step_um for p in parts}))
        yield f"The fields were taken in steps of {steps_um} um: they are of different scans."


@dataclass(frozen=True, slots=True)
class StackOutline:
    """Position and size of the frames of a stack."""

    pixel_um: float
    x0_um: float
    y0_um: float
    shape: tuple[int, int]

    @classmethod
    def of(cls, stack: FieldStack) -> StackOutline:
        """Return the outline of a stack's frames."""
        return cls(stack.pixel_um, stack.x0_um, stack.y0_um, stack.images.shape[1:])


def picture_at(stack: FieldStack, z_um: float) -> Image:
    """Return the frame of a stack that was taken nearest to z_um, as a view."""
    present = np.flatnonzero(stack.present)
    return stack.images[present[np.argmin(np.abs(stack.z_um[present] - z_um))]]


def stitched_picture(
    stacks: Sequence[FieldStack], z_um: float, rows: slice | None = None, cols: slice | None = None
) -> tuple[Image, MosaicLayout]:
    """Return the pixels [rows, cols] (default: all) of the stitched image at one z, and its lattice."""
    lattice = layout([StackOutline.of(s) for s in stacks])
    rows, cols = rows or slice(0, lattice.shape[0]), cols or slice(0, lattice.shape[1])
    pictures = [without_shading(picture_at(s, z_um), s.shading) for s in stacks]
    return blend_pictures(pictures, lattice, rows, cols), lattice
