"""Simulated faults of the virtual rig, as they occur in real stages, pulse boxes, cables and cameras."""

from __future__ import annotations

from typing import Annotated, ClassVar

from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.spec import Count, NonNegative, Spec, Within
from wafer_viewer.rigs.virtual.serial_port import Interference

# --------------------------------------------------------------------------------------------------- calibration errors


SmallFraction = Annotated[float, Within(-0.1, 0.1)]


class CalibrationErrors(Spec, frozen=True, kw_only=True):
    """True values of the virtual rig relative to those in its calibration; the table ``[calibration_errors]``.

    Parameters
    ----------
    pixel_fraction : true pixel size over the calibrated one, minus 1.
    camera_rotation_rad : angle from the x axis of the stage to the rows of the camera, anticlockwise, minus the
        calibrated one.
    trigger_delay_us : delay from the pulse to the exposure, minus the calibrated one.
    shading_fraction : rise of the sensitivity from the left to the right edge of the image, beyond vignetting.
    black_counts : counts of the camera without light, of 255.
    distortion_fraction : radial displacement at the corners of the image, as a fraction of their distance from its
        centre; positive for pincushion distortion.
    z_fraction : true distance along z over that on the scale, minus 1.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    pixel_fraction: SmallFraction = 0.0
    camera_rotation_rad: SmallFraction = 0.0
    trigger_delay_us: Annotated[float, Within(-10.0, 100_000.0)] = 0.0
    shading_fraction: Annotated[float, Within(-0.5, 0.5)] = 0.0
    black_counts: Annotated[int, Within(0, 50)] = 0
    distortion_fraction: SmallFraction = 0.0
    z_fraction: SmallFraction = 0.0


# --------------------------------------------------------------------------------------------------------------- faults


Numbers = tuple[int, ...]
WrapsAt = Annotated[int, Within(0)]


class Faults(Spec, frozen=True, kw_only=True):
    """Faults of the virtual rig; none by default. The table ``[faults]`` of a rig's file.

    Triggers are numbered from 0 since the rig was switched on; only those received while the camera is armed count. The
    first is the test pulse of a scan. Motions are numbered from 0 in the order of their commands.

    Parameters
    ----------
    ignored_triggers : triggers that the camera does not expose at.
    lost_images : triggers whose image is lost on its way to the computer.
    incomplete : triggers whose image arrives incomplete, with a stale counter.
    duplicated_images : triggers whose image arrives twice.
    extra_edges : triggers after which interference causes a further edge at the camera, `extra_edge_us` later. The
        camera counts it, and exposes at it when it is ready.
    trigger_counter : false for a camera that does not number its images.
    counts_exposures : true for a camera that numbers its exposures instead of the edges at its input.
    counter_wraps_at : modulus of the camera's counter; 0 for no wrap.
    unseen_exposures : triggers whose exposure the pulse box does not detect, so that its count is short.
    suppressed_pulses : triggers that the pulse box holds back once, and reports as suppressed.
    slips : triggers at which the pulse box loses `slip_counts` counts of the moving axis. With `slips_reported` it
        reports a quadrature error for every two of them.
    slipping_motions : motions in which the pulse box loses `slip_counts` counts of the axis that it is set to.
    reboots : triggers at which the pulse box loses its power; it answers again after 1.5 s,
        with time and counts at 0 where the stage stands.
    stage_lost, box_lost, camera_lost : triggers at which the cable of the device is pulled; it answers again when the
        rig is opened again. A motion goes on to its end, and the box disarms itself without a heartbeat.
    endless_motions : motions after which the stage reports motion until it is stopped.
    late_motions : motions that begin `late_s` after their command.
    overshooting_motions : motions that end `overshoot_um` beyond their goal.
    cut_images : triggers whose image lacks its lower half, and is not marked as incomplete.
    ignores_heartbeat : true for a pulse box that stays armed without a heartbeat.
    wire : interference on the serial line.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    ignored_triggers: Numbers = ()
    lost_images: Numbers = ()
    incomplete: Numbers = ()
    duplicated_images: Numbers = ()
    extra_edges: Numbers = ()
    extra_edge_us: NonNegative = 1_000.0
    trigger_counter: bool = True
    counts_exposures: bool = False
    counter_wraps_at: WrapsAt = 0
    unseen_exposures: Numbers = ()
    suppressed_pulses: Numbers = ()
    slips: Numbers = ()
    slipping_motions: Numbers = ()
    slip_counts: Count = 14
    slips_reported: bool = True
    reboots: Numbers = ()
    stage_lost: Numbers = ()
    box_lost: Numbers = ()
    camera_lost: Numbers = ()
    endless_motions: Numbers = ()
    late_motions: Numbers = ()
    late_s: NonNegative = 0.5
    overshooting_motions: Numbers = ()
    overshoot_um: float = 5.0
    cut_images: Numbers = ()
    ignores_heartbeat: bool = False
    wire: Interference = Interference()
