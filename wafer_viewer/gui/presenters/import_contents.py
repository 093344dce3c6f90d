"""HTML of the import dialog: files in the order of z, frames, the order that they support, facts, places and result."""

from __future__ import annotations

import base64
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.profile_plot import sharpness_plot_html
from wafer_viewer.draw.number_format import THIN, number, size, with_unit
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.acquisition.image_source import ImageOptions
from wafer_viewer.model.file_contents import Fact, FileContents, FrameFact
from wafer_viewer.model.surface_format import Reading

MOST_ROWS = 300
"""Files listed in the order of z; of more the first and the last ones."""
CHART_PX = 172
ONE_PEAK = 0.2
"""Largest rise of sharpness, relative to its maximum, that is no second peak of a place."""
FEWEST_FRAMES = 6
"""Frames below which another order is supported by chance."""
LABELS = {
    "--pixel-um": "Pixel",
    "--z-step-um": "z step",
    "--na": "NA",
    "--channel": "Channel",
    "--time": "Time",
    "--position": "Position",
    "--only": "Only",
    "--pattern": "Pattern",
    "--columns": "Columns",
    "--places": "Place table",
    "--z-unit": "z unit",
    "--table": "Lines",
    "--as-listed": "Take all files",
}
"""Labels of the dialog by the flags of the command line, which messages name."""
FIELDS_OF_FACTS = "pixel size", "z step", "numerical aperture"
"""Facts that have a field of their own in the dialog."""


_KNOWN = "|".join(LABELS)
_PHRASES = (
    (r"give --table (\w+)", r"take \1 under Lines"),
    (r", as in (--(?:channel|time|position)) '.*?', or its number, from 0", r" under \1"),
    (r"leave (--[\w-]+) out", r"empty \1"),
    (r"give --overrule", "take the typed values"),
    (r" with --overrule", " and take the typed values"),
    (r" with --as-listed", " below"),
    (rf"with ({_KNOWN})", r"under \1"),
    (rf"as in ({_KNOWN})", r"as \1"),
)
"""What the dialog says instead of phrases with a flag."""


def page_words(text: str) -> str:
    """Return a message that names flags with the labels of the dialog, and units as the page writes them."""
    for pattern, words in _PHRASES:
        text = re.sub(pattern, words, text)
    text = re.sub(r"--[\w-]+", lambda flag: LABELS.get(flag[0], flag[0]), text)
    return html.typeset(text)


def reason(text: str) -> str:
    """Return the message of a failed import without what is clear before one: that it stopped and wrote nothing."""
    text = re.sub(r"^Import stopped at [^:]*: ", "", text.replace("Nothing was written.", "").replace("  ", " "))
    return page_words(text[:1].upper() + text[1:])


# --- files and frames


def summary(contents: FileContents) -> str:
    """Return the line under the title."""
    n_files = next((fact.value for fact in contents.facts if fact.name == "files"), "1")
    files = "1 file" if n_files == "1" else f"{n_files} files"
    return f"{contents.name} · {files} · nothing is copied before you press Import"


def files_html(contents: FileContents, take_all: bool) -> Markup:
    """Return the files in the order of their z, what is missing, and what is left out. take_all: none is."""
    rows = [_file_row(frame, contents.name) for frame in contents.frames]
    if len(rows) > MOST_ROWS:
        half = MOST_ROWS // 2
        more = Markup('<div class="off"><i></i><span>{} more</span><b></b></div>').format(len(rows) - 2 * half)
        rows = [*rows[:half], more, *rows[-half:]]
    out = [_line("off", viser.Icon.CIRCLE_MINUS, name, "left out") for name in contents.left_out[:MOST_ROWS]]
    listed = Markup('<div class="wv-imp-files">{}</div>').format(Markup("").join([*rows, *out]))
    notes = [note for note in contents.notes if "left out" in note]
    if notes and not take_all:
        link = html.note("busy", "", " ".join(map(page_words, notes)), _toggle("as-listed", "Take all files"))
    elif take_all:
        link = html.note("busy", "", "All files are taken as listed.", _toggle("as-listed", "Sort them out again"))
    else:
        link = Markup()
    order = (
        "in the order of their z"
        if contents.fields == 1
        else "one a field"
        if contents.is_tiled
        else "first field, by z"
    )
    return html.head("Files", order, first=True) + listed + link


def _file_row(frame: FrameFact, source: str) -> Markup:
    z = "" if frame.z_um is None else number(frame.z_um, 1, signed=True)
    if not frame.name:
        return _line("missing", viser.Icon.ALERT_TRIANGLE, "a frame is missing", z)
    return _line("", viser.Icon.CHECK, frame.name.removeprefix(f"{source}, "), z)


