"""
Stitch a grid of tiles
======================

Height maps that overlap become one surface, wherever they come from. This example cuts six tiles out of a known
surface, adds errors of the stage, and stitches them again.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy import ndimage

import wafer_viewer as wv

# %%
# The sample has a texture, which the camera sees, and a form. Each tile is off by up to 3 pixels and 0.5 µm in height.

random = np.random.default_rng(4)
pixel_um, tile, overlap = 0.5, (220, 280), 40
shape = (2 * tile[0] - overlap, 3 * tile[1] - 2 * overlap)
grey = 120 + 25 * ndimage.gaussian_filter(random.normal(size=shape), 1.2) / 0.24
row, col = np.mgrid[: shape[0], : shape[1]]
z_um = 3 * np.sin(col / 90) + 0.01 * row + ndimage.gaussian_filter(random.normal(size=shape), 3) * 2


def tile_at(row: int, col: int) -> wv.HeightMap:
    """Return the tile whose corner the stage puts at (row, col), with its errors."""
    off = random.integers(-3, 4, 2)
    rows = np.clip(row + off[0] + np.arange(tile[0]), 0, shape[0] - 1)
    cols = np.clip(col + off[1] + np.arange(tile[1]), 0, shape[1] - 1)
    heights = (z_um[np.ix_(rows, cols)] + random.uniform(-0.5, 0.5) + random.normal(0, 0.02, tile)).astype(np.float32)
    seen = (grey[np.ix_(rows, cols)] + random.normal(0, 1.5, tile)).clip(0, 255).astype(np.uint8)
    return wv.HeightMap(
        z_um=heights,
        z_raw_um=heights,
        confidence=np.ones(tile, np.float32),
        all_in_focus=seen,
        origin=np.full(tile, wv.Origin.MEASURED, np.uint8),
        pixel_um=pixel_um,
        x0_um=col * pixel_um,
        y0_um=-row * pixel_um,
    )


tiles = [tile_at(i * (tile[0] - overlap), j * (tile[1] - overlap)) for i in range(2) for j in range(3)]

# %%
# The overlaps correct the positions of the stage. The recipe of the paper trusts the stage instead.

by_stage = wv.stitch(tiles, recipe=wv.Recipe.paper())
stitched = wv.stitch(tiles)
for name, surface in {"by the stage": by_stage, "by the overlaps": stitched}.items():
    difference_um = np.nanmedian(surface.window().overlap_um)
    print(f"{name:16s} neighbours differ by {difference_um:.3f} um where they overlap")

# %%
# Left: placed by the stage alone. Right: placed by the overlaps.

figure, axes = plt.subplots(1, 2, figsize=(11, 3.6), layout="constrained")
for ax, surface, title in ((axes[0], by_stage, "By the stage"), (axes[1], stitched, "By the overlaps")):
    image = ax.imshow(surface.window().z_raw_um, cmap="viridis", vmin=-4, vmax=7)
    ax.set_title(title)
figure.colorbar(image, ax=axes, label="z, µm")
