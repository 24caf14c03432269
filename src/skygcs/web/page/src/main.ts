// Entry: joins connection, store and page.

import { h, render } from "preact";
import { App } from "./app.tsx";
import { Connection } from "./connection.ts";
import { beginPanels } from "./panels/index.ts";
import { beginSession } from "./session.ts";
import { Store } from "./store.ts";
import { beginTheme } from "./theme.ts";

/** A jump of the wall clock that is no adjustment of a running clock. */
const SLEPT_MS = 2_000;

const store = new Store();
const address = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`;
const connection = new Connection(address);

beginTheme();
const root = document.getElementById("page");
if (root !== null) {
  root.replaceChildren();
  render(h(App, { store, connection }), root);
}
beginPanels(store);
beginSession(connection, store, () => performance.now());

// Only a person's own input is reported as such: the browser marks it, and a key that something lies on repeats itself.
for (const kind of ["pointerdown", "keydown", "wheel", "touchstart"] as const) {
  addEventListener(kind, (event) => connection.personActive(event), { capture: true, passive: true });
}
// A computer that sleeps stops performance.now, but not the wall clock: ages count the sleep, and the connection is made anew.
let offsetMs = Date.now() - performance.now();
setInterval(() => {
  const sleptMs = Date.now() - performance.now() - offsetMs;
  offsetMs += sleptMs;
  if (sleptMs < SLEPT_MS) return;
  store.dispatch({ type: "slept", ms: sleptMs });
  connection.restart("this computer slept");
}, 500);
// The browser woke up or the network came back: no need to wait for the back-off.
addEventListener("online", () => connection.retryNow());
document.addEventListener("visibilitychange", () => {
  if (document.visibilityState === "visible") connection.retryNow();
});
