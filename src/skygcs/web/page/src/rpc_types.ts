// Made of the daemon's methods by tests/unit/web/test_page_types.py: not to be edited by hand.

export type NoParams = Readonly<Record<string, never>>;

export type Targets = string | number | readonly (string | number)[];

export interface Acknowledged {
  acknowledged: readonly AlarmResult[];
}

export interface ActiveDrillFault {
  vehicle: string;
  fault: "deaf" | "link" | "gps" | "battery" | "wind";
  text: string;
  value: number | null;
  lasts_s: number;
}

export interface AlarmList {
  alarms: readonly AlarmResult[];
}

export interface AlarmResult {
  number: number;
  kind: string;
  vehicle: string | null;
  other: string | null;
  severity: "alarm" | "warning";
  text: string;
  raised_unix_s: number;
  changed_unix_s: number;
  active: boolean;
  count: number;
  consequences: Readonly<Record<string, number>>;
  acknowledged_by: string | null;
  acknowledged_unix_s: number | null;
}

export interface ArrangementParams {
  kind: "heights" | "present" | "line" | "column";
  step_m?: number | null;
  spacing_m?: number;
  heading_deg?: number | null;
}

export interface AttitudePart {
  age_s: number;
  roll_deg: number;
  pitch_deg: number;
  yaw_deg: number;
  rates_dps: readonly (number | null)[];
  quaternion: readonly (number | null)[];
  time_boot_s: number;
}

export interface AxisChange {
  pos_p_per_s?: number | null;
  vel_p?: number | null;
  vel_i?: number | null;
  vel_d?: number | null;
}

export interface BatteryPart {
  age_s: number;
  volts: number | null;
  amps: number | null;
  percent: number | null;
  consumed_mah: number | null;
  temperature_degc: number | null;
  remaining_s: number | null;
}

export interface ChannelState {
  peer: string;
  rx_bytes?: number;
  skipped_bytes?: number;
  good?: number;
  unknown?: number;
  sources?: Readonly<Record<string, unknown>>;
  counters?: Readonly<Record<string, number>>;
}

export interface ClassCounters {
  waiting: number;
  sent: number;
  sent_bytes: number;
  replaced: number;
  dropped: number;
  refused: number;
  wait_p50_s: number | null;
  wait_p95_s: number | null;
}

export interface CompanionPart {
  name: string | null;
  link: "connecting" | "up" | "down" | null;
  since_s: number | null;
  error: string | null;
  version: string | null;
  age_s: number | null;
}

export interface ComponentEntry {
  compid: number;
  name: string | null;
  type: string | null;
  autopilot: boolean;
  age_s: number;
  messages: number;
}

export interface ControlReference {
  pos_enu_m: readonly (number | null)[] | null;
  vel_enu_mps: readonly (number | null)[] | null;
  yaw_deg: number | null;
}

export interface ControlState {
  vehicle: string;
  mode: string | null;
  control_mode: string | null;
  state: "off" | "engaging" | "flying" | "held";
  reasons: readonly string[];
  successor: string | null;
  reference: ControlReference | null;
  error_enu_m: readonly number[] | null;
  error_m: number | null;
  state_age_s: number | null;
  delay_p95_s: number | null;
  rtt_s: number | null;
  rate_hz: number | null;
  ticks: number;
  late: number;
  skipped: number;
  lateness_p99_s: number | null;
  trajectory: Readonly<Record<string, unknown>> | null;
  prediction: Readonly<Record<string, unknown>> | null;
  raw: string | null;
  saturation: readonly string[];
  integral_enu: readonly number[];
  thrust: number | null;
  roll_deg: number | null;
  pitch_deg: number | null;
  recording: string | null;
  stream: StreamState | null;
  setpoints_refused: number;
}

