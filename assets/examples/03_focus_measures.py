"""
Compare focus measures
======================

A focus measure says how sharp a pixel is. This example runs the four built-in measures on a sample whose heights are
known. It compares how much each one measures, how exact it is, and how often it is wrong.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy import ndimage

import wafer_viewer as wv

# %%
# The sample is a dome 40 µm high. Its texture fades from left to right, so that the right side is hard to measure.

rows, cols, pixel_um, z_step_um = 200, 300, 0.5, 2.0
row, col = np.mgrid[:rows, :cols]
dome_um = 40 * np.exp(-((row - rows / 2) ** 2 + (col - cols / 2) ** 2) / 80**2)
random = np.random.default_rng(1)
contrast = np.linspace(30, 1, cols)
texture = 120 + contrast * ndimage.gaussian_filter(random.normal(size=(rows, cols)), 0.8) / 0.35
blurred = np.stack([ndimage.gaussian_filter(texture, 0.05 + 0.25 * n) for n in range(25)])
z_um = np.arange(-10.0, 52.0, z_step_um)


def image_at(z_um: float) -> np.ndarray:
    """Return the image with the focal plane at a height, with the noise of a camera."""
    defocus = np.minimum(np.abs(z_um - dome_um) / z_step_um, 24)
    image = ndimage.map_coordinates(blurred, [defocus, row, col], order=1) + random.normal(0, 1.5, dome_um.shape)
    return image.clip(0, 255).astype(np.uint8)


stack = wv.FieldStack(
    field=wv.Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=-10.0),
    images=np.stack([image_at(z) for z in z_um]),
    z_um=z_um,
    present=np.ones(len(z_um), bool),
    pixel_um=pixel_um,
)

# %%
# The recipes differ in the measure only. Read completeness and false heights together: a measure that leaves out all
# that is difficult has a small error.

figure, axes = plt.subplots(2, 2, figsize=(9, 6.4), layout="constrained")
quality = {}
for name, ax in zip(["log_laplacian", "tenengrad", "sml", "glv"], axes.flat, strict=True):
    height = wv.reconstruct(stack, wv.Recipe(focus_measure=name))
    quality[name] = wv.compare_with_truth(height, dome_um, tolerance_um=2.0)
    image = ax.imshow(height.z_raw_um - dome_um, cmap="RdBu", vmin=-1, vmax=1)
    ax.set_title(name)
figure.colorbar(image, ax=axes, label="height minus truth, µm", shrink=0.7)

print("measure         measured   RMSE      false")
for name, found in quality.items():
    print(f"{name:14s} {found.completeness_fraction:9.1%} {found.rmse_um:6.2f} um {found.false_fraction:7.2%}")

# %%
# The focus curve of a pixel shows why it has its height, or none. This one lies in the middle of the dome.

curve = wv.focus_curve(stack, 0.0, 0.0)
print(f"height {curve.height_um:.2f} um, truth {dome_um[rows // 2, cols // 2]:.2f} um")
plt.figure(figsize=(6, 3))
plt.plot(curve.z_um, curve.focus, marker=".")
plt.xlabel("z, µm")
plt.ylabel("focus, share of the maximum")
