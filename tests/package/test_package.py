"""What a user of the package index gets: wheel and sdist, built, checked, installed in folders without a checkout."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path
from typing import Any

import pytest

from support.process import ROOT, wait_until

MOST_WHEEL_BYTES = 2_800_000
"""Without the web page's files; .11 MB of it are what parameters of both firmwares mean, .3 MB the documentation's
pages. Measured: 2.62 MB."""

PAGES = sorted((ROOT / "docs").rglob("*.md"))
"""The documentation."""


def run(*words: str | Path, cwd: Path, **environment: str) -> str:
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("SKYGCS", "PYTHON", "VIRTUAL_ENV"))}
    done = subprocess.run([*map(str, words)], cwd=cwd, env=kept | environment, capture_output=True, text=True)
    assert done.returncode == 0, f"{words}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The sdist, the pure wheel, and the one with the fast path; wheels are made from the sdist."""
    out = tmp_path_factory.mktemp("dist")
    build = (sys.executable, "-m", "build", "--outdir")
    run(*build, out, "--sdist", ROOT, cwd=ROOT)
    (sdist,) = out.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(out / "source", filter="data")
    (source,) = (out / "source").iterdir()
    run(*build, out, "--wheel", source, cwd=out, SKYGCS_PURE="1")
    run(*build, out, "--wheel", source, cwd=out, SKYGCS_REQUIRE_FASTPATH="1")
    (pure,) = out.glob("*-none-any.whl")
    (native,) = (p for p in out.glob("*.whl") if p != pure)
    return {"sdist": sdist, "pure": pure, "native": native}


def environment(folder: Path, *wanted: str | Path, **more: str) -> Path:
    """The programs of a new environment with these packages in it, by the pip of this one."""
    venv.create(folder / "venv")
    programs = folder / "venv" / "bin"
    # not compiled: of 3,000 modules some hundred are imported
    pip(programs, "install", "--quiet", "--no-compile", *wanted, cwd=folder, **more)
    return programs


def pip(programs: Path, *words: str | Path, cwd: Path, **environment: str) -> str:
    """pip for the environment of these programs."""
    there = ("--python", programs / "python", "--disable-pip-version-check")
    return run(sys.executable, "-m", "pip", *there, *words, cwd=cwd, **environment)


def of_extras(programs: Path) -> set[str]:
    """Installed packages that an extra of skygcs asks for, and no package without an extra."""
    lines = run(
        programs / "python",
        "-c",
        "from importlib.metadata import distributions, requires\n"
        "there = list(distributions())\nprint(*(d.metadata['Name'] for d in there))\n"
        "print(*(r for d in there for r in d.requires or () if 'extra ==' not in r), sep='|')\n"
        "print(*requires('skygcs'), sep='\\n')",
        cwd=programs,
    ).splitlines()
    name = re.compile(r"[\w.-]+")
    asked = {name.match(line)[0].lower() for line in lines[2:] if "extra ==" in line}  # type: ignore[index]
    needed = {name.match(line)[0].lower() for line in lines[1].split("|")}  # type: ignore[index]
    assert {"aiohttp", "pyarrow", "pytest"} <= asked
    return {one.lower() for one in lines[0].split()} & asked - needed


def flies(programs: Path, folder: Path) -> None:
    """As the README says: init, run, and the vehicles are seen."""
    run(programs / "skygcs", "init", "sim", cwd=folder)
    fleet = (folder / "fleet.toml").read_text()
    (folder / "fleet.toml").write_text(fleet.replace("port = 14550", "port = 24550"))
    socket = {"SKYGCS_SOCKET": str(folder / "s")}
    words = [programs / "skygcs", "run", "fleet.toml", "--socket", folder / "s", "-q"]
    with (folder / "log").open("wb") as log:
        daemon = subprocess.Popen([*map(str, words)], cwd=folder, stdout=log, stderr=log)

    def seen() -> Any:
        status = subprocess.run(
            [programs / "skygcs-cli", "status", "--json"], env=os.environ | socket, capture_output=True
        )
        return status.returncode == 0 and len(json.loads(status.stdout)) == 3

    try:
        wait_until(seen, "three vehicles are seen")
    finally:
        daemon.send_signal(signal.SIGTERM)
        daemon.wait(30)


