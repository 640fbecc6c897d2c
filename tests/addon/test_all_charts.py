"""The page of all samples' charts: what its head says, and which samples a run measures."""

import html.parser
import io
import json

import pytest

pytest.importorskip("bpy")
pytest.importorskip("matplotlib")
Image = pytest.importorskip("PIL.Image")

from lightpanes.addon import chart, chart_page  # noqa: E402

from ..bench import all_charts, bench_charts  # noqa: E402


def point(error, bake, relight=0.01, **more):
    more = more or {"entries": 100, "rays": 1, "bytes": 1}
    return {"error": error, "errors": [error], "bake_s": bake, "relight_s": relight, **more}


def report(scene="one"):
    ours = [point(0.1, 2.0), point(0.04, 6.0)]
    return {
        "date": "2026-01-02",
        "machine": "a machine",
        "versions": "versions",
        "load": 1.0,
        "scene": scene,
        "resolution": 128,
        "triangles": 12,
        "error": "of something",
        "reference_spp": [64],
        "reference_noise": [0.01],
        "lamps": [{"kind": "far", "place": [0, 0, 0], "room_m": 1.0}],
        "methods": {
            "Cycles": [point(0.5, 0.2, 0.2, spp=1), point(0.03, 9.0, 9.0, spp=256)],
            "The paper's method": [point(0.3, 8.0)],
            "Lightpanes": ours,
        },
        "default": ours[-1],
        "by_hand": point(0.04, 4.0),
        "studies": {},
        "notes": ["something was left out"],
    }


class Checker(html.parser.HTMLParser):
    """Every element that is opened is closed, in order."""

    def __init__(self, page):
        super().__init__()
        self.open, self.wrong = [], []
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)


def test_head_of_the_page():
    none = report("none")
    none["methods"]["Cycles"] = [point(0.5, 0.2, 0.2, spp=1)]
    none["by_hand"] = point(0.04, 7.0)
    none["load"] = 7.5
    page = chart_page.page([report(), none], [[], []])
    found = Checker(page)
    assert found.wrong == [] and found.open == []
    head = page[: page.index("<h2")]
    assert 'name="viewport"' in head and "errs by 4.0 % and takes 6 s" in head and "takes 10 ms" in head
    cells = "<tr><td>{}</td><td>128²</td><td>4.0 %</td><td>6 s</td><td>10 ms</td><td>{}</td><td>{} ×</td></tr>"
    assert cells.format("one", "9 s", "1.50") in head
    assert cells.format("none", "more than 0.2 s", "1.00") in head
    assert page.count("a load of 7.5") == 1 and head.count("a machine") == 1
    assert "a load of up to 7.5" in head and "load" not in chart_page.page([report()], [[]]).split("<script")[0]


def test_head_without_a_default_bake():
    one = report()
    del one["default"], one["by_hand"]
    page = chart_page.page([one], [[]])
    assert "default settings" not in page and Checker(page).wrong == []


def test_rows_of_the_bench(monkeypatch):
    monkeypatch.setattr(all_charts, "read", lambda: [report("cornell")])
    rows = {row["row"].split(",")[1].split(":")[0].strip(): row for row in bench_charts.rows()}
    assert rows["cornell"]["value"] == pytest.approx(1.5) and rows["cornell"]["ok"]
    assert not rows["stairs"]["ok"]


@pytest.fixture
def measured(tmp_path, monkeypatch):
    """Names of the samples that were measured; nothing is, really."""
    names = []

    def measure(context, *arguments):
        name = chart.bpy.path.display_name_from_filepath(context.blend_data.filepath)
        names.append(name)
        if names[-2:] == ["glass", "pillars"]:
            raise KeyboardInterrupt
        found = report(name)
        return {key: found[key] for key in found if key not in ("date", "machine", "versions", "load")}

    picture = io.BytesIO()
    Image.new("RGB", (4, 3)).save(picture, "PNG")
    monkeypatch.setattr(chart, "measure", measure)
    monkeypatch.setattr(all_charts, "draw", lambda report: [picture.getvalue()])
    monkeypatch.setattr(all_charts, "FOLDER", tmp_path / "charts")
    (tmp_path / "docs").mkdir()
    monkeypatch.setattr(all_charts, "PAGE", tmp_path / "docs" / "charts.html")
    return names


def test_a_run_goes_on_where_it_ended(measured, monkeypatch, capsys):
    with pytest.raises(KeyboardInterrupt):
        all_charts.main([])
    assert measured == ["atrium", "cornell", "glass", "pillars"]
    assert [one["scene"] for one in all_charts.read()] == measured[:3]
    measured.clear()
    assert all_charts.main([]) == 0
    assert measured == ["pillars", "stairs", "two_rooms"]
    page = all_charts.PAGE.read_text("utf-8")
    assert [one["scene"] for one in chart_page.figures(page)] == [
        "atrium", "cornell", "glass", "pillars", "stairs", "two_rooms",
    ]  # fmt: skip
    assert Checker(page).wrong == [] and page.count("<img") == 6
    # where another checkout has the page alone
    measured.clear()
    for path in all_charts.FOLDER.iterdir():
        path.unlink()
    assert all_charts.main(["cornell"]) == 0 and measured == []
    assert "cornell was charted with this code on 20" in capsys.readouterr().out
    assert all_charts.main(["cornell", "--again"]) == 0 and measured == ["cornell"]
    assert all_charts.main(["--draw"]) == 0 and measured == ["cornell"]
    monkeypatch.setattr(all_charts.judged, "RESOLUTION", 64)
    assert all_charts.main(["cornell"]) == 0 and measured == ["cornell"] * 2


def test_newer_figures_win(measured):
    """Of the page's, which git keeps, and a folder's, which may be older."""
    assert all_charts.main(["cornell"]) == 0
    path = all_charts.FOLDER / "cornell_chart.json"
    old = json.loads(path.read_text()) | {"date": "2001-01-01", "triangles": 1}
    path.write_text(json.dumps(old))
    assert all_charts.read()[0]["triangles"] == 12


def test_unknown_samples(measured, capsys):
    assert all_charts.main(["atlantis"]) == 2
    assert "Unknown sample: atlantis" in capsys.readouterr().out
