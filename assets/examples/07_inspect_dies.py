"""
Find dies and their defects
===========================

A patterned wafer repeats itself, so a defect is what one die has and the others lack. This example inspects a made-up
surface of 20 dies with three defects. With your own surface, begin at ``find_dies``.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Circle, Rectangle

import wafer_viewer as wv

# %%
# Dies of 180 x 120 µm stand 3 µm over their streets. One has a particle, one a scratch, one a bump of residue.

random = np.random.default_rng(2)
pixel_um, rows, cols = 1.0, 590, 1020
row, col = np.mgrid[:rows, :cols]
u, v = (col - 12) % 200, (rows - 1 - row - 10) % 145
on_die = (u < 180) & (v < 120)
pads = on_die & (u % 30 < 14) & (v % 30 < 14)
z_um = 3.0 * on_die + 0.8 * pads + random.normal(0, 0.1, (rows, cols))
grey = 170 - 80 * on_die + 50 * pads + random.normal(0, 4, (rows, cols))
z_um[(row - 222) ** 2 + (col - 478) ** 2 < 6**2] += 2.5
z_um[(np.abs(row - col * 0.3 - 240) < 2) & (col > 640) & (col < 760)] -= 1.5
z_um += 2.0 * np.exp(-((row - 500) ** 2 + (col - 120) ** 2) / 14**2)

surface = wv.HeightMap(
    z_um=z_um.astype(np.float32),
    z_raw_um=z_um.astype(np.float32),
    confidence=np.ones(z_um.shape, np.float32),
    all_in_focus=grey.clip(0, 255).astype(np.uint8),
    origin=np.full(z_um.shape, wv.Origin.MEASURED, np.uint8),
    pixel_um=pixel_um,
    x0_um=0.0,
    y0_um=float(rows - 1),
)

# %%
# The lattice of the dies is found by what repeats. A lattice that is known can be given instead.

dies = wv.find_dies(surface)
print(f"{dies.cols} x {dies.rows} dies, pitch {dies.pitch_x_um:.2f} x {dies.pitch_y_um:.2f} um")

# %%
# Every die is compared with the median die. Limits turn defects into a verdict.

found = wv.inspect(surface, dies)
for defect in found.defects:
    print(f"{defect.kind:12s} die {defect.die or '-':4s} height {defect.height}, area {defect.area}")
print(wv.verdict_of(found, wv.DefectLimits(max_per_die=0)).word)

# %%
# Circles mark the defects.

figure, ax = plt.subplots(figsize=(10, 6), layout="constrained")
image = ax.imshow(z_um, extent=(0, cols, 0, rows), cmap="viridis")
figure.colorbar(image, label="z, µm", shrink=0.7)
for defect in found.defects:
    ax.add_patch(Circle((defect.center.x_um, defect.center.y_um), 28, edgecolor="red", fill=False, linewidth=2))
ax.add_patch(Rectangle((dies.x0_um, dies.y0_um), dies.width_um, dies.height_um, edgecolor="white", fill=False))
ax.set(xlabel="x, µm", ylabel="y, µm")
