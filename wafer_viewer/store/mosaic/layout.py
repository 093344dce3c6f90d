"""How a mosaic lies on disk: its header, the levels of each layer, and how their arrays are made."""

from __future__ import annotations

import json
import math
from typing import Any, ClassVar

import numpy as np

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Count, Positive, Spec, encode
from wafer_viewer.model.surface.height_map import Mosaic, Origin, Provenance
from wafer_viewer.store.mosaic.zarr_shards import Shards

CHUNK, SHARD = 256, 2048
COARSEST_PX = 512
"""The pyramid ends with the first level that fits into this square: one picture of the whole surface."""
GROUP, OWN = "zarr.json", "wafer_viewer"
"""The file of a group, and the one of its attributes that holds the header."""
FILLS: dict[str, float] = {
    "z_um": math.nan,
    "z_raw_um": math.nan,
    "z_min_um": math.nan,
    "z_max_um": math.nan,
    "confidence": 0.0,
    "all_in_focus": 0,
    "origin": Origin.NOT_COVERED,
    "overlap_um": math.nan,
}
SPANS = ("z_min_um", "z_max_um")
SURFACE = tuple(name for name in FILLS if name not in SPANS)


class MosaicHeader(Spec, frozen=True, kw_only=True):
    """Where the lattice of a mosaic lies, how large it is, and where it comes from."""

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
        """Where its pixels lie."""
        return self.pixel_um, self.x0_um, self.y0_um, self.rows, self.cols

    @property
    def levels(self) -> int:
        """Levels of the pyramid, at least 2."""
        return levels_for((self.rows, self.cols))

    def shape_of(self, level: int) -> tuple[int, int]:
        """(rows, cols) of a level."""
        return -(-self.rows // 2**level), -(-self.cols // 2**level)


def levels_for(shape: tuple[int, int]) -> int:
    """Levels of the pyramid over a shape, at least 2."""
    return 1 + max(1, math.ceil(math.log2(max(shape) / COARSEST_PX)))


def header_of(source: Mosaic) -> MosaicHeader:
    """The header of a mosaic made of a surface."""
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
    """The header as an attribute of the group."""
    return json.loads(encode(header, "json"))


def shards_of(name: str, header: MosaicHeader) -> Shards:
    """How the shards of a layer are made."""
    dtype = {"origin": "uint8", "all_in_focus": f"uint{header.grey_bits}"}.get(name, "float32")
    return Shards(np.dtype(dtype), FILLS[name], CHUNK, SHARD)


def levels_of(name: str, header: MosaicHeader) -> range:
    """The levels that a layer has."""
    return range(1 if name in SPANS else 0, header.levels)


def multiscale(header: MosaicHeader, name: str) -> dict[str, Any]:
    """OME-NGFF 0.5: scale and place of each level in um, from the first pixel of level 0, y downward."""

    def dataset(level: int) -> dict[str, Any]:
        scale, shift = header.pixel_um * 2**level, header.pixel_um * (2**level - 1) / 2
        place = [{"type": "scale", "scale": [scale, scale]}, {"type": "translation", "translation": [shift, shift]}]
        return {"path": str(level), "coordinateTransformations": place}

    axes = [{"name": axis, "type": "space", "unit": "micrometer"} for axis in "yx"]
    datasets = [dataset(level) for level in levels_of(name, header)]
    return {"version": "0.5", "multiscales": [{"name": name, "axes": axes, "datasets": datasets}]}
