"""Makes a u-blox receiver a base, and follows its survey. Pure: messages and the time come in, bytes to send go out.

    state     input                                      sends              next
    -------   ----------------------------------------   ----------------   --------------------------------
    outputs   the begin                                  its outputs        outputs
    outputs   acknowledged, a survey is wanted                              look
    outputs   acknowledged, the position is known        the position       place
    look      NAV-SVIN: valid and good enough                               running: the survey is kept
    look      any other NAV-SVIN, or none for `LOOK_S`   the survey         place
    place     acknowledged                                                  running
    running   `restart`                                  no base, survey    restart, then place
    any       refused                                                       LinkError: it is no receiver for a base
    any       no answer within `ANSWER_S`, `TRIES` times the same again     LinkError: it does not answer

A receiver that kept its power keeps its survey: a base that moves by a metre because this program was started anew
would move every vehicle.
"""

from __future__ import annotations

import math
from typing import Literal, Protocol

from skygcs.errors import LinkError
from skygcs.ext.corrections.ubx import (
    SurveyIn,
    UbxMessage,
    answered,
    fixed_settings,
    no_survey_settings,
    output_settings,
    survey_of,
    survey_settings,
    valset,
)

ANSWER_S = 1.0
TRIES = 4
LOOK_S = 3.0
"""NAV-SVIN comes each second once it is asked for."""

SURVEY_SILENT_S = 10.0
"""A receiver that stops sending NAV-SVIN has lost its settings, and with them its place."""

State = Literal["outputs", "look", "restart", "place", "running"]


class BaseSettings(Protocol):
    """The wishes of a fleet file; `CorrectionsConfig` has them."""

    @property
    def survey_s(self) -> float: ...
    @property
    def survey_accuracy_m(self) -> float: ...
    @property
    def position(self) -> tuple[float, float, float] | None: ...
    @property
    def position_accuracy_m(self) -> float: ...
    @property
    def observations(self) -> Literal["msm4", "msm7"]: ...


class ReceiverSetup:
    """The dialogue with one receiver, from the opening of its port to its end."""

    def __init__(self, config: BaseSettings, port: str) -> None:
        """``port``: the receiver's own that the cable is in, a key of `ubx.PORTS`."""
        self.state: State = "outputs"
        self.survey: SurveyIn | None = None
        """The last one that it reported."""
        self._config = config
        self._outputs = valset(output_settings(port, config.observations))
        self._sent = b""
        self._sent_at = 0.0
        self._tries = 0
        self._heard_at = 0.0
        """Time of the last NAV-SVIN, or of the begin of waiting for it."""

    @property
    def surveys(self) -> bool:
        """True if the position comes from a survey and not from the fleet file."""
        return self._config.position is None

    @property
    def is_placed(self) -> bool:
        """True if the receiver knows where it is, and so puts out corrections."""
        if self.state != "running":
            return False
        return not self.surveys or (self.survey is not None and self.survey.valid)

    def begin(self, now: float) -> bytes:
        """Return what to send first."""
        return self._ask("outputs", self._outputs, now)

    def restart(self, now: float) -> bytes:
        """Forget the survey and begin it anew; what to send. Raises LinkError while it is being set up, or without a
        survey."""
        if not self.surveys:
            raise LinkError("its position is in the fleet file: there is no survey to begin")
        if self.state != "running":
            raise LinkError("the receiver is being set up: ask again in a few seconds")
        return self._ask("restart", valset(no_survey_settings()), now)

    def on_message(self, message: UbxMessage, now: float) -> bytes:
        """A message of the receiver; what to send then. Raises LinkError."""
        survey = survey_of(message)
        if survey is not None:
            self.survey, self._heard_at = survey, now
            if self.state == "look":
                return self._looked(survey, now)
            return b""
        said = answered(message)
        if said is None or self.state in ("look", "running"):
            return b""
        if not said:
            what = "to be a base" if self.state != "outputs" else "to put out RTCM and NAV-SVIN"
            raise LinkError(f"it refuses {what}: it takes a receiver that can be a base, such as a ZED-F9P")
        return self._next(now)

    def tick(self, now: float) -> bytes:
        """The time has gone on; what to send. Raises LinkError if the receiver does not answer."""
        if self.state == "look":
            return self._place(now) if now >= self._heard_at + LOOK_S else b""
        if self.state == "running":
            if now >= self._heard_at + SURVEY_SILENT_S:
                raise LinkError(
                    f"no NAV-SVIN for {SURVEY_SILENT_S:g} s: it was restarted, or set up by another program"
                )
            return b""
        if now < self._sent_at + ANSWER_S:
            return b""
        if self._tries >= TRIES:
            raise LinkError("it does not answer: is it a u-blox receiver of generation 9 or later, and baud right?")
        self._tries += 1
        self._sent_at = now
        return self._sent

    # -- the inside

    def _next(self, now: float) -> bytes:
        """The last request was acknowledged."""
        if self.state == "outputs" and self.surveys:
            self.state, self._heard_at = "look", now
            return b""
        if self.state in ("outputs", "restart"):
            return self._place(now)
        self.state, self._heard_at = "running", now
        return b""

    def _looked(self, survey: SurveyIn, now: float) -> bytes:
        config = self._config
        kept = survey.valid and survey.accuracy_m <= config.survey_accuracy_m and survey.duration_s >= config.survey_s
        if kept:
            self.state = "running"
            return b""
        return self._place(now)

    def _place(self, now: float) -> bytes:
        config = self._config
        if config.position is None:
            settings = survey_settings(math.ceil(config.survey_s), config.survey_accuracy_m)
            self.survey = None
        else:
            settings = fixed_settings(*config.position, config.position_accuracy_m)
        return self._ask("place", valset(settings), now)

    def _ask(self, state: State, message: bytes, now: float) -> bytes:
        self.state, self._sent, self._sent_at, self._tries = state, message, now, 1
        return message
