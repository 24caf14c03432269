/* On which channel each recent frame was heard first, for _fast_path.c: core.routing.router.DuplicateFilter in C,
   two generations of hash sets. */
#include <Python.h>
#include <stdint.h>
#include <string.h>
#include <sys/mman.h>

enum {
    MAX_REMEMBERED = 65536, /* core.routing.router */
    SEEN_SLOTS = 2 * MAX_REMEMBERED,
    SEEN_BYTES = SEEN_SLOTS * sizeof(uint64_t),
    FEW_KEYS = SEEN_BYTES / 4096, /* as many as pages */
};
static const double WINDOW_S = 1.0; /* core.routing.router */

/* A cell holds sysid, compid, seq and CRC, and the channel id (`Hub.attach` assigns none above), in one number. */
static const uint64_t GREATEST_KEY = ((uint64_t)1 << 40) - 1;
static const uint32_t GREATEST_CHANNEL = 0xFFFFFF;

typedef struct { uint64_t *at; int count; } Generation; /* key << 24 | channel id; 0: none */
typedef struct { Generation newer, older; double swap_at; } Seen;

/* Pages of zeros that take memory only once they are written: 2 MB, of which a vehicle's frames need a tenth. */
static uint64_t *new_cells(void) {
    void *at = mmap(NULL, SEEN_BYTES, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    return at == MAP_FAILED ? NULL : at;
}

static void free_cells(uint64_t *at) {
    if (at) munmap(at, SEEN_BYTES);
}

/* Zeros again. After few keys the pages go back to the system, which refuses that for memory that is locked; after many
   most pages are needed again at once, and to have them anew costs more than to write over them. */
static void clear_generation(Generation *g) {
    if (g->count > FEW_KEYS || madvise(g->at, SEEN_BYTES, MADV_DONTNEED)) memset(g->at, 0, SEEN_BYTES);
    g->count = 0;
}

static int seen_init(Seen *seen) {
    seen->newer.at = new_cells(), seen->older.at = new_cells();
    return seen->newer.at && seen->older.at ? 1 : (PyErr_NoMemory(), 0);
}

static void seen_free(Seen *seen) { free_cells(seen->newer.at), free_cells(seen->older.at); }

static int swap_is_due(const Seen *seen, double now) {
    return now >= seen->swap_at || seen->newer.count >= MAX_REMEMBERED;
}

static void swap_generations(Seen *seen, double now) {
    Generation old = seen->newer;
    seen->newer = seen->older;
    seen->older = old;
    clear_generation(&seen->newer);
    double late_s = now - seen->swap_at; /* below 0: full before its time */
    if (late_s >= WINDOW_S) clear_generation(&seen->older);
    seen->swap_at = (late_s >= 0.0 && late_s < WINDOW_S ? seen->swap_at : now) + WINDOW_S;
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
