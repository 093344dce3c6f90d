"""How long a surface takes to be written to a file of each format, and read from it, and the memory that takes.

    python tests/bench/bench_exchange.py            44 million points, as many as the paper's gauge blocks have
    python tests/bench/bench_exchange.py --quick    1 million

Each format is written and read in a process of its own, from a mosaic on disk. Memory is what the process came to need
beyond what its modules take, files that are mapped left out.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.bench.big_mosaic import BLOCKS_PX, RESULT, big_dataset
from tests.bench.harness import Cell, alone, highest, own_mb, read_options, show, took
from wafer_viewer.model.file_formats import FORMATS, READ
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.formats.conversion import export, read_surface

QUICK_PX = 1024


def row(ending: str, side_px: int, folder: Path) -> tuple[Cell, ...]:
    """Write and read one format: size of the file in MB, seconds and MB of both."""
    path = folder / f"a{ending}"
    mosaic = Dataset.open(big_dataset(side_px)).result(RESULT).mosaic()
    written = watched(lambda: export(mosaic, path))
    read = watched(lambda: read_surface(path)) if ending in READ else (None, None)
    return ending, path.stat().st_size / 1e6, *written, *read


def watched(work: Callable[[], object]) -> tuple[float, float]:
    """Seconds, and the MB that came to be needed."""
    before_mb = own_mb()
    with highest() as most_mb:
        clock_s = took(work).clock_s
    return clock_s, most_mb[0] - before_mb


def main() -> None:
    asked = read_options(__doc__, folder=Path)
    side_px = QUICK_PX if asked.quick else BLOCKS_PX
    big_dataset(side_px)
    rows: list[tuple[Cell, ...]] = []
    for ending in (kind.suffixes[0] for kind in FORMATS):
        with TemporaryDirectory(prefix="wafer-viewer-exchange-", dir=asked.folder) as folder:
            rows.append(alone(row, ending, side_px, Path(folder)))
    title = f"{side_px} x {side_px} points; meshes of a million at most"
    show(title, "format | file, MB | write, s | MB | read, s | MB", rows)


if __name__ == "__main__":
    main()
