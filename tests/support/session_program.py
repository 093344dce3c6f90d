"""The true session in a process of its own: executes what is asked line by line, and answers with its outcome.

    python -m tests.support.session_program DATA

A line is a JSON list: the name of a function below and its words. So are the answers: the numbers of the processes that
host the rig and the compute cluster, and ``begun``, then ``done`` or the sentence that prevented it.
"""

from __future__ import annotations

import json
import multiprocessing
import sys
from collections.abc import Callable
from pathlib import Path

from tests.session.conftest import small_job
from tests.support.patience import PATIENCE_S
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.session.session import Session
from wafer_viewer.session.state.snapshot import Snapshot

BEGUN, DONE, READY, END = "begun", "done", "ready", "end"
COLS, FRAMES = 2, 12


def scan(session: Session, name: str) -> None:
    """Scan a small job, or continue the scan of that name; end when its surface is complete, as on the page."""
    path = session.snapshot.data_folder / f"{name}.wafer"
    if (path / "scan.json").exists():
        _open(session, name)
        session.jobs.confirm().result(PATIENCE_S)
        if session.snapshot.dataset is not None and not session.snapshot.dataset.finished:
            session.continue_scan().result(PATIENCE_S)
    else:
        session.jobs.confirm().result(PATIENCE_S)
        session.edit_job(small_job(cols=COLS, n_frames=FRAMES, z_step_um=4.0)).result(PATIENCE_S)
        session.start_scan(name).result(PATIENCE_S)
    session.wait_until(lambda s: s.rig.state != "fault" or _is_finished(s), PATIENCE_S)
    _answer(BEGUN)
    session.wait_until(lambda s: s.surface_is_whole or (s.rig.state == "fault" and not _is_finished(s)), PATIENCE_S)
    if not session.snapshot.surface_is_whole:
        raise WaferViewerError(session.snapshot.rig.message)


def _is_finished(snapshot: Snapshot) -> bool:
    return not snapshot.scanning and snapshot.dataset is not None and snapshot.dataset.finished


def surface(session: Session, name: str, result: str) -> None:
    """Make a surface of a dataset from its frames."""
    _open(session, name)
    session.wait_until(lambda s: not s.works, PATIENCE_S)
    made = session.reconstruct(result=result)
    _answer(BEGUN)
    made.result(PATIENCE_S)


def _open(session: Session, name: str) -> None:
    path = session.snapshot.data_folder / f"{name}.wafer"
    if session.snapshot.dataset is None or session.snapshot.dataset.path != path:
        session.open_dataset(path).result(PATIENCE_S)


VERBS: dict[str, Callable[..., None]] = {f.__name__: f for f in (scan, surface)}


def main() -> None:
    session = Session(Path(sys.argv[1]), RigConfig(seed=0))
    session.wait_until(lambda s: s.rig.state == "ready" and s.compute_ready, PATIENCE_S)
    _answer(READY)
    for line in sys.stdin:
        verb, *words = json.loads(line)
        if verb == END:
            break
        try:
            VERBS[verb](session, *words)
            _answer(DONE)
        except WaferViewerError as fault:
            _answer(str(fault))
        except TimeoutError as fault:
            _answer(f"TimeoutError\n{fault}")
    session.close()


def _answer(answer: str) -> None:
    pids = {p.name.removeprefix("wafer-viewer "): p.pid for p in multiprocessing.active_children()}
    print(json.dumps([pids, answer]), flush=True)


if __name__ == "__main__":
    main()
