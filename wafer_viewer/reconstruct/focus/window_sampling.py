"""Check of the z sampling: peaks are undersampled if the step exceeds half the depth of field."""

from __future__ import annotations

NARROWEST_STEPS = 1.2
"""Focus curves no wider than this at half maximum, in steps, have a single frame at their peak."""


def coarse_step(step_um: float, depth_of_field_um: float, focus_width_um: float) -> tuple[str, ...]:
    """Return a note when the step is too coarse for the depth of field or, if that is 0 (unknown), the focus width."""
    half_um = depth_of_field_um / 2
    if half_um > 0 and step_um > half_um:
        return (
            f"The step of {step_um:.3g} um is over half the depth of field, {half_um:.2g} um: heights scatter more "
            "than they need to; scan with a finer step.",
        )
    if half_um == 0 and focus_width_um <= NARROWEST_STEPS * step_um:
        return (
            f"Focus curves are hardly wider than a step, {focus_width_um:.3g} um of {step_um:.3g} um: heights scatter "
            "more than they need to; take frames closer to each other.",
        )
    return ()
