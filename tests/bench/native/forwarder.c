/* The bare forwarder: what the kernel alone costs. recv, send; it knows nothing of MAVLink.
   forwarder IN_PORT OUT_PORT: from 127.0.0.1:IN_PORT to 127.0.0.1:OUT_PORT, over a connected socket. */
#include <arpa/inet.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <unistd.h>

static struct sockaddr_in local(int port) {
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons((unsigned short)port)};
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    return address;
}

int main(int argc, char **argv) {
    static char data[65536];
    if (argc != 3) return fprintf(stderr, "forwarder IN_PORT OUT_PORT\n"), 2;
    struct sockaddr_in in = local(atoi(argv[1])), out = local(atoi(argv[2]));
    int from = socket(AF_INET, SOCK_DGRAM, 0), to = socket(AF_INET, SOCK_DGRAM, 0), buffer = 4 << 20;
    setsockopt(from, SOL_SOCKET, SO_RCVBUF, &buffer, sizeof buffer); /* as skygcs asks for: else its lossless rate is half */
    if (bind(from, (struct sockaddr *)&in, sizeof in) || connect(to, (struct sockaddr *)&out, sizeof out))
        return perror("forwarder"), 1;
    for (;;) {
        ssize_t size = recv(from, data, sizeof data, 0);
        if (size > 0) (void)!send(to, data, (size_t)size, 0);
    }
}
