/* The least device that speaks driver/PROTOCOL.md: no tuning, no parameters, int16 only, hardware made up (see the
   functions named hw_). Bytes and a time in, bytes out; main.c gives it a line and a clock. Times are µs since boot. */
#include "device.h"
#include <string.h>

enum { BOOT, IDLE, LINKED, READY, ARMED, SCANNING, STARVED, BLOCKED, DRAINING, DONE, PAUSED, SAFE_HOLD, FAULTED, ESTOP };
enum event { NEW_SESSION, PLAN_NEW, PLAN_LOADED, ARM, ARM_EXPIRED, DISARM, START, POINTS_SHORT, POINTS_AT_HAND,
             RING_FULL, RING_FREED, LAST_POINT_FIRED, RING_EMPTY, PAUSE, LEASE_LAPSED, LASER_OFF, RELEASE,
             HARDWARE_FAULT, EMERGENCY_STOP, CLEAR_FAULT };
enum { OK, WRONG_STATE, OUT_OF_RANGE, BAD_TOKEN, NO_LEASE, UNKNOWN, STALE, MALFORMED, RING_NOT_EMPTY, NOT_SUPPORTED,
       HARDWARE };
enum { LASER_ARMED = 1, EMITTING = 2, SHUTTER_OPEN = 4, INTERLOCK_CLOSED = 8, KEY_ON = 16 };

#define MS 1000u
#define CAP 1000000u            /* longest lease */
#define ARM_TIME 30000000u
#define SHUTTER_TIME 50000u
#define MOVE_TIME 500u
#define LATE 1000u              /* a pulse missed by more is skipped */

static int running(const struct device *d) { return d->state >= SCANNING && d->state <= BLOCKED; }
static int secured(const struct device *d) { return d->interlock && d->key; }
static uint32_t fill(const struct device *d) { return d->produced - d->acknowledged; }

/* ---- what a real device has instead ---- */
static void hw_close(struct device *d) { d->shutter = 0; }
static void hw_open(struct device *d) { d->shutter = 1; }
static int16_t hw_sample(uint32_t point, uint32_t k) { return (int16_t)(37 * point + 11 * k); }

/* ---- what is said ---- */
static void say(struct device *d, uint8_t type, uint8_t flags, const struct out *o)
{
    if (d->out_size + LONGEST + 8 > sizeof d->out)
        return; /* everything is repeated */
    struct frame f = {type, flags, (uint8_t)d->boot, d->session, (uint16_t)o->size, o->data};
    d->out_size += enframe(d->out + d->out_size, &f, d->sequence++);
}

#define BUFFER(o) uint8_t o##_bytes[MAX_PAYLOAD]; struct out o = {o##_bytes, 0, sizeof o##_bytes, 0}

static unsigned laser_bits(const struct device *d)
{
    return (running(d) || d->state == ARMED ? LASER_ARMED : 0) | (d->shutter && secured(d) ? EMITTING : 0) |
           (d->shutter ? SHUTTER_OPEN : 0) | (d->interlock ? INTERLOCK_CLOSED : 0) | (d->key ? KEY_ON : 0);
}

static unsigned lease_left(const struct device *d)
{
    return d->until > d->now ? (unsigned)((d->until - d->now) / MS) : 0;
}

static void say_status(struct device *d)
{
    BUFFER(o);
    put64(&o, d->now);
    put32(&o, d->boot);
    put8(&o, d->state);
    put8(&o, laser_bits(d));
    put8(&o, d->cause);
    put8(&o, d->fault);
    put16(&o, lease_left(d));
    put32(&o, d->plan);
    put32(&o, d->position);
    put32(&o, d->produced);
    put32(&o, d->sent);
    put32(&o, d->acknowledged);
    put32(&o, d->shots);
    put32(&o, d->wasted);
    put64(&o, d->last_shot);
    put64(&o, d->until);
    put32(&o, (uint32_t)d->x);
    put32(&o, (uint32_t)d->y);
    put32(&o, bad_frames(&d->in));
    say(d, STATUS, 0, &o);
    d->status_due = 0;
    d->status_at = d->now + 100 * MS;
}

static uint32_t plan_limit(const struct device *d)
{
    return d->length - d->position < POINTS ? d->length : d->position + POINTS;
}

