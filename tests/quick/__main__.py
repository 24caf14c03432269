"""`make quick`: the tests that the work since main touches. BASE=<commit> compares with another commit."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from quick.choice import Choice, choose
from support.file_costs import KEPT_AS

ROOT = Path(__file__).resolve().parents[2]
TESTS = ("tests/unit", "tests/integration")


def git(*words: str) -> list[str]:
    """Lines that git prints; none where it fails."""
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True)
    return done.stdout.splitlines() if done.returncode == 0 else []


def changed_files() -> list[str]:
    """Files that differ from where this branch left main, and new ones; on main itself those of the last commit too."""
    base = os.environ.get("BASE")
    if not base:
        mains = [name for name in ("main", "origin/main") if git("rev-parse", "--verify", "--quiet", name)]
        (base,) = git("merge-base", "HEAD", mains[0]) if mains else ["HEAD"]
        if [base] == git("rev-parse", "HEAD"):
            base = "HEAD" if git("status", "--porcelain") else "HEAD~1"
    return [*git("diff", "--name-only", base), *git("ls-files", "--others", "--exclude-standard")]


def last_costs() -> dict[str, float]:
    """CPU seconds of each file when it last ran on this machine; empty before the first run."""
    path = ROOT / ".pytest_cache/v" / KEPT_AS
    return json.loads(path.read_text()) if path.is_file() else {}


def choice() -> Choice:
    files = [path for folder in TESTS for path in (ROOT / folder).rglob("test_*.py")]
    return choose(
        changed_files(), {path.relative_to(ROOT).as_posix(): path.read_text() for path in files}, last_costs()
    )


def main(words: list[str]) -> int:
    chosen = choice()
    if chosen.left_out:
        print(f"left out, to stay short: {len(chosen.left_out)} more files that import what changed (make test)")
    if not chosen.run:
        print("no test of make test belongs to what changed")
        return 0
    print(f"{len(chosen.run)} test files belong to what changed")
    workers = [] if len(chosen.run) < 3 else ["-n", "auto", "--dist", "worksteal"]
    return subprocess.call([sys.executable, "-m", "pytest", *workers, *words, *chosen.run], cwd=ROOT)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
