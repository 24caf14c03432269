// Why no vehicle is heard, link by link: what came through it, and what a person does next.

import type { LinkState } from "./rpc_types.ts";

export interface Hint {
  bytes: number;
  frames: number;
  /** What a person does. */
  next: string;
  /** This link cannot work as it is. */
  bad: boolean;
}

const MAX_SOURCES = 4;

export function linkHint(link: LinkState): Hint {
  const sum = (key: "rx_bytes" | "skipped_bytes" | "good" | "unknown"): number => link.channels.reduce((total, channel) => total + (channel[key] ?? 0), 0);
  const [bytes, frames] = [sum("rx_bytes") + sum("skipped_bytes"), sum("good")];
  return { bytes, frames, ...advice(link, bytes, frames, sum("unknown")) };
}

function advice(link: LinkState, bytes: number, frames: number, unknown: number): Pick<Hint, "next" | "bad"> {
  const good = (next: string): Pick<Hint, "next" | "bad"> => ({ next, bad: false });
  const bad = (next: string): Pick<Hint, "next" | "bad"> => ({ next, bad: true });
  if (link.state === "disabled") return good("Switched off in the fleet file.");
  if (link.state !== "up") return bad(`${link.last_error ?? "It is being opened"}.`);
  if (link.role === "gcs") return good("For another ground station: no vehicle is expected here.");
  if (frames > 0) return bad(withoutHeartbeat(link));
  if (unknown > 0) return bad("Frames of messages that the dialect does not have: is it the vehicle's dialect? See [daemon] in the fleet file.");
  if ((link.not_allowed ?? 0) > 0) return bad("Datagrams come from addresses that the link's allow_from leaves out.");
  if ((link.peers_refused ?? 0) > 0) return bad("The link has as many senders as it takes: others are refused.");
  if (bytes > 0 || (link.ignored_datagrams ?? 0) > 0) {
    return bad(
      link.type === "serial" || link.type === "xbee"
        ? "Bytes and no frame: a wrong baud rate, or the port does not speak MAVLink (SERIALn_PROTOCOL = 2, MAV_n_CONFIG)."
        : "Bytes and no frame: what sends here does not speak MAVLink, or its data are encrypted.",
    );
  }
  return bad(silent(link));
}

function withoutHeartbeat(link: LinkState): string {
  const sources = [...new Set(link.channels.flatMap((channel) => Object.keys(channel.sources ?? {})))];
  const more = sources.length > MAX_SOURCES ? ` and ${sources.length - MAX_SOURCES} more` : "";
  const from = sources.length === 0 ? "" : ` from ${sources.slice(0, MAX_SOURCES).join(", ")}${more}`;
  return `Frames${from} and no heartbeat of an autopilot: is it the vehicle's other port, a ground station, or a filter (allow_msg_id_in)?`;
}

function silent(link: LinkState): string {
  switch (link.type) {
    case "serial": return "No bytes: has the radio power, are both radios paired, is it the right port, are TX and RX crossed?";
    case "xbee": return "No bytes: have the radios power, and are they in the same network?";
    case "udp_server": return "Nothing came: the vehicle sends to this computer's address and this port; does a firewall keep it out?";
    case "udp_client": return "Nothing came back: is the vehicle's address right, and is it in this network?";
    case "tcp_client": return "Connected, and nothing comes: is it the port of MAVLink?";
    case "tcp_server": return "Nothing came: the vehicle connects to this computer's address and this port; does a firewall keep it out?";
    default: return "Nothing came yet.";
  }
}
