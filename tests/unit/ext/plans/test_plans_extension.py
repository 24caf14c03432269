"""Plans in a daemon: there when one of their methods is first called, and no earlier."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from skygcs.config.dialects import load_dialect
from skygcs.config.models import FleetConfig
from skygcs.core.plan.file_reading import MAX_FILE_BYTES
from skygcs.daemon import Daemon
from skygcs.errors import RefusedError
from skygcs.ext.plans.extension import Plans
from skygcs.ext.plans.methods import METHODS as PLAN_METHODS
from skygcs.ext.plans.plan_uploads import KEPT_S, MAX_PART_CHARS, MAX_UPLOADS, PlanUploads
from skygcs.rpc.client import connect
from skygcs.rpc.methods import METHODS
from skygcs.runtime.plan_place import NO_PLAN, PlanPlace
from support.called import call
from support.daemons import started
from support.table import each


def new_daemon(folder: Path) -> Daemon:
    config = FleetConfig.model_validate({"daemon": {"socket": folder / "s", "log_dir": folder, "record": False}})
    return Daemon(config, load_dialect(config.dialect))


def test_the_core_has_none_of_their_methods() -> None:
    assert not [name for name in METHODS if name.startswith("plan.")]
    assert {method.name.partition(".")[0] for method in PLAN_METHODS} == {"plan"}
    assert {method.name for method in PLAN_METHODS if method.always} == {"plan.pause", "plan.abort", "plan.land"}


async def test_the_first_call_makes_them_and_discovery_shows_them_before(tmp_path: Path) -> None:
    daemon = new_daemon(tmp_path)
    async with started(daemon), connect(tmp_path / "s") as gcs:
        assert daemon.fleet.plans.keeper is None
        document = await gcs.call("rpc.discover")
        assert {m.name for m in PLAN_METHODS} <= {m["name"] for m in document["methods"]}
        status = await gcs.call("plan.status")
        assert {key: status[key] for key in NO_PLAN} == NO_PLAN
        assert isinstance(daemon.extensions["plan"], Plans)
        assert daemon.fleet.plans.keeper is daemon.extensions["plan"].runner
        none = {"jobs": [], "answered": 0, "failed": 0, "cancelled": 0, "turned_away": 0}
        assert await gcs.call("plan.jobs") == none
    with pytest.raises(RefusedError, match="shutting down"):
        new = new_daemon(tmp_path)
        new.extensions.close()
        new.extensions.demand("plan")


async def test_one_that_is_made_while_the_daemon_ends_begins_no_flight(tmp_path: Path) -> None:
    daemon = new_daemon(tmp_path)
    daemon.stop()
    with pytest.raises(RefusedError, match="shutting down"):
        await call(daemon, "plan.run")


def test_the_place_of_a_plan_is_empty_until_something_keeps_one() -> None:
    class Keeper:
        moving = True
        ticks = 0

        def status(self) -> dict[str, Any]:
            return {"state": "flying"}

        def tick(self) -> None:
            self.ticks += 1

        async def wind_down(self) -> None: ...

    place, keeper = PlanPlace(lambda: 12.3456, pytest.fail, pytest.fail), Keeper()
    place.tick()
    assert (place.moving, place.status()) == (False, {"now_s": 12.346, **NO_PLAN})
    place.keeper = keeper
    place.tick()
    assert (place.moving, keeper.ticks, place.status()["state"], place.status()["step"]) == (True, 1, "flying", 0)


# -- Plans that come in parts: put together in order, bounded in number, size and time.


def test_parts_are_put_together_and_used_up() -> None:
    uploads = PlanUploads()
    number, size = uploads.add(None, '{"a"', 10.0)
    assert size == 4
    assert uploads.add(number, ": 1}", 11.0) == (number, 8)
    assert uploads.take(number, 12.0) == b'{"a": 1}'
    with pytest.raises(RefusedError, match=f"no upload {number}"):
        uploads.take(number, 12.0)


def test_uploads_of_two_clients_do_not_mix() -> None:
    uploads = PlanUploads()
    one, _ = uploads.add(None, "a", 0.0)
    other, _ = uploads.add(None, "b", 0.0)
    uploads.add(one, "a", 0.0)
    assert (uploads.take(one, 0.0), uploads.take(other, 0.0)) == (b"aa", b"b")


def test_no_more_than_a_few_are_kept_and_the_forgotten_go() -> None:
    uploads = PlanUploads()
    for _ in range(MAX_UPLOADS):
        uploads.add(None, "x", 0.0)
    with pytest.raises(RefusedError, match="4 plans are being uploaded already"):
        uploads.add(None, "x", KEPT_S)
    uploads.add(None, "x", KEPT_S + 0.1)
    assert len(uploads) == 1


def test_one_that_grows_too_large_is_dropped() -> None:
    uploads = PlanUploads()
    number, size = uploads.add(None, "x" * MAX_PART_CHARS, 0.0)
    with pytest.raises(RefusedError, match="at most 32 MiB"):
        while size <= MAX_FILE_BYTES:
            _, size = uploads.add(number, "x" * MAX_PART_CHARS, 0.0)
    assert len(uploads) == 0


@each("number", [0, -1, 99])
def test_an_unknown_number_is_refused_for_parts_and_for_plans(number: int) -> None:
    uploads = PlanUploads()
    with pytest.raises(RefusedError, match=f"no upload {number}"):
        uploads.add(number, "x", 0.0)
    with pytest.raises(RefusedError, match=f"no upload {number}"):
        uploads.take(number, 0.0)


def test_text_that_is_none_is_kept_for_the_reader_to_refuse() -> None:
    uploads = PlanUploads()
    number, _ = uploads.add(None, "\ud800", 0.0)
    assert uploads.take(number, 0.0) == b"?"
