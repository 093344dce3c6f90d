"""LAZ 1.2: measured points with their grey, for programs that show large point clouds."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.formats.point_gridding import points_of
from wafer_viewer.store.formats.reader_support import heading
from wafer_viewer.store.formats.surface_strips import Strips

LATERAL_UM, HEIGHT_UM = 1e-3, 1e-5
"""Steps of the stored integers: 2.1 m in x and y, and 21 mm in z to either side of the offset."""
_FROM_8_BITS = 257


def write_laz(strips: Strips, path: Path) -> None:
    """Write points in um, with the grey of the all-in-focus picture as intensity.

    Raises DatasetError when laspy and lazrs are missing.
    """
    try:
        import laspy

        importlib.import_module("lazrs")  # without it laspy fails at the first point
    except ImportError as fault:
        raise DatasetError("LAZ files are written by laspy: pip install 'wafer-viewer[points]'.") from fault
    surface = strips.surface
    header = laspy.LasHeader(point_format=0, version="1.2")
    header.offsets = np.array([round(surface.x0_um), round(surface.y0_um), 0.0])
    header.scales = np.array([LATERAL_UM, LATERAL_UM, HEIGHT_UM])
    header.generating_software = f"Wafer Viewer {surface.provenance.software_version}"[:31]
    header.system_identifier = "SIMULATED" if surface.provenance.simulated else "focus stack"
    text = "\n".join(heading(strips)).encode()
    header.vlrs.append(laspy.VLR("wafer viewer", 1, "heights in um, stage coordinates", text))
    with laspy.open(path, mode="w", header=header, do_compress=True) as file:
        for part in strips.maps():
            rows, cols = np.nonzero(np.isfinite(part.z_um))
            if not len(rows):
                continue
            points = laspy.ScaleAwarePointRecord.zeros(len(rows), header=header)
            points["x"], points["y"], points["z"] = points_of(part, rows, cols).T
            grey = part.all_in_focus[rows, cols]
            points["intensity"] = grey.astype(np.uint16) * (_FROM_8_BITS if grey.dtype.itemsize == 1 else 1)
            file.write_points(points)
