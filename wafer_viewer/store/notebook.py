"""``notebook.json``: saved views and judgements beside the surface they are of."""

from __future__ import annotations

from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.notebook import Notebook
from wafer_viewer.model.spec import decode, encode
from wafer_viewer.store.files import write_text, writing

NOTEBOOK = "notebook.json"


def read_notebook(result: Path) -> Notebook:
    """The notebook of the folder of a result; an empty one at first. Raises DatasetError when it cannot be read."""
    path = result / NOTEBOOK
    if not path.exists():
        return Notebook()
    try:
        return decode(path.read_bytes(), Notebook, str(path), "json")
    except OSError as fault:
        raise DatasetError(f"{path} cannot be read: {fault.strerror}.") from fault


def write_notebook(result: Path, notebook: Notebook) -> None:
    """Keep a notebook in place of the one before."""
    with writing(result):
        result.mkdir(parents=True, exist_ok=True)
    write_text(result / NOTEBOOK, encode(notebook, "json"))
