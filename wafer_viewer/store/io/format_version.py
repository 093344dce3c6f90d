"""Format version of a dataset: the number of the keys of all that is stored in it, and whether it may be compressed.

It stands in ``scan.json``, so that an older program says that it is too old, not that a file is damaged. Every schema
from `OLDEST` on is read:

- 1: manifests without the lengths of logs. Its first datasets have no manifests, no checksums in ``scan.json``, journal
  and tags of frames, no provisional passes, and 0 for a size of the sample that is not given.
- 2: keys of features (upper, lower, nominal_um, lower_limit_um, upper_limit_um) that no dataset has. Heights do not say
  whether an import made up the positions of their fields.
- 3: textures have no volumes, no Smr(c) and Smc, no peaks and no choice of slopes and borders, roughness neither slopes
  nor a core, elements, noise and borders. Recipes have no least probability. Lines of a budget have no type,
  distribution and degrees of freedom: Student's t is in their standard uncertainty. Dies are not measured (tilts,
  offset, bow, brightness), and have neither limits nor rules for that.
"""

from __future__ import annotations

import re
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.atomic_files import write_text
from wafer_viewer.store.io.checksums import MOST_RECORD_BYTES, Checksum, sealed_text, strip_checksum, text_state
from wafer_viewer.store.io.guarded_reading import read_content

OLDEST, SCHEMA = 1, 4
"""Oldest number that is read, and that of the keys of all structs in a dataset: it rises with every key that is added,
removed or renamed.

tests/store/schemas.json holds the keys of each number.
"""
RECORD = "scan.json"
_VERSION = re.compile(rb'("schema_version": ?)(\d{1,9})')
_HEAD_BYTES = 256
"""Bytes at the beginning of a record that hold its version."""


def version_of(schema: int, *, compressed: bool) -> int:
    """Return the format version of a schema: an odd number, or the next even one if frame files may be compressed."""
    return 2 * schema - (not compressed)


def is_compressed(version: int) -> bool:
    """Return whether frame files of a dataset with a format version may be compressed."""
    return version % 2 == 0


def schema_of(version: int) -> int:
    """Return the schema of a format version."""
    return (version + 1) // 2


def require_readable(folder: Path, version: int) -> None:
    """Raise DatasetError when a dataset has a format that this program does not read."""
    oldest, newest = version_of(OLDEST, compressed=False), version_of(SCHEMA, compressed=True)
    if not oldest <= version <= newest:
        mend = "open it with a newer Wafer Viewer" if version > newest else "import its frames into a new dataset"
        formats = f"{oldest} to {newest}"
        raise DatasetError(f"{folder} has format {version} and this program reads formats {formats}: {mend}.")


def set_compressed(folder: Path, compressed: bool) -> None:
    """Note in the record of a dataset whether frame files may be compressed, and nothing else, atomically."""
    text = read_content(folder / RECORD, most=MOST_RECORD_BYTES)
    if (found := _VERSION.search(text)) is not None:
        _set_version(folder, version_of(schema_of(int(found[2])), compressed=compressed))


def raise_schema(folder: Path) -> None:
    """Raise the format version of an older dataset before something with the keys of this program is stored in it."""
    if not (folder / RECORD).is_file():
        return
    with (folder / RECORD).open("rb") as file:
        found = _VERSION.search(file.read(_HEAD_BYTES))
    if found is not None and schema_of(version := int(found[2])) < SCHEMA:
        _set_version(folder, version_of(SCHEMA, compressed=is_compressed(version)))


def with_version(text: bytes, version: int) -> bytes:
    """Return the text of a record with another format version, sealed if it was before."""
    changed = _VERSION.sub(rb"\g<1>%d" % version, strip_checksum(text), count=1)
    if text_state(text) is Checksum.NONE:
        return changed
    return sealed_text(changed.decode()).encode()


def _set_version(folder: Path, version: int) -> None:
    text = read_content(folder / RECORD, most=MOST_RECORD_BYTES)
    if (changed := with_version(text, version)) != text:
        write_text(folder / RECORD, changed.decode())
