"""Whole sensors: known maps recovered, shrinkage helps, and clusters, deaths and interruptions change nothing."""

import json
import os
import shutil
import subprocess
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pixelid import cluster as cluster_module
from pixelid.cli.main import main
from pixelid.cluster import LOOPBACK, Where, connected, run_tasks
from pixelid.errors import InputError, SetAside, UntrustworthyResult
from pixelid.model.files import save_model
from pixelid.model.shipped import find_model
from pixelid.recordings import write_recording
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import only
from pixelid.sensors import SensorFit, fit_sensor
from pixelid.sensors.shrinkage import population, shrink
from pixelid.simulate import simulate
from pixelid.stimuli import shapes

SIDE = 8


@pytest.fixture(scope="module")
def model():
    """The population: a source follower slow enough to show in little data."""
    return find_model("dvs128").set({"sf_cutoff_hz": 600.0, "threshold_sigma": 0.15})


@pytest.fixture(scope="module")
def sensor(model):
    """(recording, truth by parameter (SIDE, SIDE)) of a sensor whose pixels all differ; some 40 events each."""
    rng = np.random.default_rng(3)
    spreads = {"sf_cutoff_hz": 0.25, "on_threshold": 0.05, "off_threshold": 0.05}
    truth = {n: model.values[n] * np.exp(s * rng.standard_normal((SIDE, SIDE))) for n, s in spreads.items()}
    light = shapes.chirp(400.0, start_hz=50.0, stop_hz=600.0, duration_s=0.03)
    alone = model.without_effect("threshold_mismatch")
    columns = {name: [] for name in "txyp"}
    for pixel in range(SIDE * SIDE):
        y, x = divmod(pixel, SIDE)
        circuit = alone.set({name: float(values[y, x]) for name, values in truth.items()})
        events = simulate(circuit, light, width=1, height=1, seed=pixel, threads=1).events
        for name, column in zip(
            "txyp", (events.t, np.full(len(events), x), np.full(len(events), y), events.p), strict=True
        ):
            columns[name].append(column)
    t, x, y, p = (np.concatenate(columns[name]) for name in "txyp")
    order = np.argsort(t, kind="stable")
    events = Events.from_columns(t[order], x[order], y[order], p[order], SIDE, SIDE, tick_ns=1)
    return Recording(events, light, sensor="test"), truth


@pytest.fixture(scope="module")
def serial(sensor, model):
    return fit_sensor([sensor[0]], model, tile=4, replicates=40)


def test_maps_come_back(serial, tmp_path):
    serial.save(tmp_path / "out")
    again = SensorFit.load(tmp_path / "out")
    assert again.summary() == serial.summary()
    assert again.model == serial.model
    np.testing.assert_array_equal(again.events, serial.events)
    for name, m in serial.maps.items():
        for values in ("raw", "raw_sd", "log", "sd"):
            np.testing.assert_allclose(getattr(again.maps[name], values), getattr(m, values), rtol=1e-9)
        for key, value in m.as_dict().items():
            if key != "unit":
                np.testing.assert_allclose(again.maps[name].as_dict()[key], value, rtol=1e-9)
    (tmp_path / "out" / "maps.npz").unlink()
    with pytest.raises(InputError, match=r"maps\.npz"):
        SensorFit.load(tmp_path / "out")


def test_population_maximises_the_marginal_likelihood():
    rng = np.random.default_rng(8)
    sd = rng.uniform(0.02, 0.2, 300)
    estimate = 8.0 + 0.1 * rng.standard_normal(300) + sd * rng.standard_normal(300)

    def negative(spread):
        total = spread**2 + sd**2
        mean = (estimate / total).sum() / (1.0 / total).sum()
        return 0.5 * (np.log(total).sum() + ((estimate - mean) ** 2 / total).sum() + np.log((1.0 / total).sum()))

    found = population(estimate, sd)
    around = found.spread * np.exp([-1e-3, 0.0, 1e-3])
    low, here, high = map(negative, around)
    assert here < min(low, high)
    assert found.spread == pytest.approx(0.1, rel=0.3)
    assert found.mean == pytest.approx(8.0, abs=0.03)


