// What comes over the WebSocket: the keys of docs/reference/rpc.md, SI units, degrees, ENU; null is "not known".

export type Vec3 = readonly [number, number, number];

/** A telemetry group has its age when it was sent; what is shown is older, see `ageOf` of store.ts. */
export interface Aged {
  age_s: number;
}

export interface Gps extends Aged {
  fix: string | null;
  fix_type: number | null;
  satellites: number | null;
}

export interface Position extends Aged {
  lat_deg: number | null;
  lon_deg: number | null;
  alt_amsl_m: number | null;
  /** Above home. */
  alt_rel_m: number | null;
  /** Clockwise from true north. */
  heading_deg: number | null;
  vel_enu_mps: Vec3 | null;
  /** In the fleet's frame; null without an origin. */
  enu_m: Vec3 | null;
  vel_world_mps: Vec3 | null;
  /** Counter-clockwise from the frame's x axis. */
  yaw_world_deg: number | null;
  origin_generation: number | null;
}

export interface Battery extends Aged {
  volts: number | null;
  percent: number | null;
}

export interface Home extends Aged {
  lat_deg: number;
  lon_deg: number;
  alt_amsl_m: number | null;
}

export interface LinkCounters {
  frames: number;
  lost: number;
  loss_ratio: number | null;
  age_s: number;
  /** Whether it is the one in use, of a vehicle that is heard on several. */
  chosen?: boolean;
}

export interface Separation {
  level: "notice" | "warning" | "action";
  with: string;
  /** These only while a conflict is predicted; a level falls some seconds after that. */
  distance_m?: number;
  closest_m?: number;
  closest_in_s?: number;
  margin_m?: number;
}

export interface Control {
  state: "off" | "engaging" | "flying" | "held";
  mode: string | null;
  control_mode: string | null;
  reasons?: readonly string[] | null;
  reference?: { pos_enu_m: readonly (number | null)[] | null; vel_enu_mps: readonly (number | null)[] | null } | null;
  error_m?: number | null;
  [more: string]: unknown;
}

export interface Uplink extends Aged {
  heard: boolean;
  unanswered: number;
  rtt_s: number | null;
}

/** The computer on a vehicle. */
export interface Companion {
  name: string | null;
  /** The daemon's connection to it; null: it has none. */
  link: "connecting" | "up" | "down" | null;
  error: string | null;
  version: string | null;
  /** Of its newest MAVLink message; null: none was heard. */
  age_s: number | null;
}

/** The state of one vehicle as web.state carries it. */
export interface VehicleState {
  name: string;
  sysid: number;
  compid: number;
  autopilot: string;
  type: string;
  firmware: string | null;
  groups: readonly string[];
  connected: boolean;
  duplicate_sysid: boolean;
  replayed: boolean;
  last_heartbeat_age_s: number | null;
  armed: boolean | null;
  mode: string | null;
  system_status: string;
  landed: string;
  failsafe: boolean;
  control: Control | null;
  uplink: Uplink | null;
  separation: Separation | null;
  /** Absent: the daemon is of an earlier version. */
  companion?: Companion | null;
  gps: Gps | null;
  position: Position | null;
  attitude: (Aged & { roll_deg: number; pitch_deg: number; yaw_deg: number }) | null;
  battery: Battery | null;
  home: Home | null;
  vfr: (Aged & { groundspeed_mps: number | null; climb_mps: number | null; throttle_percent: number | null }) | null;
  mission: (Aged & { item: number | null; count: number | null }) | null;
  links: Readonly<Record<string, LinkCounters>>;
}

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

export interface FleetEvent {
  time_unix_s: number;
  kind: string;
  vehicle: string | null;
  sysid: number | null;
  text: string;
  data: Readonly<Record<string, unknown>>;
}

/** An alarm of the daemon: the same on every page, acknowledged once. */
export interface Alarm {
  number: number;
  kind: string;
  vehicle: string | null;
  severity: "alarm" | "warning";
  text: string;
  raised_unix_s: number;
  /** Its condition lasts. */
  active: boolean;
  count: number;
  /** What followed from it and is no alarm of its own, by kind. */
  consequences: Readonly<Record<string, number>>;
  /** Null: nobody has seen it. */
  acknowledged_by: string | null;
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

export interface Origin {
  lat_deg: number;
  lon_deg: number;
  alt_amsl_m: number;
  /** Compass heading of the x axis; 90 is plain ENU. */
  x_heading_deg: number;
}

/** What became of an order on one vehicle, in the daemon's words. */
export interface Outcome {
  ok: boolean;
  result: string;
  message: string;
  attempts?: number;
  elapsed_s?: number;
  status_texts?: readonly string[];
  /** Of an order to a vehicle of another site: its site can be asked by it. */
  id?: string;
}

/** The answer of federation.outcome. */
export interface SiteAnswer {
  id: string;
  status: "done" | "failed" | "refused" | "late" | "running" | "unknown" | "never came";
  text: string;
  /** Of the vehicle, if the daemon of its site answered. */
  outcome: Outcome | null;
}

/** The answer of plan.status; web.plan brings each change. */
export interface PlanStatus {
  plan: string | null;
  name: string | null;
  kind: string | null;
  state: string;
  phase: string | null;
  step: number | null;
  steps: number | null;
  reason: string | null;
  speed: number | null;
  clock: { trajectory_s: number; duration_s: number; finishes_in_s: number | null } | null;
  waits_for: readonly string[];
  vehicles: readonly { vehicle: string; state: string; error_m: number | null; tube_m: number | null; left: string | null }[];
}
