"""``notebook.json``: saved views and judgements beside the surface they are of."""

from __future__ import annotations

from pathlib import Path

from wafer_viewer.model.job.review_notes import Notebook
from wafer_viewer.store.io.atomic_files import writing
from wafer_viewer.store.io.checksums import load_json, require_good_json, save_json

NOTEBOOK = "notebook.json"


def read_notebook(result: Path) -> Notebook:
    """The notebook of the folder of a result; an empty one at first. Raises DatasetError when it cannot be read."""
    path = result / NOTEBOOK
    return load_json(path, Notebook) if path.exists() else Notebook()


def write_notebook(result: Path, notebook: Notebook) -> None:
    """Keep a notebook in place of the one before. Raises DatasetError when that is damaged."""
    with writing(result):
        result.mkdir(parents=True, exist_ok=True)
    require_good_json(result / NOTEBOOK)
    save_json(result / NOTEBOOK, notebook)
