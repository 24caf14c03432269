// One mission for several vehicles: how their missions differ. What is made of it is worked out by the station alone.

import type { Store } from "../store.ts";
import type { ArrangementParams } from "../rpc_types.ts";
import type { Vec3 } from "../types.ts";
import type { Shape } from "../view/overlays.ts";
import { Choice, Failure, NumberField } from "./parts.tsx";

export type Kind = "same" | "heights" | "present" | "line" | "column";

export interface Several {
  kind: Kind;
  /** Null: what the margins need. */
  stepM: number | null;
  spacingM: number;
  /** Null: the course of the first leg. */
  headingDeg: number | null;
}

export const ALIKE: Several = { kind: "same", stepM: null, spacingM: 5, headingDeg: null };

/** The answer of web.mission.check: the path of each vehicle, in the order of their system ids. */
export interface SeveralPaths {
  problem: string | null;
  paths: readonly (readonly Vec3[])[];
}

const KINDS: readonly (readonly [Kind, string])[] = [
  ["same", "the same for all"],
  ["heights", "each next one higher"],
  ["present", "as they stand now"],
  ["line", "side by side"],
  ["column", "one behind another"],
];

/** What an empty field means. */
const AUTO: Readonly<Record<Kind, string>> = {
  same: "",
  heights: " Step, auto: what margins and climbs need, at least 3 m.",
  present: "",
  line: " Heading, auto: the course of the first leg.",
  column: " Heading, auto: the course of the first leg.",
};

/** The parameter of missions.upload. */
export function arrangementOf({ kind, stepM, spacingM, headingDeg }: Several): ArrangementParams | null {
  switch (kind) {
    case "same": return null;
    case "heights": return { kind, step_m: stepM };
    case "present": return { kind };
    default: return { kind, spacing_m: spacingM, heading_deg: headingDeg };
  }
}

/** The same for web.mission.check, which does not know the vehicles; null: nothing differs. */
export function askedPaths(several: Several, store: Pick<Store, "state">, targets: readonly string[]): object | null {
  const arrangement = arrangementOf(several);
  if (arrangement === null || targets.length < 2) return null;
  const places = bySystemId(store, targets).map((name) => {
    const at = store.state.vehicles.get(name)?.position?.enu_m;
    return at === null || at === undefined ? null : [at[0], at[1]];
  });
  return { ...arrangement, places_xy_m: places };
}

/** The order in which the daemon takes vehicles: the first one flies the mission as it is. */
export function bySystemId(store: Pick<Store, "state">, targets: readonly string[]): string[] {
  const id = (name: string): number => store.state.vehicles.get(name)?.sysid ?? 0;
  return [...targets].sort((a, b) => id(a) - id(b));
}

export function severalShapes(found: SeveralPaths | null): Shape[] {
  return (found?.paths ?? []).slice(1).flatMap((points): Shape[] => (points.length > 1 ? [{ kind: "path", points, ink: "plan", dashed: true }] : []));
}

export function SeveralFields({ several, keep, names, problem }: { several: Several; keep: (several: Several) => void; names: readonly string[]; problem: string | null }) {
  const beside = several.kind === "line" || several.kind === "column";
  return (
    <fieldset class="card">
      <legend>For {names.length} vehicles</legend>
      <div class="row wrap">
        <Choice label="Missions" value={several.kind} options={KINDS} onValue={(kind) => keep({ ...several, kind })} />
        {several.kind === "heights" && (
          <NumberField label="Step" unit="m" value={several.stepM} least={0.5} most={100} placeholder="auto" onValue={(stepM) => keep({ ...several, stepM })} />
        )}
        {beside && <NumberField label="Spacing" unit="m" value={several.spacingM} least={0.5} most={1000} onValue={(value) => value !== null && keep({ ...several, spacingM: value })} />}
        {beside && (
          <NumberField label="Heading" unit="°" value={several.headingDeg} least={-360} most={360} placeholder="auto" onValue={(headingDeg) => keep({ ...several, headingDeg })} />
        )}
      </div>
      <p class="muted small">{several.kind === "same" ? "Missions that overlap are refused at the start; they can be flown one after another." : `${names[0] ?? ""} flies it as it is. Missions that come nearer to each other than the margins are refused.${AUTO[several.kind]}`}</p>
      <Failure text={problem} />
    </fieldset>
  );
}
