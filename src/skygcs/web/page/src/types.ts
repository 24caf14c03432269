// What comes over the WebSocket: the keys of docs/reference/rpc.md, SI units, degrees, ENU; null is "not known".

import type * as rpc from "./rpc_types.ts";

export type { AlarmResult as Alarm, EventRecord as FleetEvent, OriginPlace as Origin, Params, PlanStatus, Results, SeparationPart as Separation } from "./rpc_types.ts";

export type Vec3 = readonly [number, number, number];

/** A method of the daemon. */
export type Method = keyof rpc.Results;

/** A method that the web process or the station answers itself. */
export type OwnMethod = `web.${string}` | `replay.${string}` | `federation.${string}`;

export type Control = Pick<rpc.ControlState, "state" | "mode" | "control_mode"> & Partial<rpc.ControlState>;

/** What is not as the daemon has it: null where only the row of a digest was sent. */
interface OfBrief {
  armed: boolean | null;
  mode: string | null;
  control: Control | null;
}

/** The state of one vehicle as web.state carries it. */
export type VehicleState = Omit<Pick<rpc.VehicleState, rpc.StateKey>, keyof OfBrief> & OfBrief;

/** A row of `Digest` in fleet_digest.py. */
export type Brief = readonly [
  name: string,
  sysid: number | null,
  autopilot: string,
  armed: boolean | null,
  landed: string,
  failsafe: boolean,
  connected: boolean,
  silence_s: number | null,
  x: number | null,
  y: number | null,
  z: number | null,
  yaw_deg: number | null,
  at_s: number,
  lat_deg?: number | null,
  lon_deg?: number | null,
];

export interface SiteCounts {
  /** "" is the station's own. */
  site: string;
  vehicles: number;
  heard: number;
  armed: number;
  in_air: number;
  problems: number;
  /** Of the vehicle that is silent for the longest time; null: one was never heard. */
  oldest_age_s: number | null;
}

export interface StateBatch {
  seq: number;
  /** Forget everything: this is the fleet. */
  full: boolean;
  now_s: number;
  /** The server's time that the ages of `vehicles` refer to. */
  heard_s: number;
  vehicles: readonly VehicleState[];
  gone: readonly string[];
  /** Of a large fleet only, and all that is not in `vehicles`. */
  brief?: readonly Brief[];
  sites?: readonly SiteCounts[];
  /** Vehicles that this page's view asks for, and that are too many. */
  left_out?: number;
}

export interface DaemonLink {
  connected: boolean;
  /** Connected, and it has not answered for a while. */
  slow: boolean;
  text: string;
  since_s: number;
  /** What of the station is missing although it is connected. */
  note?: string | null;
  /** The name of the station's own site; null: there are no others. */
  site?: string | null;
  /** It simulates vehicles that may be given faults. */
  drills?: boolean;
  /** It lists its recordings and has one replayed. */
  recordings?: boolean;
}

export interface MapPin {
  x_px: number;
  y_px: number;
  lat_deg: number;
  lon_deg: number;
}

export interface Hello {
  role: "view" | "command";
  version: string;
  fleet: string | null;
  replay: boolean;
  now_s: number;
  seq: number;
  daemon: DaemonLink;
  map: { url: string; points: readonly [MapPin, MapPin] } | null;
  tiles?: TileFile | null;
  /** Why the tiles that the fleet file names are not shown; empty: nothing is wrong. */
  tiles_problem?: string;
  methods: { read: readonly string[]; order: readonly string[] };
}

/** Map tiles on the ground station: `url`/zoom/x/y. */
export interface TileFile {
  url: string;
  min_zoom: number;
  max_zoom: number;
  /** Pixels across one. */
  tile_px: number;
  /** West, south, east, north; null: not known. */
  bounds_deg: readonly [number, number, number, number] | null;
  attribution: string;
}

/** What became of an order on one vehicle: of an order to another site with the id by which that can be asked. */
export type Outcome = Pick<rpc.OutcomeResult, "ok" | "message"> & Partial<Omit<rpc.OutcomeResult, "result">> & { result: string; id?: string };

/** The answer of federation.outcome. */
export interface SiteAnswer {
  id: string;
  status: "done" | "failed" | "refused" | "late" | "running" | "unknown" | "never came";
  text: string;
  /** Of the vehicle, if the daemon of its site answered. */
  outcome: Outcome | null;
}
