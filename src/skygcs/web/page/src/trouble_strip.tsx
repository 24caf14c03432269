// Left of STOP, and on a phone below it: a pill for each vehicle in trouble, worst first. A click selects and shows it.

import { useSlowState } from "./hooks.ts";
import { serverNowS, type Store } from "./store.ts";
import { troublesOf, type Trouble } from "./trouble.ts";
import type { FleetView } from "./view/fleet_view.ts";

/** Pills that there is room for; CSS shows the first one alone where there is room for no more. */
const MOST_SHOWN = 3;

const MARKS = { danger: "!", warning: "?" } as const;

export function TroubleStrip({ store, view }: { store: Store; view: FleetView }) {
  const { state, nowMs } = useSlowState(store, 500);
  if (state.hello?.replay === true) return null;
  const found = troublesOf([...state.vehicles.values()], serverNowS(state, nowMs));
  if (found.length === 0) return null;
  const show = (names: readonly string[]): void => {
    store.dispatch({ type: "select", names, how: "only" });
    location.hash = "fleet";
    view.fit("selected");
  };
  const all = found.map(({ name }) => name);
  const more = (shown: number, where: string) => found.length > shown && (
    <button type="button" class={`pill more ${where}`} title={`Select all ${found.length} vehicles in trouble`} onClick={() => show(all)}>
      +{found.length - shown} more
    </button>
  );
  return (
    <section class="troubles" aria-label="Vehicles in trouble">
      {found.slice(0, MOST_SHOWN).map((trouble) => <Pill key={trouble.name} trouble={trouble} show={show} />)}
      {more(MOST_SHOWN, "wide")}
      {more(1, "narrow")}
    </section>
  );
}

function Pill({ trouble: { name, severity, text }, show }: { trouble: Trouble; show: (names: readonly string[]) => void }) {
  return (
    <button type="button" class="pill" data-severity={severity} title={`${name}: ${text}`} onClick={() => show([name])}>
      <span class="mark" aria-hidden="true">{MARKS[severity]}</span> <b>{name}</b> {text}
    </button>
  );
}
