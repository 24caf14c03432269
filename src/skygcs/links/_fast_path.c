/* The express lane of UDP: datagrams whose way is known go from socket to socket without Python.
 *
 * It knows no routing rule. Every frame goes the Python way first: links.udp, core.mavlink.parser, runtime.hub,
 * core.routing. Where that finds that all further frames of this source and message will go the same way, it says so
 * here (`Lane.add_flow`: a *flow*). A datagram takes the lane only if each of its frames is complete, has a right
 * CRC, is addressed to nobody, belongs to a flow and is no copy of what came over another channel; else it is handed to
 * Python whole, with nothing done to it, after what came before it was sent and counted. Any change of the routing
 * table ends all flows (`Table.invalidate`). So the lane can be left out at any time, and nothing but the speed changes.
 *
 * What Python would have noted per frame is gathered. The newest frame of a message is told at the end of each burst;
 * counters, sequence numbers, when somebody was last heard and tlog records when somebody wants to know
 * (`Table.take`: once a second, before anything is recorded, shown or goes the Python way). A frame alone in its burst,
 * as at 1,000 a second, so costs no call of Python. Numbers in docs/performance.md, reasons in
 * docs/decisions/0003-express-lane.md.
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
    DATAGRAM_BYTES = 65536,
    FRAMES = 256,               /* in one datagram; more go through Python */
    MAX_FLOWS = 16384,          /* 250 vehicles of some 20 messages, on three links; then all are learned anew */
    WHOLE_BYTES = 1472,         /* runtime.hub.WHOLE_DATAGRAM_BYTES */
    SEQUENCE = 512,             /* core.linkstats.BURST_MAX */
    TLOG_TIME_BYTES = 8,
    RECORDS_BYTES = 65536,      /* tlog records that wait for `Table.take`; with more it is asked for */
    RECORDS_KEPT_BYTES = 4 * RECORDS_BYTES, /* room for records that is kept; a burst of full datagrams takes 8 MB */
    PEER_NUMBERS = 1 << 24,     /* a flow's key is peer number, source and msgid: 24 + 16 + 24 bits */
};

static const double PAUSE_S = 0.5; /* core.linkstats */

static uint16_t crc_table[256];
static uint8_t *slots; /* BURST datagrams; one set for all lanes, as only one runs at a time */
static int lane_is_running;
static PyObject *s_rx_frames, *s_rx_bytes, *s_last_rx_at, *s_good, *s_on_burst,
    *s_tx_frames, *s_tx_bytes, *s_tx_dropped, *s_frame, *s_at, *s_count;

static PyTypeObject TableType, OutType, LaneType;

/* -- the table all lanes of one hub share: messages, what was heard where, what has to be told */

typedef struct { uint8_t crc_extra, min_length, length; int target_at; PyObject *info; } Message;

typedef struct Lane Lane;
static int tell_counts(Lane *lanes);

