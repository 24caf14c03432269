// Vehicles for the tests.

import type { StateBatch, VehicleState } from "../src/types.ts";

export function vehicle(name: string, sysid: number, more: Partial<VehicleState> = {}): VehicleState {
  return {
    name,
    sysid,
    compid: 1,
    autopilot: "px4",
    type: "QUADROTOR",
    firmware: "1.16.1",
    groups: [],
    connected: true,
    duplicate_sysid: false,
    replayed: false,
    last_heartbeat_age_s: 0.2,
    armed: true,
    mode: "AUTO.LOITER",
    system_status: "active",
    landed: "in_air",
    failsafe: false,
    control: null,
    uplink: null,
    separation: null,
    gps: null,
    position: position(0, 0, 10),
    attitude: null,
    battery: null,
    home: null,
    vfr: null,
    uptime_s: null,
    companion: null,
    mission: null,
    links: { radio: part({ frames: 1, lost: 0, loss_ratio: 0, age_s: 0.1 }) },
    ...more,
  };
}

/** A part of a state of which only this is looked at. */
export function part<T>(known: Partial<NoInfer<T>>): T {
  return { age_s: 0, ...known } as T;
}

export function position(x: number, y: number, z: number, more: object = {}): NonNullable<VehicleState["position"]> {
  return {
    lat_deg: 43.7806,
    lon_deg: -79.4653,
    alt_amsl_m: 180 + z,
    alt_rel_m: z,
    heading_deg: 0,
    vel_enu_mps: [0, 0, 0],
    enu_m: [x, y, z],
    vel_world_mps: [0, 0, 0],
    yaw_world_deg: 90,
    origin_generation: 1,
    time_boot_s: 0,
    takeoff_alt_amsl_m: null,
    alt_takeoff_m: null,
    age_s: 0.1,
    ...more,
  };
}

export function batch(vehicles: VehicleState[], more: Partial<StateBatch> = {}): StateBatch {
  return { seq: 1, full: true, now_s: 1000, heard_s: 1000, vehicles, gone: [], ...more };
}
