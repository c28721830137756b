"""Results reach disk whole or not at all: overwriting, claims, left-overs of the dead, and disks that fail."""

import errno
import json
import os
import re
import stat
import subprocess
import sys
import tempfile

import numpy as np
import pytest

from pixelid import outputs
from pixelid.errors import InputError, OutputError, SetAside
from pixelid.outputs import claimed, refuse_inputs, whole_file, whole_folder, write_json


def result(folder, value=1):
    """A folder with a result of ours."""
    folder.mkdir()
    write_json(folder / "fit.json", {"value": value})
    return folder


def contents(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def replace_with(path, value):
    with whole_folder(path, overwrite=True) as folder:
        write_json(folder / "fit.json", {"value": value})
        (folder / "sub").mkdir()
        (folder / "sub" / "more.txt").write_text("more")


# --- what may be replaced ---------------------------------------------------------------------------------------


def test_a_result_is_replaced_and_nothing_is_left_beside_it(tmp_path):
    out = result(tmp_path / "out")
    (out / "old.txt").write_text("old")
    replace_with(out, 2)
    assert json.loads((out / "fit.json").read_text()) == {"value": 2}
    assert not (out / "old.txt").exists()
    assert os.listdir(tmp_path) == ["out"]


@pytest.mark.parametrize("name", ["events.h5", "notes.txt", "fit.json"])
def test_a_folder_of_something_else_is_never_replaced(name, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / name).write_text("precious")
    with pytest.raises(InputError, match="only a result of pixelid"):
        replace_with(out, 2)
    assert contents(tmp_path) == {f"out/{name}": b"precious"}


def test_a_file_is_not_replaced_by_a_folder_nor_a_folder_by_a_file(tmp_path):
    (tmp_path / "file").write_text("precious")
    with pytest.raises(InputError, match="found a file"), whole_folder(tmp_path / "file", overwrite=True):
        pass
    with pytest.raises(InputError, match="found a folder"), whole_file(result(tmp_path / "out"), overwrite=True):
        pass
    assert (tmp_path / "file").read_text() == "precious"


@pytest.mark.parametrize("replaced", [claimed, whole_file])
def test_a_pipe_is_not_replaced_by_a_file(replaced, tmp_path):
    """Nor a device: whoever runs as root and writes to /dev/null would leave the machine without it."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="found a device or a pipe"), replaced(pipe, overwrite=True):
        pass
    assert stat.S_ISFIFO(pipe.stat().st_mode)


def test_a_link_keeps_pointing_at_the_folder_that_is_replaced(tmp_path):
    out = result(tmp_path / "real")
    (tmp_path / "link").symlink_to(out)
    replace_with(tmp_path / "link", 2)
    assert (tmp_path / "link").is_symlink()
    assert json.loads((out / "fit.json").read_text()) == {"value": 2}


def test_inputs_are_never_replaced(tmp_path):
    out = result(tmp_path / "out")
    (out / "steps.h5").write_text("events")
    for given in (out / "steps.h5", out, tmp_path / "out" / ".." / "out" / "steps.h5"):
        with pytest.raises(InputError, match="would replace the input"):
            refuse_inputs(out, [given])
    refuse_inputs(out, [tmp_path / "elsewhere.h5", tmp_path])


def test_a_folder_of_links_to_inputs_counts_as_inputs(tmp_path):
    out = result(tmp_path / "out")
    (out / "steps.h5").write_text("events")
    (tmp_path / "session").mkdir()
    (tmp_path / "session" / "a.h5").symlink_to(out / "steps.h5")
    with pytest.raises(InputError, match="would replace the input"):
        refuse_inputs(out, [tmp_path / "session"])


def test_inspect_does_not_delete_what_it_inspects(tmp_path, capsys):
    from pixelid.cli.main import main
    from pixelid.recordings import Events, Recording, write_recording

    out = result(tmp_path / "s2")
    write_recording(Recording(Events.empty(2, 2)), out / "steps.h5")
    before = contents(tmp_path)
    assert main(["inspect", str(out / "steps.h5"), "--out", str(out), "--overwrite"]) == 2
    assert "would replace the input" in capsys.readouterr().err
    assert contents(tmp_path) == before


# --- two runs, and the dead -------------------------------------------------------------------------------------


def test_a_second_run_on_the_same_target_is_refused(tmp_path):
    out = tmp_path / "out"
    code = f"from pixelid.outputs import claimed\nwith claimed({str(out)!r}):\n    print('in', flush=True)\n    input()"
    with subprocess.Popen([sys.executable, "-c", code], stdin=-1, stdout=-1, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "in\n"
        with pytest.raises(InputError, match=f"another run \\(process {other.pid} on"), claimed(out):
            pass
        other.communicate("\n")
    with claimed(out):
        pass
    assert os.listdir(tmp_path) == []


def test_a_killed_run_blocks_nobody_and_its_left_overs_go(tmp_path):
    out = result(tmp_path / "out")
    code = (
        "import os\nfrom pixelid.outputs import claimed, whole_folder\n"
        f"with claimed({str(out)!r}, True), whole_folder({str(out)!r}, True) as folder:\n"
        "    (folder / 'half').write_text('half')\n    os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == -9
    assert len(list(tmp_path.glob(".out.*.tmp"))) == 1
    with claimed(out, True):
        replace_with(out, 2)
    assert os.listdir(tmp_path) == ["out"]
    assert json.loads((out / "fit.json").read_text()) == {"value": 2}


def test_what_appears_meanwhile_is_kept_and_temporaries_of_the_living_stay(tmp_path):
    def overtaken():
        with whole_folder(tmp_path / "out") as folder:
            (folder / "fit.json").write_text("{}")
            with whole_folder(tmp_path / "out") as faster:
                (faster / "a").write_text("a")
            assert folder.is_dir()

    with pytest.raises(InputError, match="exists already"):
        overtaken()
    assert contents(tmp_path) == {"out/a": b"a"}


def test_an_interruption_leaves_the_old_result(tmp_path):
    out = result(tmp_path / "out")
    before = contents(tmp_path)

    def interrupted():
        with whole_folder(out, True) as folder:
            (folder / "half").write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert contents(tmp_path) == before
    assert os.listdir(tmp_path) == ["out"]


# --- disks that fail --------------------------------------------------------------------------------------------


FAULTS = {code: os.strerror(code) for code in (errno.ENOSPC, errno.EIO, errno.EROFS, errno.EACCES, errno.EDQUOT)}


@pytest.mark.parametrize("code", FAULTS, ids=lambda code: errno.errorcode[code])
@pytest.mark.parametrize("at_once", [True, False], ids=["exchange", "two renames"])
@pytest.mark.parametrize("step", ["mkdtemp", "fsync", "rename", "second rename", "last fsync"])
def test_a_fault_at_any_step_is_one_line_and_the_old_result_stays(step, at_once, code, tmp_path, monkeypatch):
    out = result(tmp_path / "out")
    before = contents(tmp_path)
    calls = []

    def fail(*args, **options):
        raise OSError(code, os.strerror(code), str(args[0]) if args and not isinstance(args[0], int) else None)

    def fail_second(*args):
        calls.append(args)
        return fail(*args) if len(calls) == 2 else real(*args)

    real = os.rename
    if not at_once:
        monkeypatch.setattr(outputs, "_exchange_at_once", lambda new, old: False)
    if step == "mkdtemp":
        monkeypatch.setattr("tempfile.mkdtemp", fail)
    elif step == "fsync":
        monkeypatch.setattr(os, "fsync", fail)
    elif step == "last fsync":  # the folder's, when the new result is in place
        flush = outputs._flush
        monkeypatch.setattr(outputs, "_flush", lambda path: fail(path) if path == tmp_path else flush(path))
    elif step == "rename":
        monkeypatch.setattr(outputs, "_exchange_at_once", fail) if at_once else monkeypatch.setattr(os, "rename", fail)
    elif at_once:
        pytest.skip("there is only one rename")
    else:
        monkeypatch.setattr(os, "rename", fail_second)
    with pytest.raises(OutputError) as caught:
        replace_with(out, 2)
    monkeypatch.undo()
    assert str(caught.value) == f"{out}: cannot be written ({FAULTS[code]}); what was there before is unchanged"
    assert contents(tmp_path) == before
    assert os.listdir(tmp_path) == ["out"]


@pytest.mark.parametrize("there", [True, False])
def test_a_file_whose_entry_cannot_be_flushed_is_as_before(there, tmp_path, monkeypatch):
    if there:
        (tmp_path / "rec.h5").write_text("old")
    before, flush = contents(tmp_path), outputs._flush

    def fail(path):
        if path == tmp_path:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        flush(path)

    monkeypatch.setattr(outputs, "_flush", fail)
    with pytest.raises(OutputError, match="unchanged"), whole_file(tmp_path / "rec.h5", True) as path:
        path.write_text("new")
    assert contents(tmp_path) == before
    assert os.listdir(tmp_path) == (["rec.h5"] if there else [])


@pytest.mark.parametrize("code", FAULTS, ids=lambda code: errno.errorcode[code])
def test_a_write_that_fails_is_said_of_the_target(code, tmp_path):
    (tmp_path / "rec.h5").write_text("old")
    with pytest.raises(OutputError, match=r"rec\.h5: cannot be written"), whole_file(tmp_path / "rec.h5", True):
        raise OSError(code, os.strerror(code))
    assert contents(tmp_path) == {"rec.h5": b"old"}


def test_an_input_that_cannot_be_read_is_not_blamed_on_the_output(tmp_path):
    with pytest.raises(FileNotFoundError), whole_folder(tmp_path / "out"):
        (tmp_path / "gone.h5").read_bytes()
    assert os.listdir(tmp_path) == []


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_full_disk_is_one_line(tmp_path):
    def fill():
        with whole_file(tmp_path / "a.json") as path:
            path.symlink_to("/dev/full")
            write_json(path, {"value": list(range(100_000))})

    with pytest.raises(OutputError, match="No space left on device"):
        fill()
    assert os.listdir(tmp_path) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write anywhere")
def test_a_read_only_folder_is_one_line(tmp_path):
    tmp_path.chmod(0o555)
    with pytest.raises(OutputError, match="Permission denied"), whole_folder(tmp_path / "out"):
        pass


# --- files that nobody should trust -----------------------------------------------------------------------------


def test_a_folder_that_takes_no_temporary_is_said_of_the_target(tmp_path, monkeypatch):
    """As a read-only file system refuses it, where nothing has claimed the folder before: a page written anew."""

    def refused(prefix, suffix, dir):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), f"{dir}/{prefix}{suffix}")

    monkeypatch.setattr(tempfile, "mkdtemp", refused)
    words = f"{tmp_path / 'report.html'}: cannot be written (Read-only file system)"
    with pytest.raises(OutputError, match=re.escape(words)), whole_file(tmp_path / "report.html"):
        pass


def test_a_marker_that_is_no_json_object_marks_nothing(tmp_path):
    for k, make in enumerate(
        (
            lambda path: os.mkfifo(path),
            lambda path: path.symlink_to("/dev/zero"),
            lambda path: path.write_text("[" * 100_000),
            lambda path: path.write_text("9" * 5000),
            lambda path: path.mkdir(),
        )
    ):
        folder = tmp_path / str(k)
        folder.mkdir()
        make(folder / "fit.json")
        with pytest.raises(InputError, match="replaces only a result"):
            outputs.refuse_existing(folder, overwrite=True)


def test_a_lock_that_is_a_link_is_not_followed(tmp_path):
    (tmp_path / "precious").write_text("precious")
    (tmp_path / ".out.lock").symlink_to("precious")
    with pytest.raises(OutputError), claimed(tmp_path / "out"):
        pass
    assert (tmp_path / "precious").read_text() == "precious"


def test_the_page_of_a_folder_is_not_written_through_a_link(tmp_path):
    from pixelid.report.html import write_report

    (tmp_path / "precious").write_text("precious")
    folder = result(tmp_path / "fit")
    (folder / "report.html").symlink_to(tmp_path / "precious")
    with pytest.raises(InputError, match="link"):
        write_report(folder)
    assert (tmp_path / "precious").read_text() == "precious"


@pytest.mark.parametrize("most", [3000, 20_000])
def test_hdf5_survives_a_disk_that_fills_up(most, tmp_path):
    """A limit on the size of files stands for the disk: HDF5 itself would crash on either."""
    run = (
        "import resource, sys\nfrom pixelid.cli.main import main\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({most}, {most}))\nsys.exit(main(sys.argv[1:]))"
    )
    words = ["convert", str(tmp_path / "a.npz"), str(tmp_path / "b.h5")]
    from pixelid.recordings import Events, Recording, open_recording, write_recording

    n = 20_000
    t = np.arange(n) * 1_000_003
    events = Events.from_columns(t, np.arange(n) * 7919 % 640, np.arange(n) * 104729 % 480, t % 2, 640, 480)
    write_recording(Recording(events), tmp_path / "a.npz")
    done = subprocess.run([sys.executable, "-c", run, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    assert "cannot be written" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]
    write_recording(Recording(events), tmp_path / "b.h5")
    assert np.array_equal(open_recording(tmp_path / "b.h5").events.t, t)


def test_a_run_killed_between_two_renames_has_lost_nothing(tmp_path):
    """Where the system cannot swap folders the old result lies in the temporary folder for a moment."""
    dead = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True)
    left = tmp_path / f"{outputs._prefix(tmp_path / 'out', int(dead.stdout))}x.tmp"
    left.mkdir()
    result(left / f"out{outputs.OLD}", 1)
    with pytest.raises(InputError, match="exists already"), whole_folder(tmp_path / "out"):
        pass
    assert json.loads((tmp_path / "out" / "fit.json").read_text()) == {"value": 1}
    assert os.listdir(tmp_path) == ["out"]


def test_what_an_earlier_run_kept_is_set_aside_under_a_name_that_is_free(tmp_path):
    for k in range(3):
        (tmp_path / "kept").write_text(str(k))
        with pytest.warns(SetAside, match="is damaged"):
            outputs.set_aside(tmp_path / "kept", "is damaged", "damaged")
    assert contents(tmp_path) == {"kept.damaged": b"0", "kept.damaged2": b"1", "kept.damaged3": b"2"}
