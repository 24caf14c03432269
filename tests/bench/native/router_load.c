/* Load for a MAVLink router: vehicles on one side, ground stations on the other, every frame numbered.
 *
 *   router_load vehicles=20 to=14550 gcs=14600,14601 rate=10000 seconds=2 per_datagram=1 own_sockets=0
 *               commands=0 fd=-1
 *
 * Telemetry: `rate` frames/s (0: none) of `vehicles` systems to UDP port `to` from one socket (own_sockets=1: from one
 * per vehicle), or into file descriptor `fd` (a pty's master). Expected at every port of `gcs`, and nowhere else.
 * Commands: `commands` COMMAND_LONG/s (0: none) from the ground stations in turn to the vehicles in turn, sent to
 * where the router's datagrams came from. Expected at that vehicle (own_sockets=1), and nowhere else.
 *
 * It warms up (two heartbeats a vehicle, so that routes are known), prints "ready", waits for a line, runs, and prints
 * one JSON object. Latency is from the call that sent to the kernel's time of receipt: the generator's own scheduling
 * does not count.
 */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <errno.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { MAX_VEHICLES = 250, MAX_GCS = 16, BATCH = 64, BUFFER = 4 << 20, GCS_SYSID = 240, DATAGRAM = 4096 };

/* What is sent: id, CRC_EXTRA, payload bytes; the first four bytes are the frame's number, but for HEARTBEAT. */
typedef struct { uint32_t msgid; uint8_t extra, length; } Kind;
static const Kind HEARTBEAT = {0, 50, 9}, ATTITUDE = {30, 39, 28}, POSITION = {33, 104, 28}, STATUS = {1, 124, 31},
                  GPS = {24, 24, 30}, COMMAND = {76, 152, 33};

typedef struct {
    long total, sent, received, duplicates, disordered, wrong, corrupt;
    double rate;
    uint64_t *sent_at;  /* by number */
    uint8_t *seen;      /* by receiver * total + number */
    long *newest;       /* by receiver * vehicles + vehicle */
    uint32_t *latency_ns;
    long latencies;
    uint64_t last_at;
} Stream;

static int n_vehicles = 20, to_port, n_gcs, gcs_ports[MAX_GCS], per_datagram = 1, own_sockets, serial_fd = -1;
static double seconds = 2;
static Stream telemetry, commands;
static int vehicle_fd[MAX_VEHICLES], gcs_fd[MAX_GCS];
static struct sockaddr_in router_at[MAX_GCS];
static atomic_int measuring, stopping;
static atomic_ulong last_receipt;

static uint64_t now_ns(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

static uint16_t crc_table[256];

static void make_crc_table(void) {
    for (unsigned i = 0; i < 256; i++) {
        unsigned crc = i;
        for (int bit = 0; bit < 8; bit++) crc = crc & 1 ? crc >> 1 ^ 0x8408 : crc >> 1;
        crc_table[i] = (uint16_t)crc;
    }
}

static uint16_t crc16(const uint8_t *data, int size, uint8_t extra) {
    uint16_t crc = 0xFFFF;
    for (int i = 0; i < size; i++) crc = (uint16_t)(crc >> 8 ^ crc_table[(crc ^ data[i]) & 0xFF]);
    return (uint16_t)(crc >> 8 ^ crc_table[(crc ^ extra) & 0xFF]);
}

static int encode(uint8_t *out, Kind kind, int sysid, int compid, uint8_t seq, const uint8_t *payload) {
    int length = kind.length;
    while (length > 1 && !payload[length - 1]) length--;
    uint8_t head[10] = {0xFD, (uint8_t)length, 0, 0, seq, (uint8_t)sysid, (uint8_t)compid, (uint8_t)kind.msgid, 0, 0};
    memcpy(out, head, 10);
    memcpy(out + 10, payload, (size_t)length);
    uint16_t crc = crc16(out + 1, 9 + length, kind.extra);
    out[10 + length] = (uint8_t)crc;
    out[11 + length] = (uint8_t)(crc >> 8);
    return length + 12;
}

/* The mix of a quadrotor's telemetry, 20 frames: mean 40 bytes. */
static Kind kind_of(long turn) {
    int n = (int)(turn % 20);
    return n == 0 ? HEARTBEAT : n <= 8 ? ATTITUDE : n <= 14 ? POSITION : n <= 16 ? STATUS : GPS;
}

/* Frames go round the vehicles one by one; with own sockets, where a datagram is of one vehicle, datagram by datagram. */
static int vehicle_of(long number) { return (int)((own_sockets ? number / per_datagram : number) % n_vehicles); }

static long turn_of(long number) {
    if (!own_sockets) return number / n_vehicles;
    return number / per_datagram / n_vehicles * per_datagram + number % per_datagram;
}

static int telemetry_frame(uint8_t *out, long number) {
    long turn = turn_of(number);
    Kind kind = kind_of(turn);
    uint8_t payload[64] = {0};
    uint32_t id = (uint32_t)number;
    if (kind.msgid == 0) {
        memcpy(payload, "\4\0\0\0\2\3\121\4\3", 9); /* ArduCopter, guided, disarmed, active */
    } else {
        memset(payload + 4, 17, (size_t)kind.length - 4 - 8);
        memcpy(payload, &id, 4);
    }
    return encode(out, kind, 1 + vehicle_of(number), 1, (uint8_t)(turn + 2), payload);
}

static int command_frame(uint8_t *out, long number, int vehicle, int gcs) {
    uint8_t payload[33] = {0};
    uint32_t id = (uint32_t)number;
    memcpy(payload, &id, 4); /* param1 */
    payload[28] = 0x90, payload[29] = 0x01; /* 400 */
    payload[30] = (uint8_t)(vehicle + 1), payload[31] = 1;
    return encode(out, COMMAND, GCS_SYSID + gcs, 190, (uint8_t)(number / n_gcs), payload);
}

static void fail(const char *what) { perror(what), exit(1); }

static int udp(int port) {
    int fd = socket(AF_INET, SOCK_DGRAM, 0), size = BUFFER, on = 1;
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port), .sin_addr = {htonl(INADDR_LOOPBACK)}};
    if (fd < 0) fail("socket");
    if (bind(fd, (struct sockaddr *)&a, sizeof a)) fail("bind");
    setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &size, sizeof size);
    setsockopt(fd, SOL_SOCKET, SO_RCVBUFFORCE, &size, sizeof size); /* if we may: the generator must not be what loses */
    setsockopt(fd, SOL_SOCKET, SO_SNDBUF, &size, sizeof size);
    setsockopt(fd, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on);
    return fd;
}

