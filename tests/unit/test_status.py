"""The closed list of statuses: names that scripts read, advice, exit codes."""

import doctest
import json

import pytest

import pixelid.status
from pixelid.status import Status

NAMES = ["converged", "misfit", "at_bound", "not_identified", "not_converged", "diverged", "interrupted"]


def test_names_are_the_contract():
    assert [str(status) for status in Status] == NAMES
    assert json.loads(json.dumps(list(Status))) == NAMES


@pytest.mark.parametrize("status", Status)
def test_all_but_converged_fail_and_say_what_to_do(status):
    good = status is Status.converged
    assert status.exit_code == (0 if good else 1)
    assert bool(status.advice) is not good
    assert "\n" not in status.advice


def test_worst_of_several():
    assert Status.worst([]) is Status.converged
    assert Status.worst([Status.at_bound, Status.diverged, Status.converged]) is Status.diverged
    assert {Status.worst([status]) for status in Status} == set(Status)


def test_unknown_names_are_refused():
    with pytest.raises(ValueError, match="done"):
        Status("done")


def test_examples():
    assert doctest.testmod(pixelid.status).failed == 0
