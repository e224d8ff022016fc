"""The size of a sweep is known before its designs are drawn, and a grid takes no more memory than its designs."""

import itertools
import tracemalloc

import numpy as np
import pytest

from smajax.api.sweep import sweep
from smajax.errors import InputError
from smajax.files.templates import write_example
from smajax.sweeps.size import require_size, sweep_size
from smajax.sweeps.space import Axis, draw_designs
from smajax.sweeps.sweep_file import read_sweep

POINTS = (300, 300, 30, 30)


def write_grid(folder, points):
    """The example sweep as a grid."""
    write_example("dead-weight", folder)
    path = folder / "sweep.toml"
    ranges = ('"0.1 mm", to = "0.3 mm"', '"100 mm", to = "400 mm"', '"50 g", to = "1 kg"', '"0.15 A", to = "1.5 A"')
    names = ("wire.diameter", "wire.length", "load.mass", "input.amplitude")
    axes = [f"{n} = {{ from = {r}, points = {p} }}" for n, r, p in zip(names, ranges, points, strict=True)]
    rest = path.read_text("utf-8").partition("[input]")[2]
    head = 'schema = 1\n[sweep]\nrig = "example.toml"\nsampling = "grid"\n[parameters]\n'
    path.write_text(head + "\n".join(axes) + "\n[input]" + rest, "utf-8")
    return path


def test_a_grid_that_does_not_fit_is_refused_with_its_bytes_and_hours(tmp_path, monkeypatch):
    path = write_grid(tmp_path, POINTS)
    monkeypatch.setattr("smajax.sweeps.size.free_memory", lambda: 16e9)
    tracemalloc.start()
    with pytest.raises(
        InputError,
        match=r"sweep.toml: 81,000,000 designs need [\d,]{14} bytes of memory \(\d+\.\d GB\), and 16.0 GB are free; their simulation would take about \d+ h on this computer: take fewer",
    ):
        sweep(path, folder=tmp_path / "out")
    assert tracemalloc.get_traced_memory()[1] < 200e6
    tracemalloc.stop()
    assert not (tmp_path / "out").exists() and not (tmp_path / "out.partial").exists()


def test_the_size_grows_with_designs_and_derivatives(tmp_path):
    file = read_sweep(write_grid(tmp_path, (2, 2, 2, 2)))
    problem = file.problem()
    small, large, derived = (sweep_size(problem, file.axes, n, g) for n, g in ((16, False), (1600, False), (16, True)))
    assert large.bytes == pytest.approx(100 * small.bytes) and large.hours == pytest.approx(100 * small.hours)
    assert derived.bytes > 2 * small.bytes and derived.hours == pytest.approx(5 * small.hours)
    assert small.time_text == "" and sweep_size(problem, file.axes, 10**8, False).time_text.endswith(" h")
    require_size(small)
    with pytest.raises(InputError, match="16 designs need"):
        require_size(small, free=small.bytes)


def test_a_grid_has_the_order_of_its_axes():
    axes = [
        Axis("a", "1", 0.0, 1.0, points=3),
        Axis("b", "1", 2.0, 4.0, points=2),
        Axis("c", "1", 1.0, 9.0, values=(5.0, 1.0)),
    ]
    expected = np.array(list(itertools.product(*(axis.grid() for axis in axes))))
    np.testing.assert_array_equal(draw_designs(axes, "grid", 0, 0), expected)