/* -- receiving */

static void note(Stream *s, long number, int receiver, int vehicle, uint64_t at) {
    s->received++;
    s->last_at = at;
    if (number < 0) return; /* a heartbeat: counted only */
    uint8_t *seen = &s->seen[receiver * s->total + number];
    long *newest = &s->newest[receiver * n_vehicles + vehicle];
    if (*seen) { s->duplicates++; s->received--; return; }
    *seen = 1;
    if (number < *newest) s->disordered++;
    else *newest = number;
    if (at > s->sent_at[number]) s->latency_ns[s->latencies++] = (uint32_t)(at - s->sent_at[number]);
}

/* One frame at one end: `vehicle` or `gcs` is who received it, the other is -1. */
static void on_frame(const uint8_t *f, int vehicle, int gcs, uint64_t at) {
    int sysid = f[5];
    uint32_t id, msgid = f[7] | (uint32_t)f[8] << 8 | (uint32_t)f[9] << 16;
    memcpy(&id, f + 10, 4);
    if (msgid == COMMAND.msgid && sysid >= GCS_SYSID && sysid < GCS_SYSID + n_gcs) {
        int target = f[10 + 30] - 1;
        if (vehicle < 0 || (own_sockets && vehicle != target) || id >= (uint32_t)commands.total) commands.wrong++;
        else note(&commands, id, 0, target, at);
    } else if (sysid >= 1 && sysid <= n_vehicles && f[6] == 1) {
        if (gcs < 0) telemetry.wrong++;
        else if (msgid == 0) note(&telemetry, -1, gcs, sysid - 1, at);
        else if (id >= (uint32_t)telemetry.total || vehicle_of(id) != sysid - 1) telemetry.corrupt++;
        else note(&telemetry, id, gcs, sysid - 1, at);
    } /* else the router's own */
}

static int known_extra(uint32_t msgid) {
    const Kind *kinds[] = {&HEARTBEAT, &ATTITUDE, &POSITION, &STATUS, &GPS, &COMMAND};
    for (int i = 0; i < 6; i++)
        if (kinds[i]->msgid == msgid) return kinds[i]->extra;
    return -1;
}

