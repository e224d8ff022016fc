"""Options and arguments that several commands share."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from smajax.arguments import MAX_SEED

# ``smajax.fitting.fit.MAX_STEPS``, which ``smajax --help`` does not import.
DEFAULT_MAX_STEPS = 100
# Larger numbers are typing errors: fits of rigs that converge take 5 to 60 steps.
MAX_STEPS = 100_000


class Device(StrEnum):
    """Devices for thousands of designs at a time."""

    auto = "auto"
    cpu = "cpu"
    gpu = "gpu"


RigFile = Annotated[Path, typer.Argument(metavar="RIG", help="The rig file (rig.toml).")]
Out = Annotated[
    Path,
    typer.Option("--out", metavar="DIR", help="The result folder; an earlier result there is replaced as a whole."),
]
Quiet = Annotated[bool, typer.Option("--quiet", help="Show no progress and no summary.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result file to stdout, and nothing else there.")]
Seed = Annotated[
    int | None, typer.Option("--seed", min=0, max=MAX_SEED, help="Seed of random numbers (default: the rig's).")
]
Open = Annotated[bool, typer.Option("--open/--no-open", help="Open the report.")]
Start = Annotated[
    Path | None, typer.Option("--start", metavar="FIT.toml", help="Start from the parameters of an earlier fit.")
]
TrainFile = Annotated[Path, typer.Argument(metavar="TRAIN.csv", help="The recording to fit.")]
Auto = Annotated[bool, typer.Option("--auto", help="Fit an offset of a sensor that the recordings show, too.")]
Split = Annotated[
    bool,
    typer.Option("--split", help="Cut the only recording into parts for training, selection and holdout."),
]
