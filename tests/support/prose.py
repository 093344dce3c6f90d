"""Sentences of a page of the documentation."""

from __future__ import annotations

import re

FENCE = re.compile(r"^ *(`{3,}|:{3,}).*?^ *\1 *$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
CODE = re.compile(r"`[^`]*`")
ABBREVIATIONS = ("e.g.", "i.e.", "eq.", "Fig.", "no.")


def paragraphs(page: str) -> list[str]:
    """Return the paragraphs, items of lists and cells of tables, with links as their words and code as one word."""
    text = FENCE.sub("", page)
    text = CODE.sub("CODE", LINK.sub(r"\1", text))
    blocks: list[str] = []
    for block in re.split(r"\n\s*\n", text):
        if block.lstrip().startswith("|"):
            blocks += [cell.strip() for row in block.splitlines() for cell in row.strip().strip("|").split("|")]
        else:
            blocks += re.split(r"\n\s*(?:[-*]|\d+\.)\s+", block)
    return [re.sub(r"^\s*(?:[-*]|\d+\.|#+|>)\s+", "", " ".join(block.split())) for block in blocks if block.strip()]


def sentences(page: str) -> list[str]:
    """Return the sentences of a page."""
    found: list[str] = []
    for paragraph in paragraphs(page):
        for known in ABBREVIATIONS:
            paragraph = paragraph.replace(known, known.replace(".", ""))
        found += re.split(r"(?<=[.!?:;])\*{0,2}\s+(?=[A-Z0-9*(])", paragraph)
    return [sentence for sentence in found if re.search(r"\w", sentence)]