/* All frames of these bytes; returns how many bytes are done with (the rest is an incomplete frame). */
static int on_bytes(const uint8_t *data, int size, int vehicle, int gcs, uint64_t at) {
    int i = 0;
    while (size - i >= 12) {
        if (data[i] != 0xFD) { i++; continue; }
        int length = data[i + 1], whole = length + 12 + (data[i + 2] & 1 ? 13 : 0);
        if (size - i < whole) break;
        uint32_t msgid = data[i + 7] | (uint32_t)data[i + 8] << 8 | (uint32_t)data[i + 9] << 16;
        int extra = known_extra(msgid);
        if (extra >= 0) {
            uint8_t full[280] = {0};
            memcpy(full, data + i, (size_t)(10 + length)); /* trimmed zeros back */
            uint16_t crc = crc16(data + i + 1, 9 + length, (uint8_t)extra);
            if (data[i + 10 + length] != (crc & 0xFF) || data[i + 11 + length] != crc >> 8) telemetry.corrupt++;
            else if (atomic_load(&measuring)) on_frame(full, vehicle, gcs, at);
        }
        i += whole;
    }
    return i;
}

static void on_stream(void) {
    static uint8_t buffer[65536];
    static int kept;
    ssize_t got = read(serial_fd, buffer + kept, sizeof buffer - (size_t)kept);
    if (got <= 0) return;
    kept += (int)got;
    int done = on_bytes(buffer, kept, 0, -1, now_ns(CLOCK_REALTIME));
    memmove(buffer, buffer + done, (size_t)(kept -= done));
    atomic_store(&last_receipt, now_ns(CLOCK_MONOTONIC));
}

static void *receive(void *unused) {
    static uint8_t data[BATCH][DATAGRAM];
    static char control[BATCH][64];
    struct mmsghdr messages[BATCH];
    struct iovec parts[BATCH];
    struct sockaddr_in from[BATCH];
    struct epoll_event events[32], want = {.events = EPOLLIN};
    int poll = epoll_create1(0), n_fds = own_sockets ? n_vehicles : 1;
    for (int i = 0; i < n_fds && serial_fd < 0; i++) want.data.u32 = (uint32_t)i, epoll_ctl(poll, EPOLL_CTL_ADD, vehicle_fd[i], &want);
    for (int i = 0; i < n_gcs; i++) want.data.u32 = 1000u + (uint32_t)i, epoll_ctl(poll, EPOLL_CTL_ADD, gcs_fd[i], &want);
    if (serial_fd >= 0) want.data.u32 = 2000, epoll_ctl(poll, EPOLL_CTL_ADD, serial_fd, &want);
    while (!atomic_load(&stopping)) {
        int ready = epoll_wait(poll, events, 32, 20);
        for (int e = 0; e < ready; e++) {
            int id = (int)events[e].data.u32, is_gcs = id >= 1000;
            if (id == 2000) { on_stream(); continue; }
            int fd = is_gcs ? gcs_fd[id - 1000] : vehicle_fd[id];
            for (int i = 0; i < BATCH; i++) {
                parts[i] = (struct iovec){data[i], DATAGRAM};
                messages[i].msg_hdr = (struct msghdr){&from[i], sizeof from[i], &parts[i], 1, control[i], sizeof control[i], 0};
            }
            int got = recvmmsg(fd, messages, BATCH, MSG_DONTWAIT, NULL);
            for (int i = 0; i < got; i++) {
                uint64_t at = 0;
                for (struct cmsghdr *c = CMSG_FIRSTHDR(&messages[i].msg_hdr); c; c = CMSG_NXTHDR(&messages[i].msg_hdr, c))
                    if (c->cmsg_type == SCM_TIMESTAMPNS) {
                        struct timespec *t = (struct timespec *)CMSG_DATA(c);
                        at = (uint64_t)t->tv_sec * 1000000000u + (uint64_t)t->tv_nsec;
                    }
                if (is_gcs) router_at[id - 1000] = from[i];
                on_bytes(data[i], (int)messages[i].msg_len, is_gcs ? -1 : id, is_gcs ? id - 1000 : -1, at);
            }
            if (got > 0) atomic_store(&last_receipt, now_ns(CLOCK_MONOTONIC));
        }
    }
    return unused;
}

/* -- sending */

static void write_all(const uint8_t *data, size_t size) {
    while (size) {
        ssize_t written = write(serial_fd, data, size);
        if (written < 0 && errno != EAGAIN && errno != EINTR) fail("pty");
        if (written > 0) data += written, size -= (size_t)written;
        else usleep(50);
    }
}

