"""Who may do what at a real hub: every subject that one could try, by every role, without the program's own care."""

from __future__ import annotations

import asyncio
import json
import re

import nats.errors
import nats.js.errors
import pytest

from skygcs.ext.federation.bridge.bus import Message
from support.hub import Hub, RawClient, until

SITES = ("north", "south", "east")
KINDS = ("cmd", "stop")
STREAMS = ("KV_skygcs_leases", "OBJ_skygcs_logs")

SUBJECTS = [
    *(f"state.{site}.{what}" for site in SITES for what in ("fast", "slow", "full.alpha", "other")),
    *(f"{what}.{site}" for site in SITES for what in ("event", "audit", "here", "log", "bridge")),
    *(f"{kind}.{site}.{what}" for kind in KINDS for site in SITES for what in ("alpha", "outcome", "alpha.more")),
    *(
        f"{kind}.{site}.{what}.{key}"
        for kind in KINDS
        for site in SITES
        for what in ("alpha", "outcome")
        for key in ("OWN", "NORTH", "*")
    ),
    *(f"lease.{site}.alpha.request" for site in SITES),
    *(f"$KV.skygcs_leases.{site}.alpha" for site in SITES),
    *("$KV.skygcs_leases.alpha", "$KV.other.north.alpha", "$O.skygcs_logs.C.x", "$O.skygcs_logs.M.x", "$O.other.C.x"),
    *(
        f"$JS.API.{verb}.{stream}"
        for stream in STREAMS
        for verb in (
            *("STREAM.CREATE", "STREAM.UPDATE", "STREAM.DELETE", "STREAM.PURGE", "STREAM.INFO", "STREAM.MSG.GET"),
            *("STREAM.MSG.DELETE", "STREAM.SNAPSHOT", "STREAM.RESTORE", "STREAM.LEADER.STEPDOWN", "DIRECT.GET"),
            *("CONSUMER.CREATE", "CONSUMER.NAMES", "CONSUMER.LIST"),
        )
    ),
    *(
        f"$JS.API.{tail}"
        for stream in STREAMS
        for tail in (
            *(f"CONSUMER.CREATE.{stream}.c.$KV.skygcs_leases.>", f"CONSUMER.DURABLE.CREATE.{stream}.c"),
            *(f"CONSUMER.INFO.{stream}.c", f"CONSUMER.DELETE.{stream}.c", f"CONSUMER.MSG.NEXT.{stream}.c"),
            *(f"DIRECT.GET.{stream}.$KV.skygcs_leases.north.alpha", f"STREAM.PEER.REMOVE.{stream}"),
        )
    ),
    *("$JS.API.INFO", "$JS.API.STREAM.NAMES", "$JS.API.STREAM.LIST", "$JS.API.STREAM.CREATE.mine"),
    *("$JS.API.STREAM.TEMPLATE.CREATE.mine", "$JS.API.SERVER.REMOVE", "$JS.API.META.LEADER.STEPDOWN"),
    *("$JS.ACK.KV_skygcs_leases.c.1.1.1.1.1", "$JS.FC.KV_skygcs_leases.c.x", "$JS.SNAPSHOT.ACK.KV_skygcs_leases.x"),
    *("$SYS.REQ.SERVER.PING", "$SYS.REQ.ACCOUNT.PING.CONNZ", "$SYS.ACCOUNT.$G.CONNECT", "$SYS._INBOX.x"),
    *("_INBOX.x", "_INBOX_.x", "_R_.x", "_GR_.x", "x", "state", "cmd", "state.north", "here.north.x", "HERE.north"),
]

ASKS = r"here\.\w+|state\.\w+\.full\.alpha"
"""Everybody."""

FILES_READ = r"log\.\w+|\$JS\.API\.STREAM\.(INFO|MSG\.GET)\.OBJ_skygcs_logs"


def orders(sites: str) -> str:
    return rf"(cmd|stop)\.({sites})\.(alpha|outcome)\.OWN"


