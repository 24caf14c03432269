"""corrections.survey: begin the survey of a base receiver anew."""

from __future__ import annotations

from typing import Any

from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import NoParams


def corrections_survey(context: Context, _: NoParams) -> JsonObject:
    """Have the receiver of [corrections] survey its position in anew, as after its antenna was moved."""
    answer: JsonObject = context.services.extensions["corrections"].restart_survey()
    return answer


METHODS: tuple[Method[Context], ...] = (
    Method("corrections.survey", NoParams, corrections_survey, dict[str, Any], (error_codes.REFUSED,)),
)
