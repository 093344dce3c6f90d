"""Load at import what a worker of a session needs in memory, once for all workers that are forked afterwards.

Loading starts no thread, which a fork would lack.
"""

from __future__ import annotations

from contextlib import suppress
from importlib import import_module

from wafer_viewer.session.surface.kernel_build import load_kernels

for module in ("distributed.worker", "zarr", "wafer_viewer.session.surface.stitching_job"):
    import_module(module)
with suppress(Exception):  # the task that needs it says what is wrong
    load_kernels()
