"""A flight as pymavlink's users write them: pymavlink_flight.py CONNECTION px4|ardupilot"""

import sys

from pymavlink import mavutil, mavwp
from report import distance_m, moved, saw, until

m = mavutil.mavlink
NAN = float("nan")


class Flight:
    def __init__(self, address, px4):
        self.px4 = px4
        self.link = mavutil.mavlink_connection(address)
        self.link.mav.heartbeat_send(m.MAV_TYPE_GCS, m.MAV_AUTOPILOT_INVALID, 0, 0, 0)

        def heard():
            self.link.mav.heartbeat_send(m.MAV_TYPE_GCS, m.MAV_AUTOPILOT_INVALID, 0, 0, 0)
            found = self.link.recv_match(type="HEARTBEAT", blocking=True, timeout=1)
            return found if found is not None and found.autopilot != m.MAV_AUTOPILOT_INVALID else None

        heartbeat = until(heard, "a heartbeat of the vehicle")
        self.system, self.component = heartbeat.get_srcSystem(), heartbeat.get_srcComponent()
        self.link.target_system, self.link.target_component = self.system, self.component
        saw("connected", system=self.system, component=self.component, autopilot=heartbeat.autopilot)

    def receive(self, kinds, good=lambda message: True, timeout_s=120.0, ask=None):
        """The next such message of the vehicle; ``ask`` again every two seconds as over any lossy link."""

        def look():
            if ask is not None:
                ask()
            self.link.mav.heartbeat_send(m.MAV_TYPE_GCS, m.MAV_AUTOPILOT_INVALID, 0, 0, 0)
            for _ in range(20):
                found = self.link.recv_match(type=kinds, blocking=True, timeout=2)
                if found is None:
                    return None
                if found.get_srcSystem() == self.system and good(found):
                    return found
            return None

        return until(look, f"{kinds}", timeout_s, 0)

    def command(self, number, *params):
        values = (*params, *[0.0] * (7 - len(params)))

        def ask():
            self.link.mav.command_long_send(self.system, self.component, number, 0, *values)

        return self.receive("COMMAND_ACK", lambda ack: ack.command == number, ask=ask).result

    def position(self):
        found = self.receive("GLOBAL_POSITION_INT")
        return found.lat / 1e7, found.lon / 1e7, found.relative_alt / 1e3

    def until_at(self, place, height_m, ask=None):
        def there(p):
            return distance_m(place, (p.lat / 1e7, p.lon / 1e7)) < 2 and abs(p.relative_alt / 1e3 - height_m) < 2

        self.receive("GLOBAL_POSITION_INT", there, ask=ask)

    def mode(self, name):
        def ask():
            self.link.set_mode(name)

        self.receive("HEARTBEAT", lambda h: mavutil.mode_string_v10(h) == name, ask=ask)
        saw("mode", name=name)

    def parameters(self):
        self.link.param_fetch_all()
        names, count = set(), 0

        def all_there():
            nonlocal count
            found = self.link.recv_match(type="PARAM_VALUE", blocking=True, timeout=2)
            if found is not None and found.param_index < found.param_count:
                names.add(found.param_id)
                count = found.param_count
            return found is None and count

        until(all_there, "all parameters", pause_s=0)
        name = "RTL_RETURN_ALT" if self.px4 else "RTL_ALT"
        value = 21.0 if self.px4 else 2100.0

        def ask():
            self.link.param_set_send(name, value, m.MAV_PARAM_TYPE_REAL32)

        told = self.receive("PARAM_VALUE", lambda p: p.param_id == name, ask=ask)
        saw("parameters", announced=count, received=len(names), set=told.param_value, wanted=value)

    def up(self, height_m):
        if self.px4:
            amsl = self.receive("GLOBAL_POSITION_INT").alt / 1e3
            saw("takeoff", result=self.command(m.MAV_CMD_NAV_TAKEOFF, NAN, NAN, NAN, NAN, NAN, NAN, amsl + height_m))
            self.arm()
        else:
            self.mode("GUIDED")
            self.arm()
            saw("takeoff", result=self.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height_m))
        self.receive("GLOBAL_POSITION_INT", lambda p: p.relative_alt > (height_m - 1) * 1e3)
        saw("up", height_m=self.position()[2])

    def arm(self):
        until(lambda: self.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1) == m.MAV_RESULT_ACCEPTED, "armed", pause_s=1)
        self.link.motors_armed_wait()
        saw("armed")

    def goto(self, north_m, east_m, height_m):
        lat, lon, _ = self.position()
        place = moved(lat, lon, north_m, east_m)
        if self.px4:
            found = self.receive("GLOBAL_POSITION_INT")
            amsl = (found.alt - found.relative_alt) / 1e3 + height_m

            def ask():
                self.link.mav.command_int_send(
                    self.system, self.component, m.MAV_FRAME_GLOBAL, m.MAV_CMD_DO_REPOSITION, 0, 0,
                    -1, 1, 0, NAN, round(place[0] * 1e7), round(place[1] * 1e7), amsl,
                )  # fmt: skip

            ack = self.receive("COMMAND_ACK", lambda a: a.command == m.MAV_CMD_DO_REPOSITION, ask=ask)
            saw("reposition", result=ack.result)
        else:

            def ask():  # again and again: an ArduCopter takes none while it still takes off
                self.link.mav.set_position_target_global_int_send(
                    0, self.system, self.component, m.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 0b110111111000,
                    round(place[0] * 1e7), round(place[1] * 1e7), height_m, 0, 0, 0, 0, 0, 0, 0, 0,
                )  # fmt: skip

        self.until_at(place, height_m, None if self.px4 else ask)
        saw("there")

    def mission_items(self, integer):
        """Three waypoints, on an ArduCopter behind home and a take-off as its users write them."""
        lat, lon, _ = self.position()
        legs = [(15, 0), (15, 15), (0, 15)]
        places = [moved(lat, lon, *leg) for leg in legs]
        items = [] if self.px4 else [(m.MAV_CMD_NAV_WAYPOINT, lat, lon, 0), (m.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 10)]
        items += [(m.MAV_CMD_NAV_WAYPOINT, *place, 10) for place in places]
        frame = m.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT if integer else m.MAV_FRAME_GLOBAL_RELATIVE_ALT
        kind = m.MAVLink_mission_item_int_message if integer else m.MAVLink_mission_item_message
        scale = (lambda degrees: round(degrees * 1e7)) if integer else float
        return [
            kind(self.system, self.component, seq, frame, command, 0, 1, 0, 0, 0, NAN if self.px4 else 0,
                 scale(at_lat), scale(at_lon), height)
            for seq, (command, at_lat, at_lon, height) in enumerate(items)
        ]  # fmt: skip

    def mission(self, integer):
        """Up and down again with MISSION_ITEM_INT, or with the MISSION_ITEM of older programs."""
        items = self.mission_items(integer)
        loader = mavwp.MAVWPLoader()
        for item in items:
            loader.add(item)

        def announce():
            self.link.waypoint_count_send(loader.count())

        def uploaded():  # again from the start if the autopilot gave up, as it does after a few seconds
            ask = announce
            while True:
                found = self.receive(["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"], ask=ask)
                ask = None
                if found.get_type() == "MISSION_ACK":
                    return found if found.type == m.MAV_MISSION_ACCEPTED else None
                self.link.mav.send(items[found.seq])

        found = until(uploaded, "an upload")
        saw("uploaded", integer=integer, result=found.type, count=len(items))
        count = self.receive("MISSION_COUNT", ask=self.link.waypoint_request_list_send).count
        back = []
        for seq in range(count):

            def request(seq=seq):
                send = self.link.mav.mission_request_int_send if integer else self.link.mav.mission_request_send
                send(self.system, self.component, seq)

            kind = "MISSION_ITEM_INT" if integer else "MISSION_ITEM"
            item = self.receive(kind, lambda i, seq=seq: i.seq == seq, ask=request)
            back.append([item.command, item.x / 1e7, item.y / 1e7] if integer else [item.command, item.x, item.y])
        self.link.mav.mission_ack_send(self.system, self.component, m.MAV_MISSION_ACCEPTED)
        sent = [[i.command, i.x / 1e7, i.y / 1e7] if integer else [i.command, i.x, i.y] for i in items]
        skip = 0 if self.px4 else 1  # item 0 is home, whatever was sent
        off = [distance_m(a[1:], b[1:]) for a, b in zip(sent[skip:], back[skip:], strict=True)]
        same = [item[0] for item in sent[skip:]] == [item[0] for item in back[skip:]]
        saw("downloaded", integer=integer, count=count, same_commands=same, worst_m=max(off))
        return items

    def fly_mission(self, items):
        last = items[-1]
        place = (last.x / 1e7, last.y / 1e7)
        saw("started", result=self.command(m.MAV_CMD_MISSION_START, 0, 0))
        seen = []

        def at_the_end(message):
            if message.get_type() == "MISSION_CURRENT":
                if message.seq not in seen:
                    seen.append(message.seq)
                return False
            return distance_m(place, (message.lat / 1e7, message.lon / 1e7)) < 2

        self.receive(["MISSION_CURRENT", "GLOBAL_POSITION_INT"], at_the_end)
        saw("flown", items=seen, count=len(items))

    def land(self):
        saw("land", result=self.command(m.MAV_CMD_NAV_LAND))
        self.receive("HEARTBEAT", lambda h: not h.base_mode & m.MAV_MODE_FLAG_SAFETY_ARMED)
        saw("landed", height_m=self.position()[2])


def main(address, autopilot):
    flight = Flight(address, autopilot == "px4")
    flight.parameters()
    flight.mission(integer=False)
    flight.up(10)
    flight.goto(12, -8, 12)
    flight.fly_mission(flight.mission(integer=True))
    flight.land()
    saw("done")


if __name__ == "__main__":
    main(*sys.argv[1:])