export interface CorrectionsStatus {
  source: string | null;
  age_s: number | null;
  bytes_per_s: number;
  messages: number;
  bytes: number;
  refused: number;
  too_long: number;
  bad_crc: number;
  skipped_bytes: number;
  types: Readonly<Record<string, unknown>>;
  radios: readonly (Readonly<Record<string, unknown>>)[];
  vehicles: readonly RtkFix[];
  rtk_float: number;
  rtk_fixed: number;
  own_source: OwnSource | null;
}

export interface DrillFault {
  fault: "deaf" | "link" | "gps" | "battery" | "wind";
  text: string;
  unit: string | null;
  default: number | null;
  least: number;
  most: number;
}

export interface DrillsStatus {
  simulated: readonly string[];
  faults: readonly DrillFault[];
  active: readonly ActiveDrillFault[];
}

export interface EventRecord {
  time_unix_s: number;
  kind: string;
  vehicle: string | null;
  sysid: number | null;
  severity: "alarm" | "warning" | "info";
  text: string;
  data: Readonly<Record<string, unknown>>;
}

export interface FenceResult {
  ok: boolean;
  result: "accepted" | "temporarily_rejected" | "denied" | "unsupported" | "failed" | "in_progress" | "cancelled" | "timeout" | "refused" | "lost";
  message: string;
  attempts: number;
  elapsed_s: number;
  status_texts: readonly string[];
  order_number?: number | null;
  taken?: boolean;
  fence: HomeFence | null;
  record: Readonly<Record<string, unknown>> | null;
}

export interface FenceResults {
  outcomes: Readonly<Record<string, FenceResult>>;
}

export interface FormationMember {
  vehicle: string;
  place_enu_m: readonly [number, number, number];
  off_place_m: number | null;
  at_place: boolean;
  hindered: boolean;
  radius_m: number;
  left: string | null;
}

export interface FormationStatus {
  state: "none" | "flying" | "stopping" | "stopped";
  reason?: string;
  settled?: boolean;
  leader?: string | null;
  middle_enu_m?: readonly [number, number, number] | null;
  vel_enu_mps?: readonly number[] | null;
  heading_deg?: number | null;
  scale?: number | null;
  rms_m?: number | null;
  least_m?: number | null;
  least_pair?: readonly string[] | null;
  members: readonly FormationMember[];
}

export interface GainsAnswer {
  outcomes: Readonly<Record<string, Readonly<Record<string, unknown>>>>;
  gains: Readonly<Record<string, GainsOfVehicle>>;
}

export interface GainsOfVehicle {
  xy: Readonly<Record<string, number>>;
  z: Readonly<Record<string, number>>;
  hover_thrust: number;
  limits: Readonly<Record<string, number>>;
}

export interface GpsPart {
  age_s: number;
  fix: string;
  fix_type: number;
  satellites: number | null;
  hdop: number | null;
  vdop: number | null;
  lat_deg: number | null;
  lon_deg: number | null;
  alt_amsl_m: number | null;
  time_usec: number;
}

export interface HomeFence {
  enabled: boolean | null;
  action: string | null;
  radius_m: number | null;
  height_m: number | null;
  follows_list: boolean | null;
}

export interface HomePart {
  age_s: number;
  lat_deg: number;
  lon_deg: number;
  alt_amsl_m: number | null;
}

export interface LinkPart {
  age_s: number;
  frames: number;
  bytes: number;
  lost: number;
  loss_ratio: number | null;
  frames_per_s: number;
  bytes_per_s: number;
  chosen?: boolean;
}

export interface LinkState {
  name: string;
  type: string;
  role: string;
  state: string;
  last_error: string | null;
  ignored_datagrams?: number;
  peers_refused?: number;
  not_allowed?: number;
  channels: readonly ChannelState[];
}

export interface LoadedPlan {
  plan: string;
  name: string;
  kind: "timed" | "phased";
  vehicles: readonly string[];
  duration_s: number | null;
  phases: readonly string[];
}

