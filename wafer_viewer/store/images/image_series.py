"""Planes of one image of a file, sorted by its axes: position, channel, time and z.

Axes have the letters of tifffile. Each format gives their sizes, what the file says of the image, and how a plane is
read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.image_source import ImagePlane, Statements
from wafer_viewer.store.images.image_files import require_planes

POSITION_AXES, Z_AXES = "RPMV", "ZQI"
"""Letters of axes for places of the stage, and for planes: Q and I are pages of which nothing is said."""
Where = Mapping[str, int]
"""Number of a plane on each axis of its file."""
_FEWEST, _MOST_COLOURS = 3, 4
UNITS_UM = {
    **dict.fromkeys(("µm", "μm", "um", "micron", "microns", "micrometer", "micrometre", "\\u00B5m", "\\u00b5m"), 1.0),
    **dict.fromkeys(("nm", "nanometer", "nanometre"), 1e-3),
    **dict.fromkeys(("mm", "millimeter", "millimetre"), 1e3),
    **dict.fromkeys(("cm", "centimeter", "centimetre"), 1e4),
    **dict.fromkeys(("m", "meter", "metre"), 1e6),
    **dict.fromkeys(("in", "inch", "inches"), 25400.0),
    "pm": 1e-6,
    "Å": 1e-4,
}
"""Units of length as image files write them, in um; others, such as pixels, are no lengths."""
TIMES_US = {"s": 1e6, "ms": 1e3, "µs": 1.0, "μs": 1.0, "us": 1.0, "ns": 1e-3, "min": 6e7}


@dataclass(frozen=True, slots=True)
class Place:
    """Place of a plane, as numbers from 0."""

    position: int = 0
    channel: int = 0
    time: int = 0
    k: int = 0


def _says_nothing(_: Place) -> Mapping[str, float]:
    return {}


@dataclass(frozen=True, slots=True)
class Series:
    """Statements of a file on one of its images.

    position: its name, empty for the only one; channels: names of its channels; own: z_um, x_um, y_um, exposure_us and
    time_us of a plane, as far as stated; exposures: True if the channels are exposures of the same slots.
    """

    says: Statements
    position: str = ""
    channels: Sequence[str] = ()
    own: Callable[[Place], Mapping[str, float]] = _says_nothing
    exposures: bool = False
    simulated: bool = False


@dataclass(frozen=True, slots=True)
class ImageAxes:
    """Axes of an image without those of its pixels, in the order of its planes.

    channels_are_stated: False if an axis C may be any that its program had no name for.
    """

    sizes: Mapping[str, int]
    channels_are_stated: bool = False

    @property
    def several(self) -> frozenset[str]:
        """Axes with several values, without the one that stands for z."""
        return frozenset(axis for axis, size in self.sizes.items() if size > 1 and axis != self._taken_as_z)

    @property
    def _taken_as_z(self) -> str | None:
        """Axis that stands for z in a file without one: its times, or more channels than colours."""
        if any(self.sizes.get(axis, 1) > 1 for axis in Z_AXES):
            return None
        if self.sizes.get("T", 1) >= _FEWEST:
            return "T"
        return "C" if self.sizes.get("C", 1) > _MOST_COLOURS and not self.channels_are_stated else None

    def places(self) -> Iterator[tuple[Where, Place]]:
        """Yield all planes in the order of the axes, the last one changing fastest."""
        stand_in = self._taken_as_z
        for at in np.ndindex(*self.sizes.values()):
            where = dict(zip(self.sizes, map(int, at), strict=True))
            yield (
                where,
                Place(
                    position=next((where[axis] for axis in where if axis in POSITION_AXES), 0),
                    channel=0 if stand_in == "C" else where.get("C", 0),
                    time=0 if stand_in == "T" else where.get("T", 0),
                    k=where[stand_in] if stand_in else next((where[axis] for axis in where if axis in Z_AXES), 0),
                ),
            )


def plane_at(
    place: Place,
    series: Series,
    several: frozenset[str],
    name: str,
    path: Path,
    page: int,
    read: Callable[[], Image],
) -> ImagePlane:
    """Return the plane at a place. several: axes of the image with several values."""
    own = {name: float(value) for name, value in series.own(place).items()}
    tile = f"position {place.position}" if several & set(POSITION_AXES) else ""
    named = series.channels[place.channel] if place.channel < len(series.channels) else f"channel {place.channel}"
    return ImagePlane(
        name=name,
        path=path,
        page=page,
        read=read,
        position=", ".join(filter(None, (series.position, tile))),
        channel=named if "C" in several and not series.exposures else "",
        time=f"time {place.time}" if "T" in several else "",
        exposure=place.channel if series.exposures else 0,
        k=place.k,
        z_um=own.get("z_um"),
        x_um=own.get("x_um"),
        y_um=own.get("y_um"),
        exposure_us=own.get("exposure_us"),
        time_us=own.get("time_us"),
        simulated=series.simulated,
        says=series.says,
    )


def planes_in(
    path: Path, sizes: Mapping[str, int], series: Series, read: Callable[[str, Where], Image], first: int = 0
) -> Iterator[ImagePlane]:
    """Yield the planes of an image whose file has no pages.

    read: returns the plane at a place on the axes; its first argument is the name of the plane. first: number of planes
    of the images before it.
    """
    axes = ImageAxes(sizes, channels_are_stated=True)
    require_planes(path.name, math.prod(sizes.values()))
    for n, (where, place) in enumerate(axes.places(), first):
        at = (f"{_TITLES.get(axis, axis)} {where[axis]}" for axis in where if sizes[axis] > 1)
        name = ", ".join(filter(None, (path.name, series.position, *at)))
        yield plane_at(place, series, axes.several, name, path, n, partial(read, name, where))


_TITLES = {"Z": "z", "C": "channel", "T": "time", **dict.fromkeys(POSITION_AXES, "position")}


def length_um(value: object, unit: object) -> float | None:
    """Return a stated length in um; None for what is no length, not finite or 0."""
    try:
        number, factor = float(str(value)), UNITS_UM.get(str(unit).strip())
    except ValueError:
        return None
    return number * factor if factor is not None and math.isfinite(number) and number != 0 else None


def stated_number(text: object) -> float | None:
    """Return a number; None for what is none, or not finite."""
    try:
        number = float(str(text))
    except ValueError:
        return None
    return number if math.isfinite(number) else None
