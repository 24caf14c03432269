"""`make fuzz`: the compiled fast path under the address and undefined behaviour sanitizers.

    make fuzz                                       # 1,000,000 datagrams, some 20 minutes
    make fuzz FUZZ_SECONDS=45                       # the short form, as .ci/run has it
    PYTHONPATH=tests python -m fuzz.fast_path --first 4711 --count 1 --plain      # one scenario, as installed

It compiles `_fast_path.c` anew with -fsanitize=address,undefined and plays, in a process of its own, (1) the tests of
its interface, in which callbacks raise, close links and memory runs out, (2) its calls in any order, (3) scenarios with
and without the fast path, which must end up equal (`support.fast_path`). One that takes a minute hangs. The
report is build/fuzz/fast_path.json. FUZZ_DATAGRAMS, FUZZ_SECONDS, FUZZ_SEED (the first scenario) and FUZZ_JOBS.
"""

from __future__ import annotations

import argparse
import faulthandler
import importlib
import importlib.util
import json
import os
import random
import shutil
import subprocess
import sys
import sysconfig
import time
from collections import Counter
from pathlib import Path

from fuzz import fast_path_calls
from support import fast_path
from support.watchdog import processor_limit

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "skygcs" / "links" / "_fast_path.c"
OUT = ROOT / "build" / "fuzz"
MODULE = "skygcs.links._fast_path"

SANITIZE = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer"]
ENVIRONMENT = {
    "ASAN_OPTIONS": "detect_leaks=0:abort_on_error=1",  # Python itself keeps much until exit
    "UBSAN_OPTIONS": "print_stacktrace=1",
    "PYTHONMALLOC": "malloc",  # so that the sanitizer sees each of Python's blocks, and not its arenas
    "SKYGCS_REQUIRE_FASTPATH": "1",
}

LIMIT_S = 60.0
"""Of processor time for one scenario, which takes a second at most, two under the sanitizers."""

STUCK_S = 1800.0
"""Of real time, against waiting for what never comes."""

SCENARIO_STEPS = 60
COUNTED_STEPS = 12
"""Of longer ones more fits into the time; of shorter ones more different ones, in the test suite."""


class Missing(Exception):
    """What has to be installed first."""


def build() -> tuple[Path, str]:
    """The extension with sanitizers, and what has to be loaded before Python. Raises Missing."""
    compiler = shutil.which(os.environ.get("CC") or "gcc") or shutil.which("cc")
    if compiler is None:
        raise Missing("make fuzz needs gcc: apt install gcc (Debian, Ubuntu) or dnf install gcc (Fedora)")
    found = subprocess.run([compiler, "-print-file-name=libasan.so"], capture_output=True, text=True, check=True)
    runtime = Path(found.stdout.strip())
    version = subprocess.run([compiler, "-dumpversion"], capture_output=True, text=True, check=True).stdout
    package = f"libgcc-{version.strip().partition('.')[0]}-dev"
    install = f"apt install {package} (Debian, Ubuntu) or dnf install libasan libubsan (Fedora)"
    if not runtime.is_absolute():
        raise Missing(f"make fuzz needs the runtime of the sanitizers, libasan and libubsan of {compiler}: {install}")
    OUT.mkdir(parents=True, exist_ok=True)
    built = OUT / f"_fast_path{sysconfig.get_config_var('EXT_SUFFIX')}"
    command = [compiler, "-g", "-O1", "-Wall", "-Wextra", "-Werror", *SANITIZE, "-shared", "-fPIC"]
    command += ["-I", sysconfig.get_path("include"), "-o", str(built), str(SOURCE)]
    compiled = subprocess.run(command, capture_output=True, text=True, check=False)
    if compiled.returncode:
        raise Missing(f"{SOURCE.name} cannot be compiled with sanitizers ({install}?):\n{compiled.stderr}")
    return built, str(runtime.resolve())


