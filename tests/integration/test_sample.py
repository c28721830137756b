"""Sampling: convergence measures against known answers, proposals that invert, chains that survive a kill."""

import os
import signal
import subprocess
import sys
import time
from typing import ClassVar

import numpy as np
import pytest

from pixelid.errors import SetAside
from pixelid.fit import fit
from pixelid.model.shipped import find_model
from pixelid.sample import sample
from pixelid.sample.convergence import autocorrelation_time, convergence, nested_r_hat, ranked_nested_r_hat
from pixelid.sample.ensembles import Ensembles
from pixelid.sample.groups import save
from pixelid.sample.proposal import Proposal, shaped
from pixelid.sample.sample import CHUNK, _next_look, _until_converged
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import steps


def test_nested_r_hat_by_hand():
    draws = np.array([[[0.0, 2.0], [1.0, 3.0]], [[4.0, 6.0], [3.0, 5.0]]])
    # superchain means 1.5 and 4.5: B = 4.5; chain variances 2, spread of chain means 0.5 in both: W = 2.5
    assert nested_r_hat(draws) == pytest.approx(np.sqrt(1 + 4.5 / 2.5))


def test_nested_r_hat_tells_agreement_from_disagreement():
    rng = np.random.default_rng(0)
    same = rng.normal(size=(2, 20, 100))
    assert ranked_nested_r_hat(same) < 1.005
    assert ranked_nested_r_hat(same + np.array([0.0, 0.5])[:, None, None]) > 1.01
    assert ranked_nested_r_hat(same * np.array([1.0, 2.0])[:, None, None]) > 1.01  # scale: only folding sees it


def test_autocorrelation_time_of_an_autoregression():
    rng = np.random.default_rng(1)
    x = np.zeros((2000, 20))
    for k in range(1, len(x)):
        x[k] = 0.8 * x[k - 1] + rng.normal(size=20)
    assert autocorrelation_time(x) == pytest.approx(9.0, rel=0.1)  # (1 + 0.8)/(1 − 0.8)


def test_a_stuck_walker_is_not_convergence():
    rng = np.random.default_rng(2)
    chain = rng.normal(size=(2, 100, 8, 1))
    assert convergence(chain).done
    chain[0, :, 0, 0] = 5.0
    assert not convergence(chain).done


def correlated(x):
    """A banana with a funnel in it."""
    return -0.5 * (x[0] ** 2 + ((x[1] - 0.3 * x[0] ** 2) / 0.2) ** 2 + (x[2] / 0.5) ** 2)


def correlated_gradient(x):
    h = 1e-6
    return np.array([(correlated(x + h * e) - correlated(x - h * e)) / (2 * h) for e in np.eye(3)])


def test_a_proposal_follows_a_ridge_and_its_density_is_that_of_its_draws():
    covariance = np.diag([1.0, 0.04, 0.25])
    far = np.full(3, 50.0)
    proposal = shaped(correlated, np.zeros(3), covariance, -far, far, np.ones(3), np.zeros(3), 0, correlated_gradient)
    x = proposal.draw(2000, np.random.RandomState(0))
    ratio = np.array([correlated(point) for point in x]) - proposal.log_density(x)
    weight = np.exp(ratio - ratio.max())
    assert weight.sum() ** 2 / (weight**2).sum() / 2000 > 0.8
    assert np.average(x[:, 0] ** 2, weights=weight) == pytest.approx(1.0, rel=0.1)
    assert np.average(x[:, 1], weights=weight) == pytest.approx(0.3, abs=0.05)


def test_a_funnel_is_undone():
    funnel = Proposal(np.ones(3), np.eye(3), np.ones(3), np.ones(3), np.array([1.0, 0.0, 0.0]), 2)
    x = funnel.draw(4000, np.random.RandomState(1))
    u = np.exp(-(x[:, 2] - 1)) * (x[:, 0] - 1)
    assert u.std() == pytest.approx(x[:, 1].std(), rel=0.1)
    new, factors = funnel.suggest(x, np.random.RandomState(2))
    np.testing.assert_allclose(factors, funnel.log_density(x) - funnel.log_density(new))


ENSEMBLES = """
import sys, time
import numpy as np
from pathlib import Path
from pixelid.sample.ensembles import Ensembles
from pixelid.sample.proposal import Proposal
import pixelid.sample.ensembles as home
home.SAVE_S = 0.0
def target(x):
    time.sleep(float(sys.argv[2]))
    return -0.5 * float(x @ x), np.array([float(x.sum()), 1.0])
proposal = Proposal(np.zeros(2), np.eye(2), np.ones(2), np.ones(2), np.zeros(2), 0)
starts = np.random.RandomState(5).normal(size=(2, 6, 2))
run = Ensembles(target, starts, proposal, 0.5, 3, Path(sys.argv[1]), {"fit": 1})
print("resumed", run.resumed, run.steps, flush=True)
for until in range(10, 41, 10):
    run.advance(until)
run.save()
np.save(sys.argv[1] + ".npy", run.chain())
"""


