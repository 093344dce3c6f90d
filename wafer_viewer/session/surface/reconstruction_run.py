"""One reconstruction of a dataset: which fields wait, which are with workers, and what its mosaic still lacks."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path

from wafer_viewer.model.surface.recipe import Recipe


@dataclass(slots=True)
class ReconstructionRun:
    """One reconstruction of the open dataset; more fields may join while a scan goes on.

    complete: fields that have all their frames; live: those that a worker was set on while they were being taken, of
    which made_live got their heights that way. restitch: the mosaic lacks heights that there are; grown: fields were
    added to it before all were there, so their poses are still to be solved for together; grows_again_at: no sooner on
    the clock is it added to again.
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
        """Whether the first field is still to say what `auto` means for all: it goes alone."""
        return self.recipe.heights_have_auto and not self.answered

    @property
    def idle(self) -> bool:
        """Whether no field waits or is with a worker."""
        return not self.waiting and not self.busy

    @property
    def growing_work(self) -> str:
        """The name of the work of adding to the mosaic."""
        return f"{self.work}-growing"

    def live_work(self, number: int) -> str:
        """The name of the work of measuring a field while its frames are taken."""
        return f"{self.work}-live-{number}"
