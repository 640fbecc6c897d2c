"""README's Python example runs as it is printed, and its room is lit as a closed form says."""

import re
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.thorough

README = Path(__file__).resolve().parents[2] / "README.md"


def examples() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", README.read_text("utf-8"), re.MULTILINE | re.DOTALL)


def test_the_python_example_runs_as_printed(tmp_path, monkeypatch, capsys):
    code, _ = examples()
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(code, README.name, "exec"), names)
    assert (tmp_path / "room.npz").exists()
    out = capsys.readouterr().out
    assert out.startswith("error 0.0")
    (told,) = re.findall(r"^It prints `error ([\d.]+), mean ([\d.]+) W/m²`", README.read_text("utf-8"), re.MULTILINE)
    found = re.fullmatch(r"error ([\d.]+), mean ([\d.]+) W/m²\n", out).groups()
    assert abs(float(found[0]) - float(told[0])) < 0.005 and abs(float(found[1]) - float(told[1])) < 0.05
    baked, image, lamp = names["baked"], names["image"], names["lamp"]
    assert image.shape == (128, 128, 4) and image.dtype == np.float32
    assert baked.report["error"] < 0.1 and not baked.report["warnings"]
    # whatever the lamp's place, its power meets the walls: bounces are P / A × ρ / (1 − ρ) in all
    assert np.isclose(image[baked.own][:, :3].mean(), lamp.power[0] / 24 * 0.8 / 0.2, rtol=0.03)


def test_the_example_of_penumbrae_runs_as_printed(capsys):
    _, code = examples()
    names = {}
    exec(compile(code, README.name, "exec"), names)
    seen, place = names["masks"].seen(), names["place"]
    # the sheet is half as high as the lamp and half as wide, and twice as wide as its umbra on the floor
    assert (seen[np.abs(place[:, 0]) < 0.5] == 0).all() and (seen[np.abs(place[:, 0]) > 1.5] == 1).all()
    assert np.isclose(np.interp(0.75, place[:, 0], seen), 0.25, atol=0.3)
    assert capsys.readouterr().out.count("]") == 2