export interface MessageRate {
  rate_hz: number;
  age_s: number;
  count: number;
}

export interface MessageReading {
  name: string;
  sysid: number;
  compid: number;
  fields: Readonly<Record<string, unknown>>;
  age_s: number;
  rate_hz: number;
  count: number;
}

export interface MissionPart {
  age_s: number;
  item: number | null;
  seq: number | null;
  count: number | null;
  last_ack: string | null;
}

export interface MissionStatus {
  vehicle: string;
  item: number | null;
  reached: number | null;
  state: string | null;
  counts: Readonly<Record<string, number | null>>;
  opaque_ids: Readonly<Record<string, number | null>>;
  transfer: MissionTransfer | null;
  last: Readonly<Record<string, Readonly<Record<string, unknown>> | null>>;
  turn: MissionTurn | null;
  fence: Readonly<Record<string, unknown>> | null;
}

export interface MissionTransfer {
  what: string;
  percent: number | null;
  sent: number;
}

export interface MissionTurn {
  turn: number;
  of: number;
  state: "flies" | "waits" | "done";
}

export interface OriginPlace {
  lat_deg: number;
  lon_deg: number;
  alt_amsl_m: number;
  x_heading_deg: number;
}

export interface OriginStatus {
  origin: OriginPlace | null;
  generation: number;
}

export interface OutcomeResult {
  ok: boolean;
  result: "accepted" | "temporarily_rejected" | "denied" | "unsupported" | "failed" | "in_progress" | "cancelled" | "timeout" | "refused" | "lost";
  message: string;
  attempts: number;
  elapsed_s: number;
  status_texts: readonly string[];
  order_number?: number | null;
  taken?: boolean;
}

export interface Outcomes {
  outcomes: Readonly<Record<string, OutcomeResult>>;
}

export interface OwnSource {
  kind: "ntrip" | "receiver";
  name: string;
  state: "connecting" | "waiting" | "streaming" | "held_off" | "down";
  text: string;
  since_s: number;
  bytes: number;
  bytes_per_s: number;
  messages: number;
  age_s: number | null;
  survey?: Survey | null;
}

export interface ParamDescription {
  unit: string;
  least: number | null;
  greatest: number | null;
  range: string;
  reboot: boolean;
  values: Readonly<Record<string, string>>;
  bits: Readonly<Record<string, string>>;
  description: string;
}

export interface ParamEntry {
  name: string;
  value: number | null;
  type: string;
}

export interface ParamListResults {
  lists: Readonly<Record<string, ParamsOfVehicle>>;
}

export interface ParamLoading {
  received: number;
  count: number | null;
  percent: number | null;
  elapsed_s: number;
  remaining_s: number | null;
}

export interface ParamMetadataOfVehicle {
  own: boolean;
  source: string;
  why_not_own: string;
  parameters: Readonly<Record<string, ParamDescription>>;
}

export interface ParamMetadataResults {
  vehicles: Readonly<Record<string, ParamMetadataOfVehicle>>;
}

export interface ParamResult {
  ok: boolean;
  result: string;
  message: string;
  name: string;
  value: number | null;
  type: string | null;
  before: number | null;
  attempts: number;
  elapsed_s: number;
}

export interface ParamResults {
  outcomes: Readonly<Record<string, Readonly<Record<string, ParamResult>>>>;
}

export interface ParamStatus {
  known: number;
  complete: boolean;
  hash: number | null;
  loading: ParamLoading | null;
  in_progress: number;
}

export interface ParamsOfVehicle {
  ok: boolean;
  result: string;
  message: string;
  source: string;
  vouched: string;
  count: number | null;
  sent: number;
  elapsed_s: number;
  sysid: number;
  compid: number;
  autopilot: string;
  params: readonly ParamEntry[] | null;
}

export interface PieceParams {
  duration_s: number;
  x: readonly number[];
  y: readonly number[];
  up: readonly number[];
  yaw?: readonly number[] | null;
}

