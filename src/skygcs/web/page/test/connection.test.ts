import assert from "node:assert/strict";
import { test } from "node:test";
import { Connection, ConnectionLost, NotConnected, SILENCE_MS, type Socket, type Surroundings } from "../src/connection.ts";

class FakeSocket implements Socket {
  onopen: (() => void) | null = null;
  onmessage: ((event: { data: unknown }) => void) | null = null;
  onclose: ((event: { code: number; reason: string }) => void) | null = null;
  onerror: (() => void) | null = null;
  sent: Record<string, unknown>[] = [];
  closed = false;

  send(text: string): void {
    this.sent.push(JSON.parse(text) as Record<string, unknown>);
  }

  close(): void {
    this.closed = true;
  }

  say(message: object): void {
    this.onmessage?.({ data: JSON.stringify({ jsonrpc: "2.0", ...message }) });
  }
}

class World implements Surroundings {
  now = 0;
  sockets: FakeSocket[] = [];
  private timers: { at: number; run: () => void }[] = [];

  nowMs = (): number => this.now;
  random = (): number => 0.5;
  open = (): Socket => {
    const socket = new FakeSocket();
    this.sockets.push(socket);
    return socket;
  };
  later = (run: () => void, ms: number): (() => void) => {
    const timer = { at: this.now + ms, run };
    this.timers.push(timer);
    return () => {
      this.timers = this.timers.filter((one) => one !== timer);
    };
  };

  pass(ms: number): void {
    const end = this.now + ms;
    for (;;) {
      const next = this.timers.filter((timer) => timer.at <= end).sort((a, b) => a.at - b.at)[0];
      if (next === undefined) break;
      this.timers = this.timers.filter((one) => one !== next);
      this.now = next.at;
      next.run();
    }
    this.now = end;
  }

  get last(): FakeSocket {
    const socket = this.sockets.at(-1);
    assert.ok(socket);
    return socket;
  }
}

function connected(): { world: World; connection: Connection } {
  const world = new World();
  const connection = new Connection("ws://x/ws", world);
  connection.begin();
  world.last.onopen?.();
  world.last.say({ method: "web.state", params: { now_s: 100 } });
  return { world, connection };
}

test("an answer goes to the call with its id", async () => {
  const { world, connection } = connected();
  const first = connection.call<number>("web.a");
  const second = connection.call<number>("web.b");
  world.last.say({ id: 2, result: 22 });
  world.last.say({ id: 1, result: 11 });
  assert.deepEqual(await Promise.all([first, second]), [11, 22]);
});

test("a refusal keeps the server's words and code", async () => {
  const { world, connection } = connected();
  const call = connection.call("vehicles.arm", { targets: "all" });
  world.last.say({ id: 1, error: { code: -32002, message: "a replay: nothing can be ordered" } });
  await assert.rejects(call, { code: -32002, message: "a replay: nothing can be ordered" });
});

test("an order has a deadline in the server's clock, a reading has none", () => {
  const { world, connection } = connected();
  world.pass(500);
  void connection.order("vehicles.arm", { targets: ["a"] }, 3);
  void connection.call("plan.pause");
  assert.equal(world.last.sent[0]?.["deadline_s"], 103.5);
  assert.equal("deadline_s" in (world.last.sent[1] ?? {}), false);
});

test("the daemon's clock in trajectory.status is not taken for the server's", async () => {
  const { world, connection } = connected();
  const call = connection.call("trajectory.status");
  world.last.say({ id: 1, result: { now_s: 36_000, trajectories: [] } });
  await call;
  assert.equal(connection.serverNowS(), 100);
});

test("nothing is sent, and nothing is kept for later, while there is no connection", async () => {
  const { world, connection } = connected();
  world.last.onclose?.({ code: 1006, reason: "" });
  await assert.rejects(connection.order("vehicles.takeoff", { targets: "all" }), NotConnected);
  world.pass(60_000);
  world.last.onopen?.();
  assert.deepEqual(world.last.sent, []);
});

