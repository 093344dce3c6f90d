"""Name of the surface that a browser shows, and of the part its statistics cover."""

from __future__ import annotations

from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.surface.comparison import ComparisonFace, comparison_of

FACES: dict[ComparisonFace, str] = {
    ComparisonFace.DIFFERENCE: "Second − first",
    ComparisonFace.FIRST: "First surface",
    ComparisonFace.SECOND: "Second surface",
    ComparisonFace.BESIDE: "Both surfaces",
}
PARTS = {"all": "", "view": ", in view", "selection": ", selection"}


def name_of(view: View) -> str:
    """Return the name of the surface part that statistics cover, such as ``Field 5, in view``."""
    compared = comparison_of(view.show)
    whole = FACES[compared[1]] if compared is not None else f"Field {view.show}" if view.show else "Stitched surface"
    return whole + PARTS[view.counted]
