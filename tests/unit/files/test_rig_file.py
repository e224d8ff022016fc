"""Rig files: reading into a plant with the origin of each value, and writing."""

import dataclasses
import pathlib
import tomllib

import equinox as eqx
import jax.numpy as jnp
import pytest

from smajax import parameters
from smajax.errors import InputError
from smajax.files.parameter_names import all_parameter_names, declarations_of
from smajax.files.rig_file import parse_rig, read_rig
from smajax.plant.convection import PolynomialConvection, PowerLawConvection
from smajax.plant.drive import DutyDrive, NoDrive, PowerDrive, VoltageDrive
from smajax.plant.heat import PrescribedTemperature
from smajax.plant.mechanisms.registry import MECHANISMS as KINDS
from smajax.plant.mechanisms.rotary import MasslessRotary, Rotary
from smajax.plant.mechanisms.stress_path import StressPath
from smajax.plant.mechanisms.testing_machine import TestingMachine
from smajax.plant.plant import Plant
from smajax.recordings.column_mapping import ChannelMap
from smajax.recordings.datasets import data_path

MATERIAL = """
[material]
martensite_start = "48.4 degC"
martensite_finish = "43.9 degC"
austenite_start = "68.0 degC"
austenite_finish = "73.8 degC"
clausius_clapeyron_austenite = "6.73 MPa/K"
clausius_clapeyron_martensite = "6.32 MPa/K"
modulus_austenite = "31.5 GPa"
modulus_martensite = "20 GPa"
detwinning_start_stress = "25 MPa"
detwinning_finish_stress = "78 MPa"
max_transformation_strain = "4.1 %"
"""


def template(kind: str, **changes: str) -> str:
    """Return the shipped template of a kind with one key changed per keyword (``mass='"0.3 kg"'``), or removed (``mass=""``)."""
    lines = data_path("templates", f"{kind}.toml").read_text("utf-8").splitlines()
    for key, value in changes.items():
        at = next(i for i, line in enumerate(lines) if line.startswith(f"{key} ="))
        lines[at] = f"{key} = {value}" if value else ""
    return "\n".join(lines) + "\n"


def value(plant: Plant, name: str) -> float:
    return float(parameters.get(plant, name))


def same(a: Plant, b: Plant) -> bool:
    return bool(eqx.tree_equal(a, b))


@pytest.mark.parametrize("kind", KINDS)
class TestTemplates:
    def test_reads_as_its_kind(self, kind: str):
        rig = parse_rig(template(kind))
        assert rig.kind == kind
        assert rig.fit.free and set(rig.fit.free) <= set(parameters.all_declarations(rig.plant))
        assert rig.notes == ()

    def test_round_trip(self, kind: str):
        rig = parse_rig(template(kind))
        again = parse_rig(rig.to_toml())
        assert same(again.plant, rig.plant)
        assert again.fit == rig.fit and again.channels == rig.channels and again.interpolation == rig.interpolation
        assert again.to_toml() == rig.to_toml()

    def test_every_parameter_can_be_written_and_read(self, kind: str):
        rig = parse_rig(template(kind))
        values = {}
        for i, (name, declaration) in enumerate(parameters.all_declarations(rig.plant).items()):
            nominal = value(rig.plant, name)
            if name in parameters.TIES or jnp.isnan(nominal):
                continue
            # Long decimals above the nominal values, larger for a finish than for its start, so that the bands keep their order.
            changed = nominal * (1 + 1e-3 / 3) + (1e-9 / (i + 7) if nominal == 0 else 0.0)
            values[name] = nominal + 1.0 if declaration.whole else min(changed, declaration.upper)
        again = parse_rig(rig.to_toml(values))
        for name, expected in values.items():
            assert value(again.plant, name) == expected, name

    def test_comments_show_only_keys_that_are_accepted(self, kind: str):
        """The comments of a template become valid lines when they are uncommented."""
        lines = data_path("templates", f"{kind}.toml").read_text("utf-8").splitlines()
        uncommented = []
        for line in lines:
            bare = line.removeprefix("# ")
            optional = bare.split(" = ")[0] if " = " in bare else bare
            is_accepted = (
                line != bare
                and (optional.isidentifier() or bare.startswith(("[channels]", "[effects.", "[recording]")))
                and optional != "parameters"
            )
            uncommented.append(bare if is_accepted and optional != "decimal" else line)
        rig = parse_rig("\n".join(uncommented))
        assert rig.channels.columns and rig.recording.delimiter == ";" and rig.channels.ignore == ("Remarks",)
        assert rig.fit.noise and rig.fit.bounds and rig.fit.per_recording and rig.fit.initial


