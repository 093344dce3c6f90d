"""HTML page of a surface, which any browser shows from a disk or a web server, without this program. Export only.

The page holds heights in 16 bits and the all-in-focus picture as JPEG; it turns them, cuts sections and reads heights.
"""

from __future__ import annotations

import base64
import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.draw.colormaps import COLOUR_MAPS, table
from wafer_viewer.draw.surface.mesh import jpeg
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.formats.point_gridding import eight_bits
from wafer_viewer.store.formats.reader_support import about, caveats
from wafer_viewer.store.formats.surface_strips import Strips

MOST_POINTS = 16_000_000
"""More would be hundreds of megabytes of text, which browsers do not open."""
GAP = 0
"""Code of a pixel without height."""
_HIGHEST = 65535
_TEMPLATE = Path(__file__).with_name("web_page.html")


def write_web_page(strips: Strips, path: Path) -> None:
    """Write one HTML file with the heights, the picture and a program of its own to look at them.

    Raises DatasetError for a surface without heights or with more than 16 million points.
    """
    if strips.shape[0] * strips.shape[1] > MOST_POINTS:
        raise DatasetError(f"{path.name} would hold more than {MOST_POINTS / 1e6:.0f} million points: take fewer.")
    heights = np.concatenate(list(strips.layer("z_um", 0, 2)))
    picture = np.concatenate(list(strips.layer("all_in_focus", 1, 2)))
    measured = np.isfinite(heights)
    if not measured.any():
        raise DatasetError(f"{path.name} would show nothing: no pixel has a height.")
    low_um, high_um = float(heights[measured].min()), float(heights[measured].max())
    step_um = (high_um - low_um) / (_HIGHEST - 1) or 1e-6
    codes = np.full(heights.shape, GAP, np.uint16)
    codes[measured] = np.rint((heights[measured].astype(np.float64) - low_um) / step_um).astype(np.uint16) + 1
    facts = {
        **json.loads(about(strips)),
        "low_um": low_um,
        "step_um": step_um,
        "every": strips.every,
        "measured": float(measured.mean()),
        "caveats": caveats(strips.surface.provenance),
        "maps": {title: table(name).ravel().tolist() for name, title in COLOUR_MAPS.items()},
    }
    page = _TEMPLATE.read_text(encoding="utf-8")
    for mark, text in (
        ("{{heights}}", _text(zlib.compress(_easy_to_compress(codes), 6))),
        ("{{picture}}", _text(jpeg(eight_bits(picture), 88))),
        ("{{facts}}", _json(facts)),  # last: what people wrote may look like a mark
    ):
        page = page.replace(mark, text)
    path.write_text(page, encoding="utf-8")


def _easy_to_compress(codes: NDArray[np.uint16]) -> bytes:
    """Return the differences along each row, modulo 65536: first all low bytes, then all high ones."""
    differences = np.diff(codes, axis=1, prepend=np.uint16(0))
    return (differences & 0xFF).astype(np.uint8).tobytes() + (differences >> 8).astype(np.uint8).tobytes()


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _json(facts: dict[str, Any]) -> str:
    """Return JSON that no HTML parser takes for the end of its script."""
    return json.dumps(facts, separators=(",", ":")).replace("<", "\\u003c")
