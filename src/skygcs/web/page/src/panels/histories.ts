// What each vehicle did in the last minutes, kept for the charts from the page's first second on. Bounded.

import { isFlying } from "../setpoint_orders.ts";
import type { Action, State, Store, Vehicle } from "../store.ts";

/** Columns as uPlot takes them: times, then a column for each series; null is a gap. */
export type Columns = [number[], ...(number | null)[][]];

export class HistoryRing {
  private readonly times: Float64Array;
  private readonly values: Float32Array;
  private begin = 0;
  length = 0;
  /** Rises with each row. */
  version = 0;

  /** `most`: rows kept, the newest. */
  constructor(private readonly count: number, readonly most: number) {
    this.times = new Float64Array(most);
    this.values = new Float32Array(most * count);
  }

  /** A row; one that is not newer than the last is left out. True if it was taken. */
  add(time_s: number, values: readonly (number | null | undefined)[]): boolean {
    if (!Number.isFinite(time_s) || (this.length > 0 && time_s <= this.lastTime())) return false;
    if (this.length === this.most) this.begin = (this.begin + 1) % this.most;
    else this.length += 1;
    const row = this.row(this.length - 1);
    this.times[row] = time_s;
    for (let k = 0; k < this.count; k++) this.values[row * this.count + k] = values[k] ?? Number.NaN;
    this.version += 1;
    return true;
  }

  clear(): void {
    this.begin = 0;
    this.length = 0;
    this.version += 1;
  }

  /** NaN without a row. */
  lastTime(): number {
    return this.length === 0 ? Number.NaN : (this.times[this.row(this.length - 1)] ?? Number.NaN);
  }

  /** The rows as columns; `picked`: only these series. */
  columns(picked: readonly number[] = Array.from({ length: this.count }, (_, k) => k)): Columns {
    const times: number[] = [];
    const series = picked.map((): (number | null)[] => []);
    for (let i = 0; i < this.length; i++) {
      const row = this.row(i);
      times.push(this.times[row] ?? 0);
      picked.forEach((k, at) => {
        const value = this.values[row * this.count + k] ?? Number.NaN;
        series[at]?.push(Number.isFinite(value) ? value : null);
      });
    }
    return [times, ...series];
  }

  private row(i: number): number {
    return (this.begin + i) % this.most;
  }
}

/** A counter's rate, from its readings. A counter that falls began anew. */
export class RateMeter {
  private at_s: number | null = null;
  private count = 0;

  /** Per second since the reading before; null at the first one. */
  read(time_s: number, count: number): number | null {
    const before_s = this.at_s;
    const before = this.count;
    if (before_s !== null && time_s <= before_s) return null;
    this.at_s = time_s;
    this.count = count;
    return before_s === null || count < before ? null : (count - before) / (time_s - before_s);
  }
}

/** A row each: ten minutes of 300 rows. 13 kB a vehicle. */
export const ROW_EVERY_S = 2;
export const ROWS = 300;
/** Rows of the control error of the vehicles that are flown by setpoints, at the rate of the updates: a minute. */
export const ERROR_ROWS = 600;
const MAX_VEHICLES = 255;

/** Order of the series. */
export const SERIES = ["height", "speed", "climb", "volts", "percent", "loss", "rtt", "satellites"] as const;
export type SeriesName = (typeof SERIES)[number];
export const ERROR_SERIES = ["error", "x", "y", "up"] as const;

export class Histories {
  private readonly byName = new Map<string, HistoryRing>();
  private readonly errors = new Map<string, HistoryRing>();
  private readonly noRows = new HistoryRing(SERIES.length, 1);
  private readonly noErrors = new HistoryRing(ERROR_SERIES.length, 1);

  of(name: string): HistoryRing {
    return this.byName.get(name) ?? this.noRows;
  }

  errorOf(name: string): HistoryRing {
    return this.errors.get(name) ?? this.noErrors;
  }

  /** Takes what a batch changed. `unix_s`: of the page, for the axis of time. */
  take(vehicles: readonly Vehicle[], unix_s: number): void {
    for (const vehicle of vehicles) {
      const ring = this.ringOf(this.byName, vehicle.name, SERIES.length, ROWS);
      if (ring !== null && !(unix_s - ring.lastTime() < ROW_EVERY_S)) ring.add(unix_s, rowOf(vehicle));
      const { control } = vehicle;
      if (control === null || !isFlying(vehicle)) continue;
      const error = control["error_enu_m"] as readonly (number | null)[] | null | undefined;
      this.ringOf(this.errors, vehicle.name, ERROR_SERIES.length, ERROR_ROWS)?.add(unix_s, [control.error_m, ...(error ?? [])]);
    }
  }

  private ringOf(rings: Map<string, HistoryRing>, name: string, count: number, rows: number): HistoryRing | null {
    const known = rings.get(name);
    if (known !== undefined) return known;
    if (rings.size >= MAX_VEHICLES) return null;
    const made = new HistoryRing(count, rows);
    rings.set(name, made);
    return made;
  }
}

function rowOf(vehicle: Vehicle): (number | null | undefined)[] {
  if (!vehicle.connected) return []; // a gap: what was last known is not what is
  const { position, vfr, battery, uplink, gps } = vehicle;
  const velocity = position?.vel_enu_mps;
  const speed = vfr?.groundspeed_mps ?? (velocity === null || velocity === undefined ? null : Math.hypot(velocity[0], velocity[1]));
  const losses = Object.values(vehicle.links).map((link) => link.loss_ratio).filter((loss) => loss !== null);
  const loss = losses.length === 0 ? null : Math.min(...losses) * 100;
  return [position?.alt_rel_m, speed, vfr?.climb_mps ?? velocity?.[2], battery?.volts, battery?.percent, loss, uplink?.rtt_s, gps?.satellites];
}

/** One for the page: panels come and go, what was recorded stays. */
export const histories = new Histories();

/** Records from now on; returns what ends it. */
export function beginHistories(store: Store): () => void {
  return store.onAction((action: Action, state: State) => {
    if (action.type !== "batch") return;
    const named = action.batch.vehicles.map(({ name }) => state.vehicles.get(name));
    histories.take(named.filter((vehicle) => vehicle !== undefined), Date.now() / 1000);
  });
}
