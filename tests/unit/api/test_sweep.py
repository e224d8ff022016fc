"""``smajax.sweep``: where it stops."""

import pytest

from smajax.api.sweep import sweep
from smajax.errors import Cancelled
from smajax.recordings.datasets import data_path


@pytest.mark.slow
def test_a_stop_during_the_last_chunk_ends_the_sweep_there(tmp_path):
    shipped = data_path("sweeps", "flexural.toml")
    text = shipped.read_text("utf-8").replace("designs = 256", "designs = 4")
    file = tmp_path / "sweep.toml"
    file.write_text(text.replace('"../', f'"{shipped.parent.parent}/'), "utf-8")

    def stop(event):
        if event.can_stop and event.step == 1:
            raise StopIteration

    with pytest.raises(Cancelled, match=r"^stopped after 1 of 1 chunk; run it again with --resume"):
        sweep(file, folder=tmp_path / "out", progress=stop)
    events = []
    sweep(file, folder=tmp_path / "out", resume=True, progress=events.append)
    assert "refining the best designs" in [event.text for event in events]