static void say_plan_status(struct device *d)
{
    BUFFER(o);
    put32(&o, d->plan);
    put32(&o, d->expected);
    put32(&o, plan_limit(d));
    put8(&o, d->refused ? 2 : 0);
    say(d, PLAN_STATUS, 0, &o);
}

/* ---- the states ---- */
static int after(int s, enum event e)
{
    int run = s >= SCANNING && s <= BLOCKED;
    switch (e) {
    case NEW_SESSION: return s == IDLE ? LINKED : run || s == ARMED ? SAFE_HOLD : s;
    case PLAN_NEW: return s == LINKED || s == READY || s == DONE || s == DRAINING || s == PAUSED || s == SAFE_HOLD ? LINKED : -1;
    case PLAN_LOADED: return s == LINKED ? READY : -1;
    case ARM: return s == READY || s == PAUSED || s == ARMED ? ARMED : -1;
    case ARM_EXPIRED: return s == ARMED ? READY : -1;
    case DISARM: return run || s == ARMED || s == PAUSED ? READY : -1;
    case START: return s == ARMED ? SCANNING : -1;
    case POINTS_SHORT: return s == SCANNING ? STARVED : -1;
    case POINTS_AT_HAND: return s == STARVED ? SCANNING : -1;
    case RING_FULL: return s == SCANNING ? BLOCKED : -1;
    case RING_FREED: return s == BLOCKED ? SCANNING : -1;
    case LAST_POINT_FIRED: return s == SCANNING ? DRAINING : -1;
    case RING_EMPTY: return s == DRAINING ? DONE : -1;
    case PAUSE: return run ? PAUSED : s == ARMED ? READY : -1;
    case LEASE_LAPSED: return run ? SAFE_HOLD : -1;
    case LASER_OFF: return run || s == ARMED || s == PAUSED ? SAFE_HOLD : -1;
    case RELEASE: return s == SAFE_HOLD ? READY : -1;
    case HARDWARE_FAULT: return s == FAULTED || s == ESTOP ? -1 : FAULTED;
    case EMERGENCY_STOP: return s == ESTOP ? -1 : ESTOP;
    case CLEAR_FAULT: return s == FAULTED || s == ESTOP ? SAFE_HOLD : -1;
    }
    return -1;
}

static void close_shutter(struct device *d)
{
    d->shut_at = d->now;
    hw_close(d);
}

static int loaded(const struct device *d) { return d->length && d->expected >= plan_limit(d); }

static int step(struct device *d, enum event e)
{
    int before = d->state, was_running = running(d), next = after(before, e);
    if (next < 0)
        return 0;
    if (e == RELEASE && !loaded(d))
        next = LINKED;
    d->state = next;
    if (next == before)
        return 1;
    d->status_due = 1;
    int left = was_running && !running(d);
    if (left && next != DRAINING) {
        d->until = d->until < d->now ? d->until : d->now;
        d->not_before = d->now;
    }
    if (next == SAFE_HOLD)
        d->cause = e == LEASE_LAPSED ? 1 : e == NEW_SESSION ? 2 : e == CLEAR_FAULT ? 4 : 3;
    else if (next != ARMED)
        d->cause = 0;
    if (next != ARMED)
        d->has_token = 0;
    if (e == CLEAR_FAULT)
        d->fault = 0;
    if (left || next >= SAFE_HOLD)
        close_shutter(d);
    if (left) {
        d->wasted += d->fired;
        d->fired = 0;
        d->moving = 0;
    }
    return 1;
}

static void raise_fault(struct device *d, unsigned code)
{
    if (step(d, HARDWARE_FAULT) || (d->state == ESTOP && !d->fault)) {
        d->fault = (uint8_t)code;
        d->fault_at = d->now;
        d->fault_number++;
    }
}

/* What is latched cannot be cleared while its cause is still read. */
static int cause_stands(const struct device *d)
{
    return d->shutter || ((d->fault == 1 || d->fault == 2) && !secured(d));
}

static void watch(struct device *d)
{
    if (!secured(d)) {
        if (running(d) || d->state == ARMED)
            raise_fault(d, d->interlock ? 2 : 1);
        else if ((d->state == SAFE_HOLD || d->state == PAUSED) && d->cause != 5)
            d->cause = 5, d->status_due = 1;
    }
    if (d->shutter && !running(d) && d->now - d->shut_at >= SHUTTER_TIME) {
        raise_fault(d, 3);
        close_shutter(d);
    }
}

/* ---- the scan ---- */
static uint64_t slot(const struct device *d, uint64_t from) { return (from + d->period - 1) / d->period * d->period; }

