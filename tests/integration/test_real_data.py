"""`benchmarks/real_data.py`: what it reads off recordings, and what the simulator says beside it."""

import json
import os
from pathlib import Path

import pytest
import real_data

SHARED = Path(os.environ.get("PIXELID_SHARED", Path(__file__).parents[3] / "shared")) / "recordings"


def test_real_data_without_recordings_says_so(tmp_path, capsys):
    assert real_data.run(tmp_path, tmp_path / "out") == 2
    assert "static_noise_pos_3klux.npy" in capsys.readouterr().err


def test_simulated_leak_is_as_regular_as_its_threshold_and_shot_noise_is_not():
    variation = real_data.regularity(8.0)
    for sigma in (0.02, 0.04, 0.1):
        assert variation[f"leak, threshold noise {sigma:g}"][0] == pytest.approx(sigma, rel=0.15)
    on, off = variation["shot noise 0.003 at 1 fA"]
    assert 0.55 < on < 0.85
    assert 0.55 < off < 0.85


@pytest.mark.skipif(not (SHARED / "dvxplorer_scan.aedat4").exists(), reason="shared recordings absent")
def test_readouts_of_real_recordings(tmp_path, capsys):
    assert real_data.INSPECTIONS["dvxplorer_scan.aedat4"](SHARED, tmp_path) == 0
    assert "timestamp_quantisation.tick_s = 197.28" in capsys.readouterr().out
    assert real_data.INSPECTIONS["davis346_aps.aedat4"](SHARED, tmp_path) == 0
    assert "readout_latency" not in capsys.readouterr().out
    health = json.loads((tmp_path / "davis346_aps" / "inspect.json").read_text())
    assert health["dead_time_s"]["value"] == pytest.approx(0.97e-3, rel=0.05)
    assert health["lines"][0]["frequency_hz"] == pytest.approx(25, abs=0.1)
    assert json.loads((tmp_path / "dvxplorer_scan" / "inspect.json").read_text())["tick_s"] == pytest.approx(
        197.28e-6, rel=1e-4
    )
