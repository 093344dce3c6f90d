"""What can be set of a measuring tool beside its places: a spec a tool, its fields the keywords of what measures."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import msgspec

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.measuring import ToolName
from wafer_viewer.model.spec import Spec


class OptionsSpec(Spec, frozen=True, kw_only=True):
    """The base of every tool's options."""

    error: ClassVar[type[WaferViewerError]] = MeasureError


class VolumeOptions(OptionsSpec, frozen=True, kw_only=True):
    """reference: the plane through the region's border, or the zero of heights; None: the border over the stage's zero,
    else the zero that was chosen."""

    reference: Literal["border", "zero"] | None = None


class ToolOptions(Spec, frozen=True, kw_only=True):
    """The options of every tool that has some, by its name."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    volume: VolumeOptions = VolumeOptions()


def keywords(options: ToolOptions, tool: ToolName) -> dict[str, Any]:
    """The options of one tool as keywords of its measuring function; none for a tool without options."""
    own = getattr(options, tool, None)
    return msgspec.structs.asdict(own) if own is not None else {}