static void record(struct device *d, const struct point *point)
{
    struct aline *a = &d->ring[d->produced % RING];
    uint8_t *samples = a->blob + 44;
    struct out o = {samples, 0, 2u * SAMPLES, 0}, meta = {a->blob, 0, 44, 0};
    const float scale = 0.25f;
    uint32_t bits;
    for (uint32_t k = 0; k < d->samples; k++)
        put16(&o, (uint16_t)hw_sample(d->position, k));
    memcpy(&bits, &scale, 4);
    put64(&meta, d->now);
    put32(&meta, point->wavelength ? point->wavelength : 1550000);
    put32(&meta, d->shots);
    put32(&meta, crc32c(samples, o.size));
    put32(&meta, bits);
    put32(&meta, d->interval);
    put16(&meta, d->samples);
    put16(&meta, d->fired);
    put16(&meta, 10000); /* energy */
    put16(&meta, 1200);  /* DC level */
    put16(&meta, 0);     /* gain */
    put16(&meta, 0);     /* quality, reserved */
    put32(&meta, 0);     /* time zero */
    a->point = d->position;
    a->size = (uint16_t)(44 + o.size);
    d->produced++;
    if (fill(d) > d->peak)
        d->peak = fill(d);
}

static void fire(struct device *d, const struct point *point)
{
    d->shots++;
    d->laser_shots++;
    d->last_shot = d->now;
    if (++d->fired < (point->averages ? point->averages : 1)) {
        d->due = slot(d, d->now + 1);
        return;
    }
    record(d, point);
    d->position++;
    d->fired = 0;
    d->moving = 0;
}

static void scan(struct device *d)
{
    while (running(d)) {
        if (d->now >= d->until) {
            step(d, LEASE_LAPSED);
            return;
        }
        if (d->position >= d->length) {
            step(d, LAST_POINT_FIRED);
            return;
        }
        if (fill(d) >= RING) {
            step(d, RING_FULL);
            return;
        }
        step(d, RING_FREED);
        if (d->position >= d->expected) {
            step(d, POINTS_SHORT);
            return;
        }
        step(d, POINTS_AT_HAND);
        const struct point *point = &d->points[d->position % POINTS];
        if (!d->moving) {
            uint64_t settled = d->now + MOVE_TIME + 100u * point->settle;
            d->moving = 1;
            d->x = point->x;
            d->y = point->y;
            d->due = slot(d, settled > d->last_shot ? settled : d->last_shot + 1);
        }
        if (d->now < d->due)
            return;
        if (d->now - d->due > LATE) {
            d->due = slot(d, d->now);
            continue;
        }
        fire(d, point);
    }
}

/* ---- A-lines on their way ---- */
static unsigned fragments(const struct device *d, const struct aline *a)
{
    unsigned room = d->payload - 16u;
    return (a->size + room - 1) / room;
}

static void say_fragment(struct device *d, uint32_t number, unsigned fragment, uint8_t flags)
{
    const struct aline *a = &d->ring[number % RING];
    unsigned room = d->payload - 16u, at = fragment * room, size = a->size - at < room ? a->size - at : room;
    BUFFER(o);
    put32(&o, d->plan);
    put32(&o, number);
    put32(&o, a->point);
    put8(&o, fragment);
    put8(&o, fragments(d, a));
    put8(&o, 0);
    put8(&o, 0);
    memcpy(o_bytes + 16, a->blob + at, size);
    o.size += size;
    say(d, ALINE, flags, &o);
}

static void say_alines(struct device *d)
{
    while (d->out_size < 2 * LONGEST) {
        if (d->again_count) {
            uint32_t number = d->again[0].number;
            unsigned fragment = d->again[0].fragment, held = number >= d->acknowledged && number < d->sent;
            unsigned count = held ? fragments(d, &d->ring[number % RING]) : 0;
            if (held && (fragment == 0xFF ? d->again_at : fragment) < count)
                say_fragment(d, number, fragment == 0xFF ? d->again_at : fragment, RETRANSMISSION);
            if (held && fragment == 0xFF && ++d->again_at < count)
                continue;
            d->again_at = 0;
            memmove(d->again, d->again + 1, --d->again_count * sizeof d->again[0]);
        } else if (d->sent < d->produced && d->sent < d->limit) {
            say_fragment(d, d->sent, d->fragment, 0);
            if (++d->fragment >= fragments(d, &d->ring[d->sent % RING]))
                d->sent++, d->fragment = 0;
        } else {
            return;
        }
    }
}

