/* The fast path of UDP: forwards datagrams from socket to socket without Python.
 *
 * It holds no routing rule. Python handles every new kind of frame first: links.udp, core.mavlink.parser, runtime.hub,
 * core.routing. When Python finds that all further frames of this source and message go to the same destinations, it
 * opens a *flow* here (`FastPath.add_flow`). A datagram is forwarded here only if each of its frames is complete, has a
 * correct CRC, has no target, belongs to an open flow and is no copy of a frame heard on another channel. Any other
 * datagram goes to Python whole and unchanged, after everything that came before it was sent and counted. Any change
 * of the routing table closes all flows (`Table.invalidate`). So the fast path may be left out: only the speed changes.
 *
 * What Python would do per frame is collected. The newest frame of each message goes to Python at the end of each
 * burst. Counters, sequence numbers, times of the last frame and tlog records go to Python when it needs them
 * (`Table.take`: once a second, and before anything is recorded, shown or handled in Python). So a frame that is alone
 * in its burst, as at 1,000 a second, costs no call of Python. Measurements: docs/developers/costs.md; reasons:
 * docs/decisions/0003-fast-path.md.
 */
#define PY_SSIZE_T_CLEAN
#define _GNU_SOURCE
#include <Python.h>
#include <structmember.h>

#include <errno.h>
#include <sys/random.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "_fast_path_map.h"
#include "_fast_path_seen.h"
#include "_fast_path_values.h"

enum {
    BURST = 64,                 /* datagrams received at once, as links.udp.DATAGRAMS_PER_WAKEUP */
    LARGEST_BYTES = 65536,      /* upper limit of `largest` (links.reading.LARGEST_DATAGRAM_BYTES) */
    FRAMES = 256,               /* in one datagram; one with more goes to Python */
    MAX_FLOWS = 16384,          /* 250 vehicles of some 20 messages, on three links; above it all flows are closed and opened again */
    WHOLE_BYTES = 1472,         /* runtime.hub.WHOLE_DATAGRAM_BYTES */
    SEQUENCE = 512,             /* core.routing.source_statistics.BURST_MAX */
    TLOG_TIME_BYTES = 8,
    RECORDS_BYTES = 65536,      /* tlog records that wait for `Table.take`; above it `after` is called */
    RECORDS_KEPT_BYTES = 4 * RECORDS_BYTES, /* buffer that is kept after `take`; a burst of full datagrams needs 8 MB */
    PEER_NUMBERS = 1 << 24,     /* a flow's key is peer number, source and msgid: 24 + 16 + 24 bits */
};

static const double PAUSE_S = 0.5; /* core.routing.source_statistics */

static uint16_t crc_table[256];
static int is_receiving;
static PyObject *s_rx_frames, *s_rx_bytes, *s_last_rx_at, *s_good, *s_on_burst,
    *s_tx_frames, *s_tx_bytes, *s_tx_dropped, *s_frame, *s_at, *s_count;

static PyTypeObject TableType, OutType, FastPathType;

/* -- the table that all fast paths of one hub share: messages, memory of duplicates, counts to report */

typedef struct { uint8_t crc_extra, min_length, length; int target_at; PyObject *info; } Message;

typedef struct FastPath FastPath;
static int report_counts(FastPath *paths);

typedef struct {
    PyObject_HEAD
    FastPath *paths;
    Map messages; /* by msgid + 1 */
    Seen seen;
    uint64_t epoch;
    PyObject *frame_type;
    int recording;
    long long forwarded, local, n_records; /* since the last `take` */
    uint8_t *records;
    size_t records_size, records_room;
} Table;

static void free_message(void *value) {
    Message *message = value;
    Py_XDECREF(message->info);
    PyMem_Free(message);
}

/* False: `__new__` without `__init__`. */
static int table_is_made(const Table *table) {
    return table->seen.older.at ? 1 : (PyErr_SetString(PyExc_RuntimeError, "the table was not initialised"), 0);
}

static PyObject *table_first_heard_on(Table *table, PyObject *args) {
    unsigned long long key, channel;
    double now;
    if (!table_is_made(table) || !PyArg_ParseTuple(args, "KKd", &key, &channel, &now)) return NULL;
    if (key > GREATEST_KEY || !channel || channel > GREATEST_CHANNEL)
        return PyErr_SetString(PyExc_ValueError, "key or channel id out of range"), NULL;
    if (swap_is_due(&table->seen, now)) swap_generations(&table->seen, now);
    uint32_t first = first_heard(&table->seen, key);
    if (!first) remember(&table->seen, key, first = (uint32_t)channel);
    return PyLong_FromUnsignedLong(first);
}

static PyObject *table_invalidate(Table *table, PyObject *unused) {
    (void)unused;
    table->epoch++;
    if (!report_counts(table->paths)) return NULL; /* now, while all channels still exist */
    Py_RETURN_NONE;
}

static int add_message(Table *table, PyObject *msgid, PyObject *row) {
    unsigned long id = PyLong_AsUnsignedLong(msgid);
    if (id == (unsigned long)-1 && PyErr_Occurred()) return 0;
    if (id > 0xFFFFFF || !PyTuple_Check(row)) return PyErr_SetString(PyExc_ValueError, "messages must be {msgid: tuple}"), 0;
    Message *message = PyMem_Calloc(1, sizeof *message);
    if (!message) return PyErr_NoMemory(), 0;
    int good = PyArg_ParseTuple(row, "bbbiO", &message->crc_extra, &message->min_length, &message->length,
                                &message->target_at, &message->info);
    Py_XINCREF(message->info);
    good = good && map_put(&table->messages, id + 1, message);
    if (!good) free_message(message);
    return good;
}