def test_known_maps_are_recovered_and_shrinkage_lowers_their_error(sensor, serial):
    for name, truth in sensor[1].items():
        m, log = serial.maps[name], np.log(truth)
        pull = ((m.raw - log) / m.raw_sd)[np.isfinite(m.raw)]
        assert 0.7 < pull.std() < 1.4
        assert np.corrcoef(m.log.ravel(), log.ravel())[0, 1] > 0.6
        alone = np.where(np.isfinite(m.raw), m.raw, m.population.mean)
        before, after = (np.sqrt(np.mean((values - log) ** 2)) for values in (alone, m.log))
        assert after < before
        assert m.population.spread == pytest.approx(log.std(), rel=0.4)
        assert m.mean_interval[0] < m.population.mean < m.mean_interval[1]
        assert abs(m.population.mean - log.mean()) < 4 * log.std() / SIDE


def test_population_and_shrinkage_of_known_numbers():
    rng = np.random.default_rng(0)
    sd = rng.uniform(0.05, 0.6, 4000)
    truth = 1.0 + 0.2 * rng.standard_normal(4000)
    seen = truth + sd * rng.standard_normal(4000)
    of = population(np.append(seen, np.nan), np.append(sd, np.inf))
    assert of.count == 4000
    assert of.mean == pytest.approx(1.0, abs=0.02)
    assert of.spread == pytest.approx(0.2, abs=0.02)
    mean, error = shrink(np.append(seen, np.nan), np.append(sd, np.inf), of)
    assert mean[-1] == of.mean
    assert error[-1] == of.spread
    assert np.std((mean[:-1] - truth) / error[:-1]) == pytest.approx(1.0, abs=0.05)
    assert np.mean((mean[:-1] - truth) ** 2) < 0.4 * np.mean((seen - truth) ** 2)


def test_identical_pixels_have_no_spread():
    sd = np.full(200, 0.1)
    of = population(0.3 + 0.05 * np.cos(np.arange(200.0)), sd)
    assert of.spread == 0.0
    assert np.allclose(shrink(np.full(200, 0.3), sd, of)[0], of.mean)


def test_blocks_share_a_bandwidth(sensor, model):
    fit = fit_sensor([sensor[0]], model, block=4, tile=6, replicates=0)
    assert fit.maps["sf_cutoff_hz"].log.shape == (2, 2)
    assert fit.maps["on_threshold"].log.shape == (SIDE, SIDE)
    assert fit.tiles == 1
    assert np.median(fit.maps["sf_cutoff_hz"].raw_sd) < 0.1


@pytest.fixture(scope="module")
def client():
    with connected(Where(workers=2)) as client:
        yield client


def test_a_cluster_gives_the_same_numbers(sensor, model, serial, client):
    where = Where(cluster=client.scheduler.address)
    fit = fit_sensor([sensor[0]], model, tile=4, replicates=40, where=where)
    for name, m in serial.maps.items():
        for field in ("raw", "raw_sd", "log", "sd"):
            assert np.array_equal(getattr(fit.maps[name], field), getattr(m, field), equal_nan=True)
        assert fit.maps[name].spread_interval == m.spread_interval


def test_nothing_listens_beyond_this_computer(client):
    import psutil

    processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
    listening = [c.laddr.ip for p in processes for c in p.net_connections("tcp") if c.status == psutil.CONN_LISTEN]
    assert len(listening) > 3
    assert set(listening) == {"127.0.0.1"}


