"""
Heights from your own images
============================

Any focus stack will do: a folder of images, taken at equal steps of the focus. This example first writes such a folder.
With your own images, begin at ``open_stack``.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tifffile
from scipy import ndimage

import wafer_viewer as wv

# %%
# The sample is a textured dome, 40 µm high. Each image is sharp where the focal plane meets it, and blurred elsewhere.

folder = Path(tempfile.mkdtemp())
rows, cols, pixel_um, z_step_um = 240, 320, 0.5, 2.0
row, col = np.mgrid[:rows, :cols]
dome_um = 40 * np.exp(-((row - rows / 2) ** 2 + (col - cols / 2) ** 2) / 80**2)
random = np.random.default_rng(1)
texture = 120 + 30 * ndimage.gaussian_filter(random.normal(size=(rows, cols)), 0.8) / 0.35
blurred = np.stack([ndimage.gaussian_filter(texture, 0.05 + 0.25 * n) for n in range(25)])

for k, z_um in enumerate(np.arange(-10.0, 52.0, z_step_um)):
    defocus = np.abs(z_um - dome_um) / z_step_um
    image = ndimage.map_coordinates(blurred, [np.minimum(defocus, 24), row, col], order=1)
    image += random.normal(0, 1.5, image.shape)
    tifffile.imwrite(folder / f"image_{k:03d}.tif", image.clip(0, 255).astype(np.uint8))

# %%
# Images state neither the step of the focus nor the pixel size, so both are given here. The lowest image comes first; a
# negative step means that the images were taken downward.

stack = wv.open_stack(folder, z_step_um=z_step_um, pixel_um=pixel_um, z_start_um=-10.0)
height = wv.reconstruct(stack)
print(f"{height.measured.mean():.0%} measured, {np.nanmin(height.z_um):.1f} to {np.nanmax(height.z_um):.1f} um")

# %%
# The all-in-focus image takes each pixel from its sharpest frame.

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
left.imshow(height.all_in_focus, cmap="gray")
left.set_title("All in focus")
heights = right.imshow(height.z_um, cmap="viridis")
right.set_title("Height")
figure.colorbar(heights, ax=right, label="z, µm")

# %%
# The ending picks the format of the export. What a format cannot hold is said by a warning in the result.

wv.export(height, folder / "dome.x3p")
print(*sorted(path.name for path in folder.glob("dome*")))
