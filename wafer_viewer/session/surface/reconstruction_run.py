"""State of a reconstruction: queued fields, fields on workers, and outstanding changes of the mosaic."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path

from wafer_viewer.model.surface.recipe import Recipe


@dataclass(slots=True)
class ReconstructionRun:
    """Reconstruction of the open dataset; fields can be added while a scan runs.

    complete: fields that have all their frames; live: those reconstructed during their scan, of which made_live have
    their heights. restitch: the mosaic lacks available heights; grown: fields were added before all were available, so
    their poses still have to be solved jointly; grows_again_at: earliest clock time of the next update.
    """

    path: Path
    result: str
    recipe: Recipe
    work: str
    waiting: deque[int] = field(default_factory=deque[int])
    busy: set[int] = field(default_factory=set[int])
    total: int = 0
    complete: set[int] = field(default_factory=set[int])
    live: set[int] = field(default_factory=set[int])
    made_live: set[int] = field(default_factory=set[int])
    restitch: bool = False
    grown: bool = False
    stitching: bool = False
    grows_again_at: float = 0.0
    answered: bool = False
    answer: Future[None] | None = None

    @property
    def settling(self) -> bool:
        """True while the first field still has to resolve `auto` for all; it is processed alone."""
        return self.recipe.heights_have_auto and not self.answered

    @property
    def idle(self) -> bool:
        """True if no field is queued or on a worker."""
        return not self.waiting and not self.busy

    @property
    def growing_work(self) -> str:
        """Name of the work item for updates of the growing mosaic."""
        return f"{self.work}-growing"

    def live_work(self, number: int) -> str:
        """Return the name of the work item of a field's live reconstruction."""
        return f"{self.work}-live-{number}"