/* Frames up to `due`, in batches of one sendmmsg per socket run. */
static void send_telemetry(long due) {
    static uint8_t data[BATCH][DATAGRAM];
    struct mmsghdr messages[BATCH];
    struct iovec parts[BATCH];
    Stream *s = &telemetry;
    while (s->sent < due) {
        int batch = 0, fd = -1;
        while (batch < BATCH && s->sent < due) {
            long first = s->sent;
            int socket_of = vehicle_fd[own_sockets ? vehicle_of(first) : 0], size = 0;
            if (fd >= 0 && socket_of != fd) break;
            fd = socket_of;
            for (int k = 0; k < per_datagram; k++) size += telemetry_frame(data[batch] + size, s->sent++);
            parts[batch] = (struct iovec){data[batch], (size_t)size};
            memset(&messages[batch], 0, sizeof messages[batch]);
            messages[batch].msg_hdr.msg_iov = &parts[batch];
            messages[batch++].msg_hdr.msg_iovlen = 1;
            uint64_t at = now_ns(CLOCK_REALTIME);
            for (long n = first; n < s->sent; n++) s->sent_at[n] = at;
        }
        if (serial_fd >= 0) {
            for (int i = 0; i < batch; i++) write_all(parts[i].iov_base, parts[i].iov_len);
            continue;
        }
        for (int done = 0; done < batch;) {
            int sent = sendmmsg(fd, messages + done, (unsigned)(batch - done), 0);
            if (sent > 0) done += sent;
            else if (errno != EAGAIN && errno != ENOBUFS && errno != ECONNREFUSED) fail("send");
        }
    }
}

static void send_commands(long due) {
    uint8_t frame[64];
    for (Stream *s = &commands; s->sent < due;) {
        long number = s->sent++;
        int gcs = (int)(number % n_gcs), size = command_frame(frame, number, (int)(number % n_vehicles), gcs);
        s->sent_at[number] = now_ns(CLOCK_REALTIME);
        if (sendto(gcs_fd[gcs], frame, (size_t)size, 0, (struct sockaddr *)&router_at[gcs], sizeof router_at[gcs]) < 0)
            s->corrupt++;
    }
}

static void run(void) {
    uint64_t start = now_ns(CLOCK_MONOTONIC);
    prctl(PR_SET_TIMERSLACK, 1);
    while (telemetry.sent < telemetry.total || commands.sent < commands.total) {
        double t = (double)(now_ns(CLOCK_MONOTONIC) - start) / 1e9;
        long due = (long)(t * telemetry.rate) / per_datagram * per_datagram, due_commands = (long)(t * commands.rate);
        if (due > telemetry.total || t > 3 * seconds) due = telemetry.total;
        if (due_commands > commands.total) due_commands = commands.total;
        send_telemetry(due);
        send_commands(due_commands);
        double next = 1e9;
        if (telemetry.sent < telemetry.total) next = (double)(telemetry.sent + per_datagram) / telemetry.rate;
        if (commands.sent < commands.total && (double)(commands.sent + 1) / commands.rate < next)
            next = (double)(commands.sent + 1) / commands.rate;
        double wait = next - (double)(now_ns(CLOCK_MONOTONIC) - start) / 1e9;
        if (wait > 0 && wait < 1) nanosleep(&(struct timespec){0, (long)(wait * 1e9)}, NULL);
    }
}

static void warm_up(void) {
    uint8_t frame[64];
    uint8_t payload[9];
    memcpy(payload, "\4\0\0\0\2\3\121\4\3", 9);
    for (int round = 0; round < 2; round++) {
        for (int v = 0; v < n_vehicles; v++) {
            int size = encode(frame, HEARTBEAT, v + 1, 1, (uint8_t)round, payload);
            if (serial_fd >= 0) write_all(frame, (size_t)size);
            else (void)!send(vehicle_fd[own_sockets ? v : 0], frame, (size_t)size, 0);
        }
        usleep(150000);
    }
    if (commands.total) { /* and the routers hear of the ground stations */
        for (int g = 0; g < n_gcs; g++) {
            int size = encode(frame, HEARTBEAT, GCS_SYSID + g, 190, 0, (const uint8_t *)"\0\0\0\0\6\10\0\4\3");
            (void)!sendto(gcs_fd[g], frame, (size_t)size, 0, (struct sockaddr *)&router_at[g], sizeof router_at[g]);
        }
        usleep(150000);
    }
}