def _line(look: str, icon: object, name: str, right: str) -> Markup:
    return Markup('<div class="{}">{}<span title="{}">{}</span><b>{}</b></div>').format(
        look, html.icon(icon, 14), name, name, right
    )


def _toggle(what: str, words: str) -> Markup:
    return html.link(words, "import-toggle", what)


def frames_html(contents: FileContents, thumbnails: Mapping[int, bytes]) -> Markup:
    """Return the strip of frames with their z; those beside a gap have an amber rim."""
    frames = contents.frames
    kind = "image" if contents.is_tiled else "frame"
    pictures = Markup("").join(_picture(frames, k, thumbnails[k], kind) for k in sorted(thumbnails))
    images = next((fact.value for fact in contents.facts if fact.name == "images"), "")
    n = len(frames) - contents.n_missing
    part = f" · {len(thumbnails)} of {n} shown" if len(thumbnails) < n else ""
    return html.head(f"{kind.capitalize()}s", html.typeset(images).replace(" x ", " × ") + part, first=True) + Markup(
        '<div class="wv-imp-strip">{}</div>'
    ).format(pictures)


def _picture(frames: Sequence[FrameFact], k: int, jpeg: bytes, kind: str) -> Markup:
    beside_gap = any(0 <= m < len(frames) and not frames[m].name for m in (k - 1, k + 1))
    z_um = frames[k].z_um
    words = f"{kind} {k + (kind == 'image')}" if z_um is None else with_unit(z_um, 1, signed=True)
    return Markup(
        '<figure class="{look}" title="{name}"><img alt="{name}" src="data:image/jpeg;base64,{data}">'
        "<figcaption>{words}</figcaption></figure>"
    ).format(
        look="gap" if beside_gap else "",
        name=frames[k].name,
        data=base64.b64encode(jpeg).decode(),
        words=words,
    )


# --- order


def order_html(contents: FileContents) -> Markup:
    """Return the plot of sharpness over z, and a sentence on the order that it supports."""
    if not any(frame.sharpness for frame in contents.frames):
        return Markup()
    head = html.head("Does the order hold?", "sharpness at five places, relative to its maximum")
    return head + sharpness_plot_html(contents.frames, CHART_PX) + _support(contents)


def places_with_one_peak(frames: Sequence[FrameFact]) -> tuple[int, int]:
    """Return how many places grow sharp once and blur again, and how many there are."""
    curves = list(zip(*(frame.sharpness for frame in frames if frame.sharpness), strict=True))
    return sum(_has_one_peak(curve) for curve in curves), len(curves)


def _has_one_peak(curve: Sequence[float]) -> bool:
    """Return whether sharpness never falls by more than `ONE_PEAK` before its maximum or rises so after it."""
    peak = max(range(len(curve)), key=curve.__getitem__)
    return all(
        max(side[: n + 1]) - value <= ONE_PEAK
        for side in (curve[: peak + 1], curve[peak:][::-1])
        for n, value in enumerate(side)
    )


def _support(contents: FileContents) -> Markup:
    single, every = places_with_one_peak(contents.frames)
    source = next((fact.source for fact in contents.facts if fact.name == "z step"), "")
    stated = "the sign of the typed z step" if source == "given" else f"the {source}" if source.islower() else source
    ends = f"They cannot tell which end is up: {stated} says it." if "z step" not in contents.unsettled else ""
    ends = ends.replace("names of the files says", "names of the files say")
    if any("contradict the order" in doubt for doubt in contents.doubts):
        return Markup()
    if len(contents.frames) - contents.n_missing < FEWEST_FRAMES:
        return html.note("busy", "Too few frames to test the order.", "It is taken from the files.")
    if single >= every - 1:
        text = f"{single} of {every} places come into focus once. {ends}"
        return html.note("good", "The pictures support this order.", text, sign=html.icon(viser.Icon.CHECK, 17))
    text = f"{single} of {every} places have one peak; no other order has more. {ends}"
    return html.note("busy", "The pictures do not decide the order.", text, sign=html.icon(viser.Icon.INFO_CIRCLE, 17))


_SIGN = viser.Icon.ALERT_TRIANGLE


def doubts_html(contents: FileContents, options: ImageOptions) -> Markup:
    """Return what has to be settled, with what settles it, and what the user overrules."""
    return Markup("").join(_doubts(contents, options))


