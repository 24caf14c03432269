// Values over time for a chart: several series on one clock. The memory is taken at once and does not grow.

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
  constructor(
    private readonly count: number,
    readonly most: number,
  ) {
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
