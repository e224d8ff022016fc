"""Reads the parts of a rig.toml that the reference simulators need, and runs the simulator of its kind.

This reader is separate, so that the references stay independent; quantities have one of the units listed here.
"""

import re
import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.reference import coil, limb, rigs
from tests.reference.brinson import Material
from tests.reference.wire import Heat, Wire

_UNITS = {
    "": 1.0, "degC": 1.0, "K": 1.0, "A": 1.0, "V": 1.0, "W": 1.0, "m": 1.0, "mm": 1e-3, "kg": 1.0, "N": 1.0, "N/mm": 1e3, "%": 1e-2, "1/K": 1.0,
    "MPa": 1e6, "GPa": 1e9, "MPa/K": 1e6, "ohm m": 1.0, "uohm cm": 1e-8, "J/m^3": 1.0, "J/m^3/K": 1.0, "MJ/m^3/K": 1e6, "kg m^2": 1.0,
    "N m s/rad": 1.0, "W/m^2/K": 1.0, "W/m^2/K^2": 1.0, "W/m^2/K^3": 1.0, "s": 1.0, "deg": np.pi / 180, "deg/s": np.pi / 180,
    "N m": 1.0, "N m/rad": 1.0,
}  # fmt: skip
TEMPERATURES = ("martensite_start", "martensite_finish", "austenite_start", "austenite_finish")
MECHANISM = ("load", "spring", "pulley", "link", "limb", "transmission", "sheath")
# Keys of files written before version 0.2, and the names that they have now.
RENAMED_KEYS = {"max_strain": "max_transformation_strain", "bend": "wrap_angle"}
LIMBS = ("elbow", "wrist", "glove-finger")

Floats = NDArray[np.float64]


def quantity(text: str | float) -> float:
    """``"0.15 mm"`` in SI, ``"20 degC"`` in degC, a bare number as it is."""
    match = re.fullmatch(r"\s*([-+.\deE]+)\s*(.*?)\s*", str(text))
    if not match or match[2] not in _UNITS:
        raise ValueError(f"not a quantity of the reference reader: '{text}'")
    return float(match[1]) * _UNITS[match[2]]


@dataclass(frozen=True)
class RigFile:
    """A rig as the simulators take it; ``mechanism`` has the values of the sections that belong to the kind, such as [load], by key.

    Where the wire is coiled, ``coil`` has the values of [wire] by key, and ``wire`` is the wire itself, all springs of a bundle in series.
    """

    kind: str
    control: str
    interpolation: str
    material: Material
    heat: Heat
    wire: Wire
    mechanism: dict[str, float]
    observe: tuple[str, ...]
    coil: dict[str, float] = field(default_factory=dict)

    def changed(self, **factors_and_shifts: float) -> "RigFile":
        """The rig with some values multiplied (``h0=1.04``), transformation temperatures moved (``austenite_start=1.5``: by so many K),
        or both of a phase (``austenite_shift``, ``martensite_shift``)."""
        material, heat, mechanism = self.material._asdict(), self.heat._asdict(), dict(self.mechanism)
        for key, value in factors_and_shifts.items():
            if key in ("austenite_shift", "martensite_shift"):
                phase = key.removesuffix("_shift")
                material[f"{phase}_start"] += value
                material[f"{phase}_finish"] += value
            elif key in TEMPERATURES:
                material[key] += value
            elif key == "capacity":
                heat["capacity_austenite"] *= value
                heat["capacity_martensite"] *= value
            else:
                home = next(part for part in (material, heat, mechanism) if key in part)
                home[key] *= value
        return replace(self, material=Material(**material), heat=Heat(**heat), mechanism=mechanism)


def read_rig(path: str | Path) -> RigFile:
    """Read a rig.toml; missing values are 0, and the ambient temperature is 20 degC."""
    with Path(path).open("rb") as file:
        raw = tomllib.load(file)
    section = {
        name: {k: quantity(v) for k, v in raw.get(name, {}).items() if k != "set"}
        for name in ("material", "heat", "wire", "environment")
    }
    material = {RENAMED_KEYS.get(key, key): value for key, value in section["material"].items()}
    both = material.pop("thermal_expansion", 0.0)
    for phase in ("austenite", "martensite"):
        material.setdefault(f"thermal_expansion_{phase}", both)
        material.setdefault(f"resistivity_{phase}", 1e-6)
    heat: dict[str, Any] = {"h0": 0.0, "h1": 0.0, "h2": 0.0, "exponent": 2.0, "latent_heat": 0.0} | section["heat"]
    capacity = heat.pop("capacity", 1.0)
    heat = {"capacity_austenite": capacity, "capacity_martensite": capacity} | heat
    ambient, coiled = section["environment"].get("ambient", 20.0), {}
    if "turns" in section["wire"]:
        coiled = {"springs": 1.0, "poisson_ratio": 0.33, "prestretch": 0.0} | section["wire"]
        section["wire"] = {
            "diameter": coiled["diameter"],
            "length": coiled["springs"] * np.pi * coiled["coil_diameter"] * coiled["turns"],
        }
    wire = {"diameter": 1.0, "length": 1.0, "prestrain": 0.0} | section["wire"] | {"ambient": ambient}
    mechanism = {
        RENAMED_KEYS.get(key, key): quantity(value) for name in MECHANISM for key, value in raw.get(name, {}).items()
    }
    rig = raw["rig"]
    observe = tuple(raw.get("fit", {}).get("observe", ()))
    control, interpolation = rig.get("control", ""), rig.get("interpolation", "hold")
    return RigFile(
        rig["kind"],
        control,
        interpolation,
        Material(**material),
        Heat(**heat),
        Wire(**wire),
        mechanism,
        observe,
        coiled,
    )


