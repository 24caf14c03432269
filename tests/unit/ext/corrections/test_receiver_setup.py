"""The dialogue that makes a receiver a base: each row of its table."""

from __future__ import annotations

from typing import Any

import pytest

from skygcs.errors import LinkError
from skygcs.ext.corrections.config import CorrectionsConfig
from skygcs.ext.corrections.receiver_setup import ANSWER_S, LOOK_S, SURVEY_SILENT_S, TRIES, ReceiverSetup
from skygcs.ext.corrections.receiver_stream import ReceiverStream
from skygcs.ext.corrections.ubx import UbxMessage
from support.base_receiver import ack, nav_svin, settings_in
from support.table import each


def setup(**keys: Any) -> ReceiverSetup:
    return ReceiverSetup(CorrectionsConfig.model_validate({"serial": "/dev/ttyACM0", **keys}), "usb")


def tell(dialogue: ReceiverSetup, raw: bytes, now: float) -> list[dict[str, Any]]:
    """Settings that it sends then."""
    (message,) = ReceiverStream().feed(raw)
    assert isinstance(message, UbxMessage)
    return settings_in(dialogue.on_message(message, now))


def test_a_survey_is_begun_and_followed() -> None:
    dialogue = setup(survey_s=120, survey_accuracy_m=1.5)
    (outputs,) = settings_in(dialogue.begin(0.0))
    assert outputs["CFG_MSGOUT_RTCM_3X_TYPE1074_USB"] == 1
    assert tell(dialogue, nav_svin(0, 100.0), 0.1) == []
    assert tell(dialogue, ack(), 0.2) == []
    assert dialogue.state == "look"
    (survey,) = tell(dialogue, nav_svin(0, 100.0, active=False), 1.0)
    assert survey == {"CFG_TMODE_MODE": 1, "CFG_TMODE_SVIN_MIN_DUR": 120, "CFG_TMODE_SVIN_ACC_LIMIT": 15000}
    assert tell(dialogue, ack(), 1.1) == []
    assert (dialogue.state, dialogue.is_placed) == ("running", False)
    assert tell(dialogue, nav_svin(60, 3.0), 61.0) == []
    assert dialogue.survey is not None and dialogue.survey.duration_s == 60
    tell(dialogue, nav_svin(121, 1.4, valid=True, active=False), 122.0)
    assert dialogue.is_placed


@each(
    ("found", "kept"),
    [
        (nav_svin(600, 1.4, valid=True, active=False), True),
        (nav_svin(600, 1.6, valid=True, active=False), False),
        (nav_svin(100, 1.4, valid=True, active=False), False),
        (nav_svin(600, 1.4), False),
    ],
)
def test_a_survey_that_is_good_enough_is_kept(found: bytes, kept: bool) -> None:
    dialogue = setup(survey_s=120, survey_accuracy_m=1.5)
    dialogue.begin(0.0)
    tell(dialogue, ack(), 0.1)
    sent = tell(dialogue, found, 1.0)
    assert (sent == [], dialogue.is_placed) == (kept, kept)


def test_a_receiver_that_says_nothing_of_its_survey_is_asked_for_one() -> None:
    dialogue = setup()
    dialogue.begin(0.0)
    tell(dialogue, ack(), 1.0)
    assert dialogue.tick(1.0 + LOOK_S - 0.1) == b""
    assert settings_in(dialogue.tick(1.0 + LOOK_S))[0]["CFG_TMODE_MODE"] == 1


def test_a_known_position_is_set_without_a_survey() -> None:
    dialogue = setup(position=[43.78, -79.46, 150.25], position_accuracy_m=0.02)
    dialogue.begin(0.0)
    (place,) = tell(dialogue, ack(), 0.1)
    assert (place["CFG_TMODE_MODE"], place["CFG_TMODE_HEIGHT"]) == (2, 15025)
    tell(dialogue, ack(), 0.2)
    assert dialogue.is_placed and not dialogue.surveys
    with pytest.raises(LinkError, match="no survey"):
        dialogue.restart(1.0)


def test_a_survey_can_be_begun_anew() -> None:
    dialogue = setup(survey_s=120)
    dialogue.begin(0.0)
    with pytest.raises(LinkError, match="being set up"):
        dialogue.restart(0.1)
    tell(dialogue, ack(), 0.1)
    tell(dialogue, nav_svin(600, 1.0, valid=True), 1.0)
    assert settings_in(dialogue.restart(2.0)) == [{"CFG_TMODE_MODE": 0}]
    assert not dialogue.is_placed
    assert tell(dialogue, ack(), 2.1)[0]["CFG_TMODE_MODE"] == 1
    tell(dialogue, ack(), 2.2)
    assert (dialogue.state, dialogue.survey) == ("running", None)


def test_a_lost_request_is_repeated_and_a_silent_receiver_named() -> None:
    dialogue = setup()
    first = dialogue.begin(0.0)
    assert dialogue.tick(ANSWER_S - 0.1) == b""
    for number in range(1, TRIES):
        assert dialogue.tick(number * ANSWER_S) == first
    with pytest.raises(LinkError, match="does not answer"):
        dialogue.tick(TRIES * ANSWER_S)


def test_a_receiver_that_is_no_base_is_named() -> None:
    dialogue = setup()
    dialogue.begin(0.0)
    with pytest.raises(LinkError, match="refuses to put out RTCM"):
        tell(dialogue, ack(accepted=False), 0.1)
    dialogue = setup(position=[1.0, 2.0, 3.0])
    dialogue.begin(0.0)
    tell(dialogue, ack(), 0.1)
    with pytest.raises(LinkError, match="refuses to be a base"):
        tell(dialogue, ack(accepted=False), 0.1)


def test_a_receiver_that_forgot_its_settings_is_noticed() -> None:
    dialogue = setup()
    dialogue.begin(0.0)
    tell(dialogue, ack(), 0.1)
    tell(dialogue, nav_svin(600, 1.0, valid=True), 1.0)
    assert dialogue.tick(1.0 + SURVEY_SILENT_S - 0.1) == b""
    with pytest.raises(LinkError, match="restarted"):
        dialogue.tick(1.0 + SURVEY_SILENT_S)
