/* Python's objects for _fast_path.c: socket addresses, integer attributes, exceptions. */
#include <Python.h>
#include <arpa/inet.h>
#include <netinet/in.h>
#include <stdint.h>
#include <string.h>

/* IPv4 only: Python handles datagrams of IPv6 peers. */

static int address_from(PyObject *tuple, struct sockaddr_in *out) {
    const char *host;
    int port;
    memset(out, 0, sizeof *out);
    if (!PyArg_ParseTuple(tuple, "si;an IPv4 address is (host, port)", &host, &port)) return 0;
    if (inet_pton(AF_INET, host, &out->sin_addr) != 1)
        return PyErr_Format(PyExc_ValueError, "%s is not a numeric IPv4 address", host), 0;
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

/* Counters have 64 bits: a `long` of a 32-bit machine would end at 2 GB. */

static int get_number(PyObject *object, PyObject *name, long long *value) {
    PyObject *number = PyObject_GetAttr(object, name);
    if (!number) return 0;
    *value = PyLong_AsLongLong(number);
    Py_DECREF(number);
    return *value != -1 || !PyErr_Occurred();
}

static int set_number(PyObject *object, PyObject *name, long long value) {
    PyObject *number = PyLong_FromLongLong(value);
    int good = number && !PyObject_SetAttr(object, name, number);
    Py_XDECREF(number);
    return good;
}

static int add(PyObject *object, PyObject *name, long long delta) {
    long long before;
    return !delta || (get_number(object, name, &before) && set_number(object, name, before + delta));
}

/* Exceptions as objects, whatever the version of Python; NULL if none is set. */

static PyObject *take_exception(void) {
#if PY_VERSION_HEX >= 0x030C0000
    return PyErr_GetRaisedException();
#else
    PyObject *type, *value, *trace;
    PyErr_Fetch(&type, &value, &trace);
    if (!type) return NULL;
    PyErr_NormalizeException(&type, &value, &trace);
    if (trace) PyException_SetTraceback(value, trace);
    Py_DECREF(type), Py_XDECREF(trace);
    return value;
#endif
}

static void raise_exception(PyObject *exception) {
#if PY_VERSION_HEX >= 0x030C0000
    PyErr_SetRaisedException(exception);
#else
    PyErr_Restore(Py_NewRef((PyObject *)Py_TYPE(exception)), exception, PyException_GetTraceback(exception));
#endif
}

/* The first exception of work that goes on nevertheless. */
typedef struct { PyObject *first; } Faults;

/* Keep the exception that is set now. The first one will be raised; the others go to sys.unraisablehook. */
static void set_aside(Faults *faults, PyObject *where) {
    if (faults->first) PyErr_WriteUnraisable(where);
    else faults->first = take_exception();
}

/* True if there were none; else raise the first one. */
static int none_of(Faults *faults) {
    if (!faults->first) return 1;
    raise_exception(faults->first);
    faults->first = NULL;
    return 0;
}
