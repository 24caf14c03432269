// What a STOP has come to, vehicle by vehicle: problems first, then those that have not answered, then those that hold.

import { isStop } from "./orders.ts";
import { isUnknown } from "./outcomes.ts";
import type { OrderRun, OrderState } from "./store.ts";

/** `open`: no answer, and none will come; the connection was lost, or its site did not answer. */
export type ChipState = "bad" | "open" | "waiting" | "ok";

export interface Chip {
  name: string;
  state: ChipState;
  /** What became of it, in the daemon's words. */
  text: string;
}

export interface Board {
  /** The orders of one press: ours, and those to other sites. */
  ids: readonly number[];
  chips: readonly Chip[];
  /** Since the press. */
  waitedS: number;
  /** Why an order as a whole was not carried out, or its answer is not known. */
  errors: readonly string[];
  counts: Readonly<Record<ChipState, number>>;
}

const URGENCY: readonly ChipState[] = ["bad", "open", "waiting", "ok"];

/** The board of the last STOP; null without one, or when a person has dismissed it. */
export function stopBoard(orders: readonly OrderRun[], nowMs: number): Board | null {
  const shown = orders.filter((order) => isStop(order) && order.dismissed !== true);
  if (shown.length === 0) return null;
  const chips = shown.flatMap(chipsOf).sort((a, b) => URGENCY.indexOf(a.state) - URGENCY.indexOf(b.state));
  const counts = { bad: 0, open: 0, waiting: 0, ok: 0 };
  for (const { state } of chips) counts[state] += 1;
  const ended = shown.every((order) => order.endedMs !== null);
  const until = ended ? Math.max(...shown.map((order) => order.endedMs ?? nowMs)) : nowMs;
  const errors = shown.flatMap((order) => (order.error === null ? [] : [`${order.label}: ${order.error}`]));
  return { ids: shown.map((order) => order.id), chips, waitedS: (until - Math.min(...shown.map((order) => order.startedMs))) / 1000, errors, counts };
}

function chipsOf(order: OrderRun): Chip[] {
  return order.targets.map((name) => {
    const outcome = order.outcomes[name];
    if (outcome === undefined) return { name, state: unanswered(order.state), text: order.error ?? "" };
    if (outcome.ok) return { name, state: "ok", text: outcome.message };
    return { name, state: isUnknown(outcome) ? "open" : "bad", text: outcome.message };
  });
}

function unanswered(state: OrderState): ChipState {
  return state === "pending" ? "waiting" : state === "failed" ? "bad" : "open";
}

/** "8 hold, 1 refused or silent, 1 waited for": what a person reads first. */
export function boardText({ counts, chips }: Board): string {
  if (chips.length === 0) return "no vehicle is known";
  const parts = [
    [counts.bad, "did not stop"],
    [counts.open, "not known"],
    [counts.waiting, "not answered yet"],
    [counts.ok, counts.ok === chips.length ? "stopped: all" : "stopped"],
  ] as const;
  return parts.filter(([count]) => count > 0).map(([count, word]) => `${count} ${word}`).join(", ");
}
