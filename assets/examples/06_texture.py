"""
Areal texture
=============

This example measures the roughness of a face by ISO 25178-2. The form is removed first; filters choose the scale.
"""

import matplotlib.pyplot as plt
import numpy as np

import wafer_viewer as wv

surface = wv.read_surface("scan.wafer")
face = wv.Region.rectangle(700, 470, 780, 520)

# %%
# Without filters, all waves between the pixel and the region count.

plain = wv.texture(surface, face)
print(f"Sa = {plain.sa}, Sq = {plain.sq}, Sz = {plain.sz}")

# %%
# The S-filter removes waves shorter than its nesting index, the L-filter longer ones. U comes from the uncertainty of
# the heights; a noise that was measured takes its place.

filtered = wv.texture(surface, face, s_filter_um=6.5, l_filter_um=40.0, noise_um=0.1)
print(f"Sa = {filtered.sa}, Sq = {filtered.sq}, Sz = {filtered.sz}")
print(*filtered.notes, sep="\n")

# %%
# The heights of the region, and their distribution.

part = surface.window(face).z_raw_um
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.4), layout="constrained")
image = left.imshow(part, cmap="viridis")
figure.colorbar(image, ax=left, label="z, µm")
right.hist(part[np.isfinite(part)] - np.nanmedian(part), bins=60)
right.set(xlabel="z over the median, µm", ylabel="pixels")
