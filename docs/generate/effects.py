"""The catalogue of effects, from the effect classes."""

import math

from docs.generate.effect_equations import EQUATIONS, STAGES
from docs.generate.markdown import code, docstring, first_sentence, table
from smajax.app.commands.catalogues import similar_effects
from smajax.parameters import declarations
from smajax.plant.effects import catalogue
from smajax.units import as_text


def effects() -> str:
    """Return a table of all effects, and a section for each."""
    every = sorted(catalogue().items(), key=lambda item: (STAGES.index(item[1].stage), item[0]))
    rows = [
        (f"[{key}](#{key})", effect.stage, as_text(effect.typical, effect.unit()), first_sentence(effect))
        for key, effect in every
    ]
    head = table(("effect", "stage", "typical", "what it is"), rows)
    return "\n".join([head, *(_section(key) for key, _ in every)])


def value_text(value: float | None, unit: str) -> str:
    """Return a value in its usual unit; "none" where it is open, "derived" for NaN."""
    if value is None:
        return "required"
    if math.isnan(value):
        return "derived"
    return as_text(value, unit) if math.isfinite(value) else "none"


def _section(key: str) -> str:
    effect = catalogue()[key]
    text = docstring(effect).partition("\nParameters:")[0].strip()
    rows = [
        (
            code(name),
            value_text(effect.typical if name == "strength" else d.default, d.unit),
            f"{value_text(d.lower, d.unit)} to {value_text(d.upper, d.unit)}",
            d.meaning,
        )
        for name, d in declarations(effect).items()
    ]
    similar = ", ".join(f"[{other}](#{other})" for other in similar_effects(key))
    facts = [
        ("Stage", effect.stage),
        (
            "Typical strength",
            f"{as_text(effect.typical, effect.unit())}. {effect.source[:1].upper()}{effect.source[1:]}.",
        ),
        ("Confusable with", similar or "no other effect of the catalogue"),
        ("A rig shows it that has", ", ".join(effect.needs) or "any input that excites it"),
        ("Not in a rig that has", ", ".join(effect.excluded_by)),
        ("On the bench", effect.remedy),
        ("Not detected", effect.no_mean_effect),
    ]
    listed = "\n".join(f"- **{name}**: {content}" for name, content in facts if content)
    sample = f'```toml\n[effects.{key}]\nstrength = "{as_text(effect.typical, effect.unit())}"\n```'
    parameters = table(("key", "typical or default", "bounds", "meaning"), rows)
    return f"\n## {key} {{ #{key} }}\n\n{text}\n\n$$ {EQUATIONS[key]} $$\n\n{parameters}\n{listed}\n\n{sample}\n"
