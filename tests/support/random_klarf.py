"""Small random KLARF files of both versions with what they hold, in the layouts of many tools, some of them damaged."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from dataclasses import dataclass

from wafer_viewer.model.inspection.klarf import Klarf, KlarfDefect, KlarfImage

CLASSES = ((0, "None"), (3, "Scratch; deep"), (8, "Größe"))


@dataclass(frozen=True, slots=True)
class DrawnKlarf:
    """File, what it held before it was damaged, and the damage; none: it must be read."""

    content: bytes
    klarf: Klarf
    damage: str = ""


def random_klarf(rng: random.Random) -> DrawnKlarf:
    """Draw a file; every second one is damaged."""
    nested = rng.random() < 0.5
    klarf = _contents(rng, nested)
    counted = nested or rng.random() < 0.7
    text = _nested(klarf, rng) if nested else _flat(klarf, rng, counted)
    damage = rng.choice([*DAMAGES][0 if counted else 2 :]) if rng.random() < 0.5 else ""
    if damage:
        text = DAMAGES[damage](text, rng)
    encoding = rng.choice(("utf-8", "utf-8-sig", "cp1252", "utf-16"))
    return DrawnKlarf(_laid_out(text, rng).encode(encoding), klarf, damage)


def _contents(rng: random.Random, nested: bool) -> Klarf:
    images = (KlarfImage(file="a;.jpg"),) if nested else (KlarfImage(file="0417_7", page=3), KlarfImage(file="0417_7"))
    images = images if rng.random() < 0.5 else ()
    pitch_x_um, pitch_y_um = rng.randrange(1000, 9000), rng.randrange(1000, 9000)
    dies = tuple(dict.fromkeys((rng.randrange(-4, 5), rng.randrange(-4, 5)) for _ in range(rng.randrange(1, 6))))
    defects = tuple(
        KlarfDefect(
            number=number,
            col=col,
            row=row,
            u_um=rng.randrange(pitch_x_um * 1000) / 1000,
            v_um=rng.randrange(pitch_y_um * 1000) / 1000,
            size_um=rng.randrange(9000) / 1000,
            area_um2=rng.randrange(9000) / 1000,
            class_number=class_number,
            class_name=name,
            images=images[: rng.randrange(3)],
        )
        for number, (col, row) in enumerate(rng.choices(dies, k=rng.randrange(6)), 1)
        for class_number, name in [rng.choice(CLASSES)]
    )
    return Klarf(
        lot=rng.choice(("L1", "Lot {1}; é")),
        wafer=f"W{rng.randrange(25)}",
        slot=rng.randrange(25),
        sample_mm=200.0,
        pitch_x_um=pitch_x_um,
        pitch_y_um=pitch_y_um,
        center_x_um=rng.randrange(-9000, 9000),
        center_y_um=rng.randrange(-9000, 9000),
        classes=CLASSES,
        dies=dies,
        defects=defects,
    )


# --------------------------------------------------------------------------------------------------------------- syntax


def _flat(klarf: Klarf, rng: random.Random, counted: bool) -> str:
    number = rng.choice(("{:.3f}", "{:.10e}")).format
    images = any(defect.images for defect in klarf.defects)
    columns = ["DEFECTID", "XREL", "YREL", "XINDEX", "YINDEX", "DSIZE", "DEFECTAREA", "CLASSNUMBER", "TEST"]
    columns += ["IMAGECOUNT", "IMAGELIST"] if images else []
    end = rng.choice((";", ""))  # of each row
    lines = [
        "FileVersion 1 2;",
        "FileTimestamp 03-14-26 09:41:07;",
        f'LotID "{klarf.lot}";',
        "TiffFileName 0417_7;",
        f"SampleSize 1 {klarf.sample_mm:.0f};",
        f"DiePitch {number(klarf.pitch_x_um)} {number(klarf.pitch_y_um)};",
        f'WaferID "{klarf.wafer}";',
        f"Slot {klarf.slot};",
        f"SampleCenterLocation {number(klarf.center_x_um)} {number(klarf.center_y_um)};",
        f"ClassLookup {len(CLASSES)}\n" + _joined([f' {n} "{name}"' for n, name in CLASSES], end),
        "InspectionTest 1;",
        f"SampleTestPlan {len(klarf.dies)}\n" + _joined([f" {col} {row}" for col, row in klarf.dies], end),
        f"DefectRecordSpec {len(columns)} {' '.join(columns)} ;",
        "DefectList\n" + _joined([_flat_row(d, number, rng, images) for d in klarf.defects], end),
    ]
    if counted:
        lines += ["SummarySpec 2 TESTNO NDEFECT ;", f"SummaryList\n 1 {len(klarf.defects)};"]
    return "\n".join([*lines, "EndOfFile;\n"])


def _flat_row(defect: KlarfDefect, number: Callable[[float], str], rng: random.Random, images: bool) -> str:
    col = f"{defect.col}{rng.choice(('', '.000'))}"
    places = f" {defect.number} {number(defect.u_um)} {number(defect.v_um)} {col} {defect.row}"
    row = f"{places} {number(defect.size_um)} {number(defect.area_um2)} {defect.class_number} {defect.test}"
    if images:
        n = len(defect.images)
        row += f" {n} {n}" + "".join(f"{rng.choice(' ' + chr(10))}{image.page} 0" for image in defect.images)
    return row


def _joined(rows: list[str], end: str) -> str:
    return f"{end}\n".join(rows) + ";"


def _nested(klarf: Klarf, rng: random.Random) -> str:
    def nm(um: float) -> int:
        return round(um * 1000)

    def listed(name: str, columns: str, rows: list[str]) -> str:
        named = columns.split(", ")
        return (
            f"List {name} {{ Columns {len(named)} {{ {columns} }} Data {len(rows)}\n{{\n"
            + "".join(f"{row}{rng.choice((' ;', ';'))}\n" for row in rows)
            + "} }"
        )

    def images(defect: KlarfDefect) -> str:
        return 'Images 1 { "a;.jpg" "JPG" 1 "Patch" }' if defect.images else "N"

    defects = [
        f"{d.number} {nm(d.u_um)} {nm(d.v_um)} {d.col} {d.row} {nm(d.size_um)} {d.area_um2 * 1e6:.1f} "
        f"{images(d)} {d.class_number} {d.test}"
        for d in klarf.defects
    ]
    header = [
        f"Field DiePitch 2 {{{nm(klarf.pitch_x_um)}, {nm(klarf.pitch_y_um)}}}",
        f"Field SampleSize 2 {{{nm(klarf.sample_mm * 1000)}, 0}}",
        listed(
            "ClassLookupList",
            "int32 CLASSNUMBER, string CLASSNAME, string CLASSCODE",
            [f'{n} "{name}" ""' for n, name in CLASSES],
        ),
    ]
    wafer = [
        f"Field SampleCenterLocation 2 {{{nm(klarf.center_x_um)}, {nm(klarf.center_y_um)}}}",
        f"Field SlotNumber 1 {{{klarf.slot}}}",
        listed(
            "DefectList",
            "int32 DEFECTID, int32 XREL, int32 YREL, int32 XINDEX, int32 YINDEX, int32 DSIZE, float DEFECTAREA, "
            "ImageList IMAGEINFO, int32 CLASSNUMBER, int32 TEST",
            defects,
        ),
        'Record TestRecord "1" {\n'
        + listed("SampleTestPlanList", "int32 XINDEX, int32 YINDEX", [f"{col} {row}" for col, row in klarf.dies])
        + "\n}",
    ]
    rng.shuffle(wafer)
    lot = [*header, "\n".join([f'Record WaferRecord "{klarf.wafer}"', "{", *wafer, "}"])]
    rng.shuffle(lot)
    return "\n".join(
        ['Record FileRecord "1.8"', "{", f'Record LotRecord "{klarf.lot}" {{', *lot, "}", "}", "EndOfFile;\n"]
    )


# ---------------------------------------------------------------------------------------------------- damage and layout


def _laid_out(text: str, rng: random.Random) -> str:
    """Return the text with other cases, blanks, blank lines and line ends."""
    if rng.random() < 0.3:
        turned = rng.choice((str.upper, str.lower))
        parts = re.split(r'("[^"\n]*")', text)
        text = "".join(part if part.startswith('"') else turned(part) for part in parts)
    if rng.random() < 0.3:
        text = text.replace("\n", "\n\n")
    if rng.random() < 0.3:
        text = re.sub(r"\n *", "\n\t ", text)
    return text.replace("\n", rng.choice(("\n", "\r\n", "\r"))) + rng.choice(("", "\n" * 250, "\x1a"))


def _without_row(text: str, rng: random.Random) -> str:
    return _on_a_row(text, rng, lambda row: "")


def _row_twice(text: str, rng: random.Random) -> str:
    return _on_a_row(text, rng, lambda row: row + row)


def _without_word(text: str, rng: random.Random) -> str:
    def lose(row: str) -> str:
        words = re.findall(r"\s+\S+|\S+", row)
        del words[rng.randrange(1, 5)]
        return "".join(words)

    return _on_a_row(text, rng, lose)


def _with_word(text: str, rng: random.Random) -> str:
    return _on_a_row(text, rng, lambda row: re.sub(r"(\S+ \S+)", r"\1 17", row, count=1))


def _on_a_row(text: str, rng: random.Random, change: Callable[[str], str]) -> str:
    """Change a row of the defects; without one, cut the text."""
    at = re.search(r"DefectList\b(?:.*\n\{\n|\n)", text)
    rows = [*re.finditer(r"[ ]?\d+(?: \S+){8,}.*\n", text[at.end() :].split("Summary")[0])] if at else []
    if at is None or not rows:
        return _cut(text, rng)
    row = rng.choice(rows)
    return text[: at.end() + row.start()] + change(row[0]) + text[at.end() + row.end() :]


def _cut(text: str, rng: random.Random) -> str:
    return text[: rng.randrange(len(text) - len("EndOfFile;"))]


def _without(marks: str) -> Callable[[str, random.Random], str]:
    """Return a damage that loses one of these marks; those within quotation marks are text."""

    def lose(text: str, rng: random.Random) -> str:
        bare = re.sub(r'"([^"\n]*)"', lambda quoted: f'"{"x" * len(quoted[1])}"', text)
        at = rng.choice([k for k, letter in enumerate(bare) if letter in marks])
        return text[:at] + text[at + 1 :]

    return lose


def _another_pitch(text: str, rng: random.Random) -> str:
    return re.sub(
        r"((?:Field )?DiePitch )([^\n]*)\n", r"\1\2\n\g<1>2 {1, 1}\n" if "{" in text else r"\1\2\n\g<1>1 1;\n", text
    )


def _decimal_comma(text: str, rng: random.Random) -> str:
    return text.replace(".", ",")


DAMAGES: dict[str, Callable[[str, random.Random], str]] = {
    "a row is lost": _without_row,
    "a row is there twice": _row_twice,
    "a word is lost": _without_word,
    "a word too many": _with_word,
    "cut off": _cut,
    "a quotation mark is lost": _without('"'),
    "a semicolon is lost": _without(";"),
    "a brace is lost": _without("{};"),
    "two pitches": _another_pitch,
    "decimal commas": _decimal_comma,
}
