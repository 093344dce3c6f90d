"""
Step height with its uncertainty
================================

A step height is the distance of two faces. This example measures the dies of the virtual wafer over the streets between
them, with the expanded uncertainty U and its budget.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Rectangle

import wafer_viewer as wv

# %%
# Regions are in micrometres on the stage. Choose flat ground of one level for each; a face may have several regions.
# Regions on both sides of the other face make the result insensitive to tilt.

surface = wv.read_surface("scan.wafer")
die = [wv.Region.rectangle(692, 670, 776, 686), wv.Region.rectangle(692, 604, 776, 620)]
streets = [wv.Region.rectangle(692, 785, 776, 797), wv.Region.rectangle(692, 390, 776, 410)]

step = wv.step_height(surface, upper=die, lower=streets)
print(f"h = {step.height}")  # the virtual wafer has 30.00 um

# %%
# The result is a number with its budget. Contributions that nobody evaluated are named, never left out silently.

for line in step.height.budget:
    print(f"{line.name:45s} {line.u_um:.4f} um" if line.u_um is not None else f"{line.name:45s} not evaluated")

# %%
# The regions lie on the die and in the streets.

z_um = np.asarray(surface)
left, bottom, right, top = surface.window().bounds_um
figure, ax = plt.subplots(figsize=(8, 5.5), layout="constrained")
image = ax.imshow(z_um, extent=(left, right, bottom, top), cmap="viridis", vmin=-3, vmax=48)
for regions, colour in ((die, "red"), (streets, "white")):
    for region in regions:
        x0, y0, x1, y1 = region.bounds_um
        ax.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, edgecolor=colour, fill=False, linewidth=2))
ax.set(title=f"Die over street: {step.height}", xlabel="x, µm", ylabel="y, µm")
figure.colorbar(image, label="z, µm")
