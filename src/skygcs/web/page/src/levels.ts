// Vehicles of which the page is not sent everything: briefs of a large fleet, and states of other sites. Pure.

import type { State, Vehicle } from "./store.ts";
import type { Brief, VehicleState } from "./types.ts";

/** The server's bounds of a view, fleet_digest.py. */
const MOST_NAMES = 300;
const MOST_SEARCH = 200;
const MOST_SELECTED = 99;

/** What is not known of a vehicle, whatever sent its state: another site's bridge leaves out what it does not have. */
const UNKNOWN: Omit<VehicleState, "name" | "sysid"> = {
  compid: 1,
  autopilot: "",
  type: "",
  firmware: null,
  groups: [],
  connected: false,
  duplicate_sysid: false,
  replayed: false,
  last_heartbeat_age_s: null,
  uptime_s: null,
  armed: null,
  mode: null,
  system_status: "",
  landed: "",
  failsafe: false,
  control: null,
  uplink: null,
  separation: null,
  companion: null,
  gps: null,
  position: null,
  attitude: null,
  battery: null,
  home: null,
  vfr: null,
  mission: null,
  links: {},
};

export function vehicleOf(state: VehicleState, heard_s: number): Vehicle {
  return { ...UNKNOWN, ...state, heard_s };
}

/** A vehicle of which only a brief is sent: what the page shows of it in full stays empty. */
export function briefVehicle([name, sysid, autopilot, armed, landed, failsafe, connected, silence_s, x, y, z, yaw_deg, at_s, lat_deg = null, lon_deg = null]: Brief): Vehicle {
  const position = x === null && lat_deg === null ? null : {
    age_s: silence_s ?? 0,
    lat_deg,
    lon_deg,
    alt_amsl_m: null,
    alt_rel_m: null,
    heading_deg: null,
    vel_enu_mps: null,
    time_boot_s: 0,
    takeoff_alt_amsl_m: null,
    alt_takeoff_m: null,
    enu_m: x === null || y === null ? null : [x, y, z ?? 0] as const,
    vel_world_mps: null,
    yaw_world_deg: yaw_deg,
    origin_generation: null,
  };
  const known = { name, sysid: sysid ?? 0, autopilot, armed, landed, failsafe, connected, last_heartbeat_age_s: silence_s, position };
  return { ...UNKNOWN, ...known, heard_s: at_s, brief: true };
}

/** "" of a vehicle of the station's own site. */
export function siteOf(name: string): string {
  return name.slice(0, Math.max(name.indexOf("/"), 0));
}

/** A vehicle's name with its site where there are several: what an order is held down for. */
export function fullName(state: State, name: string): string {
  const own = state.daemon?.site;
  return own == null || name.includes("/") ? name : `${own}/${name}`;
}

/** What the server asked to send in full: the vehicles of unfolded sites or of a search, the selected, and the near ones. */
export function viewParams(state: State, near: readonly string[]): { sites: string[]; search: string; names: string[] } {
  const names = [...new Set([...(state.shown === null ? [] : [state.shown]), ...[...state.selection].slice(0, MOST_SELECTED), ...near])];
  return { sites: [...state.unfolded], search: state.search.slice(0, MOST_SEARCH), names: names.slice(0, MOST_NAMES) };
}
