// What the parts of the orders' panel share.

import { namesText } from "./format.ts";
import { FRAME_UNKNOWN } from "./framed.ts";
import { useFrameKnown, useStore } from "./hooks.ts";
import { fullName } from "./levels.ts";
import type { OrderRequest } from "./orders.ts";
import type { PanelProps } from "./panels/registry.ts";
import type { OrderState } from "./store.ts";

export interface ButtonsProps extends PanelProps {
  targets: readonly string[];
  enabled: boolean;
  send: (request: Omit<OrderRequest, "targets">) => Promise<OrderState>;
}

/** Who an order is for, each with its site where there are several. */
export function useTargetsText({ store, targets }: Pick<ButtonsProps, "store" | "targets">): string {
  useStore(store, (state) => state.daemon?.site);
  return namesText(targets.map((name) => fullName(store.state, name)));
}

export function Key({ letter }: { letter: string }) {
  return <kbd aria-hidden="true">{letter}</kbd>;
}

/** Why no place can be sent now, if that is so. */
export function FrameNote({ store }: Pick<ButtonsProps, "store">) {
  const orders = useStore(store, (state) => state.phase.kind === "open" && state.daemon?.connected === true);
  return useFrameKnown(store) || !orders ? null : <p class="note" role="status">{FRAME_UNKNOWN}</p>;
}