def _doubts(contents: FileContents, options: ImageOptions) -> Iterator[Markup]:
    sign = html.icon(_SIGN, 17)
    for doubt in contents.doubts:
        disputed = "contradict" in doubt or "given as" in doubt
        foot = Markup()
        if "--as-listed" in doubt:
            foot = _toggle("as-listed", "The present order is right")
        elif "given as" in doubt:
            foot = _toggle("overrule", "Take the typed values")
        yield html.note("fault" if disputed else "attention", "Contradictions", reason(doubt), foot, sign)
    if options.overrule:
        back = _toggle("overrule", "Take those of the files")
        yield html.note("attention", "Typed values replace those in the files.", "", back, sign)


def notes_html(contents: FileContents) -> Markup:
    """Return the gap, and the notes on how the files are read."""
    gap = _gap(contents) if contents.n_missing else Markup()
    notes = [note for note in contents.notes if "left out" not in note and "missing" not in note]
    lines = Markup("").join(Markup("<div>{}</div>").format(page_words(note)) for note in notes)
    return gap + (Markup('<div class="wv-notes">{}</div>').format(lines) if notes else Markup())


def _gap(contents: FileContents) -> Markup:
    zs = [with_unit(f.z_um, 1, signed=True) for f in contents.frames if not f.name and f.z_um is not None]
    where = f" at {', '.join(zs[:4])}{' …' if len(zs) > 4 else ''}" if zs else ""
    what = "1 frame is missing" if contents.n_missing == 1 else f"{contents.n_missing} frames are missing"
    text = "Heights beside it are less certain; the frames above keep their z."
    no_gap = _toggle("as-listed", "No frame is missing: renumber them")
    return html.note("attention", f"{what}{where}.", text, no_gap, html.icon(_SIGN, 17))


def surface_html(contents: FileContents, options: ImageOptions) -> Markup:
    """Return the facts, doubts and notes of a surface file or a dataset."""
    head = html.head(contents.kind.capitalize(), "", first=True)
    return head + doubts_html(contents, options) + facts_html(contents) + notes_html(contents)


# --- facts and places


def source_html(contents: FileContents | None, name: str, label: str, typed: bool) -> Markup:
    """Return the line under the field of a value: its source, both values that differ, or that it is unknown.

    label: of the field, which shows the value of the files while it is empty.
    """
    fact = None if contents is None else next((fact for fact in contents.facts if fact.name == name), None)
    open_ = contents is not None and name in contents.unsettled
    if typed and not (open_ and fact is not None and fact.value):
        return _source(label, "typed")
    if contents is None:
        return Markup()
    if fact is None or not fact.value:
        return _source(label, "not in the files", "attention" if open_ else "")
    if open_:
        both = f"{html.typeset(fact.value)}: {fact.source.replace('given', 'typed')}"
        return _source(label, both, "fault")
    return _source(label, fact.source, "", fact.value.split()[0])


def _source(label: str, words: str, tone: str = "", value: str = "") -> Markup:
    return Markup(
        '<div class="wv-imp-source {tone}" data-states="{label}" data-value="{value}" data-tone="{tone}">{words}</div>'
    ).format(tone=tone, label=label, value=value, words=words)


def facts_html(contents: FileContents | None) -> Markup:
    """Return the facts that have no field, each with its source."""
    if contents is None:
        return Markup()
    shown = [fact for fact in contents.facts if fact.name not in FIELDS_OF_FACTS and fact.name != "images"]
    tones = [
        Markup('<i hidden data-states="{}" data-value="" data-tone="{}"></i>').format(
            choice.axis.capitalize(), "attention" if choice.axis in contents.unsettled else ""
        )
        for choice in contents.choices
    ]
    rows = [*map(_fact, shown), *tones]
    return Markup('<div class="wv-imp-facts">{}</div>').format(Markup("").join(rows))


def _fact(fact: Fact) -> Markup:
    tone = "attention" if fact.name == "missing frames" or fact.value == "simulated" else ""
    value = html.typeset(fact.value).replace(" x ", " × ")
    source = Markup("<small>{}</small>").format(fact.source) if fact.source else Markup()
    return Markup('<div><span>{}</span><span class="{}">{}{}</span></div>').format(
        fact.name[:1].upper() + fact.name[1:], tone, value, source
    )


_MAP_PX = (264, 118)


