"""Microscope image at one height: the frame of a field, or the stitched image of all fields."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wafer_viewer.model.acquisition.focus_stack import FieldStack, Image
from wafer_viewer.reconstruct.blending.mosaic_layout import MosaicLayout, layout
from wafer_viewer.reconstruct.blending.stitched_mosaic import blend_pictures


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
    there = np.flatnonzero(stack.present)
    return stack.images[there[np.argmin(np.abs(stack.z_um[there] - z_um))]]


def stitched_picture(
    stacks: Sequence[FieldStack], z_um: float, rows: slice | None = None, cols: slice | None = None
) -> tuple[Image, MosaicLayout]:
    """Return the pixels [rows, cols] (default: all) of the stitched image at one z, and its lattice."""
    lattice = layout([StackOutline.of(s) for s in stacks])
    rows, cols = rows or slice(0, lattice.shape[0]), cols or slice(0, lattice.shape[1])
    return blend_pictures([picture_at(s, z_um) for s in stacks], lattice, rows, cols), lattice