static int table_init(Table *table, PyObject *args, PyObject *unused) {
    (void)unused;
    PyObject *messages, *msgid, *row, *frame_type;
    Py_ssize_t at = 0;
    if (table->frame_type) return PyErr_SetString(PyExc_TypeError, "a table is initialised once"), -1;
    if (!PyArg_ParseTuple(args, "O!O!p", &PyDict_Type, &messages, &PyType_Type, &frame_type, &table->recording)) return -1;
    table->frame_type = Py_NewRef(frame_type);
    while (PyDict_Next(messages, &at, &msgid, &row))
        if (!add_message(table, msgid, row)) return -1;
    return seen_init(&table->seen) ? 0 : -1;
}

static void table_dealloc(Table *table) {
    Py_XDECREF(table->frame_type);
    map_clear(&table->messages, free_message);
    seen_free(&table->seen), PyMem_Free(table->records);
    Py_TYPE(table)->tp_free(table);
}

/* Report all counts to Python's objects; return (frames forwarded, frames for us only, tlog records, their number)
   since the last call. */
static PyObject *table_take(Table *table, PyObject *unused) {
    (void)unused;
    Faults faults = {0};
    if (!report_counts(table->paths)) set_aside(&faults, (PyObject *)table);
    PyObject *taken = NULL;
    if (none_of(&faults))
        taken = Py_BuildValue("LLy#L", table->forwarded, table->local, table->records ? (const char *)table->records : "",
                              (Py_ssize_t)table->records_size, table->n_records);
    if (!taken) return NULL; /* the next call returns it */
    table->forwarded = table->local = table->n_records = 0;
    table->records_size = 0;
    if (table->records_room > RECORDS_KEPT_BYTES) {
        PyMem_Free(table->records);
        table->records = NULL, table->records_room = 0;
    }
    return taken;
}

/* Make room for so many more bytes of records. False: no memory, and nothing has changed. */
static int reserve(Table *table, size_t size) {
    size_t wanted = table->records_size + size;
    if (wanted <= table->records_room) return 1;
    uint8_t *more = PyMem_Realloc(table->records, wanted * 2);
    if (!more) return PyErr_NoMemory(), 0;
    table->records = more, table->records_room = wanted * 2;
    return 1;
}

/* Append a record. Cannot fail: `reserve` made room. */
static void record(Table *table, const uint8_t *raw, size_t size, uint64_t unix_us) {
    uint8_t *to = table->records + table->records_size;
    for (int i = 0; i < TLOG_TIME_BYTES; i++) to[i] = (uint8_t)(unix_us >> (56 - 8 * i));
    memcpy(to + TLOG_TIME_BYTES, raw, size);
    table->records_size += TLOG_TIME_BYTES + size;
    table->n_records++;
}

/* -- a destination: one UDP peer */

/* It is in its fast path's list `waiting` exactly while `waits` (only `flush_waiting` takes it out), and in `touched_outs`
   exactly while `touched`. Only one path runs at a time, and what waits is sent before Python is called: so no Out is in
   the lists of two paths, and none in a list goes away, as the flows that own it are let go of later. */
typedef struct Out {
    PyObject_HEAD
    int fd, n, whole, touched, waits; /* whole: may be sent several frames in one datagram */
    struct Out *next, *next_waiting;
    struct sockaddr_in to;
    PyObject *channel; /* a weak reference: the channel owns its Out */
    struct iovec parts[BURST];
    int frames[BURST];
    long long tx_frames, tx_bytes, tx_dropped;
} Out;

static int out_init(Out *out, PyObject *args, PyObject *unused) {
    PyObject *address, *channel;
    (void)unused;
    if (out->channel) return PyErr_SetString(PyExc_TypeError, "an out is initialised once"), -1;
    if (!PyArg_ParseTuple(args, "iO!Op", &out->fd, &PyTuple_Type, &address, &channel, &out->whole)) return -1;
    if (!address_from(address, &out->to)) return -1;
    out->channel = PyWeakref_NewRef(channel, NULL);
    return out->channel ? 0 : -1;
}

static void out_dealloc(Out *out) {
    Py_XDECREF(out->channel);
    Py_TYPE(out)->tp_free(out);
}

/* Send what waits here. What the socket does not take is dropped and counted, as UdpChannel.send does. */
static void out_flush(Out *out) {
    struct mmsghdr messages[BURST];
    for (int i = 0; i < out->n; i++) {
        messages[i].msg_hdr = (struct msghdr){.msg_name = &out->to, .msg_namelen = sizeof out->to,
                                              .msg_iov = &out->parts[i], .msg_iovlen = 1};
        messages[i].msg_len = 0;
    }
    for (int done = 0; done < out->n;) {
        int sent = sendmmsg(out->fd, messages + done, (unsigned)(out->n - done), MSG_DONTWAIT);
        for (int i = done; i < done + sent; i++)
            out->tx_frames += out->frames[i], out->tx_bytes += (long long)out->parts[i].iov_len;
        if (sent <= 0) out->tx_dropped += out->frames[done], sent = 1;
        done += sent;
    }
    out->n = 0;
}

/* Add the counts to the channel, if it still exists. */
static int out_report(Out *out) {
#if PY_VERSION_HEX >= 0x030D0000
    PyObject *channel;
    if (PyWeakref_GetRef(out->channel, &channel) < 0) return 0;
#else
    PyObject *channel = PyWeakref_GetObject(out->channel);
    if (!channel) return 0;
    channel = channel == Py_None ? NULL : Py_NewRef(channel);
#endif
    int good = !channel || (add(channel, s_tx_frames, out->tx_frames) && add(channel, s_tx_bytes, out->tx_bytes) &&
                            add(channel, s_tx_dropped, out->tx_dropped));
    out->tx_frames = out->tx_bytes = out->tx_dropped = 0;
    Py_XDECREF(channel);
    return good;
}

/* -- a fast path: one UDP socket. Objects with counts to report are linked in lists */

