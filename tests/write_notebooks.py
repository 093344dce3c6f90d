"""Run examples of the documentation and keep them as notebooks with what they print and draw: assets/notebooks.

    python tests/write_notebooks.py

An example is a script whose comments are text; each notebook has its text, its code and the pictures of this run.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

ROOT = Path(__file__).parents[1]
EXAMPLES, NOTEBOOKS = ROOT / "assets/examples", ROOT / "assets/notebooks"
NAMES = {"quickstart": "01_simulated_scan.py", "uncertainty": "04_step_height.py"}
"""Notebook and the example that it is of."""
DPI = 80


@dataclass(frozen=True, slots=True)
class Cell:
    """Text in Markdown, or code."""

    kind: Literal["markdown", "code"]
    source: str


def cells_of(script: str) -> Iterator[Cell]:
    """Yield the cells of an example: its title and text, and what stands between comments that begin with ``# %%``."""
    docstring = ast.get_docstring(ast.parse(script)) or ""
    title, _, about = docstring.split("\n", 2)
    yield Cell("markdown", f"# {title}\n\n{_markdown(about)}")
    body = script.split('"""', 2)[2]
    for part in re.split(r"^# %%\n", body, flags=re.MULTILINE):
        lines = part.strip("\n").splitlines()
        n_text = next((n for n, line in enumerate(lines) if not line.startswith("# ")), len(lines))
        text, code = lines[:n_text], "\n".join(lines[n_text:]).strip("\n")
        words = "\n".join(line[2:] for line in text if not line.startswith("# sphinx_gallery"))
        if words:
            yield Cell("markdown", _markdown(words))
        if code:
            yield Cell("code", code)


def _markdown(text: str) -> str:
    return text.strip().replace("``", "`")


def written(cells: list[Cell]) -> dict[str, Any]:
    """Run the cells in the working directory, and return the notebook (nbformat 4.5)."""
    known: dict[str, Any] = {"__name__": "__main__"}
    made = [_written(n, cell, known) for n, cell in enumerate(cells)]
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return {"cells": made, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


def _written(n: int, cell: Cell, known: dict[str, Any]) -> dict[str, Any]:
    common = {
        "cell_type": cell.kind,
        "id": f"cell-{n}",
        "metadata": {},
        "source": cell.source.splitlines(keepends=True),
    }
    if cell.kind == "markdown":
        return common
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(cell.source, f"cell {n}", "exec"), known)
    outputs: list[dict[str, Any]] = [*_stream(printed.getvalue()), *_figures()]
    return {**common, "execution_count": None, "outputs": outputs}


def _stream(text: str) -> Iterator[dict[str, Any]]:
    if text:
        yield {"output_type": "stream", "name": "stdout", "text": text.splitlines(keepends=True)}


def _figures() -> Iterator[dict[str, Any]]:
    """Yield the figures that are open as pictures, and close them."""
    import matplotlib.pyplot as plt

    for number in plt.get_fignums():
        png = io.BytesIO()
        plt.figure(number).savefig(png, dpi=DPI)
        picture = {"image/png": base64.b64encode(png.getvalue()).decode()}
        yield {"output_type": "display_data", "data": picture, "metadata": {}}
    plt.close("all")


def main() -> None:
    import matplotlib as mpl

    mpl.use("agg")
    NOTEBOOKS.mkdir(exist_ok=True)
    os.chdir(tempfile.mkdtemp())
    for words in (["scan", ROOT / "assets/plans/wafer.toml", "-o", "scan.wafer"], ["stitch", "scan.wafer"]):
        subprocess.run([sys.executable, "-m", "wafer_viewer", *words], check=True, stdout=subprocess.DEVNULL)
    for name, example in NAMES.items():
        notebook = written(list(cells_of((EXAMPLES / example).read_text(encoding="utf-8"))))
        text = json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"
        (NOTEBOOKS / f"{name}.ipynb").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
