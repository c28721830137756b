"""Files that broke it once, and damaged ones like them, in every command that takes a file."""

import os
import random
from pathlib import Path

import fuzz
import pytest
import replay
from processes import Outcome

SHARED = Path(os.environ.get("PIXELID_SHARED", Path(__file__).parents[3] / "shared")) / "bad_files"


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """What stands beside the files."""
    folder = tmp_path_factory.mktemp("replay") / "here"
    folder.mkdir()
    replay.import_everything()
    replay.prepare(folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("slot", replay.SLOTS, ids=lambda slot: f"{slot.words} {slot.place}")
def test_no_file_breaks_a_command(slot, place, tmp_path):
    """A third of the files that the command expects there, one damaged anew for each, and some of other kinds."""
    chance = random.Random(slot.words)
    files = sorted(SHARED.glob("*/*")) or sorted(replay.DATA.rglob("*.json"))
    meant = [file for file in files if slot.meant_for(file)]
    for file in [*chance.sample(meant, (len(meant) + 2) // 3), *chance.sample(files, 3)]:
        relative = tmp_path / f"relative{file.suffix}"
        relative.write_bytes(fuzz.damaged(file.read_bytes(), chance))
        for tried in (file, relative):
            outcome, said = replay.replay(tried, slot, place)
            assert not said, (file, said)
            assert outcome.code != 2 or outcome.cpu_s < replay.CPU_S, file


def test_the_judge_of_answers_sees_what_is_wrong():
    old = {"good.h5"}
    for code, said, after in (
        (2, "", old),
        (2, "pixelid: a\nb\nc\nd", old),
        (2, "pixelid: a: missing", {"good.h5", "out"}),
        (1, "pixelid: a: missing", old),
        (0, "", {"good.h5", "half"}),
        (1, "pixelid: unexpected OSError; this is a bug", old),
        (-11, "", old),
        (2, "pixelid: \x1b[2J", old),
    ):
        assert replay.complaint(Outcome(code, said, {}), old, after)
    assert not replay.complaint(Outcome(2, "pixelid: a: missing", {}), old, old)
    assert not replay.complaint(Outcome(1, "", {}), old, {"good.h5", "out"})
