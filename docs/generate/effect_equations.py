"""The equation of each effect as a formula, for its section of the catalogue and for the page of equations.

The formulas are those of the docstrings of the effects, which say in words what they are. A test holds that each effect
has one.
"""

from docs.generate.markdown import table
from smajax.plant.effects import catalogue
from smajax.units import as_text

HEAD = ("effect", "equation", "typical strength s", "source of that size")
STAGES = ("drive", "heat", "material", "mechanism", "sensor")
# Second thermal node, which several effects of the heat stage are.
_NODE = r"q' = q - s G (T - T_a - u), \quad \tau \dot u = T - T_a - u"

EQUATIONS: dict[str, str] = {
    "airflow-change": r"h' = h (1 + s) \text{ from } t_0",
    "ambient-drift": r"T_a' = T_a + s t",
    "backlash": r"y = x - s (z - z_0), \quad dz = dx / s, \quad -1 \le z \le 1",
    "bias-nonlinearity": r"F' = F + s x^3",
    "clausius-asymmetry": r"C_M' = C_M (1 + s)",
    "clausius-curvature": r"\Delta T = s (\sigma / 100 \text{ MPa})^2 \text{ for } A_s, A_f, M_s, M_f",
    "coating": _NODE,
    "compliance": r"x' = x - s (F - F_0)",
    "convection-diameter": r"h' = h (1 - s \ln (d / 0.25 \text{ mm}))",
    "convection-temperature": r"h' = h (1 + s (T - T_a) / 50 \text{ K})",
    "coulomb-friction": r"\sigma' = \sigma + s z, \quad dz = dc / c_r, \quad -1 \le z \le 1",
    "creep": r"\varepsilon' = \varepsilon - s (\xi - \xi_f), \quad \tau \dot \xi_f = \xi - \xi_f",
    "current-limit": r"I' = I \left( 1 + ((1 - s)^{-n} - 1) x^n \right)^{-1/n}, "
    r"\quad x = \frac{I}{I_r} \left( 1 + m (R / R_A - 1) \right)",
    "encoder-drift": r"y = x + s t",
    "encoder-gain": r"y = x (1 + s)",
    "end-conduction": r"q' = q - s G (T - T_a - u), \quad \tau \dot u = (T - T_a) / 2 - u",
    "fan-cooling": r"h' = h (1 + s u^n)",
    "functional-fatigue": r"\varepsilon_L' = \varepsilon_L (1 - s N)",
    "gradual-transformation": r"\xi' = (1 - s) \xi + \frac{s}{8} \sum_{i=1}^{8} \xi(T + w o_i)",
    "hard-stop": r"\sigma' = \sigma + \frac{E q}{1 - q} \frac{e}{L}, \quad y = x - \frac{s - q}{1 - q} e, "
    r"\quad e = \max(x - p, 0), \quad q = h s",
    "heat-capacity": r"C' = C (1 + s (1 - \xi))",
    "heating-roundness": r"d\xi \propto \xi^{1 + s} \text{ while } \xi \text{ falls}",
    "hysteresis-widening": r"\Delta T = s (\sigma / 100 \text{ MPa})^n \text{ for } A_s, A_f",
    "infrared-spot": r"y^4 = (1 - s) T^4 + s B^4, \quad B = T_0 + w v, \quad \tau \dot v = T - T_0 - v",
    "initial-set": r"\varepsilon' = \varepsilon + s r, \quad dr / r = d\xi / \xi \text{ while } \xi \text{ falls}, "
    r"\quad r(0) = 1",
    "latent-heat": r"C \dot T = q + s \dot \xi",
    "lead-resistance": r"U' = I (R + s)",
    "load-change": r"\sigma' = \sigma + s \frac{c - c_0}{0.04}",
    "minor-loop-shape": r"dp \propto (1 - p)^{1 + s}",
    "quantisation": r"y = s \, \mathrm{round}(x / s)",
    "r-phase": r"\varepsilon' = \varepsilon + s c, \quad \rho_e' = \rho_e (1 + 100 k s c), "
    r"\quad c = (1 - (1 - \kappa) \xi) f(T, \sigma)",
    "radiation": r"q' = q - \frac{4}{d} s \sigma_B (T^4 - T_a^4)",
    "ratcheting": r"\varepsilon' = \varepsilon + \frac{s}{p} \left( (1 + N)^p - 1 \right)",
    "resistivity-strain": r"R' = R (1 + 2 s \varepsilon_{tr})",
    "resistivity-temperature": r"\rho_e' = \rho_e (1 + s (T - T_a))",
    "sensor-lag": r"s \dot y = x - y",
    "slack": r"x' = x - s \tanh(x / \max(l, s))",
    "slip": r"\varepsilon' = \varepsilon + s (\sigma_{max} / 1 \text{ GPa})^n",
    "specimen-lag": r"T' = T + s g, \quad dg = (\mathrm{sign}(dT) - g) \frac{\lvert dT \rvert}{w}",
    "stress-dependent-strain": r"\varepsilon_L' = \varepsilon_L \left( 1 + s \left( "
    r"\frac{1 - e^{-\sigma / \sigma_c}}{1 - e^{-150 \text{ MPa} / \sigma_c}} - 1 \right) \right)",
    "stress-ratcheting": r"\dot \varepsilon' = \dot \varepsilon + s (\sigma / 150 \text{ MPa})^n \dot N",
    "temperature-distribution": r"\varepsilon' = \varepsilon + s \varepsilon_L \left( "
    r"\xi_s \left( T_a + \frac{T - T_a}{2} \right) - \xi_s(T) \right)",
    "thermocouple-attachment": r"y = T - s (T - T_0)",
    "thermocouple-embedding": r"s \dot T_b = T - T_b, \quad s \dot y = T_b - y",
    "thermocouple-lag": r"s \dot y = T - y",
    "thermocouple-pickup": r"y = T + s I",
    "time-skew": r"y(t) = x(t - s)",
    "transformation-shift": r"\Delta T = s N \text{ for } A_s, A_f, M_s, M_f",
    "two-slope-elasticity": r"\varepsilon' = \varepsilon + s \max(\sigma - \sigma_k, 0)",
    "viscous-friction": r"\sigma' = \sigma + s \dot c",
    "wire-crosstalk": r"q_1' = q_1 - s G (T_1 - T_2), \quad q_2' = q_2 - s G (T_2 - T_1)",
}


def effect_equations() -> str:
    """Return a table of each stage: effect, equation, typical size of the strength and its source."""
    parts = []
    for stage in STAGES:
        rows = [
            (
                f"[{key}](../reference/effects.md#{key})",
                f"${EQUATIONS[key]}$",
                as_text(effect.typical, effect.unit()),
                effect.source.replace("/", "/<wbr>"),
            )
            for key, effect in sorted(catalogue().items())
            if effect.stage == stage
        ]
        parts.append(f"\n### Effects on the {stage}\n\n{table(HEAD, rows)}")
    return "\n".join(parts)
