"""Whether SIGKILL at any moment loses or alters anything, or leaves anything that is in the way.

    python tests/bench/bench_kills.py [--kills N] [--from SEED] [--only WORD ...] [--quick]

The true commands of the program, and the true session with its processes, on a small simulated dataset. A kill comes

- command: before a random write, rename, wait or new file of the command, which does all work in its process;
- leader, worker: at a random moment of a command with two workers of its own, which is leader and scheduler in one;
- viewer, rig process, session's worker, session's host: at a random moment of a session, which the host serves as
  leader and scheduler.

After each kill the same command runs again, or the session is started again and continues, as a person would do. At
the end of a few kills of the same dataset it is compared with one that nothing happened to: frames by pixels and z,
surfaces, poses, mosaics, results and exports by their bytes; `check` has to pass; no lock, no half-written file and no
process may be left. What a session says must be one sentence. Its frames are compared with themselves, before and after
each kill, because the noise of its rig is another in each scan, and its surfaces with one of the same frames that
nothing happened to. It exits with status 1 if anything is lost, differs or is in the way. --quick: 20 kills, of
commands alone.
"""

from __future__ import annotations

import random
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from tests.bench.harness import read_options, show
from tests.support.killed_programs import (
    PLAN,
    Commands,
    Tally,
    age_parts,
    content,
    frames,
    kill,
    left_behind,
    wait_for,
    workers_below,
)
from tests.support.killed_session import SessionProgram
from tests.support.session_program import COLS as SESSION_COLS
from tests.support.session_program import DONE
from tests.support.session_program import FRAMES as SESSION_FRAMES
from wafer_viewer.session.session_restore import KEPT_IN
from wafer_viewer.store.dataset.lock import Lock

FULL, QUICK = 232, 20
ROWS, COLS, FRAMES = 2, 2, 8
A_CHAIN = 5
"""Kills of one dataset before it is brought to its end and compared."""
RETRY_S = 3.0
"""Time in s after which a person tries again."""
NAME = "a.wafer"
HEADER = ("process", "stage", "kills", "lost", "differ", "blocked")


@dataclass(frozen=True)
class Stage:
    """A command, what is there before it, and the paths whose operations belong to it."""

    words: tuple[str, ...]
    after: str
    belongs: Callable[[str], bool] = lambda _: True


STAGES = {
    "scan": Stage(("scan", "plan.toml", "-o", f"DATA/{NAME}", "--yes"), ""),
    "heights": Stage(
        ("stitch", f"DATA/{NAME}"), "scan", lambda path: "surfaces" in path or path.endswith(("recipe.json", "lock"))
    ),
    "stitch": Stage(("stitch", f"DATA/{NAME}"), "scan", lambda path: "surfaces" not in path and "results" in path),
    "results": Stage(("compare", f"DATA/{NAME}", "DATA/surface.npz", "-o", "difference", "--align", "none"), "export"),
    "export": Stage(("convert", f"DATA/{NAME}", "DATA/surface.npz"), "stitch"),
    "export of fields": Stage(("fields", f"DATA/{NAME}", "DATA/fields.ome.zarr"), "stitch"),
    "report": Stage(("report", f"DATA/{NAME}", "-o", "DATA/report.html"), "stitch"),
}
SHARES = {
    ("command", "scan"): 40,
    ("command", "heights"): 20,
    ("command", "stitch"): 30,
    ("command", "results"): 20,
    ("command", "export"): 10,
    ("command", "export of fields"): 10,
    ("command", "report"): 10,
    ("leader", "heights"): 6,
    ("leader", "stitch"): 6,
    ("worker", "heights"): 6,
    ("worker", "stitch"): 6,
    ("rig process", "scan"): 20,
    ("session's worker", "scan"): 4,
    ("session's worker", "heights"): 8,
    ("session's worker", "stitch"): 8,
    ("session's host", "heights"): 4,
    ("session's host", "stitch"): 4,
    ("viewer", "scan"): 8,
    ("viewer", "heights"): 6,
    ("viewer", "stitch"): 6,
}
"""Kills of a full run by process and stage."""


