"""A circuit with other numbers: what `dataclasses.replace` would make, and no field that a circuit lacks."""

from dataclasses import replace

import pytest

from pixelid.model.shipped import find_model
from pixelid.stages.circuit import Circuit

CHANGES = {"leak_hz": 2.0, "tick": 1e-6, "photoreceptor": "unlimited"}


def test_with_is_replace():
    circuit = find_model("dvs128").circuit()
    before = dict(vars(circuit))
    changed = circuit.with_(**CHANGES)
    assert changed == replace(circuit, **CHANGES)
    assert hash(changed) == hash(replace(circuit, **CHANGES))
    assert vars(circuit) == before
    assert isinstance(changed, Circuit)


def test_a_field_that_a_circuit_lacks():
    with pytest.raises(TypeError, match="no leek_hz"):
        find_model("dvs128").circuit().with_(leek_hz=2.0)


def test_numbers_of_a_recording():
    circuit = find_model("dvs128").circuit().with_(of_recordings=(("dark", (("leak_hz", 3.0),)),))
    assert circuit.in_recording("dark") == replace(circuit, of_recordings=(), leak_hz=3.0)
    assert circuit.in_recording("other") == replace(circuit, of_recordings=())
