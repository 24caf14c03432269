// The fleet table: sorted, filtered, grouped; only the rows that are seen exist. Selection is the view's.

import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import type { Cell } from "./cells.ts";
import { type Column, COLUMNS, type Grouping, matches, type Row, rowsOf, type SiteRow, siteRows, sorted, type Sorting } from "./columns.ts";
import type { Connection } from "./connection.ts";
import { EmptyFleet } from "./empty_fleet.tsx";
import { ageText } from "./format.ts";
import { useSlowState, useStore, useWindowEvent } from "./hooks.ts";
import { Check } from "./panels/parts.tsx";
import { isTextField } from "./stop_key.ts";
import { isHeard, serverNowS, type Store, type Vehicle } from "./store.ts";
import { isChosen, keepChoices, recalledChoices, type TableChoices } from "./table_choices.ts";
import { troubleOf } from "./trouble.ts";
import type { Surroundings } from "./vehicle_status.ts";

const REFRESH_MS = 250;
const ROW_PX = 30;
/** By a finger. */
const TOUCH_ROW_PX = 56;
const OVERSCAN = 6;

export function FleetTable({ store, connection }: { store: Store; connection: Connection }) {
  const { state, nowMs } = useSlowState(store, REFRESH_MS);
  const [sorting, setSorting] = useState<Sorting>({ column: "id", down: false });
  const filter = useStore(store, (now) => now.search);
  useStore(store, (now) => now.unfolded);
  const [grouping, setGrouping] = useState<Grouping>("none");
  const [choices, setChoices] = useState(recalledChoices);
  const choose = (change: Partial<TableChoices>): void => {
    const chosen = { ...choices, ...change };
    keepChoices(chosen);
    setChoices(chosen);
  };
  const [cursor, setCursor] = useState<string | null>(null);
  const box = useRef<HTMLDivElement>(null);
  const field = useRef<HTMLInputElement>(null);
  const narrow = useNarrow();
  const rowPx = narrow ? TOUCH_ROW_PX : ROW_PX;
  const window = useWindow(box, rowPx);
  useWindowEvent("keydown", (event) => {
    if (event.key !== "/" || isTextField(event.target)) return;
    event.preventDefault();
    field.current?.focus();
  });

  const now_s = serverNowS(state, nowMs);
  const large = state.counts !== null;
  // a brief is no row: of a large fleet the server sends in full what is unfolded, or what the filter finds
  const found = sorted([...state.vehicles.values()].filter((vehicle) => vehicle.brief !== true && matches(vehicle, filter, now_s)), sorting, now_s, state, choices.problemsFirst);
  const bySite = grouping === "site" || (large && grouping === "none");
  const rows: (Row | SiteRow)[] = bySite ? siteRows(state, found, now_s) : rowsOf(found, grouping);
  const offered = COLUMNS.filter(({ when }) => when === undefined || [...state.vehicles.values()].some(when));
  const columns = narrow ? COLUMNS.filter((column) => column.narrow) : offered.filter((column) => isChosen(choices, column));
  const names = rows.flatMap((row) => (row.kind === "vehicle" ? [row.vehicle.name] : []));
  const shown = rows.slice(window.first, window.first + window.count);

  const pick = (name: string, event: { shiftKey: boolean; ctrlKey: boolean; metaKey: boolean }): void => {
    if (event.shiftKey && cursor !== null && names.includes(cursor)) {
      const [from, to] = [names.indexOf(cursor), names.indexOf(name)].sort((a, b) => a - b);
      store.dispatch({ type: "select", names: names.slice(Math.max(from ?? 0, 0), (to ?? 0) + 1), how: "add" });
    } else {
      store.dispatch({ type: "select", names: [name], how: narrow || event.ctrlKey || event.metaKey ? "toggle" : "only" });
    }
    setCursor(name);
  };

  const onKey = (event: KeyboardEvent): void => {
    const step = { ArrowDown: 1, ArrowUp: -1, PageDown: 10, PageUp: -10, Home: -Infinity, End: Infinity }[event.key];
    if (step !== undefined && names.length > 0) {
      event.preventDefault();
      const at = cursor === null ? -1 : names.indexOf(cursor);
      const next = names[Math.min(Math.max(at + step, 0), names.length - 1)];
      if (next === undefined) return;
      setCursor(next);
      store.dispatch({ type: "select", names: [next], how: event.shiftKey ? "add" : "only" });
      scrollTo(box.current, rows.findIndex((row) => row.kind === "vehicle" && row.vehicle.name === next), rowPx);
    } else if (event.key === " " && cursor !== null) {
      event.preventDefault();
      store.dispatch({ type: "select", names: [cursor], how: "toggle" });
    }
  };

  const empty = state.vehicles.size === 0;
  const all = names.length > 0 && names.every((name) => state.selection.has(name));
  return (
    <div class="fleettable" data-narrow={narrow}>
      <div class="tabletools" hidden={empty}>
        <label class="check" title="Select all that are shown">
          <input type="checkbox" checked={all} aria-label="Select all that are shown"
            onChange={() => store.dispatch({ type: "select", names: all ? [] : names, how: "only" })} />
        </label>
        <input ref={field} type="search" placeholder="Filter: name, group, mode, armed, silent …" aria-label="Filter vehicles" value={filter}
          onInput={(event) => store.dispatch({ type: "search", search: event.currentTarget.value })} />
        <select class="grouping" aria-label="Group by" value={bySite ? "site" : grouping} onChange={(event) => setGrouping(event.currentTarget.value as Grouping)}>
          {!large && <option value="none">Not grouped</option>}
          {(large || state.sites.length > 1) && <option value="site">By site</option>}
          <option value="group">By group</option>
          <option value="autopilot">By autopilot</option>
          <option value="mode">By mode</option>
        </select>
        <Check class="check problemsfirst" title="Vehicles in trouble stand above all others" checked={choices.problemsFirst} onChecked={(problemsFirst) => choose({ problemsFirst })}>Problems first</Check>
        {!narrow && <ColumnMenu offered={offered} choices={choices} choose={choose} />}
        <span class="muted count">{state.selection.size > 0 ? `${state.selection.size} of ${state.names.length} selected` : bySite && names.length === 0 ? `${state.names.length} vehicles` : `${names.length} shown`}</span>
      </div>
      <div ref={box} class="tablebox" tabIndex={0} onKeyDown={onKey} role="region" aria-label="Vehicles">
        <table hidden={empty} aria-rowcount={rows.length + 1} aria-multiselectable="true" role="grid">
          <thead><tr>{columns.map((column) => <Heading key={column.id} column={column} sorting={sorting} sort={setSorting} />)}</tr></thead>
          <tbody>
            <Spacer rows={window.first} rowPx={rowPx} />
            {shown.map((row, i) =>
              row.kind === "site" ? (
                <SiteHeading key={`/${row.counts.site}`} row={row} width={columns.length} own={state.daemon?.site ?? null} store={store} />
              ) : row.kind === "group" ? <GroupRow key={`:${row.title}`} row={row} width={columns.length} store={store} /> : (
                <VehicleRow key={row.vehicle.name} vehicle={row.vehicle} columns={columns} now_s={now_s} around={state} index={window.first + i}
                  selected={state.selection.has(row.vehicle.name)} cursor={cursor === row.vehicle.name} narrow={narrow} pick={pick} />
              ),
            )}
            <Spacer rows={Math.max(rows.length - window.first - shown.length, 0)} rowPx={rowPx} />
          </tbody>
        </table>
        {state.leftOut > 0 && <p class="note">{state.leftOut} more are not listed: that would be too many. Fold a site, or filter.</p>}
        {empty && <EmptyFleet store={store} connection={connection} />}
        {rows.length === 0 && !empty && <p class="note">No vehicle matches the filter.</p>}
      </div>
    </div>
  );
}

