// Outcomes of an order, as a person reads them.

import type { Outcome } from "./types.ts";

export interface OutcomeGroup {
  ok: boolean;
  text: string;
  names: string[];
}

/** Vehicles of which the same is said together, failures first. */
export function groupOutcomes(outcomes: Readonly<Record<string, Outcome>>): OutcomeGroup[] {
  const groups = new Map<string, OutcomeGroup>();
  for (const [name, { ok, message }] of Object.entries(outcomes)) {
    const key = `${ok ? 1 : 0}${message}`;
    const group = groups.get(key);
    if (group === undefined) groups.set(key, { ok, text: message, names: [name] });
    else group.names.push(name);
  }
  return [...groups.values()].sort((a, b) => Number(a.ok) - Number(b.ok));
}
