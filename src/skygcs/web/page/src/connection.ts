// The WebSocket: JSON-RPC calls, orders with a deadline, notifications, and a new socket with back-off when one is lost.
// An order is sent once or not at all: what was pending when a socket was lost is reported as such, never sent again.

import type { Method, Outcome, OwnMethod, Params, Results } from "./types.ts";

export const FIRST_RETRY_MS = 500;
export const LONGEST_RETRY_MS = 5_000;
/** A socket on which nothing came for so long is dead: while a daemon is there, states come several times a second. */
export const SILENCE_MS = 8_000;
export const PING_MS = 3_000;
const OPENING_MS = 5_000;
const CALL_TIMEOUT_MS = 15_000;
/** From the press of a button to the daemon; later it would surprise. */
export const ORDER_DEADLINE_S = 3;
/** STOP is wanted late rather than never. */
export const STOP_DEADLINE_S = 10;
const ACTIVE_EVERY_MS = 1_000;

export class RpcError extends Error {
  readonly code: number;
  readonly data: unknown;

  constructor(code: number, message: string, data?: unknown) {
    super(message);
    this.name = "RpcError";
    this.code = code;
    this.data = data;
  }
}

/** The request was not sent: there is no connection. */
export class NotConnected extends Error {
  constructor() {
    super("not connected to the ground station: nothing was sent");
    this.name = "NotConnected";
  }
}

/** The request was sent, and the connection was lost before its answer: what became of it is not known. */
export class ConnectionLost extends Error {
  constructor() {
    super("unknown: connection lost before the answer; look at the vehicles");
    this.name = "ConnectionLost";
  }
}

export class NoAnswer extends Error {
  constructor(seconds: number) {
    super(`no answer within ${seconds} s`);
    this.name = "NoAnswer";
  }
}

export type Phase = { kind: "connecting" } | { kind: "open" } | { kind: "lost"; retryInMs: number; attempt: number; reason: string };

/** The part of WebSocket that is used, so that tests can play the server. */
export interface Socket {
  onopen: (() => void) | null;
  onmessage: ((event: { data: unknown }) => void) | null;
  onclose: ((event: { code: number; reason: string }) => void) | null;
  onerror: (() => void) | null;
  send(text: string): void;
  close(): void;
}

export interface Surroundings {
  open: (url: string) => Socket;
  nowMs: () => number;
  later: (run: () => void, ms: number) => () => void;
  random: () => number;
}

export const BROWSER: Surroundings = {
  open: (url) => new WebSocket(url) as unknown as Socket,
  nowMs: () => performance.now(),
  later: (run, ms) => {
    const timer = setTimeout(run, ms);
    return () => clearTimeout(timer);
  },
  random: () => Math.random(),
};

/** What is reported of an order under way: the vehicles that it goes to, or the outcome of one of them. */
export interface Report {
  request: number;
  vehicles?: readonly string[];
  vehicle?: string;
  outcome?: Outcome;
}

export type OnReport = (report: Report) => void;

interface Pending {
  resolve: (value: unknown) => void;
  reject: (error: Error) => void;
  cancelTimer: () => void;
  onReport: OnReport | undefined;
}

interface Incoming {
  id?: unknown;
  method?: unknown;
  params?: unknown;
  result?: unknown;
  error?: { code: number; message: string; data?: unknown };
}

export interface CallOptions {
  /** Null: wait as long as the connection lives. */
  timeoutMs?: number | null;
}

/** A time of the server and when it came: the server's clock at any later moment follows. */
export interface ClockSample {
  now_s: number;
  atMs: number;
}

export class Connection {
  phase: Phase = { kind: "connecting" };
  clock: ClockSample | null = null;
  private socket: Socket | null = null;
  private open = false;
  private ended = false;
  private attempt = 0;
  private nextId = 1;
  private heardAtMs = 0;
  private activeAtMs = -Infinity;
  private readonly pending = new Map<number, Pending>();
  private readonly handlers = new Map<string, Set<(params: never) => void>>();
  private readonly phaseListeners = new Set<(phase: Phase) => void>();
  private cancelRetry: () => void = () => undefined;
  private cancelWatch: () => void = () => undefined;

  constructor(private readonly url: string, private readonly env: Surroundings = BROWSER) {}

  /** Connects, and again after each loss, until `end`. */
  begin(): void {
    this.ended = false;
    this.connect();
  }