class Bench:
    """Folder of the benchmark: datasets that nothing happened to, and a command runner."""

    def __init__(self, folder: Path, commands: Commands, rng: random.Random) -> None:
        self.folder, self.commands, self.rng = folder, commands, rng
        (folder / "plan.toml").write_text(PLAN.format(rows=ROWS, cols=COLS, frames=FRAMES))
        self._undisturbed: dict[str, Path] = {"": folder / "nothing"}
        self._undisturbed[""].mkdir()
        self.operations: dict[str, list[tuple[str, str]]] = {}
        self.took_s: dict[str, float] = {}

    def lay_out(self, stage: str) -> Path:
        """Make the data folder what it is before a stage, and return it; its path is always the same."""
        before, data = self.undisturbed(STAGES[stage].after), self.folder / "data"
        shutil.rmtree(data, ignore_errors=True)
        return Path(shutil.copytree(before, data))

    def undisturbed(self, stage: str) -> Path:
        """Return a copy of the data folder after a stage that nothing happened to."""
        if stage not in self._undisturbed:
            data, begun = self.lay_out(stage), time.monotonic()
            ended = self.commands.run(*self.words(stage, data), strike=("none", 0, data))
            if ended.status:
                raise SystemExit(f"{stage} fails undisturbed: {ended.err}")
            self.took_s[stage] = time.monotonic() - begun
            self.operations[stage] = self.commands.operations
            self._undisturbed[stage] = Path(shutil.copytree(data, self.folder / f"after-{stage}"))
        return self._undisturbed[stage]

    def words(self, stage: str, data: Path) -> list[str]:
        return [word.replace("DATA", str(data)) for word in STAGES[stage].words]

    def bring_to_end(self, stage: str, data: Path, tally: Tally) -> None:
        """Run the command of a stage again, undisturbed and a quarter of an hour later, and judge what is there."""
        age_parts(data)
        words = self.words(stage, data)
        ended = self.commands.run(*words)
        if ended.status and not is_done(ended.err):
            first = ended.err.strip()
            time.sleep(RETRY_S)
            ended = self.commands.run(*words)
            tally.block(f"{stage}: {first} | {RETRY_S:g} s later: {ended.err.strip() or 'it works'}")
        self.judge(stage, data, tally)

    def judge(self, stage: str, data: Path, tally: Tally) -> None:
        """Compare a data folder with one that nothing happened to."""
        whole, there = content(self.undisturbed(stage)), content(data)
        missing = [name for name in whole if name not in there]
        differ = [name for name in there if whole.get(name) != there[name]]
        tally.lost += len(missing)
        tally.differ += len(differ)
        if missing or differ:
            tally.remarks.append(f"{stage}: missing {missing[:4]}, different {differ[:4]}")
        self.require_whole(data, tally)

    def require_whole(self, data: Path, tally: Tally) -> None:
        """Require that `check` passes and nothing is left once what is dead was dead for a quarter of an hour."""
        for dataset in data.glob("*.wafer"):
            checked = self.commands.run("check", dataset)
            if checked.status:
                tally.block(f"check: {checked.out} {checked.err}")
        age_parts(data)
        for folder in (data / KEPT_IN, *data.glob("*.wafer")):
            if folder.is_dir():
                Lock.take(folder).release()  # as the viewer and the next command do, which remove what is dead
        if left := left_behind(data):
            tally.block(f"left: {left}")

    def orphans(self, orphans: tuple[str, ...], tally: Tally) -> None:
        """Count processes that go on without the one that was killed."""
        if orphans:
            tally.block(f"still running: {orphans}")

    def chains(self, stage: str, n_kills: int) -> Iterator[tuple[Path, int]]:
        """Yield the data folder as it is before a stage, and how often it is disturbed."""
        self.undisturbed(stage)
        while n_kills > 0:
            yield self.lay_out(stage), min(A_CHAIN, n_kills)
            n_kills -= A_CHAIN


