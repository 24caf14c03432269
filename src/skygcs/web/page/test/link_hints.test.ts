import assert from "node:assert/strict";
import { test } from "node:test";
import { linkHint } from "../src/link_hints.ts";
import type { ChannelState, LinkState } from "../src/rpc_types.ts";

function link(type: string, change: Partial<LinkState> = {}, ...channels: Partial<ChannelState>[]): LinkState {
  return { name: "radio", type, role: "peer", state: "up", last_error: null, channels: channels.map((one) => ({ peer: "p", ...one })), ...change };
}

function next(one: LinkState): string {
  return linkHint(one).next;
}

test("bytes without a frame are a wrong rate on a cable, and no MAVLink in a network", () => {
  const hint = linkHint(link("serial", {}, { rx_bytes: 0, skipped_bytes: 700, good: 0 }));
  assert.deepEqual([hint.bytes, hint.frames, hint.bad], [700, 0, true]);
  assert.match(hint.next, /baud rate/);
  assert.match(next(link("tcp_client", {}, { rx_bytes: 0, skipped_bytes: 700, good: 0 })), /does not speak MAVLink/);
  assert.match(next(link("udp_server", { ignored_datagrams: 4 })), /does not speak MAVLink/);
});

test("a silent link names what may be missing on its kind", () => {
  assert.match(next(link("serial", {}, { rx_bytes: 0 })), /power.*port.*TX and RX/);
  assert.match(next(link("udp_server")), /firewall/);
  for (const type of ["xbee", "udp_client", "udp_broadcast", "tcp_client", "tcp_server", "replay"]) assert.ok(next(link(type)).length > 10, type);
});

test("frames without a heartbeat name their senders, not too many of them", () => {
  const sources = { "255/190": {}, "1/191": {}, "2/191": {}, "3/191": {}, "4/191": {} };
  const hint = linkHint(link("udp_server", {}, { rx_bytes: 90, good: 5, sources }));
  assert.match(hint.next, /^Frames from 255\/190, 1\/191, 2\/191, 3\/191 and 1 more and no heartbeat/);
  assert.equal(hint.frames, 5);
  assert.match(next(link("serial", {}, { rx_bytes: 0, skipped_bytes: 90, good: 0, unknown: 3 })), /dialect/);
});

test("what keeps senders out is said before the silence that it causes", () => {
  assert.match(next(link("udp_server", { not_allowed: 2 })), /allow_from/);
  assert.match(next(link("udp_server", { peers_refused: 2 })), /refused/);
});

test("a link that is down says why, one that is off or for a ground station asks for nothing", () => {
  assert.deepEqual(linkHint(link("serial", { state: "down", last_error: "no such device; plug it in" })), { bytes: 0, frames: 0, next: "no such device; plug it in.", bad: true });
  assert.equal(linkHint(link("serial", { state: "disabled" })).bad, false);
  assert.equal(linkHint(link("udp_client", { role: "gcs" })).bad, false);
});