static int by_size(const void *a, const void *b) {
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

static void report(const char *name, Stream *s, int receivers, uint64_t start, const char *end) {
    qsort(s->latency_ns, (size_t)s->latencies, sizeof *s->latency_ns, by_size);
    double q[3] = {0.5, 0.99, 0.999}, us[3] = {0, 0, 0};
    for (int i = 0; i < 3 && s->latencies; i++) us[i] = s->latency_ns[(long)((double)(s->latencies - 1) * q[i])] / 1e3;
    double elapsed = s->last_at > start ? (double)(s->last_at - start) / 1e9 : 0;
    printf("\"%s\": {\"sent\": %ld, \"expected\": %ld, \"received\": %ld, \"lost\": %ld, \"duplicates\": %ld, "
           "\"out_of_order\": %ld, \"wrong\": %ld, \"corrupt\": %ld, \"elapsed_s\": %.6f, "
           "\"p50_us\": %.1f, \"p99_us\": %.1f, \"p999_us\": %.1f}%s",
           name, s->sent, s->sent * receivers, s->received, s->sent * receivers - s->received, s->duplicates,
           s->disordered, s->wrong, s->corrupt, elapsed, us[0], us[1], us[2], end);
}

static void prepare(Stream *s, int receivers) {
    s->total = (long)(s->rate * seconds) / per_datagram * per_datagram;
    size_t n = (size_t)s->total + 1, r = (size_t)receivers;
    s->sent_at = calloc(n, sizeof *s->sent_at);
    s->seen = calloc(n * r, 1);
    s->newest = calloc((size_t)n_vehicles * r, sizeof *s->newest);
    s->latency_ns = calloc(n * r, sizeof *s->latency_ns);
    if (!s->sent_at || !s->seen || !s->newest || !s->latency_ns) fail("memory");
    memset(s->latency_ns, 0, n * r * sizeof *s->latency_ns); /* touched before the run: no page faults in it */
    memset(s->sent_at, 0, n * sizeof *s->sent_at);
    memset(s->seen, 0, n * r);
}

int main(int argc, char **argv) {
    for (int i = 1; i < argc; i++) {
        char *value = strchr(argv[i], '=');
        if (!value) return fprintf(stderr, "%s: not key=value\n", argv[i]), 2;
        *value++ = 0;
        if (!strcmp(argv[i], "vehicles")) n_vehicles = atoi(value);
        else if (!strcmp(argv[i], "to")) to_port = atoi(value);
        else if (!strcmp(argv[i], "rate")) telemetry.rate = atof(value);
        else if (!strcmp(argv[i], "commands")) commands.rate = atof(value);
        else if (!strcmp(argv[i], "seconds")) seconds = atof(value);
        else if (!strcmp(argv[i], "per_datagram")) per_datagram = atoi(value);
        else if (!strcmp(argv[i], "own_sockets")) own_sockets = atoi(value);
        else if (!strcmp(argv[i], "fd")) serial_fd = atoi(value);
        else if (!strcmp(argv[i], "gcs"))
            for (char *p = strtok(value, ","); p && n_gcs < MAX_GCS; p = strtok(NULL, ",")) gcs_ports[n_gcs++] = atoi(p);
        else return fprintf(stderr, "%s: unknown key\n", argv[i]), 2;
    }
    int most = commands.rate > 0 ? 200 : MAX_VEHICLES; /* ground stations that command have ids of their own above */
    if (n_vehicles < 1 || n_vehicles > most || per_datagram < 1 || per_datagram > DATAGRAM / 45 || !n_gcs)
        return fputs("vehicles=, per_datagram= or gcs= is out of range\n", stderr), 2;
    make_crc_table();
    prepare(&telemetry, n_gcs);
    prepare(&commands, 1);
    for (int i = 0; i < n_gcs; i++) gcs_fd[i] = udp(gcs_ports[i]);
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons((uint16_t)to_port), .sin_addr = {htonl(INADDR_LOOPBACK)}};
    for (int i = 0; i < (own_sockets ? n_vehicles : 1) && serial_fd < 0; i++)
        /* the same ports in every run: to the router it is the same peers that go on */
        if (connect(vehicle_fd[i] = udp(to_port + 8000 + i), (struct sockaddr *)&to, sizeof to)) fail("connect");
    pthread_t receiver;
    if (pthread_create(&receiver, NULL, receive, NULL)) fail("thread");
    warm_up();
    printf("ready\n"), fflush(stdout);
    (void)getchar();
    atomic_store(&measuring, 1);
    atomic_store(&last_receipt, now_ns(CLOCK_MONOTONIC));
    uint64_t start = now_ns(CLOCK_REALTIME);
    run();
    uint64_t end = now_ns(CLOCK_MONOTONIC);
    for (;;) { /* what is still on its way */
        usleep(2000);
        uint64_t now = now_ns(CLOCK_MONOTONIC), silent = now - atomic_load(&last_receipt);
        int all = telemetry.received >= telemetry.sent * n_gcs && commands.received >= commands.sent;
        if ((all && now - end > 20000000u) || (silent > 300000000u && now - end > 300000000u)) break;
    }
    atomic_store(&stopping, 1);
    pthread_join(receiver, NULL);
    printf("{");
    report("telemetry", &telemetry, n_gcs, start, ", ");
    report("commands", &commands, 1, start, "}\n");
    return 0;
}