typedef struct Peer {
    uint32_t number, channel_id;
    PyObject *channel, *parser_stats;
    double at;
    long long frames, bytes;
    int touched;
    struct Peer *next;
} Peer;

typedef struct Source {
    PyObject *stats, *heard, *key;
    double first_at, at;
    long long bytes;
    int n, touched;
    uint8_t seqs[SEQUENCE]; /* since the last `report_source`: core.routing.source_statistics counts the losses */
    struct Source *next;
} Source;

typedef struct Flow {
    Source *source;
    Out **outs;
    int n_outs, newest_size, touched;
    uint32_t msgid;
    const Message *message;
    PyObject *slot, *watches; /* or None */
    PyObject *steady, *again;        /* steady: None or the required payload; again(now): once a burst */
    const uint8_t *newest;           /* in the burst's slots */
    long long count;
    struct Flow *next;
} Flow;

struct FastPath {
    PyObject_HEAD
    Table *table;
    FastPath *next;
    PyObject *clock, *slow, *after, *broken; /* see `FastPath` in _fast_path.pyi */
    int fd, settling; /* fd: -1 once it is closed */
    int largest, first, got; /* bytes of a slot; received datagrams from `first` up to `got` wait to be handled */
    long long kept, too_large; /* got - first; datagrams that were cut off */
    uint8_t *slots; /* BURST datagrams */
    struct mmsghdr messages[BURST];
    struct iovec parts[BURST];
    struct sockaddr_in from[BURST];
    uint32_t last_number; /* of a peer */
    Map peers, sources, flows; /* by address; peer and source; peer, source and msgid */
    uint64_t epoch;
    Peer *touched_peers;
    Source *touched_sources;
    Flow *touched_flows; /* in this burst */
    Out *touched_outs, *waiting; /* waiting: with something to send, within a burst */
};

#define TOUCH(list, item) \
    if (!(item)->touched) (item)->touched = 1, (item)->next = (list), (list) = (item)

/* These also free values whose construction failed half-way. */

static void free_peer(void *value) {
    Peer *peer = value;
    Py_XDECREF(peer->channel), Py_XDECREF(peer->parser_stats);
    PyMem_Free(peer);
}

static void free_source(void *value) {
    Source *source = value;
    Py_XDECREF(source->stats), Py_XDECREF(source->heard), Py_XDECREF(source->key);
    PyMem_Free(source);
}

static void free_flow(void *value) {
    Flow *flow = value;
    for (int i = 0; i < flow->n_outs; i++) Py_DECREF(flow->outs[i]);
    Py_XDECREF(flow->slot), Py_XDECREF(flow->watches), Py_XDECREF(flow->steady), Py_XDECREF(flow->again);
    PyMem_Free(flow->outs);
    PyMem_Free(flow);
}

static void flush_waiting(FastPath *path) {
    Out *out;
    while ((out = path->waiting)) {
        path->waiting = out->next_waiting;
        out->waits = 0;
        out_flush(out);
    }
}

/* Close all flows. First send what waits and report all counts, as their owners are released. False: an exception. */
static int forget_flows(FastPath *path) {
    flush_waiting(path);
    int good = report_counts(path->table->paths);
    PyObject *fault = good ? NULL : take_exception();
    path->touched_flows = NULL; /* there are none: `settle` reports them before Python can close them */
    path->epoch = path->table->epoch;
    map_clear(&path->flows, free_flow);
    map_clear(&path->sources, free_source);
    if (fault) raise_exception(fault);
    return good;
}

static uint64_t source_key(const Peer *peer, unsigned source) { return (uint64_t)peer->number << 16 | source; }
static uint64_t flow_key(const Peer *peer, unsigned source, uint32_t msgid) { return source_key(peer, source) << 24 | msgid; }

static int is_open(const FastPath *path) { return path->table && path->fd >= 0; }

/* A number that no peer has. Numbers count up, so that a number is not used again soon. */
static uint32_t free_number(FastPath *path) {
    int taken;
    do {
        if (++path->last_number >= PEER_NUMBERS) path->last_number = 1;
        taken = 0;
        for (size_t i = 0; path->peers.cells && i <= path->peers.mask && !taken; i++) {
            const Peer *other = path->peers.cells[i].value;
            taken = other && other->number == path->last_number;
        }
    } while (taken);
    return path->last_number;
}

static PyObject *fast_path_add_peer(FastPath *path, PyObject *args) {
    PyObject *address, *channel, *parser_stats;
    struct sockaddr_in from;
    unsigned long long channel_id;
    if (!PyArg_ParseTuple(args, "O!OOK", &PyTuple_Type, &address, &channel, &parser_stats, &channel_id)) return NULL;
    if (!address_from(address, &from)) return NULL;
    if (!channel_id || channel_id > GREATEST_CHANNEL) return PyErr_SetString(PyExc_ValueError, "channel id out of range"), NULL;
    if (!is_open(path)) Py_RETURN_NONE;
    if (!report_counts(path->table->paths)) return NULL;
    Peer *peer = PyMem_Calloc(1, sizeof *peer), *before = map_get(&path->peers, address_key(&from));
    if (!peer) return PyErr_NoMemory();
    *peer = (Peer){.number = free_number(path), .channel_id = (uint32_t)channel_id, .channel = Py_NewRef(channel),
                   .parser_stats = Py_NewRef(parser_stats)};
    if (!map_put(&path->peers, address_key(&from), peer)) return free_peer(peer), NULL;
    if (before) free_peer(before);
    Py_RETURN_NONE;
}

