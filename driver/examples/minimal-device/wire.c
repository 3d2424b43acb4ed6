#include "wire.h"
#include <string.h>

uint32_t crc32c(const uint8_t *data, size_t size)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < size; i++) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; bit++)
            crc = (crc >> 1) ^ (crc & 1 ? 0x82F63B78u : 0);
    }
    return ~crc;
}

uint64_t get(const uint8_t *from, int bytes)
{
    uint64_t value = 0;
    while (bytes--)
        value = value << 8 | from[bytes];
    return value;
}

void put8(struct out *o, unsigned value)
{
    if (o->size < o->room)
        o->data[o->size++] = (uint8_t)value;
    else
        o->over = 1;
}

static void put(struct out *o, uint64_t value, int bytes)
{
    for (; bytes--; value >>= 8)
        put8(o, value & 0xFF);
}

void put16(struct out *o, unsigned value) { put(o, value, 2); }
void put32(struct out *o, uint32_t value) { put(o, value, 4); }
void put64(struct out *o, uint64_t value) { put(o, value, 8); }

/* COBS: each zero is replaced by the distance to the next one. */
static size_t stuff(uint8_t *to, const uint8_t *from, size_t size)
{
    size_t code = 0, at = 1;
    for (size_t i = 0; i < size; i++) {
        if (from[i])
            to[at++] = from[i];
        if (!from[i] || at - code == 255) {
            to[code] = (uint8_t)(at - code);
            code = at++;
        }
    }
    to[code] = (uint8_t)(at - code);
    return at;
}

static size_t unstuff(uint8_t *to, const uint8_t *from, size_t size)   /* 0: damaged */
{
    size_t at = 0, i = 0;
    while (i < size) {
        uint8_t code = from[i++];
        if (!code || i + code - 1 > size)
            return 0;
        memcpy(to + at, from + i, code - 1u);
        at += code - 1u;
        i += code - 1u;
        if (code < 255 && i < size)
            to[at++] = 0;
    }
    return at;
}

static int take(struct deframer *d, struct frame *f)
{
    size_t size = unstuff(d->body, d->raw, d->size);
    if (!size)
        return d->bad_stuffing++, 0;
    if (size < OVERHEAD || get(d->body + 8, 2) != size - OVERHEAD)
        return d->bad_length++, 0;
    if (crc32c(d->body, size - 4) != get(d->body + size - 4, 4))
        return d->bad_crc++, 0;
    if (d->body[0] != 0xF1 || d->body[2] & 0xF0)
        return d->bad_other++, 0;
    d->good++;
    *f = (struct frame){d->body[1], d->body[2], d->body[3], (uint16_t)get(d->body + 4, 2),
                        (uint16_t)(size - OVERHEAD), d->body + 10};
    return 1;
}

int deframe(struct deframer *d, uint8_t byte, struct frame *frame)
{
    int found = 0;
    if (byte) {
        if (d->size < LONGEST)
            d->raw[d->size++] = byte;
        else if (!d->skipping)
            d->skipping = 1, d->bad_other++;
        return 0;
    }
    if (d->size && !d->skipping)
        found = take(d, frame);
    d->size = 0;
    d->skipping = 0;
    return found;
}

uint32_t bad_frames(const struct deframer *d)
{
    return d->bad_crc + d->bad_length + d->bad_stuffing + d->bad_other;
}

size_t enframe(uint8_t *to, const struct frame *f, uint16_t sequence)
{
    uint8_t body[MAX_PAYLOAD + OVERHEAD];
    struct out o = {body, 0, sizeof body, 0};
    put8(&o, 0xF1);
    put8(&o, f->type);
    put8(&o, f->flags);
    put8(&o, f->boot);
    put16(&o, f->session);
    put16(&o, sequence);
    put16(&o, f->length);
    memcpy(body + o.size, f->payload, f->length);
    o.size += f->length;
    put32(&o, crc32c(body, o.size));
    to[0] = 0;
    size_t size = stuff(to + 1, body, o.size);
    to[size + 1] = 0;
    return size + 2;
}

static void head(struct out *o, unsigned major, uint64_t value)
{
    int bytes = value < 24 ? 0 : value < 0x100 ? 1 : value < 0x10000 ? 2 : value < 0x100000000 ? 4 : 8;
    int code = bytes == 8 ? 27 : bytes == 4 ? 26 : bytes == 2 ? 25 : 24;
    put8(o, major << 5 | (bytes ? (unsigned)code : (unsigned)value));
    while (bytes--)
        put8(o, value >> (8 * bytes) & 0xFF);
}

void cbor_map(struct out *o, unsigned pairs) { head(o, 5, pairs); }
void cbor_array(struct out *o, unsigned items) { head(o, 4, items); }
void cbor_bool(struct out *o, int value) { put8(o, value ? 0xF5 : 0xF4); }

void cbor_int(struct out *o, int64_t value)
{
    if (value < 0)
        head(o, 1, (uint64_t)(-1 - value));
    else
        head(o, 0, (uint64_t)value);
}

void cbor_text(struct out *o, const char *text)
{
    head(o, 3, strlen(text));
    while (*text)
        put8(o, (uint8_t)*text++);
}

void cbor_pair(struct out *o, const char *key, int64_t value)
{
    cbor_text(o, key);
    cbor_int(o, value);
}

static int item(const uint8_t **p, const uint8_t *end, unsigned *major, uint64_t *value)
{
    if (*p >= end)
        return 0;
    unsigned first = *(*p)++, code = first & 31, bytes = code < 24 ? 0 : 1u << (code - 24);
    *major = first >> 5;
    *value = code;
    if (code > 27 || (size_t)(end - *p) < bytes)
        return 0;
    if (bytes)
        for (*value = 0; bytes; bytes--)
            *value = *value << 8 | *(*p)++;
    return 1;
}

int cbor_read(const uint8_t *data, size_t size, struct pairs *pairs)
{
    const uint8_t *p = data, *end = data + size;
    unsigned major;
    uint64_t count, value;
    pairs->count = 0;
    if (!size)
        return 1;
    if (!item(&p, end, &major, &count) || major != 5 || count > 16)
        return 0;
    for (; count; count--) {
        if (!item(&p, end, &major, &value) || major != 3 || value >= 24 || (size_t)(end - p) < value)
            return 0;
        char *key = pairs->at[pairs->count].key;
        memcpy(key, p, value);
        key[value] = 0;
        p += value;
        if (!item(&p, end, &major, &value) || (major != 0 && major != 1 && major != 3 && major != 7))
            return 0;
        pairs->at[pairs->count].whole = major < 2 || (major == 7 && (value == 20 || value == 21));
        pairs->at[pairs->count].value =
            major == 1 ? -1 - (int64_t)value : major == 7 ? value == 21 : (int64_t)value;
        if (major == 3) {
            if ((size_t)(end - p) < value)
                return 0;
            p += value;
        }
        pairs->count++;
    }
    return p == end;
}

int find(const struct pairs *pairs, const char *key, int64_t *value)
{
    for (int i = 0; i < pairs->count; i++)
        if (!strcmp(pairs->at[i].key, key) && pairs->at[i].whole)
            return *value = pairs->at[i].value, 1;
    return 0;
}
