"""`make bench-federation`: many stations over a real nats-server. All in build/bench/federation.json.

python -m bench.federation [--only PART] [--seconds N]

On a machine that is busy with other things the times say little; what is lost, doubled or refused counts anywhere.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
from collections.abc import Callable
from typing import Any

from bench.federation.faults import check_faults, measure_faults
from bench.federation.full import check_full, measure_full
from bench.federation.leases import check_races, check_takeover, measure_races, measure_takeover
from bench.federation.state import check_state, measure_state
from skygcs.errors import SkygcsError
from skygcs.ext.federation.server_program import find_server
from support.process import ROOT

OUT = ROOT / "build" / "bench"

Found = dict[str, Any]
Part = tuple[Callable[[float], Found], Callable[[Found], list[tuple[str, bool]]]]

PARTS: dict[str, Part] = {
    "state": (measure_state, check_state),
    "faults": (measure_faults, check_faults),
    "races": (measure_races, check_races),
    "takeover": (measure_takeover, check_takeover),
    "full": (measure_full, check_full),
}
"""What measures a part (given the seconds of a measurement), and (line, whether it holds) of what was found."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="bench.federation", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", choices=PARTS)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each measurement")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # a time limit, too, ends all that was started
    try:
        find_server()
    except SkygcsError as error:
        print(error, file=sys.stderr)
        return 1
    path = OUT / "federation.json"
    found: Found = json.loads(path.read_text()) if options.only and path.exists() else {}
    missed = 0
    for name, (measure, check) in PARTS.items():
        if options.only not in (None, name):
            continue
        print(f"{name}:", flush=True)
        found[name] = measure(options.seconds) | {"load": os.getloadavg()[0]}
        for line, holds in check(found[name]):
            missed += not holds
            print(f"{'ok  ' if holds else 'MISS'} {line}", flush=True)
        OUT.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(found, indent=1) + "\n")
    print(path.relative_to(ROOT))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