/* The peer is removed even if reporting fails. */
static PyObject *fast_path_remove_peer(FastPath *path, PyObject *address) {
    struct sockaddr_in from;
    if (!PyTuple_Check(address)) return PyErr_SetString(PyExc_TypeError, "an address must be a tuple"), NULL;
    if (!address_from(address, &from)) return NULL;
    if (!is_open(path)) Py_RETURN_NONE;
    int good = report_counts(path->table->paths);
    PyObject *fault = good ? NULL : take_exception();
    Peer *peer = map_remove(&path->peers, address_key(&from));
    if (peer) free_peer(peer);
    if (fault) return raise_exception(fault), NULL;
    Py_RETURN_NONE;
}

static Source *new_source(FastPath *path, uint64_t key, unsigned source, PyObject *stats, PyObject *heard) {
    Source *made = PyMem_Calloc(1, sizeof *made);
    if (!made) return PyErr_NoMemory(), NULL;
    made->stats = Py_NewRef(stats), made->heard = Py_NewRef(heard), made->key = PyLong_FromUnsignedLong(source);
    if (made->key && map_put(&path->sources, key, made)) return made;
    return free_source(made), NULL;
}

static Flow *new_flow(Source *source, uint32_t msgid, const Message *message, PyObject *outs) {
    Flow *made = PyMem_Calloc(1, sizeof *made);
    if (!made || !(made->outs = PyMem_Calloc((size_t)PyTuple_GET_SIZE(outs) + 1, sizeof *made->outs))) {
        PyMem_Free(made);
        return PyErr_NoMemory(), NULL;
    }
    for (; made->n_outs < PyTuple_GET_SIZE(outs); made->n_outs++)
        made->outs[made->n_outs] = (Out *)Py_NewRef(PyTuple_GET_ITEM(outs, made->n_outs));
    made->source = source, made->msgid = msgid, made->message = message;
    return made;
}

/* add_flow(address, source, msgid, stats, heard, outs, slot, watches, steady, again): further frames of this source
   and message from this peer go to `outs` (empty: to us only), until the table changes. */
static PyObject *fast_path_add_flow(FastPath *path, PyObject *args) {
    PyObject *address, *stats, *heard, *outs, *slot, *watches, *steady, *again;
    struct sockaddr_in from;
    unsigned source;
    unsigned long msgid;
    if (!PyArg_ParseTuple(args, "O!IkOO!O!OOOO", &PyTuple_Type, &address, &source, &msgid, &stats, &PyDict_Type, &heard,
                          &PyTuple_Type, &outs, &slot, &watches, &steady, &again) || !address_from(address, &from)) return NULL;
    for (Py_ssize_t i = 0; i < PyTuple_GET_SIZE(outs); i++)
        if (Py_TYPE(PyTuple_GET_ITEM(outs, i)) != &OutType) return PyErr_SetString(PyExc_TypeError, "outs must be Out objects"), NULL;
    if (watches != Py_None && !PyList_Check(watches)) return PyErr_SetString(PyExc_TypeError, "watches must be a list"), NULL;
    if (steady != Py_None && !PyBytes_Check(steady)) return PyErr_SetString(PyExc_TypeError, "steady must be bytes"), NULL;
    if (source > 0xFFFF || msgid > 0xFFFFFF) return PyErr_SetString(PyExc_ValueError, "source or msgid out of range"), NULL;
    if (path->settling || !is_open(path)) Py_RETURN_NONE;
    if ((path->epoch != path->table->epoch || path->flows.filled >= MAX_FLOWS) && !forget_flows(path)) return NULL;
    Peer *peer = map_get(&path->peers, address_key(&from));
    Message *message = map_get(&path->table->messages, msgid + 1);
    if (!peer || !message || map_get(&path->flows, flow_key(peer, source, (uint32_t)msgid))) Py_RETURN_NONE;
    Source *known = map_get(&path->sources, source_key(peer, source));
    if (!known && !(known = new_source(path, source_key(peer, source), source, stats, heard))) return NULL;
    Flow *flow = new_flow(known, (uint32_t)msgid, message, outs);
    if (!flow) return NULL;
    flow->slot = Py_NewRef(slot), flow->watches = Py_NewRef(watches);
    flow->steady = Py_NewRef(steady), flow->again = Py_NewRef(again);
    if (!map_put(&path->flows, flow_key(peer, source, flow->msgid), flow)) return free_flow(flow), NULL;
    Py_RETURN_NONE;
}

/* -- one datagram */

typedef struct { Flow *flow; const uint8_t *raw; int size; unsigned seq; uint64_t seen_key; } Found;

/* Find the frame at the start of `data` and its flow; 0 if Python has to handle it. */
static int find_frame(const FastPath *path, const Peer *peer, const uint8_t *data, int left, Found *found) {
    int v2 = data[0] == 0xFD, head = v2 ? 10 : 6;
    if ((!v2 && data[0] != 0xFE) || left < head + 2) return 0;
    int length = data[1], size = head + length + 2;
    const uint8_t *ids = v2 ? data + 5 : data + 3; /* sysid compid msgid */
    uint32_t msgid = ids[2];
    if (v2) {
        if (data[2] > 1) return 0;
        if (data[2]) size += 13;
        msgid |= (uint32_t)ids[3] << 8 | (uint32_t)ids[4] << 16;
    }
    unsigned source = (unsigned)ids[0] << 8 | ids[1];
    Flow *flow = size <= left ? map_get(&path->flows, flow_key(peer, source, msgid)) : NULL;
    if (!flow || (flow->watches != Py_None && PyList_GET_SIZE(flow->watches))) return 0;
    const Message *message = flow->message;
    if (!v2 && (length < message->min_length || length > message->length)) return 0;
    if (message->target_at >= 0 && message->target_at < length && data[head + message->target_at]) return 0;
    if (flow->steady != Py_None && (PyBytes_GET_SIZE(flow->steady) != length ||
                                    memcmp(PyBytes_AS_STRING(flow->steady), data + head, (size_t)length))) return 0;
    const uint8_t *sent = data + head + length;
    unsigned seq = data[v2 ? 4 : 2];
    uint64_t seen_key = (uint64_t)source << 24 | (uint64_t)seq << 16 | sent[0] | (uint64_t)sent[1] << 8;
    uint16_t crc = 0xFFFF;
    for (int i = 1; i < head + length; i++) crc = (uint16_t)(crc >> 8 ^ crc_table[(crc ^ data[i]) & 0xFF]);
    crc = (uint16_t)(crc >> 8 ^ crc_table[(crc ^ message->crc_extra) & 0xFF]);
    if (sent[0] != (crc & 0xFF) || sent[1] != crc >> 8) return 0;
    *found = (Found){flow, data, size, seq, seen_key};
    return 1;
}

