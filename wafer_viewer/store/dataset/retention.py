"""Frames of a dataset: the time for which they are kept, their removal, and holds that forbid it.

Removals and holds are lines of its journal. The line of a removal is on the disk before the first file goes, so a
removal that is broken off is known, and can be finished. Everything else stays: record, journal, surfaces, results and
their manifests.
"""

from __future__ import annotations

import datetime
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.retention import RetentionRule
from wafer_viewer.model.spec import decode
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.lock import Lock
from wafer_viewer.store.dataset.scan_record import (
    FRAMES,
    JOURNAL,
    FramesRemoved,
    Held,
    HoldEnded,
    JournalWriter,
    RetentionLine,
    frames_file,
)
from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors, to_disk
from wafer_viewer.store.io.guarded_reading import read_content
from wafer_viewer.store.records.manifest import sign_scan


def hold_line(data: Dataset, by: str, why: str) -> Held:
    """Return the line of a hold.

    Raises DatasetError without a reason, and where there is nothing to hold.
    """
    data.require_frames("There is nothing to hold")
    if data.held is not None:
        raise DatasetError(f"{data.path.name} is held by {data.held.by} already: {data.held.why}")
    return Held(by, _reason(why), _now())


def hold_end_line(data: Dataset, by: str, why: str) -> HoldEnded:
    """Return the line of the end of a hold. Raises DatasetError without a reason, and where nothing is held."""
    if data.held is None:
        raise DatasetError(f"{data.path.name} is not held.")
    return HoldEnded(by, _reason(why), _now())


def append_line(data: Dataset, line: RetentionLine) -> None:
    """Append a line to the journal of a dataset, sign the scan and read it; the caller holds the lock.

    Raises DatasetError when it cannot be written, or the scan was altered.
    """
    data.refresh()
    sign_scan(data.path)  # first, so that no alteration of before is signed
    journal = JournalWriter(data.path / JOURNAL, data.journal_bytes)
    try:
        journal.write(line)
        journal.to_disk()
    finally:
        journal.close()
    sign_scan(data.path)
    data.refresh()


def remove_frames(
    data: Dataset,
    by: str,
    days: int,
    why: str = "",
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> int:
    """Remove the frame files of a dataset, or those that an earlier removal left; returns the bytes that are free.

    Parameters
    ----------
    data
        The dataset; its lock is taken meanwhile.
    by, days, why
        Person, rule and reason, as the journal records them.
    progress, should_stop
        Called with the completed fraction, and polled for a stop request.

    Raises
    ------
    DatasetError
        When it is held, unfinished or in use, was altered, or a file cannot be removed. What is left is removed by the
        next call.
    """
    lock = Lock.take(data.path)
    try:
        data.refresh()
        if data.held is not None:
            raise DatasetError(f"{data.path.name} is held by {data.held.by}: {data.held.why}")
        if not data.finished:
            raise DatasetError(f"{data.path.name} is unfinished: continue its scan first.")
        files = [path for field in data.fields if (path := frames_file(data.path, field)).exists()]
        sizes = [path.stat().st_size for path in files]
        if data.removed is None:
            append_line(data, FramesRemoved(by, why, days, len(files), sum(sizes), _now()))
        for n, path in enumerate(files):
            if should_stop():
                raise DatasetError(f"The removal was stopped at {n} of {len(files)} files: start it again to finish.")
            with os_errors_as_dataset_errors(path):
                path.unlink()
            progress((n + 1) / len(files))
        with os_errors_as_dataset_errors(data.path):
            to_disk(data.path / FRAMES)
        return sum(sizes)
    finally:
        lock.release()


def _reason(why: str) -> str:
    """Return a reason on one line. Raises DatasetError without one."""
    if not (tidy := " ".join(why.split())):
        raise DatasetError("This needs a reason: say why.")
    return tidy


def _now() -> str:
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")


RULE = "retention.toml"


def read_rule(folder: Path) -> RetentionRule:
    """Return the setting of a data folder; frames are kept for ever without one, and if it cannot be read."""
    try:
        return required_rule(folder)
    except DatasetError:
        return RetentionRule()


def required_rule(folder: Path) -> RetentionRule:
    """Return the setting of a data folder, the default without one. Raises DatasetError when it cannot be read."""
    path = folder / RULE
    return decode(read_content(path), RetentionRule, path.name) if path.is_file() else RetentionRule()