def works_alone(programs: Path, folder: Path) -> None:
    """What a field has no network for, and a folder no checkout: the pages, shipped dialects, `up` without extras."""
    listed = {entry["page"] for entry in json.loads(run(programs / "skygcs-cli", "docs", "--json", cwd=folder))}
    assert listed == {path.relative_to(ROOT / "docs").with_suffix("").as_posix() for path in PAGES}
    page = (ROOT / "docs" / "howto" / "xbee.md").read_text(encoding="utf-8")
    assert run(programs / "skygcs-cli", "docs", "xbee", cwd=folder) == page
    for spelling in ("utias", "dialects/utias.xml"):
        (folder / "lab.toml").write_text(f'dialect = "{spelling}"\n[vehicles.alpha]\nsysid = 1\n')
        assert "dialect  utias, " in run(programs / "skygcs", "check", "lab.toml", cwd=folder)
        run(programs / "skygcs-cli", "gate", "--dialect", spelling, cwd=folder)
    words = [programs / "skygcs-cli", "--socket", "none", "up", "--fleet", "lab.toml", "--wait", "0", "--json"]
    done = subprocess.run([*map(str, words)], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 3, done.stderr  # no daemon, which is all that is missing
    assert list(json.loads(done.stdout)["vehicles"]["alpha"]["stages"]) == ["heard"]


def test_the_index_takes_them(packages: dict[str, Path], tmp_path: Path) -> None:
    out = run(sys.executable, "-m", "twine", "check", "--strict", *packages.values(), cwd=tmp_path)
    assert out.count("PASSED") == 3, out


def test_the_wheel_is_small_and_has_what_a_user_needs(packages: dict[str, Path]) -> None:
    with zipfile.ZipFile(packages["native"]) as wheel:
        sizes = {entry.filename: entry.compress_size for entry in wheel.infolist()}
        metadata = wheel.read(next(n for n in sizes if n.endswith("/METADATA"))).decode()
    page = sum(size for name, size in sizes.items() if "/web/static/" in name)
    print(f"\nwheel: {sum(sizes.values()) / 1e6:.2f} MB, of it {page / 1e6:.2f} MB of the web page")
    assert sum(sizes.values()) - page <= MOST_WHEEL_BYTES
    assert page == 0 or "skygcs/web/static/assets/licenses.txt" in sizes  # never a page without its libraries' licences
    assert {
        "skygcs/configs/sim.toml",
        "skygcs/ext/metrics/alerts.yml",
        "skygcs/ext/metrics/dashboard.json",
        "skygcs/dialects/utias.xml",
    } <= sizes.keys()
    pages = {f"skygcs/{path.relative_to(ROOT).as_posix()}": path.read_bytes() for path in PAGES}
    with zipfile.ZipFile(packages["native"]) as wheel:
        assert {name: wheel.read(name) for name in sizes if name.startswith("skygcs/docs/")} == pages
    assert any(re.fullmatch(r"skygcs/links/_fast_path\..*\.so", name) for name in sizes)
    # links of the README lead out of the package
    inside = re.findall(r"\]\((?![a-z]+:|#)([^)]*)\)", metadata)
    assert inside == []
    assert metadata.count("Project-URL:") >= 3 and "](https://" in metadata


def test_the_sdist_has_no_test_data(packages: dict[str, Path]) -> None:
    with tarfile.open(packages["sdist"]) as archive:
        names = [name.partition("/")[2] for name in archive.getnames()]
    assert not [n for n in names if n.startswith("tests") or n.endswith((".tlog", ".so"))]
    page = [n for n in names if n.startswith("src/skygcs/web/static/")]
    assert not page or "src/skygcs/web/static/assets/licenses.txt" in page
    assert {"configs/sim.toml", "hatch_build.py", "src/skygcs/links/_fast_path.c", "LICENSE"} <= set(names)


def test_the_pure_wheel_runs_without_compiler_and_checkout_and_takes_extras_later(
    packages: dict[str, Path], tmp_path: Path
) -> None:
    programs = environment(tmp_path, packages["pure"], CC="/bin/false")
    assert list(tmp_path.rglob("_fast_path*.so")) == []
    flies(programs, tmp_path)
    assert of_extras(programs) == set()
    works_alone(programs, tmp_path)
    for name in ("wheel", "setuptools"):
        assert shutil.which(name, path=str(programs)) is None
    # an extra of an installed skygcs needs no skygcs in the index
    assert "`pip install 'skygcs[companions]'` once skygcs itself is installed" in ways().replace("\n", " ")
    out = pip(programs, "install", "--no-compile", "skygcs[companions]", cwd=tmp_path)
    assert "Collecting skygcs" not in out and "Requirement already satisfied: skygcs[companions]" in out
    assert "asyncssh" in of_extras(programs)


def test_the_sdist_brings_the_fast_path_with_a_compiler(packages: dict[str, Path], tmp_path: Path) -> None:
    programs = environment(tmp_path, packages["sdist"], SKYGCS_REQUIRE_FASTPATH="1")
    assert len(list(tmp_path.rglob("_fast_path*.so"))) == 1
    flies(programs, tmp_path)


# -- the ways of the README, each as it is written there, in a folder without anything


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clone of what is committed."""
    folder = tmp_path_factory.mktemp("clone") / "skygcs"
    run("git", "clone", "--quiet", "--no-hardlinks", ROOT, folder, cwd=ROOT)
    return folder


def ways() -> str:
    """The table of the README."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return text.partition("## Install it")[2].partition("\n## ")[0]


def test_pip_installs_a_clone(clone: Path, tmp_path: Path) -> None:
    assert "`python3 -m venv ~/skygcs && ~/skygcs/bin/pip install .`" in ways()
    venv.create(tmp_path / "skygcs", with_pip=True)
    programs = tmp_path / "skygcs" / "bin"
    run(programs / "pip", "install", "--quiet", "--disable-pip-version-check", ".", cwd=clone)
    flies(programs, tmp_path)
    works_alone(programs, tmp_path)


@pytest.fixture(scope="module")
def uv(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return environment(tmp_path_factory.mktemp("uv"), "uv") / "uv"


def of_uv(folder: Path) -> dict[str, str]:
    """Where it keeps everything, so that nothing of the machine's is used or changed."""
    names = ("UV_TOOL_DIR", "UV_TOOL_BIN_DIR", "UV_CACHE_DIR", "UV_PYTHON_INSTALL_DIR", "HOME")
    return {name: str(folder / name.lower()) for name in names} | {"UV_NO_CONFIG": "1"}


def test_uv_installs_a_clone(clone: Path, uv: Path, tmp_path: Path) -> None:
    assert "`uv tool install .`" in ways()
    settings = of_uv(tmp_path)
    run(uv, "tool", "install", "--python", sys.executable, ".", cwd=clone, **settings)
    programs = Path(settings["UV_TOOL_BIN_DIR"])
    assert sorted(path.name for path in programs.iterdir()) == ["skygcs", "skygcs-cli"]
    flies(programs, tmp_path)
    works_alone(programs, tmp_path)


def test_uv_fetches_a_python_where_that_of_the_system_is_too_old(clone: Path, uv: Path, tmp_path: Path) -> None:
    """As if there were none: only one of uv's own counts. It comes from GitHub, which not every network reaches."""
    words = [uv, "tool", "install", "--managed-python", "."]
    done = subprocess.run(
        [*map(str, words)], cwd=clone, env=os.environ | of_uv(tmp_path), capture_output=True, text=True
    )
    if done.returncode != 0 and re.search("failed to (lookup|download|fetch)|dns error|connect", done.stderr, re.I):
        pytest.skip(f"uv cannot fetch a Python here: {done.stderr.strip().splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    version = run(tmp_path / "uv_tool_dir" / "skygcs" / "bin" / "python", "--version", cwd=tmp_path)
    assert tuple(map(int, version.split()[1].split(".")[:2])) >= (3, 11)


def test_an_older_python_is_refused_with_the_version_that_is_needed(packages: dict[str, Path], tmp_path: Path) -> None:
    """As pip of a Python 3.10 does it, of which there is none here."""
    shutil.copy(packages["pure"], tmp_path)
    options = ("--python-version", "3.10", "--only-binary", ":all:", "--no-deps", "--dest", tmp_path / "there")
    words = [sys.executable, "-m", "pip", "download", *options, "--no-index", "--find-links", tmp_path, "skygcs"]
    done = subprocess.run([*map(str, words)], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode != 0 and "requires a different Python: 3.10" in done.stderr, done.stderr
    assert ">=3.11" in done.stderr
