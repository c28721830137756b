"""Compiling is announced once, and only where it takes long; what cannot be compiled is no failure."""

from types import SimpleNamespace

import pytest
from numba import njit

from pixelid import compilation


def compiled() -> int:
    """Compile two kernels, the second of which compiles a third."""

    @njit
    def inner(x):
        return x + 1

    @njit
    def outer(x):
        return inner(x) * 2

    return int(inner(1.0)) + int(outer(3))


def test_long_compiling_is_announced_once(monkeypatch):
    monkeypatch.setattr(compilation, "NOTICEABLE_S", 0.0)
    said: list[str] = []
    with compilation.announced(said.append):
        assert compiled() == 10
    assert said == [compilation.SENTENCE]
    compiled()
    assert len(said) == 1


def test_short_compiling_is_not_announced(monkeypatch):
    monkeypatch.setattr(compilation, "NOTICEABLE_S", 1e9)
    said: list[str] = []
    with compilation.announced(said.append):
        compiled()
    assert said == []


@pytest.mark.parametrize(("beside", "told"), [(0, "compiled for reconstruct, in"), (1, "")])
def test_what_cannot_be_compiled_now_is_no_failure(beside, told, monkeypatch, capsys):
    def broken() -> None:
        raise OSError("read-only")

    monkeypatch.setattr(compilation, "compile_kernels", broken)
    monkeypatch.setattr(compilation.subprocess, "Popen", lambda words: SimpleNamespace(wait=lambda: beside))
    assert compilation.compile_now() == 0
    said = capsys.readouterr()
    assert "read-only" in said.err
    assert said.out.startswith(told)
    assert bool(said.out) == bool(told)


def test_the_second_process_says_what_it_cannot_compile(monkeypatch, capsys):
    def broken() -> None:
        raise OSError("read-only")

    monkeypatch.setattr(compilation, "compile_reconstruction", broken)
    assert compilation.compile_beside() == 1
    assert "reconstruct is not compiled now (read-only)" in capsys.readouterr().err
