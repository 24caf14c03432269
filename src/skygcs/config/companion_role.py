"""What [companion] makes of the rest of a fleet file: our ids are those of an onboard computer, and there is a link to
the ground."""

from __future__ import annotations

from skygcs.config.companion import COMPANION_COMPID, GROUND_LINK, GroundAddress, ground_address
from skygcs.config.models import FleetConfig, LinkConfig, TcpClientLinkConfig, UdpClientLinkConfig
from skygcs.config.signing import SigningSettings
from skygcs.config.tables import Problem


def companion_problems(config: FleetConfig) -> list[Problem]:
    """What contradicts [companion] in the file as it was written."""
    companion = config.companion
    if companion is None:
        return []
    problems: list[Problem] = []
    if companion.vehicle not in config.vehicles:
        known = ", ".join(config.vehicles) or "none"
        text = f"{companion.vehicle!r} is no vehicle of this file, which must have [vehicles.{companion.vehicle}] "
        problems.append(Problem(("companion", "vehicle"), f"{text}with its sysid; vehicles: {known}"))
    for name in config.vehicles:
        if name != companion.vehicle:
            text = f"a companion has one vehicle, which is {companion.vehicle} (companion.vehicle)"
            problems.append(Problem(("vehicles", name), text))
    if "sysid" in config.daemon.model_fields_set:
        text = f"a companion has the system id of its vehicle, {companion.vehicle}: remove the key"
        problems.append(Problem(("daemon", "sysid"), text))
    if GROUND_LINK in config.links:
        text = "is the name of the link that a companion opens to the ground (companion.ground): choose another"
        problems.append(Problem(("links", GROUND_LINK), text))
    if config.companions is not None:
        problems.append(Problem(("companions",), "is for the ground; this file has [companion], the vehicle's side"))
    return problems


def as_companion(config: FleetConfig) -> FleetConfig:
    """The configuration as the daemon runs it; the same without [companion], or if its vehicle is not there."""
    companion = config.companion
    vehicle = None if companion is None else config.vehicles.get(companion.vehicle)
    if companion is None or vehicle is None:
        return config
    own = {"sysid": vehicle.sysid}
    if "compid" not in config.daemon.model_fields_set:
        own["compid"] = COMPANION_COMPID
    links = dict(config.links)
    address = ground_address(companion.ground)
    if address is not None and GROUND_LINK not in links:
        links[GROUND_LINK] = ground_link(address, companion.signing)
    return config.model_copy(update={"daemon": config.daemon.model_copy(update=own), "links": links})


def ground_link(address: GroundAddress, signing: SigningSettings | None = None) -> LinkConfig:
    """The companion's link to the ground: an ordinary one, to a program that gives orders."""
    kind = UdpClientLinkConfig if address.transport == "udp" else TcpClientLinkConfig
    return kind(name=GROUND_LINK, role="gcs", host=address.host, port=address.port, signing=signing)
