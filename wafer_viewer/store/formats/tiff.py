"""Height TIFF: 32-bit floats in um, NaN where unmeasured, pixel size as resolution, other metadata as JSON."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.plan import MIN_FRAMES
from wafer_viewer.model.errors import DatasetError, parser_errors_as
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.formats.ome_pyramid import facts_of
from wafer_viewer.store.formats.reader_support import (
    ReadOptions,
    about,
    heights_only,
    on_square_pixels,
    parse_metadata,
    provenance_of,
    same,
    scaled,
)
from wafer_viewer.store.formats.surface_strips import Strips
from wafer_viewer.store.io.guarded_reading import opened_tiff, require_unpacked

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
        extratags=_geometry(strips),
        returnoffset=True,
    ) or (0, 0)
    with path.open("r+b") as file:  # a full disk fails here; a memory-mapped file would fail later
        file.seek(begin)
        for z_um in strips.layer("z_um"):
            file.write(z_um.astype("<f4").tobytes())


def _geometry(strips: Strips) -> list[tuple[int, int, int, Any, bool]]:
    """Return the tags by which GDAL places the pixels, in stage um: their size, and the outer corner of the first."""
    half_um, surface = strips.pixel_um / 2, strips.surface
    corner = (0.0, 0.0, 0.0, surface.x0_um - half_um, surface.y0_um + half_um, 0.0)
    return [
        (_PIXEL_SCALE, _DOUBLE, 3, (strips.pixel_um, strips.pixel_um, 0.0), True),
        (_TIE_POINT, _DOUBLE, 6, corner, True),
        (_GDAL_NO_DATA, _TEXT, 4, "nan", True),
    ]


_PIXEL_SCALE, _TIE_POINT, _GDAL_NO_DATA = 33550, 33922, 42113
_DOUBLE, _TEXT = 12, 2


def read_tiff(path: Path, options: ReadOptions) -> HeightMap:
    """Read the heights of a float TIFF. Raises DatasetError for integers, colour, or missing units."""
    damaged = options.refuse("cannot be read as TIFF, it is damaged or cut off: copy it again.")
    with parser_errors_as(lambda _: damaged), opened_tiff(path) as file:
        page, n_pages = file.pages.first, len(file.pages)
        _require_heights(page, options)
        require_unpacked(path.name, path.stat().st_size, page.nbytes)
        raw: NDArray[Any] = page.asarray(out="memmap")
        facts, lateral_um = _facts(page), _lateral_um(file, options)
        no_data = page.tags.get(_NO_DATA)
        embedded, by_imagej = page.description, str((file.imagej_metadata or {}).get("Info", ""))
    if n_pages >= MIN_FRAMES:
        raise options.refuse(f"has {n_pages} pages, a stack of images and no heights: import or reconstruct it.")
    if n_pages > 1 and "pixel_um" not in facts:  # those of ours have a picture beside the heights
        options.notes.append(f"Its first page was read, of {n_pages}.")
    options.require_heights_up(str(facts.get("quantity", facts.get("kind", ""))))
    metadata = parse_metadata(json.dumps(facts))
    if metadata is not None and (metadata.rows, metadata.cols) != raw.shape:
        metadata = None
    described_um = facts.get("pixel_um")
    if (
        isinstance(described_um, float | int)
        and lateral_um is not None
        and not same(float(described_um), lateral_um[0])
    ):
        raise options.refuse(
            f"states pixels of {described_um:g} um, but {lateral_um[0]:g} um by its resolution: correct the wrong one."
        )
    dx_um, dy_um = (
        (described_um, described_um) if isinstance(described_um, float | int) else (lateral_um or (None, None))
    )
    z_scale = options.z_scale_um(facts.get("unit"))
    pitches_um = options.pitches_um(dx_um, dy_um)
    z_um = scaled(options, raw, z_scale, is_ours=metadata is not None)
    if no_data is not None:
        z_um[raw == np.float64(str(no_data.value).strip("\0 "))] = np.nan
    z_um, pixel_um = on_square_pixels(options, z_um, *pitches_um)
    place = (metadata.x0_um, metadata.y0_um) if metadata else (0.0, 0.0)
    return heights_only(options, z_um, pixel_um, *place, provenance_of(metadata, embedded, by_imagej))


def is_heights(path: Path) -> bool:
    """Return whether a TIFF holds heights: floats, on fewer pages than a focus stack has."""
    damaged = DatasetError(f"{path} cannot be read.")
    with suppress(DatasetError), parser_errors_as(lambda _: damaged), opened_tiff(path) as file:
        dtype = file.pages.first.dtype
        return dtype is not None and dtype.kind == "f" and len(file.pages) < MIN_FRAMES
    return False


def _require_heights(page: TiffPage, options: ReadOptions) -> None:
    if page.samplesperpixel != 1 or len(page.shape) != 2:
        raise options.refuse("is a colour picture, not heights: give a TIFF with one 32-bit float per pixel.")
    if page.dtype is None or page.dtype.kind != "f":
        raise options.refuse(
            f"holds integers ({page.dtype}), not heights: give a TIFF with one 32-bit float per pixel."
        )
    orientation = page.tags.get("Orientation")
    if orientation is not None and int(orientation.value) != _TOP_LEFT:
        raise options.refuse("says that it is stored turned or mirrored: write it with its top left corner first.")


def _facts(page: TiffPage) -> dict[str, Any]:
    """Return the description if it is a JSON object, or has one in OME-XML, otherwise an empty dict."""
    if page.description.lstrip().startswith("<"):
        return facts_of(page.description)
    try:
        facts: Any = json.loads(page.description)
    except ValueError:
        return {}
    return facts if isinstance(facts, dict) else {}


def _lateral_um(file: Any, options: ReadOptions) -> tuple[float, float] | None:
    """Return the pixel sizes along x and y in um, from ImageJ's unit or pixels per cm; dots per inch are ignored."""
    page, by_imagej = file.pages.first, file.imagej_metadata or {}
    tags = [page.tags.get(name) for name in ("XResolution", "YResolution")]
    if None in tags or any(0 in tag.value for tag in tags):
        return None
    per_unit = [tag.value[0] / tag.value[1] for tag in tags]
    unit = page.tags.get("ResolutionUnit")
    if (named := str(by_imagej.get("unit", ""))) not in ("", "pixel", "inch"):
        unit_um = options.lateral_um(named.replace("\\u00B5", "µ")) or 1.0
    elif unit is not None and int(unit.value) == _CENTIMETRE:
        unit_um = _UM_PER_CM
    else:
        return None
    return unit_um / per_unit[0], unit_um / per_unit[1]
