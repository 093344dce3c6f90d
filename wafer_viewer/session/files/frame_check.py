"""Work on the frames of the open dataset: the check of their checksums, and their compression as its job requests."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.file_contents import DATASET_ENDING
from wafer_viewer.model.retention import RetentionRule
from wafer_viewer.session.core.background_work import BackgroundWork, Notifications, RunningWork
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import command
from wafer_viewer.session.core.dataset_library import ACCEPTED, Library, today, verdict_word
from wafer_viewer.session.surface.reconstruction_queue import no_heights
from wafer_viewer.session.surface.worker_tasks import compress_frames, find_damaged_frames
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.retention import RULE, required_rule

if TYPE_CHECKING:
    from wafer_viewer.store.dataset.compression import CompressionReport


# ----------------------------------------------------------------------------------------------------------- old frames


@dataclass(frozen=True, slots=True)
class OldFrames:
    """Dataset whose frames may be removed, their size, and the day until which they had to be kept.

    begun: an earlier removal was broken off.
    """

    path: Path
    n_bytes: int
    until: str
    begun: bool


def rule_of(folder: Path, days: int | None) -> RetentionRule:
    """Return the rule of a folder, or one of a number of days. Raises DatasetError where neither says a number."""
    rule = required_rule(folder) if days is None else RetentionRule(frames_days=days)
    if rule.frames_days is None:
        raise DatasetError(
            f"Frames in {folder} are kept for ever: give --days N, or write frames_days = N into {folder / RULE}."
        )
    return rule


def old_frames(folder: Path, rule: RetentionRule) -> tuple[OldFrames, ...]:
    """Return the datasets of a folder whose frames may be removed today, by name."""
    found = (_old(path, rule) for path in sorted(folder.glob(f"*{DATASET_ENDING}")))
    return tuple(old for old in found if old is not None)


def _old(path: Path, rule: RetentionRule) -> OldFrames | None:
    try:
        data = Dataset.open(path)
    except WaferViewerError:
        return None
    n_bytes = data.frame_bytes()
    if data.held is not None or not data.finished or not n_bytes:
        return None
    until = rule.until(data.scan.taken)
    if data.removed is not None:
        return OldFrames(path, n_bytes, until or "", begun=True)
    if until is None or until > today() or verdict_word(data) != ACCEPTED:
        return None
    return OldFrames(path, n_bytes, until, begun=False)


# ---------------------------------------------------------------------------------------------------------- frame check


DAMAGED = "Frames are damaged"
NAMED = 4
"""Largest number of fields, and of runs of frames in a field, that the sentence names."""


class FrameCheck:
    """Check on a worker, when a person asks for it, or when a field got no heights; it can be cancelled."""

    def __init__(
        self, command_queue: CommandQueue, library: Library, background: BackgroundWork, notices: Notifications
    ) -> None:
        self._command_queue, self._library = command_queue, library
        self._background, self._notices = background, notices
        self._running: RunningWork[tuple[Shot, ...]] | None = None
        self._number = 0
        """Number of the latest check; earlier ones are abandoned."""

    @command
    def check(self) -> Future[tuple[Shot, ...]]:
        """Compare all frames of the open dataset with their checksums; the result has the damaged ones."""
        return self.begin().done

    def begin(self) -> RunningWork[tuple[Shot, ...]]:
        """Begin the check of the open dataset; one that runs is abandoned."""
        self.abandon()
        path, number = self._library.shown.path, self._number
        self._running = self._background.run(
            f"Check the frames of {path.stem}",
            find_damaged_frames,
            path,
            ended=lambda done: self._ended(path, number, done),
        )
        return self._running

    def abandon(self) -> None:
        """Give up a running check, because the frames are about to change."""
        self._number += 1
        if (running := self._running) is not None:
            self._running = None
            self._background.cancel(running.id)

    def forget(self) -> None:
        """Forget what was found: another dataset is open, or its damaged frames are being taken again."""
        self.abandon()
        self._notices.withdraw(DAMAGED)

    def _ended(self, path: Path, number: int, done: Future[tuple[Shot, ...]]) -> None:
        if number != self._number:
            return
        self._running = None
        if done.cancelled() or done.exception() is not None or not self._library.is_open(path):
            return
        damaged = done.result()
        self._library.show_damage(damaged)
        self._notices.withdraw(DAMAGED)
        for number in {shot.field for shot in damaged}:
            self._notices.withdraw(no_heights(number))  # said in one sentence for all
        if damaged:
            text = f"{damage_sentence(damaged)} Take them again in Acquire, or restore the files from a copy."
            self._notices.fault(DAMAGED, text, "scan")


def damage_sentence(damaged: Iterable[Shot]) -> str:
    """Return one sentence that names damaged frames; frames count from 1, as on the page.

    >>> damage_sentence([Shot(1, 4), Shot(2, 0), Shot(2, 1), Shot(2, 2)])
    '4 frames are damaged: frame 5 of field 1; frames 1 to 3 of field 2.'
    """
    frames = sorted({(shot.field, shot.k) for shot in damaged})
    of_fields = {number: [k + 1 for _, k in group] for number, group in groupby(frames, key=lambda frame: frame[0])}
    named = [f"{_listed(ks)} of field {number}" for number, ks in list(of_fields.items())[:NAMED]]
    more = len(of_fields) - len(named)
    rest = [f"and others of {more} more field{'s' if more > 1 else ''}"] if more else []
    are = "frame is" if len(frames) == 1 else "frames are"
    return f"{len(frames)} {are} damaged: {'; '.join((*named, *rest))}."


def _listed(numbers: list[int]) -> str:
    """Return ascending numbers as runs, ``1 to 3, 5``."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    words = [f"{low}" if low == high else f"{low} to {high}" for low, high in runs[:NAMED]]
    more = " and others" if len(runs) > NAMED else ""
    return f"frame{'s' if len(numbers) > 1 else ''} {', '.join(words)}{more}"


class FrameCompression:
    """Compression on a worker, field by field; use on the session's thread only.

    The worker holds the lock of the dataset meanwhile, also when another dataset is opened.
    """

    def __init__(self, library: Library, background: BackgroundWork, notices: Notifications) -> None:
        self._library, self._background, self._notices = library, background, notices
        self._running: set[Path] = set()

    def begin(self) -> None:
        """Compress the frames of the open dataset if its job requests it and its scan is finished."""
        shown = self._library.shown
        codec, path = shown.job.compression, shown.path
        if codec == "none" or not shown.finished or shown.read_only is not None or path in self._running:
            return
        self._running.add(path)
        self._library.release_lock()
        title = f"Compress the frames of {shown.name}"
        self._background.run(title, compress_frames, path, codec, ended=lambda done: self._over(path, done))

    def require_over(self, path: Path) -> None:
        """Raise DatasetError while the frames of a dataset are being compressed."""
        if path in self._running:
            raise DatasetError(
                f"The frames of {path.stem} are being compressed: cancel that in the list of running work, or wait "
                "until it is done."
            )

    def _over(self, path: Path, done: Future[CompressionReport]) -> None:
        self._running.discard(path)
        if self._library.is_open(path):
            self._library.compressed()
        if (fault := done.exception()) is not None:
            self._notices.fault("The frames are not all compressed", str(fault), "scan", needs_person=False)
            return
        for left in done.result().left:
            self._notices.fault("Frames were left uncompressed", left, "scan")
