"""The outcomes of an order as they come: a line for each vehicle at once, JSON lines, or one JSON object at the end."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from skygcs.cli.render import OutcomeLines, print_json, print_lines, say, screen_width, wrapped

Outcomes = Mapping[str, Mapping[str, Any]]

JsonForm = bool | None
"""None: text. True: one JSON object with all outcomes at the end. False: a JSON line for each vehicle as it comes."""

NAMED = 3
"""At most so many vehicles are named that have not answered; of more, their number is shown."""


class OrderOutput:
    """Prints the outcomes of one order. ``clear`` is called before each line: it removes what is drawn there."""

    def __init__(self, form: JsonForm, clear: Callable[[], None] = lambda: None) -> None:
        self.form = form
        self.clear = clear
        self.vehicles: Sequence[str] = ()
        """The vehicles that the order goes to, as far as is known."""
        self.outcomes: dict[str, Mapping[str, Any]] = {}
        """Outcomes that have come so far, by vehicle."""
        self._lines = OutcomeLines(screen_width(sys.stdout))

    def begin(self, vehicles: Sequence[str]) -> None:
        """The order goes to these vehicles."""
        self.vehicles = [*self.vehicles, *vehicles]
        self._lines.width = max((len(name) for name in self.vehicles), default=0)

    def take(self, vehicle: str, outcome: Mapping[str, Any]) -> None:
        """Print one outcome, unless all of them are one object at the end."""
        self.outcomes[vehicle] = outcome
        if self.form is True:
            return
        self.clear()
        if self.form is False:
            print_json({"vehicle": vehicle, "outcome": outcome}, line=True)
        else:
            print_lines(self._lines.of(vehicle, outcome))
            sys.stdout.flush()

    def end(self) -> None:
        """All have come: print the object, or on a terminal which of several vehicles failed."""
        failed = [name for name, outcome in self.outcomes.items() if not outcome["ok"]]
        if self.form is True:
            print_json({"outcomes": self.outcomes})
        elif self.form is None and failed and len(self.outcomes) > NAMED and (columns := screen_width(sys.stderr)):
            text = f"skygcs-cli: {len(failed)} of {len(self.outcomes)} failed: {', '.join(failed)}"
            say(wrapped(text, columns, indent=2), err=True)

    @property
    def awaited(self) -> str:
        """The vehicles without an outcome, for a person; "" if they are not known."""
        left = [name for name in self.vehicles if name not in self.outcomes]
        if not left or (len(left) > NAMED and not self.outcomes):
            return ""
        return f"waiting for {', '.join(left)}" if len(left) <= NAMED else f"waiting for {len(left)} vehicles"
