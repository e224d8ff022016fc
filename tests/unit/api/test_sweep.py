"""``smajax.sweep``: what it needs is said before the first design."""

import sys

import pytest

from smajax.api.sweep import sweep
from smajax.errors import InputError
from smajax.recordings.datasets import data_path


def test_a_sweep_without_pyarrow_is_refused_before_any_computation(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    events = []
    with pytest.raises(InputError) as raised:
        sweep(data_path("sweeps", "dead-weight.toml"), progress=events.append)
    assert str(raised.value) == 'sweep.parquet: Parquet files need pyarrow: run pip install "smajax[io]"'
    assert events == []
