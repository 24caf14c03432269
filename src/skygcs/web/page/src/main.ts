// Entry: joins connection, store and page.

import { h, render } from "preact";
import { App } from "./app.tsx";
import { Connection } from "./connection.ts";
import { beginPanels } from "./panels/index.ts";
import { beginSession } from "./session.ts";
import { Store } from "./store.ts";
import { beginTheme } from "./theme.ts";

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

// Only a person's own input is reported as such; the browser marks it.
for (const kind of ["pointerdown", "keydown", "wheel", "touchstart"] as const) {
  addEventListener(kind, (event) => connection.personActive(event), { capture: true, passive: true });
}
// The browser woke up or the network came back: no need to wait for the back-off.
addEventListener("online", () => connection.retryNow());
document.addEventListener("visibilitychange", () => {
  if (document.visibilityState === "visible") connection.retryNow();
});
