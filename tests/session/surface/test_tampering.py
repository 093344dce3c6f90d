"""Datasets against people who know the format, can compute every checksum and digest, and do not have the key."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import random
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from tests.support.campaigns import drawn_cases
from tests.support.datasets.complete_dataset import complete_dataset
from tests.support.datasets.unsigned import without_manifests
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import silent
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.dataset_library import load_summary, save_summary
from wafer_viewer.session.planning.verdicts import stored_verdict
from wafer_viewer.session.reporting.record_check import check_records
from wafer_viewer.session.reporting.report_data import gather
from wafer_viewer.session.surface.headless import make_surface
from wafer_viewer.session.surface.stitching_job import bring_up_to_date
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.integrity import MANIFESTS, check_files
from wafer_viewer.store.io.atomic_files import files_below
from wafer_viewer.store.io.checksums import load_json, save_json, seal_archive, sealed_line, sealed_node, sealed_text
from wafer_viewer.store.io.checksums import strip_checksum as plain
from wafer_viewer.store.mosaic import zarr_shards
from wafer_viewer.store.mosaic.zarr_shards import Shards, append_checksum
from wafer_viewer.store.records import manifest as manifests
from wafer_viewer.store.records.inspection_records import read_notebook, write_notebook
from wafer_viewer.store.records.manifest import MANIFEST, MARKS, RECORDS, Manifest
from wafer_viewer.store.records.signed_log import KEPT_IN, KEY_FILE, KNOWN_KEYS, known_public_key, signing_key

N_TAMPERINGS = 1200
UNSIGNED = re.compile(r"frames/.*|lock|results/[^/]+/thumbnails/.*|(results/[^/]+/)?manifest\.json")
"""Files that no manifest lists: frames have their checksums in the journal."""


@pytest.fixture(scope="module")
def signed(tmp_path_factory):
    return complete_dataset(tmp_path_factory.mktemp("signed") / "whole.wafer")


@pytest.fixture
def dataset(signed, tmp_path):
    """A copy of the data folder, with its key."""
    shutil.copytree(signed.parent, tmp_path / "data")
    return tmp_path / "data" / signed.name


def is_found(dataset):
    try:
        data = Dataset.open(dataset)
    except DatasetError:
        return True
    return any(kind.damaged for kind in check_files(dataset)) or bool(check_records(data).faults)


# ----------------------------------------------------------------------------------------- changes with right checksums


def changed_leaf(value, rng):
    """Return a JSON value with one number, text or truth changed."""
    if isinstance(value, dict) and value:
        name = rng.choice(sorted(value))
        return {**value, name: changed_leaf(value[name], rng)}
    if isinstance(value, list) and value:
        at = rng.randrange(len(value))
        return [*value[:at], changed_leaf(value[at], rng), *value[at + 1 :]]
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + rng.choice([1, 2, 5])
    return f"{value}x" if isinstance(value, str) else "x"


def change_json(path, rng):
    spec = json.loads(plain(path.read_bytes()))
    path.write_text(sealed_text(json.dumps(changed_leaf(spec, rng), indent=2)))


def change_node(path, rng):
    node = json.loads(path.read_bytes())
    path.write_text(sealed_node(changed_leaf(node, rng)))


def change_archive(path, rng):
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = rng.choice(sorted(name for name, array in arrays.items() if array.size and array.dtype.kind in "fiu"))
    values = arrays[name] = np.array(arrays[name])
    values.reshape(-1)[rng.randrange(values.size)] += 1
    with path.open("wb") as file:
        np.savez(file, **arrays)
    seal_archive(path)


def change_shard(path, rng):
    node = json.loads((path.parents[2] / "zarr.json").read_bytes())
    shards = Shards(
        np.dtype(node["data_type"]), (node["fill_value"] == "NaN" and np.nan) or 0, zarr_shards.CHUNK, zarr_shards.SHARD
    )
    chunks = shards._stored_chunks(path)
    place = rng.choice(sorted(chunks))
    pixels = np.array(shards._decoded(chunks[place]))
    pixels[rng.randrange(20), rng.randrange(20)] = 7
    chunks[place] = shards._encoded(pixels)
    shards._save(path, chunks)


def change_facts(path, rng):
    content = bytearray(path.read_bytes()[:-4])
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    path.write_bytes(append_checksum(bytes(content)))


def change_journal(path, rng):
    lines = [json.loads(plain(line)) for line in path.read_bytes().splitlines()]
    at, other = rng.sample(range(len(lines)), 2)
    match rng.randrange(5):
        case 0 | 1:
            lines[at] = {
                **changed_leaf({k: v for k, v in lines[at].items() if k != "type"}, rng),
                "type": lines[at]["type"],
            }
        case 2:
            del lines[at : at + rng.randint(1, 3)]
        case 3:
            lines[at], lines[other] = lines[other], lines[at]
        case _:
            lines.insert(at, lines[other])
    digests_again, content = rng.random() < 0.6, b""
    for line in lines:
        if digests_again and "before" in line:
            line = {**line, "before": hashlib.sha256(content).hexdigest()}
        content += sealed_line(json.dumps(line, separators=(",", ":")).encode()) + b"\n"
    path.write_bytes(content)


CHANGES = (
    (r"journal\.jsonl", change_journal),
    (r".*\.npz", change_archive),
    (r".*mosaic\.zarr/(.*/)?zarr\.json", change_node),
    (r".*/facts/c/.*", change_facts),
    (r".*mosaic\.zarr/\w+/\d+/c/.*", change_shard),
    (r".*\.json", change_json),
)


def change(path, name, rng):
    next(make for pattern, make in CHANGES if re.fullmatch(pattern, name))(path, rng)


# ----------------------------------------------------------------------------------------------------- on the manifests


def as_listed(manifest, name, path):
    """Return a manifest that has the digest of a changed file."""
    if name not in manifest.files and not path.is_file():
        return manifest
    files = {n: c for n, c in manifest.files.items() if n != name}
    if path.is_file():
        files[name] = manifests._covered(path)
    is_record = name == "scan.json" and path.is_file()
    scan = manifests._scan_digest(manifests.file_mark(path)) if is_record else manifest.scan
    return replace(manifest, files=files, scan=scan)


def forge(path, how, name, changed, rng, foreign):
    """Treat the manifest of a changed file."""
    manifest = as_listed(load_json(path, Manifest), name, changed)
    if how == "removed":
        path.unlink()
    elif how == "listed":
        save_json(path, manifest)
    elif how == "not signed":
        save_json(path, replace(manifest, key="", signature=""))
    elif how == "signed with another key":
        value = foreign.sign(manifests._signed_bytes(manifest)).hex()
        save_json(path, replace(manifest, key=foreign.public_key().public_bytes_raw().hex(), signature=value))
    elif how == "of another":
        others = [p for p in (path.parents[2] if "results" in path.parts else path.parent).rglob(MANIFEST) if p != path]
        path.write_bytes(rng.choice(others).read_bytes())


FORGERIES = ("", "", "", "removed", "listed", "not signed", "signed with another key", "of another")


def deed(dataset, names, rng):
    """Change, remove, exchange or add a file; return what was done, and the names of the files that differ."""
    name, other = rng.sample(names, 2)
    path = dataset / name
    match rng.randrange(8):
        case 0:
            path.unlink()
            return "removed", (name,)
        case 1:
            alike = [n for n in names if Path(n).suffix == path.suffix and n != name] or [other]
            other = rng.choice(alike)
            if (dataset / other).read_bytes() == path.read_bytes():
                change(path, name, rng)
                return "changed", (name,)
            path.write_bytes((dataset / other).read_bytes())
            return f"taken from {other}", (name,)
        case 2:
            result = rng.choice(["default", "difference-kept"])
            missing = [record for record in RECORDS if not (dataset / "results" / result / record).exists()]
            if not missing:
                change(path, name, rng)
                return "changed", (name,)
            added = f"results/{result}/{rng.choice(missing)}"
            (dataset / added).write_text(sealed_text("{\n}"))
            return "added", (added,)
        case _:
            change(path, name, rng)
            return "changed", (name,)


@pytest.mark.slow
@pytest.mark.campaign(within=True)
def test_every_tampering_with_files_that_numbers_depend_on_is_found(dataset):
    foreign, chosen = Ed25519PrivateKey.generate(), drawn_cases(range(N_TAMPERINGS))
    original = {p.relative_to(dataset).as_posix(): p.read_bytes() for p in dataset.rglob("*") if p.is_file()}
    names = sorted(name for name in original if not UNSIGNED.fullmatch(name))
    assert not is_found(dataset)
    missed, kinds, n_done = [], set(), 0
    for n in chosen:
        rng = random.Random(n)
        what, (name,) = deed(dataset, names, rng)
        if original.get(name) == ((dataset / name).read_bytes() if (dataset / name).is_file() else None):
            continue
        how = rng.choice(FORGERIES)
        of = Path(*Path(name).parts[:2]) if name.startswith("results/") else Path()
        forge(dataset / of / MANIFEST, how, Path(name).relative_to(of).as_posix(), dataset / name, rng, foreign)
        kinds.add((Path(name).name, how))
        n_done += 1
        if not is_found(dataset):
            missed.append((n, what, name, how))
        for place in files_below(dataset):
            if place.relative_to(dataset).as_posix() not in original:
                place.unlink()
        for other in {name, *(m for m in original if m.endswith(MANIFEST))}:
            if other in original:
                (dataset / other).write_bytes(original[other])
        assert n % 100 or not is_found(dataset), "the next one is to be found for itself"
    assert missed == []
    assert n_done > 5 / 6 * len(chosen)
    assert len(kinds) > min(60, len(chosen) / 5)


# --------------------------------------------------------------------------------------------------------- what is said


def replace_in(path, *pairs):
    """Replace texts in a JSON file and give it the right checksum."""
    text = plain(path.read_bytes()).decode()
    for old, new in pairs:
        assert old in text, old
        text = text.replace(old, new)
    path.write_text(sealed_text(text))


@pytest.mark.slow
def test_a_verdict_whose_value_and_word_were_changed_together_is_refused(dataset):
    data = Dataset.open(dataset)
    verdict = stored_verdict(data, data.result())
    (item,) = verdict.items
    path = dataset / "results" / "default" / "verdict.json"
    shifted = replace(item.measured, value=item.measured.value + 1.0)
    why = item.why.replace(f"{item.measured.value:.3f}", f"{shifted.value:.3f}")
    save_json(path, replace(verdict, items=(replace(item, measured=shifted, why=why),)))
    with pytest.raises(DatasetError, match=r"verdict\.json was altered, .* another digest .* judged again \(.*\)\.$"):
        stored_verdict(data, data.result())
    with pytest.raises(DatasetError, match=r"verdict\.json was altered"):
        gather(dataset, "default")


def test_an_altered_judgement_is_refused_and_not_written_over(dataset):
    result = Dataset.open(dataset).result()
    notebook = read_notebook(result.path)
    replace_in(result.path / "notebook.json", ('"number": 1', '"number": 2'))
    with pytest.raises(DatasetError, match=r"notebook\.json was altered"):
        read_notebook(result.path)
    with pytest.raises(DatasetError, match=r"notebook\.json was altered"):
        write_notebook(result.path, notebook)


def test_an_altered_summary_is_made_anew(dataset):
    result = Dataset.open(dataset).result()
    summary = load_summary(result)
    save_summary(result, replace(summary, highest_um=summary.highest_um + 1))
    assert load_summary(result).highest_um == summary.highest_um + 1
    replace_in(result.path / "surface.json", ('"result": "default"', '"result": "other"'))
    assert load_summary(result) is None
    save_summary(result, summary)
    assert not is_found(dataset)


def test_a_manifest_that_was_removed_is_missed_and_one_of_an_older_version_is_not(dataset):
    (dataset / "results" / "default" / MANIFEST).unlink()
    with pytest.raises(DatasetError, match=r"default/manifest\.json was altered: it is missing: restore it"):
        Dataset.open(dataset).result().findings()
    assert is_found(dataset)
    without_manifests(dataset)
    assert not is_found(dataset)
    (kind,) = [kind for kind in check_files(dataset) if kind.title == MANIFESTS]
    assert (kind.n_good, kind.n_without) == (0, 2)
    result = Dataset.open(dataset).result()
    result.save_findings(result.findings())
    replace_in(result.path / "verdict.json", ('"wafer_id": "', '"wafer_id": "2'))
    assert is_found(dataset), "from the first save on all records are covered"


@pytest.mark.slow
def test_a_result_that_was_removed_is_made_again(dataset):
    recipe = Dataset.open(dataset).result().recipe()
    shutil.rmtree(dataset / "results" / "default")
    make_surface(dataset, recipe, "default", again=False, tell=silent, warn=print)
    assert not is_found(dataset)


@pytest.mark.parametrize("bits", [0, 10, 128])
def test_a_mosaic_with_a_grey_depth_that_no_picture_has_is_named(dataset, bits):
    header = dataset / "results" / "default" / "mosaic.zarr" / "zarr.json"
    (found,) = re.findall(rb'"grey_bits": ?\d+', header.read_bytes())
    header.write_text(sealed_node(json.loads(header.read_bytes().replace(found, b'"grey_bits": %d' % bits))))
    with pytest.raises(DatasetError, match=r"zarr\.json"):
        Dataset.open(dataset).result().mosaic()
    assert is_found(dataset)


def test_a_surface_that_was_made_again_is_covered_once_it_is_stitched(dataset):
    data = Dataset.open(dataset)
    result, field = data.result(), data.fields[0]
    result.save_surface(
        field, dataclasses.replace(result.surface(field), confidence=result.surface(field).confidence / 2)
    )
    (fault,) = [fault for kind in check_files(dataset) for fault in kind.damaged]
    assert re.search(r"r0000c0000\.npz was altered, or made again and not completed: .* make the surface again", fault)
    bring_up_to_date(dataset, "default", result.recipe())
    assert not is_found(dataset)


@pytest.mark.parametrize("cut", ["before the file", "after the file"])
def test_a_program_that_is_killed_while_a_record_is_saved_leaves_the_old_or_the_new_one(dataset, monkeypatch, cut):
    result = Dataset.open(dataset).result()
    findings = result.findings()
    renamed = replace(findings, items=(replace(findings.items[0], name="another"),))
    writing = manifests.write_text

    def killed(path, text):
        if path.name == "findings.json":
            if cut == "after the file":
                writing(path, text)
            raise KeyboardInterrupt
        writing(path, text)

    with monkeypatch.context() as patch:
        patch.setattr(manifests, "write_text", killed)
        with pytest.raises(KeyboardInterrupt):
            result.save_findings(renamed)
    assert result.findings() == (renamed if cut == "after the file" else findings)
    assert not is_found(dataset)
    result.save_findings(renamed)
    assert not is_found(dataset)


def test_a_copy_in_a_folder_with_another_key_is_good_and_can_be_worked_on(dataset, tmp_path):
    made_here = known_public_key(dataset.parent)
    copy = tmp_path / "elsewhere" / dataset.name
    shutil.copytree(dataset, copy)
    signing_key(copy.parent)
    assert not is_found(copy)
    result = Dataset.open(copy).result()
    result.save_findings(result.findings())
    assert not is_found(copy)
    assert any(made_here in line for line in check_records(Dataset.open(copy)).logs)
    assert any(known_public_key(copy.parent) in line for line in check_records(Dataset.open(copy)).logs)
    (dataset.parent / KEPT_IN / KEY_FILE).unlink()
    other = signing_key(dataset.parent).public_key().public_bytes_raw().hex()
    assert other != made_here
    assert is_found(dataset), "it was signed in this folder, with another key"
    (dataset.parent / KNOWN_KEYS).write_text(f"{made_here} until the machine was replaced\n")
    assert not is_found(dataset)


@pytest.mark.slow
def test_a_new_dataset_of_an_old_name_is_not_asked_for_the_manifest_of_the_old_one(dataset):
    shutil.rmtree(dataset)
    assert (dataset.parent / KEPT_IN / MARKS / dataset.name).exists()
    complete_dataset(dataset)
    assert not is_found(dataset)


def test_a_line_of_a_pass_that_was_changed_with_its_checksum_is_found_at_opening(dataset):
    without_manifests(dataset)
    path = dataset / "journal.jsonl"
    lines = path.read_bytes().splitlines()
    changed = re.sub(rb'"z_um":(-?)[0-9.]+', rb'"z_um":\g<1>3.25', plain(lines[3]))
    path.write_bytes(b"\n".join([*lines[:3], sealed_line(changed), *lines[4:]]) + b"\n")
    with pytest.raises(DatasetError, match=r"journal\.jsonl was altered before line 13, which has another digest"):
        Dataset.open(dataset)