def kill_commands(bench: Bench, stage: str, tally: Tally, n_kills: int) -> None:
    """Kill a command before one of its operations, again and again."""
    for data, n in bench.chains(stage, n_kills):
        wanted, kept = tally.kills + n, dict[str, str]()
        for _ in range(3 * n):
            ended = bench.commands.run(*bench.words(stage, data), strike=("kill", _operation(bench, stage), data))
            bench.orphans(ended.orphans, tally)
            tally.kills += ended.killed
            if ended.status > 0 and not is_done(ended.err):
                tally.block(f"{stage}: {ended.err.strip()}")
                time.sleep(RETRY_S)
            if stage == "scan":
                kept = _compared(kept, frames(data / NAME), tally)
            if tally.kills == wanted:
                break
            if ended.status == 0 or is_done(ended.err):  # the strike came too late
                bench.judge(stage, data, tally)
                bench.lay_out(stage)
                kept = {}
        bench.bring_to_end(stage, data, tally)


def is_done(told: str) -> bool:
    """Tell whether a command refuses because there is nothing left to do: the kill came at its very end."""
    return "has all its frames" in told or "exists already" in told


def _operation(bench: Bench, stage: str) -> int:
    """Return the number of a random operation of a stage: each kind of operation on each file counts alike."""
    named = [(n, of) for n, of in enumerate(bench.operations[stage], 1) if STAGES[stage].belongs(of[1])]
    kind = bench.rng.choice(sorted({of for _, of in named}))
    return bench.rng.choice([n for n, of in named if of == kind])


def _compared(before: dict[str, str], now: dict[str, str], tally: Tally) -> dict[str, str]:
    """Count the frames that were there before a kill and are not, or are others, and return those that are."""
    tally.lost += len(before.keys() - now.keys())
    tally.differ += sum(now[shot] != before[shot] for shot in before.keys() & now.keys())
    return now


def kill_in_crew(bench: Bench, stage: str, tally: Tally, n_kills: int, process: str) -> None:
    """Kill the leader or a worker of a command with two workers."""
    for data, n in bench.chains(stage, n_kills):
        for _ in range(3 * n):
            if tally.kills >= n_kills:
                break
            pid = bench.commands.begin(*bench.words(stage, data), "--workers", "2")
            if wait_for(_reached(stage, data / NAME / "results" / "default", time.time()), pid):
                time.sleep(bench.rng.uniform(0.0, 0.5 * bench.took_s[stage]))
                victims = [pid] if process == "leader" else workers_below(pid)
                tally.kills += bool(victims) and kill(bench.rng.choice(victims))
            ended = bench.commands.end()
            bench.orphans(ended.orphans, tally)
            if ended.status > 0:
                tally.block(f"{process}, {stage}: {ended.err.strip()}")
            if ended.status == 0:  # a worker was killed, or the strike came too late
                bench.judge(stage, data, tally)
                bench.lay_out(stage)
        bench.bring_to_end(stage, data, tally)


def _reached(stage: str, result: Path, begun_at: float, rows: int = ROWS, cols: int = COLS) -> Callable[[], bool]:
    """Tell whether a stage has begun: the surface of a field, or of each field, was written since then."""

    def is_new(path: Path) -> bool:
        with suppress(OSError):
            return path.stat().st_mtime >= begun_at
        return False

    if stage == "heights":
        return lambda: any(is_new(path) for path in (result / "surfaces").glob("*.npz"))
    names = [f"r{row:04d}c{col:04d}.npz" for row in range(rows) for col in range(cols)]
    return lambda: all(is_new(result / "surfaces" / name) for name in names)


# ---------------------------------------------------------------------------------------------------------- a session


SHARED, WHOLE = "a", "undisturbed"
"""Name of the dataset that a session keeps, and of its result that nothing happened to."""


