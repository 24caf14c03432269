"""Parameter files taken in by simulated vehicles."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.params.param_file import parse
from skygcs.errors import ConfigError
from skygcs.sim.firmware_params import copter_params, px4_params
from skygcs.sim.param_set import param_set
from skygcs.sim.vehicle_group import make_vehicles
from support.public_data import present, public_file
from support.sim_pilot import FIELD, Pilot, sim_dialect
from support.table import each

FILES = [
    ("made-px4.params", "px4", 1000),
    ("made-px4-mavproxy.parm", "px4", 700),
    ("made-copter-mavproxy.parm", "ardupilot", 1000),
    ("made-copter-comments.param", "ardupilot", 5),
    ("px4-amovlab-f410-v1.15.4.params", "px4", 1000),
    ("px4-mavproxy.parm", "px4", 700),
    ("apcopter-4.5-eagle-mavproxy.parm", "ardupilot", 1000),
    ("apcopter-methodic-11_battery.param", "ardupilot", 5),
]


@each(("name", "family", "at_least"), [f for f in FILES if present("params", f[:1])])
def test_a_file_is_taken_in_by_the_vehicles_of_its_firmware(name: str, family: str, at_least: int) -> None:
    text = public_file(f"params/{name}").read_text()
    taken = param_set(parse(text, name), name)
    assert (taken.family, len(taken.params) >= at_least) == (family, True)
    vehicles = make_vehicles(sim_dialect(), px4=2, ardupilot=1, first_sysid=5, home=FIELD, params=[taken])
    assert [v.sysid for v in vehicles] == [5, 6, 7], "system ids stay"
    px4_count, _, copter_count = (len(v.params) for v in vehicles)
    assert (px4_count > len(px4_params(1)) + 100) == (family == "px4" and at_least > 100)
    assert (copter_count > len(copter_params(1)) + 100) == (family == "ardupilot" and at_least > 100)
    first, second = vehicles[:2]
    first.params.set("MPC_XY_CRUISE", 9.0)
    assert second.params["MPC_XY_CRUISE"] != 9.0, "each has its own"


@each("name", present("params", ["made-px4.params", "px4-amovlab-f410-v1.15.4.params"]))
def test_a_taken_in_vehicle_lists_and_flies(name: str) -> None:
    text = public_file(f"params/{name}").read_text()
    taken = param_set(parse(text, "f410"), "f410")
    pilot = Pilot(*make_vehicles(sim_dialect(), px4=1, ardupilot=0, first_sysid=1, home=FIELD, params=[taken]))
    pilot.send(mav.MAVLink_param_request_list_message(1, 1))
    pilot.run(15.0)
    values = {x.param_id: x for x in pilot.all("PARAM_VALUE")}
    assert len(values) == values["MPC_XY_CRUISE"].param_count + 1, "and the hash"
    assert {values[name].param_type for name in taken.params} <= {mav.MAV_PARAM_TYPE_REAL32, mav.MAV_PARAM_TYPE_INT32}


def test_a_file_of_something_else_is_refused() -> None:
    with pytest.raises(ConfigError, match="no parameter that a simulated"):
        param_set(parse("Q_ENABLE,1\n", "plane.param"), "plane.param")
