"""The planning process: `python -P -m skygcs.ext.plans.planning.worker`.

Reads requests from standard input, one after the other: a line `request|call MEMORY_MB CPU_S ANSWER_BYTES LENGTH` and
so many bytes. A request is JSON (`request.py`); it writes lines of JSON, {"progress": …} now and then, and last the
answer. A call is a pickled function and its arguments: the answer is pickled, too, in base64. The limits are of one
request.

It is started by `process.py`, which ends it when nobody waits for the answer any more; should that one be killed, the
limit of CPU time ends this one, or the end of its input.
"""

from __future__ import annotations

import base64
import contextlib
import json
import math
import os
import pickle
import resource
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import replace

from skygcs.core.plan.fleet_plan import FlightSpace, Plan, TimedPlan
from skygcs.core.plan.margins import MarginRule
from skygcs.core.plan.plan_json import plan_content, plan_from_json, space_of
from skygcs.core.trajectory import MotionLimits, least_limits
from skygcs.errors import SkygcsError
from skygcs.ext.plans.certificates.certify import certify
from skygcs.ext.plans.certificates.plan_search import Task, make_plan
from skygcs.ext.plans.flight.flight_steps import starts_of
from skygcs.ext.plans.planning.process import CALL
from skygcs.ext.plans.planning.request import JsonObject, path_of, rule_of, without_text

NICENESS = 10
"""A control loop on the same computer goes first."""

HEADER_BYTES = 200
"""A line of five words."""

PROGRESS_S = 0.1
"""From one report to the next: a bar that moves ten times a second looks smooth."""

Report = Callable[[str, int, int], None]


def main() -> None:
    """Answer requests up to the end of the input. Refusals are answers; anything else ends it with a traceback on
    standard error."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole terminal: the one that waits decides
    with contextlib.suppress(OSError):
        os.nice(NICENESS)
    while header := sys.stdin.buffer.readline(HEADER_BYTES):
        kind, *numbers = header.decode().split()
        memory_mb, cpu_s, answer_bytes, length = (int(number) for number in numbers)
        spent = resource.getrusage(resource.RUSAGE_SELF)
        cpu_s += math.ceil(spent.ru_utime + spent.ru_stime)
        for what, limit in ((resource.RLIMIT_AS, memory_mb << 20), (resource.RLIMIT_CPU, cpu_s)):
            hard = resource.getrlimit(what)[1]
            resource.setrlimit(what, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
        try:
            request = sys.stdin.buffer.read(length)
            text = _called(request, answer_bytes) if kind == CALL else _answered(request, answer_bytes)
        except MemoryError:
            sys.stdout.write(json.dumps({"refused": f"it needs more than {memory_mb:,} MiB of memory"}) + "\n")
            return
        sys.stdout.write(text + "\n")
        sys.stdout.flush()


def _answered(request: bytes, answer_bytes: int) -> str:
    """The answer to a request as JSON, or why it refused."""
    try:
        text = json.dumps(answered(without_text(request), _reporter()))
    except SkygcsError as error:
        text = json.dumps({"refused": str(error)})
    if len(text) > answer_bytes:
        text = json.dumps({"refused": f"the plan has {len(text):,} bytes; the most is {answer_bytes:,}"})
    return text


def _called(request: bytes, answer_bytes: int) -> str:
    """Call a function: (None, its result) or (why it refused, None), pickled, in base64."""
    try:
        function, arguments = pickle.loads(request)
        answer = pickle.dumps((None, function(*arguments)), pickle.HIGHEST_PROTOCOL)
    except SkygcsError as error:
        answer = pickle.dumps((str(error), None))
    if 4 * len(answer) > 3 * answer_bytes:
        answer = pickle.dumps((f"the answer has {len(answer):,} bytes, too many", None))
    return base64.b64encode(answer).decode()


def answered(request: JsonObject, report: Report) -> JsonObject:
    """The answer to a request. Raises SkygcsError."""
    rule, limits = rule_of(request["rule"]), _Limits(request)
    space = space_of("the request", json.loads(json.dumps(request["space"])))
    notes: JsonObject = request.get("notes", {})
    if request["do"] == "make":
        return _made(request, rule, limits, space, report) | notes
    if request["do"] == "paths":
        plan: Plan = TimedPlan({name: path_of(name, path, limits.of(name)) for name, path in request["paths"].items()})
    else:
        plan, own = plan_from_json("the plan", request["plan"])
        heard: JsonObject = notes.get("standing", {})
        for name in starts_of(plan).keys() & heard.keys():  # it takes part: where it was heard it is no obstacle
            del heard[name]
            space = replace(space, standing={n: place for n, place in space.standing.items() if n != name})
        space = own.joined(space)
    certificate = certify(
        plan,
        rule,
        space,
        limits={name: limits.of(name) for name in starts_of(plan)} if request["within_limits"] else None,
        progress=lambda done, total: report("certify", done, total),
    )
    found = certificate.as_dict()
    kept = request["do"] == "paths" or request["keep"]
    content = plan_content(plan, space, found) if kept and certificate.certified else None
    return {"certificate": found, "plan": content, "attempts": [], "reasons": certificate.reasons()} | notes


class _Limits:
    """Limits of a request: each vehicle's own, or those of all."""

    def __init__(self, request: JsonObject) -> None:
        self._of_all = MotionLimits(**request["limits"])
        self._own = {name: MotionLimits(**given) for name, given in request.get("limits_of", {}).items()}

    def of(self, name: str) -> MotionLimits:
        return self._own.get(name, self._of_all)


def _made(request: JsonObject, rule: MarginRule, limits: _Limits, space: FlightSpace, report: Report) -> JsonObject:
    starts, goals = ({name: (x, y, z) for name, (x, y, z) in request[which].items()} for which in ("starts", "goals"))
    task = Task(starts, goals, request["exchangeable"], request["kind"])
    found = make_plan(task, rule, least_limits(limits.of(name) for name in starts), space, report)
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
