"""Focus measures: names, titles, properties and implementations; other packages may bring their own.

A package names a `FocusMeasure` as an entry point of the group ``wafer_viewer.focus_measures``.
"""

from __future__ import annotations

import warnings
from functools import cache
from typing import Annotated, ClassVar

from wafer_viewer.model.errors import ComputeError, WaferViewerError
from wafer_viewer.model.plugins import PluginWarning, plugins
from wafer_viewer.model.spec import Count, Positive, Spec, Within


class FocusMeasure(Spec, frozen=True, kw_only=True):
    """A focus measure.

    Parameters
    ----------
    name : str
        Name in recipes and on the command line.
    title, description : str
        Short name on the page; one line on what is computed.
    implementation : str
        ``module:object``, imported at its first use: a plain function ``f(image, window)``, or the `FocusKernels` of a
        compiled measure. The function takes a frame with a margin, float32 [row, col] in grey values, and the window in
        pixels; it returns the focus as an array of the same shape. Focus is positive, on any scale; zero, negative
        values and NaN mean no focus. Several threads call the function at the same time.
    power : float
        The focus falls as the blur variance to minus this power. The energy of white texture under a Gaussian blur of
        variance v goes as 1 / v^2 for first and 1 / v^3 for second derivatives; the power of the variance in a window,
        which removes the mean, was measured, and the power of a mean of logarithms equals that of its energy.
    passes, taps_px : int
        Reach beyond a pixel: number of times that the window is applied, and pixels of the derivatives.
    uses_camera_noise : bool
        True if the measure takes stabilised grey values, whose camera noise has unit variance at every grey. A plain
        function receives them in place of the grey values.
    """

    error: ClassVar[type[WaferViewerError]] = ComputeError
    name: str
    title: str
    description: str
    implementation: str
    power: Positive
    passes: Count = 1
    taps_px: Annotated[int, Within(0)] = 1
    uses_camera_noise: bool = False

    def margin_px(self, window: int) -> int:
        """Return the reach of a window beyond a pixel."""
        return self.passes * (window // 2) + self.taps_px


_PAPER = "wafer_viewer.reconstruct.focus.sml_tenengrad_glv"
BUILT_IN = (
    FocusMeasure(
        name="log_laplacian",
        title="Log-Laplacian",
        description="mean logarithm of a Laplacian's energy over the camera's noise",
        implementation="wafer_viewer.reconstruct.focus.log_laplacian:KERNELS",
        power=3.0,
        passes=2,
        taps_px=3,
        uses_camera_noise=True,
    ),
    FocusMeasure(
        name="tenengrad",
        title="Tenengrad",
        description="sum of the squared Sobel gradients, eq. 3",
        implementation=f"{_PAPER}:TENENGRAD_KERNELS",
        power=2.0,
    ),
    FocusMeasure(
        name="sml",
        title="SML",
        description="sum of the squared second derivatives, eq. 2",
        implementation=f"{_PAPER}:SML_KERNELS",
        power=3.0,
    ),
    FocusMeasure(
        name="glv",
        title="GLV",
        description="variance of the grey values, eq. 4",
        implementation=f"{_PAPER}:GLV_KERNELS",
        power=1.7,
    ),
)


@cache
def focus_measures() -> dict[str, FocusMeasure]:
    """Return the focus measures by name: the built-in ones, then those of other packages.

    One with a name or title that is taken is left out with a `PluginWarning`.
    """
    found = {measure.name: measure for measure in BUILT_IN}
    for measure in plugins("focus_measures", FocusMeasure):
        if measure.name in found or measure.title in {other.title for other in found.values()}:
            warnings.warn(
                f"There are two focus measures named '{measure.name}' or titled '{measure.title}': that of "
                f"{measure.implementation} is left out; give it another name and title.",
                PluginWarning,
                stacklevel=2,
            )
        else:
            found[measure.name] = measure
    return found
