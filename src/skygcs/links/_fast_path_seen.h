/* On which channel each recent frame was heard first, for _fast_path.c: core.routing.duplicates.DuplicateFilter in C,
   two generations of hash sets. */
#include <Python.h>
#include <stdint.h>
#include <string.h>

enum {
    MAX_REMEMBERED = 65536, /* core.routing.duplicates */
    SEEN_SLOTS = 2 * MAX_REMEMBERED,
};
static const double WINDOW_S = 1.0; /* core.routing.duplicates */

/* A cell holds sysid, compid, seq and CRC, and the channel id (`Hub.attach` assigns none above), in one number. */
static const uint64_t GREATEST_KEY = ((uint64_t)1 << 40) - 1;
static const uint32_t GREATEST_CHANNEL = 0xFFFFFF;

typedef struct { uint64_t *at; int count; } Generation; /* key << 24 | channel id; 0: none */
typedef struct { Generation newer, older; double swap_at; } Seen;

static int seen_init(Seen *seen) {
    seen->newer.at = PyMem_Calloc(SEEN_SLOTS, sizeof(uint64_t));
    seen->older.at = PyMem_Calloc(SEEN_SLOTS, sizeof(uint64_t));
    return seen->newer.at && seen->older.at ? 1 : (PyErr_NoMemory(), 0);
}

static void seen_free(Seen *seen) { PyMem_Free(seen->newer.at), PyMem_Free(seen->older.at); }

static int swap_is_due(const Seen *seen, double now) {
    return now >= seen->swap_at || seen->newer.count >= MAX_REMEMBERED;
}

static void swap_generations(Seen *seen, double now) {
    Generation old = seen->newer;
    seen->newer = seen->older;
    seen->older = old;
    seen->newer.count = 0;
    memset(seen->newer.at, 0, SEEN_SLOTS * sizeof *seen->newer.at);
    if (now >= seen->swap_at + WINDOW_S) memset(old.at, 0, SEEN_SLOTS * sizeof *old.at);
    seen->swap_at = now + WINDOW_S;
}

static uint64_t *seen_slot(const Generation *g, uint64_t key) {
    size_t i = mixed(key) % SEEN_SLOTS;
    while (g->at[i] && g->at[i] >> 24 != key) i = (i + 1) % SEEN_SLOTS;
    return &g->at[i];
}

/* The channel on which a frame was heard first; 0: it is new. */
static uint32_t first_heard(const Seen *seen, uint64_t key) {
    uint64_t found = *seen_slot(&seen->newer, key);
    if (!found) found = *seen_slot(&seen->older, key);
    return (uint32_t)(found & 0xFFFFFF);
}

static void remember(Seen *seen, uint64_t key, uint32_t channel) {
    seen->newer.count++;
    *seen_slot(&seen->newer, key) = key << 24 | channel;
}
