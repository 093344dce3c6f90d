"""Colour maps, monotonic in lightness, and the fixed colours with a meaning."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import Origin

Rgb = tuple[int, int, int]

_STOPS: dict[str, str] = {
    # Mako (seaborn) from a tenth of its way on: without the black end, trenches keep their shading.
    "mako": "251A3A 342B5A 3F4486 38659D 3585A5 37A5AC 4CC1AD 84D9B4 B7E8C8 E8F8EC",
    "batlow": "011959 0D365E 1C5460 3F6C55 687B3E 9B882E D29343 F6A27C FDB7BC FACCFA",
    "cividis": "00224E 123570 3B496C 575D6D 707173 8A8678 A59C74 C3B369 E1CC55 FEE838",
    "viridis": "440154 482878 3E4989 31688E 26828E 1F9E89 35B779 6DCD59 B4DE2C FDE725",
    "grey": "1C1C1C F2F2F2",
    # Vik (F. Crameri, Scientific colour maps): diverging, also to colour-blind eyes; its ends a little lighter.
    "vik": "0B2A6F 03437F 1E6F9D 71A8C4 C9DDE7 ECE6E1 EACEBD D39774 BE6533 97350F 6B1508",
}
COLOUR_MAPS: dict[str, str] = {
    "mako": "Mako",
    "batlow": "Batlow",
    "cividis": "Cividis",
    "viridis": "Viridis",
    "grey": "Grey",
}
"""Colour map names and their titles on the page."""
DIVERGING = "vik"
"""Colour map of signed quantities, with zero at its middle."""

PROFILE_COLOURS = ("#E8590C", "#7B2CBF", "#0B7285", "#C2255C")
"""Colours of the lines A B C D: distinct with colour vision deficiency, and readable over every map."""

BRUSH = "#C2255C"
"""Colour of points in a brushed height range, distinct from every colour map."""

ELSEWHERE: Rgb = (150, 158, 167)
"""Colour of the surface where the quantity is unavailable: a grey that no colour map has at an end."""

ORIGIN_COLOURS: dict[Origin, Rgb] = {
    Origin.MEASURED: (93, 144, 160),
    Origin.FILLED: (239, 180, 90),
    Origin.NOT_COVERED: (171, 179, 186),
    Origin.CLIPPED: (250, 244, 214),
    Origin.NO_TEXTURE: (58, 66, 92),
    Origin.AMBIGUOUS: (195, 84, 132),
    Origin.END_OF_RANGE: (231, 66, 12),
    Origin.WINDOWS_DISAGREE: (12, 120, 90),
    Origin.BLEEDING_EDGE: (181, 42, 65),
    Origin.OUTLIER: (155, 108, 250),
    Origin.STEP_EDGE: (208, 143, 216),
    Origin.TOO_FEW_FRAMES: (111, 96, 181),
    Origin.NO_REASON: (24, 12, 12),
}
"""Colours by origin; all pairs differ by at least 12 (CIEDE2000), also with colour vision deficiency."""


def rgb(text: str) -> Rgb:
    """Parse ``#0B6E99`` or ``0B6E99`` into three integers."""
    digits = text.removeprefix("#")
    return int(digits[0:2], 16), int(digits[2:4], 16), int(digits[4:6], 16)


@cache
def table(name: str) -> NDArray[np.uint8]:
    """Return a colour map as uint8 [256, 3], from low to high. Raises KeyError for an unknown name."""
    stops = np.array([rgb(stop) for stop in _STOPS[name].split()], float)
    positions = np.linspace(0, len(stops) - 1, 256)
    channels = [np.interp(positions, np.arange(len(stops)), stops[:, k]) for k in range(3)]
    out = np.stack(channels, axis=1).round().astype(np.uint8)
    out.setflags(write=False)
    return out


def css_gradient(name: str, stops: int = 48) -> str:
    """Return the CSS gradient of a colour map, from bottom to top: ``linear-gradient(to top, ...)``."""
    picked = table(name)[np.linspace(0, 255, stops).round().astype(int)]
    return "linear-gradient(to top," + ",".join(f"rgb({r},{g},{b})" for r, g, b in picked.tolist()) + ")"


@cache
def origin_table() -> NDArray[np.uint8]:
    """Return the colours of `Origin` as uint8 [256, 3]; unused codes are grey."""
    out = np.full((256, 3), 128, np.uint8)
    for origin, colour in ORIGIN_COLOURS.items():
        out[int(origin)] = colour
    out.setflags(write=False)
    return out
