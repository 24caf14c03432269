// The panels of the page, in the order of their tabs. See registry.ts.

import type { Store } from "../store.ts";
import { alarmLog, beginAlarms } from "./alarm_log.ts";
import { beginHistories } from "./histories.ts";
import type { Panel } from "./registry.ts";
import { beginSound, playAlarm, speak } from "./sound.ts";

export const PANELS: readonly Panel[] = [
  { id: "replay", title: "Replay", place: "dock", when: (state) => state.hello?.replay === true },
  { id: "vehicle", title: "Vehicle", place: "side" },
  { id: "mission", title: "Missions", place: "side", when: (state) => state.hello?.replay !== true },
  { id: "plan", title: "Plans", place: "side", when: (state) => state.hello?.replay !== true },
  { id: "preflight", title: "Preflight", place: "page", when: (state) => state.hello?.replay !== true },
  { id: "radio", title: "Radio", place: "page", when: (state) => state.hello?.replay !== true },
  { id: "recordings", title: "Recordings", place: "page", when: (state) => state.hello?.replay !== true && state.daemon?.recordings === true },
  { id: "events", title: "Events", place: "page", badge: () => alarmLog.open },
];

/** What goes on whether a panel is shown or not: histories and alarms. Returns what ends it. */
export function beginPanels(store: Store): () => void {
  beginSound();
  const undo = [beginHistories(store), beginAlarms(store, playAlarm, speak)];
  return () => undo.forEach((each) => each());
}
