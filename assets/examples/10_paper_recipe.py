"""
The recipe of the paper
=======================

The program began with a published method: the plain argmax of a focus measure, a Levy filter, outliers by a point
cloud, and splines over all gaps. This example runs that recipe beside the default one.
"""

import matplotlib.pyplot as plt
import numpy as np

import wafer_viewer as wv

# %%
# A part of one field of the virtual wafer, in both recipes.

whole = wv.Dataset.open("scan.wafer").stack(1)
stack = wv.FieldStack(
    field=whole.field,
    images=np.ascontiguousarray(whole.images[:, 60:260, 40:300]),
    z_um=whole.z_um,
    present=whole.present,
    pixel_um=whole.pixel_um,
    calibration=whole.calibration,
    simulated=whole.simulated,
)
recipes = {"paper": wv.Recipe.paper(), "default": wv.Recipe()}
heights = {name: wv.reconstruct(stack, recipe) for name, recipe in recipes.items()}

# %%
# The paper fills every gap, so it has a height everywhere. The default leaves a pixel empty where the evidence is weak.

for name, height in heights.items():
    filled = np.count_nonzero(height.origin == wv.Origin.FILLED) / height.origin.size
    print(f"{name:8s} {height.measured.mean():.1%} measured, {filled:.1%} filled")

# %%
# A row through a die shows the difference in noise.

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
for name, height in heights.items():
    left.plot(np.arange(260) * stack.pixel_um, height.z_um[100], label=name)
left.set(xlabel="x, µm", ylabel="z, µm", title="One row")
left.legend()
image = right.imshow(heights["paper"].z_um - heights["default"].z_um, cmap="RdBu", vmin=-3, vmax=3)
right.set_title("Paper minus default")
figure.colorbar(image, ax=right, label="µm")
