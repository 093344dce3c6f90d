"""Commands of released jobs: release and load a job, align a wafer, continue with the next one."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.planning.job_releases import list_released
from wafer_viewer.session.planning.plan_editor import Drafting
from wafer_viewer.session.state.snapshot import Snapshot


class JobKeeper:
    """Controller of the snapshot's released jobs. Use on the session's thread only."""

    def __init__(self, desk: CommandQueue, drafting: Drafting, folder: Path) -> None:
        self._desk, self._drafting, self._folder = desk, drafting, folder

    def refresh(self) -> None:
        """List the folder of released jobs again."""
        self._desk.change(operating=replace(self._desk.now.operating, jobs=list_released(self._folder)))

    def release(self) -> Path:
        """Release the plan with the recipe of the displayed surface."""
        path = self._drafting.release(*settled_by(self._desk.now))
        self.refresh()
        return path


def settled_by(now: Snapshot) -> tuple[Recipe | None, tuple[float, float] | None]:
    """Return the resolved recipe of the displayed surface, and the stage errors in the plane and along z.

    Each is None if it is unknown.
    """
    surface = now.surface
    stitched = surface.stitching if surface is not None else None
    errors_um = (stitched.stage_error_um, stitched.z_error_um) if stitched is not None else None
    return surface.settled if surface is not None else None, errors_um


class JobVerbs:
    """Job commands for the page and the prompt, ``session.jobs``; every command returns a future."""

    def __init__(self, do: Callable[..., Future[Any]], keeper: JobKeeper, drafting: Drafting) -> None:
        self._do, self._keeper, self._drafting = do, keeper, drafting

    def refresh(self) -> Future[None]:
        """List the released jobs again."""
        return self._do(self._keeper.refresh)

    def release(self) -> Future[Path]:
        """Release the plan under its product and revision; ``auto`` gets the values resolved for the open surface."""
        return self._do(self._keeper.release)

    def take_up(self, path: Path) -> Future[None]:
        """Load a released job for the next wafer."""
        return self._do(self._drafting.load, Path(path))

    def copy(self) -> Future[None]:
        """Copy the released job to an editable plan."""
        return self._do(self._drafting.copy)

    def confirm(self) -> Future[None]:
        """Confirm that the sample on the stage is the named one."""
        return self._do(self._drafting.confirm)

    def mark(self, n: int, x_um: float, y_um: float) -> Future[None]:
        """Set the stage position of the n-th alignment corner, from 0."""
        return self._do(self._drafting.mark, n, x_um, y_um)

    def unmark(self) -> Future[None]:
        """Clear the marked corners."""
        return self._do(self._drafting.unmark)

    def next_wafer(self) -> Future[None]:
        """Start the same job for the next wafer."""
        return self._do(self._drafting.next_wafer)