class TestPlants:
    def test_values_arrive_in_internal_units(self):
        plant = parse_rig(template("dead-weight")).plant
        assert value(plant, "wire.diameter") == 0.15e-3
        assert value(plant, "material.max_transformation_strain") == 0.041
        assert value(plant, "material.clausius_clapeyron_austenite") == 6.73e6
        assert value(plant, "material.resistivity_martensite") == 8e-7
        assert value(plant, "environment.ambient") == 20.0
        assert value(plant, "environment.gravity") == 9.81
        assert all(
            leaf.dtype == jnp.float64 for leaf in eqx.filter(plant, eqx.is_array).__dict__["wire"].__dict__.values()
        )

    def test_kelvin_is_converted_and_a_shift_is_a_difference(self):
        text = template("dead-weight", austenite_start='"341.15 K"', ambient='"293.15 K"')
        text = text.replace("[heat]", 'austenite_shift = "-2 degC"\nmartensite_shift = "1 K"\n[heat]', 1)
        plant = parse_rig(text).plant
        assert value(plant, "material.austenite_start") == 68.0
        assert value(plant, "environment.ambient") == 20.0
        assert value(plant, "material.austenite_shift") == -2.0
        assert value(plant, "material.martensite_shift") == 1.0

    def test_shifts_exist_at_zero_unwritten(self):
        rig = parse_rig(template("dead-weight"))
        assert value(rig.plant, "material.austenite_shift") == value(rig.plant, "material.martensite_shift") == 0.0
        assert rig.sources["material.austenite_shift"] == "default"

    def test_a_tie_sets_its_members_and_a_member_wins(self):
        plant = parse_rig(template("dead-weight")).plant
        assert value(plant, "heat.capacity_austenite") == value(plant, "heat.capacity_martensite") == 2.046e6
        sources = parse_rig(template("dead-weight")).sources
        assert sources["heat.capacity"] == sources["heat.capacity_martensite"] != sources["heat.h0"]
        for order in (
            'capacity = "2 MJ/m^3/K"\ncapacity_martensite = "3 MJ/m^3/K"',
            'capacity_martensite = "3 MJ/m^3/K"\ncapacity = "2 MJ/m^3/K"',
        ):
            plant = parse_rig(template("dead-weight", capacity="").replace("[heat]", f"[heat]\n{order}\n#")).plant
            assert value(plant, "heat.capacity_austenite") == 2e6
            assert value(plant, "heat.capacity_martensite") == 3e6

    def test_an_exponent_changes_the_law_of_convection(self):
        text = template("dead-weight", h2='"0.5 W/m^2/K"\nexponent = 1.5')
        assert isinstance(parse_rig(template("dead-weight")).plant.heat, PolynomialConvection)
        rig = parse_rig(text)
        assert isinstance(rig.plant.heat, PowerLawConvection)
        assert value(rig.plant, "heat.exponent") == 1.5
        assert same(parse_rig(rig.to_toml()).plant, rig.plant)

    @pytest.mark.parametrize(
        ("control", "section", "drive"),
        [
            ("voltage", '[drive]\nlead_resistance = "0.5 ohm"', VoltageDrive),
            ("power", "[drive]\ngain = 0.9", PowerDrive),
            ("duty", '[drive]\nsupply = "5 V"', DutyDrive),
        ],
    )
    def test_control_chooses_the_drive(self, control: str, section: str, drive: type):
        rig = parse_rig(template("dead-weight", control=f'"{control}"') + section)
        assert isinstance(rig.plant.drive, drive)
        assert rig.plant.signals == (control,)
        assert same(parse_rig(rig.to_toml()).plant, rig.plant)

    @pytest.mark.parametrize(
        ("changes", "extra", "mechanism"),
        [
            ({}, "", MasslessRotary),
            ({"inertia": "", "damping": ""}, "", MasslessRotary),
            ({"inertia": '"1e-5 kg m^2"'}, "", Rotary),
            ({"damping": '"1e-4 N m s/rad"'}, "", Rotary),
            ({}, 'per_recording = ["pulley.damping"]', Rotary),
        ],
    )
    def test_a_pulley_without_inertia_is_light_unless_it_is_fitted(self, changes: dict, extra: str, mechanism: type):
        rig = parse_rig(template("antagonistic-rotary", **changes) + extra)
        assert type(rig.plant.mechanism) is mechanism
        assert rig.plant.signals == ("current_1", "current_2")

    @pytest.mark.parametrize(
        ("observe", "mechanism", "signals"),
        [("", StressPath, ("temperature", "stress")), ('["stress"]', TestingMachine, ("temperature", "strain"))],
    )
    def test_a_path_prescribes_what_is_not_observed(self, observe: str, mechanism: type, signals: tuple):
        rig = parse_rig(template("path", observe=observe))
        assert isinstance(rig.plant.drive, NoDrive) and isinstance(rig.plant.heat, PrescribedTemperature)
        assert isinstance(rig.plant.mechanism, mechanism)
        assert rig.plant.signals == signals
        assert value(rig.plant, "wire.diameter") == 1e-3 and value(rig.plant, "wire.length") == 1.0
        assert rig.sources["wire.length"] == "default"
        assert same(parse_rig(rig.to_toml()).plant, rig.plant)

    def test_the_initial_state_is_derived_by_default(self):
        assert parse_rig(template("dead-weight")).plant.initial.temperature is None
        rig = parse_rig(template("dead-weight") + '\n[initial]\ntemperature = "25 degC"\ndetwinned = "40 %"')
        assert value(rig.plant, "initial.temperature") == 25.0 and value(rig.plant, "initial.detwinned") == 0.4
        assert rig.plant.initial.twinned is None
        assert same(parse_rig(rig.to_toml()).plant, rig.plant)

    def test_sections_in_one_line_and_dotted_keys(self):
        text = (
            template("dead-weight", mass="")
            .replace("[load]", "")
            .replace("schema = 1", 'schema = 1\nload = {mass = "0.3 kg"}')
        )
        rig = parse_rig(text)
        assert value(rig.plant, "load.mass") == 0.3
        assert rig.sources["load.mass"] == "rig.toml"

    def test_schema_and_fit_may_be_left_out(self):
        text = template("dead-weight").replace("schema = 1", "", 1).split("[fit]")[0]
        rig = parse_rig(text)
        assert rig.fit.free == () and rig.fit.model == "brinson" and rig.fit.observe == ("displacement",)
        assert (rig.fit.starts, rig.fit.seed) == (4, 0)

    @pytest.mark.parametrize(
        "kind, observed",
        [
            ("antagonistic-rotary", "angle"),
            ("testing-machine", "stress"),
            ("bias-spring", "displacement"),
            ("elbow", "angle"),
        ],
    )
    def test_the_coordinate_is_observed_by_default(self, kind: str, observed: str):
        assert parse_rig(template(kind, observe="")).fit.observe == (observed,)

    def test_interpolation_is_hold_by_default(self):
        assert parse_rig(template("dead-weight", interpolation="")).interpolation == "hold"
        assert parse_rig(template("dead-weight", interpolation='"linear"')).interpolation == "linear"