def of_site(name: str, ordered: str) -> str:
    own = rf"(state\.{name}\.(fast|slow)|(event|audit|bridge)\.{name})"
    sites = "|".join(filter(None, (name, ordered)))
    leases = rf"\$KV\.skygcs_leases\.({sites})\.alpha|lease\.({sites})\.alpha\.request"
    kept = r"\$JS\.API\.STREAM\.(INFO|MSG\.GET)\.KV_skygcs_leases|\$O\.skygcs_logs\.[CM]\.x"
    return "|".join((ASKS, FILES_READ, own, leases, kept, *([orders(ordered)] if ordered else [])))


PUBLISH = {
    "visitor": ASKS,
    "boss": "|".join((ASKS, FILES_READ, orders("north|south|east"))),
    "clerk": "|".join((ASKS, FILES_READ, orders("north"))),
    "north": of_site("north", "south"),
    "east": of_site("east", ""),
    "keeper": r"\$JS\.API\.STREAM\.(CREATE|INFO)\.(KV_skygcs_leases|OBJ_skygcs_logs)",
}
"""What each may send, written down here independently of the configuration."""

READ = r"state\.\*\.(fast|slow)|state\.north\.fast|(event|audit)\.(\*|>|north)"
"""The server takes a last * of a permission for >, too; nobody may send to what is below."""

OWN_INBOX = r"_INBOX_OWN\.(>|x|\*)"
SUBSCRIBE = {
    "visitor": rf"{READ}|{OWN_INBOX}",
    "boss": rf"{READ}|{OWN_INBOX}",
    "clerk": rf"{READ}|{OWN_INBOX}",
    "north": rf"{READ}|{OWN_INBOX}|(here|bridge|log)\.north|state\.north\.full\.(\*|alpha)"
    r"|(cmd|stop)\.north\.(\*|alpha)\.\*|lease\.(north|south)\.(\*|alpha)\.request",
    "east": rf"{READ}|{OWN_INBOX}|lease\.east\.\*\.request",
    "keeper": OWN_INBOX,
}
WANTED = [
    *(">", "*", "*.>", "*.*", "*.*.*", "*.north.*", "_INBOX.>", "_INBOX_.>", "_INBOX_NORTH.>", "_INBOX_NORTH.x"),
    *("_INBOX_OWN.>", "_INBOX_OWN.x", "_INBOX_OWN.*", "state.>", "state.*.*", "state.*.fast", "state.*.slow"),
    *("state.north.fast", "state.*.full.*", "state.north.full.*", "state.north.full.alpha", "event.>", "event.*"),
    *(
        "event.north",
        "bridge.*",
        "bridge.north",
        "bridge.>",
        "audit.*",
        "audit.north",
        "here.*",
        "here.north",
        *(f"{kind}.{what}" for kind in KINDS for what in (">", "*.*", "north.*")),
    ),
    *(
        "cmd.north.alpha",
        *(
            f"{kind}.{what}"
            for kind in KINDS
            for what in ("north.*.*", "north.alpha.*", "*.*.*", "south.*", "south.*.*")
        ),
        "lease.>",
        "lease.*.*.request",
        "lease.north.*.request",
    ),
    *(
        "lease.south.alpha.request",
        "lease.east.*.request",
        "log.*",
        "log.north",
        "log.south",
        "$KV.>",
        "$KV.skygcs_leases.>",
        "$JS.>",
    ),
    *("$JS.API.>", "$JS.EVENT.>", "$O.>", "$SYS.>", "$SYS.ACCOUNT.>", "_R_.>"),
]


def denied(client: RawClient, what: str) -> list[str]:
    """The subjects that the server refused, in order; nats-py gives its errors in small letters."""
    found = [re.search(rf'permissions violation for {what} to "([^"]*)"', error, re.I) for error in client.errors]
    return [match[1] for match in found if match]


def lower(subjects: list[str]) -> list[str]:
    return [subject.lower() for subject in subjects]


