"""Messages for every kind of mistake in a rig file."""

from pathlib import Path

import pytest

from smajax.errors import InputError
from smajax.files.rig_file import parse_rig, read_rig
from smajax.recordings.datasets import data_path

# Each row: the kind of the template, its replacements (an empty key appends the text), and the message.
DEAD, ROTARY, PATH, COIL = "dead-weight", "antagonistic-rotary", "path", "coil-bias-spring"
CASES: dict[str, tuple[str, dict[str, str], str]] = {
    # Sections and keys
    "section misspelt": (
        DEAD,
        {"[wire]": "[wires]"},
        "[wires] is not a section of a rig (did you mean 'wire'?): correct it, or remove it",
    ),
    "section misspelt, nothing near": (
        DEAD,
        {"[load]": "[motor]"},
        "[motor] is not a section of a rig: the sections are rig, wire, environment, initial, drive, heat, material, cells, grains, load, "
        "spring, pulley, link, limb, transmission, sheath, effects, sensor, channels, recording, fit",
    ),
    "key misspelt": (
        DEAD,
        {"diameter =": "diametre ="},
        "wire.diametre is not known (did you mean 'diameter'?): the keys of [wire] are diameter, length, prestrain, cells",
    ),
    "key misspelt among many": (
        DEAD,
        {"martensite_start": "martensit_start"},
        "material.martensit_start is not known (did you mean 'martensite_start'?): correct it, or remove it",
    ),
    "key in the wrong section": (
        DEAD,
        {'length = "230 mm"': 'length = "230 mm"\nmass = "0.2 kg"'},
        "wire.mass is not known (did you mean 'load.mass'?): write it under [load]",
    ),
    "key outside of its section": (
        DEAD,
        {"[rig]": ""},
        "kind is outside of its section: write it below a line [rig]",
    ),
    "rig section missing": (
        DEAD,
        {
            "[rig]": "[fit]",
            "kind": "# kind",
            "control": "# control",
            "interpolation": "# interpolation",
            "[fit]\nmodel": "# [fit]\nmodel",
        },
        'the section [rig] is missing: add [rig] with lines like kind = "dead-weight" and control = "current"',
    ),
    "kind missing": (DEAD, {"kind": "# kind"}, 'rig.kind is missing: add a line like kind = "dead-weight" to [rig]'),
    "control missing": (
        DEAD,
        {"control": "# control"},
        'rig.control is missing: add the electrical input that is recorded, as in control = "current", or control = "temperature"',
    ),
    "section missing": (
        DEAD,
        {"[load]": "", "\nmass": "\n# mass"},
        'load.mass is missing: a dead-weight rig needs a line like mass = "0.2 kg" under [load]',
    ),
    "key missing": (
        ROTARY,
        {"\ndiameter": "\n# diameter"},
        'wire.diameter is missing: an antagonistic-rotary rig needs a line like diameter = "0.2 mm" under [wire]',
    ),
    "key missing that a set could give": (
        DEAD,
        {"martensite_start": "# martensite_start"},
        'material.martensite_start is missing: a dead-weight rig needs a line like martensite_start = "48.4 degC" under [material], '
        'or name a parameter set under [rig], as in parameters = "NAME"',
    ),
    "key missing that this control needs": (
        DEAD,
        {'control = "current"': 'control = "duty"'},
        'drive.supply is missing: a dead-weight rig needs a line like supply = "5 V" under [drive]',
    ),
    "section of another kind": (
        DEAD,
        {"[wire]": '[pulley]\nradius = "20 mm"\n[wire]'},
        '[pulley] does not apply to a dead-weight rig: remove it, or set kind = "antagonistic-rotary" or kind = "coil-antagonistic" '
        'or kind = "hip" or kind = "elbow" or kind = "wrist" or kind = "glove-finger" under [rig]',
    ),
    "section of a heated kind": (
        PATH,
        {"": '\n[heat]\nh0 = "100 W/m^2/K"'},
        "[heat] does not apply to a path rig: remove it",
    ),
    "control on a path": (
        PATH,
        {'kind = "path"': 'kind = "path"\ncontrol = "current"'},
        "rig.control does not apply to a path rig: remove it, since the recording has the temperature",
    ),
    "start temperature on a path": (
        PATH,
        {"": '\n[initial]\ntemperature = "20 degC"'},
        "initial.temperature does not apply to a path rig: remove it, since it follows from the recording",
    ),
    "key of another control": (
        DEAD,
        {"": '\n[drive]\nlead_resistance = "1 ohm"'},
        'drive.lead_resistance does not apply with control = "current": choose control = "voltage" or control = "duty", or remove it',
    ),
    "key of another h(T)": (
        DEAD,
        {"[heat]": '[heat]\nexponent = 1.5\nh1 = "1 W/m^2/K^2"'},
        "heat.h1 does not apply with an exponent in h(T): choose h(T) as a polynomial, or remove it",
    ),
    "unit of another h(T)": (
        DEAD,
        {"[heat]": "[heat]\nexponent = 1.5"},
        "heat.h2: '0.001 W/m^2/K^3': the unit 'W/m^2/K^3' does not fit: a unit that converts to W/m^2/K is expected, as in '100 W/m^2/K'",
    ),
    "section as a value": (
        DEAD,
        {"schema = 1": "load = 3", "[load]": "", "\nmass": "\n# mass"},
        "[load] is a section, not a value: write its keys below a line [load]",
    ),
    "section as a list": (
        DEAD,
        {"[wire]": "[[wire]]"},
        "[wire] is a section, not a value: write its keys below a line [wire]",
    ),
    "another schema": (DEAD, {"schema = 1": "schema = 2"}, "schema = 2 is not known: this version reads schema = 1"),
    # Coils
    "coil narrower than its wire": (
        COIL,
        {'coil_diameter = "3 mm"': 'coil_diameter = "0.4 mm"'},
        "wire.coil_diameter = 0.4 mm (rig.toml line 37) is not above wire.diameter = 0.5 mm (rig.toml line 36): correct one of the two",
    ),
    "turns that do not fit": (
        COIL,
        {'diameter = "0.5 mm"': 'diameter = "2 mm"\nfree_length = "80 mm"', "turns = 25": "turns = 56"},
        "wire.free_length = 80 mm is too short: 56 turns of a wire of 2 mm take 112 mm side by side: correct wire.turns, wire.diameter or "
        "wire.free_length (a radius taken for a diameter makes twice as much)",
    ),
    "stretched too far": (
        "hip",
        {'prestretch = "40 mm"': 'prestretch = "400 mm"'},
        "wire.prestretch = 400 mm is too large: the equivalent tensile strain of the wire is 16.3 %, and at most 12 % is possible: reduce it, "
        "or correct the dimensions of the coil",
    ),
    "half a spring": (
        "hip",
        {"springs = 6": "springs = 5.5"},
        "wire.springs = 5.5 (rig.toml line 42) is not a whole number, but is the springs side by side that pull together: give a whole number",
    ),
    "half a wire": (
        "elbow",
        {'count = "3"': "count = 2.5"},
        "transmission.count = 2.5 (rig.toml line 52) is not a whole number, but is the number of wires that pull in parallel, each driven "
        "as the recording says: give a whole number",
    ),
    "more parallel current paths than springs": (
        COIL,
        {"turns = 25": "turns = 25\npaths = 2"},
        "wire.paths = 2 is more than wire.springs = 1: a bundle has at most as many parallel current paths as springs, and 1 if all are in "
        "series",
    ),
    "length of a coil": (
        COIL,
        {"turns = 25": 'turns = 25\nlength = "230 mm"'},
        "wire.length does not apply with a coiled wire: choose a straight wire, or remove it",
    ),
    "coil on a straight wire's kind": (
        DEAD,
        {'length = "230 mm"': 'length = "230 mm"\nturns = 25'},
        "wire.turns does not apply with a straight wire: choose a coiled wire, or remove it",
    ),
    "turns missing": (
        COIL,
        {"\nturns": "\n# turns"},
        "wire.turns is missing: a coil-bias-spring rig needs a line like turns = 25 under [wire]",
    ),
    # Words
    "kind unknown": (
        DEAD,
        {'"dead-weight"': '"dead-wieght"'},
        "rig.kind: 'dead-wieght' is not known (did you mean 'dead-weight'?): it is one of dead-weight, bias-spring, antagonistic-rotary, "
        "testing-machine, path, coil-dead-weight, coil-bias-spring, coil-antagonistic, hip, elbow, wrist, glove-finger",
    ),
    "control unknown": (
        DEAD,
        {'control = "current"': 'control = "amps"'},
        "rig.control: 'amps' is not known: it is one of current, voltage, power, duty, temperature",
    ),
    "interpolation unknown": (
        DEAD,
        {'"hold"': '"held"'},
        "rig.interpolation: 'held' is not known (did you mean 'hold'?): it is one of hold, linear",
    ),
    "model unknown": (
        DEAD,
        {'"brinson"': '"brinsen"'},
        "fit.model: 'brinsen' is not known (did you mean 'brinson'?): ",
    ),
    # Quantities
    "bare number": (
        DEAD,
        {'"0.15 mm"': "0.15"},
        "wire.diameter: '0.15' has no unit, and m is expected: write it like '0.15 mm'",
    ),
    "no quotation marks": (
        DEAD,
        {'"0.15 mm"': "0.15 mm"},
        'row 37, column 17: something follows the value: put quantities and names in quotation marks, as in diameter = "0.15 mm"',
    ),
    "wrong unit": (
        DEAD,
        {'"0.15 mm"': '"0.15 kg"'},
        "wire.diameter: '0.15 kg': the unit 'kg' does not fit: a unit that converts to m is expected, as in '0.15 mm'",
    ),
    "degC as C": (
        DEAD,
        {'"48.4 degC"': '"48.4 C"'},
        "material.martensite_start: '48.4 C': the unit 'C' does not fit (did you mean 'degC'?): a unit that converts to degC is expected, "
        "as in '20 degC'",
    ),
    "not a quantity": (DEAD, {'"0.15 mm"': "true"}, "wire.diameter: True is not a quantity: write it like '0.15 mm'"),
    "negative diameter": (
        DEAD,
        {'"0.15 mm"': '"-0.15 mm"'},
        "wire.diameter: '-0.15 mm' is not possible for the wire diameter: give a value from 0.001 mm to 20 mm",
    ),
    "fraction beyond 1": (
        DEAD,
        {"": "\n[initial]\ndetwinned = 1.5"},
        "initial.detwinned: 1.5 is not possible for the detwinned martensite fraction at the first row: give a value from 0 to 1",
    ),
    "fractions beyond 1 together": (
        DEAD,
        {"": "\n[initial]\ndetwinned = 0.7\ntwinned = 0.6"},
        "initial.detwinned and initial.twinned add up to 1.3: keep their sum at 1 or below",
    ),
    "not finite": (
        DEAD,
        {"": "\n[initial]\ndetwinned = nan"},
        "initial.detwinned: 'nan' does not begin with a number: write it like '4.1 %'",
    ),
    "infinite": (
        DEAD,
        {'"20 degC"': '"inf degC"'},
        "environment.ambient: 'inf degC' does not begin with a number: write it like '20 degC'",
    ),
    "too large": (
        DEAD,
        {'"0.2 kg"': '"1e999 kg"'},
        "load.mass: '1e999 kg' is too large for a number: write it like '0.2 kg'",
    ),
    "austenite band reversed": (
        DEAD,
        {'"73.8 degC"': '"60 degC"'},
        "material.austenite_finish = 60 degC (rig.toml line 18) is not above material.austenite_start = 68 degC (rig.toml line 17): "
        "correct one of the two",
    ),
    "martensite band empty": (
        DEAD,
        {'"43.9 degC"': '"48.4 degC"'},
        "material.martensite_start = 48.4 degC (rig.toml line 15) is not above material.martensite_finish = 48.4 degC (rig.toml line 16): "
        "correct one of the two",
    ),
    "detwinning reversed": (
        DEAD,
        {'"78 MPa"': '"20 MPa"'},
        "material.detwinning_finish_stress = 20 MPa (rig.toml line 26) is not above material.detwinning_start_stress = 25 MPa "
        "(rig.toml line 25): correct one of the two",
    ),
    # Fit
    "free parameter unknown": (
        DEAD,
        {'["heat.h0"': '["heat.hO"'},
        "fit.free has 'heat.hO', which is not a parameter of this rig (did you mean 'heat.h2'?): name it by section and key, as in heat.h0",
    ),
    "free parameter without section": (
        DEAD,
        {'["heat.h0"': '["h0"'},
        "fit.free has 'h0', which is not a parameter of this rig (did you mean 'heat.h0'?): name it by section and key, as in heat.h0",
    ),
    "free parameter of another kind": (
        DEAD,
        {'["heat.h0"': '["pulley.radius"'},
        "fit.free has 'pulley.radius', which is not a parameter of this rig: name it by section and key, as in heat.h0",
    ),
    "free parameter twice": (
        DEAD,
        {'["heat.h0"': '["heat.h0", "heat.h0"'},
        "fit.free lists heat.h0 twice: remove one of them",
    ),
    "tie and member": (
        DEAD,
        {'["heat.h0"': '["heat.capacity_austenite"'},
        "fit.free has heat.capacity and heat.capacity_austenite, which it contains: keep only one of them",
    ),
    "tie free, member per recording": (
        DEAD,
        {"": 'per_recording = ["heat.capacity_martensite"]'},
        "fit.free has heat.capacity and heat.capacity_martensite, which it contains: keep only one of them",
    ),
    "per recording unknown": (
        DEAD,
        {"": 'per_recording = ["environment.ambeint"]'},
        "fit.per_recording has 'environment.ambeint', which is not a parameter of this rig (did you mean 'environment.ambient'?): "
        "name it by section and key, as in heat.h0",
    ),
    "initial unknown": (
        DEAD,
        {"": 'initial = ["temp"]'},
        "fit.initial has 'temp', which is not an initial state of this rig (did you mean 'temperature'?): it can be temperature, detwinned, "
        "twinned",
    ),
    "initial temperature of a path": (
        PATH,
        {"": 'initial = ["temperature"]'},
        "fit.initial has 'temperature', which is not an initial state of this rig: it can be detwinned, twinned",
    ),
    "initial twice": (
        DEAD,
        {"": 'initial = ["detwinned", "initial.detwinned"]'},
        "fit.initial lists detwinned twice: remove one of them",
    ),
    "observed channel unknown": (
        DEAD,
        {'observe = ["displacement"]': 'observe = ["displacment"]'},
        "fit.observe has 'displacment', which is not an output of a dead-weight rig (did you mean 'displacement'?): its outputs are displacement, "
        "strain, temperature, stress, force, resistance, voltage, power",
    ),
    "observed channel of another kind": (
        ROTARY,
        {'observe = ["angle"]': 'observe = ["ambient"]'},
        "fit.observe has 'ambient', which is not an output of an antagonistic-rotary rig: its outputs are angle, strain_1, strain_2, temperature_1, "
        "temperature_2, stress_1, stress_2, force_1, force_2, resistance_1, resistance_2, voltage_1, voltage_2, power_1, power_2, torque",
    ),
    "observed channel drives the rig": (
        DEAD,
        {'observe = ["displacement"]': 'observe = ["current"]'},
        "fit.observe has current, which drives this dead-weight rig: observe one of displacement, strain, temperature, stress, force, "
        "resistance, voltage, power",
    ),
    "strain and stress of a path": (
        PATH,
        {'observe = ["strain"]': 'observe = ["strain", "stress"]'},
        "fit.observe has strain, which drives this path rig: observe one of stress, force, resistance, current, voltage, power",
    ),
    "observe as text": (
        DEAD,
        {'observe = ["displacement"]': 'observe = "displacement"'},
        "fit.observe = 'displacement' is not a list in square brackets: write it like observe = [\"displacement\"]",
    ),
    "observe nothing": (
        DEAD,
        {'observe = ["displacement"]': "observe = []"},
        'fit.observe is empty: name at least one channel, as in observe = ["displacement"], or leave the line out',
    ),
    "observe numbers": (
        DEAD,
        {'observe = ["displacement"]': 'observe = ["displacement", 2]'},
        'fit.observe, item 2 = 2 is not text in quotation marks: write it like observe = ["displacement"]',
    ),
    "bounds reversed": (
        DEAD,
        {"": 'bounds = {"heat.h0" = ["200 W/m^2/K", "50 W/m^2/K"]}'},
        "fit.bounds of heat.h0, ['200 W/m^2/K', '50 W/m^2/K'], are in the wrong order: put the smaller one first",
    ),
    "bounds empty": (
        DEAD,
        {"": 'bounds = {"heat.h0" = ["100.6 W/m^2/K", "100.6 W/m^2/K"]}'},
        "fit.bounds of heat.h0, ['100.6 W/m^2/K', '100.6 W/m^2/K'], are equal: move them apart",
    ),
    "bounds next to the nominal value": (
        DEAD,
        {"": 'bounds = {"heat.h0" = ["150 W/m^2/K", "200 W/m^2/K"]}'},
        "fit.bounds of heat.h0, ['150 W/m^2/K', '200 W/m^2/K'], exclude its nominal value 100.6 W/m^2/K: widen them, "
        "or set heat.h0 to a value within them, such as 175 W/m^2/K",
    ),
    "bounds beyond the model": (
        DEAD,
        {"": 'bounds = {"heat.h0" = ["-50 W/m^2/K", "200 W/m^2/K"]}'},
        "fit.bounds of heat.h0: '-50 W/m^2/K' is beyond 0 W/m^2/K, the limit of the model: stay within it",
    ),
    "bounds of one end": (
        DEAD,
        {"": 'bounds = {"heat.h0" = "50 W/m^2/K"}'},
        'fit.bounds of heat.h0 = \'50 W/m^2/K\' are not a pair: write two quantities like ["50 W/m^2/K", "200 W/m^2/K"]',
    ),
    "bounds as bare numbers": (
        DEAD,
        {"": 'bounds = {"heat.h0" = [50, 200]}'},
        "fit.bounds of heat.h0: '50' has no unit, and W/m^2/K is expected: write it like '100 W/m^2/K'",
    ),
    "noise zero": (
        DEAD,
        {"": 'noise = {displacement = "0 mm"}'},
        "fit.noise of displacement = '0 mm' is not positive: give its standard deviation, or leave it out",
    ),
    "noise of no channel": (
        DEAD,
        {"": 'noise = {displacment = "0.02 mm"}'},
        "fit.noise has 'displacment', which is not a channel of this rig (did you mean 'displacement'?): name one of fit.observe",
    ),
    "no starts": (DEAD, {"starts = 4": "starts = 0"}, "fit.starts = 0 is not 1 or more: write it like starts = 4"),
    "starts as text": (
        DEAD,
        {"starts = 4": 'starts = "4"'},
        "fit.starts = '4' is not a whole number: write it like starts = 4",
    ),
    "seed negative": (DEAD, {"seed = 0": "seed = -1"}, "fit.seed = -1 is not 0 or more: write it like seed = 0"),
    # Sensors and channels
    "sensor key misspelt": (
        DEAD,
        {"": "\n[sensor]\ndisplacement_gian = 1"},
        "sensor.displacement_gian is not known (did you mean 'displacement_gain'?): correct it, or remove it",
    ),
    "sensor offset without unit": (
        DEAD,
        {"": "\n[sensor]\ndisplacement_offset = 0.1"},
        "sensor.displacement_offset: '0.1' has no unit, and m is expected: write it like '0.15 mm'",
    ),
    "channel misspelt": (
        DEAD,
        {"": '\n[channels]\ndisplacment = "Laser (um)"'},
        "channels.displacment is neither a channel nor an option (did you mean 'displacement'?): correct it, or remove it",
    ),
    "channel not a header": (
        DEAD,
        {"": "\n[channels]\ndisplacement = 3"},
        'channels.displacement = 3 is not the header of a column: write it like "Laser (um)" or {column = "Laser (um)", unit = "um"}',
    ),
    "channel's unit of another kind": (
        DEAD,
        {"": '\n[channels]\ndisplacement = {column = "Laser", unit = "kg"}'},
        "channels.displacement: the unit 'kg' does not fit: a unit that converts to m is expected, as in '0.15 mm'",
    ),
    "unit of which channel": (
        DEAD,
        {"": '\n[channels]\ndisplacement = "a"\ncurrent = "b"\nunit = "um"'},
        'channels.unit = \'um\' does not name its channel: write it like displacement = {column = "Laser (um)", unit = "um"}',
    ),
    "decimal comma between commas": (
        DEAD,
        {"": '\n[channels]\ndelimiter = ","\ndecimal = ","'},
        'channels.delimiter and channels.decimal are both ",": set delimiter = ";" or "\\t"',
    ),
    # Parameter sets
    "set unknown": (
        DEAD,
        {"[rig]": '[rig]\nparameters = "no-such-wire"'},
        "rig.parameters = 'no-such-wire' is not known",
    ),
    "set not a name": (
        DEAD,
        {"[rig]": "[rig]\nparameters = 3"},
        "rig.parameters = 3 is not a name: write it like parameters = ",
    ),
    "set's file missing": (
        DEAD,
        {"[rig]": '[rig]\nparameters = "sets/no-such-wire.toml"'},
        "rig.parameters: sets/no-such-wire.toml: there is no such file: check the path of the parameter set",
    ),
    # Not TOML
    "section twice": (
        DEAD,
        {"[load]": "[wire]"},
        "row 40, column 6: this section is in the file twice: put its keys together under one heading",
    ),
    "key twice": (
        DEAD,
        {'length = "230 mm"': 'length = "230 mm"\nlength = "231 mm"'},
        "row 39, column 18: this key (or section) already has a value: keep one of the two",
    ),
    "quotation mark open": (
        DEAD,
        {'"230 mm"': '"230 mm'},
        "row 38, column 17: a quotation mark is not closed on its line, or a character is not allowed here: close it, or remove it",
    ),
    "no equals sign": (
        DEAD,
        {'length = "230 mm"': 'length "230 mm"'},
        "row 38, column 8: this is neither a [section] nor a key = value: write one of the two",
    ),
    "brackets without end": (
        DEAD,
        {"": "\nignore = " + "[" * 5000},
        "a number or a nesting of brackets in this file is too large to be read: correct it",
    ),
    "number without end": (
        DEAD,
        {"seed = 0": "seed = " + "9" * 5000},
        "a number or a nesting of brackets in this file is too large to be read: correct it",
    ),
}
# Messages that end with a list of shipped files: only the beginning is compared.
OPEN_ENDED = {"model unknown", "set unknown", "set not a name"}


