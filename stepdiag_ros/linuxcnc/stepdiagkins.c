/* SPDX-License-Identifier: Apache-2.0 OR GPL-2.0-or-later
 *
 * stepdiagkins: kinematics of a three-axis LinuxCNC machine with its 21 geometric errors.
 *
 *   loadrt stepdiagkins file=/path/volume.txt
 *   addf stepdiagkins.update servo-thread          (without it nothing is compensated)
 *   net all-homed motion.is-all-homed => stepdiagkins.enable
 *
 * Axis positions are where the tool point is, joint positions are what the drives are told; see
 * volume_field.h for the mathematics.  The correction is scaled by `scale`, which stepdiagkins.update
 * takes to 1 while `enable` is true and to 0 otherwise, so slowly that no joint is moved faster than
 * `slew`.  A file that cannot be used leaves the field at zero and `fault` true: the machine then moves
 * as with trivkins.
 */
#include "rtapi.h"
#include "rtapi_app.h"
#include "rtapi_math.h"
#include "hal.h"
#include "kinematics.h"
#include "emcmotcfg.h"
#include "volume_field.h"

MODULE_AUTHOR("stepdiag_ros");
MODULE_DESCRIPTION("Kinematics with the 21 geometric errors of a three-axis machine");
MODULE_LICENSE("Dual Apache-2.0/GPL");

static char *file;
RTAPI_MP_STRING(file, "solution file, written by stepdiag");

#define TOOL_SLEW 20.0           /* [mm/s] at which the lever follows a change of tool */

typedef struct {
    hal_bit_t *enable;           /* in: compensate */
    hal_bit_t *use_tool;         /* in: the tool vector is the one of tool-x.., not the file's */
    hal_float_t *tool[3];        /* in: LinuxCNC's tool offset, motion.tooloffset.x.. */
    hal_float_t *slew;           /* in: fastest change of a joint by ramping [mm/s] */
    hal_float_t *scale;          /* out: 0..1 */
    hal_float_t *error[3];       /* out: present correction [mm] */
    hal_bit_t *ramping;          /* out: the scale or the tool vector is on its way */
    hal_bit_t *active;           /* out: in full effect */
    hal_bit_t *fault;            /* out: no usable file; nothing is compensated */
} pins_t;

static field_t field;
static pins_t *pins;
static double tool[3];           /* that is in effect */
static double scale;
static double last_joint[3];
static int comp_id;

KINS_NOT_SWITCHABLE
EXPORT_SYMBOL(kinematicsType);
EXPORT_SYMBOL(kinematicsInverse);
EXPORT_SYMBOL(kinematicsForward);

KINEMATICS_TYPE kinematicsType(void)
{
    return KINEMATICS_BOTH;
}

int kinematicsForward(const double *j, EmcPose *pos, const KINEMATICS_FORWARD_FLAGS *fflags,
                      KINEMATICS_INVERSE_FLAGS *iflags)
{
    double x[3];

    (void)fflags; (void)iflags;
    field_forward(&field, j, tool, scale, x);
    pos->tran.x = x[0]; pos->tran.y = x[1]; pos->tran.z = x[2];
    pos->a = j[3]; pos->b = j[4]; pos->c = j[5];
    pos->u = j[6]; pos->v = j[7]; pos->w = j[8];
    return 0;
}

int kinematicsInverse(const EmcPose *pos, double *j, const KINEMATICS_INVERSE_FLAGS *iflags,
                      KINEMATICS_FORWARD_FLAGS *fflags)
{
    const double x[3] = {pos->tran.x, pos->tran.y, pos->tran.z};
    int k;

    (void)iflags; (void)fflags;
    if (field_inverse(&field, x, tool, scale, j) > FIELD_TURNS) return -1;   /* cannot be: checked at load */
    for (k = 0; k < 3; k++) last_joint[k] = j[k];
    j[3] = pos->a; j[4] = pos->b; j[5] = pos->c;
    j[6] = pos->u; j[7] = pos->v; j[8] = pos->w;
    return 0;
}

/* One step towards a goal, no farther than `most`; true when it is there. */
static int approach(double *value, double goal, double most)
{
    const double way = goal - *value;

    if (!(fabs(way) > most)) { *value = goal; return 1; }
    *value += way > 0.0 ? most : -most;
    return 0;
}

static void update(void *arg, long period)
{
    const double seconds = period * 1e-9;
    const double slew = *pins->slew > 0.0 ? *pins->slew : 0.0;
    double error[3], most = 1.0;
    int k, there = 1;

    (void)arg;
    if (field.known) {
        if (field.largest > 0.0) most = slew * seconds / field.largest;
        if (most > 0.01) most = 0.01;    /* never at once, however small the errors */
        for (k = 0; k < 3; k++)          /* a tool hangs along minus the offset that LinuxCNC adds for it */
            there &= approach(&tool[k], *pins->use_tool ? -*pins->tool[k] : field.tool[k], TOOL_SLEW * seconds);
        there &= approach(&scale, *pins->enable ? 1.0 : 0.0, most);
    }
    field_error(&field, last_joint, tool, scale, error);
    for (k = 0; k < 3; k++) *pins->error[k] = error[k];
    *pins->scale = scale;
    *pins->ramping = !there;
    *pins->active = field.known && there && scale == 1.0;
    *pins->fault = !field.known;
}

int rtapi_app_main(void)
{
    static const char *letter = "xyz";
    const char *wrong;
    int k, bad = 0;

    comp_id = hal_init("stepdiagkins");
    if (comp_id < 0) return comp_id;
    wrong = file && *file ? field_read(&field, file) : "no file= given";
    if (wrong)
        rtapi_print_msg(RTAPI_MSG_ERR, "stepdiagkins: %s: wrong: %s; nothing is compensated. Write the file "
                        "again with stepdiag compensate\n", file ? file : "", wrong);
    for (k = 0; k < 3; k++) tool[k] = field.tool[k];
    pins = hal_malloc(sizeof *pins);
    if (!pins) { hal_exit(comp_id); return -1; }
    memset(pins, 0, sizeof *pins);
    bad |= hal_pin_bit_newf(HAL_IN, &pins->enable, comp_id, "stepdiagkins.enable");
    bad |= hal_pin_bit_newf(HAL_IN, &pins->use_tool, comp_id, "stepdiagkins.use-tool");
    bad |= hal_pin_float_newf(HAL_IN, &pins->slew, comp_id, "stepdiagkins.slew");
    for (k = 0; k < 3; k++) {
        bad |= hal_pin_float_newf(HAL_IN, &pins->tool[k], comp_id, "stepdiagkins.tool-%c", letter[k]);
        bad |= hal_pin_float_newf(HAL_OUT, &pins->error[k], comp_id, "stepdiagkins.error-%c", letter[k]);
    }
    bad |= hal_pin_float_newf(HAL_OUT, &pins->scale, comp_id, "stepdiagkins.scale");
    bad |= hal_pin_bit_newf(HAL_OUT, &pins->ramping, comp_id, "stepdiagkins.ramping");
    bad |= hal_pin_bit_newf(HAL_OUT, &pins->active, comp_id, "stepdiagkins.active");
    bad |= hal_pin_bit_newf(HAL_OUT, &pins->fault, comp_id, "stepdiagkins.fault");
    bad |= hal_export_funct("stepdiagkins.update", update, 0, 1, 0, comp_id);
    if (bad) { hal_exit(comp_id); return -1; }
    *pins->slew = 0.1;
    *pins->fault = !field.known;
    hal_ready(comp_id);
    return 0;
}

void rtapi_app_exit(void)
{
    hal_exit(comp_id);
}
