// The bounds of a chart's values: a constant is a flat line in the middle, and noise does not fill the height.

/** Of the value itself: 16.44 V that falls by 2 mV is not a cliff. */
const LEAST_SHARE = 0.02;
const LEAST_SPAN = 0.1;
const MARGIN = 1.1;

/** [low, high] for values between these, which may be unknown; null in `range`: as the values are. */
export function bounds(least: number | null, most: number | null, range: readonly [number | null, number | null] | null): [number, number] {
  if (range !== null) {
    const low = range[0] ?? least ?? 0;
    const high = range[1] ?? most ?? 1;
    if (high > low) return [low, high];
    return range[0] === null ? [low - 0.5, low + 0.5] : [low, low + 1];
  }
  if (least === null || most === null) return [0, 1];
  const span = Math.max((most - least) * MARGIN, Math.max(Math.abs(least), Math.abs(most)) * LEAST_SHARE, LEAST_SPAN);
  const middle = (least + most) / 2;
  const low = middle - span / 2;
  return least >= 0 && low < 0 ? [0, Math.max(most, span / 2) * MARGIN] : [low, middle + span / 2];
}
