"""Where the page is served, and what a person is told of it."""

from __future__ import annotations

import stat
from contextlib import ExitStack
from pathlib import Path

import pytest

from dashboard.web.place import TOKEN_VARIABLE, Place, PlaceError, take_place, told_address
from runtime.hubs import address_file
from tests.unit.page_server import elbow

FIRST = 18_900


def place(folder: Path, port: int = FIRST, address: str = "127.0.0.1") -> Place:
    folder.mkdir(exist_ok=True)
    return take_place(elbow(port=port, address=address), folder, folder / "state")


@pytest.fixture(autouse=True)
def no_token(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(TOKEN_VARIABLE, raising=False)


def test_a_second_robot_gets_the_next_port(tmp_path: Path) -> None:
    with ExitStack() as stack:
        places = [place(tmp_path / name) for name in ("left", "right")]
        for each in places:
            stack.enter_context(each.socket)
        ports = [each.socket.getsockname()[1] for each in places]
        assert ports[1] > ports[0] >= FIRST
        assert places[1].url == f"http://localhost:{ports[1]}"
        assert told_address(str(tmp_path / "right")) == places[1].url


def test_one_that_comes_back_takes_the_port_it_had(tmp_path: Path) -> None:
    left, right = place(tmp_path / "left"), place(tmp_path / "right")
    left.socket.close()
    right.socket.close()
    again = place(tmp_path / "right")
    assert again.url == right.url
    again.socket.close()


def test_no_page_has_no_address(tmp_path: Path) -> None:
    assert told_address(str(tmp_path)) == ""


def test_on_this_host_no_token_is_asked_for(tmp_path: Path) -> None:
    here = place(tmp_path)
    here.socket.close()
    assert here.rules.token == ""
    assert not here.rules.anywhere
    assert here.told == here.url


def test_elsewhere_a_token_is_made_once_and_kept_to_oneself(tmp_path: Path) -> None:
    first, second = (place(tmp_path, address="0.0.0.0") for _ in range(2))
    first.socket.close()
    second.socket.close()
    file = tmp_path / "state" / "token"
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert first.rules.token == second.rules.token == file.read_text()
    assert first.rules.anywhere
    assert str(file) in first.told
    assert first.rules.token not in first.told
    assert address_file(tmp_path, "web").read_text() == second.told


def test_a_token_that_is_given_is_the_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, "open sesame, please\n")
    for address in ("0.0.0.0", "127.0.0.1"):
        given = place(tmp_path, address=address)
        given.socket.close()
        assert given.rules.token == "open sesame, please"
    assert not (tmp_path / "state").exists()


def test_a_token_that_can_be_guessed_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, "sesame")
    with pytest.raises(PlaceError, match="has 6 characters, 16 are needed; make one by: python3"):
        place(tmp_path)


def test_a_certificate_that_is_none_is_refused_in_words(tmp_path: Path) -> None:
    for name in ("page.pem", "key.pem"):
        (tmp_path / name).write_text("nothing of the kind")
    files = {"certificate": str(tmp_path / "page.pem"), "key": str(tmp_path / "key.pem")}
    with pytest.raises(PlaceError, match=r"page\.pem and .*key\.pem are no certificate with its"):
        take_place(elbow(port=FIRST, **files), tmp_path, tmp_path / "state")


def test_a_certificate_that_is_missing_is_told_by_the_one_who_reads_it(tmp_path: Path) -> None:
    (tmp_path / "page.pem").write_text("")
    files = {"certificate": str(tmp_path / "page.pem"), "key": str(tmp_path / "none.pem")}
    with pytest.raises(PlaceError, match=r"^\[web\]: key file .*none\.pem does not exist$"):
        take_place(elbow(port=FIRST, **files), tmp_path, tmp_path / "state")


def test_an_address_of_another_host_is_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(PlaceError, match=r"cannot be served at 203\.0\.113\.7.*see \[web\]"):
        place(tmp_path, address="203.0.113.7")
