// Reports of the preflight, of one vehicle and as a table of the fleet. Pure.

import type { PreflightFinding, PreflightStatus } from "../rpc_types.ts";
/** As a person reads them: what is red first. */
export const VERDICTS = ["fail", "unknown", "pass", "skipped"] as const satisfies readonly PreflightFinding["verdict"][];

export interface Matrix {
  /** Vehicles with a report, the worst first. */
  vehicles: readonly string[];
  rows: readonly MatrixRow[];
  /** Checks that apply to none of them. */
  skipped: readonly string[];
  /** Vehicles that were not examined since the daemon started. */
  never: readonly string[];
  /** They may be armed as far as the preflight says. */
  ready: number;
  /** Their pass is too old to count. */
  expired: readonly string[];
}

export interface MatrixRow {
  check: string;
  /** By vehicle; a vehicle without it was examined by an earlier daemon, or the check is not for its firmware. */
  findings: ReadonlyMap<string, PreflightFinding>;
}

/** All vehicles by all checks: checks that somebody failed stand first, and vehicles that failed most. */
export function matrixOf(statuses: Readonly<Record<string, PreflightStatus>>): Matrix {
  const examined = Object.entries(statuses).flatMap(([name, { report }]) => (report === null ? [] : [[name, report] as const]));
  const named = (state: string): string[] => Object.keys(statuses).filter((name) => statuses[name]?.state === state);
  const byCheck = new Map<string, Map<string, PreflightFinding>>();
  for (const [name, { findings }] of examined) {
    for (const finding of findings) {
      const row = byCheck.get(finding.check);
      if (row === undefined) byCheck.set(finding.check, new Map([[name, finding]]));
      else row.set(name, finding);
    }
  }
  const badness = (findings: Iterable<PreflightFinding>): number => [...findings].reduce((sum, { verdict }) => sum + (WEIGHT[verdict] ?? 0), 0);
  const applies = (findings: ReadonlyMap<string, PreflightFinding>): boolean => [...findings.values()].some(({ verdict }) => verdict !== "skipped");
  return {
    vehicles: examined.map(([name, { findings }]) => ({ name, bad: badness(findings) })).sort((a, b) => b.bad - a.bad).map(({ name }) => name),
    rows: [...byCheck].filter(([, findings]) => applies(findings)).map(([check, findings]) => ({ check, findings })).sort((a, b) => badness(b.findings.values()) - badness(a.findings.values())),
    skipped: [...byCheck].filter(([, findings]) => !applies(findings)).map(([check]) => check),
    never: Object.keys(statuses).filter((name) => statuses[name]?.report === null),
    ready: named("passed").length,
    expired: named("expired"),
  };
}

/** Any number of checks that could not be made is less than one that failed. */
const WEIGHT: Readonly<Record<string, number>> = { fail: 1000, unknown: 1 };