test("an order whose connection is lost is unknown and never sent again", async () => {
  const { world, connection } = connected();
  const order = connection.order("vehicles.takeoff", { targets: "all" });
  world.last.onclose?.({ code: 1006, reason: "" });
  await assert.rejects(order, ConnectionLost);
  world.pass(10_000);
  world.last.onopen?.();
  world.pass(10_000);
  assert.ok(world.sockets.slice(1).every((socket) => socket.sent.every((message) => message["method"] !== "vehicles.takeoff")));
});

test("an order before the server's clock was heard on this connection is not sent", async () => {
  const { world, connection } = connected();
  world.last.onclose?.({ code: 1006, reason: "" });
  world.pass(60_000);
  world.last.onopen?.();
  await assert.rejects(connection.order("vehicles.arm", { targets: "all" }), NotConnected);
});

test("attempts are spaced more and more, up to five seconds, and begin anew after a session that worked", () => {
  const world = new World();
  const connection = new Connection("ws://x/ws", world);
  connection.begin();
  const waits: number[] = [];
  for (let i = 0; i < 7; i++) {
    world.last.onclose?.({ code: 1006, reason: "" });
    const before = world.sockets.length;
    const begun = world.now;
    while (world.sockets.length === before) world.pass(50);
    waits.push(world.now - begun);
  }
  assert.deepEqual(waits, [500, 1000, 2000, 4000, 5000, 5000, 5000]);
  world.last.onopen?.();
  connection.settled();
  world.last.onclose?.({ code: 1006, reason: "" });
  const before = world.sockets.length;
  world.pass(500);
  assert.equal(world.sockets.length, before + 1);
});

test("a silent socket is given up, one that answers pings is not", () => {
  const { world } = connected();
  const socket = world.last;
  world.pass(5_000);
  assert.equal(socket.sent.at(-1)?.["method"], "web.ping");
  socket.say({ id: socket.sent.at(-1)?.["id"], result: { now_s: 105 } });
  world.pass(SILENCE_MS - 2_000);
  assert.equal(socket.closed, false);
  world.pass(SILENCE_MS);
  assert.equal(socket.closed, true);
});

test("a late message of a lost socket changes nothing", () => {
  const { world, connection } = connected();
  const old = world.last;
  const handler = old.onmessage;
  old.onclose?.({ code: 1006, reason: "" });
  world.pass(1_000);
  world.last.onopen?.();
  handler?.({ data: JSON.stringify({ method: "web.state", params: { now_s: 7 } }) });
  assert.equal(connection.clock, null);
});

test("what is no JSON and what nobody asked for is left out", () => {
  const { world, connection } = connected();
  world.last.onmessage?.({ data: "{" });
  world.last.onmessage?.({ data: new ArrayBuffer(3) });
  world.last.say({ id: 99, result: 1 });
  world.last.say({ id: "x", error: { code: 1, message: "y" } });
  assert.equal(connection.phase.kind, "open");
});

test("only a trusted input counts as a person's, and at most once a second", () => {
  const { world, connection } = connected();
  const active = (): number => world.last.sent.filter((message) => message["method"] === "operator.active").length;
  connection.personActive({ isTrusted: false } as Event);
  connection.personActive({ isTrusted: true, repeat: true } as unknown as Event); // something lies on the keyboard
  assert.equal(active(), 0);
  connection.personActive({ isTrusted: true } as Event);
  connection.personActive({ isTrusted: true } as Event);
  assert.equal(active(), 1);
  world.pass(1_000);
  connection.personActive({ isTrusted: true } as Event);
  assert.equal(active(), 2);
});

test("no request of the page itself counts as a person's, however long it is open", () => {
  const { world, connection } = connected();
  void connection.call("plan.pause").catch(() => undefined);
  world.pass(7_000);
  assert.ok(world.last.sent.length > 1);
  assert.ok(world.last.sent.every((message) => message["method"] !== "operator.active"));
});
