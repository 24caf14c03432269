// All events in one list: severity, filter, acknowledgement, and the sound for what needs a person.

import { Fragment } from "preact";
import { useReducer, useState } from "preact/hooks";
import { timeText, toggled } from "../format.ts";
import { refusalText } from "../orders.ts";
import type { Alarm } from "../types.ts";
import { useChanges, useStore } from "../hooks.ts";
import { alarmLog } from "./alarm_log.ts";
import { type EventGroup, grouped, groupText, keyOf, manyText, SEVERITIES, type Severity, shownEvents } from "./event_severity.ts";
import type { PanelProps } from "./registry.ts";
import { canSound, ownVoice, playAlarm, speak } from "./sound.ts";

const NAMES: Readonly<Record<Severity, string>> = { alarm: "Alarms", warning: "Warnings", info: "Reports" };
const NAME: Readonly<Record<Severity, string>> = { alarm: "alarm", warning: "warning", info: "report" };
const SHOWN = 300;

export default function EventsPanel({ store, connection }: PanelProps) {
  useChanges(alarmLog);
  const selection = useStore(store, (state) => state.selection);
  const [severities, setSeverities] = useState<ReadonlySet<Severity>>(new Set(SEVERITIES));
  const [words, setWords] = useState("");
  const [open, setOpen] = useState(false);
  const [selected, setSelected] = useState(false);
  const [unfolded, setUnfolded] = useState<ReadonlySet<string>>(new Set());
  const vehicles = selected && selection.size > 0 ? selection : null;
  const rows = shownEvents(alarmLog.events, { severities, vehicles, words, open }, alarmLog.acknowledged);
  const groups = grouped(rows);
  const select = (names: readonly string[]): void => store.dispatch({ type: "select", names, how: "only" });
  const counts = new Map(SEVERITIES.map((one) => [one, alarmLog.events.filter((event) => event.severity === one).length]));
  return (
    <div class="panel eventspanel">
      <AlarmList store={store} connection={connection} />
      <div class="row wrap">
        {SEVERITIES.map((one) => (
          <button
            key={one}
            type="button"
            class="chip"
            data-severity={one}
            aria-pressed={severities.has(one)}
            onClick={() => setSeverities(toggled(severities, one))}
          >
            {NAMES[one]} <b>{counts.get(one)}</b>
          </button>
        ))}
        <button type="button" class="chip" aria-pressed={open} onClick={() => setOpen(!open)}>Not acknowledged</button>
        <button type="button" class="chip" aria-pressed={selected} disabled={selection.size === 0} onClick={() => setSelected(!selected)}>
          Selected vehicles
        </button>
        <input type="search" placeholder="Search events" aria-label="Search events" value={words} onInput={(event) => setWords(event.currentTarget.value)} />
        <span class="spacer" />
        <Sound />
        <button type="button" class={alarmLog.open > 0 ? "primary" : ""} disabled={alarmLog.open === 0} onClick={() => alarmLog.acknowledgeAll()}>
          Acknowledge all{alarmLog.open > 0 ? ` (${alarmLog.open})` : ""}
        </button>
      </div>
      <ul class="events" aria-label="Events, the newest first">
        {groups.slice(0, SHOWN).map((group) => {
          const key = keyOf(group.head);
          const open = unfolded.has(key);
          return (
            <Fragment key={key}>
              <EventRow group={group} open={open} select={select} toggle={() => setUnfolded(toggled(unfolded, key))} />
              {open && group.more.map((event) => <EventRow key={event.id} group={{ head: event, more: [], names: [] }} inner select={select} />)}
            </Fragment>
          );
        })}
      </ul>
      {rows.length === 0 && <p class="note">{alarmLog.events.length === 0 ? "Nothing has happened yet." : "No event passes the filter."}</p>}
      {groups.length > SHOWN && <p class="note">{groups.length - SHOWN} older ones; search for them.</p>}
    </div>
  );
}

