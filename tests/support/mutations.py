"""Mutations of valid files and messages, by seed: what disks, cables and strangers make of them."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable, Sequence

import numpy as np

from wafer_viewer.store.io.checksums import sealed_line, sealed_text, strip_checksum

Rng = np.random.Generator
Mutation = Callable[[bytes, Rng, Sequence[bytes]], bytes]
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORDS = (
    *(b"", b"0", b"-1", b"1", b"255", b"65536", b"2147483648", b"4294967295", b"99999999999999999999"),
    *(b"nan", b"inf", b"-inf", b"NaN", b"Infinity", b"1e308", b"1e-308", b"1e400", b"9" * 400, b"null", b"true"),
    *(b'"x"', b"[]", b"{}", b"[[[[]]]]", b"\xff\xfe", b"\x00", b"\xc3\x28", "µ".encode("latin-1")),
)
_DELIMITERS = b'"{}[]().,:;=#<>\n\r\t \x00'


def mutated(content: bytes, rng: Rng, others: Sequence[bytes]) -> bytes:
    """Return valid content with one to three mutations; others: valid files to splice with."""
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        content = MUTATIONS[int(rng.integers(len(MUTATIONS)))](content, rng, others)
    return content


def _place(content: bytes, rng: Rng) -> int:
    """Return an offset, as often near the begin or the end, where headers are, as anywhere."""
    n = max(1, len(content))
    near = min(n, 600)
    return int((rng.integers(near), n - 1 - rng.integers(near), rng.integers(n), rng.integers(n))[rng.integers(4)])


def _flip(content: bytes, rng: Rng, others: Sequence[bytes]) -> bytes:
    out = bytearray(content)
    for _ in range(int(rng.integers(1, 9)) if out else 0):
        out[_place(content, rng)] ^= 1 << int(rng.integers(8))
    return bytes(out)


def _set(content: bytes, rng: Rng, others: Sequence[bytes]) -> bytes:
    out = bytearray(content)
    for _ in range(int(rng.integers(1, 5)) if out else 0):
        at = _place(content, rng)
        width = int(rng.choice([1, 1, 2, 4, 8]))
        out[at : at + width] = bytes([int(rng.choice([0, 0x7F, 0x80, 0xFF]))]) * width
    return bytes(out)


def _truncate(content: bytes, rng: Rng, others: Sequence[bytes]) -> bytes:
    at = _place(content, rng)
    return content[at:] if rng.random() < 0.2 else content[:at]


def _insert(content: bytes, rng: Rng, others: Sequence[bytes]) -> bytes:
    at, kind = _place(content, rng), int(rng.integers(4))
    some = (
        rng.bytes(int(rng.integers(1, 64))),
        _WORDS[int(rng.integers(len(_WORDS)))],
        bytes([_DELIMITERS[int(rng.integers(len(_DELIMITERS)))]]) * int(rng.choice([1, 2, 100, 5000])),
        content[at : at + int(rng.integers(1, 200))] * int(rng.choice([1, 2, 50])),
    )[kind]
    return content[:at] + some + content[at:]


def _delete(content: bytes, rng: Rng, others: Sequence[bytes]) -> bytes:
    at = _place(content, rng)
    return content[:at] + content[at + int(rng.choice([1, 1, 2, 8, 100])) :]


def _splice(content: bytes, rng: Rng, others: Sequence[bytes]) -> bytes:
    other = others[int(rng.integers(len(others)))] if others else content
    if rng.random() < 0.5:
        return content[: _place(content, rng)] + other[_place(other, rng) :]
    at, begin = _place(content, rng), _place(other, rng)
    return content[:at] + other[begin : begin + int(rng.integers(1, 2000))] + content[at:]


def _number(content: bytes, rng: Rng, others: Sequence[bytes]) -> bytes:
    """Replace a number in a text by an unlikely one."""
    found = list(_NUMBER.finditer(content[:100_000]))
    if not found:
        return _set(content, rng, others)
    match = found[int(rng.integers(len(found)))]
    return content[: match.start()] + _WORDS[int(rng.integers(len(_WORDS)))] + content[match.end() :]


def _encoding(content: bytes, rng: Rng, others: Sequence[bytes]) -> bytes:
    text = content.decode("latin-1")
    form = ("utf-16", "utf-8-sig", "utf-32", "cp500", "utf-7")[int(rng.integers(5))]
    return text.encode(form, "replace")


def _line(content: bytes, rng: Rng, others: Sequence[bytes]) -> bytes:
    """Repeat, drop or swap lines."""
    lines = content.split(b"\n")
    a, b = (int(rng.integers(len(lines))) for _ in range(2))
    kind = int(rng.integers(3))
    if kind == 0:
        lines[a : a + 1] = [lines[a]] * int(rng.choice([2, 3, 100]))
    elif kind == 1:
        del lines[a]
    else:
        lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def _resealed(content: bytes, rng: Rng, others: Sequence[bytes]) -> bytes:
    """Mutate a text below its checksum, so that the mutation reaches what reads it."""
    if content[:1] not in (b"{", b"["):
        return _member(content, rng, others)
    lines = content.rstrip(b"\n").split(b"\n")
    if all(line.startswith(b"{") for line in lines):
        n = int(rng.integers(len(lines)))
        lines[n] = sealed_line(_number(strip_checksum(lines[n]), rng, others))
        return b"\n".join(lines) + b"\n"
    changed = (_number, _flip, _delete, _insert)[int(rng.integers(4))](strip_checksum(content), rng, others)
    return (
        sealed_text(changed.decode("utf-8", "surrogateescape")).encode("utf-8", "surrogateescape")
        if _is_text(changed)
        else changed
    )


def _is_text(content: bytes) -> bool:
    try:
        content.decode()
    except UnicodeDecodeError:
        return False
    return True


def _member(content: bytes, rng: Rng, others: Sequence[bytes]) -> bytes:
    """Mutate a member of a zip archive and pack it again, so that the checksum of the member is right."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {info.filename: archive.read(info) for info in archive.infolist()}
    except Exception:  # noqa: BLE001 - other mutations came before
        return _flip(content, rng, others)
    if not members:
        return content
    name = list(members)[int(rng.integers(len(members)))]
    some = (_flip, _set, _truncate, _insert, _delete, _number, _member_head)
    kind = int(rng.integers(len(some) + 2))
    if kind < len(some):
        members[name] = some[kind](members[name], rng, [*members.values()])
    elif kind == len(some):
        del members[name]
    else:
        members[name] = list(members.values())[int(rng.integers(len(members)))]
    out = io.BytesIO()
    how = zipfile.ZIP_DEFLATED if rng.random() < 0.3 else zipfile.ZIP_STORED
    with zipfile.ZipFile(out, "w", how) as archive:
        for member, data in members.items():
            archive.writestr(member, data)
    return out.getvalue()


def _member_head(content: bytes, rng: Rng, others: Sequence[bytes]) -> bytes:
    """Replace a word of the header of an array by one of the same length or another."""
    end = content.find(b"\n", 0, 4096) + 1
    if not content.startswith(b"\x93NUMPY") or not end:
        return _set(content, rng, others)
    text = (b"'descr': 'O'", b"'descr': '<f4'", b"(", b"'shape': (1000000, 100000)", b"-1", b"{" * 50, b"\\", b"0x")
    words = re.findall(rb"'descr': '[^']*'|'shape': \([^)]*\)|\d+|True|False|[(){}',:]", content[10:end])
    old, new = words[int(rng.integers(len(words)))] if words else b"'", text[int(rng.integers(len(text)))]
    head = content[10:end].replace(old, new, 1).rstrip(b" \n")
    return content[:10] + head.ljust(end - 11)[: end - 11] + b"\n" + content[end:]


MUTATIONS: tuple[Mutation, ...] = (
    *(_flip, _set, _truncate, _insert, _delete, _splice, _number, _encoding, _line, _resealed, _resealed),
)