@pytest.mark.parametrize("name", PUBLISH)
async def test_what_is_not_permitted_to_a_role_is_refused_by_the_server_and_reaches_nobody(hub: Hub, name: str) -> None:
    key = hub.process.keeper if name == "keeper" else hub.keys[name]
    seen: list[str] = []

    async def see(message: object) -> None:
        seen.append(message.subject)  # type: ignore[attr-defined]

    north = "OWN" if name == "north" else "NORTH"
    keys = {"OWN": key.public_key, "NORTH": hub.keys["north"].public_key, "STRANGER": hub.keys["stranger"].public_key}
    subjects = [s.replace("NORTH", north) for s in (*SUBJECTS, "_INBOX_NORTH.x", "_INBOX_STRANGER.x")]
    real = {s: ".".join(keys.get(word.removeprefix("_INBOX_"), word) for word in s.split(".")) for s in subjects}
    async with hub.raw(hub.witness) as witness, hub.raw(key) as client:
        await witness.subscribe(">", cb=see)
        await witness.settled()
        for subject in subjects:
            await client.publish(real[subject], b"{}", reply="cmd.north.alpha")
        await client.settled()
        expected = [real[subject] for subject in subjects if not re.fullmatch(PUBLISH[name], subject)]
        assert denied(client, "publish") == lower(expected)
        await witness.settled()
        assert [s for s in seen if s in expected and s != "cmd.north.alpha"] == []
        # an answer of the server's own interface is no order, wherever it was asked to be sent
        assert set(real.values()) - set(expected) <= set(seen), "what is permitted arrives"


@pytest.mark.parametrize("name", SUBSCRIBE)
async def test_nobody_reads_what_is_for_others(hub: Hub, name: str) -> None:
    key = hub.process.keeper if name == "keeper" else hub.keys[name]
    names = {"_INBOX_OWN": f"_INBOX_{key.public_key}", "_INBOX_NORTH": f"_INBOX_{hub.keys['north'].public_key}"}

    def real(subject: str) -> str:
        first, dot, rest = subject.partition(".")
        return f"{names.get(first, first)}{dot}{rest}"

    async with hub.raw(key) as client:
        for subject in WANTED:
            await client.subscribe(real(subject), cb=_ignore)
        await client.settled()
        own = WANTED if name != "north" else [w.replace("_INBOX_NORTH", "_INBOX_OWN") for w in WANTED]
        expected = [real(subject) for subject in own if not re.fullmatch(SUBSCRIBE[name], subject)]
        assert denied(client, "subscription") == lower(expected)


async def _ignore(_: object) -> None: ...


async def test_an_observer_cannot_order_take_a_lease_or_publish_a_state(hub: Hub) -> None:
    """Through the interfaces that a program would use, against a site that is really there."""
    async with hub.bus("north") as north, hub.raw(hub.keys["visitor"]) as visitor:
        ordered: list[Message] = []

        async def take(message: Message) -> bytes:
            ordered.append(message)
            return b"{}"

        for subject in ("cmd.north.*", "lease.north.*.request"):
            await north.serve(subject, take)
        leases = await north.key_value("skygcs_leases")
        revision = await leases.create("north.alpha", b'{"holder":"north"}')
        for subject in ("cmd.north.alpha", "cmd.north.outcome", "lease.north.alpha.request"):
            with pytest.raises(nats.errors.TimeoutError):
                await visitor.request(subject, b'{"method":"vehicles.arm"}', timeout=0.2)
        jetstream = visitor.jetstream(timeout=0.2)
        for attempt in (
            lambda: jetstream.key_value("skygcs_leases"),
            lambda: jetstream.create_key_value(bucket="skygcs_leases"),
            lambda: jetstream.create_key_value(bucket="mine"),
            lambda: jetstream.delete_key_value("skygcs_leases"),
            lambda: jetstream.publish("$KV.skygcs_leases.north.alpha", b'{"holder":"visitor"}'),
            lambda: jetstream.purge_stream("KV_skygcs_leases"),
            lambda: jetstream.get_msg("KV_skygcs_leases", seq=revision),
            lambda: jetstream.add_stream(name="mine", subjects=["cmd.>"]),
            lambda: jetstream.subscribe("$KV.skygcs_leases.>", stream="KV_skygcs_leases"),
            lambda: jetstream.account_info(),
        ):
            with pytest.raises((nats.errors.Error, nats.js.errors.Error)):
                await attempt()
        assert ordered == []
        entry = await leases.get("north.alpha")
        assert (entry.revision, entry.value) == (revision, b'{"holder":"north"}')