/* ---- requests ---- */
static void capabilities(struct device *d)
{
    static const struct { const char *key; int64_t low, high; } ranges[] = {
        {"x_nm", -REACH, REACH}, {"y_nm", -REACH, REACH}, {"samples", 16, SAMPLES}, {"averages", 1, 1000},
        {"interval_ps", 1000, 1000000}, {"pulse_rate_mhz", 1000, 1000000}, {"wavelength_pm", 1545000, 1555000}};
    struct out o = {d->caps, 0, sizeof d->caps, 0};
    cbor_map(&o, 16);
    for (size_t i = 0; i < sizeof ranges / sizeof ranges[0]; i++) {
        cbor_text(&o, ranges[i].key);
        cbor_array(&o, 2);
        cbor_int(&o, ranges[i].low);
        cbor_int(&o, ranges[i].high);
    }
    cbor_text(&o, "model");
    cbor_text(&o, "minimal device");
    cbor_text(&o, "serial");
    cbor_text(&o, "C-1");
    cbor_text(&o, "simulated");
    cbor_bool(&o, 1);
    cbor_text(&o, "encodings");
    cbor_array(&o, 1);
    cbor_int(&o, 0);
    cbor_pair(&o, "adc_bits", 16);
    cbor_pair(&o, "beams", 1);
    cbor_pair(&o, "clock_rate", 1);
    cbor_pair(&o, "line_rate", 0);
    cbor_pair(&o, "lease_cap_us", CAP);
    d->caps_size = (uint16_t)o.size;
}

static void answer_get(struct device *d, struct out *o)
{
    const struct { const char *key; int64_t value; } all[] = {
        {"device_time", (int64_t)d->now}, {"boot", d->boot}, {"state", d->state}, {"laser", laser_bits(d)},
        {"cause", d->cause}, {"fault", d->fault}, {"lease_left", lease_left(d)}, {"plan", d->plan},
        {"position", d->position}, {"produced", d->produced}, {"sent", d->sent}, {"acknowledged", d->acknowledged},
        {"shots", d->shots}, {"shots_wasted", d->wasted}, {"last_shot", (int64_t)d->last_shot},
        {"lease_until", (int64_t)d->until}, {"x", d->x}, {"y", d->y}, {"bad_frames", bad_frames(&d->in)},
        {"good_frames", d->in.good}, {"bad_crc", d->in.bad_crc}, {"bad_length", d->in.bad_length},
        {"bad_stuffing", d->in.bad_stuffing}, {"payload", d->payload}, {"overhead", OVERHEAD}, {"ring_peak", d->peak},
        {"laser_shots", d->laser_shots}, {"impossible_echoes", d->impossible}};
    cbor_map(o, sizeof all / sizeof all[0]);
    for (size_t i = 0; i < sizeof all / sizeof all[0]; i++)
        cbor_pair(o, all[i].key, all[i].value);
}

static int refuse(struct out *o, int result, const char *field)
{
    cbor_map(o, 1);
    cbor_text(o, "field");
    cbor_text(o, field);
    return result;
}

static int plan_new(struct device *d, const struct pairs *p, struct out *o)
{
    int64_t plan, length, samples, interval, rate, purge = 0, start = 0, encoding = 0, group = 1, beams = 1;
    if (!find(p, "plan", &plan) || !find(p, "length", &length) || !find(p, "samples", &samples) ||
        !find(p, "interval_ps", &interval) || !find(p, "pulse_rate_mhz", &rate))
        return MALFORMED;
    find(p, "purge", &purge);
    find(p, "start", &start);
    find(p, "encoding", &encoding);
    find(p, "group", &group);
    find(p, "beams", &beams);
    const struct { const char *key; int64_t value, low, high; } ranges[] = {
        {"samples", samples, 16, SAMPLES}, {"interval_ps", interval, 1000, 1000000},
        {"pulse_rate_mhz", rate, 1000, 1000000}, {"plan", plan, 1, 0xFFFFFFFF}, {"length", length, 1, 0xFFFFFFFF},
        {"start", start, 0, length - 1}, {"encoding", encoding, 0, 0}, {"group", group, 1, 255},
        {"beams", beams, 1, 1}};
    for (size_t i = 0; i < sizeof ranges / sizeof ranges[0]; i++)
        if (ranges[i].value < ranges[i].low || ranges[i].value > ranges[i].high)
            return refuse(o, OUT_OF_RANGE, ranges[i].key);
    if (fill(d) && !purge)
        return RING_NOT_EMPTY;
    if (!step(d, PLAN_NEW))
        return WRONG_STATE;
    if (fill(d)) {
        BUFFER(gone);
        put32(&gone, d->plan);
        put32(&gone, d->acknowledged);
        put32(&gone, fill(d));
        put8(&gone, 1);
        say(d, ALINE_GONE, 0, &gone);
    }
    d->plan = (uint32_t)plan;
    d->length = (uint32_t)length;
    d->samples = (uint16_t)samples;
    d->interval = (uint32_t)interval;
    d->period = (uint32_t)(1000000000 / rate);
    d->position = d->expected = d->produced = d->acknowledged = d->sent = d->limit = (uint32_t)start;
    d->fragment = d->again_count = d->peak = 0;
    d->refused = 0;
    say_plan_status(d);
    return OK;
}

