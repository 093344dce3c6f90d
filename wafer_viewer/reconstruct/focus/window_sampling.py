"""Whether the frames of a stack lie close enough: with over half a depth of field between them peaks fall between."""

from __future__ import annotations

NARROWEST_STEPS = 1.2
"""Focus curves that are no wider than this at half their height have a single frame at their peak."""


def coarse_step(step_um: float, depth_of_field_um: float, focus_width_um: float) -> tuple[str, ...]:
    """A sentence when the step is too coarse for the optics, as known (0: not), or else as the focus curves show."""
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
