"""Text of others on a terminal."""

from __future__ import annotations

from pathlib import Path

import pytest

import skygcs
from skygcs.cli.log_limit import BURST_LINES, MAX_KINDS, LogLimit
from skygcs.cli.render import say
from skygcs.cli.serve import main
from skygcs.terminal_text import visible
from support.table import each


def test_what_moves_a_terminal_is_shown_and_does_nothing() -> None:
    assert visible("alpha é 航空") == "alpha é 航空"
    assert visible("a\x1b[2J\x9b1m\u202eb\x7f\ud800") == r"a\x1b[2J\x9b1m\u202eb\x7f\ud800"
    assert visible("a\nb\tc") == r"a\nb\tc"
    assert visible("a\nb\tc\r\x1b", lines=True) == "a\nb\tc\\r\\x1b"


@each(
    "text",
    [
        '[links."\\u001b[31mx"]\ntype = "none"\n',
        '[vehicles."a\\u001b[2J"]\nsysid = 1\n',
        '[daemon]\nlog_dir = "a\\u001b[2Jb"\n',
        '[links.x]\ntype = "serial"\ndevice = "/dev/\\u001b[2J"\nbaud = 57600\n',
    ],
)
def test_a_check_prints_no_escape_sequence_of_a_name(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "fleet.toml"
    file.write_text(text)
    with pytest.raises(SystemExit):
        main(["check", str(file)])
    printed = "".join(capsys.readouterr())
    assert "\x1b" not in printed and "1b[" in printed


def test_every_command_prints_by_the_one_function_that_shows_what_moves_a_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    say("a\x1b[2J\r\u202eb\n\tc", err=True, over=True)
    assert capsys.readouterr().err.removeprefix("\r\x1b[K").removeprefix("\r") == "a\\x1b[2J\\r\\u202eb\n\tc\n"
    source = Path(skygcs.__file__).parent
    others = [path for path in source.rglob("*.py") if "typer.echo(" in path.read_text()]
    assert others == [source / "cli" / "render.py"], "use say of cli/render.py"


def test_lines_of_one_kind_are_bounded_and_counted() -> None:
    now = [0.0]
    limit = LogLimit(lambda: now[0])
    assert [limit.admit("bad request") for _ in range(9580)].count(0) == BURST_LINES
    assert limit.admit("another") == 0
    now[0] = 5.0
    assert limit.admit("bad request") == 9580 - BURST_LINES
    for number in range(10 * MAX_KINDS):
        limit.admit(f"kind {number}")
    assert len(limit._kinds) == MAX_KINDS
