// Modes that are offered to choose from: those of `core/mavlink/modes.py` that a ground station orders. The daemon knows
// all of them and has the last word.

const PX4 = ["AUTO.LOITER", "AUTO.MISSION", "AUTO.RTL", "AUTO.LAND", "AUTO.PRECLAND", "POSCTL", "ALTCTL", "STABILIZED", "MANUAL", "ACRO"];
const ARDUPILOT = ["GUIDED", "LOITER", "AUTO", "RTL", "SMART_RTL", "LAND", "BRAKE", "POSHOLD", "ALT_HOLD", "STABILIZE", "CIRCLE", "ACRO"];
const MODES: Readonly<Record<string, readonly string[]>> = { px4: PX4, ardupilot: ARDUPILOT };

/** Modes that vehicles of all these autopilots have. */
export function modesFor(families: readonly string[]): readonly string[] {
  const [first = [], ...others] = families.map((family) => MODES[family] ?? []);
  return first.filter((mode) => others.every((modes) => modes.includes(mode)));
}
