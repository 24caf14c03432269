"""The planning process: `python -P -m skygcs.planning.worker request|call MEMORY_MB CPU_S ANSWER_BYTES`.

Reads one request (`request.py`) from standard input up to its end, writes lines of JSON: {"progress": …} now and then,
and last the answer. Or (call) a pickled function and its arguments: the answer is pickled, too, in base64.

It is started by `process.py`, which ends it when nobody waits for the answer any more; should that one be killed, the
limit of CPU time ends this one.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import pickle
import resource
import signal
import sys
import time
from collections.abc import Callable

from skygcs.core.plan.certify import certify
from skygcs.core.plan.fleet_plan import FlightSpace, Plan, TimedPlan
from skygcs.core.plan.margins import MarginRule
from skygcs.core.plan.plan_json import plan_content, plan_from_json, space_of
from skygcs.core.plan.plan_search import Task, make_plan
from skygcs.core.trajectory import MotionLimits
from skygcs.errors import SkygcsError
from skygcs.planning.process import CALL
from skygcs.planning.request import JsonObject, path_of, rule_of

NICENESS = 10
"""A control loop on the same computer goes first."""

PROGRESS_S = 0.1
"""From one report to the next: a bar that moves ten times a second looks smooth."""

Report = Callable[[str, int, int], None]


def main() -> None:
    """Answer the one request. Refusals are answers; anything else ends with a traceback on standard error."""
    kind = sys.argv[1]
    memory_mb, cpu_s, answer_bytes = (int(argument) for argument in sys.argv[2:5])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole terminal: the one that waits decides
    for what, limit in ((resource.RLIMIT_AS, memory_mb << 20), (resource.RLIMIT_CPU, cpu_s)):
        with contextlib.suppress(ValueError):  # a lower one is in force already
            resource.setrlimit(what, (limit, limit))
    with contextlib.suppress(OSError):
        os.nice(NICENESS)
    try:
        if kind == CALL:
            return _called(sys.stdin.buffer.read(), answer_bytes)
        answer = answered(json.load(sys.stdin.buffer), _reporter())
        text = json.dumps(answer)
        if len(text) > answer_bytes:
            text = json.dumps({"refused": f"the plan has {len(text):,} bytes; the most is {answer_bytes:,}"})
    except SkygcsError as error:
        text = json.dumps({"refused": str(error)})
    except MemoryError:
        text = json.dumps({"refused": f"it needs more than {memory_mb:,} MiB of memory"})
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _called(request: bytes, answer_bytes: int) -> None:
    """Call a function, and write (None, its result) or (why it refused, None)."""
    try:
        function, arguments = pickle.loads(request)
        answer = pickle.dumps((None, function(*arguments)), pickle.HIGHEST_PROTOCOL)
    except SkygcsError as error:
        answer = pickle.dumps((str(error), None))
    if 4 * len(answer) > 3 * answer_bytes:
        answer = pickle.dumps((f"the answer has {len(answer):,} bytes, too many", None))
    sys.stdout.buffer.write(base64.b64encode(answer) + b"\n")
    sys.stdout.buffer.flush()


def answered(request: JsonObject, report: Report) -> JsonObject:
    """The answer to a request. Raises SkygcsError."""
    rule, limits = rule_of(request["rule"]), MotionLimits(**request["limits"])
    space = space_of("the request", json.loads(json.dumps(request["space"])))
    notes: JsonObject = request.get("notes", {})
    if request["do"] == "make":
        return _made(request, rule, limits, space, report) | notes
    if request["do"] == "paths":
        plan: Plan = TimedPlan({name: path_of(name, path, limits) for name, path in request["paths"].items()})
    else:
        plan, own = plan_from_json("the plan", request["plan"])
        space = own.joined(space)
    certificate = certify(
        plan,
        rule,
        space,
        limits=limits if request["within_limits"] else None,
        progress=lambda done, total: report("certify", done, total),
    )
    found = certificate.as_dict()
    kept = request["do"] == "paths" or request["keep"]
    content = plan_content(plan, space, found) if kept and certificate.certified else None
    return {"certificate": found, "plan": content, "attempts": [], "reasons": certificate.reasons()} | notes


def _made(
    request: JsonObject, rule: MarginRule, limits: MotionLimits, space: FlightSpace, report: Report
) -> JsonObject:
    starts, goals = ({name: (x, y, z) for name, (x, y, z) in request[which].items()} for which in ("starts", "goals"))
    task = Task(starts, goals, request["exchangeable"], request["kind"])
    found = make_plan(task, rule, limits, space, report)
    certificate = None if found.certificate is None else found.certificate.as_dict()
    return {
        "certificate": certificate,
        "plan": None if found.plan is None else plan_content(found.plan, space, certificate),
        "attempts": [attempt.what for attempt in found.attempts],
        "reasons": found.reasons(),
    }


def _reporter() -> Report:
    last = -PROGRESS_S

    def report(what: str, done: int, total: int) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= PROGRESS_S or done == total:
            last = now
            sys.stdout.write(json.dumps({"progress": {"what": what, "done": done, "total": total}}) + "\n")
            sys.stdout.flush()

    return report


if __name__ == "__main__":
    main()
