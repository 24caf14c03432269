"""What can be said of the Containerfile without carrying it out; `make test-container` carries it out."""

from __future__ import annotations

import re
import tomllib

import pytest

from container.containerfile import arguments, copied, logical_lines, stages_of
from support.shell_examples import ROOT
from support.table import each

TEXT = (ROOT / "Containerfile").read_text(encoding="utf-8")
STAGES = stages_of(TEXT)
LAST = STAGES[-1]


def texts(instruction: str, stages: object = None) -> list[str]:
    return [
        text for stage in STAGES if stages in (None, stage.name) for word, text in stage.steps if word == instruction
    ]


def test_each_base_is_one_dated_image() -> None:
    """A tag that moves would make another image of the same checkout; a dated one of Debian is never made anew."""
    assert len(STAGES) == 2
    assert {stage.base for stage in STAGES} == {STAGES[0].base}
    assert re.fullmatch(r"docker\.io/library/debian:bookworm-20\d{6}-slim", STAGES[0].base)


def test_everything_that_is_copied_exists() -> None:
    ignored = [line for line in (ROOT / ".dockerignore").read_text().splitlines() if line and line[0] not in "#*"]
    for text in texts("COPY"):
        stage, sources, _ = copied(text)
        if stage is not None:
            assert stage in {s.name for s in STAGES}
            continue
        assert [name for name in sources if not (ROOT / name).exists() or name in ignored] == []


def test_all_that_a_wheel_is_built_of_is_copied() -> None:
    sources = {name.rstrip("/") for text in texts("COPY") for name in copied(text)[1]}
    build = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]
    assert set(build["sdist"]["only-include"]) <= sources | {"pyproject.toml"}
    assert {name.partition("/")[0] for name in build["wheel"]["force-include"]} <= sources


def test_it_runs_as_a_user_who_may_open_serial_ports() -> None:
    steps = dict(LAST.steps)
    assert steps["USER"] == "skygcs"
    (adding,) = (text for text in texts("RUN", LAST.name) if "useradd" in text)
    assert "--groups dialout" in adding and "--uid 1000" in adding
    assert [text for word, text in LAST.steps[[w for w, _ in LAST.steps].index("USER") :] if word == "RUN"] == []


def test_its_command_is_the_daemons() -> None:
    steps = dict(LAST.steps)
    assert [*arguments(steps["ENTRYPOINT"]), *arguments(steps["CMD"])] == ["skygcs", "run", "fleet.toml"]
    assert steps["ENV"].startswith("PATH=/opt/skygcs/bin:")


def test_the_last_stage_has_no_compiler_and_no_lists_of_packages() -> None:
    installing = " ".join(texts("RUN", LAST.name))
    assert not re.search(r"\b(gcc|libc6-dev|python3-dev|python3-venv|npm|nodejs)\b", installing)
    assert "rm -rf /var/lib/apt/lists/*" in installing


def test_nothing_of_one_machine_is_in_it() -> None:
    """No addresses but the base's, no paths but those of the image, no secrets, no latest."""
    for line in logical_lines(TEXT):
        assert not re.search(r"https?://|index-url|trusted-host|:latest|token|password|/home/|/root/", line), line
    for path in re.findall(r"(?<![\w./}*])/[a-z][\w./-]*", "\n".join(logical_lines(TEXT))):
        assert re.match(r"/(src|build|opt/skygcs|wheels|fleet|usr/|bin|var/lib/apt/lists)", path), path


def test_the_page_is_built_before_the_wheel_and_the_fast_path_is_required() -> None:
    building = texts("RUN", "build")
    page = next(n for n, text in enumerate(building) if "build_page.py" in text)
    wheel = next(n for n, text in enumerate(building) if "-m build" in text)
    assert page < wheel and "SKYGCS_REQUIRE_FASTPATH=1" in building[wheel]


@each("text", ["RUN true", "FROM a b c", "FROM a\nADD x y", "FROM a\nHEALTHCHECK CMD true", "FROM a\n\tnonsense"])
def test_what_is_not_carried_out_is_an_error(text: str) -> None:
    with pytest.raises(ValueError, match="not understood"):
        stages_of(text)


def test_lines_are_joined_and_comments_left_out() -> None:
    text = "# one\nFROM a AS b\n\nRUN x \\\n    # two\n    && y\nCOPY --from=b /p /q r/\n"
    assert stages_of(text)[0].steps == [("RUN", "x && y"), ("COPY", "--from=b /p /q r/")]
    assert copied("--from=b /p /q r/") == ("b", ["/p", "/q"], "r/")
    with pytest.raises(ValueError, match="not understood"):
        copied("--chown=a b c")
