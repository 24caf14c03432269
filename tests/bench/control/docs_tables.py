"""The tables of moving references on a docs page: written by the bench, and compared with what it finds."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from bench.control.figures import Section

BEGIN = "<!-- {key}: written by make bench-control -->"
END = "<!-- end of {key} -->"
ON_THE_PAGE = ("circle", "paths", "wrong_delay")
"""Keys of the sections with a table there; the verdict of the others is whether they keep their limits."""


def write_tables(page: Path, sections: Iterable[Section]) -> None:
    """Replace each section's table on the page. Raises ValueError for one that has no place there."""
    text = page.read_text()
    for section in sections:
        before, _, after = _parts(text, section)
        text = before + _table(section) + after
    page.write_text(text)


def differences(page: Path, sections: Iterable[Section]) -> list[str]:
    """What the page says otherwise than these sections, row by row."""
    text = page.read_text()
    found = []
    for section in sections:
        documented = _parts(text, section)[1].strip().splitlines()
        for row in _table(section).strip().splitlines():
            if row not in documented:
                found.append(f"{section.key}: now {row}")
    return found


def _parts(text: str, section: Section) -> tuple[str, str, str]:
    """Up to the section's table, the table, and what follows it."""
    begin, end = BEGIN.format(key=section.key), END.format(key=section.key)
    if text.count(begin) != 1 or text.count(end) != 1:
        raise ValueError(f"the page has no place for {section.key}: {begin} and {end}")
    before, _, rest = text.partition(begin)
    table, _, after = rest.partition(end)
    return before + begin + "\n", table, end + after


def _table(section: Section) -> str:
    """As Markdown, a blank line before and after it."""
    rows = [section.header, tuple("---" for _ in section.header), *section.rows]
    return "\n" + "\n".join("| " + " | ".join(cell.replace("|", "/") for cell in row) + " |" for row in rows) + "\n\n"
