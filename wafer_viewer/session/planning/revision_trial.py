"""Released jobs: their commands, on the command line too, and the trial of a revision on stored datasets.

If only limits changed, the stored measurements are judged again. If a region or the tool changed, the stored surface is
measured again. If the recipe changed, the frames are reconstructed into a separate result. Existing data are never
overwritten.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wafer_viewer.model.errors import ComputeError, DatasetError, DiskFullError, MeasureError, PlanError
from wafer_viewer.model.file_contents import DATASET_ENDING
from wafer_viewer.model.job import (
    FeatureVerdict,
    Job,
    NotTried,
    Trial,
    TriedWafer,
    VerdictChange,
    WaferVerdict,
    changed_settings,
)
from wafer_viewer.model.measurement.feature import DecisionRule, Die, Feature, limits_text
from wafer_viewer.model.measurement.tools import TOOLS, ToolOptions
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.spec import Spec
from wafer_viewer.model.spec import replace as replace_in
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.core.background_work import BackgroundWork
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import command, forwarded
from wafer_viewer.session.core.dataset_library import DEFAULT_RESULT, load_summary, today
from wafer_viewer.session.planning.job_releases import (
    as_released,
    for_next_wafer,
    free_place,
    list_released,
    prepared,
    read_job,
    released,
    revised,
)
from wafer_viewer.session.planning.plan_editor import PlanEditor
from wafer_viewer.session.planning.verdicts import stored_verdict, verdict_of
from wafer_viewer.session.state.snapshot import Snapshot
from wafer_viewer.session.surface.headless import LocalOrCluster, make_surface
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.lock import Lock
from wafer_viewer.store.dataset.result import Result
from wafer_viewer.store.dataset.scan_record import RECORD

if TYPE_CHECKING:
    from wafer_viewer.compute.task_runner import TaskRunner


# --------------------------------------------------------------------------------------------------------- job commands


NEXT = "next"
"""Revision name of a plan that has none yet."""


def _plan(jobs: JobController) -> PlanEditor:
    return jobs._plan_editor


class JobController:
    """Controller of released jobs, ``session.jobs``; every command returns a future."""

    take_up = forwarded(PlanEditor.load, _plan)
    copy = forwarded(PlanEditor.copy, _plan)
    confirm = forwarded(PlanEditor.confirm, _plan)
    mark = forwarded(PlanEditor.mark, _plan)
    unmark = forwarded(PlanEditor.unmark, _plan)
    next_wafer = forwarded(PlanEditor.next_wafer, _plan)

    def __init__(self, command_queue: CommandQueue, plan_editor: PlanEditor, folder: Path) -> None:
        self._command_queue, self._plan_editor, self._folder = command_queue, plan_editor, folder

    @command
    def refresh(self) -> None:
        """List the released jobs again."""
        self._command_queue.change(
            operating=replace(self._command_queue.now.operating, jobs=list_released(self._folder))
        )

    @command.audited("Job released")
    def release(self, why: str = "") -> Path:
        """Release the plan under its product and revision; ``auto`` gets the values resolved for the open surface.

        why: reason, which is needed where people are listed. Raises PlanError with the missing parts.
        """
        self._command_queue.now.control.require_reason(why)
        path = self._plan_editor.release(*settled_by(self._command_queue.now))
        self.refresh.run()
        return path


def settled_by(now: Snapshot) -> tuple[Recipe | None, tuple[float, float] | None]:
    """Return the resolved recipe of the displayed surface, and the stage errors in the plane and along z.

    Each is None if it is unknown.
    """
    surface = now.surface
    stitched = surface.stitching if surface is not None else None
    errors_um = (stitched.stage_error_um, stitched.z_error_um) if stitched is not None else None
    return surface.settled if surface is not None else None, errors_um


class TrialController:
    """Controller of the trial, ``session.trials``."""

    def __init__(self, command_queue: CommandQueue, background: BackgroundWork, plan_editor: PlanEditor) -> None:
        self._command_queue, self._background, self._plan_editor = command_queue, background, plan_editor

    @command
    def begin(self, paths: tuple[Path, ...], result: str = DEFAULT_RESULT) -> Future[Trial]:
        """Judge stored datasets, and folders of them, by the plan as it would be released.

        The work can be cancelled. Raises PlanError if the plan could not be released yet.
        """
        if self._command_queue.now.operating.trying:
            raise PlanError("The plan is being tried already: wait for it, or cancel it in the job list.")
        job, plan = self._plan_editor.ready()
        job = as_released(
            replace_in(job, revision=job.revision.strip() or NEXT), plan, *settled_by(self._command_queue.now)
        )
        datasets = datasets_of([Path(path) for path in paths])
        title = f"Trial of {job.product} {job.revision}".strip()
        self._show(trial=None, trial_of=self._command_queue.now.draft.job, trying=True)
        return self._background.lead(title, try_job, job, datasets, result, ended=self._ended).done

    def _ended(self, done: Future[Trial]) -> None:
        failed = done.cancelled() or done.exception() is not None
        self._show(trial=None if failed else done.result(), trying=False)

    def _show(self, **changes: Any) -> None:
        self._command_queue.change(operating=replace(self._command_queue.now.operating, **changes))


# ------------------------------------------------------------------------------------------------------- revision trial


RULES: dict[DecisionRule, str] = {"guard_band": "guard band", "simple_acceptance": "simple acceptance"}
NOTHING_DIFFERS = "Nothing of the feature differs: it was measured again with today's calibration."


def added(judged_before: bool) -> str:
    """Return the reason for a new verdict."""
    return "The feature is new." if judged_before else "The wafer was not judged before."


def taken_off(then: FeatureVerdict, job: Job) -> str:
    """Return the reason for a missing verdict."""
    still = any(feature.name == then.feature.name for feature in job.features)
    return f"The job does not have die {then.die} any more." if still and then.die else "The feature is taken off."


def feature_changes(then: FeatureVerdict, now: FeatureVerdict, other_dies: bool) -> tuple[str, ...]:
    """Return the changes of a feature, one sentence each."""
    sentences = tuple(_of_feature(then, now, other_dies))
    return sentences or (() if then.measured == now.measured else (NOTHING_DIFFERS,))


def recipe_changes(made_by: Recipe, wanted: Recipe) -> tuple[str, ...]:
    """Return the recipe settings that differ from those a surface was made with; ``auto`` matches any value."""
    return tuple(f"Recipe: {words}." for words in _settings(made_by, wanted, ""))


def _of_feature(then: FeatureVerdict, now: FeatureVerdict, other_dies: bool) -> Iterator[str]:
    old, new = then.feature, now.feature
    if (old.lower_limit, old.upper_limit, old.unit) != (new.lower_limit, new.upper_limit, new.unit):
        yield f"Limits: {limits_text(old)} before, {limits_text(new)} now."
    if old.decision_rule != new.decision_rule:
        yield f"Decision rule: {RULES[old.decision_rule]} before, {RULES[new.decision_rule]} now."
    if old.tool != new.tool:
        yield f"Tool: {TOOLS[old.tool].title} before, {TOOLS[new.tool].title} now."
    if old.quantity != new.quantity:
        yield f"Quantity: {old.quantity or 'the main one'} before, {new.quantity or 'the main one'} now."
    if (old.places, old.per_die) != (new.places, new.per_die) or (now.die and other_dies):
        yield "Place: another one; measured again."
    if old.tool == new.tool and (old.options or ToolOptions()) != (new.options or ToolOptions()):
        yield from (f"Option: {words}." for words in _settings(_own(old), _own(new), ""))


def _own(feature: object) -> Spec:
    options = getattr(feature, "options", None) or ToolOptions()
    return getattr(options, getattr(feature, "tool", ""), options)


def _settings(old: Spec, new: Spec, before: str) -> Iterator[str]:
    for name in new.__struct_fields__:
        was, now = getattr(old, name, None), getattr(new, name)
        words = f"{before}{name.replace('_', ' ')}"
        if isinstance(was, Spec) and isinstance(now, Spec):
            yield from _settings(was, now, f"{words}, ")
        elif was != now and "auto" not in (was, now):
            yield f"{words} {_value(was)} before, {_value(now)} now"


def _value(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else "nothing" if value is None else f"{value}".replace("_", " ")


Key = tuple[str, str]
"""Names of a feature and its die."""


def datasets_of(paths: Sequence[Path]) -> tuple[Path, ...]:
    """Return the named datasets, and those in named folders. Raises DatasetError if there is none."""
    found: list[Path] = []
    for path in paths:
        if path.suffix == DATASET_ENDING:
            found.append(path)
        else:
            found += sorted(path.glob(f"*{DATASET_ENDING}"))
    if not found:
        names = ", ".join(str(path) for path in paths)
        raise DatasetError(f"There is no dataset in {names}: name folders that hold some, or datasets.")
    return tuple(dict.fromkeys(path.absolute() for path in found))


def try_job(
    job: Job,
    datasets: Sequence[Path],
    result: str = DEFAULT_RESULT,
    *,
    crew: TaskRunner | None = None,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Trial:
    """Judge stored datasets by a job, and compare each verdict with the existing one.

    result: the reconstruction to be judged. crew: runner of the reconstruction, by default this process. A dataset that
    cannot be judged is listed with the reason. Raises ComputeError when the work is stopped.
    """
    wafers, not_tried = list[TriedWafer](), list[NotTried]()
    for n, path in enumerate(datasets):
        tell = partial(_tell, progress, should_stop, n, len(datasets))
        tell(0.0)
        try:
            wafers.append(_tried(job, path, result, _Led(runner=crew) if crew is not None else LocalOrCluster(), tell))
        except (ComputeError, DatasetError, MeasureError) as fault:
            if should_stop():
                raise
            not_tried.append(NotTried(dataset=path.name, why=str(fault)))
    progress(1.0)
    return Trial(job=f"{job.product} {job.revision}".strip(), wafers=tuple(wafers), not_tried=tuple(not_tried))


@dataclass(frozen=True, slots=True)
class _Led(LocalOrCluster):
    """Runner factory that returns an existing task runner."""

    runner: TaskRunner | None = None

    def crew(self, work_bytes: float) -> AbstractContextManager[TaskRunner]:
        """Return the existing runner, whatever the amount of work."""
        return nullcontext(self.runner) if self.runner is not None else LocalOrCluster.crew(self, work_bytes)


@dataclass(frozen=True, slots=True)
class _Before:
    """Earlier verdicts of a dataset: by feature and die, with their surface, and the dies by name."""

    job: Job
    stored: Result
    surface: Mosaic
    items: dict[Key, FeatureVerdict]
    dies: dict[str, Die]


def _tried(job: Job, path: Path, result: str, hire: LocalOrCluster, tell: Progress) -> TriedWafer:
    from wafer_viewer.measure.verdict import overall

    data = Dataset.open(path)
    _require_judgeable(data, job)
    before = _judged_before(data, result)
    of_recipe = recipe_changes(before.surface.provenance.recipe, job.recipe)
    stored = _remade(data, job, hire, tell) if of_recipe else before.stored
    after = {_key(item): item for item in _judged_now(data, job, before, stored, bool(of_recipe))}
    changes = tuple(_changes(before, after, job, of_recipe))
    return TriedWafer(
        dataset=path.name,
        wafer_id=data.scan.job.sample.wafer_id or data.scan.job.sample.name,
        result=stored.name,
        before=overall(tuple(before.items.values())) if before.items else None,
        after=overall(tuple(after.values())),
        changes=changes,
        n_same=len(before.items.keys() | after.keys()) - len(changes),
    )


def _require_judgeable(data: Dataset, job: Job) -> None:
    """Raise MeasureError if the job does not fit the wafer in a dataset, or its regions cannot be located there."""
    then = data.scan.job
    if then.product.strip() and then.product.strip() != job.product.strip():
        raise MeasureError(f"It is of the product '{then.product}', and the job of '{job.product}'.")
    if job.marks is not None and then.alignment is None:
        raise MeasureError("The wafer was not aligned, and the places of the job are in wafer um.")


def _judged_before(data: Dataset, result: str) -> _Before:
    """Return the stored verdicts of this very surface; if there are none, those by its own job."""
    from wafer_viewer.measure.verdict import judge_features

    stored, job = data.result(result), data.scan.job
    surface, verdict = stored.mosaic(), stored_verdict(data, stored)
    items = (
        verdict.items
        if verdict is not None
        else judge_features(surface, job.features, job.alignment, calibration_valid=_calibrated(data), dies=job.dies)
    )
    dies = {die.name: die for die in job.dies.all()} if job.dies is not None else {}
    return _Before(job, stored, surface, {_key(item): item for item in items}, dies)


def _judged_now(data: Dataset, job: Job, before: _Before, stored: Result, remade: bool) -> Iterator[FeatureVerdict]:
    """Yield the verdict of every feature by the new job, from the stored value if it still applies, else remeasured."""
    from wafer_viewer.measure.verdict import judge, judge_at, not_judged

    surface = stored.mosaic() if remade else before.surface
    alignment = data.scan.job.alignment if job.marks is not None else None
    for feature, die in judged_places(job):
        then = before.items.get((feature.name, die.name if die else ""))
        if then is not None and then.measured is not None and not remade and _same_number(then, before, feature, die):
            yield replace_in(judge(feature, then.measured), die=then.die, not_evaluated=then.not_evaluated)
        else:
            yield judge_at(surface, feature, die, alignment, _calibrated(data))
    yield from not_judged(job.features, job.dies)


def _same_number(then: FeatureVerdict, before: _Before, feature: Feature, die: Die | None) -> bool:
    """Return whether the stored value measures the same as the feature does now."""
    return then.feature.measures == feature.measures and before.dies.get(then.die) == die


def judged_places(job: Job) -> Iterator[tuple[Feature, Die | None]]:
    """Yield every feature that is judged individually, with each die that it is repeated on."""
    for feature in job.features:
        if feature.has_place and not feature.per_die:
            yield feature, None
        elif feature.has_place and job.dies is not None:
            yield from ((feature, die) for die in job.dies.all())


def _changes(
    before: _Before, after: dict[Key, FeatureVerdict], job: Job, recipe: tuple[str, ...]
) -> Iterator[VerdictChange]:
    """Yield the features with changed verdicts, in the order of the job; removed ones last."""
    for key, now in after.items():
        then = before.items.get(key)
        if then is None:
            yield VerdictChange(
                feature=now.name, after=now.word, measured_after=now.measured, why=(added(bool(before.items)),)
            )
        elif then.word != now.word:
            yield VerdictChange(
                feature=now.name,
                before=then.word,
                after=now.word,
                measured_before=then.measured,
                measured_after=now.measured,
                why=(*feature_changes(then, now, before.job.dies != job.dies), *recipe),
            )
    for key, then in before.items.items():
        if key not in after:
            why = (taken_off(then, job),)
            yield VerdictChange(feature=then.name, before=then.word, measured_before=then.measured, why=why)


def _remade(data: Dataset, job: Job, hire: LocalOrCluster, tell: Progress) -> Result:
    """Return the result with the job's recipe: reconstructed into a separate result, or an existing one."""
    faults: list[str] = []
    name = _free_result(data, job)
    make_surface(data.path, job.recipe, name, again=False, tell=tell, warn=faults.append, hire=hire)
    return data.result(name)


