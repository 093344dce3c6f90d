"""``notebook.json``: saved views and judgements, in the folder of the result."""

from __future__ import annotations

from pathlib import Path

from wafer_viewer.model.job.review_notes import Notebook
from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors
from wafer_viewer.store.io.checksums import load_json, require_good_json, save_json

NOTEBOOK = "notebook.json"


def read_notebook(result: Path) -> Notebook:
    """Read the notebook of a result; an empty one if there is none. Raises DatasetError when it is unreadable."""
    path = result / NOTEBOOK
    return load_json(path, Notebook) if path.exists() else Notebook()


def write_notebook(result: Path, notebook: Notebook) -> None:
    """Save a notebook, replacing the earlier one. Raises DatasetError when that is damaged."""
    with os_errors_as_dataset_errors(result):
        result.mkdir(parents=True, exist_ok=True)
    require_good_json(result / NOTEBOOK)
    save_json(result / NOTEBOOK, notebook)