async def test_an_answer_goes_to_inboxes_only_so_nobody_has_a_site_publish_for_them(hub: Hub) -> None:
    """A request may name any subject for its answer, and the server lets a site answer there."""
    async with hub.bus("north") as north, hub.raw(hub.keys["visitor"]) as visitor, hub.raw(hub.witness) as witness:
        seen: list[str] = []

        async def see(message: object) -> None:
            seen.append(message.subject)  # type: ignore[attr-defined]

        async def here(message: Message) -> bytes:
            return message.data

        await witness.subscribe(">", cb=see)
        await north.serve("here.north", here)
        await witness.settled()
        for subject in ("cmd.south.carol", "state.south.fast", "$KV.skygcs_leases.south.carol", "$JS.API.INFO"):
            await visitor.publish("here.north", b'{"method":"vehicles.arm"}', reply=subject)
        await until(lambda: north.counters.bad_reply_to == 4, "all four are counted")
        assert (await visitor.request("here.north", b"1", timeout=10)).data == b"1"
        await witness.settled()
        assert [s for s in seen if not s.startswith(("here.", "_INBOX_"))] == []


async def test_an_answer_can_be_faked_by_nobody_and_given_once(hub: Hub) -> None:
    async with (
        hub.raw(hub.keys["north"]) as north,
        hub.raw(hub.keys["south"]) as south,
        hub.raw(hub.keys["visitor"]) as visitor,
        hub.raw(hub.keys["stranger"]) as stranger,
    ):
        asked: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        answers: list[bytes] = []

        async def on_request(message: object) -> None:
            asked.set_result(message.reply)  # type: ignore[attr-defined]

        async def on_answer(message: object) -> None:
            answers.append(message.data)  # type: ignore[attr-defined]

        await north.subscribe("here.north", cb=on_request)
        inbox = f"_INBOX_{hub.keys['visitor'].public_key}.answer"
        await visitor.subscribe(inbox, cb=on_answer)
        await north.settled()
        await visitor.publish("here.north", b"", reply=inbox)
        assert await asyncio.wait_for(asked, 10) == inbox
        for other in (south, stranger):
            await other.publish(inbox, b"faked")
            await other.settled()
            assert denied(other, "publish") == lower([inbox])
        for answer in (b"true", b"once more"):
            await north.publish(inbox, answer)
        await north.settled()
        assert denied(north, "publish") == lower([inbox])
        await visitor.settled()
        assert answers == [b"true"]


async def test_a_site_has_no_way_around_by_the_stores(hub: Hub) -> None:
    """A consumer, a direct get and a stream of one's own send what was stored to any subject: nobody has them."""
    order = json.dumps({"method": "vehicles.arm"}).encode()
    async with hub.raw(hub.keys["east"]) as east, hub.raw(hub.witness) as witness:
        seen: list[bytes] = []

        async def see(message: object) -> None:
            seen.append(message.data)  # type: ignore[attr-defined]

        await witness.subscribe("cmd.>", cb=see)
        await witness.settled()
        await east.jetstream().publish("$KV.skygcs_leases.east.evil", order)
        consumer = {"stream_name": "KV_skygcs_leases", "config": {"deliver_subject": "cmd.north.alpha"}}
        stream = {"name": "KV_skygcs_leases", "subjects": ["$KV.skygcs_leases.>"]}
        republished = {**stream, "republish": {"src": ">", "dest": "cmd.north.alpha"}}
        for subject, body in (
            ("$JS.API.CONSUMER.CREATE.KV_skygcs_leases", consumer),
            ("$JS.API.STREAM.UPDATE.KV_skygcs_leases", republished),
            ("$JS.API.STREAM.CREATE.KV_skygcs_leases", republished),
            ("$JS.API.DIRECT.GET.KV_skygcs_leases", {"last_by_subj": "$KV.skygcs_leases.east.evil"}),
            ("$JS.API.STREAM.MSG.GET.KV_skygcs_leases", {"last_by_subj": "$KV.skygcs_leases.east.evil"}),
        ):
            await east.publish(subject, json.dumps(body).encode(), reply="cmd.north.alpha")
        await east.settled()
        await east.jetstream().publish("$KV.skygcs_leases.east.evil", order)
        await asyncio.sleep(0.2)
        await witness.settled()
        # what the server wraps is no order: it has no method, id and deadline at its top
        assert all("method" not in json.loads(data) for data in seen), seen
        assert len(seen) <= 1
