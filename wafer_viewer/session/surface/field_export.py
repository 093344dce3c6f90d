"""Export of the fields of a stitched surface as images in place."""

from __future__ import annotations

from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import Progress, ShouldStop
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.formats.field_scene import write_scene


def write_fields(
    dataset: str | Path,
    folder: str | Path,
    result: str = "default",
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
) -> Path:
    """Write the fields of a stitched surface as an OME-NGFF scene of images.

    Parameters
    ----------
    dataset : str or Path
        Dataset NAME.wafer whose fields were stitched.
    folder : str or Path
        Folder to write, ``NAME.ome.zarr``; it must not exist.
    result : str
        Name of the reconstruction.
    progress : callable, optional
        Receives the completed fraction, 0 to 1.
    should_stop : callable, optional
        Returns True if the work should stop.

    Returns
    -------
    Path
        The folder written.

    Raises
    ------
    DatasetError
        When the fields were not stitched, the folder exists, does not end with ``.zarr`` or cannot be written, or
        the work is stopped.

    Notes
    -----
    Each field is a multiscale image ``r0000c0000`` (float32) of two channels: the grey value of the all-in-focus
    picture, and the height in um, NaN without one, from which the field's own offset, tilt and sag are removed. The
    scene translates every image to the coordinate system *stitched* and to *stage*; fields that are left out of the
    mosaic have only the latter. x is that of the stage and y minus that of the stage, as in ``mosaic.zarr``, for the
    centres of pixels in um. The attribute ``wafer_viewer`` of an image holds the pose with its standard uncertainties
    (k = 1).

    References
    ----------
    .. [1] OME-NGFF 0.6, https://ngff.openmicroscopy.org/specifications/0.6/index.html
    """
    data, target = Dataset.open(Path(dataset)), Path(folder)
    stored = data.result(result)
    if (poses := stored.poses()) is None:
        raise DatasetError(f"{data.path.name} has no stitched surface {result!r}: stitch it first.")
    fields = (data.field(int(number)) for number in poses.numbers)
    surfaces = ((field.name, stored.surface(field)) for field in fields)
    about = {"dataset": data.path.name, "result": result, "notes": list(poses.notes)}
    write_scene(target, surfaces, poses, about, progress, should_stop)
    return target
