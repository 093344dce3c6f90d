"""Disk layout of a mosaic: header, levels of each layer, and shard parameters of their arrays."""

from __future__ import annotations

import json
import math
from typing import Any, ClassVar

import numpy as np

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Count, Positive, Spec, encode
from wafer_viewer.model.surface.height_map import Mosaic, Origin, Provenance
from wafer_viewer.model.surface.pyramid_layers import COUNTS, EXTREMES
from wafer_viewer.store.mosaic.zarr_shards import Shards

CHUNK, SHARD = 256, 2048
COARSEST_PX = 512
"""Side in px of the square that the coarsest level fits into, one image of the entire surface."""
GROUP, OWN = "zarr.json", "wafer_viewer"
"""File of a group, and the name of its attribute that holds the header."""
FILLS: dict[str, float] = {
    "z_um": math.nan,
    "z_raw_um": math.nan,
    "z_min_um": math.nan,
    "z_max_um": math.nan,
    "confidence": 0.0,
    "all_in_focus": 0,
    "origin": Origin.NOT_COVERED,
    "overlap_um": math.nan,
    "u_um": math.nan,
    **dict.fromkeys(COUNTS, 0),
}
NOT_IN_OLDER = ("u_um", *COUNTS)
"""Layers that mosaics of earlier versions lack."""
NGFF_VERSION = "0.5"
"""Version of OME-NGFF for Zarr 3."""
NGFF_SCENE_VERSION = "0.6"
"""Version of OME-NGFF with scenes; fewer programs read it so far."""
METHODS = {"z_min_um": "minimum", "z_max_um": "maximum", "origin": "minimum"}
"""Downscaling method of layers that are not means: the smallest code of an origin is the best."""
FROM_LEVEL_1 = (*EXTREMES, *COUNTS)
SURFACE = tuple(name for name in FILLS if name not in FROM_LEVEL_1)


class MosaicHeader(Spec, frozen=True, kw_only=True):
    """Lattice, shape, grey depth and provenance of a mosaic."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    pixel_um: Positive
    x0_um: float
    y0_um: float
    rows: Count
    cols: Count
    grey_bits: int
    provenance: Provenance

    @property
    def lattice(self) -> tuple[float, float, float, int, int]:
        """Pixel size and origin in um, rows and columns."""
        return self.pixel_um, self.x0_um, self.y0_um, self.rows, self.cols

    @property
    def levels(self) -> int:
        """Number of pyramid levels, at least 2."""
        return levels_for((self.rows, self.cols))

    def shape_of(self, level: int) -> tuple[int, int]:
        """Return (rows, cols) of a level."""
        return -(-self.rows // 2**level), -(-self.cols // 2**level)


def levels_for(shape: tuple[int, int]) -> int:
    """Return the number of pyramid levels for a shape, at least 2."""
    return 1 + max(1, math.ceil(math.log2(max(shape) / COARSEST_PX)))


def header_of(source: Mosaic) -> MosaicHeader:
    """Return the header of a mosaic made of a surface."""
    rows, cols = source.shape
    corner = source.window(Region.rectangle(source.x0_um, source.y0_um, source.x0_um, source.y0_um))
    return MosaicHeader(
        pixel_um=source.pixel_um,
        x0_um=source.x0_um,
        y0_um=source.y0_um,
        rows=rows,
        cols=cols,
        grey_bits=corner.all_in_focus.dtype.itemsize * 8,
        provenance=source.provenance,
    )


def as_json(header: MosaicHeader) -> dict[str, Any]:
    """Return the header as an attribute of the group."""
    return json.loads(encode(header, "json"))


def shards_of(name: str, header: MosaicHeader, level: int) -> Shards:
    """Return the shard parameters of a layer at a level."""
    if name in COUNTS:
        return Shards(np.min_scalar_type(4**level), FILLS[name], CHUNK, SHARD)
    dtype = {"origin": "uint8", "all_in_focus": f"uint{header.grey_bits}"}.get(name, "float32")
    return Shards(np.dtype(dtype), FILLS[name], CHUNK, SHARD)


def levels_of(name: str, header: MosaicHeader) -> range:
    """Return the levels of a layer."""
    return range(1 if name in FROM_LEVEL_1 else 0, header.levels)


def ome_of_layer(header: MosaicHeader, name: str) -> dict[str, Any]:
    """Return the OME-NGFF metadata of the group of a layer."""
    return {"version": NGFF_VERSION, "multiscales": [_multiscale(header, name, "")]}


def ome_of_root(header: MosaicHeader) -> dict[str, Any]:
    """Return the OME-NGFF metadata of the mosaic: a multiscale for each layer, the heights first.

    Readers that show one multiscale take the first.
    """
    return {"version": NGFF_VERSION, "multiscales": [_multiscale(header, name, f"{name}/") for name in FILLS]}


def _multiscale(header: MosaicHeader, name: str, folder: str) -> dict[str, Any]:
    """Return the multiscale of a layer: scale and translation of each level in um, for the centres of pixels.

    x is that of the stage, y is minus that of the stage, as rows go down: so no reader needs a negative scale, which
    many refuse, pictures stand upright, and surfaces lie beside each other as on the stage. The centre of a pixel of a
    level is that of the pixels of level 0 below it, (2^level - 1) / 2 of their size from the first.
    """

    def dataset(level: int) -> dict[str, Any]:
        scale, shift = header.pixel_um * 2**level, header.pixel_um * (2**level - 1) / 2
        first = [-header.y0_um + shift, header.x0_um + shift]
        place = [{"type": "scale", "scale": [scale, scale]}, {"type": "translation", "translation": first}]
        return {"path": f"{folder}{level}", "coordinateTransformations": place}

    return {
        "name": name,
        "axes": [{"name": axis, "type": "space", "unit": "micrometer"} for axis in "yx"],
        "datasets": [dataset(level) for level in levels_of(name, header)],
        "type": "sum" if name in COUNTS else METHODS.get(name, "mean"),
        "metadata": {"description": "x is that of the stage, y is minus that of the stage."},
    }
