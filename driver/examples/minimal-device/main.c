/* A pseudo-terminal and a clock for the device, in place of a UART and a timer. Prints the port's name.
   SIGUSR1 opens the interlock, SIGUSR2 closes it, SIGHUP takes the power away and gives it back. */
#define _XOPEN_SOURCE 700
#define _DEFAULT_SOURCE
#include "device.h"
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

static struct device device;
static volatile sig_atomic_t interlock = 1, reboot;

static void on_signal(int number)
{
    if (number == SIGHUP)
        reboot = 1;
    else
        interlock = number == SIGUSR2;
}

static uint64_t clock_us(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000u + (uint64_t)t.tv_nsec / 1000u;
}

static uint32_t new_boot(void)
{
    uint32_t boot = (uint32_t)(clock_us() ^ ((uint64_t)getpid() << 16));
    return boot ? boot : 1;
}

static int open_port(void)
{
    struct termios raw;
    int master = posix_openpt(O_RDWR | O_NOCTTY);
    if (master < 0 || grantpt(master) || unlockpt(master))
        return -1;
    int slave = open(ptsname(master), O_RDWR | O_NOCTTY); /* stays open: the line is up between two hosts */
    if (slave < 0 || tcgetattr(slave, &raw))
        return -1;
    cfmakeraw(&raw);
    if (tcsetattr(slave, TCSANOW, &raw) || fcntl(master, F_SETFL, O_NONBLOCK))
        return -1;
    printf("%s\n", ptsname(master));
    fflush(stdout);
    return master;
}

int main(void)
{
    int port = open_port();
    uint64_t start = clock_us();
    uint8_t bytes[4096];
    if (port < 0)
        return perror("no pseudo-terminal"), 1;
    signal(SIGUSR1, on_signal);
    signal(SIGUSR2, on_signal);
    signal(SIGHUP, on_signal);
    device_boot(&device, new_boot());
    for (;;) {
        struct pollfd wait = {port, (short)(POLLIN | (device.out_size ? POLLOUT : 0)), 0};
        poll(&wait, 1, 1);
        if (reboot) {
            reboot = 0;
            start = clock_us();
            device_boot(&device, new_boot());
        }
        device.interlock = interlock;
        device.now = clock_us() - start;
        ssize_t size = read(port, bytes, sizeof bytes);
        if (size > 0)
            device_receive(&device, bytes, (size_t)size);
        device_poll(&device, clock_us() - start);
        if (device.out_size) {
            ssize_t sent = write(port, device.out, device.out_size);
            if (sent > 0) {
                device.out_size -= (size_t)sent;
                memmove(device.out, device.out + sent, device.out_size);
            }
        }
    }
}
