"""`make test-container`: the steps of the Containerfile, carried out in empty roots, and what comes out of them, run.

It names what is missing. MIRROR: where Debian's packages come from, by default as this machine has it.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from container.containerfile import stages_of
from container.rooms import Root, base_root, context_of, missing
from support.process import ROOT

BUILD = ROOT / "build" / "container"
MIRROR = "http://deb.debian.org/debian"
READY_S = 60.0

FLEET = """
[web]
[links.sim]
type = "simulated"
px4 = 1
ardupilot = 2
"""


def main() -> int:
    problems = missing()
    if problems:
        print("\n".join(problems), file=sys.stderr)
        return 1
    BUILD.mkdir(parents=True, exist_ok=True)
    with (BUILD / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print(f"another make test-container works in {BUILD}", file=sys.stderr)
            return 1
        return carry_out()


def carry_out() -> int:
    """All stages, one after the other, and the last one's command; the exit code."""
    stages = stages_of((ROOT / "Containerfile").read_text(encoding="utf-8"))
    context = context_of(BUILD / "context")
    roots: dict[str, Root] = {}
    try:
        for stage in stages:
            began = time.monotonic()
            print(f"== FROM {stage.base} AS {stage.name}", flush=True)
            roots[stage.name] = Root(BUILD / f"stage-{stage.name}", base_root(BUILD, suite_of(stage.base), mirror()))
            roots[stage.name].carry_out(stage, roots, context)
            print(f"== {stage.name}: {time.monotonic() - began:.0f} s", flush=True)
        runs(roots[stages[-1].name])
    except subprocess.CalledProcessError as error:
        print(f"FAILED, exit code {error.returncode}: {str(error.cmd[-1])[-400:]}", file=sys.stderr)
        return 1
    finally:
        for root in roots.values():
            subprocess.run(["rm", "-rf", "--one-file-system", str(root.path)], check=True)
    return 0


def suite_of(base: str) -> str:
    """The release of a Debian image."""
    found = re.search(r"/debian:([a-z]+)-\d{8}", base)
    if found is None:
        raise ValueError(f"{base} is no dated image of Debian")
    return found[1]


def mirror() -> str:
    """MIRROR, or the first address of this machine's own sources of packages, if it is a Debian, or Debian's."""
    if given := os.environ.get("MIRROR"):
        return given
    for path in (*sorted(Path("/etc/apt").glob("sources.list.d/*.sources")), Path("/etc/apt/sources.list")):
        if path.is_file() and (
            found := re.search(r"^(?:URIs:|deb)\s.*?(https?://\S+/debian)/?\s", path.read_text(), re.M)
        ):
            return found[1]
    return MIRROR


def runs(root: Root) -> None:
    """The container's own command, as its user: three vehicles are seen, the page is there, SIGTERM ends it with 0."""
    root.write("fleet.toml", FLEET)
    user = subprocess.run(root.words(["id"]), check=True, capture_output=True, text=True).stdout
    assert "uid=1000(skygcs)" in user and "(dialout)" in user, user
    version = subprocess.run(root.words([*root.entrypoint, "--version"]), check=True, capture_output=True, text=True)
    with subprocess.Popen(root.words([*root.entrypoint, *root.command]), start_new_session=True) as daemon:
        try:
            answers(root, daemon, ["skygcs-cli", "status", "--json"], lambda text: len(json.loads(text)) == 3)
            answers(root, daemon, ["skygcs", "web", "link"], lambda text: "http://" in text)
            answers(root, daemon, ["skygcs-cli", "docs", "radio"], lambda text: "RFD900x" in text)
        finally:
            os.killpg(daemon.pid, signal.SIGTERM)
            ended = daemon.wait(30)
    assert ended == 0, f"SIGTERM ended it with {ended}"
    print(f"{version.stdout.strip()}: 3 vehicles seen, a link to the page, the documentation, ended by SIGTERM with 0")


def answers(root: Root, daemon: subprocess.Popen[bytes], words: list[str], right: Callable[[str], bool]) -> None:
    """Run a command beside the daemon until it answers right: what is asked about may still be starting."""
    deadline = time.monotonic() + READY_S
    while True:
        done = subprocess.run(root.words(words), capture_output=True, text=True)
        if done.returncode == 0 and right(done.stdout):
            return
        assert daemon.poll() is None, f"{daemon.args} has ended with {daemon.returncode}"
        assert time.monotonic() < deadline, f"{' '.join(words)}: {done.stdout[-300:]}{done.stderr[-300:]}"
        time.sleep(0.5)


if __name__ == "__main__":
    sys.exit(main())
