// A part of the page that is loaded after the rest, and asked for again where that failed: with the link down a reload would cost
// the whole page, and its STOP.

/** `unreachable`: it could not be loaded. `refused`: and the ground station answers, so that it has another page by now. */
export type Trouble = "unreachable" | "refused";

export class LateModule<T> {
  loaded: T | null = null;
  trouble: Trouble | null = null;
  private asking = false;
  private tries = 0;
  private readonly listeners = new Set<() => void>();

  /** `load` is called anew at each try. */
  constructor(private readonly load: () => Promise<T>) {}

  onChange(listener: () => void): () => void {
    this.listeners.add(listener);
    return () => this.listeners.delete(listener);
  }

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
    for (const listener of this.listeners) listener();
  }
}
