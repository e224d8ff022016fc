"""Templates of the C header, filled in by ``c_header``; the C names are public and must not change."""

HEADER = """/* {kind} controller tuned by smajax {version}.
 * Include it where the loop runs, and call smajax_step once every SMAJAX_PERIOD s.
 *
 *     smajax_state s;
 *     smajax_reset(&s, reference, value);
{use} *
 * Units: reference and value in {channel_unit}, command in {command_unit}.
 * Define SMAJAX_REAL as float where doubles are slow.
 * A value or reference that is NaN or infinite (a sensor dropout) is replaced by the last finite one; before the first
 * finite ones the command is 0. It is also 0 when there has been no finite value for SMAJAX_BLIND s; with the next one
 * the controller is reset.
 */
#ifndef SMAJAX_CONTROLLER_H
#define SMAJAX_CONTROLLER_H
{include}
#ifndef SMAJAX_REAL
#define SMAJAX_REAL double
#endif
typedef SMAJAX_REAL smajax_real;

#define SMAJAX_PERIOD ((smajax_real){period!r})
#define SMAJAX_LOWER ((smajax_real){lower!r})
#define SMAJAX_UPPER ((smajax_real){upper!r})
#define SMAJAX_BLIND ((smajax_real){blind!r}) /* s without a measurement after which the command is 0 */
{constants}

typedef struct {{
    smajax_real integral, last, slope, value, reference, missing;
    int begun;{more}
}} smajax_state;

static inline smajax_real smajax_seen(smajax_real reference, smajax_real value) {{ {seen} }}

static inline smajax_real smajax_clip(smajax_real x, smajax_real lower, smajax_real upper) {{
    return x < lower ? lower : x > upper ? upper : x;
}}

static inline int smajax_is_number(smajax_real x) {{
    return x - x <= 0;
}}

static inline smajax_real smajax_known(smajax_real measured, smajax_real *last) {{
    if (smajax_is_number(measured)) *last = measured;
    return *last;
}}
{functions}
static inline smajax_real smajax_slope(const smajax_state *s, smajax_real reference, smajax_real value) {{
    return (SMAJAX_FILTER_TIME * s->slope + smajax_seen(reference, value) - s->last)
           / (SMAJAX_FILTER_TIME + SMAJAX_PERIOD);
}}

static inline smajax_real smajax_pid(smajax_state *s, smajax_real reference, smajax_real value,
                                     smajax_real kp, smajax_real ki, smajax_real kd,
                                     smajax_real lower, smajax_real upper) {{
    smajax_real slope = smajax_slope(s, reference, value), error = reference - value;
    smajax_real integral = s->integral + ki * error * SMAJAX_PERIOD;
    smajax_real unsaturated = kp * error + integral + kd * slope;
    int winds_up = (unsaturated > upper && integral > s->integral) || (unsaturated < lower && integral < s->integral);
    if (!winds_up) s->integral = integral;
    s->last = smajax_seen(reference, value);
    s->slope = slope;
    return smajax_clip(unsaturated, lower, upper);
}}

static inline void smajax_begin(smajax_state *s, smajax_real reference, smajax_real value) {{
    s->integral = 0;
    s->last = smajax_seen(reference, value);
    s->slope = 0;{reset}
}}

static inline void smajax_reset(smajax_state *s, smajax_real reference, smajax_real value) {{
    s->begun = smajax_is_number(reference) && smajax_is_number(value);
    s->reference = s->begun ? reference : 0;
    s->value = s->begun ? value : 0;
    s->missing = 0;
    smajax_begin(s, s->reference, s->value);
}}

static inline smajax_real smajax_go(smajax_state *s, smajax_real reference, smajax_real value,
                                    smajax_real lower, smajax_real upper) {{
{step}
}}

static inline smajax_real smajax_step_within(smajax_state *s, smajax_real reference, smajax_real value,
                                             smajax_real lower, smajax_real upper) {{
    int lost = s->missing >= SMAJAX_BLIND;
    if (!s->begun) smajax_reset(s, reference, value);
    if (!s->begun) return smajax_clip(0, lower, upper);
    s->missing = smajax_is_number(value) ? 0 : s->missing + SMAJAX_PERIOD;
    reference = smajax_known(reference, &s->reference);
    value = smajax_known(value, &s->value);
    if (s->missing >= SMAJAX_BLIND) return smajax_clip(0, lower, upper);
    if (lost) smajax_begin(s, reference, value);
    return smajax_go(s, reference, value, lower, upper);
}}

static inline smajax_real smajax_step(smajax_state *s, smajax_real reference, smajax_real value) {{
    return smajax_step_within(s, reference, value, SMAJAX_LOWER, SMAJAX_UPPER);
}}
{pair}{guard}
#endif
"""
PAIR = """
/* The commands of two wires that pull against each other: a command above 0 heats the first, one below 0 the second. */
static inline void smajax_allocate(smajax_real command, smajax_real each[2]) {{
    each[0] = smajax_clip(SMAJAX_CO_CONTRACTION + (command > 0 ? command : 0), 0, (smajax_real){first!r});
    each[1] = smajax_clip(SMAJAX_CO_CONTRACTION + (command < 0 ? -command : 0), 0, (smajax_real){second!r});
}}
"""
USE = " *     each period:  command = smajax_step(&s, reference, value);\n"
PAIR_USE = " *     each period:  smajax_allocate(smajax_step(&s, reference, value), each);\n"
LIMITER_USE = """ *     each period:  most = smajax_guard(&g, temperature, SMAJAX_UPPER);
 *                   command = smajax_step_guarded(&s, reference, value, most);
 * with a smajax_guard_state g that smajax_guard_reset(&g, temperature) has set.
"""
LIMITED_PAIR_USE = """ *     each period:  most[0] = smajax_guard(&g[0], temperature_1, SMAJAX_UPPER);
 *                   most[1] = smajax_guard(&g[1], temperature_2, -SMAJAX_LOWER);
 *                   smajax_step_guarded(&s, reference, value, most, each);
 * with a smajax_guard_state g[2] that smajax_guard_reset(&g[0], temperature_1) and (&g[1], temperature_2) have set.
"""
OBSERVER_USE = """ * A temperature is smajax_observe(&o, power, thermocouple), called once a period and wire with a
 * smajax_observer_state o that smajax_observer_reset(&o, temperature) has set.
"""
OBSERVER = """
/* A wire's temperature in degC by its electrical power: a state for each wire. */
typedef struct {{
    smajax_real temperature, reading, power;
}} smajax_observer_state;

/* At rest at a temperature; NaN: at that of the surroundings. */
static inline void smajax_observer_reset(smajax_observer_state *o, smajax_real temperature) {{
    o->temperature = smajax_is_number(temperature) ? temperature : (smajax_real){ambient!r};
    o->reading = temperature;
    o->power = 0;
}}

/* The temperature now, in degC. power: the mean over the last period, in W. thermocouple: its reading now; NaN: none.
 * A power that is NaN is replaced by the last finite one, and the result is NaN: smajax_guard then allows nothing after
 * SMAJAX_BLIND s. */
static inline smajax_real smajax_observe(smajax_observer_state *o, smajax_real power, smajax_real thermocouple) {{
    smajax_real excess = o->temperature - (smajax_real){ambient!r};
    smajax_real lost = {lost};
    smajax_real change = (smajax_real){a1!r} * smajax_known(power, &o->power) + (smajax_real){a2!r} * lost;
    if (smajax_is_number(o->reading)) change += (smajax_real){gain!r} * (o->reading - o->temperature);
    o->temperature += SMAJAX_PERIOD * change;
    o->reading = thermocouple;
    return smajax_is_number(power) ? o->temperature : power - power;
}}
"""
LIMITED = """
/* The command of the wire, at most what smajax_guard allows; the integral does not wind up meanwhile. */
static inline smajax_real smajax_step_guarded(smajax_state *s, smajax_real reference, smajax_real value,
                                              smajax_real most) {
    smajax_real upper = most < SMAJAX_UPPER ? most : SMAJAX_UPPER, lower = SMAJAX_LOWER < upper ? SMAJAX_LOWER : upper;
    smajax_real command = smajax_step_within(s, reference, value, lower, upper);
    return command < most ? command : most;
}
"""
LIMITED_PAIR = """
/* The commands of the wires, each at most what smajax_guard allows; the integral does not wind up meanwhile. */
static inline void smajax_step_guarded(smajax_state *s, smajax_real reference, smajax_real value,
                                       const smajax_real most[2], smajax_real each[2]) {
    smajax_real lower = -smajax_clip(most[1] - SMAJAX_CO_CONTRACTION, 0, -SMAJAX_LOWER);
    smajax_real upper = smajax_clip(most[0] - SMAJAX_CO_CONTRACTION, 0, SMAJAX_UPPER);
    int i;
    smajax_allocate(smajax_step_within(s, reference, value, lower, upper), each);
    for (i = 0; i < 2; i++) each[i] = each[i] < most[i] ? each[i] : most[i];
}
"""
SIGNED_POWER = (
    "excess < 0 ? -(smajax_real)SMAJAX_POW(-excess, {exponent!r}) : (smajax_real)SMAJAX_POW(excess, {exponent!r})"
)
LIMITER = """
/* Temperature limiter: keeps a wire below {limit!r} degC; a state for each wire; temperatures in degC. */
typedef struct {{
    smajax_real integral, temperature, blind;
}} smajax_guard_state;

static inline void smajax_guard_reset(smajax_guard_state *g, smajax_real temperature) {{
    int known = smajax_is_number(temperature);
    g->integral = 0;
    g->temperature = known ? temperature : 0;
    g->blind = known ? 0 : SMAJAX_BLIND;
}}

static inline smajax_real smajax_guard_cut(smajax_guard_state *g, smajax_real temperature, smajax_real command) {{
    smajax_real error = (smajax_real){limit!r} - temperature;
    smajax_real integral = g->integral + (smajax_real){ki!r} * error * SMAJAX_PERIOD;
    smajax_real allowed = (smajax_real){kp!r} * error + integral;
    int winds_up = (allowed > (smajax_real){upper!r} && integral > g->integral)
                   || (allowed < 0 && integral < g->integral);
    if (!winds_up) g->integral = integral;
    allowed = smajax_clip(allowed, 0, (smajax_real){upper!r});
    return command < allowed ? command : allowed;
}}

static inline smajax_real smajax_guard(smajax_guard_state *g, smajax_real temperature, smajax_real command) {{
    int known = smajax_is_number(temperature);
    g->blind = known ? 0 : g->blind + SMAJAX_PERIOD;
    if (g->blind >= SMAJAX_BLIND) return command < 0 ? command : 0;
    return smajax_guard_cut(g, smajax_known(temperature, &g->temperature), command);
}}
"""
STEP_PID = "    return smajax_pid(s, reference, value, SMAJAX_KP, SMAJAX_KI, SMAJAX_KD, lower, upper);"
STEP_BPID = """    smajax_real point = 1 + SMAJAX_KB * SMAJAX_TUNING_POINT, here = 1 + SMAJAX_KB * value, factor;
    if (point < SMAJAX_LEAST) point = SMAJAX_LEAST;
    if (here < SMAJAX_LEAST) here = SMAJAX_LEAST;
    factor = point / here;
    return factor * smajax_pid(s, reference, value, SMAJAX_KP, SMAJAX_KI, SMAJAX_KD, lower / factor, upper / factor);"""