@pytest.mark.parametrize("where", ["nobody", "someone else", "no workers", "nonsense", "no certificates"])
def test_a_cluster_that_is_none_is_said_within_seconds(where, tmp_path, sensor, capsys, monkeypatch):
    import socket

    from distributed import LocalCluster

    monkeypatch.setattr(cluster_module, "ANSWER_S", 1.0)
    write_recording(sensor[0], tmp_path / "r.h5")
    with socket.socket() as silent, ExitStack() as running:
        silent.bind((LOOPBACK, 0))
        address = {
            "nobody": "tcp://127.0.0.1:1",
            "nonsense": "mail://\x1b[31m",
            "no certificates": "tls://127.0.0.1:1",
        }.get(where)
        if where == "someone else":
            silent.listen()
            address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        elif where == "no workers":
            quiet = {
                "host": LOOPBACK,
                "dashboard_address": f"{LOOPBACK}:0",
                "silence_logs": 50,
            }
            cluster = LocalCluster(1, threads_per_worker=1, processes=False, protocol="tcp", **quiet)
            address = running.enter_context(cluster).scheduler_address
            cluster.scale(0)
            while cluster.scheduler.workers:
                time.sleep(0.05)
        begun = time.monotonic()
        words = ["sensor", str(tmp_path / "r.h5"), "--model", "dvs128", "--out", str(tmp_path / "maps"), "--quiet"]
        assert main([*words, "--cluster", str(address)]) == 2
        assert time.monotonic() - begun < 10.0 + 60.0 * (os.getloadavg()[0] > (os.cpu_count() or 1))
    assert [file.name for file in tmp_path.iterdir()] == ["r.h5"]
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "no workers" in said if where == "no workers" else "no Dask scheduler answers" in said


@pytest.mark.skipif(shutil.which("openssl") is None, reason="makes certificates with openssl")
def test_a_scheduler_that_asks_for_certificates(tmp_path):
    from dask import config
    from distributed import LocalCluster, Security

    for name in ("ours", "others"):
        request = (
            f"openssl req -x509 -newkey rsa:2048 -nodes -keyout {name}.key -out {name}.pem -days 2 -subj /CN={name}"
        )
        subprocess.run(request.split(), cwd=tmp_path, check=True, capture_output=True)

    def files(name):
        return str(tmp_path / "ours.pem"), str(tmp_path / f"{name}.pem"), str(tmp_path / f"{name}.key")

    def configured(name):
        ca, cert, key = files(name)
        tls = {"ca-file": ca, "client.cert": cert, "client.key": key}
        return config.set({f"distributed.comm.tls.{name}": value for name, value in tls.items()})

    ca, certificate, key = files("ours")
    each = {
        f"tls_{who}_{what}": value
        for who in ("scheduler", "worker", "client")
        for what, value in (("cert", certificate), ("key", key))
    }
    security = Security(tls_ca_file=ca, require_encryption=True, **each)
    quiet = {
        "host": LOOPBACK,
        "dashboard_address": f"{LOOPBACK}:0",
        "silence_logs": 50,
        "processes": False,
    }
    with LocalCluster(1, protocol="tls", security=security, **quiet) as cluster:
        with configured("ours"), connected(Where(cluster.scheduler_address)) as client:
            assert [int(r["square"]) for r in run_tasks(_square, 3, lambda i: (i,), client=client)] == [0, 1, 4]
        with configured("others"), pytest.raises(InputError, match="no Dask scheduler answers"):
            connected(Where(cluster.scheduler_address)).__enter__()


def _square(i: int):
    return {"square": np.array(i * i)}


@pytest.mark.parametrize(("status", "says"), [("running", "lost every worker"), ("closed", "no longer answers")])
def test_a_cluster_that_is_lost_is_said(status, says, monkeypatch):
    class Client:
        def __init__(self):
            self.status, self.begun = "running", False

        def nthreads(self):
            return {} if self.begun else {"a": 1}

        def submit(self, function, *arguments, **settings):
            self.begun, self.status = True, status
            return object()

    def nothing_comes(futures, timeout, return_when):
        time.sleep(timeout)
        raise TimeoutError

    monkeypatch.setattr("distributed.wait", nothing_comes)
    monkeypatch.setattr(cluster_module, "WORKERS_S", 0.1)
    monkeypatch.setattr(cluster_module, "LOOK_S", 0.02)
    with pytest.raises(UntrustworthyResult, match=f"{says}.*start the same command again"):
        run_tasks(_square, 2, lambda i: (i,), client=Client())


