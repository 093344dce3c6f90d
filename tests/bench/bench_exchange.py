"""How long a surface takes to be written to a file of each format, and read from it, and the memory that takes.

    python tests/bench/bench_exchange.py            44 million points, as many as the paper's gauge blocks have
    python tests/bench/bench_exchange.py --quick    1 million

Each format is written and read in a process of its own, from a mosaic on disk. Memory is what the process came to need
beyond what its modules take, files that are mapped left out.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from tests.bench.big_mosaic import BLOCKS_PX, RESULT, big_dataset  # noqa: E402
from wafer_viewer.model.file_formats import FORMATS, READ  # noqa: E402
from wafer_viewer.store.dataset.dataset import Dataset  # noqa: E402
from wafer_viewer.store.formats.exporters import export  # noqa: E402
from wafer_viewer.store.formats.readers import read_surface  # noqa: E402

QUICK_PX = 1024
SLOWEST_S = 600
LOOK_EVERY_S = 0.02


def own_memory_mb() -> float:
    """Anonymous memory of this process."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("RssAnon")) / 1024


class Watched:
    """The time and the most memory that a piece of work takes."""

    def __enter__(self) -> Watched:
        self.before_mb = self.most_mb = own_memory_mb()
        self._over, self.begun = threading.Event(), time.perf_counter()
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.seconds = time.perf_counter() - self.begun
        self._over.set()
        self._watcher.join()

    def _watch(self) -> None:
        while not self._over.wait(LOOK_EVERY_S):
            self.most_mb = max(self.most_mb, own_memory_mb())

    @property
    def took(self) -> str:
        return f"{self.seconds:.1f} {self.most_mb - self.before_mb:.0f}"


def one(ending: str, side_px: int, folder: Path) -> None:
    """Write and read one format; prints seconds and MB of both, and the size of the file."""
    path = folder / f"a{ending}"
    mosaic = Dataset.open(big_dataset(side_px)).result(RESULT).mosaic()
    with Watched() as writing:
        export(mosaic, path)
    print(f"{path.stat().st_size / 1e6:.0f} {writing.took}", end="")
    if ending in READ:
        with Watched() as reading:
            read_surface(path)
        print(f" {reading.took}")
    else:
        print(" - -")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a million points")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help="where the files are written for a moment")
    asked = parser.parse_args()
    side_px = QUICK_PX if asked.quick else BLOCKS_PX
    if asked.one:
        one(asked.one, side_px, asked.folder)
        return 0
    big_dataset(side_px)
    print(f"{side_px} x {side_px} points; meshes of a million at most")
    print("format   file, MB   write, s    MB   read, s    MB")
    failed = 0
    for ending in (kind.suffixes[0] for kind in FORMATS):
        folder = Path(tempfile.mkdtemp(prefix="wafer-viewer-exchange-", dir=asked.folder))
        try:
            words = [sys.executable, __file__, "--one", ending, "--folder", str(folder)]
            words += ["--quick"] if asked.quick else []
            done = subprocess.run(words, capture_output=True, text=True, timeout=SLOWEST_S, check=False)
            cells = done.stdout.split()
            failed += done.returncode != 0
            line = "{:>9} {:>10} {:>5} {:>9} {:>5}".format(*cells) if len(cells) == 5 else done.stderr.strip()[-200:]
            print(f"{ending:6} {line}", flush=True)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
