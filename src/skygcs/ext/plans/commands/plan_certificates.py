"""Certificates for the command line: has them computed in a process or by the daemon, shows how far that is, prints
them."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from skygcs.cli.connection import Exit, fail
from skygcs.cli.render import console, print_json, say, table
from skygcs.ext.plans.planning.process import run
from skygcs.rpc.client import Client

Answer = Mapping[str, Any]


def computed(request: dict[str, Any], json_output: bool) -> Answer:
    """The answer of a planning process to a request (`planning/request.py`). Raises SkygcsError; Ctrl-C ends it."""
    with _bar(json_output) as report:
        return run(request, report)


async def asked(gcs: Client, method: str, json_output: bool, **params: Any) -> Answer:
    """The daemon's answer to plan.make or plan.certify. Raises SkygcsError; Ctrl-C ends the request."""
    if "plan" in params:
        params |= await gcs.given_plan(json.dumps(params.pop("plan")))
    with _bar(json_output) as report:
        return await gcs.planning(method, on_progress=report, **params)


@contextlib.contextmanager
def _bar(json_output: bool) -> Iterator[Callable[[Answer], None] | None]:
    """A progress bar on the terminal while the body runs; none for programs."""
    if json_output or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task("planning", total=None)

        def report(done: Answer) -> None:
            progress.update(bar, description=done["what"], completed=done["done"], total=done["total"])

        yield report


def print_answer(answer: Answer, json_output: bool, what: str, written: str = "") -> Exit:
    """The certificate of a plan and where it was written; the exit code."""
    certificate = answer["certificate"]
    if json_output:
        more = {"attempts": answer["attempts"]} if answer["attempts"] else {"format": what}
        print_json(certificate | more | {"output": written})
    else:
        print_certificate(certificate, written)
    return Exit.DONE if certificate["certified"] else Exit.FAILED


def print_refusal(answer: Answer, json_output: bool) -> Exit:
    """Why no plan was found."""
    reasons = answer["reasons"]
    if json_output:
        print_json({"certified": False, "attempts": answer["attempts"], "reasons": reasons})
    else:
        fail("refused:\n" + "\n".join(f"  {reason}" for reason in reasons))
    return Exit.FAILED


def print_certificate(certificate: Answer, written: str = "") -> None:
    """Certified or refused, why, and each term of the closest pair's margin with where it comes from."""
    duration_s, closest = certificate["duration_s"], certificate["closest"]
    duration = "" if duration_s is None else f", {duration_s:.1f} s"
    word = "certified" if certificate["certified"] else "REFUSED"
    say(f"{word}: {certificate['vehicles']} vehicles, {certificate['kind']}{duration}")
    for reason in certificate["reasons"]:
        say(f"  {reason}")
    if closest is None:
        say("one vehicle and nothing it could meet")
    else:
        if certificate["certified"]:
            say(f"closest: {closest['text']}")
        _print_terms(closest, certificate["downwash_ratio"])
        flown_m = closest["flown_at_least_m"]
        if certificate["certified"] and flown_m is not None:
            say(f"flown within these terms they stay {flown_m:.2f} m apart, by their own positions")
    if written:
        say(written)


def _print_terms(closest: Answer, ratio: float) -> None:
    terms, vehicles = closest["terms"], closest["vehicles"]
    names = list(dict.fromkeys(term for of_vehicle in terms.values() for term in of_vehicle))
    rows = [
        [name, *(f"{terms[vehicle].get(name, 0.0):.3f}" for vehicle in vehicles), _source(closest, name)]
        for name in names
    ]
    rows.append(["sum", *(f"{sum(terms[vehicle].values()):.3f}" for vehicle in vehicles), ""])
    columns = [f"margin, m (height / {ratio:g})", *vehicles, "source"]
    console().print(table(columns, rows, right=vehicles, wrap=("source",)))


def _source(closest: Answer, term: str) -> str:
    """Where a term comes from; of each vehicle if they differ."""
    found: dict[str, str] = {v: closest["sources"][v].get(term, "") for v in closest["vehicles"]}
    if len(set(found.values())) == 1:
        return next(iter(found.values()))
    return "; ".join(f"{vehicle} {source}" for vehicle, source in found.items())
