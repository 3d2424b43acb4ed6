/* The device's memory: all of it, there is no heap. */
#ifndef DEVICE_H
#define DEVICE_H
#include "wire.h"

enum { POINTS = 128, RING = 32, SAMPLES = 1024, REPLIES = 8, AGAIN = 64, REACH = 5000000 };

struct point { int32_t x, y; uint32_t wavelength; uint16_t averages; uint8_t settle; };
struct aline { uint32_t point; uint16_t size; uint8_t blob[44 + 2 * SAMPLES]; };
struct again { uint32_t number; uint8_t fragment; };
struct reply { uint16_t number, size; uint8_t bytes[MAX_PAYLOAD]; };

struct device {
    uint64_t now, until, not_before, last_shot, due, armed_at, shut_at, status_at, fault_at;
    uint32_t boot, nonce, token, plan, length, expected, position, interval, period;
    uint32_t produced, acknowledged, sent, limit, shots, wasted, laser_shots, fired, fault_number, impossible, peak;
    uint32_t session_seed, again_count, again_at, fragment, next_reply;
    int32_t x, y;
    uint16_t session, sequence, payload, samples, newest, caps_size;
    uint8_t cause, fault;
    int state, shutter, interlock, key, moving, refused, has_token, any, status_due;
    struct deframer in;
    struct point points[POINTS];
    struct aline ring[RING];
    struct again again[AGAIN];
    struct reply replies[REPLIES];
    uint8_t caps[400], out[16 * LONGEST];
    size_t out_size;
};

void device_boot(struct device *d, uint32_t boot);
void device_receive(struct device *d, const uint8_t *data, size_t size);
void device_poll(struct device *d, uint64_t now);     /* then send d->out, out_size bytes */
void device_lease(struct device *d, uint64_t echo, uint32_t ttl);
#endif
