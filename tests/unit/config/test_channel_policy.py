"""What a link's keys mean for routing."""

from __future__ import annotations

from pathlib import Path

import pytest

from skygcs.config.channel_policy import channel_policy
from skygcs.config.models import MemoryLinkConfig, RateLimits, ReplayLinkConfig
from support.routed import DIALECT


def test_only_a_replay_is_routed_as_a_recording() -> None:
    assert channel_policy(ReplayLinkConfig(name="flight", file=Path("flight.tlog")), DIALECT).replayed
    assert not channel_policy(MemoryLinkConfig(name="x"), DIALECT).replayed


def test_a_policy_has_the_message_ids_of_its_names() -> None:
    config = MemoryLinkConfig(
        name="x",
        role="radio",
        block_msg_id_out=("ATTITUDE", "24", 60000),
        rate_out=RateLimits(messages={"VFR_HUD": 2.0, "*": 5.0, "1": 1.0}, bytes_per_s=500.0),
    )
    policy = channel_policy(config, DIALECT)
    assert policy.filter_out.block_msgids == {30, 24, 60000}
    assert policy.rates_out == {74: 2.0, 1: 1.0}
    assert (policy.default_hz_out, policy.bytes_per_s_out) == (5.0, 500.0)
    assert policy.forward_unknown is False
    with pytest.raises(KeyError, match="no message 'ATITUDE'"):
        channel_policy(MemoryLinkConfig(name="x", allow_msg_id_in=("ATITUDE",)), DIALECT)