def malformed(kind: str, changes: dict[str, str]) -> str:
    text = data_path("templates", f"{kind}.toml").read_text("utf-8")
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new, 1) if old else text + new
    return text


@pytest.mark.parametrize("case", CASES)
def test_malformed_rig_files_are_refused(case: str):
    kind, changes, sentence = CASES[case]
    with pytest.raises(InputError) as error:
        parse_rig(malformed(kind, changes))
    message = str(error.value)
    expected = f"rig.toml: {sentence}"
    assert (message[: len(expected)] if case in OPEN_ENDED else message) == expected
    assert "\n" not in message


def test_a_missing_file_suggests_a_similar_one(tmp_path: Path):
    (tmp_path / "rig.toml").write_text("schema = 1")
    with pytest.raises(InputError) as error:
        read_rig(tmp_path / "rgi.toml")
    assert (
        str(error.value)
        == f"{tmp_path}/rgi.toml: there is no such file (did you mean 'rig.toml'?): check the path of the rig"
    )


def test_folder(tmp_path: Path):
    with pytest.raises(InputError) as error:
        read_rig(tmp_path)
    assert str(error.value) == f"{tmp_path}: this is a folder: name the rig file in it, one ending in .toml"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "the file is empty: a rig begins with a line 'schema = ...', as 'smajax init' writes it"),
        (b" \n\t\n", "the file is empty: a rig begins with a line 'schema = ...', as 'smajax init' writes it"),
        (b"schema = 1\n# \xb5m\n", "row 2 is not text in UTF-8: name the .toml file of the rig, saved as UTF-8"),
        (b"PAR1\0\0\0", "this is a binary file: name the .toml file of the rig, saved as UTF-8 text"),
        (b"#" * 1_100_000, "1100000 bytes are too many for a rig: name the .toml file, not a recording"),
        (
            b"time [s],current [A]\n0,1\n",
            "row 1, column 6: this is neither a [section] nor a key = value: write one of the two",
        ),
    ],
)
def test_files_that_are_not_rigs_are_refused(tmp_path: Path, content: bytes, sentence: str):
    path = tmp_path / "rig.toml"
    path.write_bytes(content)
    with pytest.raises(InputError) as error:
        read_rig(path)
    assert str(error.value) == f"{path}: {sentence}"


def test_messages_have_the_path_of_the_caller(tmp_path: Path):
    path = tmp_path / "my-rig.toml"
    path.write_text(malformed(DEAD, {'"0.15 mm"': '"-1 mm"'}))
    with pytest.raises(InputError, match=r"^.*/my-rig\.toml: wire\.diameter: '-1 mm' is not possible"):
        read_rig(path)


def test_error_is_one_of_input():
    assert InputError.exit_code == 2
    with pytest.raises(InputError) as error:
        parse_rig("schema = 1\n[rig]\nkind = 5\n")
    assert str(error.value).startswith("rig.toml: rig.kind: 5 is not known: it is one of dead-weight")
