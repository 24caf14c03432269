"""The rest of a fleet file with [companion]: our ids are those of an onboard computer, and there is a link to
the ground."""

from __future__ import annotations

from skygcs.config.models import FleetConfig, LinkConfig, TcpClientLinkConfig, UdpClientLinkConfig
from skygcs.config.signing import SigningSettings
from skygcs.config.tables import Problem
from skygcs.ext.companions.companion_table import COMPANION_COMPID, CompanionConfig, GroundAddress, ground_address
from skygcs.ext.companions.ground_contact import GROUND_LINK


def companion_problems(companion: CompanionConfig, config: FleetConfig) -> list[Problem]:
    """Contradictions to [companion] in the file as it was written."""
    problems: list[Problem] = []
    if companion.vehicle not in config.vehicles:
        known = ", ".join(config.vehicles) or "none"
        text = f"{companion.vehicle!r} is not a vehicle of this file, which must have [vehicles.{companion.vehicle}] "
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
    if "companions" in config.extensions:
        problems.append(Problem(("companions",), "is for the ground; this file has [companion], the vehicle's side"))
    return problems


def as_companion(companion: CompanionConfig, config: FleetConfig) -> FleetConfig:
    """The configuration as the daemon runs it; the same if the companion's vehicle is not there."""
    vehicle = config.vehicles.get(companion.vehicle)
    if vehicle is None:
        return config
    own = {"sysid": vehicle.sysid}
    if "compid" not in config.daemon.model_fields_set:
        own["compid"] = COMPANION_COMPID
    links = dict(config.links)
    address = ground_address(companion.ground)
    if address is not None and GROUND_LINK not in links:
        links[GROUND_LINK] = ground_link(address, companion.signing)
    daemon = config.daemon.model_copy(update=own)
    return config.model_copy(update={"daemon": daemon, "links": links, "aboard": companion.vehicle})


def ground_link(address: GroundAddress, signing: SigningSettings | None = None) -> LinkConfig:
    """The companion's link to the ground: an ordinary one, to a program that gives orders."""
    kind = UdpClientLinkConfig if address.transport == "udp" else TcpClientLinkConfig
    return kind(name=GROUND_LINK, role="gcs", host=address.host, port=address.port, signing=signing)