/** The daemon's alarms: one for each cause, the same on every page, acknowledged once. */
function AlarmList({ store, connection }: Pick<PanelProps, "store" | "connection">) {
  const alarms = useStore(store, (state) => state.alarms);
  const mayOrder = useStore(store, (state) => state.hello?.role === "command");
  const [problem, setProblem] = useState<string | null>(null);
  if (alarms.length === 0) return null;
  const acknowledge = (number: number): void => {
    connection.order("alarms.acknowledge", { numbers: [number], by: "web page" }).then(() => setProblem(null), (error: unknown) => setProblem(refusalText(error)));
  };
  return (
    <section class="alarms" aria-label="Alarms of the daemon">
      {problem !== null && <p class="bad" role="alert">{problem}</p>}
      <ul>
        {alarms.map((alarm) => (
          <li key={alarm.number} data-severity={alarm.severity} data-open={alarm.acknowledged_by === null}>
            <time class="muted">{timeText(alarm.raised_unix_s)}</time> <b>{alarm.vehicle ?? "–"}</b> {alarm.kind}: {alarm.text}
            <span class="muted">{alarmNotes(alarm)}</span>
            {alarm.acknowledged_by === null && mayOrder && <button type="button" aria-label={`Acknowledge: ${alarm.vehicle ?? ""} ${alarm.kind}`} onClick={() => acknowledge(alarm.number)}>Acknowledge</button>}
          </li>
        ))}
      </ul>
    </section>
  );
}

/** "; over; 12 more followed from it; acknowledged by mia@field". */
function alarmNotes({ active, consequences, acknowledged_by }: Alarm): string {
  const followed = Object.values(consequences).reduce((sum, count) => sum + count, 0);
  const notes = [active ? "" : "over", followed > 0 ? `${followed} more followed from it` : "", acknowledged_by === null ? "" : `acknowledged by ${acknowledged_by}`];
  return notes.filter(Boolean).map((note) => `; ${note}`).join("");
}

interface RowProps {
  group: EventGroup;
  select: (names: readonly string[]) => void;
  /** Whether the others of the group are shown. */
  open?: boolean;
  toggle?: () => void;
  /** One of a group that is unfolded. */
  inner?: boolean;
}

function EventRow({ group, select, open = false, toggle, inner = false }: RowProps) {
  const { head, more, names } = group;
  const unseen = [head, ...more].filter((event) => event.severity === "alarm" && !alarmLog.acknowledged.has(keyOf(event)));
  const severity = SEVERITIES.find((one) => [head, ...more].some((event) => event.severity === one)) ?? "info";
  const targets = names.length > 0 ? names : head.vehicle === null ? [] : [head.vehicle];
  return (
    <li data-severity={severity} data-open={unseen.length > 0} data-inner={inner}>
      <time class="muted">{timeText(head.time_unix_s)}</time>
      <span class="severity">{NAME[severity]}</span>
      {targets.length === 0 ? <span class="who muted">–</span> : (
        <button type="button" class="link who" onClick={() => select(targets)}>{names.length > 0 ? manyText(group) : head.vehicle}</button>
      )}
      <span class="kind muted">{head.kind.replaceAll("_", " ")}</span>
      <span class="what">
        {groupText(group)}
        {more.length > 0 && toggle !== undefined && (
          <button type="button" class="link more" aria-expanded={open} onClick={toggle}>{open ? "fold" : names.length > 0 ? "each of them" : `${more.length} more`}</button>
        )}
      </span>
      {unseen.length > 0 && (
        <button type="button" onClick={() => alarmLog.acknowledge(unseen)}>
          {unseen.length > 1 ? `Acknowledge ${unseen.length}` : "Acknowledge"}
        </button>
      )}
    </li>
  );
}

function Sound() {
  const [, redraw] = useReducer((n: number) => n + 1, 0);
  return (
    <>
      <button type="button" aria-pressed={!alarmLog.muted} onClick={() => alarmLog.setMuted(!alarmLog.muted)}
        title={canSound() ? "Alarms sound until they are acknowledged" : "The browser allows sound after the first click or key on the page"}>
        {alarmLog.muted ? "Tones off" : "Tones on"}
      </button>
      <button type="button" aria-pressed={alarmLog.speech} onClick={() => alarmLog.setSpeech(!alarmLog.speech)}
        title={ownVoice() === null ? "This computer has no voice of its own" : "Each alarm is said once, by this computer's own voice"}>
        {alarmLog.speech ? "Speech on" : "Speech off"}
      </button>
      <button
        type="button"
        onClick={() => {
          playAlarm();
          if (alarmLog.speech) speak("So are alarms said");
          redraw(0);
        }}
      >
        Test sound
      </button>
    </>
  );
}