def _free_result(data: Dataset, job: Job) -> str:
    """Return a result name that no other recipe uses."""
    plain = "".join(c if c.isalnum() or c in ".+-_" else "-" for c in job.revision.strip()) or "next"
    wishes = (f"revision {plain}" if n == 1 else f"revision {plain} {n}" for n in count(1))
    return next(name for name in wishes if not (made := data.result(name)).exists or made.recipe() == job.recipe)


def _calibrated(data: Dataset) -> bool:
    return data.calibration_problem(today()) is None


def _key(item: FeatureVerdict) -> Key:
    return item.feature.name, item.die


def _tell(progress: Progress, should_stop: ShouldStop, n: int, total: int, share: float) -> None:
    """Report the overall progress; raises ComputeError when the trial is to stop."""
    if should_stop():
        raise ComputeError(f"The trial was stopped at dataset {n + 1} of {total}; nothing was released.")
    progress((n + share) / total)


# ------------------------------------------------------------------------------------------------------------- headless


def job_to_release(plan: Path, names: dict[str, str | None], good: Path | None, result: str, folder: Path) -> Job:
    """Return the job of a plan as it would be released in `folder`/jobs; a good sample's dataset resolves ``auto``.

    names: product and revision, if they differ from those of the plan. Raises PlanError with the missing parts, or if
    that revision is already released; DatasetError if the dataset has no stitched surface.
    """
    job = read_job(plan)
    job = replace_in(job, released=False, **{key: name for key, name in names.items() if name is not None})
    ready = revised(job) if good is None else _settled(job, Dataset.open(good), result)
    free_place(folder, ready)
    return ready


