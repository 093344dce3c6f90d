"""Damaged frames of a dataset whose scan is continued: their slots are empty again, and their files fit to be written.

A frame whose page differs from its checksum in the journal loses its slot. So do all frames of a file that cannot be
read or decoded, which is made again. A file with damaged tags is written again from its good frames.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from wafer_viewer.model.acquisition.plan import Field, Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import Progress, ShouldStop, with_progress
from wafer_viewer.store.dataset.compression import rewrite_field
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.frame_pages import compression_of, create_pages, tags_crc32c
from wafer_viewer.store.dataset.scan_record import frames_file
from wafer_viewer.store.io.atomic_files import atomic_write

_MOST_THREADS = 8
NAMED = 8
"""Largest number of fields that a sentence names."""


@dataclass(frozen=True, slots=True)
class FieldDamage:
    """Damage of the frame file of a field: slots of damaged frames, and whether the file or its tags are damaged."""

    field: Field
    shots: tuple[Shot, ...]
    is_unreadable: bool
    has_damaged_tags: bool

    @property
    def is_any(self) -> bool:
        """True if anything is damaged."""
        return bool(self.shots) or self.is_unreadable or self.has_damaged_tags


def find_damage(
    data: Dataset, progress: Progress | None = None, should_stop: ShouldStop | None = None
) -> list[FieldDamage]:
    """Compare all frames that count with their checksums; reads all of them, several files at once.

    Raises DatasetError when stopped.
    """
    tags = data.scan.tags_crc32c()
    n_threads = 1 if data.scan.is_compressed else min(_MOST_THREADS, os.cpu_count() or 1)  # decoding uses all cores
    with ThreadPoolExecutor(n_threads) as threads:
        submitted = [threads.submit(_damage, data, field, tags.get(field.number)) for field in data.fields]
        try:
            awaited = with_progress(submitted, len(submitted), "The check of the frames", progress, should_stop)
            return [damage for done in awaited if (damage := done.result()).is_any]
        finally:
            threads.shutdown(cancel_futures=True)


def make_writable(data: Dataset, damage: FieldDamage, description: bytes) -> None:
    """Make the file of a field fit to be written, once the slots of its damaged frames are empty.

    data: as it is after that; description: of a file without frames. The caller holds the lock. Raises DatasetError
    when the file cannot be written.
    """
    field = damage.field
    if damage.is_unreadable:
        crc = data.scan.tags_crc32c().get(field.number)
        with atomic_write(frames_file(data.path, field)) as temporary:
            create_pages(temporary, data.scan.pages(field), data.scan.pixel_um, description, crc)
    elif damage.has_damaged_tags:
        rewrite_field(data, field)


def sentence_of(damages: Sequence[FieldDamage]) -> str:
    """Return what is said of frames that are taken again; an empty text if there are none."""
    numbers = [damage.field.number for damage in damages if damage.shots]
    if not numbers:
        return ""
    n_frames = sum(len(damage.shots) for damage in damages)
    frames = "1 frame was" if n_frames == 1 else f"{n_frames} frames were"
    more = f" and {len(numbers) - NAMED} more" if len(numbers) > NAMED else ""
    fields = f"field {numbers[0]}" if len(numbers) == 1 else f"fields {', '.join(map(str, numbers[:NAMED]))}{more}"
    again = "it is" if n_frames == 1 else "they are"
    return f"On the disk {frames} damaged, of {fields}: {again} taken again. Check the disk if this happens again."


def _damage(data: Dataset, field: Field, tags: int | None) -> FieldDamage:
    path, shape = frames_file(data.path, field), data.scan.pages(field)
    if data.removed is not None:
        return FieldDamage(field, (), is_unreadable=False, has_damaged_tags=False)
    try:
        compression_of(path, shape)
        shots, has_damaged_tags = tuple(data.damaged_slots(field)), tags not in (None, tags_crc32c(path, shape))
        return FieldDamage(field, shots, is_unreadable=False, has_damaged_tags=has_damaged_tags)
    except DatasetError:
        return FieldDamage(field, tuple(data.kept_of(field)), is_unreadable=True, has_damaged_tags=False)