export interface PlanDownload {
  outcome: OutcomeResult;
  plan: string | null;
  mission: readonly (Readonly<Record<string, unknown>>)[];
  fence: readonly (Readonly<Record<string, unknown>>)[];
  rally: readonly (Readonly<Record<string, unknown>>)[];
}

export interface PlanFinding {
  vehicle: string | null;
  check: string;
  severity: "ok" | "note" | "warning" | "refused";
  text: string;
  todo: string;
  command: string | null;
  insist: boolean;
}

export interface PlanOrderAnswer {
  ok: boolean;
  message: string;
  reasons: readonly string[];
}

export interface PlanReport {
  ok: boolean;
  by: "goto" | "setpoints" | "onboard" | "mission";
  why: string;
  findings: readonly PlanFinding[];
  certificate: Readonly<Record<string, unknown>> | null;
  way_there: Readonly<Record<string, unknown>> | null;
  margins: Readonly<Record<string, Readonly<Record<string, readonly unknown[]>>>>;
  duration_s: number;
  steps: readonly PlanStep[];
  return_heights: Readonly<Record<string, readonly [number | null, number, string]>>;
}

export interface PlanStarted {
  started: boolean;
  report: PlanReport;
}

export interface PlanStatus {
  now_s: number;
  plan: string | null;
  name: string | null;
  kind: string | null;
  state: string;
  busy: string | null;
  phase: string | null;
  step: number;
  steps: number;
  reason: string;
  by: string | null;
  mode: string | null;
  speed: number | null;
  clock: StepClock | null;
  waits_for: readonly string[];
  pairs: readonly (Readonly<Record<string, unknown>>)[];
  vehicles: readonly VehicleInPlan[];
}

export interface PlanStep {
  name: string;
  duration_s: number | null;
  goals: Readonly<Record<string, readonly [number, number, number]>>;
}

export interface PlanUploaded {
  upload: number;
  bytes: number;
}

export interface PositionPart {
  age_s: number;
  lat_deg: number | null;
  lon_deg: number | null;
  alt_amsl_m: number | null;
  alt_rel_m: number | null;
  heading_deg: number | null;
  vel_enu_mps: readonly [number, number, number] | null;
  time_boot_s: number;
  takeoff_alt_amsl_m: number | null;
  alt_takeoff_m: number | null;
  enu_m: readonly [number, number, number] | null;
  vel_world_mps: readonly [number, number, number] | null;
  yaw_world_deg: number | null;
  origin_generation: number | null;
}

export interface PreflightAnswer {
  ok: boolean;
  vehicles: Readonly<Record<string, PreflightReport>>;
}

export interface PreflightFinding {
  check: string;
  verdict: "pass" | "fail" | "unknown" | "skipped";
  severity: "danger" | "fault" | "note";
  text: string;
  todo: string;
  fixes: readonly PreflightFix[];
}

export interface PreflightFix {
  name: string;
  before: number;
  value: number;
}

export interface PreflightReport {
  ok: boolean;
  summary: string;
  sysid: number;
  autopilot: string;
  findings: readonly PreflightFinding[];
  fixes: readonly PreflightFix[];
  fixed: Readonly<Record<string, ParamResult>>;
  unfixed: string;
}

export interface PreflightStatus {
  state: "never" | "failed" | "passed" | "expired";
  required: boolean;
  age_s: number | null;
  valid_s: number | null;
  refusal: string | null;
  report: PreflightReport | null;
}

export interface PresenceResult {
  ok: boolean;
}

export interface RadioAir {
  link: string;
  peer: string;
  vehicles: readonly RadioVehicle[];
  down: RadioDown;
  up: RadioUp;
  poor: readonly string[];
  history: readonly RadioReport[];
}

export interface RadioDown {
  budget_bytes_per_s: number;
  per_vehicle_bytes_per_s: number;
  planned_bytes_per_s: number;
  measured_bytes_per_s: number;
  factor: number;
}