/* True if the sequence has room for the frames of a whole datagram, and there was no pause in it. */
static int has_room(const Source *s, double now) { return !s->n || (s->n <= SEQUENCE - FRAMES && now - s->at < PAUSE_S); }

static void append_seq(Source *s, unsigned seq, int size, double now) {
    if (!s->n) s->first_at = now;
    s->seqs[s->n++] = (uint8_t)seq;
    s->bytes += size;
    s->at = now;
}

static void send_to(FastPath *path, const Flow *flow, const uint8_t *data, int size, int frames) {
    for (int i = 0; i < flow->n_outs; i++) {
        Out *out = flow->outs[i];
        if (out->n == BURST) out_flush(out); /* it stays in the list */
        if (!out->waits) out->waits = 1, out->next_waiting = path->waiting, path->waiting = out;
        TOUCH(path->touched_outs, out);
        out->parts[out->n] = (struct iovec){(void *)data, (size_t)size};
        out->frames[out->n++] = frames;
    }
}

static int same_outs(const Flow *a, const Flow *b) {
    return a->n_outs == b->n_outs && !memcmp(a->outs, b->outs, (size_t)a->n_outs * sizeof *a->outs);
}

/* Forward one datagram. 1: done. 0: Python has to handle it; nothing changed. -1: an exception; nothing changed. */
static int forward_datagram(FastPath *path, Peer *peer, const uint8_t *data, int size, double now, uint64_t unix_us) {
    Table *table = path->table;
    Found found[FRAMES];
    int n = 0, together = size <= WHOLE_BYTES;
    if (swap_is_due(&table->seen, now)) return 0; /* twice a second: Python does it with this datagram */
    for (int at = 0; at < size; at += found[n++].size) {
        if (n == FRAMES || !find_frame(path, peer, data + at, size - at, &found[n])) return 0;
        uint32_t first = first_heard(&table->seen, found[n].seen_key);
        if (first && first != peer->channel_id) return 0;
        if (!same_outs(found[n].flow, found[0].flow)) together = 0;
    }
    if (!n || table->seen.newer.count + n > MAX_REMEMBERED) return 0;
    for (int i = 0; i < n; i++)
        if (!has_room(found[i].flow->source, now)) return 0;
    if (table->recording && !reserve(table, (size_t)size + (size_t)n * TLOG_TIME_BYTES)) return -1;
    for (int i = 0; i < found[0].flow->n_outs; i++)
        if (!found[0].flow->outs[i]->whole) together = 0;
    for (int i = 0; i < n; i++) { /* nothing fails from here on */
        Found *f = &found[i];
        Flow *flow = f->flow;
        Source *source = flow->source;
        if (!first_heard(&table->seen, f->seen_key)) remember(&table->seen, f->seen_key, peer->channel_id);
        TOUCH(path->touched_sources, source);
        TOUCH(path->touched_flows, flow);
        append_seq(source, f->seq, f->size, now);
        flow->newest = f->raw, flow->newest_size = f->size, flow->count++;
        *(flow->n_outs ? &table->forwarded : &table->local) += 1;
        if (table->recording) record(table, f->raw, (size_t)f->size, unix_us);
        if (!together) send_to(path, flow, f->raw, f->size, 1);
    }
    if (together) send_to(path, found[0].flow, data, size, n);
    TOUCH(path->touched_peers, peer);
    peer->frames += n, peer->bytes += size, peer->at = now;
    return 1;
}

/* -- a burst */

/* The newest frame of a flow: Frame(raw, seq, sysid, compid, msgid, info). NULL: an exception. */
static PyObject *newest_frame(const FastPath *path, const Flow *flow) {
    const uint8_t *raw = flow->newest, *ids = raw + (raw[0] == 0xFD ? 4 : 2); /* seq sysid compid */
    PyObject *args[] = {
        PyBytes_FromStringAndSize((const char *)raw, flow->newest_size),
        PyLong_FromLong(ids[0]), PyLong_FromLong(ids[1]), PyLong_FromLong(ids[2]), PyLong_FromLong((long)flow->msgid),
        flow->message->info,
    };
    PyObject *frame = NULL;
    if (args[0] && args[1] && args[2] && args[3] && args[4])
        frame = PyObject_Vectorcall(path->table->frame_type, args, 6, NULL);
    for (int i = 0; i < 5; i++) Py_XDECREF(args[i]);
    return frame;
}

/* Put the newest frame and its time into the slot of the vehicle's message cache, and count. */
static int update_state(FastPath *path, Flow *flow, long long count, PyObject *now) {
    PyObject *frame = newest_frame(path, flow);
    int good = frame && !PyObject_SetAttr(flow->slot, s_frame, frame) && !PyObject_SetAttr(flow->slot, s_at, now) &&
               add(flow->slot, s_count, count);
    Py_XDECREF(frame);
    return good;
}

static int report_flow(FastPath *path, Flow *flow, PyObject *now) {
    long long count = flow->count;
    flow->count = 0;
    if (flow->slot != Py_None && !update_state(path, flow, count, now)) return 0;
    if (flow->again == Py_None) return 1;
    PyObject *done = PyObject_CallOneArg(flow->again, now);
    Py_XDECREF(done);
    return done != NULL;
}

