"""`skygcs-cli docs`: the pages of the documentation, installed with skygcs; needs neither network nor daemon."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from skygcs.cli.connection import run_offline
from skygcs.cli.options import Json
from skygcs.cli.render import plural, print_json, print_lines
from skygcs.errors import SkygcsError
from skygcs.spelling import near_names

MOST_WIDTH = 110
"""Columns of a page on a wide terminal."""

FOLDERS = ("", "tutorial", "howto", "reference", "explanation", "developers", "decisions")
"""In the order in which a new reader needs them."""

_HEADING = re.compile(r"^#{1,6} (.+)$")


def docs(
    page: Annotated[
        str | None,
        typer.Argument(metavar="PAGE", help="A name as in the list: radio, howto/radio.", show_default=False),
    ] = None,
    find: Annotated[
        str | None, typer.Option("--find", metavar="TEXT", help="List the lines of all pages that have this text.")
    ] = None,
    json_output: Json = False,
) -> None:
    """Show a page of the documentation, or list the pages; works without network.

    Example: skygcs-cli docs howto/radio
    """
    if page is not None and find is not None:
        raise typer.BadParameter("--find looks through all pages: leave out PAGE")

    def command() -> None:
        pages = all_pages()
        if find is not None:
            _show_found(find, pages, json_output)
        elif page is None:
            _show_list(pages, json_output)
        else:
            _show_page(chosen(page, pages), pages, json_output)

    run_offline(command)


def docs_dir() -> Path:
    """Inside the package when installed, at the project's top in a checkout."""
    packaged = Path(__file__).parent.parent / "docs"
    return packaged if packaged.is_dir() else Path(__file__).parents[3] / "docs"


def all_pages() -> dict[str, Path]:
    """The files of the pages by name, such as ``howto/radio``. Raises SkygcsError without any."""
    top = docs_dir()
    found = {
        path.relative_to(top).with_suffix("").as_posix(): path
        for folder in FOLDERS
        for path in sorted((top / folder).glob("*.md"))
    }
    if not found:
        raise SkygcsError(f"{top} has no pages; reinstall skygcs")
    return found


def chosen(wanted: str, pages: dict[str, Path]) -> str:
    """The page of this name, with or without its folder and ``.md``. Raises SkygcsError: none, or several."""
    name = wanted.removeprefix("docs/").partition("#")[0].removesuffix(".md").casefold()
    if name in pages:
        return name
    found = [page for page in pages if page.rpartition("/")[2] == name]
    if len(found) == 1:
        return found[0]
    if found:
        raise SkygcsError(f"{wanted} is the name of {plural(len(found), 'page')}: {', '.join(found)}")
    near = near_names(name, [*pages, *(page.rpartition("/")[2] for page in pages)], n=3)
    hint = f"did you mean {' or '.join(near)}?" if near else "skygcs-cli docs lists all of them"
    raise SkygcsError(f"no page {wanted!r}; {hint}")


def title_of(text: str) -> str:
    """The first heading."""
    return next((found[1] for line in text.splitlines() if (found := _HEADING.match(line))), "")


def found_lines(text: str, wanted: str) -> Iterator[tuple[int, str, str]]:
    """Number, heading and text of each line that has ``wanted``, in whatever case."""
    heading = ""
    for number, line in enumerate(text.splitlines(), 1):
        if found := _HEADING.match(line):
            heading = found[1]
        if wanted.casefold() in line.casefold():
            yield number, heading, line.strip()


def _show_list(pages: dict[str, Path], json_output: bool) -> None:
    titles = {name: title_of(path.read_text(encoding="utf-8")) for name, path in pages.items()}
    if json_output:
        print_json([{"page": name, "title": title, "file": str(pages[name])} for name, title in titles.items()])
        return
    width = max(map(len, titles)) + 2
    print_lines(f"{name:{width}}{title}" for name, title in titles.items())
    print_lines(["", "skygcs-cli docs PAGE shows one, --find TEXT looks through all of them."])


def _show_page(name: str, pages: dict[str, Path], json_output: bool) -> None:
    """Write it as it is into a pipe; on a terminal laid out, in a pager."""
    text = pages[name].read_text(encoding="utf-8")
    if json_output:
        print_json({"page": name, "title": title_of(text), "file": str(pages[name]), "text": text})
    elif sys.stdout.isatty():
        from rich.console import Console
        from rich.markdown import Markdown

        os.environ.setdefault("LESS", "-FRX")  # colours, and no pager for a page that fits
        screen = Console()
        screen.width = min(screen.width, MOST_WIDTH)
        with screen.pager(styles=True):
            screen.print(Markdown(text, hyperlinks=False))
    else:
        print_lines(text.rstrip().splitlines())


def _show_found(wanted: str, pages: dict[str, Path], json_output: bool) -> None:
    """Raises SkygcsError if no page has it."""
    found = [
        {"page": name, "line": number, "heading": heading, "text": line}
        for name, path in pages.items()
        for number, heading, line in found_lines(path.read_text(encoding="utf-8"), wanted)
    ]
    if not found:
        raise SkygcsError(f"no page has {wanted!r}")
    if json_output:
        print_json(found)
        return
    print_lines(f"{line['page']}:{line['line']}  {line['text']}" for line in found)


def add_to(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(docs)
