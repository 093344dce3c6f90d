"""
Scan on the virtual rig
=======================

This example scans two fields of the virtual wafer from Python. It shows the sharpest frame and the height map of the
first field. The same lines move real hardware if you open the rig of your own file.
"""

# sphinx_gallery_thumbnail_number = 2
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import wafer_viewer as wv
from wafer_viewer.rigs.rig_config import open_rig
from wafer_viewer.session.acquisition.headless import scan_to

# %%
# A job says where the fields lie and which focus sweep each of them gets. Lengths are in micrometres.

job = wv.Job(
    product="example",
    sample=wv.Sample(name="virtual wafer", wafer_id="01", operator="you"),
    grid=wv.FieldGrid(
        rows=1, cols=2, field_width_um=336.4, field_height_um=252.3, overlap_x_fraction=0.1, x0_um=648.6, y0_um=560.0
    ),
    z_start_um=-6.0,
    sweep=wv.FocusSweep(z_step_um=2.0, n_frames=26),
)

# %%
# Six checks come before the first motion. Raise an error in ``ready`` to stop there.


def ready(checks) -> None:
    for check in checks:
        print(f"{check.what}: {check.found}")


path = Path(tempfile.mkdtemp()) / "example.wafer"
rig = open_rig(wv.RigConfig())
try:
    ended = scan_to(path, job, rig, tell=lambda fraction: None, ready=ready, warn=print)
finally:
    rig.close()
print(ended.words)

# %%
# The dataset holds one focus stack for each field. This is the frame with the most contrast.

data = wv.Dataset.open(path)
stack = data.stack(1)
sharpest = max(range(len(stack.z_um)), key=lambda k: np.diff(stack.images[k].astype(float)).std())
plt.imshow(stack.images[sharpest], cmap="gray")
plt.title(f"Field 1 at z = {stack.z_um[sharpest]:.1f} µm")

# %%
# Shape from focus turns the stack into heights. A pixel without a reliable height stays empty.

height = wv.reconstruct(stack)
print(f"{height.measured.mean():.0%} of the field is measured.")
plt.figure()
plt.imshow(height.z_um, cmap="viridis")
plt.colorbar(label="z, µm")