class SessionBench:
    """A session with a data folder of its own; started again after each kill of itself."""

    def __init__(self, bench: Bench, tally: Tally) -> None:
        self.bench, self.tally, self.rng = bench, tally, bench.rng
        self.data = Path(tempfile.mkdtemp(dir=bench.folder, prefix="session-"))
        self.program = SessionProgram(self.data)
        self._timed("scan", SHARED)  # the first of each compiles
        self._timed("surface", SHARED, WHOLE)
        self.scan_s, self.surface_s = self._timed("scan", "timed"), self._timed("surface", SHARED, WHOLE)

    def _timed(self, *words: str) -> float:
        begun = time.monotonic()
        if (answer := self.program.do(*words)) != DONE:
            raise SystemExit(f"{words} fails undisturbed: {answer}")
        return time.monotonic() - begun

    def strike(self, victim: str) -> None:
        """Kill the session or one of its processes."""
        match victim:
            case "viewer":
                self.bench.orphans(self.program.kill(), self.tally)
                self.tally.kills += 1
                self.program = SessionProgram(self.data)
            case "rig process":
                self.tally.kills += kill(self.program.pids["rig"])
            case "session's host":
                self.tally.kills += kill(self.program.pids["compute"])
            case _:
                workers = workers_below(self.program.pids["compute"])
                self.tally.kills += bool(workers) and kill(self.rng.choice(workers))

    def disturb(self, victim: str, words: tuple[str, ...], at: Callable[[], bool], most_s: float) -> str | None:
        """Begin to do something and kill at a random moment of it; return the answer that follows, if one does."""
        if (answer := self.program.begin(*words)) is not None:
            return answer
        if not wait_for(at, self.program.process.pid):
            return self.program.answer()
        if (answer := self.program.answer(self.rng.uniform(0.0, most_s))) is not None:
            return answer  # it was over before
        self.strike(victim)
        return None if victim == "viewer" else self.program.answer()

    def finish(self, *words: str) -> None:
        """Do something to its end, as a person does who tries again."""
        if (answer := self.program.do(*words)) != DONE:
            self.tally.block(f"{words}: {answer}")

    def read(self, answer: str | None, *, may_fail: bool) -> None:
        """Judge what a person reads after a kill: nothing, or one sentence where the work had to end."""
        if answer in (None, DONE):
            return
        if (remark := f"a person reads: {answer}") not in self.tally.remarks:
            self.tally.remarks.append(remark)
        if not may_fail or "\n" in answer or not answer.endswith(".") or "Traceback" in answer:
            self.tally.block(f"no sentence: {answer}")

    def close(self) -> None:
        """End the session, and require that nothing of it is left."""
        self.bench.orphans(self.program.close(), self.tally)
        self.bench.require_whole(self.data, self.tally)
        shutil.rmtree(self.data, ignore_errors=True)


@contextmanager
def _session(bench: Bench, tally: Tally) -> Generator[SessionBench]:
    session = SessionBench(bench, tally)
    try:
        yield session
    finally:
        session.close()


def kill_during_scan(session: SessionBench, victim: str, n_kills: int) -> None:
    """Kill in scans, each up to three times before it is continued to its end."""
    tally = session.tally
    for number in range(3 * n_kills):
        if tally.kills >= n_kills:
            break
        name = f"scan-{number}"
        dataset, kept = session.data / f"{name}.wafer", dict[str, str]()
        for _ in range(3):
            answer = session.disturb(victim, ("scan", name), lambda: True, 0.6 * session.scan_s)
            session.read(answer, may_fail=victim == "rig process")
            kept = _compared(kept, frames(dataset), tally)
            if answer == DONE or tally.kills >= n_kills:
                break
        session.finish("scan", name)
        tally.lost += SESSION_COLS * SESSION_FRAMES - len(_compared(kept, frames(dataset), tally))


