"""The commands tune and sweep."""

from pathlib import Path
from typing import Annotated

import typer

from smajax.app.command_line.early_checks import check_files
from smajax.app.command_line.options import Device, Json, Open, Out, Quiet, RigFile, Seed
from smajax.app.command_line.run import argv, finish_run, start_run
from smajax.app.memory_limit import MANY_PROGRAMS, WIDE_PROGRAMS


def tune(
    rig: RigFile,
    controller: Annotated[
        Path, typer.Argument(metavar="CONTROLLER.toml", help="The controller, its reference and its limits.")
    ],
    out: Out,
    seed: Seed = None,
    quiet: Quiet = False,
    as_json: Json = False,
    open_report: Open = False,
) -> None:
    """Tune a controller's gains in its closed loop with the rig; write them for a microcontroller."""
    check_files(toml={"rig": rig, "controller": controller}, out=out)
    with start_run(quiet, address_space=MANY_PROGRAMS, page="tune", keep_memory=True) as progress:
        from smajax.api.tune import tune as tune_gains

        study = tune_gains(rig, controller, seed=seed, progress=progress)
        study.save(out, argv=argv())
    finish_run(study, out, progress, quiet=quiet, as_json=as_json, open_report=open_report)


def sweep(
    sweep_file: Annotated[
        Path, typer.Argument(metavar="SWEEP.toml", help="The sweep; or sweep.parquet of an earlier one, to repeat it.")
    ],
    out: Out,
    scheduler: Annotated[
        str | None,
        typer.Option(
            "--scheduler", metavar="tcp://...", help="A Dask scheduler that shares the work; 'local' starts one here."
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue a run that ended early; finished chunks are kept.")
    ] = False,
    device: Annotated[
        Device, typer.Option("--device", help="Where designs are simulated; auto takes a GPU if JAX has one.")
    ] = Device.auto,
    quiet: Quiet = False,
    as_json: Json = False,
    open_report: Open = False,
) -> None:
    """Simulate many designs of a rig: the best ones, their trade-offs, what matters; refine them by gradients."""
    check_files(toml={"sweep": sweep_file}, out=out)
    with start_run(quiet, device, address_space=WIDE_PROGRAMS, page="sweep") as progress:
        from smajax.api.sweep import sweep as simulate_designs

        study = simulate_designs(
            sweep_file, folder=out, scheduler=scheduler, resume=resume, progress=progress, argv=argv()
        )
    finish_run(study, out, progress, quiet=quiet, as_json=as_json, open_report=open_report)
