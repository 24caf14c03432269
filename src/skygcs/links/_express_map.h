/* A map from 64-bit keys to pointers, for _express.c. Open addressing, half full at most. */
#include <Python.h>
#include <stdint.h>

/* A value of NULL is no entry. */
typedef struct { uint64_t key; void *value; } Cell;
typedef struct { Cell *cells; size_t mask, used; } Map;

static size_t mixed(uint64_t key) {
    key *= 0x9E3779B97F4A7C15u;
    return (size_t)(key ^ key >> 32);
}

static void **map_slot(Map *map, uint64_t key) {
    size_t i = mixed(key) & map->mask;
    while (map->cells[i].key != key && map->cells[i].key) i = (i + 1) & map->mask;
    map->cells[i].key = key;
    return &map->cells[i].value;
}

static void *map_get(const Map *map, uint64_t key) {
    if (!map->used) return NULL;
    for (size_t i = mixed(key) & map->mask; map->cells[i].key; i = (i + 1) & map->mask)
        if (map->cells[i].key == key) return map->cells[i].value;
    return NULL;
}

/* key must not be 0. False: no memory. */
static int map_put(Map *map, uint64_t key, void *value) {
    if (map->used * 2 >= map->mask) {
        Map bigger = {.mask = map->mask ? map->mask * 2 + 1 : 255};
        if (!(bigger.cells = PyMem_Calloc(bigger.mask + 1, sizeof *bigger.cells))) return PyErr_NoMemory(), 0;
        for (size_t i = 0; map->mask && i <= map->mask; i++)
            if (map->cells[i].value) *map_slot(&bigger, map->cells[i].key) = map->cells[i].value, bigger.used++;
        PyMem_Free(map->cells);
        *map = bigger;
    }
    void **slot = map_slot(map, key);
    if (!*slot) map->used++; /* a removed entry that comes back is counted twice: it grows a little early */
    *slot = value;
    return 1;
}

static void map_clear(Map *map, void (*free_value)(void *)) {
    for (size_t i = 0; map->mask && i <= map->mask; i++)
        if (map->cells[i].value) free_value(map->cells[i].value);
    PyMem_Free(map->cells);
    *map = (Map){0};
}
