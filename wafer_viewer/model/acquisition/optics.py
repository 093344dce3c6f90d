"""Numerical aperture and depth of field of an objective, in air."""

from __future__ import annotations

import re

WAVELENGTH_UM = 0.55
"""Green light, the default."""

_ENGRAVED = re.compile(r"\d\s*[xX×]?\s*/\s*([01]\.\d+)")


def depth_of_field_um(numerical_aperture: float, pixel_um: float, wavelength_um: float = WAVELENGTH_UM) -> float:
    """Return the depth of field, wavelength / NA^2 + pixel on the sample / NA, in um."""
    return wavelength_um / numerical_aperture**2 + pixel_um / numerical_aperture


def engraved_aperture(objective: str) -> float | None:
    """Return the numerical aperture engraved in an objective's name, as in ``10x/0.28``, or None."""
    found = _ENGRAVED.search(objective)
    return float(found.group(1)) if found is not None else None
