// A table of initial and final positions: what the seed's buttons loaded. Its positions become goals on the view.

import { useMemo, useState } from "preact/hooks";
import { useOverlay } from "../hooks.ts";
import type { State } from "../store.ts";
import type { Vec3 } from "../types.ts";
import type { Shape } from "../view/overlays.ts";
import { overlay } from "./drafts.ts";
import { contentOf, DropZone, Failure, Kept, useAsk, useKept } from "./parts.tsx";
import type { PanelProps } from "./registry.ts";

const OVERLAY = "position table";

export type Which = "initial" | "final";

/** The answer of web.positions.check. */
export interface PositionTable {
  name: string;
  vehicles: Readonly<Record<string, Readonly<Record<Which, Vec3 | null>>>>;
  headings: boolean;
}

const TABLE = new Kept<PositionTable | null>(null);

export interface Chosen {
  goals: ReadonlyMap<string, Vec3>;
  /** Of the table and not of the fleet. */
  unknown: readonly string[];
}

/** The positions by the fleet's names; a table may name vehicles by system id, too. */
export function chosenFrom(table: PositionTable, which: Which, vehicles: State["vehicles"]): Chosen {
  const bySysid = new Map([...vehicles.values()].map((vehicle) => [String(vehicle.sysid), vehicle.name]));
  const goals = new Map<string, Vec3>();
  const unknown: string[] = [];
  for (const [key, places] of Object.entries(table.vehicles)) {
    const name = vehicles.has(key) ? key : bySysid.get(key);
    const place = places[which];
    if (name === undefined) unknown.push(key);
    else if (place !== null) goals.set(name, place);
  }
  return { goals, unknown };
}

/** Where each begins and ends. */
export function tableShapes(table: PositionTable): Shape[] {
  return Object.entries(table.vehicles).flatMap(([name, { initial, final }]): Shape[] => [
    ...(initial !== null && final !== null ? [{ kind: "path", points: [initial, final], ink: "muted", dashed: true } as const] : []),
    ...(initial === null ? [] : [{ kind: "mark", at: initial, symbol: "start", ink: "plan" } as const]),
    ...(final === null ? [] : [{ kind: "mark", at: final, symbol: "goal", ink: "goal", text: name } as const]),
  ]);
}

export function PositionTableLoader({ store, connection, view, take }: PanelProps & { take: (goals: ReadonlyMap<string, Vec3>) => void }) {
  const [table, keep] = useKept(TABLE);
  const [problem, setProblem] = useState<string | null>(null);
  const check = useAsk<PositionTable>(store, connection, "web.positions.check");
  useOverlay(view, OVERLAY, useMemo(() => (table === null ? null : overlay(tableShapes(table))), [table]));
  const content = async (file: File): Promise<object> => ({ file: await contentOf(file) });
  const open = async ([file]: File[]): Promise<void> => {
    if (file === undefined) return;
    setProblem(null);
    const found = await check.run(content(file));
    if (found !== null) keep(found);
  };
  const use = (which: Which): void => {
    if (table === null) return;
    const { goals, unknown } = chosenFrom(table, which, store.state.vehicles);
    setProblem(unknown.length === 0 ? null : `the table names ${unknown.join(", ")}, which the fleet does not have`);
    if (goals.size === 0) return;
    take(goals);
    store.dispatch({ type: "select", names: [...goals.keys()], how: "only" });
  };
  return (
    <>
      <DropZone label="Open a table of positions" accept=".csv,.toml" onFiles={(files) => void open(files)} />
      {check.busy && <p class="note">Reading …</p>}
      {table !== null && (
        <div class="row wrap" role="group" aria-label={table.name}>
          <span>{table.name}: {Object.keys(table.vehicles).length} vehicles</span>
          {(["initial", "final"] as const).map((which) => (
            <button key={which} type="button" disabled={Object.values(table.vehicles).every((places) => places[which] === null)} onClick={() => use(which)}>
              To the {which} positions
            </button>
          ))}
          <button type="button" class="quiet" aria-label="Discard the table" onClick={() => keep(null)}>×</button>
        </div>
      )}
      {table?.headings === true && <p class="muted">The headings of the table are flown by skygcs-cli table only; a plan keeps the headings that the vehicles have.</p>}
      <Failure text={problem ?? check.error} />
    </>
  );
}