typedef struct {
    PyObject_HEAD
    Lane *lanes;
    Map messages; /* by msgid + 1 */
    Seen seen;
    uint64_t epoch;
    PyTypeObject *frame_type;
    Py_ssize_t frame_slots[6];
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

/* `__new__` alone makes no table. */
static int table_is_made(const Table *table) {
    return table->seen.older.at ? 1 : (PyErr_SetString(PyExc_RuntimeError, "the table was not initialised"), 0);
}

static PyObject *table_first_heard_on(Table *table, PyObject *args) {
    unsigned long long key, channel;
    double now;
    if (!table_is_made(table) || !PyArg_ParseTuple(args, "KKd", &key, &channel, &now)) return NULL;
    if (key > GREATEST_KEY || !channel || channel > GREATEST_CHANNEL)
        return PyErr_SetString(PyExc_ValueError, "key or channel id out of range"), NULL;
    if (turn_is_due(&table->seen, now)) turn(&table->seen, now);
    uint32_t first = first_heard(&table->seen, key);
    if (!first) remember(&table->seen, key, first = (uint32_t)channel);
    return PyLong_FromUnsignedLong(first);
}

static PyObject *table_invalidate(Table *table, PyObject *unused) {
    (void)unused;
    table->epoch++;
    if (!tell_counts(table->lanes)) return NULL; /* now, while all channels are still there */
    Py_RETURN_NONE;
}

static int add_message(Table *table, PyObject *msgid, PyObject *row) {
    unsigned long id = PyLong_AsUnsignedLong(msgid);
    if (id == (unsigned long)-1 && PyErr_Occurred()) return 0;
    if (id > 0xFFFFFF || !PyTuple_Check(row)) return PyErr_SetString(PyExc_ValueError, "messages are {msgid: tuple}"), 0;
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
    PyObject *messages, *msgid, *row;
    PyTypeObject *frame_type;
    Py_ssize_t at = 0;
    if (table->frame_type) return PyErr_SetString(PyExc_TypeError, "a table is made once"), -1;
    if (!PyArg_ParseTuple(args, "O!O!p", &PyDict_Type, &messages, &PyType_Type, &frame_type, &table->recording)) return -1;
    table->frame_type = (PyTypeObject *)Py_NewRef(frame_type);
    static const char *const names[] = {"raw", "seq", "sysid", "compid", "msgid", "info"};
    for (int i = 0; i < 6; i++) {
        PyObject *slot = PyObject_GetAttrString((PyObject *)table->frame_type, names[i]);
        int is_slot = slot && Py_TYPE(slot) == &PyMemberDescr_Type;
        if (is_slot) table->frame_slots[i] = ((PyMemberDescrObject *)slot)->d_member->offset;
        Py_XDECREF(slot);
        if (!is_slot) return PyErr_Format(PyExc_TypeError, "a frame has a slot %s", names[i]), -1;
    }
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

/* (frames forwarded, frames for nobody but us, tlog records, their number) since the last call; all else is told. */
static PyObject *table_take(Table *table, PyObject *unused) {
    (void)unused;
    Faults faults = {0};
    if (!tell_counts(table->lanes)) set_aside(&faults, (PyObject *)table);
    PyObject *taken = NULL;
    if (none_of(&faults))
        taken = Py_BuildValue("LLy#L", table->forwarded, table->local, table->records ? (const char *)table->records : "",
                              (Py_ssize_t)table->records_size, table->n_records);
    if (!taken) return NULL; /* what was gathered is kept for the next call */
    table->forwarded = table->local = table->n_records = 0;
    table->records_size = 0;
    if (table->records_room > RECORDS_KEPT_BYTES) {
        PyMem_Free(table->records);
        table->records = NULL, table->records_room = 0;
    }
    return taken;
}

/* Room for so many more bytes of records. False: no memory, and nothing has changed. */
static int reserve(Table *table, size_t size) {
    size_t wanted = table->records_size + size;
    if (wanted <= table->records_room) return 1;
    uint8_t *more = PyMem_Realloc(table->records, wanted * 2);
    if (!more) return PyErr_NoMemory(), 0;
    table->records = more, table->records_room = wanted * 2;
    return 1;
}

/* Cannot fail: there is room. */
static void record(Table *table, const uint8_t *raw, size_t size, uint64_t unix_us) {
    uint8_t *to = table->records + table->records_size;
    for (int i = 0; i < TLOG_TIME_BYTES; i++) to[i] = (uint8_t)(unix_us >> (56 - 8 * i));
    memcpy(to + TLOG_TIME_BYTES, raw, size);
    table->records_size += TLOG_TIME_BYTES + size;
    table->n_records++;
}

/* -- where frames go to: one UDP peer */

/* It is in its lane's list `waiting` exactly while `waits` (only `flush_waiting` takes it out), and in `touched_outs`
   exactly while `touched`. Only one lane runs at a time, and what waits is sent before Python is called: so no Out is in
   the lists of two lanes, and none in a list goes away, as the flows that own it are let go of later. */
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
    if (out->channel) return PyErr_SetString(PyExc_TypeError, "an out is made once"), -1;
    if (!PyArg_ParseTuple(args, "iO!Op", &out->fd, &PyTuple_Type, &address, &channel, &out->whole)) return -1;
    if (!address_from(address, &out->to)) return -1;
    out->channel = PyWeakref_NewRef(channel, NULL);
    return out->channel ? 0 : -1;
}

static void out_dealloc(Out *out) {
    Py_XDECREF(out->channel);
    Py_TYPE(out)->tp_free(out);
}

/* Send what it holds. What a socket does not take is dropped and counted, as UdpChannel.send does. */
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

/* A channel that is gone is not told. */
static int out_tell(Out *out) {
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

/* -- a lane: one UDP socket. What was touched is linked in lists, to be told of */

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
    uint8_t seqs[SEQUENCE]; /* since the last `tell_source`: core.linkstats counts what was lost */
    struct Source *next;
} Source;

typedef struct Flow {
    Source *source;
    Out **outs;
    int n_outs, newest_size, touched;
    uint32_t msgid;
    const Message *message;
    PyObject *slot, *watches; /* or None */
    PyObject *steady, *again;        /* steady: None, or the payload it has to have; again(now): once a burst */
    const uint8_t *newest;           /* in the burst's slots */
    long long count;
    struct Flow *next;
} Flow;

struct Lane {
    PyObject_HEAD
    Table *table;
    Lane *next;
    PyObject *clock, *slow, *after, *broken; /* see `Lane` in _fast_path.pyi */
    int fd, settling; /* fd: -1 once it is closed */
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

/* Values whose making failed half-way are freed as well. */

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

static void flush_waiting(Lane *lane) {
    Out *out;
    while ((out = lane->waiting)) {
        lane->waiting = out->next_waiting;
        out->waits = 0;
        out_flush(out);
    }
}

/* All flows end. What waits is sent and what was gathered is told before: its owners are let go of. False: an exception. */
static int forget_flows(Lane *lane) {
    flush_waiting(lane);
    int told = tell_counts(lane->table->lanes);
    PyObject *fault = told ? NULL : take_exception();
    lane->touched_flows = NULL; /* there are none: `settle` shows them before Python can end them */
    lane->epoch = lane->table->epoch;
    map_clear(&lane->flows, free_flow);
    map_clear(&lane->sources, free_source);
    if (fault) raise_exception(fault);
    return told;
}

static uint64_t source_key(const Peer *peer, unsigned source) { return (uint64_t)peer->number << 16 | source; }
static uint64_t flow_key(const Peer *peer, unsigned source, uint32_t msgid) { return source_key(peer, source) << 24 | msgid; }

static int lane_is_open(const Lane *lane) { return lane->table && lane->fd >= 0; }

/* A number that no peer has. They are counted up, so that it was nobody's for a long time. */
static uint32_t free_number(Lane *lane) {
    int taken;
    do {
        if (++lane->last_number >= PEER_NUMBERS) lane->last_number = 1;
        taken = 0;
        for (size_t i = 0; lane->peers.cells && i <= lane->peers.mask && !taken; i++) {
            const Peer *other = lane->peers.cells[i].value;
            taken = other && other->number == lane->last_number;
        }
    } while (taken);
    return lane->last_number;
}

static PyObject *lane_add_peer(Lane *lane, PyObject *args) {
    PyObject *address, *channel, *parser_stats;
    struct sockaddr_in from;
    unsigned long long channel_id;
    if (!PyArg_ParseTuple(args, "O!OOK", &PyTuple_Type, &address, &channel, &parser_stats, &channel_id)) return NULL;
    if (!address_from(address, &from)) return NULL;
    if (!channel_id || channel_id > GREATEST_CHANNEL) return PyErr_SetString(PyExc_ValueError, "channel id out of range"), NULL;
    if (!lane_is_open(lane)) Py_RETURN_NONE;
    if (!tell_counts(lane->table->lanes)) return NULL;
    Peer *peer = PyMem_Calloc(1, sizeof *peer), *before = map_get(&lane->peers, address_key(&from));
    if (!peer) return PyErr_NoMemory();
    *peer = (Peer){.number = free_number(lane), .channel_id = (uint32_t)channel_id, .channel = Py_NewRef(channel),
                   .parser_stats = Py_NewRef(parser_stats)};
    if (!map_put(&lane->peers, address_key(&from), peer)) return free_peer(peer), NULL;
    if (before) free_peer(before);
    Py_RETURN_NONE;
}

/* It is removed whatever else fails. */
static PyObject *lane_remove_peer(Lane *lane, PyObject *address) {
    struct sockaddr_in from;
    if (!PyTuple_Check(address)) return PyErr_SetString(PyExc_TypeError, "an address is a tuple"), NULL;
    if (!address_from(address, &from)) return NULL;
    if (!lane_is_open(lane)) Py_RETURN_NONE;
    int told = tell_counts(lane->table->lanes);
    PyObject *fault = told ? NULL : take_exception();
    Peer *peer = map_remove(&lane->peers, address_key(&from));
    if (peer) free_peer(peer);
    if (fault) return raise_exception(fault), NULL;
    Py_RETURN_NONE;
}

static Source *new_source(Lane *lane, uint64_t key, unsigned source, PyObject *stats, PyObject *heard) {
    Source *made = PyMem_Calloc(1, sizeof *made);
    if (!made) return PyErr_NoMemory(), NULL;
    made->stats = Py_NewRef(stats), made->heard = Py_NewRef(heard), made->key = PyLong_FromUnsignedLong(source);
    if (made->key && map_put(&lane->sources, key, made)) return made;
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
   and message from this peer go to `outs` (empty: to nobody but us), until the table changes. */
static PyObject *lane_add_flow(Lane *lane, PyObject *args) {
    PyObject *address, *stats, *heard, *outs, *slot, *watches, *steady, *again;
    struct sockaddr_in from;
    unsigned source;
    unsigned long msgid;
    if (!PyArg_ParseTuple(args, "O!IkOO!O!OOOO", &PyTuple_Type, &address, &source, &msgid, &stats, &PyDict_Type, &heard,
                          &PyTuple_Type, &outs, &slot, &watches, &steady, &again) || !address_from(address, &from)) return NULL;
    for (Py_ssize_t i = 0; i < PyTuple_GET_SIZE(outs); i++)
        if (Py_TYPE(PyTuple_GET_ITEM(outs, i)) != &OutType) return PyErr_SetString(PyExc_TypeError, "outs are Out"), NULL;
    if (watches != Py_None && !PyList_Check(watches)) return PyErr_SetString(PyExc_TypeError, "watches is a list"), NULL;
    if (steady != Py_None && !PyBytes_Check(steady)) return PyErr_SetString(PyExc_TypeError, "steady is bytes"), NULL;
    if (source > 0xFFFF || msgid > 0xFFFFFF) return PyErr_SetString(PyExc_ValueError, "source or msgid out of range"), NULL;
    if (lane->settling || !lane_is_open(lane)) Py_RETURN_NONE;
    if ((lane->epoch != lane->table->epoch || lane->flows.filled >= MAX_FLOWS) && !forget_flows(lane)) return NULL;
    Peer *peer = map_get(&lane->peers, address_key(&from));
    Message *message = map_get(&lane->table->messages, msgid + 1);
    if (!peer || !message || map_get(&lane->flows, flow_key(peer, source, (uint32_t)msgid))) Py_RETURN_NONE;
    Source *known = map_get(&lane->sources, source_key(peer, source));
    if (!known && !(known = new_source(lane, source_key(peer, source), source, stats, heard))) return NULL;
    Flow *flow = new_flow(known, (uint32_t)msgid, message, outs);
    if (!flow) return NULL;
    flow->slot = Py_NewRef(slot), flow->watches = Py_NewRef(watches);
    flow->steady = Py_NewRef(steady), flow->again = Py_NewRef(again);
    if (!map_put(&lane->flows, flow_key(peer, source, flow->msgid), flow)) return free_flow(flow), NULL;
    Py_RETURN_NONE;
}

/* -- one datagram */

typedef struct { Flow *flow; const uint8_t *raw; int size; unsigned seq; uint64_t seen_key; } Found;

/* The frame at the start of `data` and its flow; 0 if it has to take the Python way. */
static int find_frame(const Lane *lane, const Peer *peer, const uint8_t *data, int left, Found *found) {
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
    Flow *flow = size <= left ? map_get(&lane->flows, flow_key(peer, source, msgid)) : NULL;
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

/* Whether a datagram's frames of this source fit into its sequence, in which there is no pause. */
static int has_room(const Source *s, double now) { return !s->n || (s->n <= SEQUENCE - FRAMES && now - s->at < PAUSE_S); }

static void note_seq(Source *s, unsigned seq, int size, double now) {
    if (!s->n) s->first_at = now;
    s->seqs[s->n++] = (uint8_t)seq;
    s->bytes += size;
    s->at = now;
}

static void send_to(Lane *lane, const Flow *flow, const uint8_t *data, int size, int frames) {
    for (int i = 0; i < flow->n_outs; i++) {
        Out *out = flow->outs[i];
        if (out->n == BURST) out_flush(out); /* and it goes on waiting */
        if (!out->waits) out->waits = 1, out->next_waiting = lane->waiting, lane->waiting = out;
        TOUCH(lane->touched_outs, out);
        out->parts[out->n] = (struct iovec){(void *)data, (size_t)size};
        out->frames[out->n++] = frames;
    }
}

static int same_outs(const Flow *a, const Flow *b) {
    return a->n_outs == b->n_outs && !memcmp(a->outs, b->outs, (size_t)a->n_outs * sizeof *a->outs);
}

/* 1: done with. 0: for Python, untouched. -1: an exception, untouched as well. */
static int pass(Lane *lane, Peer *peer, const uint8_t *data, int size, double now, uint64_t unix_us) {
    Table *table = lane->table;
    Found found[FRAMES];
    int n = 0, together = size <= WHOLE_BYTES;
    if (turn_is_due(&table->seen, now)) return 0; /* twice a second; Python knows whether this datagram has it come */
    for (int at = 0; at < size; at += found[n++].size) {
        if (n == FRAMES || !find_frame(lane, peer, data + at, size - at, &found[n])) return 0;
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
        TOUCH(lane->touched_sources, source);
        TOUCH(lane->touched_flows, flow);
        note_seq(source, f->seq, f->size, now);
        flow->newest = f->raw, flow->newest_size = f->size, flow->count++;
        *(flow->n_outs ? &table->forwarded : &table->local) += 1;
        if (table->recording) record(table, f->raw, (size_t)f->size, unix_us);
        if (!together) send_to(lane, flow, f->raw, f->size, 1);
    }
    if (together) send_to(lane, found[0].flow, data, size, n);
    TOUCH(lane->touched_peers, peer);
    peer->frames += n, peer->bytes += size, peer->at = now;
    return 1;
}

/* -- a burst */

static int tell_slot(Lane *lane, Flow *flow, long long count, PyObject *now) {
    const uint8_t *raw = flow->newest;
    int v2 = raw[0] == 0xFD;
    PyObject *frame = PyType_GenericAlloc(lane->table->frame_type, 0);
    if (frame) { /* its slots filled as Frame.__init__ does, without the call: 6 % of all with vehicles and recording */
        const Py_ssize_t *at = lane->table->frame_slots;
        *(PyObject **)((char *)frame + at[0]) = PyBytes_FromStringAndSize((const char *)raw, flow->newest_size);
        *(PyObject **)((char *)frame + at[1]) = PyLong_FromLong(raw[v2 ? 4 : 2]);
        *(PyObject **)((char *)frame + at[2]) = PyLong_FromLong(raw[v2 ? 5 : 3]);
        *(PyObject **)((char *)frame + at[3]) = PyLong_FromLong(raw[v2 ? 6 : 4]);
        *(PyObject **)((char *)frame + at[4]) = PyLong_FromLong((long)flow->msgid);
        *(PyObject **)((char *)frame + at[5]) = Py_NewRef(flow->message->info);
    }
    int good = frame && !PyErr_Occurred() && !PyObject_SetAttr(flow->slot, s_frame, frame) && !PyObject_SetAttr(flow->slot, s_at, now) &&
               add(flow->slot, s_count, count);
    Py_XDECREF(frame);
    return good;
}

static int tell_flow(Lane *lane, Flow *flow, PyObject *now) {
    long long count = flow->count;
    flow->count = 0;
    if (flow->slot != Py_None && !tell_slot(lane, flow, count, now)) return 0;
    if (flow->again == Py_None) return 1;
    PyObject *done = PyObject_CallOneArg(flow->again, now);
    Py_XDECREF(done);
    return done != NULL;
}

static int tell_source(Source *s) {
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

static int tell_peer(Peer *peer) {
    PyObject *at = PyFloat_FromDouble(peer->at);
    int good = at && add(peer->channel, s_rx_frames, peer->frames) && add(peer->channel, s_rx_bytes, peer->bytes) &&
               add(peer->parser_stats, s_good, peer->frames) && !PyObject_SetAttr(peer->channel, s_last_rx_at, at);
    Py_XDECREF(at);
    peer->frames = peer->bytes = 0;
    return good;
}

/* Tell all that is in a list, each out of it first: whatever fails, the list ends empty. */
#define TELL(list, item, tell, faults, where) \
    while ((item = (list))) { \
        (list) = item->next, item->touched = 0; \
        if (!(tell)) set_aside(faults, where); \
    }

/* Make Python's objects say what they would have been made to say frame by frame. Calls nothing but `SourceStats.on_burst`,
   which only counts; but with it come signal handlers and the garbage collector, which may do anything. */
static int tell_lane(Lane *lane) {
    Faults faults = {0};
    Out *out;
    Source *source;
    Peer *peer;
    TELL(lane->touched_outs, out, out_tell(out), &faults, (PyObject *)lane);
    TELL(lane->touched_sources, source, tell_source(source), &faults, (PyObject *)lane);
    TELL(lane->touched_peers, peer, tell_peer(peer), &faults, (PyObject *)lane);
    return none_of(&faults);
}

/* The same of all lanes of a table. One that is closed meanwhile ends the list early: it was the next to be told. */
static int tell_counts(Lane *lanes) {
    Faults faults = {0};
    for (Lane *lane = lanes, *next; lane; lane = next) {
        Py_INCREF(lane);
        if (!tell_lane(lane)) set_aside(&faults, (PyObject *)lane);
        next = lane->next;
        Py_DECREF(lane);
    }
    return none_of(&faults);
}

/* Of a closed lane: let go of everything. */
static void release(Lane *lane) {
    lane->touched_flows = NULL; /* see `forget_flows` */
    map_clear(&lane->flows, free_flow), map_clear(&lane->sources, free_source), map_clear(&lane->peers, free_peer);
    Py_CLEAR(lane->clock);
    Py_CLEAR(lane->slow);
    Py_CLEAR(lane->after);
    Py_CLEAR(lane->broken);
}

/* Flows are linked newest first; they are shown in the order in which they were first touched, as events follow it. */
static Flow *in_order(Flow *list) {
    Flow *done = NULL;
    while (list) {
        Flow *next = list->next;
        list->next = done, done = list, list = next;
    }
    return done;
}

/* Send what waits and show the newest frames. That calls Python, which may close the lane: its flows live until the end. */
static int settle(Lane *lane, PyObject *now) {
    Faults faults = {0};
    Flow *flow;
    flush_waiting(lane);
    lane->settling = 1;
    lane->touched_flows = in_order(lane->touched_flows);
    TELL(lane->touched_flows, flow, tell_flow(lane, flow, now), &faults, (PyObject *)lane);
    lane->settling = 0;
    if (lane->fd < 0) release(lane);
    return none_of(&faults);
}

/* The datagram takes the Python way, after all that came before it, and whatever failed of that. */
static int to_python(Lane *lane, const uint8_t *data, int size, const struct sockaddr_in *from, PyObject *now) {
    Faults faults = {0};
    if (!settle(lane, now)) set_aside(&faults, (PyObject *)lane);
    if (!tell_counts(lane->table->lanes)) set_aside(&faults, (PyObject *)lane);
    if (lane->fd >= 0) {
        PyObject *slow = Py_NewRef(lane->slow); /* it may close the lane */
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

/* All of them, whatever fails of one: they are out of the kernel and nobody else has them. Python may close the lane. */
static int burst(Lane *lane, int got, struct mmsghdr *messages, struct sockaddr_in *from, PyObject *now) {
    Faults faults = {0};
    double seconds = PyFloat_AS_DOUBLE(now);
    uint64_t unix_us = unix_time_us();
    for (int i = 0; i < got && lane->fd >= 0; i++) {
        const uint8_t *data = slots + (size_t)i * DATAGRAM_BYTES;
        int size = (int)messages[i].msg_len, passed = 0;
        if (lane->epoch != lane->table->epoch && !forget_flows(lane)) set_aside(&faults, (PyObject *)lane);
        Peer *peer = map_get(&lane->peers, address_key(&from[i]));
        if (peer) passed = pass(lane, peer, data, size, seconds, unix_us);
        if (passed < 0) set_aside(&faults, (PyObject *)lane);
        if (passed > 0) continue;
        if (!to_python(lane, data, size, &from[i], now)) set_aside(&faults, (PyObject *)lane);
        unix_us = unix_time_us(); /* Python recorded its frames meanwhile: no record is to be older than one before it */
    }
    if (!settle(lane, now)) set_aside(&faults, (PyObject *)lane);
    return none_of(&faults);
}

/* Receive at most BURST datagrams and see to them. False: an exception, which an error of the socket is not. */
static int receive(Lane *lane, PyObject *now) {
    static struct mmsghdr messages[BURST];
    static struct iovec parts[BURST];
    static struct sockaddr_in from[BURST];
    for (int i = 0; i < BURST; i++) {
        parts[i] = (struct iovec){slots + (size_t)i * DATAGRAM_BYTES, DATAGRAM_BYTES};
        messages[i].msg_hdr = (struct msghdr){.msg_name = &from[i], .msg_namelen = sizeof from[i], .msg_iov = &parts[i], .msg_iovlen = 1};
    }
    int got = recvmmsg(lane->fd, messages, BURST, MSG_DONTWAIT, NULL);
    if (got >= 0) return burst(lane, got, messages, from, now);
    if (errno == EAGAIN || errno == EWOULDBLOCK) return 1;
    PyErr_SetFromErrno(PyExc_OSError);
    PyObject *error = take_exception(), *broken = Py_NewRef(lane->broken); /* it may close the lane */
    PyObject *done = error ? PyObject_CallOneArg(broken, error) : NULL;
    Py_XDECREF(done), Py_XDECREF(error);
    Py_DECREF(broken);
    return done != NULL;
}

/* The socket can be read: the event loop's callback. An error of the socket goes to `broken`, a fault in a callback up. */
static PyObject *lane_ready(Lane *lane, PyObject *unused) {
    (void)unused;
    if (lane_is_running) return PyErr_SetString(PyExc_RuntimeError, "a lane is being received from already"), NULL;
    if (!lane_is_open(lane)) Py_RETURN_NONE;
    PyObject *now = PyObject_CallNoArgs(lane->clock);
    if (!now) return NULL;
    if (!PyFloat_Check(now)) return Py_DECREF(now), PyErr_SetString(PyExc_TypeError, "a clock tells seconds as a float"), NULL;
    if (lane->fd < 0) { /* the clock closed it */
        Py_DECREF(now);
        Py_RETURN_NONE;
    }
    PyObject *after = Py_NewRef(lane->after); /* any callback may close the lane, which lets go of all of them, ... */
    Py_INCREF(lane); /* ... and of the last reference to it */
    Faults faults = {0};
    lane_is_running = 1;
    if (!receive(lane, now)) set_aside(&faults, (PyObject *)lane);
    lane_is_running = 0;
    if (lane->table->records_size >= RECORDS_BYTES) {
        PyObject *done = PyObject_CallNoArgs(after);
        if (!done) set_aside(&faults, after);
        Py_XDECREF(done);
    }
    Py_DECREF(after), Py_DECREF(now), Py_DECREF(lane);
    return none_of(&faults) ? Py_NewRef(Py_None) : NULL;
}

static int lane_init(Lane *lane, PyObject *args, PyObject *unused) {
    (void)unused;
    PyObject *table, *clock, *slow, *after, *broken;
    int fd;
    if (lane->table) return PyErr_SetString(PyExc_TypeError, "a lane is made once"), -1;
    if (!PyArg_ParseTuple(args, "O!iOOOO", &TableType, &table, &fd, &clock, &slow, &after, &broken)) return -1;
    if (fd < 0) return PyErr_SetString(PyExc_ValueError, "the socket is closed"), -1;
    if (!table_is_made((Table *)table)) return -1;
    lane->fd = fd, lane->table = (Table *)Py_NewRef(table);
    lane->clock = Py_NewRef(clock), lane->slow = Py_NewRef(slow), lane->after = Py_NewRef(after), lane->broken = Py_NewRef(broken);
    lane->next = lane->table->lanes, lane->table->lanes = lane;
    return 0;
}

/* The socket is about to be closed: let go of everything; amid `settle`, at its end. May be called from any callback. */
static PyObject *lane_close(Lane *lane, PyObject *unused) {
    (void)unused;
    if (!lane_is_open(lane)) Py_RETURN_NONE;
    flush_waiting(lane);
    int told = tell_lane(lane);
    PyObject *fault = told ? NULL : take_exception();
    lane->fd = -1;
    for (Lane **at = &lane->table->lanes; *at; at = &(*at)->next)
        if (*at == lane) {
            *at = lane->next;
            break;
        }
    lane->next = NULL;
    if (!lane->settling) release(lane);
    if (fault) return raise_exception(fault), NULL;
    Py_RETURN_NONE;
}

static void lane_finalize(PyObject *lane) {
    PyObject *pending = take_exception(), *done = lane_close((Lane *)lane, NULL);
    if (!done) PyErr_WriteUnraisable(NULL);
    Py_XDECREF(done);
    if (pending) raise_exception(pending);
}

static void lane_dealloc(Lane *lane) {
    if (PyObject_CallFinalizerFromDealloc((PyObject *)lane) < 0) return; /* somebody has taken it up again */
    Py_XDECREF(lane->table);
    Py_TYPE(lane)->tp_free(lane);
}

/* -- the module */

static PyMethodDef table_methods[] = {
    {"first_heard_on", (PyCFunction)table_first_heard_on, METH_VARARGS, "As core.dedup.DuplicateFilter's; keys are integers."},
    {"invalidate", (PyCFunction)table_invalidate, METH_NOARGS, "End all flows: the routing table changed."},
    {"take", (PyCFunction)table_take, METH_NOARGS, "(forwarded, local, tlog records, their number) since the last call."},
    {0},
};
static PyMemberDef table_members[] = {
    {"records_waiting", T_LONGLONG, offsetof(Table, n_records), READONLY, "tlog records that `take` would give."},
    {0},
};
static PyMethodDef lane_methods[] = {
    {"add_peer", (PyCFunction)lane_add_peer, METH_VARARGS, "add_peer(address, channel, parser_stats, channel_id)"},
    {"remove_peer", (PyCFunction)lane_remove_peer, METH_O, "remove_peer(address)"},
    {"add_flow", (PyCFunction)lane_add_flow, METH_VARARGS, "add_flow(address, source, msgid, stats, heard, outs, slot, watches)"},
    {"ready", (PyCFunction)lane_ready, METH_NOARGS, "To be called when the socket can be read."},
    {"close", (PyCFunction)lane_close, METH_NOARGS, "Let go of everything."},
    {0},
};
#define TYPE(NAME, SIZE, METHODS, MEMBERS, INIT, DEALLOC) \
    {PyVarObject_HEAD_INIT(NULL, 0).tp_name = "skygcs.links._fast_path." NAME, .tp_basicsize = SIZE, .tp_flags = Py_TPFLAGS_DEFAULT, \
     .tp_new = PyType_GenericNew, .tp_methods = METHODS, .tp_members = MEMBERS, .tp_init = (initproc)INIT, .tp_dealloc = (destructor)DEALLOC}
static PyTypeObject TableType = TYPE("Table", sizeof(Table), table_methods, table_members, table_init, table_dealloc);
static PyTypeObject OutType = TYPE("Out", sizeof(Out), NULL, NULL, out_init, out_dealloc);
static PyTypeObject LaneType = TYPE("FastPath", sizeof(Lane), lane_methods, NULL, lane_init, lane_dealloc);
/* Changes with every change of what Python and this file expect of each other; the same number is in links/fast_path.py. */
#define INTERFACE 2

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_fast_path", "The express lane of UDP; see links.express.", -1, NULL, NULL, NULL, NULL, NULL};

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
        hash_seed = unix_time_us() ^ (uint64_t)getpid() << 40; /* so early after boot that there is no randomness yet */
    if (!slots && !(slots = PyMem_RawMalloc((size_t)BURST * DATAGRAM_BYTES))) return PyErr_NoMemory();
    LaneType.tp_finalize = lane_finalize;
    PyObject *made = PyModule_Create(&module);
    if (made && PyModule_AddIntConstant(made, "INTERFACE", INTERFACE)) {
        Py_DECREF(made);
        return NULL;
    }
    if (made && !PyModule_AddType(made, &TableType) && !PyModule_AddType(made, &OutType) && !PyModule_AddType(made, &LaneType)) return made;
    Py_XDECREF(made);
    return NULL;
}
