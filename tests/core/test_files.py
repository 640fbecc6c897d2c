"""Files appear whole or not at all, whatever goes wrong."""

import os

import pytest
from lightpanes.core.files import filling, replacing


def contents(folder):
    return {path.name: path.read_text() if path.is_file() else None for path in folder.iterdir()}


def test_replacing(tmp_path):
    path = tmp_path / "light.exr"
    path.write_text("old")
    with replacing(path) as temporary:
        assert temporary.suffix == ".exr" and temporary.parent == tmp_path
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert contents(tmp_path) == {"light.exr": "new"}


@pytest.mark.parametrize("written", [False, True])
def test_replacing_that_fails(tmp_path, written):
    path = tmp_path / "light.exr"
    path.write_text("old")
    with pytest.raises(ZeroDivisionError), replacing(path) as temporary:
        if written:
            temporary.write_text("half")
        raise ZeroDivisionError
    assert contents(tmp_path) == {"light.exr": "old"}


def test_filling(tmp_path):
    folder = tmp_path / "new" / "out"
    with filling(folder) as stage:
        (stage / "a").write_text("a")
        (stage / "b").write_text("b")
        assert [path.name for path in folder.iterdir()] == [stage.name]
    assert contents(folder) == {"a": "a", "b": "b"}


def test_filling_moves_the_last_one_last(tmp_path, monkeypatch):
    moved, replace = [], os.replace
    monkeypatch.setattr(os, "replace", lambda a, b: (moved.append(os.path.basename(b)), replace(a, b)))
    with filling(tmp_path, last="b") as stage:
        for name in "cba":
            (stage / name).write_text(name)
    assert moved == ["a", "c", "b"]


@pytest.mark.parametrize("fails", range(5))
def test_filling_that_fails(tmp_path, monkeypatch, fails):
    """At whichever move: the first file of a name that was there, or its place, or the next."""
    (tmp_path / "a").write_text("old a")
    (tmp_path / "c").write_text("old c")
    before, moves, replace = contents(tmp_path), [0], os.replace

    def failing(source, target):
        moves[0] += 1
        if moves[0] == fails + 1:
            raise OSError(28, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(os, "replace", failing)
    with pytest.raises(OSError, match="No space left"), filling(tmp_path) as stage:
        for name in "abc":
            (stage / name).write_text("new")
    assert contents(tmp_path) == before


def test_filling_a_folder_that_did_not_exist(tmp_path):
    with pytest.raises(ZeroDivisionError), filling(tmp_path / "out") as stage:
        (stage / "a").write_text("a")
        raise ZeroDivisionError
    assert not (tmp_path / "out").exists()


def test_filling_over_a_folder(tmp_path):
    """It is the user's, and stays with all that it holds."""
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "mine").write_text("mine")
    (tmp_path / "a").write_text("old")
    with pytest.raises(OSError), filling(tmp_path) as stage:
        (stage / "a").write_text("new")
        (stage / "b").write_text("new")
    assert contents(tmp_path) == {"a": "old", "b": None} and (tmp_path / "b" / "mine").exists()