static int start(struct device *d, const struct pairs *p, struct out *o)
{
    int64_t token, echo, ttl;
    if (!find(p, "token", &token) || !find(p, "echo", &echo) || !find(p, "ttl", &ttl))
        return MALFORMED;
    if (d->state != ARMED)
        return WRONG_STATE;
    if (!d->has_token || token != d->token)
        return BAD_TOKEN;
    d->until = 0;
    device_lease(d, (uint64_t)echo, (uint32_t)ttl);
    if (d->now >= d->until)
        return NO_LEASE;
    watch(d);
    if (!secured(d) || d->fault)
        return HARDWARE;
    cbor_map(o, 1);
    cbor_pair(o, "laser_shots", d->laser_shots);
    hw_open(d);
    step(d, START);
    return OK;
}

static int carry_out(struct device *d, unsigned operation, const struct pairs *p, struct out *o)
{
    int at_rest = !running(d) && d->state != ARMED && d->state != FAULTED && d->state != ESTOP;
    switch (operation) {
    case 1: answer_get(d, o); return OK;
    case 2: return !at_rest ? WRONG_STATE : p->count ? refuse(o, NOT_SUPPORTED, p->at[0].key) : OK;
    case 3: return plan_new(d, p, o);
    case 4:
        if (!step(d, ARM))
            return WRONG_STATE;
        d->armed_at = d->now;
        d->has_token = 1;
        d->token = d->token * 1664525u + 1013904223u;
        cbor_map(o, 1);
        cbor_pair(o, "token", d->token);
        return OK;
    case 5: return start(d, p, o);
    case 6: return step(d, PAUSE) ? OK : WRONG_STATE;
    case 7: return at_rest ? close_shutter(d), OK : WRONG_STATE;
    case 8: return at_rest ? NOT_SUPPORTED : WRONG_STATE;
    case 9: return step(d, DISARM) ? OK : WRONG_STATE;
    case 10:
        if (d->state >= FAULTED && d->shutter)
            close_shutter(d);
        return !cause_stands(d) && step(d, CLEAR_FAULT) ? OK : WRONG_STATE;
    case 11: return step(d, RELEASE) ? OK : WRONG_STATE;
    default: return UNKNOWN;
    }
}

static void request(struct device *d, const uint8_t *data, unsigned size)
{
    uint16_t number = (uint16_t)get(data, 2), ahead = (uint16_t)(number - d->newest);
    for (int i = 0; i < REPLIES; i++)
        if (d->replies[i].size && d->replies[i].number == number) {
            struct out known = {d->replies[i].bytes, d->replies[i].size, MAX_PAYLOAD, 0};
            say(d, RSP, 0, &known);
            return;
        }
    BUFFER(o);
    BUFFER(body);
    struct pairs pairs;
    int result = d->any && !(ahead && ahead < 0x8000) ? STALE : cbor_read(data + 3, size - 3, &pairs) ? OK : MALFORMED;
    if (result == OK)
        result = carry_out(d, data[2], &pairs, &body);
    put16(&o, number);
    put8(&o, data[2]);
    put8(&o, result);
    put8(&o, d->state);
    if (!body.size)
        cbor_map(&body, 0);
    memcpy(o_bytes + o.size, body_bytes, body.size);
    o.size += body.size;
    if (result != STALE) {
        struct reply *kept = &d->replies[d->next_reply++ % REPLIES];
        kept->number = d->newest = number;
        kept->size = (uint16_t)o.size;
        memcpy(kept->bytes, o_bytes, o.size);
        d->any = 1;
    }
    say(d, RSP, 0, &o);
}

