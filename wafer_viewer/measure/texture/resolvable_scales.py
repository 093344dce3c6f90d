"""Limits of resolvable texture: shortest wavelength by optics and focus window, smallest roughness above the noise."""

from __future__ import annotations

from collections.abc import Iterator

from wafer_viewer.model.acquisition.calibration import WAVELENGTH_UM, engraved_aperture
from wafer_viewer.model.surface.height_map import Provenance

PIXELS_A_WAVE = 3
"""Samples per shortest wave required for optical instruments (ISO 25178-3)."""
NOISE_STEPS = {"argmax": 0.29}
"""Scatter of heights in z steps, by peak method: 1 / sqrt(12) when rounded to frames."""
NOISE_STEPS_BETWEEN = 0.015
"""Smallest scatter with peaks interpolated between frames: ray-traced planes, z steps of 2 and 4 um."""
CLEAR_OF_NOISE = 3.0
"""Ratio of Sq to noise from which noise changes Sq by a twentieth at most."""


def unseen_waves(provenance: Provenance, pixel_um: float, shortest_um: float | None, name: str) -> tuple[str, ...]:
    """Return a note where the filter (None: no filter) passes waves shorter than the resolution, with the reason.

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
    """Return a warning where a root mean square height may be mostly noise."""
    per_step = NOISE_STEPS.get(provenance.recipe.peak, NOISE_STEPS_BETWEEN)
    noise_um = per_step * provenance.z_step_um
    if root_mean_square_um >= CLEAR_OF_NOISE * noise_um:
        return ()
    return (
        f"{name} is {root_mean_square_um:.2g} um, and heights from steps of {provenance.z_step_um:g} um scatter by "
        f"{noise_um:.2g} um at best: much of it is noise.",
    )


def _limits_um(provenance: Provenance, pixel_um: float) -> Iterator[tuple[float, str]]:
    """Yield the shortest resolvable wave by each limiting factor."""
    yield PIXELS_A_WAVE * pixel_um, f"three pixels of {pixel_um:.3g} um"
    if isinstance(window := provenance.recipe.window, int) and provenance.z_step_um > 0:
        calibration = provenance.calibration
        of_camera_um = calibration.pixel_um if calibration is not None else pixel_um
        yield window * of_camera_um, f"the focus window of {window} pixels"
    if (aperture := aperture_of(provenance)) is not None:
        yield WAVELENGTH_UM / (2 * aperture), f"the objective's aperture of {aperture:g} in light of {WAVELENGTH_UM} um"


def aperture_of(provenance: Provenance) -> float | None:
    """Return the numerical aperture engraved on the objective, ``10x/0.28``; None where the calibration has none."""
    return None if provenance.calibration is None else engraved_aperture(provenance.calibration.setup.objective)
