// A part of the page that is loaded after the rest, and asked for again where that failed: with the link down a reload would cost
// the whole page, and its STOP.

import { Changes } from "./hooks.ts";

/** `unreachable`: it could not be loaded. `refused`: and the ground station answers, so that it has another page by now. */
export type Trouble = "unreachable" | "refused";

export class LateModule<T> extends Changes {
  loaded: T | null = null;
  trouble: Trouble | null = null;
  private asking = false;
  private tries = 0;

  /** `load` is called anew at each try. */
  constructor(private readonly load: () => Promise<T>) { super(); }

  /** Loads it, unless it is there or on its way. Never rejects. `answers`: whether the ground station does, asked after a failure. */
  async ask(answers: () => Promise<boolean>): Promise<void> {
    if (this.loaded !== null || this.asking) return;
    this.asking = true;
    const mine = ++this.tries;
    this.become(null);
    const failed = await this.load().then((loaded) => { this.loaded = loaded; }, () => true as const) === true;
    this.asking = false;
    this.become(failed ? "unreachable" : null);
    if (failed && (await answers()) && this.tries === mine) this.become("refused");
  }

  private become(trouble: Trouble | null): void {
    this.trouble = trouble;
    this.changed();
  }
}
