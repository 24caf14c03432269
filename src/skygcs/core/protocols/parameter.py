"""One parameter of one vehicle: read, or set and read back.

Rule: everything that decides how reading or setting one parameter goes on is in this file.

    state      what came                                      next       effects
    --------   --------------------------------------------   --------   -------------------------------------------
    IDLE       start                                          READING    request by name (WRITING: PARAM_SET, if what
                                                                         the vehicle holds was known before); with a
                                                                         probe if it is not in the vehicle's list
    READING    its value, to be read                          DONE       Finish: accepted
    READING    its value, to be set, which fits               WRITING    PARAM_SET
    READING    its value, to be set, which does not fit       DONE       Finish: refused
    READING    timer, repeats left                            READING    request by name, and of an index as a probe
    READING    the probe's value, not in the vehicle's list   READING    request by name and the next probe
    READING    the same, ABSENT_PROBES of them                DONE       Finish: unknown
    READING    timer, none left                               DONE       Finish: unknown (probes came) or timeout
    WRITING    the value wanted                               DONE       Finish: accepted
    WRITING    its old value, earlier                         WRITING    -
    WRITING    a third value, the first                       WRITING    PARAM_SET again, unless repeated already
    WRITING    its old value, LATE_VALUE_S after the first    DONE       Finish: denied
    WRITING    a third value, again                           DONE       Finish: changed
    WRITING    timer, repeats left                            WRITING    PARAM_SET again
    WRITING    timer, none left                               DONE       Finish: timeout
    any        PARAM_ERROR, or PX4's text: no such parameter  DONE       Finish: unknown or denied
    not DONE   stop (cancelled, vehicle lost, ...)            DONE       Finish: as given
    DONE       anything                                       DONE       -

Neither autopilot refuses in so many words: it sends what the parameter is now. The old value may as well be an answer
to an earlier request, overtaken or doubled on the way: it is believed when no such answer can be on its way any more.
Protocol: https://mavlink.io/en/services/parameter.html
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

from skygcs.core.mavlink.param_encoding import Encoding, Param, ParamValue, Value, from_bits, to_bits, value_text
from skygcs.core.protocols.base import Effect, Finish, ProtocolMachine, Send
from skygcs.core.protocols.command import RETRY_TIMERS_S

LONGEST_QUEUED_S = 120.0
"""Twenty parameters of each of fourteen vehicles take a radio at 64 kbit/s a minute and a half."""

LATE_VALUE_S = 2.5
"""An answer later than this is not expected any more: three rounds of a nine-node multipoint radio at 64 kbit/s."""

ABSENT_PROBES = 3
"""So many requests of a name that a complete list has not, each with a probe that was answered, are enough. A PX4 has
parameters that are not in its list, as nothing uses them, and answers for them; with 20 % lost each way one of 20 such
is missed."""

PARAM_ERRORS = {
    1: ("unknown", "it has no such parameter"),
    2: ("denied", "the value is out of its range"),
    3: ("denied", "setting it is not permitted"),
    4: ("denied", "the component was not found"),
    5: ("denied", "it is read-only"),
    6: ("denied", "its type is not supported"),
    7: ("denied", "its type is another"),
    8: ("denied", "it could not be read"),
}
"""MAV_PARAM_ERROR of PARAM_ERROR (ArduPilot from 4.7 on, as far as the dialect has the message)."""


@dataclass(frozen=True, slots=True)
class ParamOutcome:
    """How it ended. ``result`` is one of the words

    accepted denied changed unknown timeout cancelled lost refused
    (denied: the vehicle kept its value; changed: it took another one, as one that clamps; refused: by skygcs itself).
    ``param`` is what the vehicle said it holds, ``before`` what it held; None where it did not say.
    """

    ok: bool
    result: str
    message: str
    name: str
    param: Param | None = None
    before: Param | None = None
    attempts: int = 0
    elapsed_s: float = 0.0

    @property
    def number(self) -> Value | None:
        """The vehicle's value to reckon with; None where it did not say, or said what is no finite number.

        What decides something by a parameter reads it here: NaN passes every comparison, and is no whole number.
        """
        return None if self.param is None else self.param.number

    @property
    def why_no_number(self) -> str:
        """Why `number` is None."""
        return self.message if self.param is None else f"it says {value_text(self.param.value)}"

    def as_dict(self) -> dict[str, Any]:
        """JSON-able; a value that is no finite number is null."""
        return {
            "ok": self.ok,
            "result": self.result,
            "message": self.message,
            "name": self.name,
            "value": _json_value(self.param),
            "type": None if self.param is None else self.param.type.name,
            "before": _json_value(self.before),
            "attempts": self.attempts,
            "elapsed_s": round(self.elapsed_s, 3),
        }


class ParamState(Enum):
    IDLE = auto()
    READING = auto()
    WRITING = auto()
    DONE = auto()


class ParameterProtocol(ProtocolMachine):
    """See the table at the top. Only what this vehicle sent may be handed in.

    ``value`` None: to be read. ``known``: what the vehicle holds, if it has just said so: one round trip less.
    ``absent_of``: the vehicle's complete list has so many parameters, and none of this name; 0: it may have it.
    ``probe_index``: what the first probe asks for. Each has another one, so that no answer counts for two.
    """

    def __init__(
        self,
        name: str,
        encoding: Encoding,
        value: Value | None = None,
        known: Param | None = None,
        *,
        absent_of: int = 0,
        probe_index: int = 0,
    ) -> None:
        # state and outcome
        self.name = name
        self.state = ParamState.IDLE
        self.outcome: ParamOutcome | None = None
        self.attempts = 0
        """Messages sent, probes not counted."""
        self.answers = 0
        self.last_sent = -math.inf
        # the parameter: its old, present and wanted value
        self._encoding = encoding
        self._value = value
        self._before = known
        self._param: Param | None = None
        self._wanted: Value | None = None
        # tries, and probes for a parameter that may be absent
        self._started = 0.0
        self._tries = 0
        self._absent_of = absent_of
        self._probe_index = probe_index
        self._probed: set[int] = set()
        """Probes that were answered: somebody is there, and the link works."""
        # evidence about a write
        self._first_written = 0.0
        self._thirds = 0
        """Answers with a value that is neither the old one nor the one wanted."""
        self._reason = ""

    @property
    def done(self) -> bool:
        return self.state is ParamState.DONE

    @property
    def quiet_until(self) -> float:
        """Until when answers to this request may still come, and be taken for answers to the next with the same
        name."""
        return self.last_sent + LATE_VALUE_S if self.attempts != self.answers else -math.inf

    def start(self, now: float) -> tuple[Effect, ...]:
        assert self.state is ParamState.IDLE, "start is called once"
        self._started = now
        if self._before is not None and self._value is not None:
            return self._begin_writing(self._before, now)
        self.state = ParamState.READING
        return self._transmit(now)

    def on_value(self, value: ParamValue, now: float) -> tuple[Effect, ...]:
        """Any PARAM_VALUE of this vehicle."""
        if self.state in (ParamState.IDLE, ParamState.DONE):
            return ()
        param = value.param
        if param.name != self.name:
            return self._on_probe(value.index, now)
        self.answers += 1
        if self.state is ParamState.READING:
            if self._value is not None:
                return self._begin_writing(param, now)
            self._param = param
            return self._finish(now, "accepted", value_text(param.value))
        self._param = param
        if param.value == self._wanted:
            return self._finish(now, "accepted", self._changed())
        if param.value == self._before_value():
            late = now >= self._first_written + LATE_VALUE_S
            return self._not_taken(now) if late or self._reason else ()
        self._thirds += 1
        if self._thirds > 1 or self._reason:
            return self._not_taken(now)
        return self._transmit(now) if self._tries == 1 else ()

    def on_error(self, name: str, code: int, now: float) -> tuple[Effect, ...]:
        """A PARAM_ERROR of this vehicle, for us."""
        if self.state in (ParamState.IDLE, ParamState.DONE) or name != self.name or code == 0:
            return ()
        result, reason = PARAM_ERRORS.get(code, ("denied", f"MAV_PARAM_ERROR {code}"))
        self._param = self._before
        return self._finish(now, result, f"{'denied: ' if result == 'denied' else ''}{reason}")

    def on_text(self, text: str, now: float) -> tuple[Effect, ...]:
        """A status text of this vehicle: both autopilots name the parameter whose setting they refuse."""
        if self.state is not ParamState.WRITING or self.name not in text:
            return ()
        if "unknown param" in text:
            return self._finish(now, "unknown", "it has no such parameter")
        if "denied" in text or "mismatch" in text or "failed" in text:
            self._reason = text
        return ()

    def on_timer(self, now: float) -> tuple[Effect, ...]:
        if self.deadline is None or now < self.deadline:
            return ()
        if self._tries < len(RETRY_TIMERS_S):
            return self._transmit(now)
        if self.state is ParamState.WRITING:
            said = "no answer" if self._param is None else f"it said {value_text(self._param.value)}, no answer since,"
            return self._finish(now, "timeout", f"{said} to {self._tries} transmissions; it may or may not be set")
        if len(self._probed) >= len(RETRY_TIMERS_S) - 1:
            return self._finish(
                now, "unknown", f"it answers, but not for {self.name}: it seems to have no such parameter"
            )
        return self._finish(now, "timeout", f"no answer to {self._tries} transmissions")

    def still_waits(self, now: float) -> None:
        """Its request has not left yet, behind others for the same radio: the wait for its answer begins later, up to
        `LONGEST_QUEUED_S` after the begin."""
        if self.deadline is not None and now - self._started < LONGEST_QUEUED_S:
            self.deadline = now + RETRY_TIMERS_S[max(0, self._tries - 1)]
            self.last_sent = now

    def stop(self, now: float, result: str, message: str) -> tuple[Effect, ...]:
        """End it from outside."""
        if self.state in (ParamState.IDLE, ParamState.DONE):
            return ()
        if self.state is ParamState.WRITING:
            message += "; it may or may not be set"
        return self._finish(now, result, message)

    def _on_probe(self, index: int | None, now: float) -> tuple[Effect, ...]:
        """Another parameter's value came; ``index`` is its place in the list, None where it does not say."""
        if self.state is not ParamState.READING or index != self._probe():
            return ()
        self._probed.add(self._tries)
        if not self._absent_of:
            return ()
        if len(self._probed) >= ABSENT_PROBES:
            return self._finish(now, "unknown", f"it has no such parameter: none of its {self._absent_of}")
        return self._transmit(now) if self._tries < len(RETRY_TIMERS_S) else ()

    def _probe(self) -> int:
        """The index that this transmission's probe asks for. Without a list only index 0 is sure to be there."""
        return (self._probe_index + self._tries) % self._absent_of if self._absent_of else 0

    def _before_value(self) -> Value | None:
        return None if self._before is None else self._before.value

    def _begin_writing(self, before: Param, now: float) -> tuple[Effect, ...]:
        assert self._value is not None
        self._before = before
        try:
            self._bits = to_bits(self._value, before.type, self._encoding)
        except ValueError as error:
            self._param = before
            self.state = ParamState.READING
            return self._finish(now, "refused", f"refused: {error}")
        self._wanted = from_bits(self._bits, before.type, self._encoding)
        self.state = ParamState.WRITING
        self._first_written = now
        self._tries = 0
        return self._transmit(now)

    def _transmit(self, now: float) -> tuple[Effect, ...]:
        wait_s = RETRY_TIMERS_S[self._tries]
        self._tries += 1
        self.attempts += 1
        self.last_sent = now
        self.deadline = now + wait_s
        if self.state is ParamState.WRITING:
            assert self._before is not None
            values = {"param_id": self.name, "param_value": self._bits, "param_type": int(self._before.type)}
            return (Send("PARAM_SET", values),)
        request = Send("PARAM_REQUEST_READ", {"param_id": self.name, "param_index": -1})
        probe = Send("PARAM_REQUEST_READ", {"param_id": "", "param_index": self._probe()})
        return (request,) if self._tries == 1 and not self._absent_of else (request, probe)

    def _changed(self) -> str:
        assert self._before is not None and self._param is not None
        before, after = value_text(self._before.value), value_text(self._param.value)
        return f"{after} as before" if before == after else f"{before} -> {after}"

    def _not_taken(self, now: float) -> tuple[Effect, ...]:
        assert self._before is not None and self._param is not None and self._wanted is not None
        why = f": {self._reason}" if self._reason else ""
        wanted, now_is = value_text(self._wanted), value_text(self._param.value)
        if self._param.value == self._before.value:
            return self._finish(now, "denied", f"denied: it keeps {now_is} instead of {wanted}{why}")
        return self._finish(now, "changed", f"it took {now_is} instead of {wanted} (it was {self._before_text()}){why}")

    def _before_text(self) -> str:
        return "not known" if self._before is None else value_text(self._before.value)

    def _finish(self, now: float, result: str, message: str) -> tuple[Effect, ...]:
        self.state = ParamState.DONE
        self.deadline = None
        self.outcome = ParamOutcome(
            result == "accepted",
            result,
            message,
            self.name,
            self._param,
            self._before,
            self.attempts,
            now - self._started,
        )
        return (Finish(),)


def _json_value(param: Param | None) -> Value | None:
    return None if param is None else param.number