  end(): void {
    this.ended = true;
    this.cancelRetry();
    this.cancelWatch();
    this.drop("closed");
  }

  /** The back-off is cut short: a person wants the connection now, or the browser came back. */
  retryNow(): void {
    if (this.phase.kind !== "lost" || this.ended) return;
    this.cancelRetry();
    this.connect();
  }

  /** Gives up a socket that cannot be trusted, and connects anew: the computer slept. */
  restart(reason: string): void {
    if (this.socket !== null) this.lost(this.socket, reason);
  }

  onPhase(listener: (phase: Phase) => void): () => void {
    this.phaseListeners.add(listener);
    return () => this.phaseListeners.delete(listener);
  }

  /** Notifications of the server by method; returns what ends it. */
  // eslint-disable-next-line @typescript-eslint/no-unnecessary-type-parameters -- the caller names what this method carries
  on<T>(method: string, handler: (params: T) => void): () => void {
    const known = this.handlers.get(method) ?? new Set();
    known.add(handler);
    this.handlers.set(method, known);
    return () => known.delete(handler);
  }

  /** A request that changes nothing. Rejects with RpcError, NotConnected, ConnectionLost or NoAnswer. */
  call<M extends Method>(method: M, params?: Params[M], options?: CallOptions): Promise<Results[M]>;
  call<T>(method: OwnMethod, params?: object, options?: CallOptions): Promise<T>;
  call(method: string, params: object = {}, options: CallOptions = {}): Promise<unknown> {
    return this.request({ method, params }, options.timeoutMs === undefined ? CALL_TIMEOUT_MS : options.timeoutMs);
  }

  /** A request that changes something: the server refuses it once `withinS` have passed. Sent once, never again.
   * `onReport` gets what becomes of each vehicle while the order is under way. */
  order<M extends Method>(method: M, params: Params[M], withinS?: number, onReport?: OnReport): Promise<Results[M]>;
  order<T>(method: OwnMethod, params: object, withinS?: number, onReport?: OnReport): Promise<T>;
  order(method: string, params: object, withinS = ORDER_DEADLINE_S, onReport?: OnReport): Promise<unknown> {
    const now_s = this.serverNowS();
    if (now_s === null) return Promise.reject(new NotConnected());
    const message = { method, params, deadline_s: round3(now_s + withinS) };
    return onReport === undefined ? this.request(message, null) : this.request({ ...message, report: true }, null, onReport);
  }

  /** Reports that a person touched the page: at most once a second, and only what the browser itself calls trusted. */
  personActive(event: Event): void {
    const now = this.env.nowMs();
    if (!event.isTrusted || ("repeat" in event && event.repeat === true) || !this.open || now - this.activeAtMs < ACTIVE_EVERY_MS) return;
    this.activeAtMs = now;
    this.socket?.send(JSON.stringify({ jsonrpc: "2.0", method: "operator.active" }));
  }

  /** The server's clock now; null until it was heard. */
  serverNowS(): number | null {
    return this.clock === null ? null : this.clock.now_s + (this.env.nowMs() - this.clock.atMs) / 1000;
  }

  private request(message: object, timeoutMs: number | null, onReport?: OnReport): Promise<unknown> {
    const socket = this.socket;
    if (!this.open || socket === null) return Promise.reject(new NotConnected());
    const id = this.nextId++;
    return new Promise((resolve, reject) => {
      const cancelTimer =
        timeoutMs === null
          ? () => undefined
          : this.env.later(() => {
              this.pending.delete(id);
              reject(new NoAnswer(timeoutMs / 1000));
            }, timeoutMs);
      this.pending.set(id, { resolve, reject, cancelTimer, onReport });
      try {
        socket.send(JSON.stringify({ jsonrpc: "2.0", id, ...message }));
      } catch {
        this.lost(socket, "cannot be written to");
      }
    });
  }

  private connect(): void {
    this.setPhase({ kind: "connecting" });
    let socket: Socket;
    try {
      socket = this.env.open(this.url);
    } catch {
      this.retryLater("the address cannot be opened");
      return;
    }
    this.socket = socket;
    this.clock = null;
    this.heardAtMs = this.env.nowMs();
    socket.onopen = () => {
      if (socket !== this.socket) return;
      this.open = true;
      this.heardAtMs = this.env.nowMs();
      this.setPhase({ kind: "open" });
    };
    socket.onmessage = (event) => {
      if (socket === this.socket) this.onText(event.data);
    };
    socket.onclose = (event) => this.lost(socket, event.reason || closeReason(event.code));
    socket.onerror = () => undefined; // a close follows
    this.watch(socket);
  }

