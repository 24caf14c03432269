"""Whose vehicles are heard over channels of their own is kept for each source: it must be what all channels together
say, whatever came and went."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.routing.filters import ChannelPolicy
from skygcs.core.routing.router import Router
from support.examples import examples
from support.routed import RoutedNet, heartbeat

POLICIES = {
    "radio": ChannelPolicy(role="radio", link="radio"),
    "wifi": ChannelPolicy(link="wifi"),
    "tablet": ChannelPolicy(role="gcs", link="tablet"),
    "recording": ChannelPolicy(link="recording", replayed=True),
}
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("hear"), st.sampled_from(sorted(POLICIES)), st.integers(1, 3)),
        st.tuples(st.just("toggle"), st.sampled_from(sorted(POLICIES)), st.just(0)),
        st.tuples(st.just("wait"), st.just(""), st.sampled_from([1, 4, 20, 70])),
    ),
    max_size=60,
)


def anew(router: Router) -> set[int]:
    """What the router would find if it looked at all its channels."""
    return {
        source
        for port in router._ports.values()
        if port.policy.role != "gcs" and not port.policy.replayed
        for source in port.vehicles
        if source not in router.state_sources or not router.table.is_station(router.state_sources[source].present_id)
    }


@settings(max_examples=examples(400))
@given(STEPS)
def test_it_is_what_all_channels_together_say(steps: list[tuple[str, str, int]]) -> None:
    net = RoutedNet()
    for name, policy in POLICIES.items():
        net.open(name, policy)
    seq = 0
    for kind, name, number in steps:
        if kind == "hear" and name in net.ids:
            seq += 1
            net.datagram(name, heartbeat(number, 1, seq % 256))
        elif kind == "toggle" and name in net.ids:
            net.close(name)
        elif kind == "toggle":
            net.open(name, POLICIES[name])
        elif kind == "wait":
            net.now += number
            net.router.expire(net.now)
        assert net.router.table.heard_directly == anew(net.router)
