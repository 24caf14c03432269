"""A bundle: one tar file with all wheels that a companion needs, so that it is installed without a network.

`collect` makes one with pip for another architecture and Python than this computer's; `read_bundle` checks it.
The tar holds ``manifest.json`` and ``wheels/``; the manifest names each wheel with its size and SHA-256.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import IO, Any

import skygcs
from skygcs.errors import SkygcsError

FORMAT = 1
EXTRA = "companions"
ARCHITECTURES = ("aarch64", "armv7l", "x86_64")
PYTHONS = ("3.11", "3.12", "3.13")

NEWEST_GLIBC = 36
"""2.36 is that of Debian 12; no older system has Python 3.11."""

OLDEST_GLIBC = {"aarch64": 17, "armv7l": 17, "x86_64": 5}
"""glibc of the oldest manylinux tag of an architecture (PEP 600)."""

OLD_TAGS = {
    "aarch64": ("manylinux2014",),
    "armv7l": ("manylinux2014",),
    "x86_64": ("manylinux2014", "manylinux2010", "manylinux1"),
}

REMEDY = (
    "--index-url of an index that has them (for armv7l https://www.piwheels.org/simple, made for Raspberry Pi OS), or "
    "on such a computer `pip wheel --no-deps -w FOLDER` with these names, then --wheels FOLDER here"
)

PIPS_AT_ONCE = 4
PIP_TIMEOUT_S = 1800.0
MAX_MANIFEST_BYTES = 1 << 20
READ_BYTES = 1 << 20
MAX_FILES = 500
"""skygcs and what it needs are some 40 wheels."""

_WHEEL = re.compile(r"[A-Za-z0-9._+!-]{1,200}\.whl")
_WORD = re.compile(r"[A-Za-z0-9._+-]{1,60}")
_REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+)\s*(?:\[([A-Za-z0-9._, -]*)\])?")
_EXTRA = re.compile(r"extra\s*==\s*['\"]([A-Za-z0-9._-]+)['\"]")
_NO_WHEEL = re.compile(r"No matching distribution found for ([^\s(;]+)")


@dataclass(frozen=True, slots=True)
class Bundle:
    """A bundle that was read and checked."""

    path: Path
    version: str
    arch: str
    python: str
    sha256: str
    """SHA-256 of the tar, in hexadecimal digits."""
    bytes: int
    installed_bytes: int
    """Room that its wheels take when they are installed."""
    pip_wheel: str
    """File name of the pip that installs it: a companion may have none."""

    @property
    def identifier(self) -> str:
        """Names the folder of this version on a companion."""
        return f"{self.version}-{self.sha256[:12]}"

    @property
    def needed_bytes(self) -> int:
        """Room for the tar, its wheels and the installed packages at the same time."""
        return 2 * self.bytes + self.installed_bytes


@dataclass(frozen=True, slots=True)
class Sources:
    """Where wheels come from. ``own_wheel`` None: built from this checkout, or the released one of the index."""

    own_wheel: Path | None = None
    wheel_folders: tuple[Path, ...] = ()
    index_urls: tuple[str, ...] = ()
    """Further package indexes."""
    offline: bool = False
    """Only from ``wheel_folders``."""


def collect(output: Path, arch: str, python: str, sources: Sources) -> Bundle:
    """Collect the wheels and write the bundle, whole or not at all. Raises SkygcsError with what is missing."""
    with tempfile.TemporaryDirectory(prefix="skygcs-bundle-") as name:
        folder = Path(name)
        wheels = folder / "wheels"
        wheels.mkdir()
        own = sources.own_wheel or _built_wheel(folder)
        which = f"=={skygcs.__version__}" if own is None else f" @ {own.resolve().as_uri()}"
        purpose = f"{arch}, Python {python}"
        try:
            _pip(_download(f"skygcs[{EXTRA}]{which}", wheels, arch, python, sources), purpose)
        except NoWheel as missing:
            raise SkygcsError(_all_missing(missing, folder, arch, python, sources)) from None
        _write(output, sorted(wheels.glob("*.whl")), arch, python)
    return read_bundle(output)


def platform_tags(arch: str) -> list[str]:
    """Platform tags of wheels that an architecture takes, newest first."""
    newest = [f"manylinux_2_{minor}_{arch}" for minor in range(NEWEST_GLIBC, OLDEST_GLIBC[arch] - 1, -1)]
    return [*newest, *(f"{tag}_{arch}" for tag in OLD_TAGS[arch]), f"linux_{arch}"]


def _download(requirement: str, wheels: Path, arch: str, python: str, sources: Sources) -> list[str]:
    abi = "cp" + python.replace(".", "")
    words = ["download", "--dest", str(wheels), "--only-binary=:all:", "--python-version", python]
    words += ["--implementation", "cp", "--abi", abi, "--abi", "abi3", "--abi", "none"]
    words += [word for tag in platform_tags(arch) for word in ("--platform", tag)]
    words += [word for place in sources.wheel_folders for word in ("--find-links", str(place))]
    words += [word for url in sources.index_urls for word in ("--extra-index-url", url)]
    return [*words, *(["--no-index"] if sources.offline else []), requirement, "pip"]


class NoWheel(SkygcsError):
    """There is no wheel of ``requirement``, the first one that pip did not find."""

    def __init__(self, purpose: str, requirement: str) -> None:
        super().__init__(f"bundle for {purpose}: there is no wheel of {requirement}; {REMEDY}")
        self.purpose = purpose
        self.requirement = requirement


def _all_missing(first: NoWheel, folder: Path, arch: str, python: str, sources: Sources) -> str:
    """The text for a person: pip stops at the first package without a wheel, so each one is asked for by itself."""
    wanted = requirements("skygcs", {EXTRA})

    def is_missing(requirement: str) -> bool:
        words = _download(requirement, folder / "tried", arch, python, sources)
        try:
            _pip(["download", "--no-deps", *words[1:]], first.purpose)
        except NoWheel:
            return True
        except SkygcsError:
            return False  # a fault of another kind: not known
        return False

    with ThreadPoolExecutor(PIPS_AT_ONCE) as pool:
        missing = [name for name, gone in zip(wanted, pool.map(is_missing, wanted), strict=True) if gone]
    listed = " ".join(f"'{name}'" for name in missing or [first.requirement])
    return (
        f"bundle for {first.purpose}: there are no wheels of {len(missing) or 1} of {len(wanted)} packages: {listed}. "
        f"{REMEDY}"
    )


def requirements(name: str, extras: Collection[str] = ()) -> list[str]:
    """Requirements of a package that is installed here, and theirs, as for pip. What is not installed here is for
    other systems."""
    found: dict[str, str] = {}
    waiting = [(name, frozenset(extras))]
    while waiting:
        package, wanted = waiting.pop()
        for text in metadata.requires(package) or []:
            requirement, _, marker = (part.strip() for part in text.partition(";"))
            needed = _EXTRA.search(marker)
            match = _REQUIREMENT.match(requirement)
            if match is None or (needed is not None and needed[1] not in wanted):
                continue
            other, own_extras = match[1], frozenset(filter(None, (match[2] or "").replace(" ", "").split(",")))
            try:
                metadata.distribution(other)
            except metadata.PackageNotFoundError:
                continue
            key = re.sub(r"[-_.]+", "-", other).lower()
            if key == name and not own_extras <= wanted:
                waiting.append((name, own_extras | wanted))  # an extra that consists of others
            elif key != name and key not in found:
                found[key] = requirement
                waiting.append((other, own_extras))
    return [found[key] for key in sorted(found)]


def _built_wheel(folder: Path) -> Path | None:
    """The pure wheel of this checkout; None if skygcs is not run from one."""
    root = Path(skygcs.__file__).resolve().parents[2]
    if not (root / "hatch_build.py").exists():
        return None
    _pip(["wheel", "--no-deps", "--wheel-dir", str(folder), str(root)], "skygcs itself", SKYGCS_PURE="1")
    return next(folder.glob("skygcs-*.whl"))


def _pip(words: Sequence[str], purpose: str, **environment: str) -> None:
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input", *words, "--quiet"]
    try:
        done = subprocess.run(
            command, env=os.environ | environment, capture_output=True, text=True, timeout=PIP_TIMEOUT_S
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise SkygcsError(f"bundle for {purpose}: pip: {error}") from None
    if done.returncode == 0:
        return
    missing = _NO_WHEEL.search(done.stderr)
    if missing is not None:
        raise NoWheel(purpose, missing[1])
    lines = [line for line in done.stderr.splitlines() if line.startswith("ERROR")] or done.stderr.splitlines()
    raise SkygcsError(f"bundle for {purpose}: pip: {lines[0][:300] if lines else f'exit code {done.returncode}'}")


def _write(output: Path, wheels: Sequence[Path], arch: str, python: str) -> None:
    own = next((wheel for wheel in wheels if wheel.name.startswith("skygcs-")), None)
    pip = next((wheel for wheel in wheels if wheel.name.startswith("pip-")), None)
    if own is None or pip is None:
        raise SkygcsError("bundle: the wheels have no skygcs or no pip among them")
    manifest = {
        "format": FORMAT,
        "version": own.name.split("-")[1],
        "arch": arch,
        "python": python,
        "pip_wheel": pip.name,
        "installed_bytes": sum(_unpacked_bytes(wheel) for wheel in wheels),
        "files": {wheel.name: {"bytes": wheel.stat().st_size, "sha256": _sha256(wheel)} for wheel in wheels},
    }
    text = json.dumps(manifest, indent=1).encode()
    draft = output.with_name(f".{output.name}.part")
    try:
        with tarfile.open(draft, "w") as archive:
            entry = tarfile.TarInfo("manifest.json")
            entry.size = len(text)
            archive.addfile(entry, io.BytesIO(text))
            for wheel in wheels:
                archive.add(wheel, f"wheels/{wheel.name}", recursive=False, filter=_anonymous)
        os.replace(draft, output)
    except OSError as error:
        raise SkygcsError(f"{output}: {error.strerror or error}") from None
    finally:
        draft.unlink(missing_ok=True)


def _anonymous(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    entry.uid = entry.gid = entry.mtime = 0
    entry.uname = entry.gname = ""
    entry.mode = 0o644
    return entry


def read_bundle(path: Path) -> Bundle:
    """Read a bundle's manifest and compare every wheel with it. Raises SkygcsError."""
    try:
        with tarfile.open(path, "r:") as archive:
            manifest = _manifest(archive)
            for name, facts in manifest["files"].items():
                _compare(archive, name, facts)
        size = path.stat().st_size
        digest = _sha256(path)
    except OSError as error:
        raise SkygcsError(f"{path}: {error.strerror or error}") from None
    except (tarfile.TarError, ValueError, KeyError, TypeError) as error:
        raise SkygcsError(f"{path} is not a bundle of `skygcs-cli companions bundle`: {error}") from None
    return Bundle(
        path=path,
        version=manifest["version"],
        arch=manifest["arch"],
        python=manifest["python"],
        sha256=digest,
        bytes=size,
        installed_bytes=manifest["installed_bytes"],
        pip_wheel=manifest["pip_wheel"],
    )


