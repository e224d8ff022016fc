"""The diagnosis: its statistics on made-up numbers, and the whole command on truth from the exact reference."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from smajax.cli import app
from smajax.datasets import shipped
from smajax.diagnose import score
from smajax.rig import read_rig
from tests.reference.rig_file import read_channel, read_csv, simulate
from tests.reference.rig_file import read_rig as reference_rig

SECONDS = 50.0


def test_a_score_finds_a_planted_strength_beside_what_is_absorbed():
    rng = np.random.default_rng(1)
    jacobian, column = rng.standard_normal((400, 3)), rng.standard_normal(400)
    residual = -(jacobian @ [1.0, -2.0, 0.5]) - 0.7 * column + 1e-3 * rng.standard_normal(400)
    q = score.basis(jacobian)
    one = score.score(q, score.project(q, residual), column, (-3.0, 3.0))
    assert one.strength == pytest.approx(0.7, abs=1e-3)
    clipped = score.score(q, score.project(q, residual), column, (-3.0, 0.0))
    assert clipped.strength == clipped.gain == 0.0
    assert score.score(q, score.project(q, residual), jacobian @ [1.0, 1.0, 1.0], (-3.0, 3.0)).absorbed > score.ABSORBED


def test_false_alarms_stay_at_their_rate():
    """The simulated maximum holds its level for correlated, partly one-sided columns."""
    rng = np.random.default_rng(2)
    shared = rng.standard_normal((300, 1))
    columns = {f"{k}": c for k, c in enumerate((0.8 * shared + 0.6 * rng.standard_normal((300, 6))).T)}
    plausible = {k: (0.0, 9.0) if int(k) % 2 else (-9.0, 9.0) for k in columns}
    empty = np.zeros((300, 0))
    alarms = 0
    for _ in range(200):
        noise = rng.standard_normal(300)
        gain = max(score.score(empty, noise, c, plausible[k]).gain for k, c in columns.items())
        alarms += score.p_value(columns, plausible, gain, seed=3, draws=1000) < 0.05
    assert 2 <= alarms <= 22


def test_classes_are_linked_by_their_cosines():
    base = np.random.default_rng(0).standard_normal((200, 3))
    columns = {"a": base[:, 0], "b": base[:, 0] + 0.1 * base[:, 1], "c": base[:, 2]}
    assert sorted(map(sorted, score.classes(columns))) == [["a", "b"], ["c"]]


@pytest.fixture(scope="module")
def hidden(tmp_path_factory) -> Path:
    """Recordings of a wire with latent heat that its rig file does not have, by the exact reference simulator."""
    folder = tmp_path_factory.mktemp("hidden")
    source = shipped("recordings", "dead-weight")
    (folder / "rig.toml").write_text((source / "rig.toml").read_text("utf-8"))
    rig = reference_rig(source / "rig.toml").changed(h0=1.05, capacity=0.97, austenite_shift=1.0)
    rig = rig.__class__(**{**rig.__dict__, "heat": rig.heat._replace(latent_heat=5e7)})
    for k, part in enumerate(("train", "select", "holdout")):
        channels = read_csv(source / f"{part}.csv")
        count = int(np.sum(channels["time"] <= SECONDS))
        channels = {name: column[:count] for name, column in channels.items()}
        lifted = read_channel(simulate(rig, channels, substeps=20), "displacement") * 1e3
        lifted += np.random.default_rng(k).normal(0.0, 0.02, count)
        table = np.column_stack([channels["time"], channels["current"], lifted])
        np.savetxt(folder / f"{part}.csv", table, delimiter=",", header="time [s],current [A],displacement [mm]", comments="", fmt="%.6f")
    return folder


def test_hidden_latent_heat_is_named_and_the_rig_with_it_predicts_to_the_noise(hidden):
    words = [str(hidden / name) for name in ("rig.toml", "train.csv")]
    words += ["--select", str(hidden / "select.csv"), "--holdout", str(hidden / "holdout.csv"), "--out", str(hidden / "out"), "--quiet"]
    result = CliRunner().invoke(app, ["diagnose", *words])
    assert result.exit_code == 0, result.output
    document = json.loads((hidden / "out" / "diagnosis.json").read_text("utf-8"))
    assert document["effects"] == ["latent-heat"]
    assert document["verdict"] in ("named", "named-up-to-class")
    rmse = document["rmse"]["displacement"]
    assert rmse["holdout_after"] < 0.022 < 3 * 0.022 < rmse["holdout_before"]
    assert rmse["holdout_cut_95"][0] > 0.0
    entry = next(r for r in document["ranking"] if r["key"] == "latent-heat")
    assert entry["strength"] == pytest.approx(5e7, rel=0.02)
    assert entry["refit_rmse_select"] < 0.022
    assert entry["lower95"] < entry["strength"] < entry["upper95"]
    assert {r["key"] for r in document["ranking"]} >= {"coating", "encoder-gain", "quantisation"}
    assert read_rig(hidden / "out" / "rig-diagnosed.toml").plant.effects[0].key == "latent-heat"
    assert "latent-heat" in (hidden / "out" / "report.html").read_text("utf-8")
    assert CliRunner().invoke(app, ["report", str(hidden / "out")]).exit_code == 0


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("train", "train", "holdout"), "given twice"),
        (("train", "copy", "holdout"), "same content"),
        (("short", "select", "holdout"), "too few"),
    ],
)
def test_recordings_that_test_nothing_are_refused(hidden, names, said):
    (hidden / "copy.csv").write_bytes((hidden / "train.csv").read_bytes())
    (hidden / "short.csv").write_text("\n".join((hidden / "train.csv").read_text().splitlines()[:60]))
    train, select, holdout = (str(hidden / f"{name}.csv") for name in names)
    words = [
        "diagnose",
        str(hidden / "rig.toml"),
        train,
        "--select",
        select,
        "--holdout",
        holdout,
        "--out",
        str(hidden / "never"),
        "--quiet",
    ]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert said in result.stderr
