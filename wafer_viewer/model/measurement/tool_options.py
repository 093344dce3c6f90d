"""What can be set of a measuring tool beside its places: a spec a tool, its fields the keywords of what measures."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import msgspec

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.measurement.tools import ToolName
from wafer_viewer.model.measurement.uncertainty_conditions import Conditions
from wafer_viewer.model.spec import Positive, Spec, Within


class OptionsSpec(Spec, frozen=True, kw_only=True):
    """The base of every tool's options."""

    error: ClassVar[type[WaferViewerError]] = MeasureError


StepDefinition = Literal["common_plane", "upper_face", "lower_face", "joint"]
"""Where the two faces of a step are compared: each in the middle of its region, over a plane that both have in common
or that of one of them; or both extended to the middle between the regions."""


class StepOptions(OptionsSpec, frozen=True, kw_only=True):
    """definition: what the height of the step is; conditions: what is known of how it was measured."""

    definition: StepDefinition = "common_plane"
    conditions: Conditions = Conditions()


class GrooveOptions(OptionsSpec, frozen=True, kw_only=True):
    """shape: what the line crosses, a groove (or a ridge) with two edges, or a single step."""

    shape: Literal["groove", "step"] = "groove"
    conditions: Conditions = Conditions()


class VolumeOptions(OptionsSpec, frozen=True, kw_only=True):
    """reference: the plane through the region's border, or the zero of heights; None: the border over the stage's zero,
    else the zero that was chosen."""

    reference: Literal["border", "zero"] | None = None


class TextureOptions(OptionsSpec, frozen=True, kw_only=True):
    """form_order: of the polynomial of least squares that is taken off as form, 0 the mean alone, 1 a plane.

    s_filter_um, l_filter_um: nesting indices of the Gaussian filters of ISO 16610-61 that take off what is shorter, and
    what is longer; None: no filter.
    """

    form_order: Annotated[int, Within(0, 8)] = 1
    s_filter_um: Positive | None = None
    l_filter_um: Positive | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.s_filter_um is not None and self.l_filter_um is not None and self.s_filter_um >= self.l_filter_um:
            self.refuse("s_filter_um", f"under l_filter_um, which is {self.l_filter_um:g}: else nothing is left")


class RoughnessOptions(OptionsSpec, frozen=True, kw_only=True):
    """lambda_c_um, lambda_s_um: cut-offs of the Gaussian filters of ISO 16610-21 that take off what is longer, and what
    is shorter; None: no filter."""

    lambda_c_um: Positive | None = None
    lambda_s_um: Positive | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lambda_s_um is not None and self.lambda_c_um is not None and self.lambda_s_um >= self.lambda_c_um:
            self.refuse("lambda_s_um", f"under lambda_c_um, which is {self.lambda_c_um:g}: else nothing is left")


class KerfOptions(OptionsSpec, frozen=True, kw_only=True):
    """kerf: whether it is brighter or darker on the picture than what lies beside it."""

    kerf: Literal["either", "bright", "dark"] = "either"


class DieOptions(OptionsSpec, frozen=True, kw_only=True):
    """die: whether its rim is brighter or darker on the picture than what is round it."""

    die: Literal["either", "bright", "dark"] = "either"


class CircleOptions(OptionsSpec, frozen=True, kw_only=True):
    """inside: whether the picture is brighter or darker inside of the round edge."""

    inside: Literal["either", "bright", "dark"] = "either"


class ChippingOptions(OptionsSpec, frozen=True, kw_only=True):
    """limit_um: what is deeper is a chip; None: four robust deviations of the edge, two pixels at least.

    die: on which side of the edge it lies; auto: on the higher one.
    """

    limit_um: Positive | None = None
    die: Literal["auto", "bright", "dark"] = "auto"


class CoplanarityOptions(OptionsSpec, frozen=True, kw_only=True):
    """reference: the plane that tops are compared with, of least squares or the one that the part would stand on."""

    reference: Literal["least_squares", "seating"] = "least_squares"


class SiteRangeOptions(OptionsSpec, frozen=True, kw_only=True):
    """width_um, height_um: of a site; None: a quarter of the region's side."""

    width_um: Positive | None = None
    height_um: Positive | None = None


class ToolOptions(Spec, frozen=True, kw_only=True):
    """The options of every tool that has some, by its name."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    step: StepOptions = StepOptions()
    groove: GrooveOptions = GrooveOptions()
    volume: VolumeOptions = VolumeOptions()
    texture: TextureOptions = TextureOptions()
    roughness: RoughnessOptions = RoughnessOptions()
    kerf: KerfOptions = KerfOptions()
    die: DieOptions = DieOptions()
    circle: CircleOptions = CircleOptions()
    chipping: ChippingOptions = ChippingOptions()
    coplanarity: CoplanarityOptions = CoplanarityOptions()
    site_range: SiteRangeOptions = SiteRangeOptions()


def keywords(options: ToolOptions, tool: ToolName) -> dict[str, Any]:
    """The options of one tool as keywords of its measuring function; none for a tool without options."""
    own = getattr(options, tool, None)
    return msgspec.structs.asdict(own) if own is not None else {}