/* ---- the other messages ---- */
static void hello(struct device *d, const uint8_t *data)
{
    uint32_t nonce = (uint32_t)get(data + 4, 4);
    int version = data[0] <= 2 && data[1] >= 2 ? 2 : 0;
    if (version && (!d->session || nonce != d->nonce)) {
        unsigned payload = (unsigned)get(data + 2, 2);
        step(d, NEW_SESSION);
        d->nonce = nonce;
        d->session = (uint16_t)(d->session_seed = d->session_seed % 0xFFFF + 1);
        d->payload = (uint16_t)(payload < 64 ? 64 : payload > MAX_PAYLOAD ? MAX_PAYLOAD : payload);
        d->has_token = d->any = 0;
        memset(d->replies, 0, sizeof d->replies);
        d->out_size = 0;
        d->until = d->until < d->now ? d->until : d->now;
        d->not_before = d->now;
        d->sent = d->acknowledged;
        d->limit = d->fragment = d->again_count = 0;
        d->status_due = 1;
    }
    BUFFER(o);
    put32(&o, nonce);
    put32(&o, d->boot);
    put16(&o, d->session);
    put8(&o, version);
    put8(&o, 1);
    put8(&o, d->state);
    put8(&o, 1);
    put16(&o, d->payload);
    put16(&o, RING);
    put16(&o, d->caps_size);
    put32(&o, crc32c(d->caps, d->caps_size));
    put32(&o, d->plan);
    put32(&o, d->length);
    put32(&o, d->position);
    put32(&o, d->produced);
    put32(&o, d->acknowledged);
    put64(&o, d->now);
    say(d, HELLO_ACK, 0, &o);
}

static void caps(struct device *d, const uint8_t *data)
{
    unsigned offset = (unsigned)get(data, 2), room = d->payload - 4u;
    unsigned left = offset < d->caps_size ? d->caps_size - offset : 0, size = left < room ? left : room;
    BUFFER(o);
    put16(&o, offset);
    put16(&o, d->caps_size);
    memcpy(o_bytes + 4, d->caps + (left ? offset : 0), size);
    o.size += size;
    say(d, CAPS_PIECE, 0, &o);
}

static struct point point_at(const uint8_t *p)
{
    return (struct point){(int32_t)get(p, 4), (int32_t)get(p + 4, 4), (uint32_t)get(p + 8, 4),
                          (uint16_t)get(p + 12, 2), p[15]};
}

static void plan_data(struct device *d, const uint8_t *data, unsigned count)
{
    uint32_t first = (uint32_t)get(data + 4, 4);
    if (get(data, 4) != d->plan || !d->length) {
        say_plan_status(d);
        return;
    }
    for (unsigned i = 0; i < count; i++) {
        struct point p = point_at(data + 10 + 16 * i);
        if (p.x < -REACH || p.x > REACH || p.y < -REACH || p.y > REACH || p.averages < 1 || p.averages > 1000 ||
            (p.wavelength && (p.wavelength < 1545000 || p.wavelength > 1555000)) || data[10 + 16 * i + 14] & 8) {
            d->refused = 1;
            say_plan_status(d);
            return;
        }
    }
    for (unsigned i = 0; i < count; i++)
        if (first + i == d->expected && d->expected < plan_limit(d))
            d->points[d->expected++ % POINTS] = point_at(data + 10 + 16 * i);
    if (loaded(d) && d->state == LINKED)
        step(d, PLAN_LOADED);
    say_plan_status(d);
}

static void aline_ack(struct device *d, const uint8_t *data, unsigned missing)
{
    uint32_t durable = (uint32_t)get(data + 4, 4), limit = (uint32_t)get(data + 8, 4);
    if (get(data, 4) != d->plan || durable > d->produced)
        return;
    if (durable > d->acknowledged)
        d->acknowledged = durable;
    if (d->sent < d->acknowledged)
        d->sent = d->acknowledged, d->fragment = 0;
    if (limit > d->limit)
        d->limit = limit;
    for (unsigned i = 0; i < missing && d->again_count < AGAIN; i++) {
        struct again wanted = {(uint32_t)get(data + 12 + 5 * i, 4), data[16 + 5 * i]};
        int known = wanted.number < d->acknowledged || wanted.number >= d->sent;
        for (unsigned k = 0; k < d->again_count; k++)
            known |= d->again[k].number == wanted.number && d->again[k].fragment == wanted.fragment;
        if (!known)
            d->again[d->again_count++] = wanted;
    }
}

