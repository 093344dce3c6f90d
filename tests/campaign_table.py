"""Renew the table of the campaigns, assets/docs/validation/campaigns.md, from the results of a run.

    python tests/campaign_table.py RESULTS.xml ...

RESULTS.xml are JUnit files of pytest with the attribute `file` (`-o junit_family=xunit1`). A campaign is the tests of
one file. One with a failure, or of which nothing ran, keeps its line; the line of a file that is gone is dropped.
"""

from __future__ import annotations

import ast
import os
import platform
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping
from datetime import date
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "assets/docs/validation/campaigns.md"
HEAD = ("| campaign | passed last | commit | machine | tests | minutes |", "|---|---|---|---|---|---|")


def results(files: Iterable[Path]) -> dict[str, list[ElementTree.Element]]:
    """Return the cases of each test file."""
    cases: dict[str, list[ElementTree.Element]] = defaultdict(list)
    for file in files:
        for case in ElementTree.parse(file).iter("testcase"):
            cases[case.attrib["file"]].append(case)
    return cases


def failed(cases: Iterable[ElementTree.Element]) -> bool:
    return any(case.find(fault) is not None for case in cases for fault in ("failure", "error"))


def line(file: str, cases: list[ElementTree.Element], when: str, commit: str, machine: str) -> str:
    """Return the row of a campaign that passed."""
    skipped = sum(case.find("skipped") is not None for case in cases)
    count = f"{len(cases) - skipped}" + (f", {skipped} skipped" if skipped else "")
    minutes = sum(float(case.attrib["time"]) for case in cases) / 60
    return f"| {subject(ROOT / file)} (`{file}`) | {when} | {commit} | {machine} | {count} | {minutes:.1f} |"


def subject(file: Path) -> str:
    """Return the first line of a test file, without what follows a colon or its full stop, or else its name."""
    told = (
        ast.get_docstring(ast.parse(file.read_text())) or file.stem.removeprefix("test_").replace("_", " ").capitalize()
    )
    return told.splitlines()[0].split(":")[0].rstrip(".")


def renewed(page: str, passed: Mapping[str, str]) -> str:
    """Return the page with the lines of campaigns by file; older ones stay as long as their file is there."""
    above, _, rest = page.partition("\n".join(HEAD) + "\n")
    rows, below = [], rest.splitlines()
    while below and below[0].startswith("|"):
        rows.append(below.pop(0))
    lines = {row.partition("(`")[2].partition("`)")[0]: row for row in rows} | dict(passed)
    kept = [lines[file] for file in sorted(lines) if (ROOT / file).exists()]
    return above + "\n".join((*HEAD, *kept, *below)) + "\n"


def commit() -> str:
    """Return the commit of the checkout, and say so where it was changed since."""
    git = ["git", "-C", str(ROOT)]
    head = subprocess.run([*git, "rev-parse", "--short=8", "HEAD"], capture_output=True, text=True).stdout.strip()
    other_files = [".", f":(exclude){TABLE.relative_to(ROOT)}"]
    changed = subprocess.run([*git, "status", "--porcelain", "--", *other_files], capture_output=True).stdout
    return f"{head or 'no git'}{', changed' if changed else ''}"


def machine() -> str:
    """Return the processor and the number of its cores."""
    info = Path("/proc/cpuinfo")
    models = [
        row.partition(":")[2].strip()
        for row in (info.read_text().splitlines() if info.exists() else ())
        if row.startswith("model name")
    ]
    return f"{models[0] if models else platform.machine()}, {os.cpu_count()} cores"


def main(files: Iterable[str]) -> int:
    """Renew the page; status 1 when a campaign failed or none ran."""
    cases = results(map(Path, files))
    wrong = [file for file in sorted(cases) if failed(cases[file])]
    ran = [file for file in cases if any(case.find("skipped") is None for case in cases[file])]
    about = date.today().isoformat(), commit(), machine()
    TABLE.write_text(
        renewed(TABLE.read_text(), {file: line(file, cases[file], *about) for file in ran if file not in wrong})
    )
    print(f"{len(set(ran) - set(wrong))} campaigns passed.", *(f"Failed: {file}" for file in wrong), sep="\n")
    return 1 if wrong or not ran else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
