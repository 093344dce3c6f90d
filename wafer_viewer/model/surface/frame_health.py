"""Uncertainty of heights from the frames themselves: positions along z, gaps, and flicker of the light."""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.model.spec import NonNegative, Spec

JITTER_SHARE = 0.75
"""Standard uncertainty of a height per unit of z jitter of single frames and per sqrt(step / depth of field).

Monte Carlo on focus curves of a circular aperture, exact to 1 % for steps from 0.2 to 0.75 depths of field.
"""
FLICKER_SHARE = 0.29
"""Standard uncertainty of a height in depths of field, per unit of flicker and per sqrt(step / depth of field).

From the same simulation, for steps up to 0.75 depths of field.
"""
PEAK_WIDTHS = (1.0, 1.15, 1.25, 1.35, 1.45, 1.55, 1.7, 1.9, 2.3, 4.0)
"""Widths of a focus curve at its peak, in z steps, to which `CENTRED_U` belongs."""
CENTRED_U = (0.12, 0.1, 0.08, 0.06, 0.038, 0.022, 0.011, 0.006, 0.004, 0.003)
"""Standard uncertainty of one height, in z steps, for centred peaks: tests/bench/bench_phase.py.

Rms of lenses of rays, whose curves are narrower and less round than those of waves.
"""
THREE_POINT_U = 0.03
"""The same for peaks through three points, rms of the blur law at any step up to a depth of field."""
GAP_DOF = (0.4, 0.6, 0.85, 1.1, 1.45, 1.8)
"""Distances of the frames on both sides of a gap, in depths of field, to which `GAP_U` belongs."""
GAP_U = (0.02, 0.025, 0.04, 0.067, 0.14, 0.18)
"""Standard uncertainty of one height beside a gap, in its widths, for centred peaks: tests/bench/bench_gaps.py."""


class FrameHealth(Spec, frozen=True, kw_only=True):
    """Standard uncertainty (k = 1) of one height in um that the frames cause; 0 if unseen.

    u_between_um: of interpolation between frames, 0 if not told. u_jitter_um: of the z jitter of single frames, a lower
    bound: it tells how far frames differ from those beside them, and, where the relief spans several depths of field,
    from the surface. u_flicker_um: of the flicker that is left after correction. u_gap_um: of heights beside the worst
    gap, where frames are missing or were left out. Heights at different z come from different frames: a difference has
    sqrt(2) times the uncertainty.
    """

    u_between_um: NonNegative = 0.0
    u_jitter_um: NonNegative = 0.0
    u_flicker_um: NonNegative = 0.0
    u_gap_um: NonNegative = 0.0

    @classmethod
    def worst(cls, *parts: FrameHealth) -> FrameHealth:
        """Return the largest uncertainties of several fields."""
        names = cls.__struct_fields__
        return cls(**{name: max((getattr(part, name) for part in parts), default=0.0) for name in names})


def jitter_u_um(jitter_um: float, step_um: float, depth_of_field_um: float) -> float:
    """Return the standard uncertainty of a height due to the standard deviation of the z of single frames."""
    return JITTER_SHARE * math.sqrt(step_um / depth_of_field_um) * jitter_um


def flicker_u_um(flicker: float, step_um: float, depth_of_field_um: float) -> float:
    """Return the standard uncertainty of a height due to flicker, given as the standard deviation of the gains."""
    return FLICKER_SHARE * math.sqrt(step_um / depth_of_field_um) * depth_of_field_um * flicker


def gap_u_um(gap_um: float, depth_of_field_um: float) -> float:
    """Return the standard uncertainty of a height beside a gap between two frames."""
    return gap_um * float(np.interp(gap_um / depth_of_field_um, GAP_DOF, GAP_U))


def interpolation_u_um(peak: str, step_um: float, peak_width_um: float) -> float:
    """Return the standard uncertainty of a height from interpolation between frames; not for argmax, which has none."""
    if peak != "centred":
        return THREE_POINT_U * step_um
    return float(np.interp(peak_width_um, step_um * np.array(PEAK_WIDTHS), step_um * np.array(CENTRED_U)))
