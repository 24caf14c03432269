/* Which frame was heard where first, for _express.c: core.dedup.DuplicateFilter in C, two generations of hash sets. */
#include <Python.h>
#include <stdint.h>
#include <string.h>

enum {
    MAX_REMEMBERED = 65536, /* core.dedup */
    SEEN_SLOTS = 2 * MAX_REMEMBERED,
};
static const double WINDOW_S = 0.5; /* core.dedup */

typedef struct { uint64_t *at; size_t mask; int count; } Generation; /* key << 24 | channel id; 0: none */
typedef struct { Generation newer, older; uint64_t *spare; double turn_at; } Seen;

static int seen_init(Seen *seen) {
    seen->newer.at = PyMem_Calloc(SEEN_SLOTS, sizeof(uint64_t));
    seen->older.at = PyMem_Calloc(SEEN_SLOTS, sizeof(uint64_t));
    seen->spare = PyMem_Calloc(SEEN_SLOTS, sizeof(uint64_t));
    if (!seen->newer.at || !seen->older.at || !seen->spare) return PyErr_NoMemory(), 0;
    seen->newer.mask = seen->older.mask = 1023;
    return 1;
}

static void seen_free(Seen *seen) { PyMem_Free(seen->newer.at), PyMem_Free(seen->older.at), PyMem_Free(seen->spare); }

static int turn_is_due(const Seen *seen, double now) {
    return now >= seen->turn_at || seen->newer.count >= MAX_REMEMBERED;
}

static void turn(Seen *seen, double now) {
    Generation old = seen->newer;
    seen->newer = seen->older;
    seen->older = old;
    /* Twice what the last one held, at half its room or less: the smaller, the less of it misses the CPU's caches. */
    seen->newer.mask = 1023;
    while (seen->newer.mask < (size_t)old.count * 4 && seen->newer.mask < SEEN_SLOTS - 1)
        seen->newer.mask = seen->newer.mask * 2 + 1;
    seen->newer.count = 0;
    memset(seen->newer.at, 0, (seen->newer.mask + 1) * sizeof *seen->newer.at);
    if (now >= seen->turn_at + WINDOW_S) memset(old.at, 0, (old.mask + 1) * sizeof *old.at);
    seen->turn_at = now + WINDOW_S;
}

static uint64_t *seen_slot(const Generation *g, uint64_t key) {
    size_t i = mixed(key) & g->mask;
    while (g->at[i] && g->at[i] >> 24 != key) i = (i + 1) & g->mask;
    return &g->at[i];
}

/* The channel that a frame was heard on first, 0 if it is new. */
static uint32_t first_heard(const Seen *seen, uint64_t key) {
    uint64_t found = *seen_slot(&seen->newer, key);
    if (!found) found = *seen_slot(&seen->older, key);
    return (uint32_t)(found & 0xFFFFFF);
}

static void remember(Seen *seen, uint64_t key, uint32_t channel) {
    Generation *g = &seen->newer;
    if ((size_t)++g->count * 2 > g->mask && g->mask < SEEN_SLOTS - 1) { /* more than the last one: into the room beside */
        size_t wider = g->mask * 4 + 3 < SEEN_SLOTS - 1 ? g->mask * 4 + 3 : SEEN_SLOTS - 1, n = g->mask + 1;
        uint64_t *kept = g->at;
        g->at = seen->spare, g->mask = wider, seen->spare = kept;
        memset(g->at, 0, (wider + 1) * sizeof *g->at);
        for (size_t i = 0; i < n; i++)
            if (kept[i]) *seen_slot(g, kept[i] >> 24) = kept[i];
    }
    *seen_slot(g, key) = key << 24 | (channel & 0xFFFFFF);
}

/* The entries of a key will be wanted soon. */
static void seen_prefetch(const Seen *seen, uint64_t key) {
    __builtin_prefetch(&seen->newer.at[mixed(key) & seen->newer.mask]);
    __builtin_prefetch(&seen->older.at[mixed(key) & seen->older.mask]);
}
