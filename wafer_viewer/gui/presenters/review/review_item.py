"""One thing under review, whatever it is: a feature of a job, a result, a defect."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.gui.presenters.result_regions import Box
from wafer_viewer.gui.presenters.verdict import LOOKS
from wafer_viewer.model.job.review_notes import Judgement
from wafer_viewer.model.job.verdict import Word
from wafer_viewer.model.measurement.levelling import Levelling

Row = tuple[str, str, str, str]
"""Name, value, U, unit."""
VERDICTS = {"open": "open", "accepted": "accepted", "rejected": "rejected"}


@dataclass(frozen=True, slots=True)
class ReviewItem:
    """One thing to be judged: its sign, where it is, its numbers, what the instrument says, what people say.

    value: what the list shows, HTML. show: the surface it was measured on; number: of the result it is, if it is one;
    defect: of the defect it is. word: what the instrument says of it, and `said` why; None where it says nothing.
    """

    key: str
    sign: str
    colour: str
    title: str
    below: str
    value: str
    rows: tuple[Row, ...]
    judgement: Judgement
    box_um: Box | None = None
    show: int = 0
    levelling: Levelling = Levelling()
    number: int | None = None
    word: Word | None = None
    said: str = ""
    defect: int | None = None
    shape: str = "disc"

    @property
    def told(self) -> str:
        """What the instrument says and what people say of it, in words."""
        people = VERDICTS[self.judgement.verdict]
        return people if self.word is None else f"{LOOKS[self.word][0]}, {people}"
