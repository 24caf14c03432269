// Orders to vehicles: what they are, how each is sent, and what is said of it. An order is sent once.

import { type Connection, ConnectionLost, ORDER_DEADLINE_S, RpcError, STOP_DEADLINE_S } from "./connection.ts";
import { siteOf } from "./levels.ts";
import { isUnknown, lost, outcomeOf, stateOf } from "./outcomes.ts";
import type { OrderRun, OrderState, Store } from "./store.ts";
import type { Method, Outcome, Params, Results, SiteAnswer } from "./types.ts";

export interface OrderRequest<M extends Method = Method> {
  /** As a person reads it: "Take off to 10 m". */
  label: string;
  method: M;
  params: Omit<Params[M], "targets">;
  /** Vehicles that it is for, or null: all that the daemon knows. */
  targets: readonly string[] | null;
  /** Another way to say who: all vehicles of all sites, be they known here or not. */
  to?: string;
  withinS?: number;
  /** It is a step of it: not sent once the chain has ended. Any other order ends the chains of its vehicles. */
  chain?: OrderChain | undefined;
}

type OrderStore = Pick<Store, "state" | "dispatch">;
type Sender = Pick<Connection, "order">;

const STOP_METHOD = "vehicles.stop";

let nextId = 1;

/** Questions at once: a page has 16 requests without an answer, and other parts of it ask, too. */
const ASKED_AT_ONCE = 4;

/** What an answer says of each vehicle, or of the fleet as a whole, in the terms of the list of orders. */
export type Reader<T> = (answer: T) => { state: OrderState; outcomes: Outcomes; text: string | null };

type Outcomes = Readonly<Record<string, Outcome>>;

/** Of an order whose answer has an outcome for each vehicle, or says by coming that it was carried out. */
function readOutcomes(answer: unknown): ReturnType<Reader<unknown>> {
  const { outcomes = {} } = (answer ?? {}) as { outcomes?: Outcomes };
  return { state: stateOf(outcomes), outcomes, text: null };
}

/** Sends an order and keeps its course in the store: its answer, or null. Never rejects: what went wrong is the order's
 *  state, which `ended` is called with. */
export async function runOrder<M extends Method>(
  store: OrderStore,
  connection: Sender,
  request: { label: string; method: M; params: Params[M]; targets: readonly string[]; withinS?: number | undefined; chain?: OrderChain | undefined },
  read: Reader<Results[M]> = readOutcomes,
  ended: (state: OrderState) => void = () => undefined,
): Promise<Results[M] | null> {
  const { label, method, targets, chain } = request;
  if (chain === undefined) takeOver(targets);
  else if (!chain.goesOn) {
    ended("failed");
    return null;
  }
  const id = nextId++;
  store.dispatch({
    type: "orderBegun",
    order: { id, label, method, targets, startedMs: performance.now(), endedMs: null, state: "pending", outcomes: {}, error: null },
  });
  const end = (state: OrderState, outcomes: Outcomes, error: string | null): void => {
    store.dispatch({ type: "orderEnded", id, atMs: performance.now(), state, outcomes, error });
    ended(state);
  };
  try {
    const answer = await connection.order(method, request.params, request.withinS ?? ORDER_DEADLINE_S, ({ vehicles = [], vehicle, outcome }) => {
      const outcomes = vehicle === undefined || outcome === undefined ? {} : { [vehicle]: outcome };
      store.dispatch({ type: "orderReported", id, vehicles, outcomes });
    });
    const { state, outcomes, text } = read(answer);
    end(state, outcomes, text);
    return answer;
  } catch (error) {
    end(error instanceof ConnectionLost ? "unknown" : "failed", {}, refusalText(error));
    return null;
  }
}

/** Sends an order that is for vehicles. */
export async function sendOrder<M extends Method>(store: OrderStore, connection: Sender, request: OrderRequest<M>): Promise<OrderState> {
  const { label, method, withinS, chain } = request;
  const params = { targets: request.to ?? (request.targets === null ? "all" : [...request.targets]), ...request.params } as Params[M];
  let state: OrderState = "pending";
  await runOrder(store, connection, { label, method, params, targets: request.targets ?? store.state.names, withinS, chain }, readOutcomes, (now) => { state = now; });
  return state;
}

export function isStop(order: Pick<OrderRun, "method">): boolean {
  return order.method === STOP_METHOD;
}

/** STOP: all vehicles hold where they are, by every link. Those of other sites get it as an order of their own: ours wait
 *  for no hub. */
export function sendStop(store: Store, connection: Connection): void {
  const { names, sites } = store.state;
  // the board shows the newest press
  for (const order of store.state.orders) if (isStop(order) && order.dismissed !== true) store.dispatch({ type: "orderDismissed", id: order.id });
  const stop = { method: STOP_METHOD as typeof STOP_METHOD, params: {}, withinS: STOP_DEADLINE_S };
  const others = names.filter((name) => siteOf(name) !== "");
  const ours = others.length === 0 ? null : names.filter((name) => siteOf(name) === "");
  if (ours === null || ours.length > 0) void sendOrder(store, connection, { ...stop, label: "STOP all", targets: ours, to: "all" });
  if (others.length > 0) void sendOrder(store, connection, { ...stop, label: `STOP all of ${sites.filter(Boolean).join(", ")}`, targets: others, to: "*/all" });
}

/** Asks the sites of these vehicles what became of an order whose answers were lost, and keeps it with the order. Nothing
 *  is ordered by it. Never rejects: what went wrong is said with the outcome, which can be asked for again. */
export async function askOutcomes(store: OrderStore, connection: Sender, order: OrderRun, names: readonly string[]): Promise<void> {
  const waiting = names.flatMap((name) => {
    const outcome = order.outcomes[name];
    return outcome !== undefined && isUnknown(outcome) && outcome.id !== undefined ? [[name, outcome.id] as const] : [];
  });
  const found: Record<string, Outcome> = {};
  const askInTurn = async (): Promise<void> => {
    for (let next = waiting.shift(); next !== undefined; next = waiting.shift()) {
      const [name, id] = next;
      try {
        found[name] = outcomeOf(await connection.order<SiteAnswer>("federation.outcome", { id }));
      } catch (error) {
        found[name] = lost(id, `outcome unknown, and not asked for: ${refusalText(error)}`);
      }
    }
  };
  await Promise.all(Array.from({ length: ASKED_AT_ONCE }, askInTurn));
  store.dispatch({ type: "outcomesFound", id: order.id, atMs: performance.now(), outcomes: found });
}

export function refusalText(error: unknown): string {
  if (error instanceof RpcError) return error.message;
  return error instanceof Error ? error.message : String(error);
}

const owners = new Map<string, OrderChain>();

export class OrderChain {
  constructor(readonly targets: readonly string[]) {
    takeOver(targets);
    for (const name of targets) owners.set(name, this);
  }

  /** No newer chain and no other order was for one of its vehicles. */
  get goesOn(): boolean {
    return this.targets.length > 0 && this.targets.every((name) => owners.get(name) === this);
  }

  /** No further step is sent. Idempotent. */
  end(): void {
    for (const name of this.targets) if (owners.get(name) === this) owners.delete(name);
  }
}

/** A newer order for these vehicles ends, as a whole, each chain that owns one of them. */
export function takeOver(targets: readonly string[]): void {
  for (const name of targets) owners.get(name)?.end();
}
