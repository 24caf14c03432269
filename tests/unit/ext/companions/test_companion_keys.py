"""`skygcs companion identity|pin|show`."""

from __future__ import annotations

from pathlib import Path

import pytest

from skygcs.cli.serve import main
from support.table import each


def run(*words: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["companion", *words])
    return int(ended.value.code or 0)


def test_both_sides_exchange_their_certificates(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ground, vehicle = tmp_path / "ground", tmp_path / "vehicle"
    assert run("identity", "ground", "--dir", str(ground)) == 0
    assert run("identity", "companion", "--dir", str(vehicle)) == 0
    assert run("identity", "companion", "--dir", str(vehicle)) == 0
    assert "is there already" in capsys.readouterr().out
    assert run("pin", str(ground / "ground.crt"), "--dir", str(vehicle)) == 0
    assert run("pin", str(vehicle / "companion.crt"), "alpha", "--dir", str(ground)) == 0
    assert (vehicle / "ground.crt").read_bytes() == (ground / "ground.crt").read_bytes()
    assert (ground / "companions" / "alpha.crt").read_bytes() == (vehicle / "companion.crt").read_bytes()
    printed = capsys.readouterr().out
    assert run("show", "--dir", str(ground)) == 0
    shown = capsys.readouterr().out
    assert "companions/alpha.crt" in shown and shown.count("SHA-256") == 2
    assert all(line.split()[-1] in printed for line in shown.splitlines())


@each(
    ("words", "reason"),
    [
        (("pin", "{ground}/ground.crt", "--dir", "{ground}"), "name the companion"),
        (("pin", "{ground}/ground.crt", "../x", "--dir", "{ground}"), "is not a companion's name"),
        (("pin", "{ground}/ground.key", "alpha", "--dir", "{ground}"), "one certificate in PEM format"),
        (("pin", "{ground}/absent", "alpha", "--dir", "{ground}"), "No such file"),
        (("show", "--dir", "{ground}/none"), "no certificate in"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(
    words: tuple[str, ...], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("identity", "ground", "--dir", str(tmp_path)) == 0
    capsys.readouterr()
    assert run(*(word.format(ground=tmp_path) for word in words)) == 1
    error = capsys.readouterr().err
    assert reason in error and error.count("\n") == 1 and error.startswith("skygcs: ")
