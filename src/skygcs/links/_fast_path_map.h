/* A map from 64-bit keys to pointers, for _fast_path.c. Open addressing, half full at most. */
#include <Python.h>
#include <stdint.h>

/* Random per process: a sender that knew the hash could choose keys that make every look-up a walk through the table. */
static uint64_t hash_seed;

/* A key of 0 is a free cell; a value of NULL a removed entry, whose cell is freed when the map is rebuilt. */
typedef struct { uint64_t key; void *value; } Cell;
typedef struct { Cell *cells; size_t mask, filled; } Map; /* filled: cells with a key, removed entries included */

enum { LEAST_CELLS = 256 };

static size_t mixed(uint64_t key) {
    key = (key ^ hash_seed) * 0x9E3779B97F4A7C15u;
    key = (key ^ key >> 29) * 0xBF58476D1CE4E5B9u;
    return (size_t)(key ^ key >> 32);
}

/* The key's cell, or the free one where it would be. There is always a free one. */
static Cell *map_cell(const Map *map, uint64_t key) {
    size_t i = mixed(key) & map->mask;
    while (map->cells[i].key != key && map->cells[i].key) i = (i + 1) & map->mask;
    return &map->cells[i];
}

static void *map_get(const Map *map, uint64_t key) { return map->filled ? map_cell(map, key)->value : NULL; }

/* Copy the live entries into a table of fitting size: entries that come and go do not make it grow. False: no memory. */
static int map_rebuild(Map *map) {
    size_t live = 0, size = LEAST_CELLS;
    for (size_t i = 0; map->cells && i <= map->mask; i++) live += map->cells[i].value != NULL;
    while (size < 4 * (live + 1)) size *= 2;
    Map rebuilt = {.mask = size - 1, .filled = live};
    if (!(rebuilt.cells = PyMem_Calloc(size, sizeof *rebuilt.cells))) return PyErr_NoMemory(), 0;
    for (size_t i = 0; map->cells && i <= map->mask; i++)
        if (map->cells[i].value) *map_cell(&rebuilt, map->cells[i].key) = map->cells[i];
    PyMem_Free(map->cells);
    *map = rebuilt;
    return 1;
}

/* key must not be 0. False: no memory, and nothing has changed. */
static int map_put(Map *map, uint64_t key, void *value) {
    if ((map->filled + 1) * 2 > map->mask && !map_rebuild(map)) return 0;
    Cell *cell = map_cell(map, key);
    if (!cell->key) cell->key = key, map->filled++;
    cell->value = value;
    return 1;
}

/* Remove a key; returns its value, or NULL. */
static void *map_remove(Map *map, uint64_t key) {
    if (!map->filled) return NULL;
    Cell *cell = map_cell(map, key);
    void *value = cell->value;
    cell->value = NULL;
    return value;
}

/* Empty the map, then free the values: freeing may call Python, which may use the map. */
static void map_clear(Map *map, void (*free_value)(void *)) {
    Map old = *map;
    *map = (Map){0};
    for (size_t i = 0; old.cells && i <= old.mask; i++)
        if (old.cells[i].value) free_value(old.cells[i].value);
    PyMem_Free(old.cells);
}