class TestDeclarations:
    def test_every_parameter_of_every_plant_is_in_the_catalogue(self):
        for kind in KINDS:
            plant = parse_rig(template(kind)).plant
            for name, declaration in parameters.all_declarations(plant).items():
                assert declaration.unit in [d.unit for d in declarations_of(name)], name

    def test_ambiguous_and_unknown_names(self):
        assert {d.unit for d in declarations_of("heat.h2")} == {"W/m^2/K^3", "W/m^2/K"}
        assert [d.unit for d in declarations_of("heat.capacity")] == ["J/m^3/K"]
        assert [d.unit for d in declarations_of("sensor.temperature_1_offset")] == ["K"]
        assert declarations_of("heat.h7") == declarations_of("nothing") == declarations_of("sensor.nothing_gain") == []
        assert {"pulley.radius", "drive.supply", "heat.exponent", "material.thermal_expansion"} <= set(
            all_parameter_names()
        )


class TestSensors:
    def test_observed_and_mentioned_channels_have_sensors(self):
        text = template("dead-weight", free='["heat.h0", "sensor.temperature_offset"]')
        rig = parse_rig(
            text + '\n[sensor]\ndisplacement_gain = "101 %"\ndisplacement_offset = "0.1 mm"\nresistance_gain = 1.02'
        )
        assert set(rig.plant.sensor.gain) == {"displacement", "temperature", "resistance"}
        assert value(rig.plant, "sensor.displacement_gain") == 1.01
        assert value(rig.plant, "sensor.displacement_offset") == 1e-4
        assert value(rig.plant, "sensor.temperature_offset") == 0.0
        assert rig.sources["sensor.displacement_gain"].startswith("rig.toml line ")
        assert rig.sources["sensor.displacement_offset"] != rig.sources["sensor.displacement_gain"]
        assert rig.sources["sensor.temperature_offset"] == "default"
        assert same(parse_rig(rig.to_toml()).plant, rig.plant)

    def test_offset_of_a_thermometer_is_a_difference(self):
        rig = parse_rig(template("dead-weight") + '\n[sensor]\ntemperature_offset = "2 K"')
        assert value(rig.plant, "sensor.temperature_offset") == 2.0