export interface RadioReport {
  age_s: number;
  txbuf_percent: number;
  rssi: number;
  noise: number;
  remrssi: number;
  remnoise: number;
}

export interface RadioUp {
  base_bytes_per_s: number;
  bytes_per_s: number;
  paced_by: "rates" | "reports";
  round_s: number | null;
  radio: RadioReport | null;
  classes: Readonly<Record<string, ClassCounters>>;
  third_party: ThirdPartyShare | null;
}

export interface RadioVehicle {
  name: string;
  sysid: number;
  weight: number;
  planned_bytes_per_s: number;
  measured_bytes_per_s: number | null;
  loss: number | null;
  round_trip_s: number | null;
  settled: boolean;
  scaled: boolean;
  streams: Readonly<Record<string, StreamRates>>;
}

export interface RecordingFile {
  name: string;
  bytes: number;
  begun_unix_s: number | null;
  ended_unix_s: number;
}

export interface RecordingsList {
  folder: string;
  recordings: readonly RecordingFile[];
  left_out: number;
  replays: string | null;
}

export interface ReplayEnded {
  ended: boolean;
}

export interface ReplayPage {
  name: string;
  address: string;
}

export interface RtkFix {
  name: string;
  fix: string | null;
  satellites: number | null;
}

export interface SeparationPart {
  with: string;
  level: "notice" | "warning" | "action";
  distance_m?: number;
  closest_m?: number;
  closest_in_s?: number;
  enters_in_s?: number;
  margin_m?: number;
}

export interface StatusTextEntry {
  severity: string;
  level: number;
  text: string;
  compid: number;
  age_s: number;
}

export interface StepClock {
  state: string;
  trajectory_s: number;
  duration_s: number;
  rate: number;
  speed_factor: number;
  finishes_in_s: number | null;
}

export interface StreamRates {
  planned_hz: number;
  measured_hz: number;
}

export interface StreamState {
  client: string;
  left_s: number;
}

export interface Survey {
  state: "setting_up" | "surveying" | "surveyed" | "fixed";
  duration_s: number | null;
  minimum_s: number | null;
  accuracy_m: number | null;
  wanted_m: number | null;
  observations: number | null;
}

export interface ThirdPartyShare {
  bytes_per_s: number;
  sources: readonly ThirdPartySource[];
}

export interface ThirdPartySource {
  source: string;
  age_s: number;
  sent: number;
  sent_bytes: number;
  counts: Readonly<Record<string, number>>;
}

export interface TrajectoryOfVehicle {
  vehicle: string;
  name: string;
  pieces: number;
  duration_s: number;
  start_enu_m: readonly [number, number, number];
}

export interface TrajectoryPath {
  vehicle: string;
  name: string;
  flown: boolean;
  points_enu_m: readonly (readonly [number, number, number])[];
}

export interface TrajectoryPaths {
  key: string;
  paths: readonly TrajectoryPath[] | null;
}

export interface TrajectoryStatus {
  now_s: number;
  trajectories: readonly TrajectoryOfVehicle[];
}

export interface TurnsEnded {
  ended: boolean;
}

export interface UplinkPart {
  age_s: number;
  heard: boolean;
  unanswered: number;
  rtt_s: number | null;
}

export interface VehicleInPlan {
  vehicle: string;
  state: string;
  error_m: number | null;
  tube_m: number | null;
  pos_enu_m: readonly [number, number, number] | null;
  goal_enu_m: readonly [number, number, number] | null;
  position_age_s: number | null;
  left: string | null;
}

