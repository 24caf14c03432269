// The panels of the page, in the order of their tabs. See registry.ts.

import type { Store } from "../store.ts";
import { alarmLog, beginAlarms } from "./alarm_log.ts";
import { beginHistories } from "./histories.ts";
import type { Panel } from "./registry.ts";
import { beginSound, playAlarm, speak } from "./sound.ts";

export const PANELS: readonly Panel[] = [
  { id: "replay", title: "Replay", place: "dock", when: (state) => state.hello?.replay === true, load: () => import("./replay_panel.tsx") },
  { id: "vehicle", title: "Vehicle", place: "side", load: () => import("./vehicle_panel.tsx") },
  { id: "mission", title: "Missions", place: "side", when: (state) => state.hello?.replay !== true, load: () => import("./mission_panel.tsx") },
  { id: "plan", title: "Plans", place: "side", when: (state) => state.hello?.replay !== true, load: () => import("./plan_panel.tsx") },
  { id: "preflight", title: "Preflight", place: "page", when: (state) => state.hello?.replay !== true, load: () => import("./fleet_preflight.tsx") },
  { id: "radio", title: "Radio", place: "page", when: (state) => state.hello?.replay !== true, load: () => import("./radio_panel.tsx") },
  { id: "recordings", title: "Recordings", place: "page", when: (state) => state.hello?.replay !== true && state.daemon?.recordings === true, load: () => import("./recordings_panel.tsx") },
  { id: "events", title: "Events", place: "page", load: () => import("./events_panel.tsx"), badge: () => alarmLog.open },
];

/** What goes on whether a panel is shown or not: histories and alarms. Returns what ends it. */
export function beginPanels(store: Store): () => void {
  beginSound();
  const undo = [beginHistories(store), beginAlarms(store, playAlarm, speak)];
  return () => undo.forEach((each) => each());
}