class TestFit:
    def test_all_keys(self):
        text = template("dead-weight", seed="7", starts="2") + (
            'per_recording = ["environment.ambient", "heat.h0"]\ninitial = ["temperature"]\n'
            'bounds = {"heat.h0" = ["50 W/m^2/K", "200 W/m^2/K"], "heat.capacity" = ["1 MJ/m^3/K", "8 MJ/m^3/K"], '
            '"material.austenite_shift" = ["-10 degC", "10 K"], "initial.temperature" = ["290 K", "30 degC"]}\n'
            'noise = {displacement = "0.02 mm", temperature = "0.4 K"}\n'
        )
        rig = parse_rig(text)
        fit = rig.fit
        assert fit.per_recording == ("environment.ambient", "heat.h0") and fit.initial == ("temperature",)
        assert fit.bounds["heat.h0"] == (50.0, 200.0) and fit.bounds["heat.capacity"] == (1e6, 8e6)
        assert fit.bounds["material.austenite_shift"] == (-10.0, 10.0)
        assert fit.bounds["initial.temperature"] == pytest.approx((16.85, 30.0))
        assert fit.noise == {"displacement": 2e-5, "temperature": 0.4}
        assert (fit.starts, fit.seed) == (2, 7)
        assert fit.names[-2:] == ("environment.ambient", "initial.temperature") and len(fit.names) == 7
        assert parse_rig(rig.to_toml()).fit == fit

    def test_bounds_with_dotted_keys(self):
        rig = parse_rig(template("dead-weight") + '[fit.bounds]\nheat.h0 = ["50 W/m^2/K", "200 W/m^2/K"]\n')
        assert rig.fit.bounds == {"heat.h0": (50.0, 200.0)}

    def test_initial_states_may_be_listed_as_free(self):
        fit = parse_rig(
            template("dead-weight", free='["heat.h0", "initial.detwinned"]') + 'initial = ["initial.temperature"]'
        ).fit
        assert fit.free == ("heat.h0",)
        assert fit.initial == ("temperature", "detwinned")

    def test_bounds_of_parameters_that_are_not_free_are_noted(self):
        rig = parse_rig(template("dead-weight", free='["heat.h0"]') + 'bounds = {"load.mass" = ["0.1 kg", "0.3 kg"]}')
        assert rig.notes == ("fit.bounds without effect, since the parameters are not free: load.mass",)


SET = """
schema = "smajax.parameters/1"
title = "a wire"
[material.martensite_start]
value = "321.55 K"
[material.max_transformation_strain]
value = "5 %"
bounds = ["3 %", "6 %"]
[heat.h0]
value = "80 W/m^2/K"
bounds = ["40 W/m^2/K", "160 W/m^2/K"]
[heat.capacity]
value = "3 MJ/m^3/K"
[sensor.displacement_offset]
value = "0.1 mm"
[pulley.radius]
value = "20 mm"
[fit]
seed = 3
[per_recording."environment.ambient@train.csv"]
value = "21 degC"
"""


