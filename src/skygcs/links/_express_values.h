/* Python's objects as _express.c reads and sets them: socket addresses, and integers that are attributes. */
#include <Python.h>
#include <arpa/inet.h>
#include <netinet/in.h>
#include <stdint.h>
#include <string.h>

/* Addresses are of IPv4; a peer of IPv6 is no peer here and takes the Python way */

static int address_from(PyObject *tuple, struct sockaddr_in *out) {
    const char *host;
    int port;
    memset(out, 0, sizeof *out);
    if (!PyArg_ParseTuple(tuple, "si;an IPv4 address is (host, port)", &host, &port)) return 0;
    if (inet_pton(AF_INET, host, &out->sin_addr) != 1)
        return PyErr_Format(PyExc_ValueError, "%s is no numeric IPv4 address", host), 0;
    out->sin_family = AF_INET, out->sin_port = htons((uint16_t)port);
    return 1;
}

static PyObject *address_tuple(const struct sockaddr_in *a) {
    char host[INET_ADDRSTRLEN];
    return Py_BuildValue("si", inet_ntop(AF_INET, &a->sin_addr, host, sizeof host), ntohs(a->sin_port));
}

static uint64_t address_key(const struct sockaddr_in *a) {
    return (uint64_t)1 << 48 | (uint64_t)a->sin_port << 32 | a->sin_addr.s_addr;
}

static int add(PyObject *object, PyObject *name, long delta) {
    if (!delta) return 1;
    PyObject *before = PyObject_GetAttr(object, name);
    if (!before) return 0;
    PyObject *after = PyLong_FromLong(PyLong_AsLong(before) + delta);
    Py_DECREF(before);
    int good = after && !PyErr_Occurred() && !PyObject_SetAttr(object, name, after);
    Py_XDECREF(after);
    return good;
}

static int set_long(PyObject *object, PyObject *name, long value) {
    PyObject *number = PyLong_FromLong(value);
    int good = number && !PyObject_SetAttr(object, name, number);
    Py_XDECREF(number);
    return good;
}

static int get_long(PyObject *object, PyObject *name, long *value) {
    PyObject *number = PyObject_GetAttr(object, name);
    if (!number) return 0;
    *value = PyLong_AsLong(number);
    Py_DECREF(number);
    return !PyErr_Occurred();
}
