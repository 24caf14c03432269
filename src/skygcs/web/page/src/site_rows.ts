// The table by site: a row with counts for each, which unfolds to its vehicles. Pure.

import type { Row } from "./columns.ts";
import { siteOf } from "./levels.ts";
import { isHeard, silenceOf, type State, type Vehicle } from "./store.ts";
import { isInAir, isLostInAir, isProblem } from "./trouble.ts";
import type { SiteCounts } from "./types.ts";

export type SiteRow = { kind: "site"; counts: SiteCounts; names: string[]; unfolded: boolean };

/** ``found``: the vehicles that the filter leaves, sorted; while it filters, every site is unfolded. */
export function siteRows(state: State, found: readonly Vehicle[], now_s: number): (Row | SiteRow)[] {
  const filtered = state.search.trim() !== "";
  const members = new Map<string, Vehicle[]>(state.sites.map((site) => [site, []]));
  for (const vehicle of found) members.get(siteOf(vehicle.name))?.push(vehicle);
  return countsOf(state, now_s).flatMap((counts): (Row | SiteRow)[] => {
    const inside = members.get(counts.site) ?? [];
    if (filtered && inside.length === 0) return [];
    const unfolded = filtered || state.unfolded.has(counts.site);
    const names = filtered ? inside.map(({ name }) => name) : state.names.filter((name) => siteOf(name) === counts.site);
    const rows = unfolded ? inside.map((vehicle): Row => ({ kind: "vehicle", vehicle })) : [];
    return [{ kind: "site", counts, names, unfolded }, ...rows];
  });
}

/** Those that the server sent of a large fleet, otherwise counted here. */
function countsOf(state: State, now_s: number): readonly SiteCounts[] {
  if (state.counts !== null) return state.counts;
  const all = [...state.vehicles.values()];
  return state.sites.map((site) => {
    const here = all.filter(({ name }) => siteOf(name) === site);
    const heard = here.filter((vehicle) => isHeard(vehicle, now_s));
    const counted = here.filter((vehicle) => isHeard(vehicle, now_s) || isLostInAir(vehicle, now_s));
    return {
      site,
      vehicles: here.length,
      heard: heard.length,
      armed: counted.filter(({ armed }) => armed === true).length,
      in_air: counted.filter(isInAir).length,
      problems: here.length - heard.length + heard.filter(isProblem).length,
      oldest_age_s: Math.max(...here.map((vehicle) => silenceOf(vehicle, now_s) ?? Infinity)),
    };
  });
}

export interface FleetFigures {
  vehicles: number;
  armed: number;
  inAir: number;
  failsafe: number;
  silent: number;
  /** Of the silent ones, those that were in the air when they were last heard: they may still be. */
  silentInAir: number;
}

/** What is said of the whole fleet in one line. One that was lost in the air still counts as armed and in the air; one that
 *  is not heard on the ground counts as neither. */
export function fleetFigures(vehicles: readonly Vehicle[], now_s: number): FleetFigures {
  const heard = vehicles.filter((vehicle) => isHeard(vehicle, now_s));
  const lost = vehicles.filter((vehicle) => isLostInAir(vehicle, now_s));
  const counted = [...heard, ...lost];
  return {
    vehicles: vehicles.length,
    armed: counted.filter(({ armed }) => armed === true).length,
    inAir: counted.filter(isInAir).length,
    failsafe: heard.filter(({ failsafe }) => failsafe).length,
    silent: vehicles.length - heard.length,
    silentInAir: lost.length,
  };
}
