"""The surface that a path names: the stitched one of a dataset, or that of a file."""

from __future__ import annotations

from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.file_formats import with_suffixes
from wafer_viewer.model.progress import Progress, ShouldStop
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.model.surface_format import Reading, Table
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.preview import DATASET_ENDING
from wafer_viewer.store.formats import conversion


@with_suffixes
def read_surface(
    path: str | Path,
    z_unit: str | None = None,
    pixel_um: float | None = None,
    invert_z: bool = False,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
    *,
    table: Table = None,
    result: str = "default",
) -> HeightMap:
    """Read a surface from a dataset or a file, in the format given by its suffix.

    Lengths from other programs are uncalibrated.

    Parameters
    ----------
    path : str or Path
        Dataset, ``NAME.wafer``, or file to read. Its suffix selects the format: ``{READ}``.
    z_unit : str, optional
        Unit of the heights if the file states none (m, cm, mm, um, nm, pm or inch), for points of all three
        coordinates.
    pixel_um : float, optional
        Pixel size in um if the file states none, or the pitch on which scattered points and meshes are gridded.
    invert_z : bool, default False
        The values are depths: their sign is inverted.
    progress : callable, optional
        Receives the completed fraction, 0 to 1.
    should_stop : callable, optional
        Returns True if the work should stop.
    table : {"points", "matrix"}, optional
        Meaning of the lines of a text file: points by their x, y and z, or rows of a matrix of heights. Default: found
        out; refused where it could be either.
    result : str, default 'default'
        Name of the reconstruction, for a dataset.

    Returns
    -------
    HeightMap
        Heights in um; see `HeightMap`.

    Raises
    ------
    DatasetError
        With one sentence on the file, the cause and the remedy: when the file does not exist, is no surface, is
        damaged, holds no height, states no unit or no pixel size and none is given, contradicts itself or the given
        values, has no stitched surface yet, or the work is stopped.
    WaferViewerError
        When the provenance in an ``.npz`` is invalid.

    Notes
    -----
    The files that `export` writes can be read, a mesh (``.stl``, ``.obj``, ``.glb``) as it is seen from above. For an
    ``.npz``, `z_unit`, `pixel_um` and `invert_z` have no effect. A surface of heights only has confidence 1 and a black
    all-in-focus image. The stitched surface of a dataset is read whole: where it is larger than the memory, measure on
    ``Dataset.open(path).result().mosaic()``, which reads the parts that are asked for.

    References
    ----------
    .. [1] ISO 25178-72, Geometrical product specifications (GPS) - Surface texture: Areal - Part 72: XML file format
       x3p.
    """
    place, says = Path(path), Reading(z_unit=z_unit, pixel_um=pixel_um, invert_z=invert_z, table=table)
    if place.suffix != DATASET_ENDING:
        return conversion.read_surface(place, z_unit, pixel_um, invert_z, progress, should_stop, table=table)
    if says != Reading():
        raise DatasetError(f"{place.name} states its own units: leave z_unit, pixel_um, invert_z and table out.")
    return Dataset.open(place).result(result).mosaic().window()