/** Which columns are shown: all but the name are a choice. */
function ColumnMenu({ offered, choices, choose }: { offered: readonly Column[]; choices: TableChoices; choose: (change: Partial<TableChoices>) => void }) {
  const menu = useRef<HTMLDetailsElement>(null);
  const [open, setOpen] = useState(false);
  const close = (outside: boolean): void => { if (outside) menu.current?.removeAttribute("open"); };
  useWindowEvent("pointerdown", ({ target }) => close(target instanceof Node && menu.current?.contains(target) === false));
  useWindowEvent("keydown", ({ key }) => close(key === "Escape"));
  return (
    <details ref={menu} class="columnmenu" onToggle={(event) => setOpen(event.currentTarget.open)}>
      <summary>Columns</summary>
      {open && <div class="choices" role="group" aria-label="Columns of the table">
        {offered.filter(({ id }) => id !== "name").map((column) => (
          <Check key={column.id} class="" checked={isChosen(choices, column)} onChecked={(on) => choose({ columns: { ...choices.columns, [column.id]: on } })}>{column.title}</Check>
        ))}
        <button type="button" onClick={() => choose({ columns: {} })}>As at first</button>
      </div>}
    </details>
  );
}

function Heading({ column, sorting, sort }: { column: Column; sorting: Sorting; sort: (to: Sorting) => void }) {
  const now = sorting.column === column.id;
  return (
    <th scope="col" class={column.numeric ? "num" : ""} data-column={column.id} aria-sort={now ? (sorting.down ? "descending" : "ascending") : undefined}>
      <button type="button" onClick={() => sort({ column: column.id, down: now && !sorting.down })}>
        {column.title}
        <span class="arrow" aria-hidden="true">{now ? (sorting.down ? "▾" : "▴") : ""}</span>
      </button>
    </th>
  );
}

function Spacer({ rows, rowPx }: { rows: number; rowPx: number }) {
  return rows === 0 ? null : <tr aria-hidden="true" class="spacer" style={{ height: `${rows * rowPx}px` }} />;
}

function GroupRow({ row, width, store }: { row: Extract<Row, { kind: "group" }>; width: number; store: Store }) {
  return (
    <tr class="grouprow">
      <th colSpan={width} scope="colgroup">
        <button type="button" onClick={() => store.dispatch({ type: "select", names: row.names, how: "only" })} title="Select this group">
          {row.title} <span class="muted">{row.names.length}</span>
        </button>
      </th>
    </tr>
  );
}

