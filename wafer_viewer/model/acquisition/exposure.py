"""Result of the search for the exposure: brightness in focus, and a bracket where one exposure does not suffice."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ExposureLevels:
    """Brightness in focus at an exposure; a pixel counts by its brightest frame over z, as a fraction of white.

    level: of the brightest pixels; clipped_fraction: share of pixels at white; dark_fraction: share of pixels too dark
    to measure heights from; dark_level: median of those, 0 without any; brightest_field: number of the field that has
    the brightest pixels.
    """

    exposure_us: float
    level: float
    clipped_fraction: float
    dark_fraction: float
    dark_level: float
    brightest_field: int


@dataclass(frozen=True, slots=True)
class FoundExposure:
    """Exposure that suits the brightest of some fields over their z range, and what it was found from.

    single: at the exposure found; bracket: proposed where a single exposure leaves too much in the dark, shortest
    first, else empty; fields: numbers; z_um: positions above the start of each field's sweep; n_frames: frames taken.
    """

    single: ExposureLevels
    bracket: tuple[ExposureLevels, ...]
    fields: tuple[int, ...]
    z_um: tuple[float, ...]
    n_frames: int

    @property
    def single_us(self) -> tuple[float, ...]:
        """The exposure found, as exposures of a plan."""
        return (self.single.exposure_us,)

    @property
    def bracket_us(self) -> tuple[float, ...]:
        """The proposed bracket, as exposures of a plan."""
        return tuple(levels.exposure_us for levels in self.bracket)