STEP_PPID = """    smajax_real error = reference - value, size = error < 0 ? -error : error;
    int rests = size <= (s->rested ? SMAJAX_LEAVE * SMAJAX_BAND : SMAJAX_BAND);
    smajax_real ahead = {ahead};
    if (error <= 0) ahead = 0;
    if (rests != s->rested) s->integral = 0;
    s->rested = rests;
    if (rests)
        return ahead + smajax_pid(s, reference, value, SMAJAX_KP_REST, SMAJAX_KI, 0, lower - ahead, upper - ahead);
    return smajax_pid(s, reference, value, SMAJAX_KP, 0, SMAJAX_KD, lower, upper);"""
STEP_ADAPTIVE = """    smajax_real error = reference - value, slope = smajax_slope(s, reference, value);
    s->summed += error * SMAJAX_PERIOD;
    {{
        smajax_real p = {p}, i = {i}, d = {d};
        s->kp = smajax_clip(s->kp + SMAJAX_RATE_P * p * error, 0, SMAJAX_GROWTH * SMAJAX_KP);
        s->ki = smajax_clip(s->ki + SMAJAX_RATE_I * i * s->summed, 0, SMAJAX_GROWTH * SMAJAX_KI);
        s->kd = smajax_clip(s->kd + SMAJAX_RATE_D * d * slope, 0, SMAJAX_GROWTH * SMAJAX_KD);
    }}
    return smajax_pid(s, reference, value, s->kp, s->ki, s->kd, lower, upper);"""

