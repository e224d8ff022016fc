"""Makes the shipped recordings: ``python -m tests.reference.make_data [NAME ...]`` writes into data/recordings/.

Each rig.toml there is written by hand and holds nominal values. The wire behind the recordings differs from them by the factors and shifts
in ``TRUTHS``, which truth.toml records; the exact simulators of this folder run it, and a sensor adds noise. Seeds are fixed: the same
versions of NumPy and numba give the same files.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.reference.rig_file import TEMPERATURES, RigFile, read_channel, read_rig, simulate
from tests.reference.wire import CONTROLS, Rig, State, heating

FOLDER = Path(__file__).parents[2] / "data" / "recordings"
SPLITS = ("train", "select", "holdout")
# A further recording of some folders: whole cycles under one stress.
CYCLES = {"isobaric": "cycles"}

Floats = NDArray[np.float64]
Columns = dict[str, Floats]


@dataclass(frozen=True)
class Channel:
    """An observed column: its header, one of its units in SI, the standard deviation of its noise and the digits, both in that unit.

    ``grid`` is the step of a counting sensor, 0 for none.
    """

    name: str
    unit: str
    si: float
    noise: float
    digits: int
    grid: float = 0.0


@dataclass(frozen=True)
class Recipe:
    """How a folder is made: its inputs from a random generator (in the file's units), what is observed, and other columns ``extra``."""

    inputs: Callable[[np.random.Generator], Columns]
    observed: Channel
    options: dict[str, int]
    extra: tuple[Channel, ...] = ()


# Factors on nominal values; temperatures and shifts of both of a phase are moved by so many K. Only parameters that the rig file leaves free.
TRUTHS: dict[str, dict[str, float]] = {
    "dead-weight": {"h0": 1.06, "h2": 0.9, "capacity": 0.96, "max_transformation_strain": 1.02, "austenite_shift": 1.7, "martensite_shift": -1.2},
    "rotary": {"h0": 0.95, "h2": 1.15, "capacity": 1.04, "max_transformation_strain": 0.985, "austenite_shift": -1.4, "martensite_shift": 0.8},
    "bias-spring": {"h0": 1.03, "h2": 1.1, "capacity": 1.05, "max_transformation_strain": 0.975, "austenite_shift": 2.1, "martensite_shift": 1.3},
    "testing-machine": {
        "h0": 0.96, "capacity": 1.03, "modulus_austenite": 1.04, "modulus_martensite": 0.95, "max_transformation_strain": 1.015,
        "austenite_shift": 1.1, "martensite_shift": -1.8,
    },
    "dead-weight-unexplained": {"h0": 0.96, "h2": 1.1, "capacity": 1.03, "max_transformation_strain": 0.985, "austenite_shift": -1.2, "martensite_shift": 1.4},
    "isobaric": {
        "austenite_start": 2.9, "austenite_finish": 1.6, "martensite_start": -1.1, "detwinning_finish_stress": 1.06, "max_transformation_strain": 1.03,
        "clausius_clapeyron_austenite": 1.04, "clausius_clapeyron_martensite": 0.97,
    },
    "coil-dead-weight": {"h0": 1.05, "capacity": 0.97, "max_transformation_strain": 1.02, "austenite_shift": 1.4, "martensite_shift": -1.1},
    "coil-bias-spring": {"h0": 0.96, "capacity": 1.04, "max_transformation_strain": 0.98, "austenite_shift": -1.3, "martensite_shift": 1.6},
    "coil-antagonistic": {"h0": 1.04, "capacity": 1.03, "max_transformation_strain": 0.985, "austenite_shift": 1.2, "martensite_shift": -0.9},
    "hip": {"h0": 0.95, "capacity": 0.96, "max_transformation_strain": 1.025, "austenite_shift": -1.5, "martensite_shift": 1.1},
    "elbow": {"h0": 1.05, "capacity": 0.96, "max_transformation_strain": 0.98, "austenite_shift": 1.5, "martensite_shift": -1.1, "friction": 1.25},
    "wrist": {"h0": 0.95, "capacity": 1.04, "max_transformation_strain": 1.02, "austenite_shift": -1.3, "martensite_shift": 1.6, "friction": 0.8},
    "glove-finger": {"h0": 1.04, "capacity": 1.03, "max_transformation_strain": 0.975, "austenite_shift": -1.8, "martensite_shift": -1.2, "friction": 1.2},
}  # fmt: skip
# Effect of the wire that is not in its rig file: the latent heat of Flexinol, 24.2 kJ/kg, at 6450 kg/m^3 is 1.56e8; a third of it here.
HIDDEN: dict[str, dict[str, float]] = {"dead-weight-unexplained": {"latent_heat": 5e7}}
# The parameter that each truth says, and its unit with its size in SI; a capacity is one for both phases.
WRITTEN = {
    "h0": ("heat.h0", "W/m^2/K", 1.0),
    "h2": ("heat.h2", "W/m^2/K^3", 1.0),
    "capacity": ("heat.capacity", "MJ/m^3/K", 1e6),
    "max_transformation_strain": ("material.max_transformation_strain", "%", 1e-2),
    "detwinning_finish_stress": ("material.detwinning_finish_stress", "MPa", 1e6),
    "modulus_austenite": ("material.modulus_austenite", "GPa", 1e9),
    "modulus_martensite": ("material.modulus_martensite", "GPa", 1e9),
    "clausius_clapeyron_austenite": ("material.clausius_clapeyron_austenite", "MPa/K", 1e6),
    "clausius_clapeyron_martensite": ("material.clausius_clapeyron_martensite", "MPa/K", 1e6),
    "friction": ("sheath.friction", "%", 1e-2),
}


def clock(seconds: float, rate: float = 50.0) -> Floats:
    """Sample times in s."""
    return np.arange(round(seconds * rate) + 1) / rate


def shipped(name: str) -> RigFile:
    """Return the rig of a shipped folder."""
    return read_rig(FOLDER / name / "rig.toml")


def turns(
    rng: np.random.Generator,
    time: Floats,
    rig: RigFile,
    down: tuple[float, float],
    up: tuple[float, float],
    bands: Floats,
    hottest: float = 125.0,
) -> Floats:
    """A signal that goes up and down between levels in ``down`` and ``up``, by steps and ramps, and turns within the wire's bands.

    It turns when the wire, by the nominal heat balance at half martensite, has reached a temperature drawn
    from ``bands``: (lowest, highest) of the turns after cooling, and of those after heating. Every sixth leg goes all the way, to
    ``hottest`` or nearly to ambient.
    """
    bench = Rig(rig.material, rig.heat, rig.wire, CONTROLS[rig.control], 1.0, 0.0, 0.0)
    signal, temperature, leg, step = np.zeros(len(time)), rig.wire.ambient, 0, time[1]
    begin = level = start = ramp = turn = 0.0
    for k, now in enumerate(time):
        rising = leg % 2 == 1
        if k == 0 or (temperature >= turn if rising else temperature <= turn):
            leg, begin, start = leg + 1, now, signal[k - 1] if k else 0.0
            rising = leg % 2 == 1
            whole = leg % 6 in (1, 4)
            level = (up[1] if rising else 0.0) if whole else rng.uniform(*(up if rising else down))
            turn = (hottest if rising else rig.wire.ambient + 5.0) if whole else rng.uniform(*bands[int(rising)])
            ramp = rng.uniform(0.3, 2.0) if rng.random() < 0.5 else step / 2
        signal[k] = start + (level - start) * min((now - begin) / ramp, 1.0)
        state = State(temperature, 0.0, 0.5, 0.0)
        temperature += step * heating(bench, signal[k], state) / rig.heat.capacity_austenite
    return signal


def dead_weight(rng: np.random.Generator) -> Columns:
    """Return 120 s of current: many partial loops between full ones."""
    time, bands = clock(120.0), np.array([[48.0, 62.0], [85.0, 99.0]])
    return {
        "time [s]": time,
        "current [A]": turns(rng, time, shipped("dead-weight"), (0.0, 0.14), (0.29, 0.34), bands).round(4),
    }


def unexplained(rng: np.random.Generator) -> Columns:
    """As ``dead_weight``, for 60 s."""
    time, bands = clock(60.0), np.array([[48.0, 62.0], [85.0, 99.0]])
    return {
        "time [s]": time,
        "current [A]": turns(rng, time, shipped("dead-weight"), (0.0, 0.14), (0.29, 0.34), bands).round(4),
    }


def bias_spring(rng: np.random.Generator) -> Columns:
    """Return 100 s of voltage: many partial loops between full ones."""
    time, bands = clock(100.0), np.array([[45.0, 80.0], [82.0, 112.0]])
    return {
        "time [s]": time,
        "voltage [V]": turns(rng, time, shipped("bias-spring"), (0.0, 1.5), (3.75, 4.2), bands).round(3),
    }


def rotary(rng: np.random.Generator) -> Columns:
    """80 s in which the wires take turns of 1.5 to 6 s, with pauses, each turn's current steady, rising or falling."""
    time = clock(80.0)
    signal, now, turn = np.zeros((len(time), 2)), 0.0, 0
    while now <= time[-1]:
        span, pause = rng.uniform(1.5, 6.0), rng.uniform(0.3, 3.0) if rng.random() < 0.4 else 0.0
        inside = (time >= now) & (time < now + span)
        signal[inside, turn % 2] = np.interp(time[inside] - now, [0.0, span], rng.uniform(0.30, 0.47, 2))
        now, turn = now + span + pause, turn + 1
    return {"time [s]": time, "current_1 [A]": signal[:, 0].round(4), "current_2 [A]": signal[:, 1].round(4)}


def testing_machine(rng: np.random.Generator) -> Columns:
    """60 s of strain cycles; the power changes at the turns of every second cycle, so that each is at nearly one temperature."""
    time = clock(60.0)
    turns, strains, powers = [0.0], [0.0], []
    while turns[-1] <= time[-1]:
        if len(turns) % 4 == 1:
            # Warm up at a standstill, then two cycles.
            turns.append(turns[-1] + rng.uniform(2.0, 3.0))
            strains.append(strains[-1])
            powers += [rng.choice([0.0, 0.35, 0.5, 0.6, 0.68])] * 4
        else:
            turns.append(turns[-1] + rng.uniform(1.5, 3.0))
            strains.append(rng.uniform(2.0, 4.0) if strains[-1] < 1.5 else rng.uniform(0.0, 1.2))
    level = np.array(powers)[np.searchsorted(turns, time, side="right") - 1]
    return {"time [s]": time, "power [W]": level.round(3), "strain [%]": np.interp(time, turns, strains).round(4)}


def isobaric(rng: np.random.Generator) -> Columns:
    """Three stress levels, each loaded hot: from cold a partial loop, from hot another, and all the way; half a kelvin a row."""
    temperature, stress, hot, before = [], [], 140.0, 0.0
    for level in np.sort(rng.uniform(60.0, 260.0, 3) + np.array([-20.0, 0.0, 20.0])).round():
        loading = np.arange(before, level, 2.0)
        temperature += [hot] * len(loading)
        stress += list(loading)
        # Within the bands of the forward and of the reverse transformation.
        low = rng.uniform(35.0, 44.0, 2) + level / 6.3
        high = rng.uniform(69.0, 77.0, 2) + level / 6.7
        legs = [hot, 20.0, high[0], low[0], hot, low[1], high[1], 20.0, hot]
        for start, end in zip(legs, legs[1:], strict=False):
            rows = np.arange(start, end, np.copysign(0.5, end - start))
            temperature += list(rows)
            stress += [level] * len(rows)
        before = level
    return {"temperature [degC]": np.array(temperature).round(2), "stress [MPa]": np.array(stress).round(2)}


def whole_cycles() -> Columns:
    """Return three whole cycles under 150 MPa, loaded hot, half a kelvin a row."""
    loading = np.arange(0.0, 150.0, 2.0)
    cycle = np.concatenate([np.arange(140.0, 20.0, -0.5), np.arange(20.0, 140.0, 0.5)])
    temperature = np.concatenate([np.full(len(loading), 140.0), np.tile(cycle, 3), [140.0]])
    stress = np.concatenate([loading, np.full(len(temperature) - len(loading), 150.0)])
    return {"temperature [degC]": temperature, "stress [MPa]": stress}


def coil_dead_weight(rng: np.random.Generator) -> Columns:
    """Return 200 s of current through a lifting coil: many partial loops between full ones."""
    time, bands = clock(200.0, 10.0), np.array([[57.0, 71.0], [87.0, 105.0]])
    return {
        "time [s]": time,
        "current [A]": turns(rng, time, shipped("coil-dead-weight"), (0.0, 0.6), (1.55, 1.9), bands).round(3),
    }


def coil_bias_spring(rng: np.random.Generator) -> Columns:
    """200 s of voltage at a coil that stretches a spring."""
    time, bands = clock(200.0, 10.0), np.array([[47.0, 78.0], [82.0, 110.0]])
    return {
        "time [s]": time,
        "voltage [V]": turns(rng, time, shipped("coil-bias-spring"), (0.0, 0.6), (1.65, 2.1), bands).round(3),
    }


def taking_turns(
    rng: np.random.Generator, time: Floats, spans: tuple[float, float], levels: tuple[float, float]
) -> Floats:
    """Two inputs (n, 2) of which one is on at a time for a span within ``spans``, with pauses, each turn steady, rising or falling."""
    signal, now, turn = np.zeros((len(time), 2)), 0.0, 0
    while now <= time[-1]:
        span, pause = rng.uniform(*spans), rng.uniform(1.0, 8.0) if rng.random() < 0.4 else 0.0
        inside = (time >= now) & (time < now + span)
        signal[inside, turn % 2] = np.interp(time[inside] - now, [0.0, span], rng.uniform(*levels, 2))
        now, turn = now + span + pause, turn + 1
    return signal


def coil_antagonistic(rng: np.random.Generator) -> Columns:
    """200 s in which two coils take turns."""
    time = clock(200.0, 10.0)
    signal = taking_turns(rng, time, (4.0, 14.0), (1.25, 1.9)).round(3)
    return {"time [s]": time, "current_1 [A]": signal[:, 0], "current_2 [A]": signal[:, 1]}


def hip(rng: np.random.Generator) -> Columns:
    """240 s in which the groups of springs take turns at up to 12 V."""
    time = clock(240.0, 10.0)
    signal = taking_turns(rng, time, (5.0, 18.0), (7.5, 12.0)).round(2)
    return {"time [s]": time, "voltage_1 [V]": signal[:, 0], "voltage_2 [V]": signal[:, 1]}


def pushes(
    name: str, unit: str, low: tuple[float, float], high: tuple[float, float], digits: int
) -> Callable[[np.random.Generator], Columns]:
    """150 s at 10 Hz in which heating, at a level in ``high`` for 4 to 9 s, and cooling, at one in ``low`` for 14 to 40 s, take turns."""

    def inputs(rng: np.random.Generator) -> Columns:
        time = clock(150.0, 10.0)
        signal, now, heats = np.zeros(len(time)), 1.0, True
        while now <= time[-1]:
            span = rng.uniform(4.0, 9.0) if heats else rng.uniform(14.0, 40.0)
            signal[(time >= now) & (time < now + span)] = rng.uniform(*(high if heats else low))
            now, heats = now + span, not heats
        return {"time [s]": time, f"{name} [{unit}]": signal.round(digits)}

    return inputs


MILLIMETRE, DEGREE, MEGAPASCAL, PERCENT = 1e-3, np.pi / 180, 1e6, 1e-2
RECIPES: dict[str, Recipe] = {
    "dead-weight": Recipe(dead_weight, Channel("displacement", "mm", MILLIMETRE, 0.02, 4), {"substeps": 20}),
    "rotary": Recipe(rotary, Channel("angle", "deg", DEGREE, 0.06, 3, 0.025), {"substeps": 100}),
    "bias-spring": Recipe(bias_spring, Channel("displacement", "mm", MILLIMETRE, 0.02, 4), {"substeps": 20}),
    "testing-machine": Recipe(testing_machine, Channel("stress", "MPa", MEGAPASCAL, 1.0, 2), {"substeps": 40}),
    "isobaric": Recipe(isobaric, Channel("strain", "%", PERCENT, 0.01, 4), {}),
    "dead-weight-unexplained": Recipe(
        unexplained, Channel("displacement", "mm", MILLIMETRE, 0.02, 4), {"substeps": 20}
    ),
    "coil-dead-weight": Recipe(coil_dead_weight, Channel("displacement", "mm", MILLIMETRE, 0.05, 3), {"substeps": 30}),
    "coil-bias-spring": Recipe(coil_bias_spring, Channel("displacement", "mm", MILLIMETRE, 0.05, 3), {"substeps": 30}),
    "coil-antagonistic": Recipe(coil_antagonistic, Channel("angle", "deg", DEGREE, 0.06, 3, 0.025), {"substeps": 30}),
    "hip": Recipe(
        hip, Channel("angle", "deg", DEGREE, 0.2, 3), {"substeps": 30}, (Channel("rate", "deg/s", DEGREE, 1.0, 2),)
    ),
    "elbow": Recipe(
        pushes("current", "A", (0.0, 0.8), (2.8, 3.4), 3), Channel("angle", "deg", DEGREE, 0.3, 2), {"substeps": 10}
    ),
    "wrist": Recipe(
        pushes("voltage", "V", (0.0, 2.5), (9.0, 12.0), 3), Channel("angle", "deg", DEGREE, 0.2, 2), {"substeps": 10}
    ),
    "glove-finger": Recipe(
        pushes("power", "W", (0.0, 2.0), (25.0, 40.0), 2), Channel("angle", "deg", DEGREE, 0.5, 2), {"substeps": 10}
    ),
}


def read_sensor(rng: np.random.Generator, exact: Floats, channel: Channel) -> Floats:
    """Return the measured values of an exact SI series: in the unit of the file, with noise, on the sensor grid."""
    values = exact / channel.si + channel.noise * rng.standard_normal(len(exact))
    if channel.grid:
        values = channel.grid * np.round(values / channel.grid)
    # Adding zero turns -0 into 0.
    return values.round(channel.digits) + 0.0


def in_si(columns: Columns) -> dict[str, Floats]:
    """The inputs by channel name, in SI and degC."""
    sizes = {"mm": MILLIMETRE, "deg": DEGREE, "MPa": MEGAPASCAL, "%": PERCENT}
    split = {header: header.rstrip("]").split(" [") for header in columns}
    return {split[header][0]: values * sizes.get(split[header][1], 1.0) for header, values in columns.items()}


def splits(name: str) -> tuple[str, ...]:
    """Return the recordings of a folder."""
    return (*SPLITS, CYCLES[name]) if name in CYCLES else SPLITS


def truth(nominal: RigFile, name: str) -> RigFile:
    """Return the rig with the true values of a folder's recordings."""
    rig = nominal.changed(**TRUTHS[name])
    return replace(rig, heat=rig.heat._replace(**HIDDEN.get(name, {})))


def make(name: str, split: str) -> tuple[Columns, Floats]:
    """One recording in the file's units, and the exact observed series in SI behind it."""
    recipe = RECIPES[name]
    rng = np.random.default_rng([list(RECIPES).index(name), [*SPLITS, CYCLES.get(name)].index(split)])
    columns = whole_cycles() if split == CYCLES.get(name) else recipe.inputs(rng)
    rig = truth(read_rig(FOLDER / name / "rig.toml"), name)
    run = simulate(rig, in_si(columns), **recipe.options)
    for channel in (recipe.observed, *recipe.extra):
        columns[f"{channel.name} [{channel.unit}]"] = read_sensor(rng, read_channel(run, channel.name), channel)
    return columns, read_channel(run, recipe.observed.name)


def write_csv(path: Path, columns: Columns) -> None:
    """Write a header and numbers without insignificant digits."""
    rows = zip(*([f"{value:.10g}" for value in column] for column in columns.values()), strict=True)
    path.write_text("\n".join([",".join(columns), *(",".join(row) for row in rows)]) + "\n", encoding="utf-8")


def truth_text(name: str, nominal: RigFile) -> str:
    """truth.toml: a parameter file with the values behind the recordings, and their noise in the heading."""
    true, tables = nominal.changed(**TRUTHS[name]), []
    for key, by in TRUTHS[name].items():
        if key.endswith("_shift"):
            parameter, value, source = f"material.{key}", f"{by:g} K", "added to the nominal temperatures"
        elif key in TEMPERATURES:
            parameter, value, source = (
                f"material.{key}",
                f"{getattr(true.material, key):.10g} degC",
                f"nominal and {by:+g} K",
            )
        else:
            parameter, unit, size = WRITTEN[key]
            values = true.heat._asdict() | true.material._asdict() | true.mechanism
            number = values["capacity_austenite" if key == "capacity" else key] / size
            value, source = f"{number:.10g} {unit}", f"nominal times {by:g}"
        tables.append(f'[{parameter}]\nvalue = "{value}"\nsource = "{source}"\n')
    for key, value in HIDDEN.get(name, {}).items():
        tables.append(f"# Hidden from rig.toml: {key} = {value:g} J/m^3\n")
    noise = "; ".join(
        f"{c.noise:g} {c.unit} in {c.name}" + (f", then rounding to {c.grid:g} {c.unit}" if c.grid else "")
        for c in (RECIPES[name].observed, *RECIPES[name].extra)
    )
    head = (
        f'schema = "smajax.parameters/1"\ntitle = "{name}: the values behind the recordings"\n'
        f'source = "chosen for tests.reference.make_data, which ran them through the exact simulator; all else is as in rig.toml"\n'
        f"# Noise: white, {noise}.\n"
    )
    return "\n".join([head, *tables])


def main(names: list[str]) -> None:
    """Write the named folders, or all."""
    for name in names or RECIPES:
        folder = FOLDER / name
        (folder / "truth.toml").write_text(truth_text(name, read_rig(folder / "rig.toml")), encoding="utf-8")
        for split in splits(name):
            columns, _ = make(name, split)
            write_csv(folder / f"{split}.csv", columns)
            print(f"{name}/{split}.csv: {len(next(iter(columns.values())))} rows")


if __name__ == "__main__":
    main(sys.argv[1:])
