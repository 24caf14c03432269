"""The meaning of a link's keys in the fleet file for routing: filters, rates, cost."""

from __future__ import annotations

from collections.abc import Mapping

from skygcs.config.models import LinkConfig, MessageName
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.routing.filters import ChannelPolicy, MessageFilter
from skygcs.core.routing.link_choice import DEFAULT_COST, SCARCE_COST

STATION_COST = 1000
"""Cost of a link to a ground station, which may return a vehicle's frames: any other link to the vehicle is better."""


def channel_policy(config: LinkConfig, dialect: Dialect, vehicles: frozenset[int] = frozenset()) -> ChannelPolicy:
    """The routing policy of a link's channels; ``vehicles``: the system ids it is bound to. Raises KeyError for a
    message name the dialect does not have."""

    def msgid(name: MessageName) -> int:
        if isinstance(name, int) or name.isdecimal():
            return int(name)  # ids that the dialect does not have may be filtered, too
        return dialect.find(name).msgid

    def msgids(names: tuple[MessageName, ...]) -> frozenset[int]:
        return frozenset(msgid(n) for n in names)

    def rates(named: Mapping[str, float]) -> dict[int, float]:
        return {msgid(n): hz for n, hz in named.items() if n != "*"}

    # defaults that follow from what the link is: a radio or serial line is scarce, a station comes last
    unknown = config.forward_unknown
    scarce = config.role == "radio" or config.type in ("serial", "xbee")
    cost = STATION_COST if config.role == "gcs" else SCARCE_COST if scarce else DEFAULT_COST
    return ChannelPolicy(
        cost=cost if config.cost is None else config.cost,
        role=config.role,
        link=config.name,
        replayed=config.type == "replay",
        group=config.group,
        vehicles=vehicles,
        forward_unknown=config.role != "radio" if unknown is None else unknown,
        filter_in=MessageFilter(
            msgids(config.allow_msg_id_in),
            msgids(config.block_msg_id_in),
            frozenset(config.allow_src_sys_in),
            frozenset(config.block_src_sys_in),
            frozenset(config.allow_src_comp_in),
            frozenset(config.block_src_comp_in),
        ),
        filter_out=MessageFilter(
            msgids(config.allow_msg_id_out),
            msgids(config.block_msg_id_out),
            frozenset(config.allow_src_sys_out),
            frozenset(config.block_src_sys_out),
            frozenset(config.allow_src_comp_out),
            frozenset(config.block_src_comp_out),
        ),
        rates_in=rates(config.rate_in.messages),
        rates_out=rates(config.rate_out.messages),
        default_hz_in=config.rate_in.messages.get("*"),
        default_hz_out=config.rate_out.messages.get("*"),
        bytes_per_s_in=config.rate_in.bytes_per_s,
        bytes_per_s_out=config.rate_out.bytes_per_s,
    )
