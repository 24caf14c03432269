/* A map from 64-bit keys to pointers, for _express.c. Open addressing, half full at most. */
#include <Python.h>
#include <stdint.h>

/* A value of NULL is no entry. */
typedef struct { uint64_t *keys; void **values; size_t mask, used; } Map;

static size_t mixed(uint64_t key) {
    key *= 0x9E3779B97F4A7C15u;
    return (size_t)(key ^ key >> 32);
}

static void **map_slot(Map *map, uint64_t key) {
    size_t i = mixed(key) & map->mask;
    while (map->keys[i] != key && map->keys[i]) i = (i + 1) & map->mask;
    map->keys[i] = key;
    return &map->values[i];
}

static void *map_get(const Map *map, uint64_t key) {
    if (!map->used) return NULL;
    for (size_t i = mixed(key) & map->mask; map->keys[i]; i = (i + 1) & map->mask)
        if (map->keys[i] == key) return map->values[i];
    return NULL;
}

/* key must not be 0. False: no memory. */
static int map_put(Map *map, uint64_t key, void *value) {
    if (map->used * 2 >= map->mask) {
        Map bigger = {.mask = map->mask ? map->mask * 2 + 1 : 255};
        bigger.keys = PyMem_Calloc(bigger.mask + 1, sizeof *bigger.keys);
        bigger.values = PyMem_Calloc(bigger.mask + 1, sizeof *bigger.values);
        if (!bigger.keys || !bigger.values) {
            PyMem_Free(bigger.keys), PyMem_Free(bigger.values);
            PyErr_NoMemory();
            return 0;
        }
        for (size_t i = 0; map->mask && i <= map->mask; i++)
            if (map->values[i]) *map_slot(&bigger, map->keys[i]) = map->values[i], bigger.used++;
        PyMem_Free(map->keys), PyMem_Free(map->values);
        *map = bigger;
    }
    void **slot = map_slot(map, key);
    if (!*slot) map->used++; /* a removed entry that comes back is counted twice: it grows a little early */
    *slot = value;
    return 1;
}

static void map_clear(Map *map, void (*free_value)(void *)) {
    for (size_t i = 0; map->mask && i <= map->mask; i++)
        if (map->values[i]) free_value(map->values[i]);
    PyMem_Free(map->keys), PyMem_Free(map->values);
    *map = (Map){0};
}