def kill_during_surface(session: SessionBench, victim: str, stage: str, n_kills: int) -> None:
    """Kill while a surface is made, from its first field or from its last one on."""
    tally = session.tally
    for number in range(3 * n_kills):
        if tally.kills >= n_kills:
            break
        words = ("surface", SHARED, f"result-{number}")
        result = session.data / f"{SHARED}.wafer" / "results" / words[-1]
        at = (lambda: True) if stage == "heights" else _reached(stage, result, time.time(), 1, SESSION_COLS)
        before = frames(session.data / f"{SHARED}.wafer")
        answer = session.disturb(victim, words, at, 0.5 * session.surface_s)
        session.read(answer, may_fail=False)
        if victim == "viewer" or answer != DONE:
            session.finish(*words)
        _compared(before, frames(session.data / f"{SHARED}.wafer"), tally)
        _same_results(session.data, WHOLE, words[-1], tally)


def _same_results(data: Path, one: str, other: str, tally: Tally) -> None:
    """Compare surfaces, poses and mosaics of two results of the same frames."""
    there, parts = content(data), ("/surfaces/", "/mosaic.zarr/", "/poses.npz")
    first, second = (
        {
            path.split(f"/{name}/", 1)[1]: mark
            for path, mark in there.items()
            if f"/results/{name}/" in path and any(part in path for part in parts)
        }
        for name in (one, other)
    )
    if not first:
        raise SystemExit(f"{one} holds nothing to compare with.")
    missing = sorted(first.keys() - second.keys())
    differ = [path for path in second if first.get(path) != second[path]]
    tally.lost += len(missing)
    tally.differ += len(differ)
    if missing or differ:
        tally.remarks.append(f"{other}: missing {missing[:4]}, different {differ[:4]}")


# ----------------------------------------------------------------------------------------------------------- the table


def strike(bench: Bench, process: str, stage: str, n_kills: int) -> Tally:
    """Kill a process in a stage some times, and return what came of it."""
    tally = Tally()
    match process:
        case "command":
            kill_commands(bench, stage, tally, n_kills)
        case "viewer" | "rig process" | "session's worker" | "session's host":
            with _session(bench, tally) as session:
                if stage == "scan":
                    kill_during_scan(session, process, n_kills)
                else:
                    kill_during_surface(session, process, stage, n_kills)
        case _:
            kill_in_crew(bench, stage, tally, n_kills, process)
    return tally


def shares(n_kills: int, only: list[str], *, quick: bool) -> dict[tuple[str, str], int]:
    """Return how many kills each process gets in each stage, together `n_kills`."""
    wanted = {
        key: share
        for key, share in SHARES.items()
        if (not quick or key[0] == "command") and (not only or any(word in " ".join(key) for word in only))
    }
    if only:
        return wanted
    whole, given, shared = sum(wanted.values()), 0, 0
    counts = dict[tuple[str, str], int]()
    for key, share in wanted.items():
        shared += share
        counts[key] = round(n_kills * shared / whole) - given
        given += counts[key]
    return counts


def main() -> None:
    arguments = read_options(__doc__, kills=int, first_seed=1000, only=[])
    n_kills = arguments.kills or (QUICK if arguments.quick else FULL)
    rows, tallies, begun = [], list[Tally](), time.monotonic()
    with tempfile.TemporaryDirectory() as place, Commands(Path(place)) as commands:
        bench = Bench(Path(place), commands, random.Random(arguments.first_seed))
        for (process, stage), n in shares(n_kills, arguments.only, quick=arguments.quick).items():
            if not n:
                continue
            tally = strike(bench, process, stage, n)
            tallies.append(tally)
            rows.append((process, stage, tally.kills, tally.lost, tally.differ, tally.blocked))
            print(*rows[-1], *tally.remarks, sep="; ", file=sys.stderr, flush=True)
    rows.append(("all", "", *(sum(row[k] for row in rows) for k in range(2, 6))))
    show(f"SIGKILL at random, {time.monotonic() - begun:.0f} s", HEADER, rows)
    for tally in tallies:
        print(*tally.remarks, sep="\n", end="\n" if tally.remarks else "")
    sys.exit(any(rows[-1][3:]))


if __name__ == "__main__":
    main()
