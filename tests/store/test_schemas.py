"""Keys of all that is stored in a dataset: they change only together with the number of the schema.

When a key was added, removed or renamed, raise SCHEMA in wafer_viewer/store/io/format_version.py and record the keys:

    python -m tests.store.test_schemas
"""

from __future__ import annotations

import dataclasses
import json
import typing
from pathlib import Path

import msgspec
import pytest

from tests.support.plans import plan_without_motion
from wafer_viewer.model.acquisition.calibration import FlatField
from wafer_viewer.model.acquisition.plan import Field, FocusSweep
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.findings import MeasurementResults
from wafer_viewer.model.inspection.defect import Inspection
from wafer_viewer.model.job import Job, Notebook, WaferVerdict
from wafer_viewer.model.surface.comparison import Comparison
from wafer_viewer.model.surface.height_map import Provenance
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.store.dataset import scan_record
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.scan_record import Line, ScanRecord
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.io import format_version
from wafer_viewer.store.io.format_version import SCHEMA
from wafer_viewer.store.mosaic.zarr_shards import MosaicHeader
from wafer_viewer.store.records.manifest import Manifest

RECORDED = Path(__file__).with_name("schemas.json")
"""Keys of each struct by the number of the schema."""
STORED = (
    *(ScanRecord, Line, FlatField, Manifest),
    *(Recipe, Provenance, MosaicHeader, MeasurementResults, Inspection, WaferVerdict, Notebook, Comparison),
)
"""Structs in the files of a dataset and of its results, with all that they consist of."""


def stored_keys() -> dict[str, str]:
    """Return the keys of every stored struct, in alphabetical order, with its tag if it has one."""
    found: dict[type, str] = {}
    for kind in STORED:
        collect(kind, found)
    return {kind.__name__: keys for kind, keys in sorted(found.items(), key=lambda item: item[0].__name__)}


def collect(hint: object, found: dict[type, str]) -> None:
    for part in typing.get_args(hint):
        collect(part, found)
    kind = typing.get_origin(hint) or hint
    if not isinstance(kind, type) or kind in found:
        return
    if issubclass(kind, msgspec.Struct):
        tag = kind.__struct_config__.tag
        names = [field.encode_name for field in msgspec.structs.fields(kind)]
        found[kind] = " ".join(([f"({tag})"] if tag else []) + sorted(names))
    elif dataclasses.is_dataclass(kind) or hasattr(kind, "_fields"):
        found[kind] = " ".join(sorted(typing.get_type_hints(kind)))
    else:
        return
    for part in typing.get_type_hints(kind, include_extras=True).values():
        collect(part, found)


def recorded() -> dict[str, dict[str, str]]:
    return json.loads(RECORDED.read_text())


def test_stored_keys_are_those_of_the_schema_number():
    assert str(SCHEMA) in recorded(), f"record the keys of schema {SCHEMA}: {__doc__}"
    assert stored_keys() == recorded()[str(SCHEMA)], __doc__


def test_schema_numbers_are_recorded_without_a_gap():
    assert sorted(map(int, recorded())) == list(range(1, SCHEMA + 1))


def test_each_schema_has_other_keys():
    tables = recorded()
    assert all(tables[str(n)] != tables[str(n + 1)] for n in range(1, SCHEMA))


def test_changed_key_of_a_nested_struct_is_found():
    class Inner(msgspec.Struct):
        a: int

    class Outer(msgspec.Struct, tag="outer"):
        inner: tuple[Inner, ...] | None = None

    found: dict[type, str] = {}
    Outer.__annotations__ = {"inner": tuple[Inner, ...] | None}
    collect(Outer, found)
    assert found == {Outer: "(outer) inner", Inner: "a"}


@pytest.fixture
def data(tmp_path):
    job = Job(
        fields=(Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=0.0),),
        sweep=FocusSweep(z_step_um=1.0, n_frames=5),
    )
    DatasetWriter.create(tmp_path / "a.wafer", plan_without_motion(job, (8, 8), 0.5), job).close()
    return Dataset.open(tmp_path / "a.wafer")


def raise_number(monkeypatch):
    for module in (format_version, scan_record):
        monkeypatch.setattr(module, "SCHEMA", SCHEMA + 1)


def test_dataset_of_a_newer_schema_is_refused_with_the_mend(data, monkeypatch):
    with monkeypatch.context() as newer:
        raise_number(newer)
        data.result().save_recipe(Recipe())
    with pytest.raises(DatasetError, match=f"has format {2 * SCHEMA + 1} .* open it with a newer Wafer Viewer"):
        Dataset.open(data.path)


def test_dataset_older_than_all_that_is_read_is_refused_with_the_mend(data):
    record = data.path / "scan.json"
    record.write_bytes(format_version.with_version(record.read_bytes(), 0))
    with pytest.raises(DatasetError, match=rf"has format 0 .* reads formats 1 to {2 * SCHEMA}: import its frames"):
        Dataset.open(data.path)


def test_result_of_a_newer_schema_raises_the_number_of_its_dataset(data, monkeypatch):
    format_version.set_compressed(data.path, True)
    raise_number(monkeypatch)
    before = Dataset.open(data.path)
    before.result().save_recipe(Recipe())
    after = Dataset.open(data.path)
    assert (before.scan.schema_version, after.scan.schema_version) == (2 * SCHEMA, 2 * SCHEMA + 2)
    assert after.scan.is_compressed
    format_version.set_compressed(data.path, False)
    assert Dataset.open(data.path).scan.schema_version == 2 * SCHEMA + 1
    report = after.check()
    assert (report.faults, [kind.damaged for kind in report.files if kind.damaged]) == ((), [])


def test_continued_scan_of_a_newer_schema_raises_the_number_of_its_dataset(data, monkeypatch):
    raise_number(monkeypatch)
    DatasetWriter.resume(data.path).close()
    assert Dataset.open(data.path).scan.schema_version == 2 * SCHEMA + 1


if __name__ == "__main__":
    tables = recorded() if RECORDED.exists() else {}
    RECORDED.write_text(json.dumps({str(SCHEMA): stored_keys(), **tables}, indent=1, sort_keys=True) + "\n")