class TestSets:
    def rig(self, folder: pathlib.Path, text: str, entries: str = SET):
        (folder / "wire.toml").write_text(entries)
        path = folder / "rig.toml"
        path.write_text(text.replace("[rig]", '[rig]\nparameters = "wire.toml"', 1))
        return read_rig(path)

    def test_the_rig_wins_over_the_set_and_the_set_over_defaults(self, tmp_path: pathlib.Path):
        text = template("dead-weight", martensite_start="", capacity='"4 MJ/m^3/K"', h0="")
        rig = self.rig(tmp_path, text)
        assert rig.name == "rig.toml" and rig.path == tmp_path / "rig.toml"
        assert value(rig.plant, "material.martensite_start") == pytest.approx(48.4, abs=1e-12)
        assert value(rig.plant, "material.max_transformation_strain") == 0.041
        assert value(rig.plant, "heat.capacity_martensite") == 4e6
        assert value(rig.plant, "heat.h0") == 80.0
        assert value(rig.plant, "sensor.displacement_offset") == 1e-4
        assert (
            rig.sources["material.martensite_start"]
            == rig.sources["sensor.displacement_offset"]
            == "parameter set wire.toml"
        )
        line = rig.sources["heat.capacity_austenite"].removeprefix("rig.toml line ")
        assert (tmp_path / "rig.toml").read_text().splitlines()[int(line) - 1].startswith("capacity =")
        assert rig.sources["heat.h1"] == "default"

    def test_unused_entries_are_noted(self, tmp_path: pathlib.Path):
        rig = self.rig(tmp_path, template("dead-weight", martensite_start=""))
        assert rig.notes == ("parameter set wire.toml: unused entries: pulley.radius, environment.ambient@train.csv",)

    def test_a_member_in_the_rig_wins_over_a_tie_in_the_set(self, tmp_path: pathlib.Path):
        rig = self.rig(
            tmp_path, template("dead-weight", capacity='"4 MJ/m^3/K"').replace("capacity =", "capacity_austenite =")
        )
        assert value(rig.plant, "heat.capacity_austenite") == 4e6
        assert value(rig.plant, "heat.capacity_martensite") == 3e6

    def test_bounds_of_the_set_hold_for_its_values(self, tmp_path: pathlib.Path):
        free = '["heat.h0", "material.max_transformation_strain"]'
        rig = self.rig(tmp_path, template("dead-weight", martensite_start="", h0="", free=free))
        assert rig.fit.bounds == {"heat.h0": (40.0, 160.0)}
        rig = self.rig(
            tmp_path, template("dead-weight", h0="", free=free) + 'bounds = {"heat.h0" = ["70 W/m^2/K", "90 W/m^2/K"]}'
        )
        assert rig.fit.bounds == {"heat.h0": (70.0, 90.0)}

    def test_the_law_of_convection_of_the_set(self, tmp_path: pathlib.Path):
        power = SET + '[heat.exponent]\nvalue = 1.5\n[heat.h2]\nvalue = "0.5 W/m^2/K"\n'
        assert isinstance(self.rig(tmp_path, template("dead-weight", h2=""), power).plant.heat, PowerLawConvection)
        assert isinstance(self.rig(tmp_path, template("dead-weight"), power).plant.heat, PolynomialConvection)
        mixed = SET + '[heat.h2]\nvalue = "0.001 W/m^2/K^3"\n'
        with pytest.raises(InputError) as error:
            self.rig(tmp_path, template("dead-weight", h2="exponent = 1.5").replace("h2 = exponent", "exponent"), mixed)
        sentence = "parameter set wire.toml: heat.h2 is in W/m^2/K^3, and that of this rig in W/m^2/K: give it in the rig, in that unit"
        assert str(error.value) == f"{tmp_path}/rig.toml: {sentence}"

    def test_bands_that_do_not_fit_together_name_both_origins(self, tmp_path: pathlib.Path):
        entries = SET.replace("321.55 K", "40 degC")
        with pytest.raises(InputError) as error:
            self.rig(tmp_path, template("dead-weight", martensite_start=""), entries)
        assert (
            "material.martensite_start = 40 degC (parameter set wire.toml) is not above material.martensite_finish = 43.9 degC (rig.toml"
            in str(error.value)
        )

    def test_a_wrong_set_names_both_files(self, tmp_path: pathlib.Path):
        with pytest.raises(InputError) as error:
            self.rig(tmp_path, template("dead-weight"), SET.replace("80 W/m^2/K", "80 W"))
        assert str(error.value).startswith(
            f"{tmp_path}/rig.toml: rig.parameters: {tmp_path}/wire.toml: heat.h0: '80 W': the unit 'W' does not fit"
        )

    def test_a_shipped_set_is_found_by_name(self):
        text = (
            template("dead-weight").split("[material]")[0]
            + 'parameters = "rotary-table1"\n[heat]\nh0 = "100 W/m^2/K"\n[wire]\n'
        )
        rig = parse_rig(text + 'length = "0.5 m"\n[load]\nmass = "0.2 kg"\n')
        assert value(rig.plant, "material.austenite_finish") == 73.8 and value(rig.plant, "wire.diameter") == 0.2e-3
        assert rig.sources["wire.diameter"] == "parameter set rotary-table1"
        with pytest.raises(
            InputError, match=r"rig\.parameters = 'rotary-table-1' is not known \(did you mean 'rotary-table1'\?\)"
        ):
            parse_rig(text.replace("rotary-table1", "rotary-table-1"))


