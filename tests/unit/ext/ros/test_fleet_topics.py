"""Topics of the fleet with a node that keeps what it gets: readers, the loss of the daemon, faults; and the package."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skygcs.core.ros.fleet_markers import DELETE
from skygcs.errors import RpcError
from skygcs.ext.ros.commands import app, write_messages
from skygcs.ext.ros.fleet_topics import FleetTopics
from support.ros_node import KeptNode
from support.table import each

NOW_NS = 1_700_000_000 * 10**9


class Rig:
    def __init__(self, *readers: str) -> None:
        self.node = KeptNode()
        self.states: list[dict[str, Any]] = []
        self.topics = FleetTopics(self.node, lambda: ((s, f"/{s['name']}") for s in self.states), lambda: NOW_NS)
        self.node.read(*(f"/skygcs/{name}" for name in readers))

    def sent(self, name: str) -> list[dict[str, Any]]:
        return self.node.publications[f"/skygcs/{name}"].messages


def state(x_m: float, sysid: int = 1) -> dict[str, Any]:
    return {"name": f"v{sysid}", "sysid": sysid, "connected": True, "position": {"enu_m": [x_m, 0.0, 5.0]}}


def test_qualities_of_service() -> None:
    qualities = {name.removeprefix("/skygcs/"): p.quality for name, p in Rig().node.publications.items()}
    assert qualities == {"fleet": "default", "events": "events", "plan": "newest", "markers": "default"}


def test_states_go_out_only_to_readers_and_trails_grow_without_them() -> None:
    rig = Rig()
    for x in range(5):
        rig.states = [state(float(x))]
        rig.topics.publish_now()
    assert rig.sent("fleet") == rig.sent("markers") == []
    rig.node.read("/skygcs/fleet", "/skygcs/markers")
    rig.topics.publish_now()
    assert rig.sent("fleet")[0]["vehicles"][0]["position"]["x"] == 4.0
    kinds = {marker["ns"]: marker for marker in rig.sent("markers")[0]["markers"]}
    assert kinds.keys() == {"vehicle", "name", "trail"} and len(kinds["trail"]["points"]) == 5
    rig.topics.has_origin, rig.topics.fences = True, {"v1": {"x_m": [0, 1], "y_m": [0, 1], "up_m": [0, 1]}}
    rig.topics.publish_now()
    assert any(marker["ns"] == "fence" for marker in rig.sent("markers")[1]["markers"])


def test_what_cannot_be_sent_is_counted_and_the_rest_is() -> None:
    rig = Rig("fleet")
    rig.states = [{"name": "v1", "sysid": 10**9}]
    rig.topics.publish_now()
    rig.topics.on_event({"kind": "mode", "data": object()})
    rig.topics.on_plan({"state": "loaded", "vehicles": [7]})
    assert rig.topics.faults == 3 and rig.sent("fleet") == []
    rig.states = [state(0.0)]
    rig.topics.publish_now()
    rig.topics.on_event({"kind": "mode", "vehicle": "v1", "text": "mode LAND"})
    assert len(rig.sent("fleet")) == 1 and rig.sent("events")[0]["text"] == "mode LAND"


async def test_paths_are_looked_at_while_markers_are_read_and_taken_from_the_display() -> None:
    rig = Rig("markers")
    answers: list[Any] = [RpcError(-32001, "no vehicle")]
    known = []

    class Gcs:
        async def call(self, method: str, **params: Any) -> Any:
            known.append((method, params["known"]))
            answer = answers.pop(0) if answers else {"key": "b", "paths": None}
            if isinstance(answer, Exception):
                raise answer
            return answer

    path = {"vehicle": "v1", "points_enu_m": [[0.0, 0.0, 5.0], [9.0, 0.0, 5.0]]}
    gcs: Any = Gcs()
    await rig.topics._look_at_paths(gcs)
    answers.append({"key": "a", "paths": [path, path]})
    await rig.topics._look_at_paths(gcs)
    rig.topics.publish_now()
    answers.append({"key": "b", "paths": [path]})
    await rig.topics._look_at_paths(gcs)
    await rig.topics._look_at_paths(gcs)  # nothing has changed
    rig.topics.publish_now()
    assert known == [("trajectory.paths", key) for key in (None, None, "a", "b")]
    first, second = (message["markers"] for message in rig.sent("markers"))
    assert [(marker["ns"], marker["id"]) for marker in first] == [("plan", 0), ("plan", 1)]
    assert {(marker["id"], marker["action"]) for marker in second} == {(1, DELETE), (0, 0)}
    task = asyncio.create_task(rig.topics.publish_states(gcs))
    await asyncio.sleep(0.05)
    task.cancel()
    assert len(known) == 5 and len(rig.sent("markers")) == 3


def test_nothing_is_known_without_the_daemon() -> None:
    rig = Rig("fleet")
    rig.states = [state(0.0)]
    rig.topics.on_plan({"state": "flying", "plan": "1"})
    rig.topics.lost()
    fleet = rig.sent("fleet")[-1]
    assert not fleet["daemon_connected"] and not fleet["vehicles"][0]["connected"]
    assert (rig.sent("plan")[-1]["state"], rig.sent("plan")[-1]["plan"]) == ("unknown", "")


# -- skygcs-cli ros messages


def test_the_package_is_written_into_an_empty_folder_only(tmp_path: Path) -> None:
    folder = tmp_path / "ws" / "src" / "skygcs_msgs"
    written = write_messages(folder)
    there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert {"package.xml", "CMakeLists.txt", "msg/Fleet.msg", "action/Goto.action"} <= there
    assert {path.relative_to(folder).as_posix() for path in written} == there
    (folder / "package.xml").write_text("mine")
    done = CliRunner().invoke(app, ["messages", str(folder)])
    assert done.exit_code == 1 and "not empty" in done.output
    assert (folder / "package.xml").read_text() == "mine"
    (tmp_path / "empty").mkdir()
    done = CliRunner().invoke(app, ["messages", str(tmp_path / "empty")])
    assert done.exit_code == 0 and f"{len(written)} files" in done.output


@each("below", ["", "under/it"])
def test_a_file_is_no_folder(tmp_path: Path, below: str) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OSError):
        write_messages(tmp_path / "file" / below)
    assert (tmp_path / "file").read_text() == "mine"
