// Outcomes of an order, as a person reads them.

import type { OrderState } from "./store.ts";
import type { Outcome, SiteAnswer } from "./types.ts";

export interface OutcomeGroup {
  ok: boolean;
  /** The answer was lost: whether it was carried out is not known. */
  unknown: boolean;
  text: string;
  names: string[];
}

/** Vehicles of which the same is said together, failures first. */
export function groupOutcomes(outcomes: Readonly<Record<string, Outcome>>): OutcomeGroup[] {
  const groups = new Map<string, OutcomeGroup>();
  for (const [name, outcome] of Object.entries(outcomes)) {
    const { ok } = outcome;
    const unknown = isUnknown(outcome);
    const text = withoutCommand(outcome);
    const key = `${ok ? 1 : 0}${unknown ? 1 : 0}${text}`;
    const group = groups.get(key);
    if (group === undefined) groups.set(key, { ok, unknown, text, names: [name] });
    else group.names.push(name);
  }
  return [...groups.values()].sort((a, b) => Number(a.ok) - Number(b.ok));
}

/** What an order with these outcomes has come to. One that only lacks answers has not failed. */
export function stateOf(outcomes: Readonly<Record<string, Outcome>>): OrderState {
  const open = Object.values(outcomes).filter(({ ok }) => !ok);
  if (open.length === 0) return "done";
  return open.every(isUnknown) ? "unknown" : "failed";
}

/** True if the answer of another site was lost: the site can be asked by the order's id. */
export function isUnknown({ result, id }: Outcome): boolean {
  return result === "unknown" && id !== undefined;
}

/** The answer of federation.outcome as the outcome of its vehicle. */
export function outcomeOf({ id, status, text, outcome }: SiteAnswer): Outcome {
  switch (status) {
    case "unknown": return lost(id, `outcome unknown: ${text}`);
    case "running": return lost(id, "still being carried out");
    case "done":
    case "failed": return outcome ?? { ok: status === "done", result: status === "done" ? "accepted" : "failed", message: text || status };
    case "refused":
    case "late":
    case "never came": return outcome ?? { ok: false, result: "refused", message: `not carried out: ${text || status}` };
  }
}

/** An outcome that can be asked for again. */
export function lost(id: string, message: string): Outcome {
  return { ok: false, result: "unknown", message, id };
}

/** The page has a button in place of the command that a shell is told. */
function withoutCommand({ message, id }: Outcome): string {
  return id === undefined ? message : message.replace(`; ask: skygcs-cli federation outcome ${id}`, "");
}
