"""A plan beyond the autopilots' own fences, or with vehicles that their failsafe flies, does not begin."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from skygcs.core.mission.item import MissionType
from support.flown import Flown, flown
from support.planned import MARGIN_M, above, load, northwards


def fence_of_30_m(gcs: Flown, *, lists: bool) -> None:
    for sim in gcs.sims:
        for name, value in (
            ("FENCE_ENABLE", 1),
            ("FENCE_ACTION", 1),
            ("FENCE_TYPE", 6 if lists else 2),
            ("FENCE_RADIUS", 300.0 if lists else 30.0),
            ("GF_MAX_HOR_DIST", 0.0 if lists else 30.0),
        ):
            sim.params.set(name, value)
        if (found := sim.params.find("GF_ACTION")) is not None:
            found[1].value = 3


def findings(report: dict[str, Any], check: str) -> dict[str, str]:
    refused = [f for f in report["findings"] if f["severity"] == "refused" and f["check"] == check]
    return {f["vehicle"]: f["text"] for f in refused}


async def test_the_own_fence_is_looked_at_before_anything_moves_or_is_written(tmp_path: Path) -> None:
    """A 30 m fence and a plan to 43.9 m: nothing was said. Refused runs wrote return heights all the same."""
    async with flown(tmp_path, px4=1, ardupilot=1, takeoff=False) as gcs:
        fence_of_30_m(gcs, lists=False)
        await load(gcs, northwards(above(gcs), 43.9))
        for name, height in (("RTL_RETURN_ALT", 15.0), ("RTL_ALT", 1500)):
            for sim in gcs.sims:
                sim.params.set(name, height)
        for force in (False, True):
            answer = await gcs("plan.run", margin_m=MARGIN_M, set_return_heights=True, force=force)
            assert not answer["started"]
            beyond = findings(answer["report"], "fence")
            assert beyond.keys() == {"v1", "v2"} and all("leads to 4" in text for text in beyond.values()), beyond
        assert not any(s.name == "PARAM_SET" for s in gcs.sent) and not any(sim.armed for sim in gcs.sims)
        # polygons that cannot be read are no open space: refused, and may be insisted on
        fence_of_30_m(gcs, lists=True)
        gcs.loses = frozenset({"MISSION_REQUEST_LIST"})
        for name in ("v1", "v2"):
            gcs.actor(name).missions.forget(MissionType.FENCE)  # another station may have sent some
        report = await gcs("plan.check", margin_m=MARGIN_M)
        unread = findings(report, "fence")
        assert unread.keys() == {"v1", "v2"} and all("could not be read" in text for text in unread.values()), report
        insisted = await gcs("plan.check", margin_m=MARGIN_M, force=True)
        assert not report["ok"] and insisted["ok"], insisted["findings"]
