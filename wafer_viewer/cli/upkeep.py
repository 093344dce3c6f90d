"""Commands of upkeep: audit log, people, old frames, state of the machine, a file for support, the glossary.

The signature of a command defines its flags, its docstring is its help.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from wafer_viewer.cli.arguments import (
    DATA_FOLDER,
    Count,
    DatasetFolder,
    File,
    Folder,
    OutFile,
    Text,
    Word,
    Words,
    config_of,
)
from wafer_viewer.cli.output import (
    audit,
    print_audit,
    print_checks,
    print_datasets,
    print_json,
    print_lines,
    progress,
    warn,
)
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.roles import Role
from wafer_viewer.store.io.atomic_files import size

# ------------------------------------------------------------------------------------------------------------ retention


if TYPE_CHECKING:
    from collections.abc import Callable

    from wafer_viewer.model.roles import Action
    from wafer_viewer.session.files.frame_check import OldFrames
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
    from wafer_viewer.session.core.people import acting_person, name_of, require_reason
    from wafer_viewer.session.files.frame_check import old_frames, rule_of
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
    from wafer_viewer.session.core.people import acting_person, name_of
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


# --------------------------------------------------------------------------------------------------------------- people


PersonName = Annotated[Positional[str], arg(metavar="NAME")]


def people_add(name: PersonName, role: Role, data: Path = DATA_FOLDER, by: Text = None, reason: str = "") -> None:
    """List a person who may sign in, or give one another role and password; the password is typed twice.

    Without anybody listed, everyone at the station is an engineer. The first person must be one.

    Args:
        name: Name of the person, as it stands in the audit log.
        role: operator runs released jobs; engineer may do everything.
        data: Folder of the datasets.
        by: Engineer who lists the person, once somebody is listed.
        reason: Reason, for the audit log; needed once somebody is listed.
    """
    from wafer_viewer.session.core.people import acting_person, add_person, name_of, new_password, require_reason

    folder = data.expanduser()
    actor = acting_person(folder, "Person added", by)
    require_reason(actor, reason)
    person = add_person(folder, name, role, new_password(name))
    audit(folder, "Person added", person.name, _detail(role, reason), by=name_of(actor, by))
    print(f"{person.name} may sign in as {role}.")


def people_remove(name: PersonName, data: Path = DATA_FOLDER, by: Text = None, reason: str = "") -> None:
    """Remove a person; when the last one has gone, everyone at the station is an engineer again.

    Args:
        name: Name of the person.
        data: Folder of the datasets.
        by: Engineer who removes the person.
        reason: Reason, for the audit log.
    """
    from wafer_viewer.session.core.people import acting_person, name_of, remove_person, require_reason

    folder = data.expanduser()
    actor = acting_person(folder, "Person removed", by)
    require_reason(actor, reason)
    remove_person(folder, name)
    audit(folder, "Person removed", name, _detail("", reason), by=name_of(actor, by))
    print(f"{name} may no longer sign in.")


def people_list(data: Path = DATA_FOLDER) -> int:
    """List who may sign in; status 1 when nobody is listed, and everyone at the station is an engineer.

    Args:
        data: Folder of the datasets.
    """
    from wafer_viewer.session.core.people import listed_people

    people = listed_people(data.expanduser())
    print_lines(f"{person.name}: {person.role}" for person in people)
    if not people:
        print("Nobody is listed: everyone at the station is an engineer.")
    return 0 if people else 1


def _detail(role: str, reason: str) -> str:
    return ", ".join(f"{name}: {value}" for name, value in (("role", role), ("why", " ".join(reason.split()))) if value)


# --------------------------------------------------------------------------------------------------------------- upkeep


def find(folder: Folder, words: Words = (), json: bool = False) -> int:
    """Find datasets by lot, wafer, product, verdict, date or name, the newest first; status 1 when there is none.

    Args:
        folder: A data folder.
        words: Each must be part of the name, lot, wafer, product, verdict or date, such as lot42 fail 2026-03.
        json: Print JSON instead of a table.
    """
    from wafer_viewer.session.core.dataset_library import datasets_in

    found = datasets_in(folder, " ".join(words))
    print_json([{**asdict(entry), "path": str(entry.path)} for entry in found]) if json else print_datasets(found)
    return 0 if found else 1


def log(folder: Folder, of: Text = None, json: bool = False) -> int:
    """List who scanned, released, changed, judged and signed what in a data folder; status 1 when nothing is recorded.

    Raises an error when an entry was changed, removed or inserted.

    Args:
        folder: A data folder.
        of: Only what was done to this dataset or job.
        json: Print JSON instead of a table.
    """
    from wafer_viewer.store.records.signed_log import recorded_actions

    entries = recorded_actions(folder, of or "")
    print_json(entries) if json else print_audit(entries)
    return 0 if entries else 1


def doctor(rig: File = None, data: Path = DATA_FOLDER, move: bool = False) -> int:
    """List what this machine has and lacks, and how to fix it; status 1 when something is lacking.

    Also connects to each device of the rig, says what answers, and compares the counts of the pulse box with the stage.
    It compiles the numerical kernels for this machine, if they are not yet, so that nothing waits for them later.

    Args:
        rig: RIG.toml of the instrument; the virtual rig without it.
        data: Folder of the datasets.
        move: Home the stage, move each axis by a mm at most and over its index mark, if it has one, and back.
    """
    from wafer_viewer.session.core.environment_check import check_environment
    from wafer_viewer.session.surface.kernel_build import PARTS, compile_missing, load_all

    def compile_kernels() -> None:
        compile_missing(PARTS, lambda progress: warn(f"{progress.words}."))
        load_all()

    return print_checks(check_environment(config_of(rig), data.expanduser(), compile_kernels, move=move))


def bundle(out: OutFile = None, rig: File = None, data: Path = DATA_FOLDER, dataset: File = None) -> None:
    """Write a support file: what this machine has, versions, settings of the rig, the log; no pictures, no secrets.

    Keys, tokens and passwords are left out, and the names of account, home folder and machine are replaced. Look into
    it before you send it: it is a .zip of texts.

    Args:
        out: The file, .zip; wafer-viewer-support.zip without it.
        rig: RIG.toml of the instrument; the virtual rig without it.
        data: Folder of the datasets.
        dataset: A dataset whose records are included: its job with lot and wafer, its journal, its results.
    """
    from wafer_viewer.session.core.environment_check import check_environment
    from wafer_viewer.session.files.support_bundle import require_zip, write_bundle

    path, config = require_zip(out or Path("wafer-viewer-support.zip")), config_of(rig)
    with progress("Support file"):
        held = write_bundle(path, check_environment(config, data.expanduser(), lambda: None), config, dataset)
    print_lines((f"{path}:", *(f"  {name}" for name in held)))


def docs(build: bool = False) -> None:
    """Open the documentation in the browser of this machine; it needs no network.

    Args:
        build: Build the site instead, in a checkout; a warning ends it with status 2.
    """
    import webbrowser

    from wafer_viewer.session.files.documentation import build_site, first_page

    if build:
        build_site()
    address = first_page().as_uri()
    print(address)
    if not build:
        webbrowser.open(address)


def glossary(word: Word = "") -> int:
    """Print what the words of this program mean; status 1 when it does not know the word.

    Args:
        word: Only the terms that contain this; all without it.
    """
    from wafer_viewer.model.glossary import find_terms

    found = find_terms(word)
    width = max((len(term.word) for term in found), default=0)
    for term in found:
        source = f" [{term.source}]" if term.source else ""
        print(f"{term.word:<{width}}  {term.meaning}{source}")
    if not found:
        warn(f"The glossary has no term with '{word}': wafer-viewer glossary lists all of them.")
    return int(not found)
