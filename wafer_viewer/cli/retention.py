"""Commands for old frames: remove those of accepted datasets, hold others, end a hold.

The signature of a command defines its flags, its docstring is its help.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from wafer_viewer.cli.arguments import Count, DatasetFolder, Folder, Text
from wafer_viewer.cli.output import audit, print_lines, progress
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.atomic_files import size

if TYPE_CHECKING:
    from collections.abc import Callable

    from wafer_viewer.model.audit import Action
    from wafer_viewer.session.files.old_frames import OldFrames
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.dataset.scan_record import RetentionLine

    LineOf = Callable[[Dataset, str, str], RetentionLine]


def tidy(
    folder: Folder,
    days: Count = None,
    dry_run: bool = False,
    yes: bool = False,
    by: Text = None,
    reason: str = "",
) -> int:
    """Remove the frames of datasets with the verdict pass that are old enough; asks before. Status 1 if there are none.

    Held datasets are never touched. Records, journals, surfaces, results and verdicts stay, and check says who removed
    the frames and when. A removal that was broken off is finished by the next one.

    Args:
        folder: A data folder.
        days: Days after the scan; as frames_days in retention.toml of the folder says by default, and never without it.
        dry_run: Only list the datasets with the sizes of their frames.
        yes: Do not ask.
        by: Engineer who removes them, where people are listed; the account without it.
        reason: Reason, for the record; needed where people are listed.
    """
    from wafer_viewer.session.core.signing_in import acting_person, name_of, require_reason
    from wafer_viewer.session.files.old_frames import old_frames, rule_of
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.dataset.retention import remove_frames

    rule = rule_of(folder, days)
    found = old_frames(folder, rule)
    if not found:
        print(f"No frames in {folder} may be removed.")
        return 1
    print_lines(_lines(found))
    if dry_run:
        return 0
    person = acting_person(folder, "Frames removed", by)
    require_reason(person, reason)
    _confirm(found, yes)
    why = " ".join(reason.split())
    for old in found:
        with progress(old.path.name) as tell:
            freed = remove_frames(Dataset.open(old.path), name_of(person, by), rule.frames_days or 0, why, tell)
        detail = f"{size(freed)} freed" + (f", why: {why}" if why else "")
        audit(folder, "Frames removed", old.path.name, detail, by=name_of(person, by))
    print(f"{size(sum(old.n_bytes for old in found))} freed.")
    return 0


def hold(dataset: DatasetFolder, reason: str, by: Text = None) -> None:
    """Keep the frames of a dataset, however old they are.

    Args:
        dataset: The dataset.
        reason: Reason, which is recorded.
        by: Who holds it, where people are listed; the account without it.
    """
    from wafer_viewer.store.dataset.retention import hold_line

    _change(dataset, "Frames held", reason, by, hold_line)
    print(f"{dataset.name} is held.")


def unhold(dataset: DatasetFolder, reason: str, by: Text = None) -> None:
    """End the hold of a dataset.

    Args:
        dataset: The dataset.
        reason: Reason, which is recorded.
        by: Engineer who ends it, where people are listed; the account without it.
    """
    from wafer_viewer.store.dataset.retention import hold_end_line

    _change(dataset, "Hold ended", reason, by, hold_end_line)
    print(f"{dataset.name} is no longer held.")


def _change(dataset: Path, action: Action, reason: str, by: str | None, line_of: LineOf) -> None:
    from wafer_viewer.session.core.signing_in import acting_person, name_of
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.dataset.lock import Lock
    from wafer_viewer.store.dataset.retention import append_line

    data, folder = Dataset.open(dataset), dataset.absolute().parent
    name = name_of(acting_person(folder, action, by), by)
    lock = Lock.take(dataset)
    try:
        data.refresh()
        append_line(data, line_of(data, name, reason))
    finally:
        lock.release()
    audit(folder, action, dataset.name, f"why: {' '.join(reason.split())}", by=name)


def _lines(found: Sequence[OldFrames]) -> list[str]:
    width = max(len(old.path.name) for old in found)
    told = [
        f"{old.path.name:<{width}}  {size(old.n_bytes):>9}  "
        + ("removal was broken off" if old.begun else f"kept until {old.until}")
        for old in found
    ]
    total = f"{len(found)} dataset{'s' if len(found) > 1 else ''}, {size(sum(old.n_bytes for old in found))}"
    return [*told, total]


def _confirm(found: Sequence[OldFrames], yes: bool) -> None:
    """Ask whether the frames are to be removed. Raises DatasetError if not."""
    if yes:
        return
    if not sys.stdin.isatty():
        raise DatasetError("Nothing was removed: there is no terminal to ask at, so give --yes.")
    answer = input(f"Remove the frames of {len(found)} dataset{'s' if len(found) > 1 else ''}? Type yes: ")
    if answer.strip().lower() != "yes":
        raise DatasetError("Nothing was removed.")
