"""The page of results: what is found, how it is read, what is not let out."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from dashboard.web.results import find, folders_of, missing_folders, read
from experiments.tables import Measure, markdown_table
from runtime.cli.main import DONE, REFUSED, main
from tests.unit.page_server import elbow, served

PIXEL = b"\x89PNG\r\n\x1a\n"
MEANS = [
    {"method": "before", "n_new": 0, "mean": 0.0214, "sd": 0.0001},
    {"method": "(iv)", "n_new": 5, "mean": 0.005, "sd": None},
]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """As experiments leave it: one swept into its own folder, one told in a document."""
    swept = tmp_path / "arm-quick"
    swept.mkdir()
    measure = Measure("e_theta_rad", "E_theta", "rad", 4)
    runs = [
        {
            "method": method,
            "control": "norm",
            "variant": "clean",
            "n_new": 5,
            "seed": seed,
            "figures": {"e_theta_rad": value},
        }
        for method, value in (("(iii)", 0.02), ("(iv)", 0.01))
        for seed in range(3)
    ]
    (swept / "tables.md").write_text(markdown_table(measure, runs) + "\n")
    (swept / "arm-norm.png").write_bytes(PIXEL)
    (swept / "arm-norm.svg").write_text("<svg xmlns='http://www.w3.org/2000/svg'/>")
    (swept / "units.jsonl").write_text("{}")
    rows = [{"figure": "e_theta_rad", "variant": "clean", "control": "paper", **x} for x in MEANS]
    order = {
        "claim": "(ii) < (i)",
        "figure": "e_theta_rad",
        "variant": "clean",
        "control": "paper",
        "n_new": 5,
        "verdict": "a < b",
    }
    titles = {"e_theta_rad": "E_theta [rad]"}
    document = {"titles": titles, "means": rows, "orderings": [order, {**order, "claim": ""}]}
    (tmp_path / "elbow.json").write_text(json.dumps(document))
    (tmp_path / "elbow-paper.svg").write_text("<svg xmlns='http://www.w3.org/2000/svg'/>")
    (tmp_path / "elbow-b.json").write_text(json.dumps(document))
    (tmp_path / "elbow-b-paper.svg").write_text("<svg xmlns='http://www.w3.org/2000/svg'/>")
    (tmp_path / "broken.json").write_text('{"means": [{}]}')
    return tmp_path


def test_both_kinds_are_found(folder: Path) -> None:
    found = find((folder, folder / "nowhere"))
    assert list(found) == ["arm-quick", "elbow-b", "elbow", "broken"]
    assert list(found["arm-quick"].pictures) == ["arm-norm.png"]
    assert list(found["elbow"].pictures) == ["elbow-paper.svg"]
    assert list(found["elbow-b"].pictures) == ["elbow-b-paper.svg"]


def test_tables_of_a_sweep(folder: Path) -> None:
    (table,) = read(find((folder,))["arm-quick"])["tables"]
    assert table["title"] == "E_theta [rad]"
    assert table["head"] == ["", "N=5"]
    assert [row[0] for row in table["rows"]] == ["(iii)", "(iv)"]
    assert table["rows"][1][1].startswith("0.0100")


def test_tables_of_a_document(folder: Path) -> None:
    means, claims = read(find((folder,))["elbow"])["tables"]
    assert means["title"] == "E_theta [rad] · clean · control paper"
    assert means["head"] == ["method", "any N", "N=5"]
    assert means["rows"] == [["before", "0.0214 ± 0.0001", ""], ["(iv)", "", "0.00500"]]
    assert claims["rows"] == [["(ii) < (i)", "e_theta_rad", "clean", "paper", "5", "a < b"]]


def test_what_cannot_be_read_is_said(folder: Path) -> None:
    told = read(find((folder,))["broken"])
    assert told["tables"] == []
    assert told["problem"].startswith("broken.json cannot be read")


def test_the_documents_of_this_repository_are_read() -> None:
    found = find(folders_of(elbow()))
    documents = {file.stem for file in (Path("docs") / "results").glob("*.json")}
    assert documents >= {"elbow", "arm", "lift", "estimate-elbow", "ablate-elbow"}
    for name in documents:
        told = read(found[name])
        assert told["tables"], told
        assert all(len(row) == len(x["head"]) for x in told["tables"] for row in x["rows"])
    assert found["elbow"].pictures


def test_the_terminal_shows_the_same(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a folder that a robot's file names."""
    monkeypatch.setenv("XDG_STATE_HOME", str(folder / "none"))
    shipped = elbow()
    text = Path(shipped.file).read_text().replace('"../', f'"{Path(shipped.file).parent}/../')
    file = folder / "robot.toml"
    file.write_text(f'{text}\n[web]\nresults = ["."]\n')

    def said(*words: str, code: int = DONE) -> str:
        assert main(["results", *words, "--robot", str(file)]) == code
        told = capsys.readouterr()
        return told.err if code else told.out

    assert said().split()[:3] == ["arm-quick", "elbow-b", "elbow"]
    lines = said("elbow").splitlines()
    assert lines[0] == "E_theta [rad] · clean · control paper"
    assert [line.split() for line in lines[1:3]] == [
        ["method", "any", "N", "N=5"],
        ["before", "0.0214", "±", "0.0001"],
    ]
    assert lines[-1] == f"picture: {folder / 'elbow-paper.svg'}"
    assert json.loads(said("elbow", "--json"))["tables"][1]["rows"][0][-1] == "a < b"
    assert "did you mean 'elbow'" in said("elbwo", code=REFUSED)
    assert "broken.json cannot be read" in said("broken", code=REFUSED)


def test_folders_of_the_robot_file_come_first(folder: Path) -> None:
    settings = msgspec.structs.replace(
        elbow(results=(folder.name,)), file=str(folder / "../x.toml")
    )
    assert folders_of(settings)[0] == folder.resolve()
    assert missing_folders(settings) == []
    assert missing_folders(elbow(results=("runs",))) == [elbow().beside("runs")]


def test_over_the_page(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    with served(tmp_path_factory.mktemp("run"), folders=(folder,)) as page:
        names = [row["name"] for row in page.get("/api/results").json]
        assert names == ["arm-quick", "elbow-b", "elbow", "broken"]
        assert len(page.get("/api/results/elbow").json["tables"]) == 2
        picture = page.get("/api/results/arm-quick/arm-norm.png")
        assert (picture.status, picture.body) == (200, PIXEL)
        assert picture.headers["Content-Security-Policy"] == "sandbox"
        for path in (
            "/api/results/none",
            "/api/results/arm-quick/units.jsonl",
            "/api/results/arm-quick/..%2Felbow.json",
            "/api/results/..%2F..%2Fetc/passwd",
        ):
            assert page.get(path).status == 404, path