static int report_source(Source *s) {
    PyObject *at = PyFloat_FromDouble(s->at), *stats = Py_NewRef(s->stats), *done = NULL;
    PyObject *seqs = PyBytes_FromStringAndSize((const char *)s->seqs, s->n);
    PyObject *size = PyLong_FromLongLong(s->bytes), *first_at = PyFloat_FromDouble(s->first_at);
    s->n = 0, s->bytes = 0;
    if (at && seqs && size && first_at && !PyDict_SetItem(s->heard, s->key, at))
        done = PyObject_CallMethodObjArgs(stats, s_on_burst, seqs, size, first_at, at, NULL);
    Py_XDECREF(done), Py_XDECREF(first_at), Py_XDECREF(size), Py_XDECREF(seqs), Py_XDECREF(at);
    Py_DECREF(stats);
    return done != NULL;
}

static int report_peer(Peer *peer) {
    PyObject *at = PyFloat_FromDouble(peer->at);
    int good = at && add(peer->channel, s_rx_frames, peer->frames) && add(peer->channel, s_rx_bytes, peer->bytes) &&
               add(peer->parser_stats, s_good, peer->frames) && !PyObject_SetAttr(peer->channel, s_last_rx_at, at);
    Py_XDECREF(at);
    peer->frames = peer->bytes = 0;
    return good;
}

/* Report each item of a list, after taking it out: the list ends empty even if a report fails. */
#define REPORT(list, item, report, faults, where) \
    while ((item = (list))) { \
        (list) = item->next, item->touched = 0; \
        if (!(report)) set_aside(faults, where); \
    }

/* Report the collected counts to Python's objects. Calls only `SourceStats.on_burst`, which counts; but a call of Python
   may run signal handlers and the garbage collector, which may do anything. */
static int report_path_counts(FastPath *path) {
    Faults faults = {0};
    Out *out;
    Source *source;
    Peer *peer;
    REPORT(path->touched_outs, out, out_report(out), &faults, (PyObject *)path);
    REPORT(path->touched_sources, source, report_source(source), &faults, (PyObject *)path);
    REPORT(path->touched_peers, peer, report_peer(peer), &faults, (PyObject *)path);
    return none_of(&faults);
}

/* The same for all fast paths of a table. If the next one is closed meanwhile the loop ends early. */
static int report_counts(FastPath *paths) {
    Faults faults = {0};
    for (FastPath *path = paths, *next; path; path = next) {
        Py_INCREF(path);
        if (!report_path_counts(path)) set_aside(&faults, (PyObject *)path);
        next = path->next;
        Py_DECREF(path);
    }
    return none_of(&faults);
}

/* Release everything that a closed fast path holds. */
static void release(FastPath *path) {
    path->touched_flows = NULL; /* see `forget_flows` */
    map_clear(&path->flows, free_flow), map_clear(&path->sources, free_source), map_clear(&path->peers, free_peer);
    Py_CLEAR(path->clock);
    Py_CLEAR(path->slow);
    Py_CLEAR(path->after);
    Py_CLEAR(path->broken);
}

/* Reverse the list: flows are linked newest first, and events must follow the order in which the frames came. */
static Flow *in_order(Flow *list) {
    Flow *done = NULL;
    while (list) {
        Flow *next = list->next;
        list->next = done, done = list, list = next;
    }
    return done;
}

/* Send what waits and report the newest frames. Python may close the fast path meanwhile: flows live until the end. */
static int settle(FastPath *path, PyObject *now) {
    Faults faults = {0};
    Flow *flow;
    flush_waiting(path);
    path->settling = 1;
    path->touched_flows = in_order(path->touched_flows);
    REPORT(path->touched_flows, flow, report_flow(path, flow, now), &faults, (PyObject *)path);
    path->settling = 0;
    if (path->fd < 0) release(path);
    return none_of(&faults);
}

/* Hand the datagram to Python, after everything before it was sent and reported, even if some of that failed. */
static int leave_to_python(FastPath *path, const uint8_t *data, int size, const struct sockaddr_in *from, PyObject *now) {
    Faults faults = {0};
    if (!settle(path, now)) set_aside(&faults, (PyObject *)path);
    if (!report_counts(path->table->paths)) set_aside(&faults, (PyObject *)path);
    if (path->fd >= 0) {
        PyObject *slow = Py_NewRef(path->slow); /* it may close the fast path */
        PyObject *address = address_tuple(from);
        PyObject *done = address ? PyObject_CallFunction(slow, "y#OO", (const char *)data, (Py_ssize_t)size, address, now) : NULL;
        if (!done) set_aside(&faults, slow);
        Py_XDECREF(done), Py_XDECREF(address);
        Py_DECREF(slow);
    }
    return none_of(&faults);
}

static uint64_t unix_time_us(void) {
    struct timespec clock;
    clock_gettime(CLOCK_REALTIME, &clock);
    return (uint64_t)clock.tv_sec * 1000000u + (uint64_t)clock.tv_nsec / 1000u;
}

static long long monotonic_ns(void) {
    struct timespec clock;
    clock_gettime(CLOCK_MONOTONIC, &clock);
    return (long long)clock.tv_sec * 1000000000 + clock.tv_nsec;
}

/* What one call of `ready` may take of the loop: bytes of datagrams that are left to Python, and time. */
typedef struct { long long left_bytes, ends_at_ns; } Share;

/* Handle the datagrams that wait until the share is spent, even if one fails: they are out of the kernel and would be
   lost. What is left waits for the next call. Python may close the path. */
