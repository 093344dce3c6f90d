"""Order of image files by their names: numbers with signs and decimals, z in um, rollovers, gaps, copies and strangers.

Names that number their frames share a template, such as ``z#um.png``. The largest group of one template is the stack;
what else is there is named. What the names leave open is an error that names the flag which settles it.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.atomic_files import natural_sort_key

_NUMBER = re.compile(r"(?<![\d.,])\d+[.,]\d+(?![.,]?\d)|\d+")
"""A number with decimals, which no further point follows as in a date, or digits."""
_SIGNS = "+-\u2212\u2013"
_UNIT_UM = {"um": 1.0, "µm": 1.0, "μm": 1.0, "mic": 1.0, "mm": 1e3, "nm": 1e-3}
_UNIT = re.compile(r"\s*(um|µm|μm|mic|mm|nm)(?![a-z])", re.IGNORECASE)
_Z_BEFORE = re.compile(r"(?:^|[^a-z])z[\s_=]*$", re.IGNORECASE)
_COPY = re.compile(r"[\s_-]*(\(\d+\)|copy|kopie|copia)(\s*\d+)?$", re.IGNORECASE)
_RESULT = re.compile(
    r"output|result|fused|fusion|stacked|edf|all.?in.?focus|merged|depth.?map|height.?map|mosaic|overview|thumb",
    re.IGNORECASE,
)
FEW_STRANGERS, MOST_STRANGERS = 2, 0.25
"""Files with other names that are left out with a note, as a number and as a share; more are a second series."""
MOST_MISSING = 0.25
"""Largest share of missing numbers that are gaps of one stack; more are numbers that count something else."""
COUNTER_SHARE = 0.6
"""Least share of equal steps between numbers that count frames; times of the day differ at every step."""
_ROLLOVER_DIGITS = 3
_LISTED = "Give the files one by one in their order with --as-listed"


@dataclass(frozen=True, slots=True)
class FrameOrder:
    """Files in the order of their frames, None where a number is missing.

    z_um: z of each file by its name, as long as `files`; None without.
    left_out: files that are no frames. notes: one sentence each on what was found.
    """

    files: tuple[Path | None, ...]
    z_um: tuple[float, ...] | None = None
    left_out: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _Token:
    """Number in a name. sign: the character before it, if it may be one."""

    digits: str
    sign: str

    @property
    def value(self) -> float:
        return float(self.digits.replace(",", "."))

    @property
    def is_whole(self) -> bool:
        return self.digits.isdigit()


@dataclass(frozen=True, slots=True)
class _Name:
    path: Path
    texts: tuple[str, ...]
    """What stands between the numbers, one more than these."""
    tokens: tuple[_Token, ...]

    @property
    def template(self) -> tuple[str, ...]:
        return (*(text.casefold() for text in self.texts), self.path.suffix.lower())


Clock = Mapping[Path, str]
"""When each file was taken, ISO 8601, where it says so."""


def frame_order(files: Sequence[Path], *, listed: bool, clock: Clock = MappingProxyType({})) -> FrameOrder:
    """Return the order of image files by their names.

    Parameters
    ----------
    files : sequence of Path
        The files of a folder, or those that the user has listed, in the order given.
    listed : bool
        The user has listed them: their order holds, unless it is the alphabetical one that a shell gives.
    clock : mapping of Path to str, default {}
        When files were taken, ISO 8601: tells whether the numbers of a camera began anew.

    Returns
    -------
    FrameOrder
        All files that belong together, in order.

    Raises
    ------
    DatasetError
        When there are two series or two files for a frame, or the names number two things.
    """
    in_order = sorted(files, key=lambda path: natural_sort_key(path.name))
    alphabetical = (in_order, sorted(files), sorted(files, key=lambda path: path.name))
    if listed and list(files) not in alphabetical and not _rise_in_z(files):
        return FrameOrder(tuple(files), notes=())
    names = [_parsed(path) for path in in_order]
    series, left_out, notes = _one_series(names)
    column, notes_of_order = _numbering_column(series)
    ordered = _by_column(series, column, clock)
    return FrameOrder(ordered.files, ordered.z_um, tuple(left_out), (*notes, *notes_of_order, *ordered.notes))


def _parsed(path: Path) -> _Name:
    texts, tokens, end = list[str](), list[_Token](), 0
    for match in _NUMBER.finditer(path.stem):
        before = path.stem[end : match.start()]
        sign = before[-1:] if before[-1:] in _SIGNS and before[-1:] else ""
        texts.append(before[: len(before) - len(sign)])
        tokens.append(_Token(match[0], sign))
        end = match.end()
    return _Name(path, (*texts, path.stem[end:]), tuple(tokens))


def _rise_in_z(files: Sequence[Path]) -> bool:
    """Return whether listed names say their z, which rises along the list, or falls if it has a unit."""
    series = [_parsed(path) for path in files]
    if len({name.template for name in series}) > 1:
        return False
    columns = [n for n in range(len(series[0].tokens)) if _all_differ(series, n) and _is_z(series, n)]
    if len(columns) != 1:
        return False
    values = [_value(name, columns[0], signed=_is_signed(series, columns[0])) for name in series]
    has_unit = _UNIT.match(series[0].texts[columns[0] + 1]) is not None
    return values == sorted(values) or (has_unit and values == sorted(values, reverse=True))


# --- one series


def _one_series(names: list[_Name]) -> tuple[list[_Name], list[Path], list[str]]:
    """Return the names of the stack, the files left out, and why. Raises DatasetError for twins and two series."""
    groups: dict[tuple[str, ...], list[_Name]] = defaultdict(list)
    for name in names:
        groups[name.template].append(name)
    by_size = sorted(groups.values(), key=lambda group: (-len(group), not group[0].tokens))
    main = by_size[0]
    if len(main) == 1 or not main[0].tokens:  # nothing is numbered
        _refuse_twins([], names)
        return names, [], []
    others = [name for group in by_size[1:] for name in group]
    first = _without_number(others, main)
    if first is not None:
        others.remove(first)
        main = [_numbered(first, main), *main]
    copies = [name for name in others if _copied(name, main) is not None]
    _refuse_other_copies(copies, main)
    strangers = [name for name in others if name not in copies]
    _refuse_twins(strangers, main)
    second = next((group for group in by_size[1:] if group[0] in strangers), [])
    if len(second) > FEW_STRANGERS or len(strangers) > max(FEW_STRANGERS, MOST_STRANGERS * len(main)):
        raise DatasetError(
            f"The folder holds two series of images: {len(main)} named like {main[0].path.name}, and {len(second)} "
            f"like {second[0].path.name}. Say which to take, as in --only '{_glob(main)}'."
        )
    notes: list[str] = []
    if copies:
        notes.append(f"{_listing(copies)} left out: the same image as the file without the mark of a copy.")
    for stranger in strangers:
        kind = "named as a result, not as a frame" if _RESULT.search(stranger.path.stem) else "not named as the others"
        notes.append(f"{stranger.path.name} was left out: it is {kind}, such as {main[0].path.name}.")
    return main, [name.path for name in (*copies, *strangers)], notes


def _without_number(others: list[_Name], main: list[_Name]) -> _Name | None:
    """Return the file that is named as the frames but for the number, which begins after it: pic, pic (1), pic (2)."""
    if len(main[0].tokens) != 1 or min(name.tokens[0].value for name in main) not in (1, 2):
        return None
    stem = f"{main[0].texts[0].rstrip(' (_-')}{main[0].texts[1].lstrip(')')}".casefold()
    found = [one for one in others if one.path.stem.casefold() == stem and one.template[-1] == main[0].template[-1]]
    return found[0] if len(found) == 1 and stem else None


def _numbered(first: _Name, main: list[_Name]) -> _Name:
    """Return a name without a number as that of the frame before the others."""
    number = int(min(name.tokens[0].value for name in main)) - 1
    return _Name(first.path, main[0].texts, (_Token(str(number), ""),))


def _copied(name: _Name, main: list[_Name]) -> _Name | None:
    """Return the frame that a file is marked as a copy of."""
    stem = _COPY.sub("", name.path.stem)
    if stem == name.path.stem:
        return None
    return next((one for one in main if one.path.stem.casefold() == stem.casefold()), None)


def _refuse_other_copies(copies: list[_Name], main: list[_Name]) -> None:
    for copy in copies:
        original = _copied(copy, main)
        if original is not None and copy.path.read_bytes() != original.path.read_bytes():
            raise DatasetError(
                f"{copy.path.name} is marked as a copy of {original.path.name} and is another image: "
                f"take one out, or say which to take, as in --only '{_glob(main)}'."
            )


def _refuse_twins(others: list[_Name], main: list[_Name]) -> None:
    """Raise DatasetError when files differ from others in their ending alone."""
    by_stem: dict[str, set[str]] = defaultdict(set)
    for name in {*others, *main}:
        by_stem[name.path.stem.casefold()].add(name.path.suffix)
    twins = sorted(stem for stem, suffixes in by_stem.items() if len(suffixes) > 1)
    if twins:
        kinds = sorted({suffix for stem in twins for suffix in by_stem[stem]})
        raise DatasetError(
            f"{len(twins)} images are there twice, as {' and '.join(kinds)}, such as {twins[0]}: say which to take, "
            f"as in --only '*{kinds[-1]}'."
        )


def _glob(names: list[_Name]) -> str:
    """Return a file pattern for names of one template."""
    first = names[0]
    constant = [len({name.tokens[n] for name in names}) == 1 for n in range(len(first.tokens))]
    pieces = [first.texts[0]]
    for n, token in enumerate(first.tokens):
        pieces += [f"{token.sign}{token.digits}" if constant[n] else "*", first.texts[n + 1]]
    return "".join(pieces) + first.path.suffix


def _listing(names: Sequence[_Name]) -> str:
    shown = ", ".join(name.path.name for name in names[:3])
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return f"{shown}{more} {'was' if len(names) == 1 else 'were'}"


# --- the number that counts the frames


def _numbering_column(series: list[_Name]) -> tuple[int | None, list[str]]:
    """Return which number of the names counts the frames; None if no number differs, or they count together.

    Raises DatasetError when the names count two things, such as fields and frames.
    """
    n_columns = len(series[0].tokens)
    if any(len(name.tokens) != n_columns for name in series):
        return None, []
    differing = [n for n in range(n_columns) if len({_signed(name.tokens[n]) for name in series}) > 1]
    in_z = [n for n in differing if _is_z(series, n)]
    if len(in_z) == 1 and _all_differ(series, in_z[0]):
        return in_z[0], []
    if len(differing) <= 1:
        return (differing or [None])[0], []
    _refuse_product(series, differing)
    counting = [n for n in differing if _all_differ(series, n) and _is_monotone(series, n)]
    return (counting[-1] if len(counting) == 1 else None), []


def _refuse_product(series: list[_Name], differing: list[int]) -> None:
    """Raise DatasetError when every value of one number comes with every value of another."""
    for n, one in enumerate(differing):
        for other in differing[n + 1 :]:
            pairs = Counter((name.tokens[one].digits, name.tokens[other].digits) for name in series)
            n_one, n_other = (len({pair[side] for pair in pairs}) for side in (0, 1))
            if min(n_one, n_other) > 1 and len(pairs) == n_one * n_other == len(series):
                first = series[0]
                pattern = _pattern(first, one, other)
                raise DatasetError(
                    f"The names count two things: {n_one} values of the number {one + 1} of {first.path.name}, with "
                    f"{n_other} of the number {other + 1} each. Say which are fields and which frames, as in "
                    f"--pattern '{pattern}', or take one field, as in --only."
                )


def _pattern(name: _Name, one: int, other: int) -> str:
    parts = {one: "{n}", other: "{k}"}
    pieces = [name.texts[0]]
    for n, token in enumerate(name.tokens):
        pieces += [parts.get(n, f"{token.sign}{token.digits}"), name.texts[n + 1]]
    return "".join(pieces) + name.path.suffix


def _signed(token: _Token) -> tuple[str, str]:
    return token.sign, token.digits


def _all_differ(series: list[_Name], column: int) -> bool:
    return len({_signed(name.tokens[column]) for name in series}) == len(series)


def _is_monotone(series: list[_Name], column: int) -> bool:
    """Return whether a number rises or falls in natural order, as hours, minutes and seconds do not."""
    values = [name.tokens[column].value for name in series]
    return values in (sorted(values), sorted(values, reverse=True))


def _is_z(series: list[_Name], column: int) -> bool:
    """Return whether a number is a z: with a unit of length, or after a z with a sign or decimals."""
    if _UNIT.match(series[0].texts[column + 1]) is not None:
        return True
    tokens = [name.tokens[column] for name in series]
    after_z = _Z_BEFORE.search(series[0].texts[column]) is not None
    return after_z and (len({token.sign for token in tokens}) > 1 or not all(token.is_whole for token in tokens))


def _is_signed(series: list[_Name], column: int) -> bool:
    """Return whether the characters before the numbers are signs: they differ, or a length is negative throughout."""
    signs = {name.tokens[column].sign for name in series}
    if len(signs) > 1 or "+" in signs:
        return True
    return signs != {""} and _is_z(series, column) and _Z_BEFORE.search(series[0].texts[column]) is not None


# --- order


def _value(name: _Name, column: int, *, signed: bool) -> float:
    token = name.tokens[column]
    return -token.value if signed and token.sign and token.sign in _SIGNS[1:] else token.value


def _by_column(series: list[_Name], column: int | None, clock: Clock) -> FrameOrder:
    if column is None:
        return FrameOrder(tuple(name.path for name in series))
    signed = _is_signed(series, column)
    values = {name.path: _value(name, column, signed=signed) for name in series}
    if len(set(values.values())) < len(values):
        value, n = Counter(values.values()).most_common(1)[0]
        twins = [path.name for path, own in values.items() if own == value]
        raise DatasetError(
            f"{n} files have the number {value:g}: {', '.join(twins[:3])}. Take all but one out, or {_LISTED.lower()}."
        )
    ordered = sorted(values, key=values.__getitem__)
    unit = _UNIT.match(series[0].texts[column + 1])
    if unit is not None and _is_z(series, column):
        factor = _UNIT_UM[unit[1].lower()]
        return _without_gaps_in_z(ordered, [factor * values[path] for path in ordered])
    whole = all(name.tokens[column].is_whole for name in series)
    if signed or not whole:  # a length in an unknown unit
        return replace(_without_gaps_in_z(ordered, [values[path] for path in ordered], unit=""), z_um=None)
    widths = {len(name.tokens[column].digits) for name in series}
    numbers = [int(values[path]) for path in ordered]
    return _without_gaps(*_rolled(ordered, numbers, widths.pop() if len(widths) == 1 else 0, clock))


def _without_gaps_in_z(ordered: list[Path], z_um: list[float], unit: str = " um") -> FrameOrder:
    """Insert None where a z is missing among even steps; uneven steps stay as they are."""
    steps = [after - before for before, after in pairwise(z_um)]
    step = min(steps, default=0.0)
    counts = [round(one / step) for one in steps] if step > 0 else []
    even = all(abs(one - n * step) <= _EVEN * step for one, n in zip(steps, counts, strict=False))
    n_missing = sum(n - 1 for n in counts)
    if not even or not 0 < n_missing <= MOST_MISSING * len(ordered):
        return FrameOrder(tuple(ordered), tuple(z_um))
    files: list[Path | None] = [ordered[0]]
    filled, missing = [z_um[0]], list[float]()
    for path, before, here, n in zip(ordered[1:], z_um[:-1], z_um[1:], counts, strict=True):
        between = [before + m * (here - before) / n for m in range(1, n)]
        missing += between
        filled += [*between, here]
        files += [None] * (n - 1) + [path]
    shown = ", ".join(f"{z:g}" for z in missing[:5]) + (" ..." if len(missing) > 5 else "")
    note = f"No image is named z {shown}{unit}: its place stays empty."
    return FrameOrder(tuple(files), tuple(filled), notes=(note,))


_EVEN = 0.1


def _rolled(
    ordered: list[Path], numbers: list[int], width: int, clock: Clock
) -> tuple[list[Path], list[int], tuple[str, ...]]:
    """Begin where a counter of a camera went from 9999 to 0 or 1: by the clock of the files, else at the widest gap."""
    period = 10**width
    at, doubts = _turn_by_clock([clock.get(path, "") for path in ordered])
    if at is None:
        gaps = [(after - before, n) for n, (before, after) in enumerate(pairwise(numbers), 1)]
        widest, at = max(gaps, default=(0, 0))
        closes = numbers[0] + period - numbers[-1] if numbers else period
        if widest <= period // 2 or closes > max(2, len(numbers) // 4 + 1):
            at = 0
    if width < _ROLLOVER_DIGITS or at == 0:
        return ordered, numbers, doubts
    note = f"The numbers of the names go on from {numbers[-1]} to {numbers[0]:0{width}d}: a counter that began anew."
    skipped = 1 if numbers[0] == 1 and numbers[-1] == period - 1 else 0
    return ordered[at:] + ordered[:at], numbers[at:] + [n + period - skipped for n in numbers[:at]], (note, *doubts)


def _turn_by_clock(taken: list[str]) -> tuple[int | None, tuple[str, ...]]:
    """Return where a cycle of times begins, 0 if they rise throughout; None where they do not tell, with a doubt."""
    if not taken or not all(taken) or len(set(taken)) == 1:
        return None, ()
    falls = [n for n, (before, after) in enumerate(pairwise(taken), 1) if after < before]
    if len(falls) <= 1 and (not falls or taken[-1] <= taken[0]):
        return (falls[0] if falls else 0), ()
    if len(falls) == len(taken) - 1:  # numbered from the last
        return 0, ()
    return None, ("The times in the files are not in the order of the numbers of their names: check the order.",)


def _without_gaps(ordered: list[Path], numbers: list[int], notes: tuple[str, ...]) -> FrameOrder:
    """Insert None for missing numbers. Raises DatasetError when the numbers jump."""
    steps = [after - before for before, after in pairwise(numbers)]
    if not steps:
        return FrameOrder(tuple(ordered), notes=notes)
    stride, n_alike = Counter(steps).most_common(1)[0]
    if n_alike < COUNTER_SHARE * len(steps):  # times or places, not a count
        return FrameOrder(tuple(ordered), notes=notes)
    even = all(step % stride == 0 for step in steps)
    n_missing = sum(step // stride - 1 for step in steps) if even else 0
    if not even or n_missing > MOST_MISSING * len(numbers):
        jump = max(range(len(steps)), key=steps.__getitem__)
        raise DatasetError(
            f"The numbers of the names jump from {ordered[jump].name} to {ordered[jump + 1].name}, and elsewhere by "
            f"{stride}: images may be missing, or of another stack. Say which to take with --only, or take them as "
            "neighbours with --as-listed."
        )
    files: list[Path | None] = [ordered[0]]
    missing: list[int] = []
    for path, before, after in zip(ordered[1:], numbers[:-1], numbers[1:], strict=True):
        missing += range(before + stride, after, stride)
        files += [None] * ((after - before) // stride - 1) + [path]
    if missing:
        shown = ", ".join(str(n) for n in missing[:5]) + (f" and {len(missing) - 5} more" if len(missing) > 5 else "")
        what = f"number {shown} is" if len(missing) == 1 else f"numbers {shown} are"
        notes += (f"Of the images, {what} missing: their place in z stays empty.",)
    return FrameOrder(tuple(files), notes=notes)
