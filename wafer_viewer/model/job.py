"""A job, prepared once by an engineer and run by operators; its verdict, its trial, and users' annotations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Annotated, ClassVar, Literal

import msgspec

from wafer_viewer.model.acquisition.plan import Field, FieldGrid, FocusSweep, FollowFocus
from wafer_viewer.model.acquisition.sample import Alignment, Marks, Sample
from wafer_viewer.model.errors import DatasetError, MeasureError, WaferViewerError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.feature import Dies, Feature
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.quantity import Quantity, Word
from wafer_viewer.model.spec import Positive, Setting, Spec, Within
from wafer_viewer.model.surface.recipe import Recipe

Compression = Literal["none", "zstd", "deflate", "jpeg2000"]
"""Lossless compression of the frames of a dataset."""
_COMPRESSION = Setting(
    "Frames on disk",
    "Lossless, field by field after reconstruction: zstd is the fastest to read, JPEG 2000 the smallest and slowest, "
    "deflate opens in most programs",
    titles={
        "none": "Uncompressed",
        "zstd": "Compressed, zstd",
        "deflate": "Compressed, deflate",
        "jpeg2000": "Compressed, JPEG 2000",
    },
)


class Job(Spec, frozen=True, kw_only=True):
    """Complete definition of a job: the file ``PLAN.toml``.

    Either `grid` or `fields` gives the positions, in wafer um if `marks` are given for alignment, else in stage um;
    `strategy` is a strategy of the planner or ``auto``; with `follow_focus` also that of the windows that follow the
    focus. `objective` and `zoom`, where given, are those that the plan was made for. `alignment` applies to the wafer
    now on the stage. Features measured per die are repeated on `dies`. `compression` is that of the frames after their
    reconstruction.
    """

    product: str = ""
    revision: str = ""
    sample: Sample = Sample()
    grid: FieldGrid | None = None
    fields: tuple[Field, ...] = ()
    z_start_um: float = 0.0
    sweep: FocusSweep
    exposures_us: tuple[Positive, ...] = (100.0,)
    light_fraction: Annotated[float, Within(0, 1)] = 1.0
    objective: str = ""
    zoom: Positive | None = None
    strategy: str = "auto"
    follow_focus: FollowFocus | None = None
    recipe: Recipe = Recipe()
    marks: Marks | None = None
    alignment: Alignment | None = None
    features: tuple[Feature, ...] = ()
    dies: Dies | None = None
    defect_sensitivity: Positive = 5.0
    compression: Annotated[Compression, _COMPRESSION] = "none"
    released: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.grid is None) == (not self.fields):
            self.refuse("grid", "given, or else a list of fields, not both")
        if not self.exposures_us:
            self.refuse("exposures_us", "at least one exposure time")
        if self.released and self.recipe.has_auto:
            self.refuse("released", "false as long as the recipe holds an 'auto'")
        if self.released and self.strategy == "auto":
            self.refuse("released", "false as long as the strategy is 'auto'")
        if self.dies is None and any(feature.per_die for feature in self.features):
            self.refuse("dies", "given where a feature is measured per die")
        if self.alignment is not None and self.marks is None:
            self.refuse("alignment", "left out where there are no marks to align by")

    def all_fields(self) -> tuple[Field, ...]:
        """Return the fields from the grid or as listed, in stage coordinates of the aligned wafer."""
        fields = self.fields if self.grid is None else self.grid.fields(self.z_start_um)
        return fields if self.alignment is None else tuple(_on_stage(field, self.alignment) for field in fields)


def _on_stage(field: Field, alignment: Alignment) -> Field:
    x_um, y_um = alignment.to_stage(field.x_um, field.y_um)
    return msgspec.structs.replace(field, x_um=x_um, y_um=y_um)


_AFTER_THE_SCAN = frozenset(("recipe", "features", "dies", "defect_sensitivity", "compression"))
"""Settings of a job for what is made of its frames, which do not depend on them."""


def changed_settings(job: Job, other: Job) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the settings that differ: those that frames depend on or belong to, and the others."""
    differ = [name for name in job.__struct_fields__ if getattr(job, name) != getattr(other, name)]
    of_frames = tuple(name for name in differ if name not in _AFTER_THE_SCAN)
    return of_frames, tuple(name for name in differ if name in _AFTER_THE_SCAN)


class VerdictChange(Spec, frozen=True, kw_only=True):
    """A feature whose verdict changes. before: None if it was not judged; after: None if it is no longer judged."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    feature: str
    before: Word | None = None
    after: Word | None = None
    measured_before: Quantity | None = None
    measured_after: Quantity | None = None
    why: tuple[str, ...]


class TriedWafer(Spec, frozen=True, kw_only=True):
    """Verdict on a wafer by the job, with its previous verdict.

    result: reconstruction that was judged; n_same: number of features with an unchanged verdict.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    dataset: str
    wafer_id: str = ""
    result: str
    before: Word | None = None
    after: Word
    changes: tuple[VerdictChange, ...] = ()
    n_same: int = 0


