"""Height TIFF: 32-bit floats in um, NaN where unmeasured, pixel size as resolution, other metadata as JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.formats.embedded_metadata import about, parse_metadata
from wafer_viewer.store.formats.reader_support import ReadOptions, heights_only, same, scaled
from wafer_viewer.store.formats.surface_strips import Strips

if TYPE_CHECKING:
    from tifffile import TiffPage

_UM_PER_CM = 1e4
_TOP_LEFT = 1
_CENTIMETRE = 3
_NO_DATA = "GDAL_NODATA"


def write_tiff(strips: Strips, path: Path) -> None:
    """Write z_um as 32-bit floats, NaN where unmeasured; filled pixels are not marked."""
    import tifffile

    per_cm = _UM_PER_CM / strips.pixel_um
    begin, _ = tifffile.imwrite(
        path,
        shape=strips.shape,
        dtype="<f4",
        photometric="minisblack",
        metadata=None,
        description=about(strips),
        resolution=(per_cm, per_cm),
        resolutionunit="CENTIMETER",
        returnoffset=True,
    ) or (0, 0)
    with path.open("r+b") as file:  # what the disk cannot hold is refused here, as it would not be by a mapped file
        file.seek(begin)
        for z_um in strips.layer("z_um"):
            file.write(z_um.astype("<f4").tobytes())


def read_tiff(path: Path, asked: ReadOptions) -> HeightMap:
    """Read the heights of a float TIFF. Raises DatasetError for integers, colour, or missing units."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            page, n_pages = file.pages.first, len(file.pages)
            _require_heights(page, asked)
            raw: NDArray[Any] = page.asarray(out="memmap")
            facts, lateral_um = _facts(page), _lateral_um(file, asked)
            no_data = page.tags.get(_NO_DATA)
    except (tifffile.TiffFileError, ValueError, IndexError, KeyError) as fault:
        raise asked.refuse("cannot be read as TIFF, it is damaged or cut off: copy it again.") from fault
    if n_pages > 1:
        asked.notes.append(f"Its first page was read, of {n_pages}.")
    asked.require_heights_up(str(facts.get("quantity", facts.get("kind", ""))))
    told = parse_metadata(json.dumps(facts))
    if told is not None and (told.rows, told.cols) != raw.shape:
        told = None
    said_um = facts.get("pixel_um")
    if isinstance(said_um, float | int) and lateral_um is not None and not same(float(said_um), lateral_um[0]):
        raise asked.refuse(
            f"says that a pixel is {said_um:g} um and {lateral_um[0]:g} um by its resolution: keep what is right."
        )
    dx_um, dy_um = (said_um, said_um) if isinstance(said_um, float | int) else (lateral_um or (None, None))
    z_scale = asked.z_scale_um(facts.get("unit"))
    pixel_um = asked.pixel_um(dx_um, dy_um)
    z_um = scaled(asked, raw, z_scale)
    if no_data is not None:
        z_um[raw == np.float64(str(no_data.value).strip("\0 "))] = np.nan
    place = (told.x0_um, told.y0_um, told.provenance) if told else (0.0, 0.0, None)
    return heights_only(asked, z_um, pixel_um, *place)


def is_heights(path: Path) -> bool:
    """Return whether a TIFF holds floats, hence heights and not the images of a focus stack."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            dtype = file.pages.first.dtype
            return dtype is not None and dtype.kind == "f"
    except (tifffile.TiffFileError, ValueError, IndexError, KeyError, OSError):
        return False


def _require_heights(page: TiffPage, asked: ReadOptions) -> None:
    if page.samplesperpixel != 1 or len(page.shape) != 2:
        raise asked.refuse("is a colour picture, not heights: give a TIFF with one 32-bit float per pixel.")
    if page.dtype is None or page.dtype.kind != "f":
        raise asked.refuse(f"holds integers ({page.dtype}), not heights: give a TIFF with one 32-bit float per pixel.")
    orientation = page.tags.get("Orientation")
    if orientation is not None and int(orientation.value) != _TOP_LEFT:
        raise asked.refuse("says that it is stored turned or mirrored: write it with its top left corner first.")


def _facts(page: TiffPage) -> dict[str, Any]:
    """Return the description if it is a JSON object, otherwise an empty dict."""
    try:
        found: Any = json.loads(page.description)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _lateral_um(file: Any, asked: ReadOptions) -> tuple[float, float] | None:
    """Return the pixel sizes along x and y in um, from ImageJ's unit or pixels per cm; dots per inch are ignored."""
    page, by_imagej = file.pages.first, file.imagej_metadata or {}
    tags = [page.tags.get(name) for name in ("XResolution", "YResolution")]
    if None in tags or any(0 in tag.value for tag in tags):
        return None
    per_unit = [tag.value[0] / tag.value[1] for tag in tags]
    unit = page.tags.get("ResolutionUnit")
    if (named := str(by_imagej.get("unit", ""))) not in ("", "pixel", "inch"):
        unit_um = asked.lateral_um(named.replace("\\u00B5", "µ")) or 1.0
    elif unit is not None and int(unit.value) == _CENTIMETRE:
        unit_um = _UM_PER_CM
    else:
        return None
    return unit_um / per_unit[0], unit_um / per_unit[1]
