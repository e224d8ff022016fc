"""Texts of the C header around the functions that ``c_header`` writes; the C names are public and must not change."""

import re

from smajax.errors import printable


def comment_text(text: str) -> str:
    """Return a text for a comment of C: in one line, in which no comment ends or begins.

    Args:
        text: The text, such as a docstring or the name of a unit.
    """
    return re.sub(r"(?<=\*)(?=/)|(?<=/)(?=\*)", " ", printable(" ".join(text.split())))


HEADER = """/* {kind} controller tuned by smajax {version}.
 * Include it where the loop runs, and call smajax_step once every SMAJAX_PERIOD s.
 *
 *     smajax_state s;
 *     smajax_reset(&s, {start}, value);
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

{constants}

{helpers}

{functions}
#endif
"""
MATH = """#ifndef SMAJAX_{name} /* with SMAJAX_REAL as float, define it as {function}f */
#define SMAJAX_{name} {function}
#endif
"""
# The start of the rollout that the gains were tuned for: with another reference, a derivative of the error begins with
# a kick, or leaves one out.
START = (
    "#define SMAJAX_START ((smajax_real){start!r}) /* {unit}: reference before the first sample, as in the tuning */"
)
# Functions that replace operations of JAX, by name; NaN stays NaN.
HELPERS = {
    "smajax_is_number": """static inline int smajax_is_number(smajax_real x) {
    return x - x <= 0;
}""",
    "smajax_max": """static inline smajax_real smajax_max(smajax_real a, smajax_real b) {
    return a > b || a != a ? a : b;
}""",
    "smajax_min": """static inline smajax_real smajax_min(smajax_real a, smajax_real b) {
    return a < b || a != a ? a : b;
}""",
    "smajax_abs": """static inline smajax_real smajax_abs(smajax_real x) {
    return x < 0 ? -x : x;
}""",
    "smajax_sign": """static inline smajax_real smajax_sign(smajax_real x) {
    return x > 0 ? 1 : x < 0 ? -1 : x;
}""",
    "smajax_infinity": """static inline smajax_real smajax_infinity(void) {
    const smajax_real zero = 0;
    return 1 / zero;
}""",
    "smajax_nan": """static inline smajax_real smajax_nan(void) {
    const smajax_real zero = 0;
    return zero / zero;
}""",
}
STATE = """/* {meaning} */
typedef struct {{
    {members}
}} {name};
"""
FUNCTION = """/* {meaning} */
static inline {result} {name}({parameters}) {{
{body}
}}
"""
STEP = """/* One sample: the command until the next one. */
static inline smajax_real smajax_step(smajax_state *s, smajax_real reference, smajax_real value) {
    return smajax_step_within(s, reference, value, SMAJAX_LOWER, SMAJAX_UPPER);
}
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