class NotTried(Spec, frozen=True, kw_only=True):
    """A dataset that could not be judged by the job, with the reason."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    dataset: str
    why: str


class Trial(Spec, frozen=True, kw_only=True):
    """Result of a trial of a job on stored datasets."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    job: str
    wafers: tuple[TriedWafer, ...] = ()
    not_tried: tuple[NotTried, ...] = ()

    @property
    def n_changes(self) -> int:
        """Number of changed verdicts on features, over all wafers."""
        return sum(len(wafer.changes) for wafer in self.wafers)

    @property
    def summary(self) -> str:
        """Summary in one sentence."""
        turned = sum(wafer.before != wafer.after for wafer in self.wafers)
        n_verdicts = self.n_changes + sum(wafer.n_same for wafer in self.wafers)
        verdicts = _changing(self.n_changes, n_verdicts, "verdict", "changes", "change")
        wafers = _changing(turned, len(self.wafers), "wafer", "gets another word", "get another word")
        not_judged = f", {_count(len(self.not_tried), 'dataset')} not judged" if self.not_tried else ""
        return f"{verdicts[:1].upper()}{verdicts[1:]}; {wafers}{not_judged}."


def _changing(n: int, total: int, noun: str, one: str, many: str) -> str:
    return f"{n} of {_count(total, noun)} {one if n == 1 else many}" if n else f"no {noun} of {total} {one}"


def _count(n: int, word: str) -> str:
    return f"{n} {word}{'' if n == 1 else 's'}"


GRAVEST: tuple[Word, ...] = ("fail", "no verdict", "inconclusive", "pass")
"""Verdicts by severity: a die or wafer gets the first of these that any of its features has."""


class FeatureVerdict(Spec, frozen=True, kw_only=True, omit_defaults=True):
    """Verdict on one feature: measured value, outcome and the sentence with the reason. measured: None if not measured.

    die: name of the die that it was measured on, for a feature repeated over dies; not_evaluated: contributions missing
    from the uncertainty.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    feature: Feature
    die: str = ""
    measured: Quantity | None = None
    not_evaluated: tuple[str, ...] = ()
    word: Word
    why: str

    @property
    def name(self) -> str:
        """Name of the feature, with the die that it was measured on."""
        return f"{self.feature.name}, die {self.die}" if self.die else self.feature.name


class JudgedDie(Spec, frozen=True, kw_only=True):
    """A die with its verdict, its lower left corner on the wafer and its size."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: str
    x_um: float
    y_um: float
    width_um: float
    height_um: float
    word: Word


class WaferVerdict(Spec, frozen=True, kw_only=True):
    """Verdict on a wafer, the next action, and every feature and die: the file ``verdict.json`` of a reconstruction.

    job: product and revision; surface: mark of the surface that was measured.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    word: Word
    next: str
    items: tuple[FeatureVerdict, ...] = ()
    dies: tuple[JudgedDie, ...] = ()
    job: str = ""
    lot: str = ""
    wafer_id: str = ""
    released: bool = False
    simulated: bool = False
    residual_um: float | None = None
    surface: str = ""

    @property
    def die_counts(self) -> dict[Word, int]:
        """Number of dies per verdict, the most severe first; without verdicts that no die has."""
        counts = Counter(die.word for die in self.dies)
        return {word: counts[word] for word in GRAVEST if counts[word]}


Verdict = Literal["open", "accepted", "rejected"]
Place = tuple[float, float, float]


class SavedView(Spec, frozen=True, kw_only=True):
    """A saved view of the surface: camera position and target in mm of the scene, and display settings.

    number: its position in the list, from 1. look, colour_by and colours are the page's names for these settings.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    number: int = 0
    name: str = ""
    position_mm: Place
    look_at_mm: Place
    look: str = "surface"
    colour_by: str = "height"
    colours: str = "mako"
    range_um: tuple[float, float] | None = None
    exaggeration: Positive = 3.0
    hillshade: float = 0.8
    all_in_focus: float = 0.0
    show: int = 0
    levelling: Levelling = Levelling()


class Judgement(Spec, frozen=True, kw_only=True):
    """A user's judgement on an item under review; `key` names the item, ``result 3`` or ``feature pad``."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    key: str
    verdict: Verdict = "open"
    note: str = ""


def key_of_result(number: int) -> str:
    """Return the key of the result with a number."""
    return f"result {number}"


def keys_of_features(verdict: WaferVerdict | None) -> tuple[str, ...]:
    """Return the keys of the features of a verdict, in its order; repeated names are numbered."""
    counts: Counter[str] = Counter()
    keys: list[str] = []
    for name in (item.name for item in (verdict.items if verdict is not None else ())):
        counts[name] += 1
        keys.append(f"feature {name}" if counts[name] == 1 else f"feature {name} ({counts[name]})")
    return tuple(keys)


def keys_under_review(verdict: WaferVerdict | None, findings: Iterable[AnyResult]) -> tuple[str, ...]:
    """Return the keys of everything under review: the features of the verdict and the stored results."""
    return (*keys_of_features(verdict), *(key_of_result(finding.number) for finding in findings))


class Notebook(Spec, frozen=True, kw_only=True):
    """The file ``notebook.json`` of one reconstruction."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    views: tuple[SavedView, ...] = ()
    judgements: tuple[Judgement, ...] = ()

    def view(self, number: int) -> SavedView | None:
        """Return the saved view with a number, or None."""
        return next((view for view in self.views if view.number == number), None)

    def judgement(self, key: str) -> Judgement:
        """Return the judgement on an item; open if there is none."""
        return next((j for j in self.judgements if j.key == key), Judgement(key=key))

    def judged(self, keys: Iterable[str]) -> int:
        """Return how many of the keys are accepted or rejected."""
        return sum(self.judgement(key).verdict != "open" for key in keys)