function SiteHeading({ row, width, own, store }: { row: SiteRow; width: number; own: string | null; store: Store }) {
  const { site, vehicles, heard, armed, in_air, problems, oldest_age_s } = row.counts;
  const title = site || (own ?? "This site");
  const age = oldest_age_s === null || !Number.isFinite(oldest_age_s) ? "one never heard" : `oldest ${ageText(oldest_age_s)}`;
  return (
    <tr class="grouprow siterow" data-site={site}>
      <th colSpan={width} scope="colgroup">
        <button type="button" aria-expanded={row.unfolded} title={row.unfolded ? "Fold" : "Unfold"} onClick={() => store.dispatch({ type: "unfold", site })}>
          <span aria-hidden="true">{row.unfolded ? "▾" : "▸"}</span> {title}
        </button>
        <span class="muted">{heard === vehicles ? vehicles : `${heard} of ${vehicles}`} heard, {armed} armed, {in_air} in the air, {age}</span>
        {problems > 0 && (
          <button type="button" class="problems" title="List them" onClick={() => store.dispatch({ type: "search", search: `${site && `${site}/ `}problem` })}>
            {problems} {problems === 1 ? "problem" : "problems"}
          </button>
        )}
        <button type="button" class="muted" title={`Select ${row.names.length} vehicles`} onClick={() => store.dispatch({ type: "select", names: row.names, how: "only" })}>Select</button>
      </th>
    </tr>
  );
}

interface VehicleRowProps {
  vehicle: Vehicle;
  columns: readonly Column[];
  now_s: number;
  around: Surroundings;
  index: number;
  selected: boolean;
  cursor: boolean;
  narrow: boolean;
  pick: (name: string, event: MouseEvent) => void;
}

function VehicleRow({ vehicle, columns, now_s, around, index, selected, cursor, narrow, pick }: VehicleRowProps) {
  const heard = isHeard(vehicle, now_s);
  return (
    <tr class="row" data-name={vehicle.name} data-heard={heard} data-severity={troubleOf(vehicle, now_s)?.severity} data-cursor={cursor} aria-selected={selected} aria-rowindex={index + 2}
      onClick={(event) => pick(vehicle.name, event)}>
      {columns.map((column) => <CellOf key={column.id} column={column} cell={column.cell(vehicle, now_s, around)} heard={heard} narrow={narrow} />)}
    </tr>
  );
}

function CellOf({ column, cell, heard, narrow }: { column: Column; cell: Cell; heard: boolean; narrow: boolean }) {
  // of a vehicle that is not heard nothing is a good value any more; only that, and since when
  const ofNow = heard || column.ofNow === true;
  const tone = ofNow ? cell.tone : "lost";
  const title = ofNow ? (cell.title ?? (column.id === "status" ? cell.text : undefined)) : "Not heard: this was the last value";
  return <td class={`${column.numeric ? "num " : ""}${tone}`} data-column={column.id} title={title}>{narrow ? (cell.narrow ?? cell.text) : cell.text}{narrow && cell.under !== undefined && <span class="under">{cell.under}</span>}</td>;
}

/** The rows that are seen, and some around them. */
function useWindow(box: { current: HTMLDivElement | null }, rowPx: number): { first: number; count: number } {
  const [seen, setSeen] = useState({ first: 0, count: 40 });
  useLayoutEffect(() => {
    const element = box.current;
    if (element === null) return undefined;
    const measure = (): void => {
      const first = Math.max(Math.floor(element.scrollTop / rowPx) - OVERSCAN, 0);
      const count = Math.ceil(element.clientHeight / rowPx) + 2 * OVERSCAN;
      setSeen((before) => (before.first === first && before.count === count ? before : { first, count }));
    };
    const observer = new ResizeObserver(measure);
    observer.observe(element);
    element.addEventListener("scroll", measure, { passive: true });
    measure();
    return () => {
      observer.disconnect();
      element.removeEventListener("scroll", measure);
    };
  }, [box, rowPx]);
  return seen;
}

function scrollTo(box: HTMLDivElement | null, index: number, rowPx: number): void {
  if (box === null || index < 0) return;
  const top = index * rowPx;
  const head = box.querySelector("thead")?.clientHeight ?? 0;
  if (top < box.scrollTop) box.scrollTop = top;
  else if (top + rowPx > box.scrollTop + box.clientHeight - head) box.scrollTop = top + rowPx - box.clientHeight + head;
}

/** Upright, or lying on its side. */
const NARROW = "(max-width: 760px), (max-height: 500px)";

/** Whether the page is shown on a phone. */
function useNarrow(): boolean {
  const [narrow, setNarrow] = useState(() => matchMedia(NARROW).matches);
  useEffect(() => {
    const media = matchMedia(NARROW);
    const onChange = (): void => setNarrow(media.matches);
    media.addEventListener("change", onChange);
    return () => media.removeEventListener("change", onChange);
  }, []);
  return narrow;
}
