"""Command that repeats the paper's jobs. Its signature defines the flags, its docstring is the help."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from wafer_viewer.cli.output import progress, warn
from wafer_viewer.store.io.atomic_files import size

ResultFolder = Annotated[Positional[Path], arg(metavar="FOLDER")]


def paper(folder: ResultFolder = Path("paper"), reduced: bool = False, keep: bool = False, plan: bool = False) -> None:
    """Repeat the paper's two jobs on the virtual rig, and write its tables and figures beside ours as one page.

    Scans, makes the surfaces by each method of the paper and by the default recipe, stitches, measures, inspects and
    reports. Every step is done once: Ctrl-C stops, and the same command continues. Prints time and room before it
    starts.

    Args:
        folder: Where all of it lies; FOLDER/paper.html is the page.
        reduced: A few small fields instead of 271 full-size ones: minutes instead of hours.
        keep: Leave the datasets with all surfaces in FOLDER.
        plan: Only print time and room.
    """
    from wafer_viewer.draw.number_format import duration
    from wafer_viewer.session.reproduction.paper_page import write_page
    from wafer_viewer.session.reproduction.reproduction import Reproduction

    run = Reproduction(folder, reduced, keep)
    pending = run.pending
    print(
        f"{folder}: {len(pending)} of {len(run.steps)} steps to do, about {duration(run.expected_s)} and "
        f"{size(run.needed_bytes)} of room.",
        flush=True,
    )
    if plan:
        return
    run.begin()
    for n, step in enumerate(pending, len(run.steps) - len(pending) + 1):
        began = time.monotonic()
        with progress(f"{n}/{len(run.steps)} {step.title}") as tell:
            run.run(step, tell, warn)
        print(f"{n}/{len(run.steps)} {step.title}: {time.monotonic() - began:.1f} s", flush=True)
    print(write_page(run))
