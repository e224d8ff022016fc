"""The list of experiments with their running times: a part of the site, and experiments/README.md.

    python -m docs.generate.experiment_list

writes that file, which a test compares with the results.
"""

from docs.generate.markdown import table
from docs.generate.results import EXPERIMENTS, duration, question, results, variant

TEXT = """# Experiments

Each experiment is a program that prints a table of what was measured and what it should be. It is run as

```sh
python experiments/papers/knee_ankle/soft_bending.py
```

with the options `--quick` (within two minutes on two cores), `--json FILE` (all numbers), `--record` (the table, with
date, running time, processor and versions, to `results/`) and `--out DIR` (pictures). Recordings by others are read
from `../shared/data`, or from the folder named by `--data`. The pages of [benchmarks](../docs/benchmarks/index.md) are
made from `results/`; `python -m docs.generate.experiment_list` writes this file.

"""


def experiments() -> str:
    """Return a table of all experiments: what each asks, and its running time."""
    rows = []
    for path in sorted(EXPERIMENTS.rglob("*.py")):
        name = path.relative_to(EXPERIMENTS).with_suffix("").as_posix()
        if path.name != "__init__.py" and not name.startswith("common/"):
            rows.append((f"`{name}`", question(name), _times(name)))
    return table(("experiment", "what it asks", "running time"), rows)


def _times(name: str) -> str:
    """The running times of the runs of an experiment."""
    times = {variant(d): duration(d) for d in results().values() if d["experiment"] == name}
    return "; ".join(f"`{words}`: {text}" if words else text for words, text in times.items()) or "no run recorded"


def readme() -> str:
    """Return the content of experiments/README.md."""
    return TEXT + experiments()


if __name__ == "__main__":
    (EXPERIMENTS / "README.md").write_text(readme(), encoding="utf-8")
