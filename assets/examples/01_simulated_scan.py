"""
Scan on the virtual rig
=======================

This example scans two fields of the virtual wafer from Python. It shows the sharpest frame and the height map of the
first field. With your own rig the same lines move real hardware: pass its configuration to ``Session``.
"""

# sphinx_gallery_thumbnail_number = 2
import tempfile

import matplotlib.pyplot as plt
import numpy as np

import wafer_viewer as wv

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
# A session owns the rig and the data folder. Nothing moves before the sample is confirmed.


def main() -> wv.Dataset:
    session = wv.Session(tempfile.mkdtemp())
    try:
        session.wait_until(lambda now: now.rig.state == "ready")
        session.jobs.confirm().result()
        session.edit_job(job).result()
        print(f"The fastest strategy takes {session.snapshot.draft.plan.predicted_s:.1f} s.")
        path = session.start_scan("example").result()
        session.wait_until(lambda now: now.dataset is not None and now.dataset.finished)
        return wv.Dataset.open(path)
    finally:
        session.close()


# The session starts processes of its own, so the program needs the guard below.
if __name__ == "__main__":
    data = main()

    # %%
    # The dataset holds one focus stack for each field. This is the frame with the most contrast.

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
