"""`make bench-federation`: many stations over a real nats-server. All in build/bench/federation.json.

python -m bench.federation [--only PART] [--seconds N]

On a machine that is busy with other things the times say little; what is lost, doubled or refused counts anywhere.
"""

from __future__ import annotations

import sys

from bench.federation.faults import check_faults, measure_faults
from bench.federation.full import check_full, measure_full
from bench.federation.leases import check_races, check_takeover, measure_races, measure_takeover
from bench.federation.state import check_state, measure_state
from bench.results import Part, run_parts
from skygcs.errors import SkygcsError
from skygcs.ext.federation.server_program import find_server

PARTS: dict[str, Part] = {
    "state": (measure_state, check_state),
    "faults": (measure_faults, check_faults),
    "races": (measure_races, check_races),
    "takeover": (measure_takeover, check_takeover),
    "full": (measure_full, check_full),
}


def main() -> int:
    try:
        find_server()
    except SkygcsError as error:
        print(error, file=sys.stderr)
        return 1
    return run_parts("federation", PARTS, 20.0)


if __name__ == "__main__":
    sys.exit(main())
