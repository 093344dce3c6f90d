"""Which waves the optics and the search for focus can see, and how rough a surface must be to show over the noise."""

from __future__ import annotations

from collections.abc import Iterator

from wafer_viewer.model.acquisition.optics import WAVELENGTH_UM, engraved_aperture
from wafer_viewer.model.surface.height_map import Provenance

PIXELS_A_WAVE = 3
"""ISO 25178-3 asks of optical instruments that the shortest wave is sampled so often."""
NOISE_STEPS = {"argmax": 0.29}
"""Scatter of heights in steps of the sweep, by the way peaks are found: rounded to whole frames it is 1 / sqrt(12)."""
NOISE_STEPS_BETWEEN = 0.015
"""The same for peaks found between frames, at its best: planes simulated by rays in steps of 2 and 4 um."""
CLEAR_OF_NOISE = 3.0
"""So many times the noise a surface's Sq is hardly changed by it: by a twentieth."""


def unseen_waves(provenance: Provenance, pixel_um: float, shortest_um: float | None, name: str) -> tuple[str, ...]:
    """Where waves as short as a filter lets through (None: no filter) are shorter than can be seen, and why.

    name: of the filter.
    """
    limits = sorted(_limits_um(provenance, pixel_um), reverse=True)
    if not limits:
        return ()
    limit_um, why = limits[0]
    if shortest_um is None:
        return (f"Waves under {limit_um:.3g} um cannot be seen here, {why}: what is shorter is noise.",)
    if shortest_um < limit_um:
        return (
            f"{name} is {shortest_um:g} um and waves under {limit_um:.3g} um cannot be seen here, {why}: take "
            f"{limit_um:.3g} um or more.",
        )
    return ()


def near_noise(provenance: Provenance, root_mean_square_um: float, name: str) -> tuple[str, ...]:
    """A warning where a root mean square height is so small that it may be all noise."""
    per_step = NOISE_STEPS.get(provenance.recipe.peak, NOISE_STEPS_BETWEEN)
    noise_um = per_step * provenance.z_step_um
    if root_mean_square_um >= CLEAR_OF_NOISE * noise_um:
        return ()
    return (
        f"{name} is {root_mean_square_um:.2g} um, and heights from steps of {provenance.z_step_um:g} um scatter by "
        f"{noise_um:.2g} um at best: much of it is noise.",
    )


def _limits_um(provenance: Provenance, pixel_um: float) -> Iterator[tuple[float, str]]:
    """The shortest wave that can be seen, by what limits it."""
    yield PIXELS_A_WAVE * pixel_um, f"three pixels of {pixel_um:.3g} um"
    if isinstance(window := provenance.recipe.window, int) and provenance.z_step_um > 0:
        calibration = provenance.calibration
        of_camera_um = calibration.pixel_um if calibration is not None else pixel_um
        yield window * of_camera_um, f"the focus window of {window} pixels"
    if (aperture := aperture_of(provenance)) is not None:
        yield WAVELENGTH_UM / (2 * aperture), f"the objective's aperture of {aperture:g} in light of {WAVELENGTH_UM} um"


def aperture_of(provenance: Provenance) -> float | None:
    """The numerical aperture as it is engraved on objectives, ``10x/0.28``; None where the calibration names none."""
    return None if provenance.calibration is None else engraved_aperture(provenance.calibration.setup.objective)