class TestChannels:
    @pytest.mark.parametrize(
        "section",
        [
            '[channels]\ndisplacement = {column = "Laser (um)", unit = "um"}',
            '[channels]\ndisplacement = "Laser (um)"\n[channels.unit]\ndisplacement = "um"',
            '[channels]\ndisplacement = "Laser (um)"\nunit = "um"',
            '[channels.displacement]\ncolumn = "Laser (um)"\nunit = "um"',
        ],
    )
    def test_the_ways_to_map_a_column(self, section: str, tmp_path: pathlib.Path):
        rig = parse_rig(template("dead-weight") + "\n" + section)
        assert rig.channels.columns == {"displacement": ChannelMap("Laser (um)", "um")}
        (tmp_path / "a.csv").write_text("time [s],current [A],Laser (um)\n0,0.1,0\n1,0.2,500\n")
        recording = rig.read(tmp_path / "a.csv")
        assert recording.channels["displacement"].tolist() == [0.0, 5e-4]
        assert parse_rig(rig.to_toml()).channels == rig.channels

    def test_a_header_without_unit(self):
        rig = parse_rig(template("dead-weight") + '\n[channels.unit]\ndisplacement = "um"\n')
        assert rig.channels.columns == {"displacement": ChannelMap("displacement", "um")}

    def test_any_scale(self):
        rig = parse_rig(template("dead-weight") + "\n[channels]\ncurrent = {any_scale = true}")
        assert rig.channels.columns == {"current": ChannelMap("current", None, True)}
        assert parse_rig(rig.to_toml()).channels == rig.channels

    def test_the_layout_of_a_file(self, tmp_path: pathlib.Path):
        layout = '[channels]\nskip_rows = 1\ndelimiter = ";"\ndecimal = ","\nignore = ["Remarks"]\ntime = {column = "t", unit = "ms"}'
        rig = parse_rig(template("dead-weight") + "\n" + layout)
        (tmp_path / "a.csv").write_text(
            "made on the bench\nt;current [A];displacement [mm];Remarks\n0;0,1;0;x\n20;0,2;0,5;y\n"
        )
        recording = rig.read(tmp_path / "a.csv")
        assert recording.time.tolist() == [0.0, 0.02]
        assert recording.channels["current"].tolist() == [0.1, 0.2]
        assert parse_rig(rig.to_toml()).channels == rig.channels

    def test_inputs_are_needed_always_and_observed_channels_on_request(self, tmp_path: pathlib.Path):
        rig = parse_rig(template("dead-weight"))
        (tmp_path / "inputs.csv").write_text("time [s],current [A]\n0,0.1\n1,0.2\n")
        assert rig.read(tmp_path / "inputs.csv", observed=False).channels["current"].tolist() == [0.1, 0.2]
        with pytest.raises(InputError, match="the channel displacement is missing"):
            rig.read(tmp_path / "inputs.csv")
        (tmp_path / "outputs.csv").write_text("time [s],displacement [mm]\n0,0.1\n1,0.2\n")
        with pytest.raises(InputError, match="the channel current is missing"):
            rig.read(tmp_path / "outputs.csv")

    def test_only_a_path_does_without_time(self, tmp_path: pathlib.Path):
        (tmp_path / "cycle.csv").write_text(
            "temperature [degC],stress [MPa],strain [%],power [W]\n20,100,4,0\n90,100,0.5,1\n"
        )
        assert not parse_rig(template("path")).read(tmp_path / "cycle.csv").has_clock
        with pytest.raises(InputError, match="the channel time is missing"):
            parse_rig(template("testing-machine", control='"power"')).read(tmp_path / "cycle.csv", observed=False)


