"""Commands of upkeep: the audit log, the state of the machine, a file for support, the glossary.

The signature of a command defines its flags, its docstring is its help.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from wafer_viewer.cli.arguments import DATA_FOLDER, File, Folder, OutFile, Text, Word, Words, config_of
from wafer_viewer.cli.output import print_audit, print_checks, print_datasets, print_json, print_lines, progress, warn


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
    from wafer_viewer.store.records.audit_log import recorded_actions

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
