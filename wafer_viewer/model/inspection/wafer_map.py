"""Contents of a wafer map: the bin code of every die, with what the file states of wafer and dies."""

from __future__ import annotations

from typing import ClassVar, Literal

from wafer_viewer.model.acquisition.sample import QUARTER_TURNS, Notch
from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.inspection.die_grid import DieStatus
from wafer_viewer.model.spec import NonNegative, Spec, replace

DieQuality = Literal["pass", "fail", "skip"]
"""Whether a die is good, bad, or was not judged."""
Place = tuple[int, int]


class MapDie(Spec, frozen=True, kw_only=True):
    """A die of a map: column from the left, row from the bottom, bin code, and its quality, "skip" if not stated."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    col: int
    row: int
    code: str
    quality: DieQuality = "skip"


class WaferMap(Spec, frozen=True, kw_only=True):
    """A wafer map: its dies by column and row, where (0, 0) is the lower left place of the map.

    notch: where it points on the map; pitch and size of the dies in um, 0 if not stated; codes: description of bin
    codes; reference: column and row of die 0,0, None if not stated.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    format: Literal["e142", "sinf"]
    lot: str = ""
    wafer: str = ""
    product: str = ""
    notch: Notch = "none"
    cols: int
    rows: int
    pitch_x_um: NonNegative = 0.0
    pitch_y_um: NonNegative = 0.0
    width_um: NonNegative = 0.0
    height_um: NonNegative = 0.0
    dies: tuple[MapDie, ...] = ()
    codes: tuple[tuple[str, str], ...] = ()
    reference: Place | None = None

    def turned(self, notch: Notch) -> WaferMap:
        """Return the map as seen with its notch at another side; unchanged if either side is not known."""
        if "none" in (notch, self.notch):
            return self
        turned = self
        for _ in range((QUARTER_TURNS[notch] - QUARTER_TURNS[self.notch]) % 4):
            turned = turned._quarter_turn()
        return replace(turned, notch=notch)

    def _quarter_turn(self) -> WaferMap:
        """Return the map turned anticlockwise by 90 degrees."""
        dies = tuple(replace(die, col=self.rows - 1 - die.row, row=die.col) for die in self.dies)
        reference = None if self.reference is None else (self.rows - 1 - self.reference[1], self.reference[0])
        sides = {"pitch_x_um": self.pitch_y_um, "pitch_y_um": self.pitch_x_um}
        sides |= {"width_um": self.height_um, "height_um": self.width_um}
        return replace(self, cols=self.rows, rows=self.cols, dies=dies, reference=reference, **sides)

    def on(self, dies: tuple[DieStatus, ...], notch: Notch = "none") -> dict[Place, MapDie]:
        """Return its dies by the column and row of inspected dies.

        Dies correspond by die 0,0 if the map states it, else by their outermost columns and rows.

        Parameters
        ----------
        dies : tuple of DieStatus
            The inspected dies.
        notch : {"none", "up", "down", "left", "right"}
            Side of the notch of the inspected wafer.

        Returns
        -------
        dict of MapDie
            The dies of the map by (column, row).

        Raises
        ------
        DatasetError
            If columns or rows are not as many.
        """
        turned = self.turned(notch)
        cols, rows = (sorted({getattr(die, name) for die in dies}) for name in ("col", "row"))
        if turned.reference is not None:
            away = turned.reference
        elif (turned.cols, turned.rows) == (cols[-1] - cols[0] + 1, rows[-1] - rows[0] + 1):
            away = -cols[0], -rows[0]
        else:
            raise DatasetError(
                f"The map has {turned.cols} x {turned.rows} dies and this wafer {cols[-1] - cols[0] + 1} x "
                f"{rows[-1] - rows[0] + 1}, and it does not state which is die 0,0: choose the map of this wafer."
            )
        return {(die.col - away[0], die.row - away[1]): die for die in turned.dies}


def require_notch(notch: Notch) -> None:
    """Raise DatasetError for a notch that is not known: a wafer map shows nothing without it."""
    if notch == "none":
        raise DatasetError("A wafer map states the side of the notch, and it is not known: give it (--notch).")