def _dies_once(i: int, folder: str):
    marker = Path(folder) / "died"
    if i == 3 and not marker.exists():
        marker.touch()
        os._exit(1)
    return {"square": np.array(i * i)}


def test_a_dying_worker_changes_nothing(tmp_path, client):
    results = run_tasks(_dies_once, 8, lambda i: (i, str(tmp_path)), client=client)
    assert (tmp_path / "died").exists()
    assert [int(r["square"]) for r in results] == [i * i for i in range(8)]


def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path, sensor, model, serial):
    keep = tmp_path / "maps.tiles"

    def interrupt(what, fraction):
        if fraction >= 0.45:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit_sensor([sensor[0]], model, tile=4, replicates=40, keep=keep, progress=interrupt)
    kept = {path: path.stat().st_mtime_ns for path in keep.glob("*.npz")}
    assert len(kept) == 2
    fit = fit_sensor([sensor[0]], model, tile=4, replicates=40, keep=keep)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert np.array_equal(fit.maps["on_threshold"].log, serial.maps["on_threshold"].log)


def test_damaged_and_foreign_tiles_are_set_aside_and_computed_again(tmp_path, sensor, model, serial):
    keep = tmp_path / "maps.tiles"
    fit_sensor([sensor[0]], model, tile=4, replicates=0, keep=keep)
    (keep / "0.npz").write_bytes((keep / "0.npz").read_bytes()[:-40])
    (keep / "1.npz").write_bytes((keep / "2.npz").read_bytes())
    with pytest.warns(SetAside) as said:
        fit = fit_sensor([sensor[0]], model, tile=4, replicates=40, keep=keep)
    assert sorted(str(w.message).partition(": ")[2] for w in said if w.category is SetAside) == [
        "belongs to another run; set aside as 1.npz.other, and computed again",
        "is damaged; set aside as 0.npz.damaged, and computed again",
    ]
    assert np.array_equal(fit.maps["on_threshold"].log, serial.maps["on_threshold"].log)
    with pytest.warns(SetAside, match="tiles of another run"):
        fit_sensor([sensor[0]], model, bandwidth="", tile=4, replicates=0, keep=keep)
    assert (tmp_path / "maps.tiles.other" / "0.npz.damaged").is_file()


def test_command_writes_maps(tmp_path, sensor, model, capsys):
    write_recording(sensor[0], tmp_path / "r.h5")
    save_model(model, tmp_path / "camera.toml")
    arguments = ["sensor", str(tmp_path / "r.h5"), "--model", str(tmp_path / "camera.toml"), "--bootstrap", "20"]
    assert main([*arguments, "--out", str(tmp_path / "maps"), "--quiet"]) == 0
    written = json.loads((tmp_path / "maps" / "sensor.json").read_text())
    assert written["maps"]["on_threshold"]["estimates"] > 0.5 * SIDE * SIDE
    assert (tmp_path / "maps" / "on_threshold.svg").stat().st_size > 1000
    with np.load(tmp_path / "maps" / "maps.npz") as maps:
        assert maps["off_threshold"].shape == (SIDE, SIDE)
    assert not (tmp_path / "maps.tiles").exists()
    assert main([*arguments, "--out", str(tmp_path / "maps"), "--quiet"]) == 2
    assert "exists already" in capsys.readouterr().err


def test_events_that_have_nothing_to_do_with_the_light_are_a_misfit(sensor, model):
    rng, mixed = np.random.default_rng(1), []
    for r in [sensor[0]]:
        t = np.sort(rng.integers(int(r.stimulus.start_s * 1e9), int(r.stimulus.end_s * 1e9), len(r.events)))
        mixed.append(replace(r, events=replace(r.events, t=t)))
    found = fit_sensor(mixed, model, replicates=0)
    assert found.status == "misfit"
    assert found.as_dict()["unexplained_fraction"] > 0.05


def test_one_pixel_is_no_population(sensor, model):
    some = [sensor[0]]
    pixel = some[0].events.pixel[0]
    alone = fit_sensor(only(some, np.array([pixel])), model, replicates=0)
    assert alone.status == "not_identified"
    assert set(alone.empty) == set(alone.maps)
