"""What every key does, and what the command palette lists: the verbs of the page in one table."""

from __future__ import annotations

import viser

from wafer_viewer.gui.acquire_panel import AcquirePanel
from wafer_viewer.gui.commands import Command
from wafer_viewer.gui.header import possible
from wafer_viewer.gui.measure_panel import MeasurePanel
from wafer_viewer.gui.page import Page
from wafer_viewer.gui.plan_panel import PlanPanel
from wafer_viewer.gui.surface_panel import SurfacePanel
from wafer_viewer.gui.view import Step
from wafer_viewer.gui.why_panel import WhyPanel


def commands_of(
    page: Page, plan: PlanPanel, acquire: AcquirePanel, surface: SurfacePanel, measure: MeasurePanel, why: WhyPanel
) -> list[Command]:
    """Every verb of the page with its key."""
    session = page.session

    def scan_or_pause() -> None:
        if session.snapshot.scanning:
            acquire.pause_or_resume()
        elif plan.why_not(session.snapshot) is None:
            plan.start()

    def undo() -> None:
        verb = session.undo_findings if page.view.step == "measure" else session.undo
        page.ask("Nothing was undone", verb())

    def leave() -> None:
        """What was opened last is left first."""
        if page.view.explains:
            why.close()
        else:
            page.change(tool="none", selected=None)

    steps: list[Step] = ["plan", "acquire", "surface", "measure"]
    icon = viser.Icon
    return [
        Command("Scan, pause, go on", "G", scan_or_pause, icon.PLAYER_PLAY),
        Command("Profile", "L", lambda: measure.use("profile"), icon.LINE),
        Command("Step height", "K", lambda: measure.use("step"), icon.STAIRS_UP),
        Command("Why this height?", "C", why.toggle, icon.ZOOM_QUESTION),
        Command("Leave the tool", "escape", leave, icon.X),
        Command("Hillshade", "H", surface.toggle_hillshade, icon.SUN),
        Command("All-in-focus", "U", surface.toggle_all_in_focus, icon.FOCUS_2),
        Command("Fields and overlaps", "O", surface.toggle_fields, icon.GRID_DOTS),
        Command("Undo", "Z", undo, icon.ARROW_BACK_UP, "cmd/ctrl"),
        Command(
            "Redo", "Z", lambda: page.ask("Nothing was redone", session.redo()), icon.ARROW_FORWARD_UP, "cmd/ctrl+shift"
        ),
        Command("Light or dark page", None, lambda: page.change(dark=not page.view.dark), icon.MOON),
        *(
            Command(
                f"Go to {step.capitalize()}",
                None,
                lambda s=step: possible(s, session.snapshot) and page.change(step=s, why=None),
            )
            for step in steps
        ),
    ]
