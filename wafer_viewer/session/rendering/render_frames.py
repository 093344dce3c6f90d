"""Camera images for the page: a frame of a field, or the stitched image at one z, at scene height 0."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.draw.surface import mesh
from wafer_viewer.draw.surface.display_style import eight_bit
from wafer_viewer.draw.surface.glb import painted
from wafer_viewer.session.rendering.render_request import RenderRequest
from wafer_viewer.session.rendering.surface_source import SurfaceProvider

_FRAME_SIDE_PX = 1024
_SLICE_PIXELS = 1_500_000
_STRIP_ROWS = 512


def frame(shelf: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return frame k of a field as a flat picture at height 0."""
    stack = shelf.stacks(request.source)[0]
    if not stack.present[request.k]:
        return b""
    step = -(-max(stack.images.shape[1:]) // _FRAME_SIDE_PX)
    image = eight_bit(stack.images[request.k][::step, ::step])
    half_x, half_y = (n * stack.pixel_um / 2 for n in (stack.images.shape[2], stack.images.shape[1]))
    x, y = stack.field.x_um, stack.field.y_um
    lying = mesh.flat((x - half_x) * 1e-3, (y - half_y) * 1e-3, (x + half_x) * 1e-3, (y + half_y) * 1e-3)
    return painted(lying, _grey(image))


def stitched(shelf: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return the image of all fields at one z, each from its nearest frame, blended like the surfaces."""
    from wafer_viewer.reconstruct.blending.mosaic_layout import layout
    from wafer_viewer.reconstruct.blending.stitched_slice import StackOutline, stitched_picture

    stacks = shelf.stacks(request.source)
    if not stacks:
        return b""
    lattice = layout([StackOutline.of(s) for s in stacks])
    step = max(1, round((lattice.shape[0] * lattice.shape[1] / _SLICE_PIXELS) ** 0.5))
    height = _STRIP_ROWS // step * step
    strips = [
        eight_bit(
            stitched_picture(stacks, request.z_um, slice(r, min(r + height, lattice.shape[0])))[0][::step, ::step]
        )
        for r in range(0, lattice.shape[0], height)
    ]
    x0, y1 = lattice.x0_um - lattice.pixel_um / 2, lattice.y0_um + lattice.pixel_um / 2
    x1, y0 = x0 + lattice.shape[1] * lattice.pixel_um, y1 - lattice.shape[0] * lattice.pixel_um
    lying = mesh.flat(x0 * 1e-3, y0 * 1e-3, x1 * 1e-3, y1 * 1e-3)
    return painted(lying, _grey(np.concatenate(strips)))


def _grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.repeat(image[..., None], 3, axis=2)
