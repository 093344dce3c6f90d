"""The verbs of released jobs: releasing and taking one up, aligning a wafer, going on with the next."""

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
    """The released jobs of the snapshot; on the session's thread only."""

    def __init__(self, desk: CommandQueue, drafting: Drafting, folder: Path) -> None:
        self._desk, self._drafting, self._folder = desk, drafting, folder

    def refresh(self) -> None:
        """List the folder of released jobs anew."""
        self._desk.change(operating=replace(self._desk.now.operating, jobs=list_released(self._folder)))

    def release(self) -> Path:
        """Release the plan with the recipe of the surface being looked at."""
        path = self._drafting.release(*settled_by(self._desk.now))
        self.refresh()
        return path


def settled_by(now: Snapshot) -> tuple[Recipe | None, tuple[float, float] | None]:
    """The recipe that the surface on show came to, and the stage's errors in the plane and along z; None without."""
    surface = now.surface
    stitched = surface.stitching if surface is not None else None
    errors_um = (stitched.stage_error_um, stitched.z_error_um) if stitched is not None else None
    return surface.settled if surface is not None else None, errors_um


class JobVerbs:
    """What the page and the prompt ask for, ``session.jobs``; every verb returns a future."""

    def __init__(self, do: Callable[..., Future[Any]], keeper: JobKeeper, drafting: Drafting) -> None:
        self._do, self._keeper, self._drafting = do, keeper, drafting

    def refresh(self) -> Future[None]:
        """List the released jobs anew."""
        return self._do(self._keeper.refresh)

    def release(self) -> Future[Path]:
        """Release the plan under its product and revision; an ``auto`` takes what the open surface settled it to."""
        return self._do(self._keeper.release)

    def take_up(self, path: Path) -> Future[None]:
        """Take a released job for the next wafer."""
        return self._do(self._drafting.load, Path(path))

    def copy(self) -> Future[None]:
        """Make a plan that can be changed of the released job."""
        return self._do(self._drafting.copy)

    def confirm(self) -> Future[None]:
        """A person looked: the sample on the stage is the one that is named."""
        return self._do(self._drafting.confirm)

    def mark(self, n: int, x_um: float, y_um: float) -> Future[None]:
        """The n-th corner to align by, from 0, is seen at a place of the stage."""
        return self._do(self._drafting.mark, n, x_um, y_um)

    def unmark(self) -> Future[None]:
        """Forget the corners that were marked."""
        return self._do(self._drafting.unmark)

    def next_wafer(self) -> Future[None]:
        """The same job for the next wafer."""
        return self._do(self._drafting.next_wafer)
