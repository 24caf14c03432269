// What each vehicle did in the last minutes, kept for the charts from the page's first second on. Bounded.

import type { Action, State, Store, Vehicle } from "../store.ts";
import { isFlying } from "../setpoint_orders.ts";
import { HistoryRing } from "./history_ring.ts";

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