void device_lease(struct device *d, uint64_t echo, uint32_t ttl)
{
    if (echo > d->now)
        d->impossible++;
    else if (echo >= d->not_before && echo + (ttl < CAP ? ttl : CAP) > d->until)
        d->until = echo + (ttl < CAP ? ttl : CAP);
}

static void stop(struct device *d, const uint8_t *data)
{
    if (!step(d, data[0] == 1 ? PAUSE : data[0] == 3 ? EMERGENCY_STOP : LASER_OFF) && data[0] != 1
        && d->state == SAFE_HOLD && d->cause != 5)
        d->cause = 3, d->status_due = 1; /* a scan that is interrupted does not come back by itself now */
    BUFFER(o);
    put8(&o, data[0]);
    put32(&o, (uint32_t)get(data + 1, 4));
    put8(&o, d->state);
    say(d, ABORT_ACK, URGENT, &o);
}

static void handle(struct device *d, const struct frame *f)
{
    const uint8_t *p = f->payload;
    unsigned size = f->length;
    int mine = d->session && f->session == d->session && f->boot == (uint8_t)d->boot, short_or_long = 1;
    if (f->type == HELLO && size == 8)
        hello(d, p), short_or_long = 0;
    else if (f->type == ABORT && size == 5)
        stop(d, p), short_or_long = 0;
    else if (!mine || (f->type & 0x80))
        return;
    else if (f->type == CAPS && size == 2)
        caps(d, p), short_or_long = 0;
    else if (f->type == REQ && size >= 3)
        request(d, p, size), short_or_long = 0;
    else if (f->type == PLAN_DATA && size >= 10 && size == 10 + 16 * get(p + 8, 2))
        plan_data(d, p, (unsigned)get(p + 8, 2)), short_or_long = 0;
    else if (f->type == ALINE_ACK && size >= 12 && (size - 12) % 5 == 0)
        aline_ack(d, p, (size - 12) / 5), short_or_long = 0;
    else if (f->type == LEASE && size == 16) {
        short_or_long = 0;
        if (get(p, 4) == d->boot)
            device_lease(d, get(p + 4, 8), (uint32_t)get(p + 12, 4));
    } else if (f->type == FAULT_ACK && size == 6) {
        short_or_long = 0;
        if (get(p + 2, 4) == d->fault_number)
            d->fault_at = UINT64_MAX;
    }
    d->in.bad_length += (uint32_t)short_or_long;
}

/* ---- from outside ---- */
void device_boot(struct device *d, uint32_t boot)
{
    uint32_t laser_shots = d->laser_shots;
    memset(d, 0, sizeof *d);
    d->laser_shots = laser_shots; /* the laser's own counter survives */
    d->boot = boot;
    d->token = boot;
    d->session_seed = boot >> 8 & 0xFFFF;
    d->interlock = d->key = 1;
    d->payload = 64;
    d->period = 20000;
    capabilities(d);
    close_shutter(d);
    d->state = IDLE;
}

void device_receive(struct device *d, const uint8_t *data, size_t size)
{
    struct frame f;
    for (size_t i = 0; i < size; i++)
        if (deframe(&d->in, data[i], &f))
            handle(d, &f);
}

void device_poll(struct device *d, uint64_t now)
{
    d->now = now;
    if (running(d) && now >= d->until)
        step(d, LEASE_LAPSED);
    if (d->state == ARMED && now - d->armed_at >= ARM_TIME)
        step(d, ARM_EXPIRED);
    watch(d);
    scan(d);
    if (d->state == DRAINING && !fill(d))
        step(d, RING_EMPTY);
    if (!d->session)
        return;
    if (d->fault && now >= d->fault_at) {
        BUFFER(o);
        put16(&o, d->fault);
        put32(&o, d->fault_number);
        say(d, FAULT, URGENT, &o);
        d->fault_at = now + 100 * MS;
    }
    if (d->status_due || now >= d->status_at) {
        if (!d->status_due && d->expected < d->length)
            say_plan_status(d);
        say_status(d);
    }
    say_alines(d);
}