def tried(job: Job, against: Sequence[Path], result: str, tell: Progress) -> Trial:
    """Return the trial of a job on stored datasets, and on those in folders."""
    return try_job(job, datasets_of(against), result, progress=tell)


def _settled(job: Job, data: Dataset, result: str) -> Job:
    """Return the job with the resolved recipe of a dataset."""
    stored = data.result(result)
    settled, info = stored.mosaic().provenance.recipe, load_summary(stored)
    stitched = info.stitching if info is not None else None
    errors_um = (stitched.stage_error_um, stitched.z_error_um) if stitched is not None else None
    return released(job, data.scan.plan, settled, errors_um)


def job_of_wafer(plan: Path, out: Path, names: dict[str, str | None], corners_um: Sequence[float]) -> Job:
    """Return the job in a file for one wafer, with its names and aligned by its corners.

    corners_um: measured x and y of each corner in order. A dataset that is continued has both already. Raises PlanError
    for corners that give no alignment.
    """
    job = read_job(plan)
    given = {key: name for key, name in names.items() if name is not None}
    if out.exists() and not given and not corners_um and _is_of(out, job):
        return Dataset.open(out).scan.job
    job = replace_in(job, sample=replace_in(job.sample, **given))
    return _aligned(job, corners_um) if corners_um else job