  /** Ends a socket that is silent: TCP alone would take minutes to notice. */
  private watch(socket: Socket): void {
    this.cancelWatch();
    this.cancelWatch = this.env.later(() => {
      if (socket !== this.socket) return;
      const silentMs = this.env.nowMs() - this.heardAtMs;
      if (silentMs > (this.open ? SILENCE_MS : OPENING_MS)) {
        this.lost(socket, this.open ? "the ground station is silent" : "no answer");
        return;
      }
      if (this.open && silentMs > PING_MS) {
        this.call("web.ping").catch(() => undefined); // a loss is seen by the silence
      }
      this.watch(socket);
    }, 1_000);
  }

  private onText(data: unknown): void {
    this.heardAtMs = this.env.nowMs();
    if (typeof data !== "string") return;
    let message: Incoming;
    try {
      message = JSON.parse(data) as Incoming;
    } catch {
      return; // only our own server writes here; what it cannot mean is left out
    }
    if (typeof message.method === "string") {
      if (message.method === "order.begun" || message.method === "order.outcome") {
        this.takeReport(message.params as Report | undefined);
        return;
      }
      this.takeClock(message.params);
      for (const handler of this.handlers.get(message.method) ?? []) (handler as (params: unknown) => void)(message.params);
      return;
    }
    if (typeof message.id !== "number") return;
    const waiting = this.pending.get(message.id);
    if (waiting === undefined) return;
    this.pending.delete(message.id);
    waiting.cancelTimer();
    if (message.error === undefined) {
      this.takeClock(message.result);
      waiting.resolve(message.result);
    } else {
      waiting.reject(new RpcError(message.error.code, message.error.message, message.error.data));
    }
  }

  private takeReport(report: Report | undefined): void {
    if (typeof report?.request === "number") this.pending.get(report.request)?.onReport?.(report);
  }

  private takeClock(from: unknown): void {
    if (typeof from !== "object" || from === null) return;
    // trajectory.status has a now_s too: that of the daemon
    const { now_s, trajectories } = from as { now_s?: unknown; trajectories?: unknown };
    if (typeof now_s === "number" && trajectories === undefined) this.clock = { now_s, atMs: this.env.nowMs() };
  }

  private lost(socket: Socket, reason: string): void {
    if (socket !== this.socket) return;
    this.drop(reason);
    if (!this.ended) this.retryLater(reason);
  }

  private drop(reason: string): void {
    const socket = this.socket;
    this.socket = null;
    this.open = false;
    this.cancelWatch();
    const waiting = [...this.pending.values()];
    this.pending.clear();
    for (const one of waiting) {
      one.cancelTimer();
      one.reject(new ConnectionLost());
    }
    if (socket !== null) {
      socket.onopen = socket.onmessage = socket.onclose = socket.onerror = null;
      try {
        socket.close();
      } catch {
        // it never opened
      }
    }
    if (this.ended) this.setPhase({ kind: "lost", retryInMs: Infinity, attempt: 0, reason });
  }

  private retryLater(reason: string): void {
    this.attempt += 1;
    const full = Math.min(FIRST_RETRY_MS * 2 ** (this.attempt - 1), LONGEST_RETRY_MS);
    const retryInMs = Math.round(full * (0.8 + 0.4 * this.env.random()));
    this.setPhase({ kind: "lost", retryInMs, attempt: this.attempt, reason });
    this.cancelRetry = this.env.later(() => this.connect(), retryInMs);
  }

  /** The session works: the next loss is retried at once again. */
  settled(): void {
    this.attempt = 0;
  }

  private setPhase(phase: Phase): void {
    this.phase = phase;
    for (const listener of this.phaseListeners) listener(phase);
  }
}

function closeReason(code: number): string {
  if (code === 1009) return "a message was too long";
  if (code === 1008) return "refused by the ground station";
  if (code === 1013) return "the ground station has no place left: too many pages are open";
  return "the ground station cannot be reached";
}

function round3(value: number): number {
  return Math.round(value * 1000) / 1000;
}
