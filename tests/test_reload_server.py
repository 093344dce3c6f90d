"""The server for development starts anew at an edit, also after an edit that it could not start with."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from tests.support.paths import ROOT

PROGRAM = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.SIG_DFL)
source = open(sys.argv[1]).read()
print(source, flush=True)
time.sleep(0 if source == "broken" else 60)
"""
WATCH = """
import sys; from pathlib import Path; from tests.reload_server import serve
serve(sys.argv[2:], Path(sys.argv[1]))
"""


@pytest.mark.slow
def test_edit_starts_the_server_anew(tmp_path):
    (source := tmp_path / "source.py").write_text("first")
    words = [sys.executable, "-c", WATCH, str(tmp_path), sys.executable, "-c", PROGRAM, str(source)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT) as watch:
        printed = []
        for edit in ("broken", "mended", ""):
            printed.append(watch.stdout.readline().strip())
            if edit:
                (written := tmp_path / "written").write_text(edit)
                written.rename(source)
        watch.send_signal(signal.SIGINT)
        _, errors = watch.communicate(timeout=30)
    assert printed == ["first", "broken", "mended"]
    assert (watch.returncode, errors) == (0, "")