STEP_FEEDFORWARD = """    smajax_real ahead = smajax_ahead(s, reference, lower, upper);
    return ahead + smajax_pid(s, reference, value, SMAJAX_KP, SMAJAX_KI, SMAJAX_KD, lower - ahead, upper - ahead);"""
INVERSE = """
static const smajax_real smajax_thresholds[SMAJAX_PLAYS] = {{{thresholds}}};
static const smajax_real smajax_densities[SMAJAX_PLAYS] = {{{densities}}};

static inline smajax_real smajax_play(smajax_real input, smajax_real threshold, smajax_real play) {{
    return smajax_clip(play, input - threshold, input + threshold);
}}

static inline smajax_real smajax_ahead(smajax_state *s, smajax_real reference, smajax_real lower, smajax_real upper) {{
    smajax_real level = SMAJAX_DIRECT * reference;
    int i;
    for (i = 0; i < SMAJAX_PLAYS; i++) {{
        s->plays[i] = smajax_play(reference, smajax_thresholds[i], s->plays[i]);
        level += smajax_densities[i] * s->plays[i];
    }}
    level = smajax_clip((level - SMAJAX_MIDDLE) / SMAJAX_HEIGHT, -1 + SMAJAX_EDGE, 1 - SMAJAX_EDGE);
    return smajax_clip((SMAJAX_ATANH(level) - SMAJAX_SHIFT) / SMAJAX_STEEPNESS, lower, upper);
}}
"""
MATH = """#include <math.h>
#ifndef SMAJAX_{name} /* with SMAJAX_REAL as float, define it as {function}f */
#define SMAJAX_{name} {function}
#endif
"""
RESET_PLAYS = """
    {
        int i;
        for (i = 0; i < SMAJAX_PLAYS; i++) s->plays[i] = smajax_play(reference, smajax_thresholds[i], 0);
    }"""