def place_html(contents: FileContents | None) -> Markup:
    """Return the drawing of the fields on the sample, with the size of the whole, and what mirrors them."""
    if contents is None or contents.kind != "images":
        return Markup()
    if contents.field_um is None:
        return html.empty("Drawn as soon as the pixel size is known.")
    width_um, height_um = contents.field_um
    xs, ys = zip(*contents.places_um, strict=True)
    across_um, down_um = max(xs) - min(xs) + width_um, max(ys) - min(ys) + height_um
    scale = min(_MAP_PX[0] / across_um, _MAP_PX[1] / down_um)
    fields = [
        Markup('<rect x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}"/>').format(
            (x - min(xs)) * scale, (max(ys) - y) * scale, width_um * scale, height_um * scale
        )
        for x, y in contents.places_um
    ]
    drawing = Markup(
        '<svg width="{w:.0f}" height="{h:.0f}" viewBox="-1 -1 {w:.0f} {h:.0f}" role="img" aria-label="Fields">{f}</svg>'
    ).format(w=across_um * scale + 2, h=down_um * scale + 2, f=Markup("").join(fields))
    caption = f"{number(across_um, 0)} × {number(down_um, 0)}{THIN}µm"
    links = Markup(" · ").join((_toggle("mirror-x", "Mirror x"), _toggle("mirror-y", "Mirror y")))
    mirror = Markup("<div>{}</div>").format(links) if contents.fields > 1 else Markup()
    return Markup('<div class="wv-imp-place">{}<div>{}</div>{}</div>').format(drawing, caption, mirror)


def fields_words(contents: FileContents | None) -> str:
    """Return the number of fields."""
    return "" if contents is None else "1 field" if contents.fields == 1 else f"{contents.fields} fields"


# --- result


def button_words(contents: FileContents | None, options: ImageOptions) -> str:
    """Return the label of the button that imports: it names a gap, and what the user overrules."""
    if contents is None:
        return "Import"
    if contents.is_tiled:
        return "Stitch to one picture"
    if options.overrule:
        return "Import with the typed values"
    if contents.n_missing:
        return "Import with the gap" if contents.n_missing == 1 else f"Import with {contents.n_missing} gaps"
    return "Import as listed" if options.as_listed else "Import"


def why_not(contents: FileContents | None) -> str:
    """Return what has to be settled before the import, empty if nothing has."""
    if contents is None:
        return ""
    if contents.kind == "dataset":
        return "This is a dataset already: open it with Open…"
    if contents.unsettled:
        return f"{', '.join(_open(contents, name) for name in contents.unsettled)}."
    return reason(" ".join(contents.doubts[:1]))


def _open(contents: FileContents, name: str) -> str:
    if any(choice.axis == name for choice in contents.choices):
        return f"the {name} is not chosen"
    values = next((fact.value for fact in contents.facts if fact.name == name), "")
    return f"the {name} has two values" if values else f"the {name} is missing"


def foot_html(contents: FileContents, out: Path, command: str) -> Markup:
    """Return what the import makes, how large and where, and the same as a command line."""
    if why := why_not(contents):
        what = Markup('<div class="wv-imp-not">Not yet: {}</div>').format(why)
    else:
        n = len(contents.frames) - contents.n_missing
        gaps = (
            ""
            if not contents.n_missing
            else " and one gap"
            if contents.n_missing == 1
            else (f" and {contents.n_missing} gaps")
        )
        several = f"{fields_words(contents)}{',' if contents.fields == 1 else ' of'} {n} frames{gaps}"
        several = f"{n} images, one a field" if contents.is_tiled else several
        made = "A surface" if contents.kind == "surface" else several
        weight = f", {size(contents.n_bytes)}" if contents.n_bytes else ""
        what = Markup("<div><b>{} → </b>{}{}, in {}</div>").format(made, out.name, weight, out.parent)
        what += Markup('<div class="wv-imp-same">same as: <code>{}</code></div>').format(command)
    return Markup('<div class="wv-imp-foot">{}</div>').format(what)


def command_line(
    sources: Sequence[Path], options: ImageOptions, says: Reading, out: Path, *, is_tiled: bool = False
) -> str:
    """Return the command that makes the same import, or the same picture."""
    words = ["wafer-viewer", "stitch-images" if is_tiled else "import", *map(str, sources)]
    given = {name: getattr(options, name) for name in options.__struct_fields__}
    given |= {"z_unit": says.z_unit, "invert_z": says.invert_z, "table": says.table}
    standard = ImageOptions()
    for name, value in given.items():
        if value == getattr(standard, name, None) or value is False or value is None:
            continue
        flag = "--na" if name == "numerical_aperture" else f"--{name.replace('_', '-')}"
        words += [flag] if value is True else [flag, f"{value:g}" if isinstance(value, float) else str(value)]
    return shlex.join([*words, "-o", out.name])
