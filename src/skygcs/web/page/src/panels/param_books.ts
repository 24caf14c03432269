// What the page knows of vehicles' parameters: values, edits that wait, what was set here. It outlives the panel.

import { Changes } from "../hooks.ts";
import type { ParamEntry, ParamMetadata } from "./param_values.ts";

export interface ParamBook {
  params: readonly ParamEntry[];
  /** By name; empty until it came, and for a firmware without any. */
  metadata: Readonly<Record<string, ParamMetadata>>;
  /** Where the metadata come from. */
  source: string;
  edits: ReadonlyMap<string, number>;
  /** Set from this page: marked. */
  setHere: ReadonlySet<string>;
  sysid: number;
  compid: number;
  autopilot: string;
  /** Its list is on its way. */
  reading: boolean;
  /** Why the last list did not come. */
  failure: string | null;
}

const EMPTY_BOOK: ParamBook = { params: [], metadata: {}, source: "", edits: new Map(), setHere: new Set(), sysid: 1, compid: 1, autopilot: "generic", reading: false, failure: null };

/** Vehicles whose parameters are kept: some 300 kB each. */
export const MAX_BOOKS = 20;

export class ParamBooks extends Changes {
  private readonly byName = new Map<string, ParamBook>();

  of(name: string): ParamBook {
    return this.byName.get(name) ?? EMPTY_BOOK;
  }

  /** Keeps the changed book, and forgets the one that was changed longest ago. */
  change(name: string, change: (book: ParamBook) => ParamBook): void {
    const book = change(this.of(name));
    this.byName.delete(name);
    this.byName.set(name, book);
    const [oldest] = this.byName.keys();
    if (this.byName.size > MAX_BOOKS && oldest !== undefined) this.byName.delete(oldest);
    this.changed();
  }
}

/** One for the page. */
export const paramBooks = new ParamBooks();