class TestWriting:
    def test_new_values_change_nothing_else(self, tmp_path: pathlib.Path):
        rig = parse_rig(template("dead-weight"))
        values = {
            "heat.h0": 1e2 / 3,
            "heat.capacity": 3e6,
            "heat.capacity_martensite": 4e6,
            "initial.temperature": 21.5,
        }
        rig.write(tmp_path / "accepted.toml", values)
        again = read_rig(tmp_path / "accepted.toml")
        assert same(again.plant, parameters.replace(rig.plant, values))
        assert again.fit == rig.fit
        assert [path.name for path in tmp_path.iterdir()] == ["accepted.toml"]

    def test_a_tie_stays_one_key_while_its_members_agree(self):
        rig = parse_rig(template("dead-weight"))
        assert set(tomllib.loads(rig.to_toml())["heat"]) == {"h0", "h1", "h2", "capacity"}
        apart = tomllib.loads(rig.to_toml({"heat.capacity_austenite": 3e6}))["heat"]
        assert set(apart) == {"h0", "h1", "h2", "capacity_austenite", "capacity_martensite"}

    def test_invalid_values_are_refused_and_nothing_is_written(self, tmp_path: pathlib.Path):
        rig = parse_rig(template("dead-weight"))
        with pytest.raises(
            InputError,
            match=r"^material\.austenite_finish = 60 degC is not above material\.austenite_start = 68 degC: correct",
        ):
            rig.write(tmp_path / "rig.toml", {"material.austenite_finish": 60.0})
        with pytest.raises(InputError, match=r"wire\.diameter: .* is not possible"):
            rig.write(tmp_path / "rig.toml", {"wire.diameter": -1.0})
        with pytest.raises(InputError, match=r"there is no parameter 'heat\.ho'"):
            rig.write(tmp_path / "rig.toml", {"heat.ho": 1.0})
        assert not list(tmp_path.iterdir())

    def test_a_missing_folder_is_refused(self, tmp_path: pathlib.Path):
        with pytest.raises(InputError, match="the file cannot be written"):
            parse_rig(template("dead-weight")).write(tmp_path / "nowhere" / "rig.toml")

    def test_a_rig_with_a_set_is_written_without_it(self, tmp_path: pathlib.Path):
        rig = TestSets().rig(tmp_path, template("dead-weight", martensite_start=""))
        again = parse_rig(rig.to_toml())
        assert same(again.plant, rig.plant)
        assert again.fit == rig.fit

    def test_a_rig_cannot_be_changed(self):
        with pytest.raises(dataclasses.FrozenInstanceError):
            parse_rig(template("dead-weight")).kind = "path"  # type: ignore[misc]


def test_rigs_of_the_shared_recordings(shared: pathlib.Path):
    """Every rig file of the shared recordings, and its recordings, can be read."""
    folders = sorted((shared / "blind").glob("case-*"))
    assert len(folders) >= 14
    for folder in folders:
        rig = read_rig(folder / "rig.toml")
        assert rig.notes == () and len(rig.fit.free) == 6
        assert same(parse_rig(rig.to_toml()).plant, rig.plant)
    for folder in (folders[0], folders[7]):
        rig = read_rig(folder / "rig.toml")
        recording = rig.read(folder / "train.csv")
        assert set(rig.plant.signals) | set(rig.fit.observe) <= set(recording.channels)
        assert len(recording) > 1000


def test_a_fit_of_many_parameters_begins_at_more_points():
    names = (
        "martensite_start",
        "martensite_finish",
        "austenite_start",
        "austenite_finish",
        "max_transformation_strain",
        "modulus_austenite",
    )
    more_names = ("n1", "n2", "n3", "n4", "clausius_clapeyron_austenite", "clausius_clapeyron_martensite")
    lines = '[rig]\nkind = "path"\nparameters = "rotary-table1"\n[material]\nn1 = "0.5"\nn2 = "0.5"\nn3 = "0.5"\nn4 = "0.5"\n[fit]\nmodel = "lagoudas"\n'
    for free, line, expected in ((names, "", 4), (names + more_names, "", 12), (names + more_names, "starts = 3", 3)):
        free_list = ", ".join(f'"material.{n}"' for n in free)
        rig = parse_rig(f'{lines}observe = ["strain"]\nfree = [{free_list}]\n{line}\n')
        assert rig.fit.starts == expected


def test_a_count_that_is_fitted_may_be_any():
    """The estimate of a count is written into a rig file and read again."""
    text = template("hip").replace("springs = 6", "springs = 5.5")
    free = "free = ["
    assert free in text
    rig = parse_rig(text.replace(free, 'free = ["wire.springs", ', 1))
    assert value(parse_rig(rig.to_toml()).plant, "wire.springs") == 5.5
