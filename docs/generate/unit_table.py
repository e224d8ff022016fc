"""Units that smajax looks up without pint: factors and dimensions of frequent names, as pint gives them.

    python -m docs.generate.unit_table

writes smajax/common_units.json, which a test compares with pint.
"""

import json
from pathlib import Path

import smajax
from smajax.unit_parser import UnknownUnitError, unit_of_pint

_PREFIXES = ("", *"GMkhdcmnp", "u", "\u00b5", "\u03bc")
_WITH_PREFIX = (
    *("m", "g", "s", "A", "V", "W", "N", "Pa", "J", "Hz", "K", "F", "H", "C", "L", "l", "bar"),
    *("ohm", "\u03a9", "\u2126"),
)
_OTHERS = (
    *("rad", "mrad", "urad", "krad"),
    *("degC", "degF", "\u00b0C", "\u00b0F", "deg", "\u00b0", "min", "h", "hour", "hours", "day", "rpm", "%", "percent"),
    *("meter", "gram", "second", "seconds", "ampere", "volt", "watt", "newton", "pascal", "joule", "kelvin", "radian"),
    *("degree", "degrees", "inch", "ft", "psi", "ksi", "atm", "lb", "lbf", "kgf", "cal", "kcal", "eV", "celsius"),
)


def text() -> str:
    """Return the content of the file."""
    table = {}
    for name in [*(prefix + unit for unit in _WITH_PREFIX for prefix in _PREFIXES), *_OTHERS]:
        try:
            unit = unit_of_pint(name)
        except UnknownUnitError:
            continue
        table[name] = [str(unit.factor), {base: str(power) for base, power in unit.dimension}, str(unit.offset)]
    lines = ",\n".join(f" {json.dumps(name, ensure_ascii=False)}: {json.dumps(entry)}" for name, entry in table.items())
    return f"{{\n{lines}\n}}\n"


if __name__ == "__main__":
    (Path(smajax.__file__).parent / "common_units.json").write_text(text(), encoding="utf-8")
