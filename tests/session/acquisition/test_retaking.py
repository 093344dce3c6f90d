"""Damaged frames of an open dataset: found when asked, or when a field gets no heights, named, and taken again."""

from __future__ import annotations

import pytest

from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.session.core.audit_trail import account
from wafer_viewer.session.files.frame_check import DAMAGED, damage_sentence
from wafer_viewer.session.state.snapshot import FieldState
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.scan_record import frames_file

pytestmark = pytest.mark.slow


def harm(path, *shots):
    """Flip a bit in the middle of frames on the disk."""
    data = Dataset.open(path)
    for shot in shots:
        field = data.field(shot.field)
        pages, file = data.scan.pages(field), frames_file(path, field)
        content = bytearray(file.read_bytes())
        at = content.find(data.stack(shot.field, verify=False).images[shot.k].tobytes())
        content[at + pages.rows * pages.cols // 2] ^= 1
        file.write_bytes(content)


@pytest.mark.campaign(together=True)
def test_damaged_frames_are_named_and_taken_again(session, job, surfaced, patience_s):
    session.edit_job(job()).result()
    path = session.start_scan("harmed").result(patience_s)
    session.wait_until(surfaced, patience_s)
    session.close_dataset().result()
    with pytest.raises(DatasetError, match="No dataset is open"):
        session.check_frames().result()
    lost = (Shot(1, 4), Shot(2, 9), Shot(2, 10))
    harm(path, *lost)

    session.open_dataset(path).result()
    assert session.snapshot.dataset.damaged == ()
    assert session.check_frames().result(patience_s) == lost
    shown = session.snapshot
    assert shown.dataset.damaged == lost
    (fault,) = (f for f in shown.faults if f.title == DAMAGED)
    assert fault.text.startswith("3 frames are damaged: frame 5 of field 1; frames 10 to 11 of field 2.")

    before = Dataset.open(path).result().surface(Dataset.open(path).field(1)).provenance
    session.continue_scan().result(patience_s)
    session.wait_until(surfaced, patience_s)
    done = session.snapshot
    assert Dataset.open(path).check().ok
    assert done.dataset.damaged == ()
    assert done.dataset.finished
    assert set(done.dataset.states.values()) == {FieldState.MEASURED}
    assert [f for f in done.faults if f.title == DAMAGED] == []
    after = Dataset.open(path).result().surface(Dataset.open(path).field(1)).provenance
    assert after.input_checksum != before.input_checksum, "the heights are those of the new frames"
    assert session.check_frames().result(patience_s) == ()
    last = session.recorded_actions(path.name)[-1]
    assert (last.action, last.by) == ("Scan continued", account())


@pytest.mark.campaign(together=True)
def test_a_field_without_heights_has_its_frames_checked(session, surfaced, patience_s):
    path = session.snapshot.dataset.path
    session.close_dataset().result()
    harm(path, Shot(2, 3))
    session.open_dataset(path).result()
    session.reconstruct(result="again")
    session.wait_until(lambda now: bool(now.dataset.damaged), patience_s)
    assert session.snapshot.dataset.damaged == (Shot(2, 3),)
    titles = [fault.title for fault in session.snapshot.faults]
    assert DAMAGED in titles
    assert "Field 2 has no heights" not in titles, "said once, with the others"
    session.continue_scan().result(patience_s)
    session.wait_until(lambda now: surfaced(now) and not now.dataset.damaged, patience_s)
    assert Dataset.open(path).check().ok


@pytest.mark.parametrize(
    ("shots", "sentence"),
    [
        ([Shot(1, 4, 1), Shot(1, 4, 0)], "1 frame is damaged: frame 5 of field 1."),
        ([Shot(2, 9), Shot(1, 0)], "2 frames are damaged: frame 1 of field 1; frame 10 of field 2."),
        (
            [Shot(1, k) for k in range(0, 10, 2)],
            "5 frames are damaged: frames 1, 3, 5, 7 and others of field 1.",
        ),
        (
            [Shot(number, 0) for number in range(1, 7)],
            "6 frames are damaged: frame 1 of field 1; frame 1 of field 2; frame 1 of field 3; frame 1 of field 4; "
            "and others of 2 more fields.",
        ),
    ],
)
def test_one_sentence_names_them(shots, sentence):
    assert damage_sentence(shots) == sentence
