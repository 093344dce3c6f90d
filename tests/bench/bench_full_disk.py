"""Whether a disk that is full at any write costs more than the time to make space.

    python tests/bench/bench_full_disk.py [--cases N] [--from SEED] [--only WORD ...] [--quick]

True commands, and what the page does with uploads and settings, write to a tmpfs of 24 MB in a namespace of this
program's own, which needs no rights (unshare). For each kind of file some of its operations are chosen; the disk
becomes full

- filled: before one of them a ballast takes all space, and the system itself refuses what needs more;
- injected: this and all later operations raise ENOSPC, also new files, renames, fsync, and writes to preallocated
  frames, as a disk that copies on write or a network disk does. Where there are no namespaces, all cases are injected.

The user then has to read one sentence that says so, nothing half-written may have a final name (what is there is what
was there before or what is there at the end), and no part may be left. Then there is space again, and the same command
has to lead to what one makes that met no full disk. It exits with status 1 otherwise. --quick: one case of each kind.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tests.bench.harness import read_options, show
from tests.support.killed_programs import PLAN, Commands, Ended, content, left_behind
from tests.support.struck_command import BALLAST
from wafer_viewer.store.dataset.result import DRAWING

INSIDE = "WAFER_VIEWER_BENCH_DISK"
DISK_MB = 24
FULL, QUICK = 6, 1
NAME = "a.wafer"
FEATURE = """
[[features]]
name = "step"
nominal = 1.0
lower_limit = -9.0
upper_limit = 9.0
places = [
    {kind = "rectangle", points = [[585, 550], [600, 560]]},
    {kind = "rectangle", points = [[650, 550], [665, 560]]},
]
"""
CALL = "tests.support.full_disk_calls"
COMMANDS = {
    "scan": ("", ("scan", "plan.toml", "-o", f"DATA/{NAME}", "--yes")),
    "stitch": ("scan", ("stitch", f"DATA/{NAME}")),
    "export": ("stitch", ("convert", f"DATA/{NAME}", "DATA/surface.npz")),
    "fields": ("stitch", ("fields", f"DATA/{NAME}", "DATA/fields.ome.zarr")),
    "report": ("stitch", ("report", f"DATA/{NAME}", "-o", "DATA/report.html")),
    "compare": ("export", ("compare", f"DATA/{NAME}", "DATA/surface.npz", "-o", "difference", "--align", "none")),
    "verdict": ("stitch", ("measure", "verdict", f"DATA/{NAME}")),
    "compress": ("scan", ("compress", f"DATA/{NAME}")),
    "settings": ("", ("call", f"{CALL}:settings", "DATA")),
    "upload": ("", ("call", f"{CALL}:upload", "DATA")),
}
"""What is there before each command, and its words."""
KINDS = {
    "frame": ("/frames/",),
    "journal": ("/journal.jsonl",),
    "scan record": ("/scan.json",),
    "manifest": ("/manifest.json", "/manifests"),
    "audit log": ("audit.jsonl", "conformance-key", "/keys"),
    "verdict": ("/verdict.json",),
    "surface of a field": ("/surfaces",),
    "result of a comparison": ("/difference",),
    "mosaic chunk": ("/mosaic.zarr",),
    "poses": ("/poses",),
    "recipe, summary": ("/recipe.json", "/settled.json", "/surface.json"),
    "export": ("surface.npz", "fields.ome.zarr", "report.html"),
    "settings": ("session.json",),
    "lock": ("/lock",),
}
HEADER = "kind of write | cases | no sentence | half-written | left | does not continue"


@dataclass
class Row:
    """Outcome of the cases of a kind of write."""

    cases: int = 0
    silent: int = 0
    half: int = 0
    left: int = 0
    blocked: int = 0
    remarks: list[str] = field(default_factory=list[str])


class Bench:
    """Data folders that no full disk met, and the disk."""

    def __init__(self, folder: Path, commands: Commands) -> None:
        self.folder, self.commands, self.disk = folder, commands, folder / "disk" / "data"
        (folder / "plan.toml").write_text(PLAN.format(rows=1, cols=2, frames=8) + FEATURE)
        (folder / "nothing").mkdir()
        self._whole: dict[str, Path] = {"": folder / "nothing"}
        self.operations: dict[str, list[tuple[str, str]]] = {}
        self.statuses: dict[str, int] = {}

    def whole(self, command: str) -> Path:
        """Return the data folder after a command that met no full disk."""
        if command not in self._whole:
            self.lay_out(command)
            ended = self.run(command, ("none", 0))
            if ended.status not in (0, 1):
                raise SystemExit(f"{command} fails without a full disk: {ended.err}")
            self.operations[command], self.statuses[command] = self.commands.operations, ended.status
            self._whole[command] = Path(shutil.copytree(self.disk, self.folder / f"after-{command}"))
        return self._whole[command]

    def lay_out(self, command: str) -> None:
        """Put what is there before a command on the disk."""
        before = self.whole(COMMANDS[command][0])
        shutil.rmtree(self.disk, ignore_errors=True)
        shutil.copytree(before, self.disk)

    def run(self, command: str, how: tuple[str, int] | None = None) -> Ended:
        words = [word.replace("DATA", str(self.disk)) for word in COMMANDS[command][1]]
        return self.commands.run(*words, strike=None if how is None else (*how, self.disk))

    def try_full(self, command: str, how: str, at: int, row: Row) -> None:
        """Let the disk become full at an operation of a command, and make space again."""
        self.whole(command)
        self.lay_out(command)
        before, what = content(self.disk), " ".join(self.operations[command][at - 1])
        ended = self.run(command, (how, at))
        ballast = self.disk / BALLAST
        was_full = how != "fill" or ballast.exists()
        ballast.unlink(missing_ok=True)
        row.cases += was_full
        told = f"{command}, {how} at {what}"
        there, whole = content(self.disk), content(self.whole(command))
        is_done = ended.status == self.statuses[command] and _same(there, whole)
        if not (_is_sentence(ended) or (is_done and "Traceback" not in ended.err)):
            row.silent += 1
            row.remarks.append(f"{told}: status {ended.status}, {ended.err.strip()[-700:]!r}")
        partial = (n for n, mark in there.items() if mark not in (before.get(n), whole.get(n)))
        half = [name for name in partial if not name.endswith(DRAWING)]  # complete, and only there until the end
        if half:
            row.half += 1
            row.remarks.append(f"{told}: half-written {half[:3]}")
        if left := left_behind(self.disk):
            row.left += 1
            row.remarks.append(f"{told}: left {left[:3]}")
        again = self.run(command)
        if not self._is_whole(command, again):
            row.blocked += 1
            row.remarks.append(f"{told}: with space again status {again.status}, {again.err.strip()[-300:]!r}")

    def _is_whole(self, command: str, again: Ended) -> bool:
        if again.status not in (0, 1) and "has all its frames" not in again.err:
            return False
        there, whole = content(self.disk), content(self.whole(command))
        if command == "upload":  # each has a folder of its own
            there, whole = ({Path(name).name: mark for name, mark in of.items()} for of in (there, whole))
        checked = self.commands.run("check", self.disk / NAME) if (self.disk / NAME).exists() else Ended(0, "", "")
        return there == whole and checked.status == 0


def _same(there: dict[str, str], whole: dict[str, str]) -> bool:
    return sorted(there.values()) == sorted(whole.values())


def _is_sentence(ended: Ended) -> bool:
    """Tell whether a command ended with one sentence that the disk is full."""
    lines = ended.err.strip().splitlines()
    is_one = len(lines) == 1 and lines[0].startswith("wafer-viewer: ") and "the disk is full" in lines[0]
    return ended.status != 0 and is_one


def kind_of(command: str, path: str) -> str:
    """Return the kind of write of a path; the folders themselves count with what is made in them."""
    if command == "upload":
        return "upload"
    return next((kind for kind, parts in KINDS.items() if any(part in f"/{path}" for part in parts)), "folders")


def cases(
    bench: Bench, rng: random.Random, most: int, only: list[str], hows: tuple[str, ...]
) -> Iterator[tuple[str, str, str, int]]:
    """Yield kind, command, how and operation: for each kind of write and of operation the first, the last, others."""
    for command in COMMANDS:
        bench.whole(command)
        groups: dict[tuple[str, str], list[int]] = {}
        for n, (operation, path) in enumerate(bench.operations[command], 1):
            groups.setdefault((kind_of(command, path), operation), []).append(n)
        for (kind, operation), numbers in groups.items():
            if only and not any(word in f"{kind} {command}" for word in only):
                continue
            for how in hows:
                if how == "fill" and operation not in ("write", "allocate", "make"):
                    continue
                wanted = {numbers[0], numbers[-1], *rng.sample(numbers, min(most, len(numbers)))}
                for at in sorted(wanted)[: max(1, most // 2)]:
                    yield kind, command, how, at


def main() -> None:
    arguments = read_options(__doc__, cases=FULL, first_seed=1000, only=[])
    enter_namespace()
    with tempfile.TemporaryDirectory() as place, Commands(Path(place)) as commands:
        measure(Path(place), commands, arguments)


def enter_namespace() -> None:
    """Start this program again where it may mount a disk of its own, if the system lets it."""
    if INSIDE in os.environ:
        return
    try:
        able = subprocess.run(["unshare", "-rm", "true"], capture_output=True, check=False).returncode == 0
    except OSError:
        able = False
    os.environ[INSIDE] = "own" if able else "none"
    if able:
        os.execvp("unshare", ["unshare", "-rm", sys.executable, *sys.argv])


def measure(folder: Path, commands: Commands, arguments: argparse.Namespace) -> None:
    disk, has_own = folder / "disk", os.environ[INSIDE] == "own"
    disk.mkdir()
    if has_own:
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_MB}m", "none", str(disk)], check=True)
    rows, begun = dict[str, Row](), time.monotonic()
    bench, rng = Bench(folder, commands), random.Random(arguments.first_seed)
    hows = ("fill", "full") if has_own else ("full",)
    most = QUICK if arguments.quick else arguments.cases
    for kind, command, how, at in cases(bench, rng, most, arguments.only, hows):
        row = rows.setdefault(kind, Row())
        if arguments.quick and row.cases:
            continue
        bench.try_full(command, how, at, row)
    if has_own:
        subprocess.run(["umount", "-l", str(disk)], check=True)
    table = [(kind, row.cases, row.silent, row.half, row.left, row.blocked) for kind, row in rows.items()]
    table.append(("all", *(sum(row[n] for row in table) for n in range(1, 6))))
    where = f"a tmpfs of {DISK_MB} MB" if has_own else "injected alone"
    show(f"Full disk ({where}), {time.monotonic() - begun:.0f} s", HEADER, table)
    for row in rows.values():
        print(*row.remarks, sep="\n", end="\n" if row.remarks else "")
    sys.exit(any(table[-1][2:]))


if __name__ == "__main__":
    main()
