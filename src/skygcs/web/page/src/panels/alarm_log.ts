// The events with their severity, what a person has acknowledged, and when the alarm sounds.

import { Changes } from "../hooks.ts";
import type { Action, NumberedEvent, State, Store } from "../store.ts";
import { recall, remember } from "../theme.ts";
import type { FleetEvent } from "../types.ts";
import { keyOf, spokenText } from "./event_severity.ts";

/** What happened longer before the page was opened is history: shown, and not open. */
export const FRESH_S = 300;
/** How long an alarm sounds that nobody acknowledges. */
export const SOUNDS_S = 60;
export const SOUND_EVERY_MS = 4_000;
/** Alarms that come within it are said as one. */
const SPOKEN_AFTER_MS = 700;
const MUTED = "skygcs.muted";
const SPEECH = "skygcs.speech";

export class AlarmLog extends Changes {
  events: readonly NumberedEvent[] = [];
  acknowledged: ReadonlySet<string> = new Set();
  /** Both are off until a person wants them: a page on a projector or in a meeting must not begin to sound. */
  muted = recalled(MUTED) !== "no";
  speech = recalled(SPEECH) === "yes";
  /** Alarms that are to be said. */
  private unsaid: NumberedEvent[] = [];
  private first = true;
  private soundsUntilMs = -Infinity;

  constructor(private readonly nowMs: () => number = () => performance.now()) { super(); }

  /** Alarms that nobody has acknowledged. */
  get open(): number {
    return this.events.filter((event) => event.severity === "alarm" && !this.acknowledged.has(keyOf(event))).length;
  }

  /** True while the alarm is to be heard. */
  get sounding(): boolean {
    return !this.muted && this.open > 0 && this.nowMs() < this.soundsUntilMs;
  }

  take(action: Action, state: State, unix_s: number): void {
    if (action.type === "event") {
      const event = state.events.at(-1);
      if (event === undefined) return;
      this.events = state.events;
      if (event.severity === "alarm") {
        this.soundsUntilMs = this.nowMs() + SOUNDS_S * 1000;
        if (this.speech) this.unsaid.push(event);
      }
      this.changed();
    } else if (action.type === "recentEvents") {
      this.anew(state, unix_s);
    }
  }

  acknowledge(events: readonly FleetEvent[]): void {
    this.keep(new Set([...this.acknowledged, ...events.map(keyOf)]));
  }

  acknowledgeAll(): void {
    this.acknowledge(this.events);
  }

  setMuted(muted: boolean): void {
    this.muted = muted;
    remember(MUTED, muted ? "yes" : "no");
    this.changed();
  }

  setSpeech(speech: boolean): void {
    this.speech = speech;
    remember(SPEECH, speech ? "yes" : "no");
    this.changed();
  }

  /** What is to be said now, once; "" for nothing. */
  takeSpoken(): string {
    const text = spokenText(this.unsaid);
    this.unsaid = [];
    return text;
  }

  /** The list after a new connection. */
  private anew(state: State, unix_s: number): void {
    this.events = state.events;
    const old = this.first ? this.events.filter((event) => unix_s - event.time_unix_s > FRESH_S) : [];
    this.first = false;
    this.keep(new Set([...this.acknowledged, ...old.map(keyOf)]));
  }

  /** Acknowledgements of events that are listed; of others nobody asks again. */
  private keep(keys: ReadonlySet<string>): void {
    const listed = new Set(this.events.map(keyOf));
    this.acknowledged = new Set([...keys].filter((key) => listed.has(key)));
    this.changed();
  }
}

function recalled(key: string): string | null {
  return typeof window === "undefined" ? null : recall(key);
}

/** One for the page. */
export const alarmLog = new AlarmLog();

/** Judges events from now on, sounds alarms and says them; returns what ends it. */
export function beginAlarms(store: Store, sound: () => void, say: (text: string) => void): () => void {
  let saying: ReturnType<typeof setTimeout> | undefined;
  const undo = store.onAction((action, state) => {
    const before = alarmLog.sounding;
    alarmLog.take(action, state, Date.now() / 1000);
    if (alarmLog.sounding && !before) sound();
    if (action.type === "event" && alarmLog.speech && saying === undefined) {
      saying = setTimeout(() => {
        saying = undefined;
        say(alarmLog.takeSpoken());
      }, SPOKEN_AFTER_MS);
    }
  });
  const timer = setInterval(() => {
    if (alarmLog.sounding) sound();
  }, SOUND_EVERY_MS);
  return () => {
    undo();
    clearTimeout(saying);
    clearInterval(timer);
  };
}
