"""Hidden errors of the virtual rig's calibration, for calibrations to find."""

from __future__ import annotations

from typing import Annotated, ClassVar

from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.spec import Spec, Within

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
