"""Note on a heat balance without latent heat."""

import tomllib

import pytest

from smajax.files.latent_heat_note import FLEXINOL_LATENT_HEAT, latent_heat_note, template_note
from smajax.files.rig_file import parse_rig
from smajax.recordings.datasets import data_path

KINDS = sorted(path.stem for path in data_path("templates").glob("*.toml"))


def note(text):
    rig = parse_rig(text)
    return latent_heat_note(rig.plant, rig.fit)


def test_the_value_is_that_of_the_data_sheet():
    assert pytest.approx(156e6, rel=1e-3) == FLEXINOL_LATENT_HEAT  # 24.2 kJ/kg at 6450 kg/m^3


@pytest.mark.parametrize("kind", KINDS)
def test_a_heat_balance_without_latent_heat_has_a_note_with_its_cure(kind):
    text = data_path("templates", f"{kind}.toml").read_text("utf-8")
    assert template_note(tomllib.loads(text)) == note(text)
    if kind == "path":  # no heat balance
        assert note(text) == ""
        return
    assert "156 MJ/m^3" in note(text) and "[effects.latent-heat]" in note(text)
    assert "\n# [effects.latent-heat]" in text
    with_effect = text.replace("# [effects.latent-heat]", "[effects.latent-heat]").replace("# strength", "strength")
    assert template_note(tomllib.loads(with_effect)) == note(with_effect) == ""


def test_latent_heat_that_is_fitted_or_a_temperature_that_is_recorded_has_none():
    text = data_path("templates", "dead-weight.toml").read_text("utf-8")
    free = text.replace('free = ["heat.h0"', 'free = ["effects.latent-heat.strength", "heat.h0"')
    free = free.replace("\n[fit]", '\n[effects.latent-heat]\nstrength = "0 J/m^3"\n\n[fit]')
    assert note(free) == ""
    zero = text.replace("\n[fit]", '\n[effects.latent-heat]\nstrength = "0 J/m^3"\n\n[fit]')
    assert "no latent heat" in note(zero)
    prescribed = text.replace('control = "current"', 'control = "temperature"')
    assert template_note(tomllib.loads(prescribed)) == ""
    prescribed = "".join(
        line for line in prescribed.splitlines(keepends=True) if not line.startswith(("[heat]", "h0", "h2", "capacity"))
    ).replace('"heat.h0", "heat.capacity", ', "")
    assert note(prescribed) == ""