static int burst(FastPath *path, PyObject *now, Share share) {
    Faults faults = {0};
    double seconds = PyFloat_AS_DOUBLE(now);
    uint64_t unix_us = unix_time_us();
    for (int spent = 0; path->first < path->got && path->fd >= 0 && !spent;) {
        int i = path->first++, size = (int)path->messages[i].msg_len, passed = 0;
        const uint8_t *data = path->slots + (size_t)i * (size_t)path->largest;
        if (path->messages[i].msg_hdr.msg_flags & MSG_TRUNC) {
            path->too_large++;
            continue;
        }
        if (path->epoch != path->table->epoch && !forget_flows(path)) set_aside(&faults, (PyObject *)path);
        Peer *peer = map_get(&path->peers, address_key(&path->from[i]));
        if (peer) passed = forward_datagram(path, peer, data, size, seconds, unix_us);
        if (passed < 0) set_aside(&faults, (PyObject *)path);
        if (passed > 0) continue;
        if (!leave_to_python(path, data, size, &path->from[i], now)) set_aside(&faults, (PyObject *)path);
        unix_us = unix_time_us(); /* Python recorded frames meanwhile: no record may be older than the one before it */
        share.left_bytes -= size;
        spent = share.left_bytes <= 0 || monotonic_ns() >= share.ends_at_ns;
    }
    path->kept = path->fd >= 0 ? path->got - path->first : 0;
    if (!settle(path, now)) set_aside(&faults, (PyObject *)path);
    return none_of(&faults);
}

/* Handle what was kept, else receive at most BURST datagrams and handle them. False: an exception; an error of the
   socket goes to `broken` instead. */
static int receive(FastPath *path, PyObject *now, Share share) {
    if (path->first < path->got) return burst(path, now, share);
    for (int i = 0; i < BURST; i++) {
        path->parts[i] = (struct iovec){path->slots + (size_t)i * (size_t)path->largest, (size_t)path->largest};
        path->messages[i].msg_hdr = (struct msghdr){.msg_name = &path->from[i], .msg_namelen = sizeof path->from[i],
                                                    .msg_iov = &path->parts[i], .msg_iovlen = 1};
    }
    int got = recvmmsg(path->fd, path->messages, BURST, MSG_DONTWAIT, NULL);
    path->first = 0, path->got = got > 0 ? got : 0;
    if (got >= 0) return burst(path, now, share);
    if (errno == EAGAIN || errno == EWOULDBLOCK) return 1;
    PyErr_SetFromErrno(PyExc_OSError);
    PyObject *error = take_exception(), *broken = Py_NewRef(path->broken); /* it may close the fast path */
    PyObject *done = error ? PyObject_CallOneArg(broken, error) : NULL;
    Py_XDECREF(done), Py_XDECREF(error);
    Py_DECREF(broken);
    return done != NULL;
}

/* ready(left_bytes, seconds): the socket can be read, or datagrams are `kept`. A socket error goes to `broken`; a callback's
   exception is raised. */
static PyObject *fast_path_ready(FastPath *path, PyObject *args) {
    Share share;
    double share_s;
    if (!PyArg_ParseTuple(args, "Ld", &share.left_bytes, &share_s)) return NULL;
    share.ends_at_ns = monotonic_ns() + (long long)(share_s * 1e9);
    if (is_receiving) return PyErr_SetString(PyExc_RuntimeError, "this fast path is receiving already"), NULL;
    if (!is_open(path)) Py_RETURN_NONE;
    PyObject *now = PyObject_CallNoArgs(path->clock);
    if (!now) return NULL;
    if (!PyFloat_Check(now)) return Py_DECREF(now), PyErr_SetString(PyExc_TypeError, "the clock must return a float (seconds)"), NULL;
    if (path->fd < 0) { /* the clock closed it */
        Py_DECREF(now);
        Py_RETURN_NONE;
    }
    PyObject *after = Py_NewRef(path->after); /* any callback may close the fast path, which releases them, ... */
    Py_INCREF(path); /* ... and drop the last reference to it */
    Faults faults = {0};
    is_receiving = 1;
    if (!receive(path, now, share)) set_aside(&faults, (PyObject *)path);
    is_receiving = 0;
    if (path->table->records_size >= RECORDS_BYTES) {
        PyObject *done = PyObject_CallNoArgs(after);
        if (!done) set_aside(&faults, after);
        Py_XDECREF(done);
    }
    Py_DECREF(after), Py_DECREF(now), Py_DECREF(path);
    return none_of(&faults) ? Py_NewRef(Py_None) : NULL;
}

static int fast_path_init(FastPath *path, PyObject *args, PyObject *unused) {
    (void)unused;
    PyObject *table, *clock, *slow, *after, *broken;
    int fd, largest;
    if (path->table) return PyErr_SetString(PyExc_TypeError, "a fast path is initialised once"), -1;
    if (!PyArg_ParseTuple(args, "O!iiOOOO", &TableType, &table, &fd, &largest, &clock, &slow, &after, &broken)) return -1;
    if (fd < 0) return PyErr_SetString(PyExc_ValueError, "the socket is closed"), -1;
    if (largest < 1 || largest > LARGEST_BYTES) return PyErr_SetString(PyExc_ValueError, "largest out of range"), -1;
    if (!table_is_made((Table *)table)) return -1;
    if (!(path->slots = PyMem_RawMalloc((size_t)BURST * (size_t)largest))) return PyErr_NoMemory(), -1;
    path->fd = fd, path->largest = largest, path->table = (Table *)Py_NewRef(table);
    path->clock = Py_NewRef(clock), path->slow = Py_NewRef(slow), path->after = Py_NewRef(after), path->broken = Py_NewRef(broken);
    path->next = path->table->paths, path->table->paths = path;
    return 0;
}