def load(path: Path) -> None:
    """From now on this is the compiled fast path."""
    spec = importlib.util.spec_from_file_location(MODULE, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.modules[MODULE] = module
    package, _, name = MODULE.rpartition(".")
    setattr(importlib.import_module(package), name, module)


# -- the process that plays


def play(options: argparse.Namespace) -> int:
    """The tests, calls in any order, scenarios; the counts on the last line of the output."""
    # The loopback keeps the order of datagrams on one CPU only: a busy machine moves a process between two sends.
    os.sched_setaffinity(0, {random.choice(sorted(os.sched_getaffinity(0)))})
    if options.module:
        load(Path(options.module))
    if not options.count and options.tests and _interface_tests():
        return 1
    counts: Counter[str] = Counter()
    began = time.monotonic()
    seed = options.first
    while _goes_on(options, counts, time.monotonic() - began):
        print(f"scenario {seed}", flush=True)
        faulthandler.dump_traceback_later(STUCK_S, exit=True)
        with processor_limit(LIMIT_S):
            if not _scenario(options, seed, counts):
                return 1
        faulthandler.cancel_dump_traceback_later()
        seed += options.step
        print(json.dumps(counts), flush=True)
    return 0


def _scenario(options: argparse.Namespace, seed: int, counts: Counter[str]) -> bool:
    """One scenario, and a run of calls beside it; False if the fast path made a difference."""
    made = fast_path.scenario(seed, length=COUNTED_STEPS if options.count else SCENARIO_STEPS)
    found = fast_path.differences(made)
    if found:  # or did another program send something to a port that was its own before?
        print("\n".join(found), flush=True)
        if fast_path.differences(made):
            return False
        counts["differences not seen again"] += 1
    counts["scenarios"] += 1
    counts["datagrams"] += made.datagrams
    counts["frames"] += made.frames
    counts["datagrams on the fast path"] += made.fast
    counts["bursts of 65 frames and more"] += made.bursts
    if not options.count:
        counts["calls"] += fast_path_calls.play(seed)
    return True


def _goes_on(options: argparse.Namespace, counts: Counter[str], seconds: float) -> bool:
    if options.count:
        return counts["scenarios"] < options.count
    if options.seconds:
        return seconds < options.seconds
    return counts["datagrams"] < options.datagrams


def _interface_tests() -> int:
    """tests/unit/links/test_fast_path.py, in this process."""
    import pytest

    print("the tests of the interface", flush=True)
    file = ROOT / "tests" / "unit" / "links" / "test_fast_path.py"
    return int(pytest.main([str(file), "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--rootdir", str(ROOT)]))


# -- the process that watches


def watch(options: argparse.Namespace) -> int:
    """Build, play in processes of their own, add up."""
    environment, words = dict(os.environ), []
    if not options.plain:
        try:
            built, runtime = build()
        except Missing as missing:
            print(missing, file=sys.stderr)
            return 2
        environment |= {**ENVIRONMENT, "LD_PRELOAD": runtime}
        words = ["--module", str(built)]
    began = time.monotonic()
    jobs = []
    for job in range(options.jobs):
        command = [sys.executable, "-m", "fuzz.fast_path", "--play", *words, "--first", str(options.first + job)]
        command += ["--step", str(options.jobs), "--count", str(options.count), "--seconds", str(options.seconds)]
        command += ["--datagrams", str(-(-options.datagrams // options.jobs)), *([] if job else ["--tests"])]
        OUT.mkdir(parents=True, exist_ok=True)
        with (OUT / f"job-{job}.log").open("wb") as log:
            jobs.append(subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=environment, cwd=ROOT))
    failed = [job for job, process in enumerate(jobs) if process.wait() != 0]
    for job in failed:
        said = (OUT / f"job-{job}.log").read_text(errors="replace").splitlines()
        last = next((line for line in reversed(said) if line.startswith("scenario ")), "before the first scenario")
        print(f"FAILED with code {jobs[job].returncode} at {last}:", *said[-60:], sep="\n")
    if failed:
        return 1
    total: Counter[str] = Counter()
    for job in range(options.jobs):
        total.update(json.loads((OUT / f"job-{job}.log").read_text().splitlines()[-1]))
    report = {
        **total,
        "seconds": round(time.monotonic() - began),
        "first scenario": options.first,
        "sanitizers": [] if options.plain else ["address", "undefined"],
    }
    (OUT / "fast_path.json").write_text(json.dumps(report, indent=1) + "\n")
    print(
        *(f"{name}: {value:,}" if isinstance(value, int) else f"{name}: {value}" for name, value in report.items()),
        sep="\n",
    )
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--datagrams", type=int, default=int(os.environ.get("FUZZ_DATAGRAMS") or 1_000_000))
    parser.add_argument("--seconds", type=float, default=float(os.environ.get("FUZZ_SECONDS") or 0))
    parser.add_argument("--first", type=int, default=int(os.environ.get("FUZZ_SEED") or 0))
    parser.add_argument("--jobs", type=int, default=int(os.environ.get("FUZZ_JOBS") or 1))
    parser.add_argument("--count", type=int, default=0, help="so many scenarios and nothing else")
    parser.add_argument("--plain", action="store_true", help="the fast path as it is installed, without sanitizers")
    parser.add_argument("--play", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--tests", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--step", type=int, default=1, help=argparse.SUPPRESS)
    parser.add_argument("--module", default="", help=argparse.SUPPRESS)
    options = parser.parse_args()
    return play(options) if options.play else watch(options)


if __name__ == "__main__":
    sys.exit(main())
