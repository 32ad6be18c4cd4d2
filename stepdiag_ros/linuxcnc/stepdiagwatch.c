/* SPDX-License-Identifier: Apache-2.0 OR GPL-2.0-or-later
 *
 * stepdiagwatch: stops a LinuxCNC machine whose remote client has fallen silent.
 *
 *   addf stepdiagwatch.update servo-thread
 *
 * `beat` changes with every sign of life of the client.  A move that begins with one, or sees one, is the
 * client's: from then on `beat` must change at least every `timeout` seconds until `moving` is false.  If it
 * does not, `inhibit` (for motion.feed-inhibit) becomes true in the same servo cycle, the axes brake within
 * their limits, and `abort` (for halui.abort) ends the move so that nothing goes on afterwards.  Moves that
 * somebody makes at the machine, without a client, are left alone.
 */
#include "rtapi.h"
#include "rtapi_app.h"
#include "rtapi_string.h"
#include "hal.h"

MODULE_AUTHOR("stepdiag_ros");
MODULE_DESCRIPTION("Stops the machine when its remote client is silent");
MODULE_LICENSE("Dual Apache-2.0/GPL");

typedef struct {
    hal_u32_t *beat;             /* in: changes with every sign of life */
    hal_bit_t *moving;           /* in: a commanded move is under way */
    hal_float_t *timeout;        /* in: longest silence [s] */
    hal_float_t *silent;         /* out: present silence [s] */
    hal_bit_t *hold;             /* in: hold the motion for another reason */
    hal_bit_t *guarded;          /* out: the present move is the client's */
    hal_bit_t *inhibit;          /* out: hold the motion */
    hal_bit_t *abort;            /* out: end the move */
    hal_u32_t *trips;            /* out: how often so far */
} pins_t;

static pins_t *pins;
static hal_u32_t last_beat;
static double silent = 1.0e9;    /* nobody was there yet */
static int guarded, tripped, was_moving, comp_id;

static void update(void *arg, long period)
{
    const int alive = *pins->beat != last_beat;

    (void)arg;
    last_beat = *pins->beat;
    silent = alive ? 0.0 : silent + period * 1e-9;
    if (!*pins->moving) guarded = tripped = 0;
    else if (alive || (!was_moving && silent <= *pins->timeout)) guarded = 1;
    was_moving = *pins->moving;
    if (guarded && !tripped && silent > *pins->timeout) {
        tripped = 1;
        ++*pins->trips;
    }
    *pins->silent = silent;
    *pins->guarded = guarded;
    *pins->inhibit = tripped || *pins->hold;
    *pins->abort = tripped;
}

int rtapi_app_main(void)
{
    int bad = 0;

    comp_id = hal_init("stepdiagwatch");
    if (comp_id < 0) return comp_id;
    pins = hal_malloc(sizeof *pins);
    if (!pins) { hal_exit(comp_id); return -1; }
    memset(pins, 0, sizeof *pins);
    bad |= hal_pin_u32_newf(HAL_IN, &pins->beat, comp_id, "stepdiagwatch.beat");
    bad |= hal_pin_bit_newf(HAL_IN, &pins->moving, comp_id, "stepdiagwatch.moving");
    bad |= hal_pin_float_newf(HAL_IN, &pins->timeout, comp_id, "stepdiagwatch.timeout");
    bad |= hal_pin_float_newf(HAL_OUT, &pins->silent, comp_id, "stepdiagwatch.silent");
    bad |= hal_pin_bit_newf(HAL_IN, &pins->hold, comp_id, "stepdiagwatch.hold");
    bad |= hal_pin_bit_newf(HAL_OUT, &pins->guarded, comp_id, "stepdiagwatch.guarded");
    bad |= hal_pin_bit_newf(HAL_OUT, &pins->inhibit, comp_id, "stepdiagwatch.inhibit");
    bad |= hal_pin_bit_newf(HAL_OUT, &pins->abort, comp_id, "stepdiagwatch.abort");
    bad |= hal_pin_u32_newf(HAL_OUT, &pins->trips, comp_id, "stepdiagwatch.trips");
    bad |= hal_export_funct("stepdiagwatch.update", update, 0, 1, 0, comp_id);
    if (bad) { hal_exit(comp_id); return -1; }
    *pins->timeout = 0.25;
    hal_ready(comp_id);
    return 0;
}

void rtapi_app_exit(void)
{
    hal_exit(comp_id);
}
