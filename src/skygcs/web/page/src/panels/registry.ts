// How a panel joins the page: one entry in `PANELS` of index.ts, and a module that exports its component as `default`, which
// components.ts names.

import type { Connection } from "../connection.ts";
import type { State, Store } from "../store.ts";
import type { FleetView } from "../view/fleet_view.ts";

export interface PanelProps {
  store: Store;
  connection: Connection;
  /** The canvas: overlays, tools, what is seen. */
  view: FleetView;
}

export interface Panel {
  /** Part of the address after #. */
  id: keyof typeof import("./components.ts");
  title: string;
  /** `side`: a tab beside the fleet view; `page`: instead of it; `dock`: a strip below the top bar while `when` holds. */
  place: "side" | "page" | "dock";
  /** Shown only while it holds. */
  when?: (state: State) => boolean;
  /** A number beside the title, 0 for none: what waits for a person. */
  badge?: (state: State) => number;
}
