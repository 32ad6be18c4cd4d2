/* SPDX-License-Identifier: Apache-2.0 OR GPL-2.0-or-later
 *
 * The way that was not taken (docs/decisions/0231): the same compensation by external offsets.
 *
 *   loadrt stepdiagoffsets file=volume.txt
 *   addf stepdiagoffsets.update servo-thread
 *   net ... joint.N.pos-cmd => stepdiagoffsets.joint-N;  stepdiagoffsets.counts-N => axis.L.eoffset-counts
 *   setp axis.L.eoffset-scale 1e-6;  setp axis.L.eoffset-enable 1
 */
#include "rtapi.h"
#include "rtapi_app.h"
#include "rtapi_math.h"
#include "hal.h"
#include "volume_field.h"

MODULE_LICENSE("Dual Apache-2.0/GPL");
static char *file;
RTAPI_MP_STRING(file, "solution file");

typedef struct { hal_float_t *joint[3]; hal_s32_t *counts[3]; } pins_t;
static pins_t *pins;
static field_t field;
static int comp_id;

static void update(void *arg, long period)
{
    double q[3], error[3];
    int k;

    (void)arg; (void)period;
    for (k = 0; k < 3; k++) q[k] = *pins->joint[k];
    field_error(&field, q, field.tool, 1.0, error);
    for (k = 0; k < 3; k++) *pins->counts[k] = (int)rint(-error[k] * 1e6);
}

int rtapi_app_main(void)
{
    int k;

    comp_id = hal_init("stepdiagoffsets");
    if (comp_id < 0 || !file || field_read(&field, file)) return -1;
    pins = hal_malloc(sizeof *pins);
    for (k = 0; k < 3; k++) {
        hal_pin_float_newf(HAL_IN, &pins->joint[k], comp_id, "stepdiagoffsets.joint-%d", k);
        hal_pin_s32_newf(HAL_OUT, &pins->counts[k], comp_id, "stepdiagoffsets.counts-%d", k);
    }
    hal_export_funct("stepdiagoffsets.update", update, 0, 1, 0, comp_id);
    hal_ready(comp_id);
    return 0;
}

void rtapi_app_exit(void) { hal_exit(comp_id); }