export interface VehicleState {
  name: string;
  sysid: number;
  compid: number;
  autopilot: string;
  type: string;
  firmware: string | null;
  groups: readonly string[];
  gcs_sysid: number | null;
  connected: boolean;
  duplicate_sysid: boolean;
  replayed: boolean;
  last_heartbeat_age_s: number | null;
  uptime_s: number | null;
  clock_offset_s: number | null;
  armed: boolean;
  mode: string;
  system_status: string;
  landed: string;
  failsafe: boolean;
  authority: Readonly<Record<string, unknown>> | null;
  control: Readonly<Record<string, unknown>> | null;
  uplink: UplinkPart | null;
  separation: SeparationPart | null;
  calibration: Readonly<Record<string, unknown>> | null;
  companion: CompanionPart | null;
  gps: GpsPart | null;
  position: PositionPart | null;
  local: Readonly<Record<string, unknown>> | null;
  attitude: AttitudePart | null;
  battery: BatteryPart | null;
  home: HomePart | null;
  ekf_origin: Readonly<Record<string, unknown>> | null;
  estimator: Readonly<Record<string, unknown>> | null;
  sensors: Readonly<Record<string, unknown>> | null;
  vfr: VfrPart | null;
  rc: Readonly<Record<string, unknown>> | null;
  imu: Readonly<Record<string, unknown>> | null;
  servos: Readonly<Record<string, unknown>> | null;
  mission: MissionPart | null;
  target_global: Readonly<Record<string, unknown>> | null;
  target_local: Readonly<Record<string, unknown>> | null;
  target_attitude: Readonly<Record<string, unknown>> | null;
  time: Readonly<Record<string, unknown>> | null;
  high_latency: Readonly<Record<string, unknown>> | null;
  last_ack: Readonly<Record<string, unknown>> | null;
  status_texts: readonly StatusTextEntry[];
  components: readonly ComponentEntry[];
  messages: Readonly<Record<string, MessageRate>>;
  links: Readonly<Record<string, LinkPart>>;
}

export interface VfrPart {
  age_s: number;
  airspeed_mps: number | null;
  groundspeed_mps: number | null;
  heading_deg: number;
  throttle_percent: number;
  alt_m: number | null;
  climb_mps: number | null;
}

/** Keys of a state that web.state carries. */
export type StateKey = "name" | "sysid" | "compid" | "autopilot" | "type" | "firmware" | "groups" | "connected" | "duplicate_sysid" | "replayed" | "last_heartbeat_age_s" | "uptime_s" | "armed" | "mode" | "system_status" | "landed" | "failsafe" | "control" | "uplink" | "separation" | "companion" | "gps" | "position" | "attitude" | "battery" | "home" | "vfr" | "mission" | "links";

