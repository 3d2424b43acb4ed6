/* Frames, checksums and CBOR, as driver/PROTOCOL.md has them. Little-endian integers are written byte by byte. */
#ifndef WIRE_H
#define WIRE_H
#include <stddef.h>
#include <stdint.h>

enum { MAX_PAYLOAD = 641, OVERHEAD = 14, LONGEST = 700 };

enum { HELLO = 0x01, CAPS = 0x02, REQ = 0x03, PLAN_DATA = 0x10, ALINE_ACK = 0x20, LEASE = 0x30, ABORT = 0x31,
       FAULT_ACK = 0x32, HELLO_ACK = 0x81, CAPS_PIECE = 0x82, RSP = 0x83, PLAN_STATUS = 0x90, ALINE = 0xA0,
       ALINE_GONE = 0xA1, STATUS = 0xB0, ABORT_ACK = 0xB1, FAULT = 0xB2 };
enum { RETRANSMISSION = 1, URGENT = 2 };

struct frame { uint8_t type, flags, boot; uint16_t session, length; const uint8_t *payload; };

struct deframer {
    uint8_t raw[LONGEST], body[LONGEST];
    size_t size;
    int skipping;
    uint32_t good, bad_crc, bad_length, bad_stuffing, bad_other;
};

/* A buffer that is written to; what does not fit is left out, and `over` says so. */
struct out { uint8_t *data; size_t size, room; int over; };

uint32_t crc32c(const uint8_t *data, size_t size);
int deframe(struct deframer *d, uint8_t byte, struct frame *frame);
size_t enframe(uint8_t *to, const struct frame *frame, uint16_t sequence);
uint32_t bad_frames(const struct deframer *d);

void put8(struct out *o, unsigned value);
void put16(struct out *o, unsigned value);
void put32(struct out *o, uint32_t value);
void put64(struct out *o, uint64_t value);
uint64_t get(const uint8_t *from, int bytes);

void cbor_map(struct out *o, unsigned pairs);
void cbor_array(struct out *o, unsigned items);
void cbor_int(struct out *o, int64_t value);
void cbor_text(struct out *o, const char *text);
void cbor_bool(struct out *o, int value);
void cbor_pair(struct out *o, const char *key, int64_t value);

/* A map of text keys with integers and booleans, as requests carry it. */
struct pairs { int count; struct { char key[24]; int64_t value; int whole; } at[16]; };
int cbor_read(const uint8_t *data, size_t size, struct pairs *pairs);          /* 0: not such a map */
int find(const struct pairs *pairs, const char *key, int64_t *value);         /* 0: not there, or no integer */
#endif