def simulate(rig: RigFile, channels: dict[str, Floats], **options: Any) -> rigs.Run | coil.Run:
    """Run the simulator of the rig's kind on a recording's channels (SI, degC, by name; (n,) each)."""
    if rig.coil:
        return _simulate_coil(rig, channels, **options)
    parts = (rig.material, rig.heat, rig.wire)
    if rig.kind == "path":
        inputs = {name: channels[name] for name in ("stress", "strain") if name in channels and name not in rig.observe}
        return rigs.path(rig.material, channels["temperature"], **inputs, reference=rig.wire.ambient, **options)
    options = {"control": rig.control, "interpolation": rig.interpolation} | options
    time, of = channels["time"], rig.mechanism
    if rig.kind == "antagonistic-rotary":
        signal = np.column_stack([channels[f"{rig.control}_{i}"] for i in (1, 2)])
        if of.get("inertia", 0.0) > 0.0:
            return rigs.rotary_inertia(
                *parts, of["radius"], of["inertia"], of.get("damping", 0.0), time, signal, **options
            )
        return rigs.rotary(*parts, of["radius"], time, signal, **options)
    signal = channels[rig.control]
    if rig.kind == "dead-weight":
        return rigs.dead_weight(*parts, of["mass"], time, signal, **options)
    if rig.kind == "bias-spring":
        return rigs.bias_spring(*parts, of["stiffness"], of["preload"], time, signal, **options)
    if rig.kind == "testing-machine":
        return rigs.testing_machine(*parts, time, channels["strain"], signal, **options)
    if rig.kind in LIMBS:
        parts = limb.Limb(**{key: of.get(key, 0.0) for key in limb.Limb._fields})
        # A limb moves faster than a wire heats.
        options["substeps"] = 10 * options.get("substeps", 10)
        return limb.limb(rig.material, rig.heat, rig.wire, parts, time, signal, **options)
    raise ValueError(f"no reference simulator for a rig of kind '{rig.kind}'")


def _simulate_coil(rig: RigFile, channels: dict[str, Floats], **options: Any) -> coil.Run:
    shear = coil.sheared(rig.material, rig.coil["poisson_ratio"])
    spring = coil.Coil(
        rig.coil["diameter"] / 2, rig.coil["coil_diameter"] / 2, rig.coil["turns"], rig.coil["springs"], rig.wire.ambient,
        rig.material.resistivity_austenite, rig.material.resistivity_martensite,
    )  # fmt: skip
    parts, time, of = (shear, rig.heat, spring), channels["time"], rig.mechanism
    options = {"control": rig.control} | options
    if rig.kind == "coil-dead-weight":
        return coil.dead_weight(*parts, of["mass"], time, channels[rig.control], **options)
    if rig.kind == "coil-bias-spring":
        return coil.bias_spring(*parts, of["stiffness"], of["preload"], time, channels[rig.control], **options)
    signal = np.column_stack([channels[f"{rig.control}_{i}"] for i in (1, 2)])
    arguments = (*parts, rig.coil["prestretch"], of["radius"])
    if rig.kind == "coil-antagonistic":
        return coil.antagonistic(*arguments, time, signal, **options)
    inertia = of.get("inertia", 0.0) + of["mass"] * of["centre"] ** 2
    return coil.joint(
        *arguments, inertia, of.get("damping", 0.0), of["mass"] * coil.GRAVITY * of["centre"], time, signal, **options
    )


def read_csv(path: str | Path) -> dict[str, Floats]:
    """A recording's columns by name, in SI and degC."""
    with Path(path).open() as file:
        headers = [re.fullmatch(r"(\w+) \[(.*)\]", h.strip()) for h in file.readline().split(",")]
        values = np.loadtxt(file, delimiter=",").T
    return {h[1]: column * _UNITS[h[2]] for h, column in zip(headers, values, strict=True) if h}


def read_channel(run: rigs.Run | coil.Run, channel: str) -> Floats:
    """Return the exact values of ``channel`` in a run, shape ``(n,)``; a suffix ``_2`` names the wire."""
    if channel == "rate":
        return run.rate
    name, _, number = channel.partition("_")
    if name in ("displacement", "angle"):
        return run.position
    return getattr(run, name)[:, int(number or 1) - 1]