def test_a_killed_chain_resumes_to_the_same_chain(tmp_path):
    def start(name, pause):
        command = [sys.executable, "-c", ENSEMBLES, str(tmp_path / name), str(pause)]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ)

    whole = start("whole.npz", 0.0)
    killed = start("killed.npz", 0.01)
    deadline = time.monotonic() + 300
    while not (tmp_path / "killed.npz").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(0.3)
    killed.send_signal(signal.SIGKILL)
    assert killed.wait() == -signal.SIGKILL
    assert not (tmp_path / "killed.npz.npy").exists()
    again = start("killed.npz", 0.0)
    output, _ = again.communicate(timeout=400)
    assert whole.wait(timeout=400) == 0
    assert output.startswith("resumed True")
    a, b = np.load(tmp_path / "whole.npz.npy"), np.load(tmp_path / "killed.npz.npy")
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a[0], a[1])  # ensembles have their own random numbers


def test_a_snapshot_that_is_damaged_or_of_another_run_is_set_aside(tmp_path):
    proposal = Proposal(np.zeros(2), np.eye(2), np.ones(2), np.ones(2), np.zeros(2), 0)
    starts = np.random.RandomState(5).normal(size=(2, 6, 2))

    def ensembles(identity=1):
        where, mark = tmp_path / "c.npz", {"fit": identity}
        return Ensembles(lambda x: (-0.5 * float(x @ x), x), starts, proposal, 0.5, 3, where, mark)

    first = ensembles()
    first.samplers[0].run_mcmc(starts[0], 7)  # killed while the first ensemble is ahead of the second
    first.save()
    again = ensembles()
    assert again.resumed
    assert again.steps == 7
    again.advance(20)
    first.advance(20)
    np.testing.assert_array_equal(again.chain(), first.chain())
    np.testing.assert_array_equal(again.pieces(), first.pieces())
    assert again.acceptance() == first.acceptance()
    with pytest.warns(SetAside, match="another run"):
        assert not ensembles(identity=2).resumed
    content = (tmp_path / "c.npz.other").read_bytes()
    for k, damaged in enumerate((content[:-1], content[:1000] + b"\xff" * 9 + content[1009:], b"nothing", b"")):
        (tmp_path / "c.npz").write_bytes(damaged)
        with pytest.warns(SetAside, match="damaged"):
            assert not ensembles().resumed
        assert (tmp_path / f"c.npz.damaged{k + 1 if k else ''}").read_bytes() == damaged


def test_a_resumed_run_looks_where_the_first_would_have():
    looks = [CHUNK]
    while looks[-1] < 4000:
        looks.append(_next_look(looks[-1], 4000))

    class Run:
        steps = 137
        seen: ClassVar[list[int]] = []

        def advance(self, until):
            self.seen.append(until)
            raise StopIteration

    with pytest.raises(StopIteration):
        _until_converged(Run(), 1000, 4000, None)  # type: ignore[arg-type]
    assert Run.seen == [next(look for look in looks if look >= 137)]


@pytest.fixture(scope="module")
def two_thresholds():
    """A small recording and a fit of its two thresholds and their noise."""
    model = find_model("dvs128").without_effect("threshold_mismatch").set({"on_threshold": 0.2, "off_threshold": 0.3})
    recording = simulate(model, steps(level=100.0, duration_s=0.3, dt=2e-4), width=2, height=2, seed=4)
    held = {n: None for n in model.free if n not in ("on_threshold", "off_threshold", "threshold_sigma")}
    return [recording], fit([recording], model.fix(held), starts=0, between="linear")


def test_posterior_of_a_small_fit(two_thresholds, tmp_path):
    recordings, result = two_thresholds
    posterior = sample(result, recordings, seed=2, wanted=400)
    assert posterior.status == "converged"
    assert posterior.convergence.done
    assert posterior.convergence.effective.min() > 400
    for name, row in posterior.statistics().items():
        estimate = result.estimates[name]
        assert abs(row["mean"] - estimate.value) < estimate.std
        assert row["sd"] == pytest.approx(estimate.std, rel=0.35)
    total = posterior.pieces[..., :2].sum(axis=-1)  # one recording, and the thresholds
    np.testing.assert_allclose(posterior.pieces[..., 2:].sum(axis=-1), total, rtol=1e-9)
    np.testing.assert_allclose(total, posterior.log_prob, rtol=1e-9)
    said = save(posterior, result, recordings, tmp_path)
    assert said["status"] == "converged"
    import xarray
    from arviz_stats import ess, rhat

    data = xarray.open_datatree(tmp_path / "posterior.nc", engine="h5netcdf").load()
    groups = {"posterior", "sample_stats", "log_likelihood", "posterior_predictive", "observed_data"}
    assert groups <= set(data.children)
    assert set(ess(data).data_vars) == set(rhat(data).data_vars) == set(posterior.coordinates.names)
    observed = int(data.observed_data.on_events.sum())
    assert observed == int((recordings[0].events.p == 1).sum())
    predicted = data.posterior_predictive.on_events.values
    assert abs(predicted.mean() - observed) < 0.2 * observed
    assert {"corner.svg", "trace.svg"} <= {path.name for path in tmp_path.iterdir()}


def test_physical_values_follow_the_gauge(two_thresholds):
    recordings, result = two_thresholds
    physical = sample(result, recordings, seed=2, wanted=50, max_steps=10).physical(result.model, 20)
    np.testing.assert_allclose(physical["q_in"], 0.875)
    np.testing.assert_allclose(physical["A_loop"], 0.7 * physical["A_amp"])