def stored_verdict_of(path: Path, result: str) -> WaferVerdict:
    """Return the verdict on the wafer of a dataset; it is stored in the dataset unless another process holds that.

    Raises DiskFullError when there is no space to store it.
    """
    data = Dataset.open(path.absolute())
    try:
        lock = Lock.take(data.path)
    except DiskFullError:
        raise
    except DatasetError:
        return verdict_of(data, data.result(result), keep=False)
    try:
        return verdict_of(data, data.result(result), keep=True)
    finally:
        lock.release()


def _is_of(out: Path, job: Job) -> bool:
    if not (job.released and (out / RECORD).exists()):
        return False
    begun: Any = Dataset.open(out).scan.job
    return not changed_settings(prepared(begun), prepared(for_next_wafer(job)))[0]


def _aligned(job: Job, corners_um: Sequence[float]) -> Job:
    from wafer_viewer.calibrate.wafer_alignment import fit_alignment

    if job.marks is None:
        raise PlanError("The plan names no corners to align by: leave --corners out, or name them in the plan.")
    if len(corners_um) % 2:
        raise PlanError(f"--corners has {len(corners_um)} numbers: give x and y of each corner.")
    marked_um = list(zip(corners_um[::2], corners_um[1::2], strict=True))
    return replace_in(job, alignment=fit_alignment(job.marks, marked_um, job.sample.notch))
