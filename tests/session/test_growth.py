"""The stitched surface grows while its fields are taken, and is solved for as a whole at the end."""

from __future__ import annotations

import pytest

from wafer_viewer.store.dataset.dataset import Dataset

pytestmark = pytest.mark.campaign(together=True)


def test_the_surface_grows_during_a_scan_and_is_whole_afterwards(session, job, surfaced, patience_s):
    counts: list[int] = []

    def listen(snapshot):
        if snapshot.surface is not None and snapshot.dataset is not None and snapshot.dataset.name == "growing":
            counts.append(snapshot.surface.n_fields)

    session.edit_job(job(cols=3, rows=3, n_frames=30)).result()
    leave = session.subscribe(listen)
    session.start_scan("growing").result(patience_s)
    done = session.wait_until(surfaced, patience_s)
    leave()

    assert counts[0] < 9
    assert counts == sorted(counts)
    assert done.surface.n_fields == 9
    assert done.surface.changed  # parts were drawn, not the whole again
    placed = done.surface.stitching
    assert placed.n_overlaps >= 12
    assert placed.n_believed > placed.n_overlaps / 2
    poses = session.poses()
    assert poses.numbers.tolist() == list(range(1, 10))
    assert session.mosaic().window(level=1).overlap_um is not None


def test_a_stitching_that_was_broken_off_is_made_good_when_the_dataset_is_opened(session, surfaced, patience_s):
    path = session.snapshot.dataset.path
    session.close_dataset().result()
    stored = Dataset.open(path).result()
    stored.begin_mosaic_update(stored.poses())  # as a viewer leaves it that is killed while it draws
    session.open_dataset(path).result()
    session.wait_until(lambda s: surfaced(s) and not stored.broken_off, patience_s)
    assert stored.shows_all(session.snapshot.dataset.fields)
    assert session.snapshot.surface.n_fields == 9