export interface Results {
  "alarms.acknowledge": Acknowledged;
  "alarms.list": AlarmList;
  "control.gains": GainsAnswer;
  "control.set": Outcomes;
  "control.status": readonly ControlState[];
  "corrections.status": CorrectionsStatus;
  "drills.begin": Outcomes;
  "drills.end": Outcomes;
  "drills.status": DrillsStatus;
  "events.recent": readonly EventRecord[];
  "fence.set": FenceResults;
  "fence.status": FenceResults;
  "formation.move": FormationStatus;
  "formation.scale": FormationStatus;
  "formation.start": FormationStatus;
  "formation.status": FormationStatus;
  "formation.stop": FormationStatus;
  "formation.turn": FormationStatus;
  "link.status": readonly RadioAir[];
  "links.list": readonly LinkState[];
  "messages.latest": MessageReading | null;
  "missions.clear": Outcomes;
  "missions.download": PlanDownload;
  "missions.end_turns": TurnsEnded;
  "missions.pause": Outcomes;
  "missions.resume": Outcomes;
  "missions.set_current": Outcomes;
  "missions.start": Outcomes;
  "missions.status": readonly MissionStatus[];
  "missions.upload": Outcomes;
  "operator.active": PresenceResult;
  "origin.from_vehicle": OriginStatus;
  "origin.get": OriginStatus;
  "origin.set": OriginStatus;
  "params.cancel": Readonly<Record<string, number>>;
  "params.list": ParamListResults;
  "params.metadata": ParamMetadataResults;
  "params.set": ParamResults;
  "params.status": Readonly<Record<string, ParamStatus>>;
  "plan.abort": PlanOrderAnswer;
  "plan.check": PlanReport;
  "plan.land": PlanOrderAnswer;
  "plan.load": LoadedPlan;
  "plan.pause": PlanOrderAnswer;
  "plan.resume": PlanOrderAnswer;
  "plan.run": PlanStarted;
  "plan.speed": PlanOrderAnswer;
  "plan.status": PlanStatus;
  "plan.upload": PlanUploaded;
  "preflight.run": PreflightAnswer;
  "preflight.status": Readonly<Record<string, PreflightStatus>>;
  "recordings.end": ReplayEnded;
  "recordings.list": RecordingsList;
  "recordings.replay": ReplayPage;
  "trajectory.abort": Outcomes;
  "trajectory.load": Outcomes;
  "trajectory.paths": TrajectoryPaths;
  "trajectory.pause": Outcomes;
  "trajectory.resume": Outcomes;
  "trajectory.start": Outcomes;
  "trajectory.status": TrajectoryStatus;
  "vehicles.arm": Outcomes;
  "vehicles.disarm": Outcomes;
  "vehicles.get": VehicleState;
  "vehicles.goto": Outcomes;
  "vehicles.hold": Outcomes;
  "vehicles.interval": Outcomes;
  "vehicles.land": Outcomes;
  "vehicles.mode": Outcomes;
  "vehicles.rtl": Outcomes;
  "vehicles.stop": Outcomes;
  "vehicles.takeoff": Outcomes;
}

