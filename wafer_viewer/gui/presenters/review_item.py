"""One item under review, and the colours of its judgements."""

from __future__ import annotations

from dataclasses import dataclass

import viser

from wafer_viewer.gui.presenters.results import Box
from wafer_viewer.gui.presenters.verdict import LOOKS
from wafer_viewer.model.job import Judgement, Word
from wafer_viewer.model.measurement.levelling import Levelling

Row = tuple[str, str, str, str]
"""Name, value, U, unit."""
VERDICTS = {"open": "open", "accepted": "accepted", "rejected": "rejected"}


@dataclass(frozen=True, slots=True)
class ReviewItem:
    """Item to judge: symbol, position, quantities, verdict of the instrument, judgement of the user.

    value: HTML for the list. show: surface of the measurement; number: number of the result, defect: number of the
    defect, None for others. word: verdict of the instrument, None if there is none; said: its reason.
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
    reason: str = ""
    defect: int | None = None
    shape: str = "disc"

    @property
    def verdict_text(self) -> str:
        """Verdict of the instrument, if any, and judgement of the user, as text."""
        people = VERDICTS[self.judgement.verdict]
        return people if self.word is None else f"{LOOKS[self.word][0]}, {people}"


VERDICT_LOOKS = {
    "open": (viser.Icon.CIRCLE_DASHED, "ink3"),
    "accepted": (viser.Icon.CIRCLE_CHECK, "good"),
    "rejected": (viser.Icon.CIRCLE_X, "fault"),
}