def _manifest(archive: tarfile.TarFile) -> dict[str, Any]:
    """Raises ValueError, KeyError or TypeError for anything that `_write` does not write."""
    entry = archive.next()
    if entry is None or entry.name != "manifest.json" or entry.size > MAX_MANIFEST_BYTES:
        raise ValueError("it does not begin with a manifest")
    file = archive.extractfile(entry)
    manifest: dict[str, Any] = json.loads(b"" if file is None else file.read())
    if manifest["format"] != FORMAT:
        raise ValueError(f"its format is {manifest['format']!r}, not {FORMAT}")
    for key in ("version", "arch", "python"):
        if not _WORD.fullmatch(manifest[key]):
            raise ValueError(f"{key} {manifest[key]!r}")
    files = manifest["files"]
    if (
        not isinstance(files, dict)
        or not 0 < len(files) <= MAX_FILES
        or not all(_WHEEL.fullmatch(name) for name in files)
    ):
        raise ValueError("it names files that are no wheels")
    if manifest["pip_wheel"] not in files or not isinstance(manifest["installed_bytes"], int):
        raise ValueError("it has no pip")
    names = sorted(archive.getnames())
    if names != sorted(["manifest.json", *(f"wheels/{name}" for name in files)]):
        raise ValueError("it holds other files than the manifest names")
    return manifest


def _compare(archive: tarfile.TarFile, name: str, facts: Any) -> None:
    entry = archive.getmember(f"wheels/{name}")
    file = archive.extractfile(entry) if entry.isfile() else None
    if file is None or _digest(file) != facts["sha256"]:
        raise ValueError(f"{name} is damaged")


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return _digest(file)


def _digest(file: IO[bytes]) -> str:
    digest = hashlib.sha256()
    while data := file.read(READ_BYTES):
        digest.update(data)
    return digest.hexdigest()


def _unpacked_bytes(wheel: Path) -> int:
    try:
        with zipfile.ZipFile(wheel) as archive:
            return sum(entry.file_size for entry in archive.infolist())
    except zipfile.BadZipFile as error:
        raise SkygcsError(f"{wheel.name}: {error}") from None