export interface Params {
  "alarms.acknowledge": { by: string; numbers?: readonly number[] | null };
  "alarms.list": NoParams;
  "control.gains": { targets: Targets; xy?: AxisChange | null; z?: AxisChange | null; hover_thrust?: number | null; force?: boolean };
  "control.set": { targets: Targets; mode: "off" | "position" | "velocity" | "attitude" | "raw"; force?: boolean };
  "control.status": { targets?: Targets };
  "corrections.status": NoParams;
  "drills.begin": { targets: Targets; fault: "deaf" | "link" | "gps" | "battery" | "wind"; value?: number | null };
  "drills.end": { targets: Targets; fault?: "deaf" | "link" | "gps" | "battery" | "wind" | null };
  "drills.status": NoParams;
  "events.recent": { limit?: number };
  "fence.set": { targets: Targets; radius_m?: number | null; height_m?: number | null; action?: "none" | "warn" | "hold" | "return" | "land" | "terminate" | null; force?: boolean };
  "fence.status": { targets?: Targets };
  "formation.move": { to_enu_m?: readonly [number, number, number] | null; vel_enu_mps?: readonly [number, number, number] | null; speed_mps?: number | null; valid_s?: number };
  "formation.scale": { factor: number };
  "formation.start": { targets: Targets; shape?: "current" | "line" | "column" | "v" | "circle" | "grid"; spacing_m?: number; heading_deg?: number | null; leader?: string | null; at_enu_m?: readonly [number, number, number] | null };
  "formation.status": NoParams;
  "formation.stop": NoParams;
  "formation.turn": { heading_deg: number };
  "link.status": NoParams;
  "links.list": NoParams;
  "messages.latest": { target: string | number; name: string | number };
  "missions.clear": { targets: Targets; lists?: readonly ("mission" | "fence" | "rally")[]; force?: boolean };
  "missions.download": { target: string | number; lists?: readonly ("mission" | "fence" | "rally")[] };
  "missions.end_turns": NoParams;
  "missions.pause": { targets: Targets };
  "missions.resume": { targets: Targets; force?: boolean };
  "missions.set_current": { targets: Targets; item: number; force?: boolean };
  "missions.start": { targets: Targets; first?: number; arm?: boolean; one_after_another?: boolean; force?: boolean };
  "missions.status": { targets?: Targets };
  "missions.upload": { targets: Targets; plan: string; name?: string; lists?: readonly ("mission" | "fence" | "rally")[] | null; arrangement?: ArrangementParams | null; force?: boolean };
  "operator.active": NoParams;
  "origin.from_vehicle": { target: string | number; heading?: boolean; force?: boolean };
  "origin.get": NoParams;
  "origin.set": { lat_deg: number; lon_deg: number; alt_amsl_m: number; x_heading_deg?: number | null; force?: boolean };
  "params.cancel": { targets: Targets };
  "params.list": { targets: Targets; refresh?: boolean; burst?: boolean; bytes_per_s?: number | null; values?: boolean };
  "params.metadata": { targets: Targets; names: readonly string[]; read?: boolean };
  "params.set": { targets: Targets; params: Readonly<Record<string, number>>; settle?: boolean; force?: boolean };
  "params.status": { targets: Targets };
  "plan.abort": NoParams;
  "plan.check": { plan?: string | null; vehicles?: Readonly<Record<string, string | number>> | null; mode?: "position" | "velocity" | "attitude"; speed?: number; margin_m?: number | null; force?: boolean; by?: "auto" | "goto" | "setpoints" | "onboard" | "mission" };
  "plan.land": { force?: boolean };
  "plan.load": { plan?: Readonly<Record<string, unknown>> | null; name?: string; upload?: number | null };
  "plan.pause": NoParams;
  "plan.resume": { force?: boolean };
  "plan.run": { plan?: string | null; vehicles?: Readonly<Record<string, string | number>> | null; mode?: "position" | "velocity" | "attitude"; speed?: number; margin_m?: number | null; force?: boolean; by?: "auto" | "goto" | "setpoints" | "onboard" | "mission"; set_return_heights?: boolean };
  "plan.speed": { speed: number };
  "plan.status": NoParams;
  "plan.upload": { part: string; upload?: number | null };
  "preflight.run": { targets: Targets; fix?: boolean; confirmed?: Readonly<Record<string, Readonly<Record<string, number>>>> | null };
  "preflight.status": { targets: Targets };
  "recordings.end": NoParams;
  "recordings.list": NoParams;
  "recordings.replay": { name: string };
  "trajectory.abort": { targets: Targets };
  "trajectory.load": { target: string | number; pieces: readonly PieceParams[]; name?: string };
  "trajectory.paths": { targets?: Targets; known?: string | null };
  "trajectory.pause": { targets: Targets };
  "trajectory.resume": { targets: Targets };
  "trajectory.start": { targets: Targets; after_s?: number | null; at_s?: number | null; speed?: number; force?: boolean };
  "trajectory.status": { targets?: Targets };
  "vehicles.arm": { targets: Targets; force?: boolean; wait_s?: number };
  "vehicles.disarm": { targets: Targets; force?: boolean; confirm?: string | null };
  "vehicles.get": { target: string | number };
  "vehicles.goto": { targets: Targets; lat_deg?: number | null; lon_deg?: number | null; height_m?: number | null; enu_m?: readonly [number, number, number] | null; yaw_deg?: number | null; force?: boolean; same_place?: boolean; together?: Targets | null };
  "vehicles.hold": { targets: Targets; instead_of?: number | null };
  "vehicles.interval": { targets: Targets; message: string | number; rate_hz: number | null };
  "vehicles.land": { targets: Targets };
  "vehicles.mode": { targets: Targets; mode: string; force?: boolean };
  "vehicles.rtl": { targets: Targets };
  "vehicles.stop": { targets: Targets; action?: "hold" | "land" | "kill"; confirm?: string | null };
  "vehicles.takeoff": { targets: Targets; height_m?: number | null; arm?: boolean; wait_s?: number; force?: boolean };
}
