"""Single pictures of the camera as OME-TIFF files, which are never overwritten."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from wafer_viewer._version import __version__
from wafer_viewer.store.dataset.ome_header import StagePicture, picture_xml
from wafer_viewer.store.io.atomic_files import atomic_write, new_file

_UM_PER_CM = 1e4


def write_stage_picture(folder: Path, picture: StagePicture) -> Path:
    """Write a picture into a folder as ``live-picture-3.ome.tif``, the first free number; return its path.

    Raises DatasetError when the folder cannot be written to.
    """
    import tifffile

    path = new_file(folder, "live-picture", ".ome.tif")
    per_cm = None if picture.pixel_um is None else _UM_PER_CM / picture.pixel_um
    with ExitStack() as on_failure:
        on_failure.callback(path.unlink, missing_ok=True)
        with atomic_write(path) as temporary:
            tifffile.imwrite(
                temporary,
                picture.image,
                byteorder="<",
                photometric="minisblack",
                description=picture_xml(picture, __version__),
                metadata=None,
                resolution=None if per_cm is None else (per_cm, per_cm),
                resolutionunit="NONE" if per_cm is None else "CENTIMETER",
                software=False,
            )
        on_failure.pop_all()
    return path
