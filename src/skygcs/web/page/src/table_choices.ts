// What a person chose for the table, kept in this browser: columns shown or hidden, and whether problems stand first.

import type { Column } from "./columns.ts";
import { recall, remember } from "./theme.ts";

const KEY = "skygcs.table";

export interface TableChoices {
  problemsFirst: boolean;
  /** By column; of others the column itself says it. */
  columns: Readonly<Record<string, boolean>>;
}

const DEFAULT: TableChoices = { problemsFirst: true, columns: {} };

/** What was kept; what is none of our choices is left out. */
export function parsedChoices(text: string | null): TableChoices {
  try {
    const kept: unknown = JSON.parse(text ?? "{}");
    if (typeof kept !== "object" || kept === null) return DEFAULT;
    const { problemsFirst, columns } = kept as Partial<Record<keyof TableChoices, unknown>>;
    const chosen = typeof columns === "object" && columns !== null ? Object.entries(columns).filter(([, shown]) => typeof shown === "boolean") : [];
    return { problemsFirst: problemsFirst !== false, columns: Object.fromEntries(chosen) };
  } catch {
    return DEFAULT;
  }
}

export function recalledChoices(): TableChoices {
  return parsedChoices(recall(KEY));
}

export function keepChoices(choices: TableChoices): void {
  remember(KEY, JSON.stringify(choices));
}

export function isChosen({ columns }: TableChoices, { id, byChoice }: Column): boolean {
  return columns[id] ?? byChoice !== true;
}