/* The socket is about to be closed: report and release everything; within `settle`, at its end. Any callback may call it. */
static PyObject *fast_path_close(FastPath *path, PyObject *unused) {
    (void)unused;
    if (!is_open(path)) Py_RETURN_NONE;
    flush_waiting(path);
    int good = report_path_counts(path);
    PyObject *fault = good ? NULL : take_exception();
    path->fd = -1, path->kept = 0;
    for (FastPath **at = &path->table->paths; *at; at = &(*at)->next)
        if (*at == path) {
            *at = path->next;
            break;
        }
    path->next = NULL;
    if (!path->settling) release(path);
    if (fault) return raise_exception(fault), NULL;
    Py_RETURN_NONE;
}

static void fast_path_finalize(PyObject *path) {
    PyObject *pending = take_exception(), *done = fast_path_close((FastPath *)path, NULL);
    if (!done) PyErr_WriteUnraisable(NULL);
    Py_XDECREF(done);
    if (pending) raise_exception(pending);
}

static void fast_path_dealloc(FastPath *path) {
    if (PyObject_CallFinalizerFromDealloc((PyObject *)path) < 0) return; /* the finalizer's callbacks made a new reference */
    Py_XDECREF(path->table), PyMem_RawFree(path->slots);
    Py_TYPE(path)->tp_free(path);
}

/* -- the module */

static PyMethodDef table_methods[] = {
    {"first_heard_on", (PyCFunction)table_first_heard_on, METH_VARARGS, "As core.routing.router.DuplicateFilter's; keys are integers."},
    {"invalidate", (PyCFunction)table_invalidate, METH_NOARGS, "Close all flows: the routing table changed."},
    {"take", (PyCFunction)table_take, METH_NOARGS, "(forwarded, local, tlog records, their number) since the last call."},
    {0},
};
static PyMemberDef table_members[] = {
    {"records_waiting", T_LONGLONG, offsetof(Table, n_records), READONLY, "tlog records that `take` would return."},
    {0},
};
static PyMemberDef fast_path_members[] = {
    {"kept", T_LONGLONG, offsetof(FastPath, kept), READONLY, "Datagrams that were received and wait for the next call of `ready`."},
    {"too_large", T_LONGLONG, offsetof(FastPath, too_large), READONLY, "Datagrams that were dropped as they are larger than `largest`."},
    {0},
};
static PyMethodDef fast_path_methods[] = {
    {"add_peer", (PyCFunction)fast_path_add_peer, METH_VARARGS, "add_peer(address, channel, parser_stats, channel_id)"},
    {"remove_peer", (PyCFunction)fast_path_remove_peer, METH_O, "remove_peer(address)"},
    {"add_flow", (PyCFunction)fast_path_add_flow, METH_VARARGS, "add_flow(address, source, msgid, stats, heard, outs, slot, watches, steady, again)"},
    {"ready", (PyCFunction)fast_path_ready, METH_VARARGS, "ready(left_bytes, seconds): to be called when the socket can be read, or datagrams are kept."},
    {"close", (PyCFunction)fast_path_close, METH_NOARGS, "Report all counts and release everything."},
    {0},
};
#define TYPE(NAME, SIZE, METHODS, MEMBERS, INIT, DEALLOC) \
    {PyVarObject_HEAD_INIT(NULL, 0).tp_name = "skygcs.links._fast_path." NAME, .tp_basicsize = SIZE, .tp_flags = Py_TPFLAGS_DEFAULT, \
     .tp_new = PyType_GenericNew, .tp_methods = METHODS, .tp_members = MEMBERS, .tp_init = (initproc)INIT, .tp_dealloc = (destructor)DEALLOC}
static PyTypeObject TableType = TYPE("Table", sizeof(Table), table_methods, table_members, table_init, table_dealloc);
static PyTypeObject OutType = TYPE("Out", sizeof(Out), NULL, NULL, out_init, out_dealloc);
static PyTypeObject FastPathType = TYPE("FastPath", sizeof(FastPath), fast_path_methods, fast_path_members, fast_path_init, fast_path_dealloc);
/* Raised with every change of what Python and this file expect of each other; links/fast_path.py has the same number. */
#define INTERFACE 4

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_fast_path", "The fast path of UDP; see links/fast_path.py.", -1, NULL, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__fast_path(void) {
    static const struct { PyObject **at; const char *name; } names[] = {
        {&s_rx_frames, "rx_frames"}, {&s_rx_bytes, "rx_bytes"}, {&s_last_rx_at, "last_rx_at"}, {&s_good, "good"},
        {&s_on_burst, "on_burst"}, {&s_tx_frames, "tx_frames"}, {&s_tx_bytes, "tx_bytes"},
        {&s_tx_dropped, "tx_dropped"}, {&s_frame, "frame"}, {&s_at, "at"}, {&s_count, "count"},
    };
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (!(*names[i].at = PyUnicode_InternFromString(names[i].name))) return NULL;
    for (unsigned i = 0; i < 256; i++) { /* CRC-16/MCRF4XX */
        unsigned crc = i;
        for (int bit = 0; bit < 8; bit++) crc = crc & 1 ? crc >> 1 ^ 0x8408 : crc >> 1;
        crc_table[i] = (uint16_t)crc;
    }
    if (getrandom(&hash_seed, sizeof hash_seed, GRND_NONBLOCK) != sizeof hash_seed)
        hash_seed = unix_time_us() ^ (uint64_t)getpid() << 40; /* early after boot there may be no randomness yet */
    FastPathType.tp_finalize = fast_path_finalize;
    PyObject *made = PyModule_Create(&module);
    if (made && PyModule_AddIntConstant(made, "INTERFACE", INTERFACE)) {
        Py_DECREF(made);
        return NULL;
    }
    if (made && !PyModule_AddType(made, &TableType) && !PyModule_AddType(made, &OutType) && !PyModule_AddType(made, &FastPathType)) return made;
    Py_XDECREF(made);
    return NULL;
}
