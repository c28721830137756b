"""Compiling is announced once, and only where it takes long."""

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


def test_what_cannot_be_compiled_now_is_no_failure(monkeypatch, capsys):
    def broken() -> float:
        raise OSError("read-only")

    monkeypatch.setattr(compilation, "compile_kernels", broken)
    assert compilation.compile_now() == 0
    assert "read-only" in capsys.readouterr().err
