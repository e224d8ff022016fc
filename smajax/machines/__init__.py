"""Machines whose equations are not those of a wire's five stages: what bends, and what cools across a section.

machine = smajax.machines.read("data/machines/flexural/rig.toml")
machine.metrics()                          # figures by name
machine.units                              # and the unit of each
smajax.parameters.replace(machine, {"wire.diameter": 0.25e-3})
"""

from smajax.machines.machine import AbstractMachine
from smajax.machines.machine_file import MACHINES, is_machine, kind_of, parse_machine, read, to_toml, write

__all__ = ["MACHINES", "AbstractMachine", "is_machine", "kind_of", "parse_machine", "read", "to_toml", "write"]
