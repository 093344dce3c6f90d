"""Uncertainty of heights from the frames themselves: positions along z and flicker of the light."""

from __future__ import annotations

import math

from wafer_viewer.model.spec import NonNegative, Spec

JITTER_SHARE = 0.75
"""Standard uncertainty of a height per unit of z jitter of single frames and per sqrt(step / depth of field).

Monte Carlo on focus curves of a circular aperture, exact to 1 % for steps from 0.2 to 0.75 depths of field.
"""
FLICKER_SHARE = 0.29
"""Standard uncertainty of a height in depths of field, per unit of flicker and per sqrt(step / depth of field).

From the same simulation, for steps up to 0.75 depths of field.
"""


class FrameHealth(Spec, frozen=True, kw_only=True):
    """Standard uncertainty (k = 1) of one height in um, from the z jitter of frames and from flicker; 0 if unseen.

    u_jitter_um: a lower bound from the surface itself, where its relief spans several depths of field; u_flicker_um:
    of the flicker that is left after correction. Heights at different z come from different frames: a difference has
    sqrt(2) times the uncertainty.
    """

    u_jitter_um: NonNegative = 0.0
    u_flicker_um: NonNegative = 0.0

    @classmethod
    def worst(cls, *parts: FrameHealth) -> FrameHealth:
        """Return the largest uncertainties of several fields."""
        jitter_um, flicker_um = (
            max((getattr(part, name) for part in parts), default=0.0) for name in ("u_jitter_um", "u_flicker_um")
        )
        return cls(u_jitter_um=jitter_um, u_flicker_um=flicker_um)


def jitter_u_um(jitter_um: float, step_um: float, depth_of_field_um: float) -> float:
    """Return the standard uncertainty of a height due to the standard deviation of the z of single frames."""
    return JITTER_SHARE * math.sqrt(step_um / depth_of_field_um) * jitter_um


def flicker_u_um(flicker: float, step_um: float, depth_of_field_um: float) -> float:
    """Return the standard uncertainty of a height due to flicker, given as the standard deviation of the gains."""
    return FLICKER_SHARE * math.sqrt(step_um / depth_of_field_um) * depth_of_field_um * flicker
