// What the parts of the orders' panel share.

import { namesText } from "./format.ts";
import { useStore } from "./hooks.ts";
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
